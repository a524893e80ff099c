"""Forces written as a bag, read back by the reader of recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from onebend.errors import ExportError
from onebend.recording.bag_topics import clock_of, read_bag_force, timed
from onebend.recording.bags import open_bag, topic_of
from onebend.recording.entries import ForceEntry
from onebend.results.sensing import COVARIANCE_TOPIC, FORCE_TOPIC, FRAME, force_bag

RNG = np.random.default_rng(2)
TIME = 1.7e9 + np.arange(16) / 30.0
FORCE = RNG.normal(size=(16, 2))
ROOT = RNG.normal(size=(16, 2, 2))
COVARIANCE = ROOT @ np.swapaxes(ROOT, 1, 2)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    """A frame that tells no force is left out."""
    force = FORCE.copy()
    force[2] = np.nan
    kept = [0, 1, *range(3, 16)]
    file = tmp_path / "force.mcap"
    file.write_bytes(force_bag(TIME, force, COVARIANCE))
    log = read_bag_force(ForceEntry(file=file, topic=FORCE_TOPIC))
    np.testing.assert_array_equal(log.force, FORCE[kept])
    np.testing.assert_allclose(log.time - log.time[0], TIME[kept] - TIME[0], atol=1e-6)
    bag = open_bag(file)
    wrenches = topic_of(bag, FORCE_TOPIC, "topic")
    clock = clock_of(bag, wrenches)
    assert clock.by == "header"
    assert clock.origin == round(TIME[0] * 1e9)
    first = next(message for _, message in timed(bag, wrenches, clock))
    assert (first.header.frame_id, first.wrench.force.z, first.wrench.torque.z) == (FRAME, 0.0, 0.0)
    topic = topic_of(bag, COVARIANCE_TOPIC, "topic")
    received = clock_of(bag, topic)
    assert received.origin == clock.origin
    read = [message for _, message in timed(bag, topic, received)]
    np.testing.assert_array_equal([message.data.reshape(2, 2) for message in read], COVARIANCE[kept])
    assert [side.label for side in read[0].layout.dim] == ["row: fx_N, fy_N", "column: fx_N, fy_N"]


def test_a_recording_that_begins_at_zero_has_a_stamp(tmp_path: Path) -> None:
    file = tmp_path / "force.mcap"
    file.write_bytes(force_bag(TIME - TIME[0], FORCE, COVARIANCE))
    log = read_bag_force(ForceEntry(file=file, topic=FORCE_TOPIC))
    np.testing.assert_array_equal(log.force, FORCE)
    np.testing.assert_allclose(log.time - log.time[0], TIME - TIME[0], atol=2e-9)


def test_what_no_stamp_can_hold_is_refused() -> None:
    with pytest.raises(ExportError, match="from 0 to"):
        force_bag(TIME - TIME[3], FORCE, COVARIANCE)
    with pytest.raises(ExportError, match="no frame has a force"):
        force_bag(TIME, np.full((16, 2), np.nan), COVARIANCE)
