"""Pictures that only repeat the one before while the beam moves on: a camera, or what recorded it, that hung.

A film of a beam at rest may repeat pictures rightly: a packed film shows little where nothing changes. So pictures that
repeat are left out only where the tags stand elsewhere as soon as the pictures change again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from onebend.recording.signals import bridged, runs
from onebend.recording.video import FilmFrame, Picture
from onebend.records import Array, BoolArray, Remark

SHORTEST = 3  # pictures that repeat; fewer are a hiccup of less than the clock's own error
JUMP, LEAST_PX = 3.0, 1.0  # times the steps before and after, and px, that the tags go when the pictures change again
COARSE = 4  # px: every so manyth pixel is compared
SAME = 0.25  # of the usual change from picture to picture, which noise makes: less is a repeat


def noting_changes(frames: Iterable[FilmFrame], changes: list[float]) -> Iterator[FilmFrame]:
    """The frames; how much each differs from the one before (mean of the grey levels) is added to `changes`."""
    before: NDArray[np.int16] | None = None
    for frame in frames:
        coarse = coarse_of(frame.luma)
        changes.append(change_between(before, coarse))
        before = coarse
        yield frame


def coarse_of(picture: Picture) -> NDArray[np.int16]:
    """What of a picture is compared."""
    return picture[::COARSE, ::COARSE].astype(np.int16)


def change_between(before: NDArray[np.int16] | None, coarse: NDArray[np.int16]) -> float:
    """Mean difference of the grey levels of two pictures (`coarse_of`); infinite where there is none before."""
    if before is None or before.shape != coarse.shape:
        return math.inf
    return float(np.mean(np.abs(coarse - before)))


def repeated(changes: Sequence[float]) -> BoolArray:
    """(T,) pictures that are the one before, but for what packing the film makes of it."""
    change = np.array(changes)
    usual = float(np.median(change[1:])) if len(change) > 1 else 0.0
    return np.asarray((change == 0.0) | (change < SAME * usual))


def frozen(corners: Array, repeats: BoolArray) -> BoolArray:
    """(T,) frames that repeat (T,) the one before, in runs after which the tags (T, m, 4, 2) [px] stand elsewhere."""
    centre = bridged(np.arange(len(corners), dtype=float), corners.mean(axis=2).reshape(len(corners), -1))
    centre = centre.reshape(len(corners), -1, 2)
    step = np.linalg.norm(np.diff(centre, axis=0), axis=-1)  # (T - 1, m)
    hung = np.zeros(len(corners), dtype=bool)
    for begin, end in runs(repeats).tolist():
        if end - begin < SHORTEST or end >= len(corners) or begin < 2:
            continue
        around = np.concatenate([step[max(begin - 4, 0) : begin - 1], step[end : end + 3]])
        usual = np.nan_to_num(np.nanmax(around, axis=0, initial=0.0)) if len(around) else np.zeros(step.shape[1])
        if np.any(step[end - 1] > np.maximum(LEAST_PX, JUMP * usual)):
            hung[begin:end] = True
    return hung


def frozen_remarks(hung: BoolArray, time: Array) -> tuple[Remark, ...]:
    """A warning on each stretch of the film that is left out; `time` (T,) s."""
    return tuple(
        Remark(
            "warning",
            f"The pictures of frames {begin} to {end - 1} only repeat the one before, and then the beam is elsewhere: "
            f"the film hung for {time[end] - time[begin - 1]:.2g} s. They are left out.",
            about="film hung",
        )
        for begin, end in runs(hung).tolist()
    )
