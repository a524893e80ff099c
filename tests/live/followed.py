"""A recorded push followed live, and what each frame of it costs."""

from __future__ import annotations

import time as clock
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from onebend.live.live import Live
from onebend.live.review import Reviewer, Seen
from onebend.records import Array
from tests.live.disturbed import Arrival


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
    reviews: float  # s, processor time of this process's reviews


class _Timed:
    """A reviewer, and how long this process is at its reviews."""

    def __init__(self, reviewer: Reviewer) -> None:
        self.begun, self.spent = reviewer.begin, 0.0

    def begin(self, seen: Seen) -> None:
        begun = clock.thread_time()
        self.begun(seen)
        self.spent += clock.thread_time() - begun


def learned_until(live: Live) -> float:
    """s, the camera's clock: the last frame that k(s) has in it; NaN where there is none."""
    return live._following.until + live._begin


def follow(live: Live, arrivals: Iterable[Arrival], *, at_pace: bool = False) -> Followed:
    """Play arrivals to a stream and measure the cost of each frame, and its delay until k(s) includes it.

    An arrival waits while the one before is processed. Time counts stamps and processor time without reviews; with
    `at_pace` it is wall time, and arrivals come as fast as they were recorded.
    """
    stamps, came, frame_cost, force_cost, tags, latency = [], [], [], [], [], []
    now, between, zero = -np.inf, 0.0, np.nan
    waiting: list[int] = []  # frames that are not in k(s)
    timed = _Timed(live._reviewer)
    live._reviewer.begin = timed.begin  # type: ignore[method-assign]
    for arrival in arrivals:
        if at_pace:
            zero = clock.perf_counter() - arrival.at if np.isnan(zero) else zero
            clock.sleep(max(0.0, arrival.at + zero - clock.perf_counter()))
        until, begun = learned_until(live), clock.thread_time() - timed.spent
        learning = not np.isnan(until)
        if arrival.picture is None:
            live.force(arrival.stamp, arrival.rows[:, :2], arrival.rows[:, 2] if arrival.rows.shape[1] > 2 else None)
        else:
            live.frame(arrival.picture, float(arrival.stamp), arrival.colour)
        cost = clock.thread_time() - timed.spent - begun
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
        for i in [i for i in waiting if stamps[i] <= learned_until(live)]:
            latency[i] = now - came[i]
            waiting.remove(i)
    live._reviewer.begin = timed.begun  # type: ignore[method-assign]
    costs = np.array(frame_cost), np.array(force_cost), np.array(tags), np.array(latency)
    return Followed(np.array(stamps), *costs, reviews=timed.spent)
