"""Place and direction of the push, as unknowns of the fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.forward import Film, film, jacobian, predict
from onebend.learning.parameters import Layout, Priors, layout
from onebend.learning.spline import Spline
from onebend.records import Array, Observations
from tests.learning.bench import MARKERS, SOFT, forces, observed

FREE = Priors(mounting=0.0, placement=0.0, clamp=0.0, origin=0.0)


def prepared(one: Observations, priors: Priors = FREE) -> tuple[Film, Layout, Array]:
    """A film, its parameters, and their values at the beam's own k."""
    spline = Spline(48)
    seen = film(one, 0, np.ones(len(one.time), dtype=bool), spline)
    at = layout(spline, [one], [len(seen.error.knots)], priors)
    s = np.linspace(0.0, 1.0, 400)
    x = np.zeros(at.size)
    x[: spline.count] = np.linalg.lstsq(spline.basis(s), np.log(SOFT.stiffness(s)), rcond=None)[0]
    return seen, at, x


def poses(one: Observations, force: Array, at_s: float) -> Array:
    shape = SOFT.equilibrium(force, at_s)
    return np.concatenate([shape.xy(MARKERS), shape.angle(MARKERS)[..., None]], axis=-1)


@pytest.mark.parametrize("at_s", [0.5, 0.8, 0.97])
def test_a_push_farther_out_is_a_push_at_another_place(at_s: float) -> None:
    force, out = forces(20), 1e-4
    one = observed(SOFT, force, at_s=at_s)
    seen, at, x = prepared(one)
    x[at.index["place", 0].where] = out
    moved = predict(seen, at, x, None).pose[: len(force)] - poses(one, force, at_s)
    exact = poses(one, force, at_s + out / SOFT.length) - poses(one, force, at_s)
    assert np.max(np.abs(exact[..., 2])) > 2e-4
    assert np.allclose(moved[..., 2], exact[..., 2], atol=0.01 * np.max(np.abs(exact[..., 2])))
    assert np.allclose(moved[..., :2], exact[..., :2], atol=0.01 * np.max(np.abs(exact[..., :2])))


def test_turned_axes_turn_the_logged_force() -> None:
    force, turn = forces(20), 0.03
    turned = force @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    seen, at, x = prepared(observed(SOFT, force))
    x[at.index["direction", 0].where] = turn
    np.testing.assert_allclose(predict(seen, at, x, None).force[: len(force)], turned, atol=1e-12)


@pytest.mark.parametrize("name", ["place", "direction", "force", "clock"])
def test_derivatives_are_those_of_the_prediction(name: str) -> None:
    one = replace(observed(SOFT, forces(12), at_s=0.9), time=np.arange(12) / 5.0)
    seen, at, x = prepared(one, replace(FREE, clock=0.01, placement=1e-3))
    x[at.index["place", 0].where], x[at.index["direction", 0].where] = 2e-3, 0.1
    x[at.index["along", -1].where] = -1e-3
    columns, where, h = at.columns(name, 0), at.index[name, 0].where, 1e-5
    assert columns is not None
    exact = jacobian(seen, at, x, predict(seen, at, x, None))[0][..., columns]
    for i in range(where.stop - where.start):
        step = np.zeros(at.size)
        step[where.start + i] = h
        far, near = (predict(seen, at, x + sign * step, None).pose for sign in (1.0, -1.0))
        change = (far - near) / (2.0 * h)
        np.testing.assert_allclose(exact[..., i], change, atol=1e-4 * np.max(np.abs(change)) + 1e-12)
