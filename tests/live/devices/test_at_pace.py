"""A film that is played at its own pace beside a box that sends by itself: two threads, two clocks, one folder."""

from __future__ import annotations

import csv
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onebend.live.force_sensors import AtiForce, AtiScale
from onebend.live.session import record
from onebend.live.sources import HostClock
from onebend.report.overview import overview
from tests.live.devices.test_ati import Box
from tests.live.disturbed import Disturbances, DisturbedCamera
from tests.live.played_push import CAMERA_CLOCK, SETTINGS, folder
from tests.live.streamed import BIAS, DURATION, force_at, frames

RATE = 200.0  # Hz


@pytest.mark.slow
def test_a_played_film_and_a_box_that_sends_become_a_recording(tmp_path: Path) -> None:
    shown = frames()  # before the clock begins
    box, clock, done = Box(), HostClock(), threading.Event()
    sensor = AtiForce("127.0.0.1", port=box.port, scale=AtiScale(1e6, 1e6, RATE))

    def send() -> None:
        box.asked()
        rng = np.random.default_rng(1)
        begun = clock.now()
        for i in range(round((DURATION + 3.0) * RATE)):
            clock.wait_until(begun + i / RATE)
            if done.is_set():
                return
            moment = np.array([clock.now() - clock.origin])
            x, y = (force_at(moment)[0] + BIAS + 0.001 * rng.standard_normal(2)).tolist()
            box.send((x, y, 0.0))

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    camera = DisturbedCamera(shown, Disturbances(), CAMERA_CLOCK, 0)
    begun = time.monotonic()
    outcome = record(folder(tmp_path), camera, sensor, replace(SETTINGS, begin_at_once=True), clock=clock)
    assert time.monotonic() - begun > 0.7 * DURATION
    done.set()
    thread.join()
    box.socket.close()
    assert not outcome.fault, outcome.why
    assert overview(tmp_path).faults == ()
    with (tmp_path / "force.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    at, force = (np.array([float(row[name]) for row in rows]) for name in ("time_s", "fy_N"))
    later = at > 0.5
    # Sent when the film was there: what is left is what the film takes to be shown, and the noise.
    assert np.median(np.abs(force - BIAS[1] - force_at(at)[:, 1])[later]) < 0.01
