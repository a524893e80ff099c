"""A frame goes into k(s) with the force of its time; where the clocks leave open which one that is, with the newest."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from onebend.live.history import ForceHistory, FrameReader
from onebend.live.live import Following, Learning
from onebend.records import Array

AHEAD = 5.0  # s, of the log's clock
RATE, FPS = 100.0, 30.0


@dataclass
class Reader:
    """As `FrameReader`, of frames without tags."""

    offset: float
    offset_sd: float

    def stands_in(self, ahead: float) -> float:
        return FrameReader.stands_in(self, ahead)  # type: ignore[arg-type]

    def force_on_beam(self, logged: Array) -> Array:
        return logged

    def frame(self, time: float, corners: Array, logged: Array) -> Any:  # noqa: ARG002
        return SimpleNamespace(time=time, force=logged) if np.isfinite(logged).all() else None


@dataclass
class Learner:
    """Takes note of what it is taught."""

    time: list[float] = field(default_factory=list)
    taken: list[float] = field(default_factory=list)  # s, the log's time of the force

    def update(self, time: float, force: Array) -> Any:
        self.time.append(time)
        self.taken.append(float(force[0]))
        return SimpleNamespace(doubts=())


def followed(wrong: float, sd: float, seconds: float = 4.0, gap: float = 0.0, late: float = 0.0) -> Any:
    """Frames and samples as they come in, the clocks taken to be `wrong` [s] by an `sd`; the sensor stops for a `gap`
    [s] from 2 s on, and all its samples are `late` [s]. With how long each frame waited, and what it was taught."""
    log = ForceHistory(10_000)
    following, learner = Following(log, 2.0, 1000), Learner()
    following.learning = Learning(Reader(AHEAD + wrong, sd), learner, -np.inf)  # type: ignore[arg-type]
    samples = [t for t in np.arange(-1.0, seconds, 1.0 / RATE).tolist() if not 2.0 <= t < 2.0 + gap]
    frames = np.arange(0.0, seconds, 1.0 / FPS).tolist()
    events = sorted([(t + late, 0, t) for t in samples] + [(t + 0.005, 1, t) for t in frames])
    waited: dict[float, float] = {}
    most = 0.0
    for now, is_frame, t in events:
        if is_frame:
            following.add(t, np.zeros((1, 4, 2)))  # type: ignore[arg-type]
            most = max(most, following.stands_in)
        else:
            log.add(np.array([[t + AHEAD, t + AHEAD, 0.0]]))
            following.release()
        for one in learner.time[len(waited) :]:
            waited[one] = now - one
    return SimpleNamespace(waited=waited, taken=dict(zip(learner.time, learner.taken, strict=True)), stands_in=most)


def test_a_frame_waits_for_the_force_of_its_time_where_the_clocks_are_known() -> None:
    right, wrong = followed(0.0, 0.005), followed(0.2, 0.005)
    assert max(right.waited.values()) < 0.05
    assert right.stands_in <= 0.01
    assert all(taken == pytest.approx(time + AHEAD, abs=0.01) for time, taken in right.taken.items())
    assert min(wrong.waited.values()) > 0.19  # the sensor is that late


def test_a_frame_takes_the_newest_force_where_the_clocks_leave_that_open() -> None:
    poorly = followed(0.2, 0.15)
    assert max(poorly.waited.values()) < 0.05
    assert poorly.stands_in == pytest.approx(0.2, abs=0.02)
    assert all(taken == pytest.approx(time + AHEAD, abs=0.02) for time, taken in poorly.taken.items())
    behind = followed(-0.2, 0.15)  # the force of the time that the clocks say is there
    assert behind.stands_in == 0.0
    assert all(taken == pytest.approx(time + AHEAD - 0.2, abs=0.01) for time, taken in behind.taken.items())


def test_never_farther_than_the_clocks_may_be_wrong() -> None:
    late = followed(0.0, 0.05, late=0.3)
    assert late.stands_in == pytest.approx(0.1)
    assert min(late.waited.values()) > 0.18
    assert all(time + AHEAD - taken <= 0.12 for time, taken in late.taken.items())


def test_a_sensor_that_stops_gives_no_old_force() -> None:
    stopped = followed(0.0, 0.3, gap=0.4)
    assert all(abs(time + AHEAD - taken) <= 0.11 for time, taken in stopped.taken.items())
