"""The course of a push as the tags show it: how far the beam is bent in each frame, on the way out or back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.records import Array, BoolArray, Observations


@dataclass(frozen=True)
class PushCourse:
    """T frames of one recording, in order of time."""

    time: Array  # (T,) s
    bend: Array  # (T,) 0 to 1: displacement of the tags over its largest
    back: Array  # (T,) 1 after the largest displacement
    elapsed: Array  # (T,) 0 to 1: integral of `bend` over time so far, over its end
    turn: Array  # (T, m) rad of each tag since rest; 0 where it was not seen


def course(observations: Observations, frames: BoolArray) -> PushCourse:
    """Of the chosen `frames` (T,) of a recording."""
    o = observations
    time, xy, angle = o.time[frames], o.xy[frames], o.angle[frames]
    rest = np.where(np.isfinite(o.rest_xy), o.rest_xy, xy[0])
    squares = np.sum((xy - rest) ** 2, axis=-1)
    seen = np.isfinite(squares)
    total = np.sum(np.where(seen, squares, 0.0), axis=1)
    away = np.sqrt(total / np.maximum(np.sum(seen, axis=1), 1))
    bend = away / max(float(np.max(away)), np.finfo(float).tiny)
    step = np.gradient(time) if len(time) > 1 else np.ones(1)
    elapsed = np.cumsum(bend * step)
    elapsed = elapsed / max(float(elapsed[-1]), np.finfo(float).tiny)
    back = np.asarray(np.arange(len(time)) > int(np.argmax(bend)), dtype=float)
    turn = angle - np.where(np.isfinite(o.rest_angle), o.rest_angle, 0.0)
    return PushCourse(time, bend, back, elapsed, np.where(np.isfinite(turn), turn, 0.0))


def with_rest(values: Array, count: int) -> Array:
    """(count, ...) values (T, ...) of the frames; zero in the frames behind, which show the beam at rest."""
    out = np.zeros((count, *values.shape[1:]))
    out[: len(values)] = values
    return out
