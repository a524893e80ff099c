"""The weight in the fit: gravity's direction within its tolerance, and what contradicts it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform
from onebend.learning.allowances import EVERY_ALLOWANCE
from onebend.learning.fit_data import FitData, fit_data
from onebend.learning.parameters import Layout, LearnedMass, Spline, make_layout
from onebend.learning.posterior import weight_doubts
from onebend.learning.prediction import predict
from onebend.records import Array, Observations, PointMass
from tests.learning.bench import MARKERS, SOFT, forces, observed
from tests.made_up import with_stated

MASS, LENGTH, MOST = 0.05, 0.15, 0.6  # kg, m, N: the weight is 0.8 of the largest force
LEANING: frozenset[str] = frozenset({"gravity direction"})


def pulls(count: int, off: float = 0.0) -> Array:
    """(count, 2) m/s^2, of a beam that hangs, its written direction `off` rad from the real one."""
    return np.tile(9.81 * np.array([np.cos(off), np.sin(off)]), (count, 1))


def heavy() -> Observations:
    """A heavy beam that hangs and is pushed."""
    beam = Beam(LENGTH, SOFT.stiffness, mass_per_length=Uniform(MASS / LENGTH))
    force = forces(40, most=MOST)
    shape = beam.equilibrium(force, gravity=pulls(40))
    made = observed(beam, force, xy=shape.xy(MARKERS), angle=shape.angle(MARKERS))
    unknown = np.full((3, 2), np.nan)
    made = replace(made, gravity=pulls(40), rest_xy=unknown, rest_angle=unknown[:, 0])
    return with_stated(made, mass=MASS)


def seen(o: Observations, allowances: frozenset[str] = EVERY_ALLOWANCE) -> FitData:
    return fit_data(o, 0, np.ones(len(o.time), dtype=bool), Spline(8), allowances)


def test_the_allowance_turns_all_of_the_weight() -> None:
    made = with_stated(heavy(), masses=(PointMass(0.55, 0.01),))
    [leaning] = [one for one in seen(made).allowances if one.name == "gravity direction"]
    h = 1e-4

    def weight(off: float) -> Array:
        one = seen(replace(made, gravity=pulls(40, off)), frozenset())
        assert one.mass is not None
        return one.weight + one.mass.force(one.problem, np.full(len(one.problem.grid.nodes), 0.03), np.zeros(4))

    turned = (weight(h) - weight(-h)) / (2.0 * h)
    np.testing.assert_allclose(leaning.basis[..., 0], turned, atol=1e-7)
    assert np.max(np.abs(turned)) > 0.9 * 9.81 * (MASS + 0.01)


def test_where_nothing_weighs_or_the_direction_is_exact_there_is_none() -> None:
    light, exact = observed(SOFT, forces(40)), with_stated(heavy(), gravity_sd=0.0)
    for made in (light, exact, replace(heavy(), static=True)):
        assert not [one for one in seen(made).allowances if one.name == "gravity direction"]


def test_its_derivative_is_the_change_of_the_tags_under_a_turned_gravity() -> None:
    def at(o: Observations) -> tuple[FitData, Layout, Array]:
        one, spline = seen(o, LEANING), Spline(8)
        layout = make_layout(spline, [o], [len(one.error.knots)], [one.allowances])
        return one, layout, np.concatenate([np.full(8, np.log(0.03)), np.zeros(layout.size - 8)])

    made, h = heavy(), 1e-3
    one, layout, x = at(made)
    slope = predict(one, layout, x, None).slopes.written[..., layout.columns("gravity direction", 0)][..., 0]
    ways = [predict(*at(replace(made, gravity=pulls(40, off))), None).pose for off in (h, -h)]
    np.testing.assert_allclose(slope, (ways[0] - ways[1]) / (2.0 * h), atol=1e-6)
    assert np.max(np.abs(slope[..., 1])) > 0.01


def test_a_weight_that_contradicts_what_is_written_is_a_doubt() -> None:
    mass = LearnedMass(value=MASS, sd=0.001, even=MASS, even_sd=0.001, written=MASS, identified=True)
    assert weight_doubts(None, []) == ()
    assert weight_doubts(mass, [0.5, -3.5]) == ()
    assert weight_doubts(replace(mass, even=0.5 * MASS), []) == ()  # a cone
    assert weight_doubts(replace(mass, even=MASS / 9.81, written=np.nan), []) == ()  # nothing was written
    [kilograms] = weight_doubts(replace(mass, even=MASS / 9.81), [])
    assert "contradict" in kilograms
    [leaning] = weight_doubts(mass, [0.5, -4.5])
    assert "gravity does not pull where" in leaning
