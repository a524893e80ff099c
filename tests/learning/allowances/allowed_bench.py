"""A recording with every allowance, and parameters at which none of them is zero."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.beam.stiffness import Uniform
from onebend.learning.allowances import EVERY_ALLOWANCE, Film, PushCourse, course_of
from onebend.learning.fit_data import FitData, fit_data
from onebend.learning.parameters import Layout, Spline, make_layout
from onebend.records import Array, Observations, View
from tests.learning.bench import SOFT, forces, observed
from tests.made_up import with_source, with_stated

TAGS = np.array([0.3, 0.6, 0.9])  # none at the tip, where a tag that moves outwards leaves the curved beam
PUSH_S = 0.8
_TILT = np.deg2rad(20.0)
CAMERA = View(
    matrix=np.array([[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]]),
    dist=np.zeros(5),
    rotation=np.diag([1.0, -1.0, -1.0])
    @ np.array([[1.0, 0.0, 0.0], [0.0, np.cos(_TILT), -np.sin(_TILT)], [0.0, np.sin(_TILT), np.cos(_TILT)]]),
    translation=np.array([-0.05, 0.02, 0.45]),
    calibrated=False,
    corner_sd=0.1,
)


def filmed(count: int = 20) -> Observations:
    """A push that bends the beam far, slowly enough for it to relax, as a camera sees it."""
    made = observed(SOFT, forces(count), at_s=PUSH_S)
    made = replace(made, marker_s=TAGS, time=0.3 * np.arange(count) + 0.05 * np.sin(np.arange(count)))
    by_camera = 1e-5 * np.random.default_rng(1).standard_normal((count, len(TAGS), 3, 2))
    return replace(with_source(with_stated(made, rest="unknown", friction_sd=0.3), view=CAMERA), by_camera=by_camera)


def course(count: int = 20, **changed: object) -> PushCourse:
    """`filmed`, with changed fields, and the beam at rest behind."""
    made = replace(filmed(count), **changed)  # type: ignore[arg-type]
    return fit_course(made)


def fit_course(made: Observations) -> PushCourse:
    """As the fit sees it, all frames and the beam at rest."""
    one = fit_data(made, 0, np.ones(len(made.time), dtype=bool), Spline(7))
    film = Film(made, one.frames, one.measured, one.problem, np.zeros((1, 2)), Uniform(0.0), one.rate)
    return course_of(made, one.frames, film, one.across)


def with_everything(*, share: float) -> tuple[FitData, Layout, Array]:
    """Data, layout and parameters (P,), about half of a prior sd from zero each; `share` is what relaxes."""
    made, spline = filmed(), Spline(7)
    one = fit_data(made, 0, np.ones(len(made.time), dtype=bool), spline, EVERY_ALLOWANCE)
    layout = make_layout(spline, [made], [len(one.error.knots)], [one.allowances])
    rng, x = np.random.default_rng(0), np.zeros(layout.size)
    for block in layout.blocks:
        if block.start >= 0 and block.name != "force":
            x[block.where] = 0.5 * block.prior_sd * rng.choice([-1.0, 1.0], len(block.prior_sd))
    x[layout.index["stiffness", -1].where] = np.log(0.03) + 0.3 * np.cos(np.arange(7))
    x[layout.index["relaxation", -1].where] = share * np.array([0.4, 1.0, -0.2])
    return one, layout, x
