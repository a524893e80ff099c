"""The fit's and the live learner's derivatives of the tags: the same numbers, and those of central differences.

Both on the live learner's grid: the fit's own is finer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from onebend.learning import static_poses
from onebend.learning.allowances import TIMES, MaterialMemory, lags, reached_part
from onebend.learning.fit_data import fit_data
from onebend.learning.parameters import Block, Layout, Spline, make_layout
from onebend.learning.prediction import Prediction, predict
from onebend.live.model import RESOLUTION, FrameInputs, frames_at, pushed_at, session_of
from onebend.records import Array, ClockOffset, View
from tests.learning.bench import SOFT, forces, observed
from tests.made_up import with_stated

SPLINE, MASS, PUSH_S = Spline(7), 0.02, 0.8
TAGS = np.array([0.3, 0.6, 0.9])  # none at the tip, where a tag that moves outwards leaves the curved beam
STATED = {"curvature_sd": 0.1, "turn_sd": 0.02, "placement_sd": 5e-4, "clamp_sd": 0.01, "scale_sd": 0.01}  # no zeros
FREE = {"scale": 0.01, "clock": 0.02, "place": 1e-3, "direction": 0.01}
# What both have, in the same functions; discrepancy and posture have others, and enter just as they say.
ALLOWED = ("section", "relaxation", "slide", "clamp gives", "patches", "length")
BLOCKS = (
    "stiffness",
    "curvature",
    "mass",
    "along",
    "across",
    "turn",
    "clamp",
    "origin",
    "scale",
    "clock",
    "place",
    "direction",
    *ALLOWED,
)


class Point:
    """One recording at one point of all parameters, as the fit and as the live learner see it."""

    def __init__(self) -> None:
        made = observed(SOFT, forces(8), at_s=PUSH_S)
        frames = np.ones(8, dtype=bool)
        stated = replace(made.stated, mass=MASS, rest="unknown", place_sd=1e-3, direction_sd=0.01)
        gravity, unseen = np.tile([1.0, -3.0], (8, 1)), np.full((3, 2), np.nan)
        camera = View(np.eye(3), np.zeros(5), np.eye(3), np.ones(3), calibrated=False, corner_sd=0.1)
        made = replace(
            made,
            marker_s=TAGS,
            stated=stated,
            source=replace(made.source, view=camera, clock=ClockOffset(0.0, 0.01, 0.0, True)),
            gravity=gravity,
            rest_xy=unseen,
        )
        made = with_stated(made, **STATED)
        self.fit_data = data = fit_data(made, 0, frames, SPLINE, frozenset(ALLOWED))
        self.fit_layout = make_layout(SPLINE, [made], [data.error_weights.shape[1]], [data.allowances])
        self.session = session_of(
            SPLINE,
            TAGS,
            FREE,
            length=0.15,
            mass=MASS,
            allowances=frozenset(ALLOWED),
        )
        self.session_layout = self.session.layout
        rng = np.random.default_rng(0)
        sizes = {"stiffness": 0.3, "curvature": 0.1, "mass": 0.1, "across": 1e-3, "turn": 0.02, "section": 0.3}
        sizes |= {"patches": 0.3, "clamp gives": 0.02, "relaxation": 0.0}  # the fit's shapes also know what was before
        self.values = {
            name: sizes.get(name, 5e-3) * rng.standard_normal(len(_block(self.session_layout, name).labels))
            for name in BLOCKS
        }
        self.values["stiffness"] += np.log(0.03)
        bases = {a.name: a.basis for a in data.allowances}
        self.terms = np.concatenate([bases[a.name].reshape(8, -1) for a in self.session.terms.allowances], axis=1)

    def at(self, where: Layout, **changed: Array) -> Array:
        """(n,) parameters of one of the layouts."""
        x = np.zeros(where.size)
        for name, value in (self.values | changed).items():
            x[_block(where, name).where] = value
        return x

    def fit(self, **changed: Array) -> Prediction:
        return predict(self.fit_data, self.fit_layout, self.at(self.fit_layout, **changed), None)

    def live(self, **changed: Array) -> Prediction:
        """From the fit's shapes at the point itself, with what it remembers there."""
        data, x = self.fit_data, self.at(self.session_layout, **changed)
        shapes = self.fit().solved.q
        bent = shapes - data.rest_on_nodes @ self.values["curvature"]
        lagging = np.moveaxis(lags(data.observations.time) @ bent, 0, -1)
        reached = np.array([reached_part(lagging[..., j], bent, data.problem.weights) for j in range(len(TIMES))])
        memory = MaterialMemory(lagging, np.zeros((8, len(TIMES))), reached)
        inputs = FrameInputs(data.force, data.rate, data.observations.gravity, np.zeros(8), self.terms, memory)
        return predict(frames_at(self.session, PUSH_S, inputs), self.session_layout, x, shapes)


def _block(where: Layout, name: str) -> Block:
    return where.index.get((name, -1)) or where.index[name, 0]


@pytest.fixture(scope="module")
def point() -> Iterator[Point]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(static_poses, "RESOLUTION", RESOLUTION)
        yield Point()


def test_the_grids_are_the_same(point: Point) -> None:
    np.testing.assert_allclose(
        point.fit_data.problem.grid.nodes, pushed_at(point.session, PUSH_S).problem.grid.nodes, atol=1e-14
    )


def test_fit_and_live_learner_have_the_same_jacobian(point: Point) -> None:
    fit, live = point.fit(), point.live()
    np.testing.assert_allclose(live.pose, fit.pose, atol=1e-12)
    for name in BLOCKS:
        ours = fit.slopes.written[..., _block(point.fit_layout, name).where]
        theirs = live.slopes.j[..., _block(point.session_layout, name).where]
        size = np.max(np.abs(ours), axis=(0, 1, 2))
        assert np.all(size > 0.0), name
        np.testing.assert_array_less(np.max(np.abs(theirs - ours), axis=(0, 1, 2)), 1e-8 * size, err_msg=name)
    by_force = fit.slopes.a @ fit.slopes.axes
    np.testing.assert_allclose(live.slopes.a @ live.slopes.axes, by_force, atol=1e-8 * np.max(np.abs(by_force)))


@pytest.mark.parametrize("name", BLOCKS)
def test_both_jacobians_are_those_of_central_differences(point: Point, name: str) -> None:
    fit = point.fit().slopes.written[..., _block(point.fit_layout, name).where]
    live = point.live().slopes.j[..., _block(point.session_layout, name).where]
    h = 1e-5
    for i, value in enumerate(np.eye(fit.shape[-1])):
        ends = [{name: point.values[name] + sign * h * value} for sign in (1.0, -1.0)]
        for model, column in ((point.fit, fit[..., i]), (point.live, live[..., i])):
            difference = (model(**ends[0]).pose - model(**ends[1]).pose) / (2.0 * h)
            np.testing.assert_allclose(column, difference, atol=3e-6 * max(1.0, float(np.max(np.abs(difference)))))
