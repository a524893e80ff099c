"""A film and a force log as a camera and a sensor would give them on a bad day: late, with gaps, out of order, with
clocks of their own. Time is data: nothing waits."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from onebend.live.played import PlayedCamera, PlayedForce
from onebend.live.sources import Frame, Samples
from onebend.recording.video import FilmFrame, Picture
from onebend.records import Array, ForceLog


@dataclass(frozen=True)
class Disturbances:
    """What happens to frames and samples on their way; all shares are of those that come."""

    frames_lost: float = 0.0
    frames_late: float = 0.0  # that come after the next ones
    frames_late_by: float = 0.1  # s
    frames_twice: float = 0.0
    frame_delay: float = 0.005  # s, from the exposure to where it is read
    frame_jitter: float = 0.0  # s, one sd of its stamp
    samples_lost: float = 0.0
    samples_late: float = 0.0
    samples_late_by: float = 0.05  # s
    samples_twice: float = 0.0
    samples_nan: float = 0.0
    sample_delay: float = 0.002  # s
    sample_jitter: float = 0.0  # s, one sd of its stamp
    samples_each: int = 10  # that come together


@dataclass(frozen=True)
class Arrival:
    """A picture, or samples of the force, as they come in."""

    at: float  # s, the camera's clock
    stamp: Array  # () or (n,) s, the own clock of what sends it
    picture: Picture | None = None
    rows: Array = field(default_factory=lambda: np.empty((0, 2)))  # (n, 2) N, or with the place of the push (n, 3)
    number: int = -1  # of the picture in its film
    colour: Any = None  # of the picture, as of `FilmFrame`


def play(
    frames: Iterable[FilmFrame],
    log: ForceLog,
    offset: float,
    disturbances: Disturbances = Disturbances(),
    *,
    seed: int = 0,
) -> Iterator[Arrival]:
    """Frames and samples in the order in which they come in; the same `seed` gives the same order.

    `offset` [s] is what the log's clock is ahead of the film's. Only what is on its way is held at a time.
    """
    rng = np.random.default_rng(seed)
    coming: list[tuple[float, int, Arrival]] = []
    count = 0
    for begun, arrivals in _sent(frames, log, offset, disturbances, rng):
        while coming and coming[0][0] <= begun:
            yield heapq.heappop(coming)[2]
        for arrival in arrivals:
            heapq.heappush(coming, (arrival.at, count, arrival))
            count += 1
    while coming:
        yield heapq.heappop(coming)[2]


def _sent(
    frames: Iterable[FilmFrame], log: ForceLog, offset: float, how: Disturbances, rng: np.random.Generator
) -> Iterator[tuple[float, list[Arrival]]]:
    """When each frame or packet of samples is sent [s, the camera's clock], and how it comes in: not at all, or up to
    two times."""
    packets = iter(range(0, len(log.time), how.samples_each))
    packet = next(packets, None)
    for frame in frames:
        while packet is not None and log.time[_last(log, packet, how)] - offset <= frame.time:
            yield _samples(log, packet, offset, how, rng)
            packet = next(packets, None)
        late = how.frames_late_by * (rng.random() < how.frames_late)
        arrival = Arrival(
            at=frame.time + how.frame_delay + late,
            stamp=np.array(frame.time + how.frame_jitter * rng.normal()),
            picture=frame.luma,
            number=frame.index,
            colour=frame.colour,
        )
        times = 0 if rng.random() < how.frames_lost else 1 + int(rng.random() < how.frames_twice)
        yield frame.time, [arrival] * times
    while packet is not None:
        yield _samples(log, packet, offset, how, rng)
        packet = next(packets, None)


def _samples(
    log: ForceLog, first: int, offset: float, how: Disturbances, rng: np.random.Generator
) -> tuple[float, list[Arrival]]:
    """When the rows from `first` on that go together are sent, and how they come in."""
    last = _last(log, first, how)
    packet = np.arange(first, last + 1)
    rows = log.force[packet] if log.push_s is None else np.column_stack([log.force[packet], log.push_s[packet]])
    rows, stamps = rows.copy(), log.time[packet] + how.sample_jitter * rng.normal(size=len(packet))
    rows[rng.random(len(packet)) < how.samples_nan] = np.nan
    kept = np.flatnonzero(rng.random(len(packet)) >= how.samples_lost)
    kept = np.concatenate([kept, kept[rng.random(len(kept)) < how.samples_twice]])
    sent = float(log.time[last] - offset)
    late = how.samples_late_by * (rng.random() < how.samples_late)
    arrival = Arrival(at=sent + how.sample_delay + late, stamp=stamps[kept], rows=rows[kept])
    return sent, [arrival] if len(kept) else []


def _last(log: ForceLog, first: int, how: Disturbances) -> int:
    return min(first + how.samples_each, len(log.time)) - 1


@dataclass(frozen=True)
class OwnClock:
    """How a played source's stamps differ from the recorder's clock."""

    offset: float = 0.0  # s
    drift: float = 0.0  # of its second, as a share
    late: float = 0.0  # s, mean of what an item takes to come, beyond what all take; exponential

    def stamped(self, arrivals: Iterable[Arrival], seed: int) -> Iterator[tuple[Array, float, Arrival]]:
        """The stamp of each, when it comes in, and itself."""
        rng = np.random.default_rng([seed, 7])
        for one in arrivals:
            late = float(rng.exponential(self.late)) if self.late > 0.0 else 0.0
            yield self.offset + (1.0 + self.drift) * one.stamp, one.at + late, one


class DisturbedCamera(PlayedCamera):
    """A film as a camera with a clock of its own."""

    def __init__(self, film: Iterable[FilmFrame], how: Disturbances, own: OwnClock, seed: int) -> None:
        super().__init__(film)
        self._frames, self._how, self._own, self._seed = film, how, own, seed

    def items(self) -> Iterator[Frame]:
        nothing = ForceLog(np.empty(0), np.empty((0, 2)))
        arrivals = play(self._frames, nothing, 0.0, self._how, seed=self._seed)
        for stamp, at, one in self._own.stamped(arrivals, self._seed):
            assert one.picture is not None
            yield Frame(one.picture, float(stamp), at, one.number, one.colour)


class DisturbedForce(PlayedForce):
    """A force log as a sensor with a clock of its own."""

    def __init__(self, log: ForceLog, start: float, how: Disturbances, own: OwnClock, seed: int) -> None:
        super().__init__(log, start)
        self._how, self._own, self._seed = how, own, seed

    def items(self) -> Iterator[Samples]:
        arrivals = play((), self.log, 0.0, self._how, seed=self._seed + 1)
        for stamp, at, one in self._own.stamped(arrivals, self._seed):
            yield Samples(stamp, one.rows, at)
