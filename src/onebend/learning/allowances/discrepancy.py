"""What is left: every coordinate of every tag may be off by something smooth in the bending and in time.

A discrepancy between model and world (Kennedy and O'Hagan 2001) whose size the evidence chooses: the band is as wide as
the world demands and as narrow as it allows.
"""

from __future__ import annotations

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.course import PushCourse, with_rest
from onebend.records import Array

PLACE_SD = 5e-5  # m, of each function's coefficient, before the evidence has chosen
XY, ANGLE = (0, 1), (2,)  # coordinates of a pose
LEVER = 0.3  # of the length: a smooth error of place d has a slope of about d over this


def discrepancy(run: PushCourse, tags: tuple[str, ...], length: float, count: int) -> tuple[Allowance, Allowance]:
    """For the tags' places, and for their angles; `count` frames, those at rest last."""
    return discrepancy_of(with_rest(smooth_functions(run), count), tags, length)


def discrepancy_of(functions: Array, tags: tuple[str, ...], length: float) -> tuple[Allowance, Allowance]:
    """The same of these functions (F, n)."""
    places, angles = (of_axes(functions, len(tags), axes) for axes in (XY, ANGLE))
    place_labels = tuple(f"discrepancy {t} {a}{i}" for a in "xy" for t in tags for i in range(functions.shape[1]))
    angle_labels = tuple(f"discrepancy {t} angle{i}" for t in tags for i in range(functions.shape[1]))
    place_sd = np.full(len(place_labels), PLACE_SD)
    angle_sd = np.full(len(angle_labels), PLACE_SD / (LEVER * length))
    return (
        Allowance("discrepancy", "poses", "m", place_labels, place_sd, places, sized=True),
        Allowance("angle discrepancy", "poses", "rad", angle_labels, angle_sd, angles, sized=True),
    )


def smooth_functions(run: PushCourse) -> Array:
    """(T, 5)."""
    side = run.back - 0.5
    return np.stack([run.bend, run.bend**2, run.bend * side, run.bend**2 * side, run.elapsed], axis=1)


def of_axes(functions: Array, tags: int, axes: tuple[int, ...]) -> Array:
    """(F, m, 3, axes m n): each of the functions (F, n) for each of these coordinates of each tag."""
    frames, n = functions.shape
    out = np.zeros((frames, tags, 3, len(axes), tags, n))
    for i, axis in enumerate(axes):
        for tag in range(tags):
            out[:, tag, axis, i, tag] = functions
    return out.reshape(frames, tags, 3, len(axes) * tags * n)
