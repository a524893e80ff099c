"""Frequencies as recording.toml states them, and a recording that holds nothing else."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations

import numpy as np

from onebend.errors import RecordingError
from onebend.recording.stated import stated_in
from onebend.recording.toml.entries import Recording
from onebend.recording.toml.frequency_entry import FrequencyEntry
from onebend.records import MeasuredFrequency, Observations, Remark, Source

_G = 9.81  # m/s^2, where [gravity] does not say another
_CLAMP_SD = 1e-6  # m, rad: the clamp is where it is


def measured_frequencies(rec: Recording) -> tuple[MeasuredFrequency, ...]:
    """Undamped, with gravity in the beam's frame.

    Raises:
        RecordingError: of two modes in one posture the lower one is the faster.
    """
    every = tuple(_measured(one, rec) for one in rec.frequencies)
    for one, other in permutations((one for one in every if one.mode > 0), 2):
        alike = one.tip_mass == other.tip_mass and np.allclose(one.gravity, other.gravity)
        if alike and one.mode < other.mode and one.frequency >= other.frequency:
            raise RecordingError(
                f"{rec.folder}: mode {one.mode} at {one.frequency:.4g} Hz is no slower than mode {other.mode} at "
                f"{other.frequency:.4g} Hz in the same posture. Correct hz or mode in [[frequencies]].",
                about="unit",
            )
    return every


def with_frequencies(seen: Observations, rec: Recording) -> Observations:
    """What was seen of the beam, and how fast it swings."""
    if not rec.frequencies:
        return seen
    source = replace(seen.source, remarks=(*seen.source.remarks, *_remarks(rec)))
    return replace(seen, source=source, frequencies=measured_frequencies(rec))


def frequency_observations(rec: Recording) -> Observations:
    """A recording of frequencies alone. All that it shows of the beam is the clamp in its place: nothing of k."""
    seen = Observations(
        source=Source(rec.name, remarks=rec.remarks),
        stated=replace(stated_in(rec), clamp_sd=0.0, placement_sd=0.0, turn_sd=0.0),
        length=rec.beam.length,
        time=np.zeros(1),
        frame=np.zeros(1, dtype=np.int64),
        tag_id=np.array([tag.id for tag in rec.tags.on_beam], dtype=np.int64),
        marker_s=np.zeros(1),
        xy=np.zeros((1, 1, 2)),
        angle=np.zeros((1, 1)),
        covariance=np.full((1, 1, 3, 3), _CLAMP_SD**2) * np.eye(3),
        force=np.zeros((1, 2)),
        force_sd=np.zeros(2),
        push_s=np.ones(1),
        loaded=np.ones(1, dtype=bool),
        rest_xy=np.full((1, 2), np.nan),
        rest_angle=np.full(1, np.nan),
        rest_covariance=np.full((1, 3, 3), np.nan),
        gravity=np.zeros((1, 2)),
        static=True,
    )
    return with_frequencies(seen, rec)


def _measured(one: FrequencyEntry, rec: Recording) -> MeasuredFrequency:
    undamped = 1.0 / math.sqrt(1.0 - one.damping_ratio**2)
    base = _base_angle(one, rec)
    gravity = np.zeros(2)
    if math.isfinite(base):
        direction, size = (
            (-math.pi / 2.0, _G) if rec.gravity is None else (rec.gravity.direction, rec.gravity.magnitude)
        )
        gravity = size * np.array([math.cos(direction - base), math.sin(direction - base)])
        gravity[np.abs(gravity) < 1e-12 * size] = 0.0
    return MeasuredFrequency(
        undamped * one.hz, undamped * one.sd, one.mode, (float(gravity[0]), float(gravity[1])), one.tip_mass
    )


def _base_angle(one: FrequencyEntry, rec: Recording) -> float:
    """rad; NaN where nothing says it."""
    return one.base_angle if math.isfinite(one.base_angle) or rec.gravity is None else rec.gravity.base_angle


def _remarks(rec: Recording) -> tuple[Remark, ...]:
    across = [f"{one.hz:.4g}" for one in rec.frequencies if not math.isfinite(_base_angle(one, rec))]
    if not across:
        return ()
    text = (
        f"{', '.join(across)} Hz: without base_angle_deg the beam is taken to swing across gravity, where its weight "
        "does nothing to its frequency"
    )
    return (Remark("note", text),)
