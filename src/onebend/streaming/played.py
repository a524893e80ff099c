"""A recorded push played as a camera and a sensor would give it: late, with gaps, out of order. Time is data: nothing
waits."""

from __future__ import annotations

import heapq
import time as clock
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from onebend.recording.video import FilmFrame, Picture
from onebend.records import Array, ForceLog
from onebend.streaming.live import Live


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
class Followed:
    """How a played push was followed, frame by frame."""

    time: Array  # (T,) s, stamps of the frames that came
    frame: Array  # (T,) s, processor time of `Live.frame`
    force: Array  # (T,) s, processor time of `Live.force` since the frame before
    tags_latency: Array  # (T,) s, from its coming in until its tags are known
    latency: (
        Array  # (T,) s, the same until k(s) has it in it; NaN where that was no matter: before there is a k(s), late
    )


def follow(live: Live, arrivals: Iterable[Arrival], *, at_pace: bool = False) -> Followed:
    """Give a stream all that comes in, and measure: what a frame costs, and how long after it came it is in k(s).

    What comes in while the one before is worked on waits, as it would live. Time is that of the stamps and the
    processor's, without that of reviews, as if another process had made them; with `at_pace` it is the clock's, and all
    comes in as fast as it was recorded.
    """
    stamps, came, frame_cost, force_cost, tags, latency = [], [], [], [], [], []
    now, between, zero = -np.inf, 0.0, np.nan
    waiting: list[int] = []  # frames that are not in k(s)
    for arrival in arrivals:
        if at_pace:
            zero = clock.perf_counter() - arrival.at if np.isnan(zero) else zero
            clock.sleep(max(0.0, arrival.at + zero - clock.perf_counter()))
        until, begun = live.learned_until, clock.thread_time() - live.review_seconds
        learning = not np.isnan(until)
        if arrival.picture is None:
            live.force(arrival.stamp, arrival.rows[:, :2], arrival.rows[:, 2] if arrival.rows.shape[1] > 2 else None)
        else:
            live.frame(arrival.picture, float(arrival.stamp))
        cost = clock.thread_time() - live.review_seconds - begun
        now = clock.perf_counter() - zero if at_pace else max(now, arrival.at) + cost
        if arrival.picture is None:
            between += cost
        else:
            stamps.append(float(arrival.stamp))
            came.append(arrival.at)
            frame_cost.append(cost)
            force_cost.append(between)
            tags.append(now - arrival.at)
            latency.append(np.nan)
            between = 0.0
            waiting += [len(stamps) - 1] if learning and stamps[-1] > until else []
        for i in [i for i in waiting if stamps[i] <= live.learned_until]:
            latency[i] = now - came[i]
            waiting.remove(i)
    return Followed(*(np.array(one) for one in (stamps, frame_cost, force_cost, tags, latency)))
