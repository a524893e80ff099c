"""Which allowances a recording has, and what the person who fits may switch off."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from onebend.beam.grid import Grid
from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.clamp import giving
from onebend.learning.allowances.contact import sliding
from onebend.learning.allowances.course import course
from onebend.learning.allowances.discrepancy import discrepancy
from onebend.learning.allowances.length import length
from onebend.learning.allowances.patches import patches
from onebend.learning.allowances.picture import camera, has_rows, heights, rolling_shutter
from onebend.learning.allowances.posture import posture_bias
from onebend.learning.allowances.relaxation import relaxation
from onebend.learning.allowances.section import section
from onebend.records import Array, BoolArray, Observations

AllowanceName = Literal[
    "section",
    "relaxation",
    "slide",
    "clamp gives",
    "posture",
    "patches",
    "length",
    "inertia",
    "gravity direction",
    "heights",
    "camera",
    "rolling shutter",
    "discrepancy",
    "angle discrepancy",
    "between recordings",
]
EVERY_ALLOWANCE: frozenset[AllowanceName] = frozenset(get_args(AllowanceName))
OF_ONE = EVERY_ALLOWANCE - {"between recordings"}  # those that one recording may have


def allowances_of(
    observations: Observations,
    frames: BoolArray,
    measured: Array,
    push_s: Array,
    force: Array,
    grid: Grid,
    wanted: frozenset[AllowanceName],
) -> tuple[Allowance, ...]:
    """Those of a film's chosen `frames` (T,); none of static poses, whose loads hang on marks, in no order.

    `measured` (F, m, 3) poses of the tags, `push_s` (F,) and `force` (F, 2) N of these frames and of the beam at rest
    behind them; `grid` the beam is solved on.
    """
    if observations.static or not np.any(frames):
        return ()
    run, tags = course(observations, frames), tuple(f"tag {i}" for i in observations.tag_id)
    every = [
        section(known=bool(np.isfinite(observations.stated.thickness))),
        relaxation(run),
        patches(observations.marker_s, observations.length, observations.stated.tag_size, grid),
        length(),
        giving(run, len(force)),
        *discrepancy(run, tags, observations.length, len(force)),
    ]
    if np.any(force != 0.0):
        every += [sliding(observations.marker_s, run, push_s), posture_bias(run, force)]
    if observations.source.view is not None:
        every.append(heights(observations, measured))
        if has_rows(observations):
            every.append(rolling_shutter(observations, frames, len(force)))
    if observations.by_camera is not None:
        every.append(camera(observations, frames, len(force)))
    return tuple(one for one in every if one.name in wanted)
