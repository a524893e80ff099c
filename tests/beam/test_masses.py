"""Masses that ride on a beam: statics, vibrations, motion and files, against point forces and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from onebend.beam.continuation import follow
from onebend.beam.dynamics import body
from onebend.beam.grid import Modes
from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.problem import make_problem, make_problems
from onebend.beam.stiffness import Steps, Uniform
from onebend.beam.vibration import vibration
from onebend.errors import ExportError, MechanicsError
from onebend.export.chain import chain_of
from onebend.export.export import Kind, export
from onebend.export.sample import rod_sample
from onebend.records import Array, PointMass
from tests.beam.moving import gravity_vector, kinetic_energy, weight_energy

BEAM = Beam(0.3, Steps((0.0, 0.5, 1.0), (0.05, 0.02)), Uniform(0.4), 0.2, Uniform(0.05))
CLIPS = (PointMass(0.37, 0.004), PointMass(1.0, 0.002))
LADEN = replace(BEAM, masses=CLIPS)
GRAVITY = np.array([1.0, -9.7])
S = np.linspace(0.05, 1.0, 9)


def test_its_weight_is_a_force_where_it_rides() -> None:
    by_hand = weight(GRAVITY) + push(CLIPS[0].mass * GRAVITY, 0.37) + push(CLIPS[1].mass * GRAVITY, 1.0)
    laden = follow(make_problem(LADEN, weight(GRAVITY)))
    np.testing.assert_allclose(laden.xy(S), follow(make_problem(BEAM, by_hand)).xy(S), atol=1e-10)
    np.testing.assert_allclose(LADEN.equilibrium((0.0, 0.0), gravity=GRAVITY).xy(S), laden.xy(S)[0], atol=1e-9)
    both = follow(make_problems([BEAM, LADEN], weight(np.tile(GRAVITY, (2, 1)))))
    np.testing.assert_allclose(both.xy(S)[1], laden.xy(S)[0], atol=1e-10)
    np.testing.assert_allclose(both.xy(S)[0], follow(make_problem(BEAM, weight(GRAVITY))).xy(S)[0], atol=1e-10)


def test_public_call_agrees_with_an_initial_value_solver() -> None:
    """`alpha' = q0 + M / k` and `M' = -L (cos alpha Fy - sin alpha Fx)`, piece by piece between the masses."""
    force = np.array([0.1, 0.2])

    def shot(base_moment: float) -> Array:
        state = np.array([LADEN.clamp_angle, base_moment, 0.0, 0.0])
        for piece in ((0.0, 0.37), (0.37, 0.5), (0.5, 1.0)):
            k, riding = 0.05 if piece[0] < 0.5 else 0.02, sum(one.mass for one in CLIPS if one.s > piece[0])

            def slopes(s: float, y: Array, k: float = k, riding: float = riding) -> list[float]:
                fx, fy = force + (0.05 * LADEN.length * (1.0 - s) + riding) * GRAVITY
                cos, sin = np.cos(y[0]), np.sin(y[0])
                return [0.4 + y[1] / k, -LADEN.length * (cos * fy - sin * fx), LADEN.length * cos, LADEN.length * sin]

            state = solve_ivp(slopes, piece, state, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        return state

    base_moment = brentq(lambda m: shot(m)[1], -0.1, 0.1, xtol=1e-15)
    assert shot(base_moment - 1e-3)[1] < 0.0 < shot(base_moment + 1e-3)[1]  # there is no other near it
    found = LADEN.equilibrium(force, gravity=GRAVITY)
    assert np.max(np.abs(found.xy(1.0) - shot(base_moment)[2:])) < 1e-8 * LADEN.length
    assert float(found.angle(1.0)) == pytest.approx(shot(base_moment)[0], abs=1e-8)


@pytest.mark.parametrize("ratio", [0.3, 2.0])
def test_frequencies_with_a_mass_at_the_tip(ratio: float) -> None:
    """1 + cos cosh + r b (cos sinh - sin cosh) = 0 for a tip mass of r times the beam's own (Laura et al. 1974)."""

    def left(b: float) -> float:
        coupled = np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b)
        return float(1.0 + np.cos(b) * np.cosh(b) + ratio * b * coupled)

    roots = [brentq(left, *ends) for ends in ((0.3, 1.875), (2.5, 4.69), (5.5, 7.85))]
    beam = Beam(1.0, Uniform(1.0), mass_per_length=Uniform(1.0), masses=(PointMass(1.0, ratio),))
    found = vibration(beam, follow(make_problem(beam, push((0.0, 0.0)))), count=3).frequency
    np.testing.assert_allclose(2.0 * np.pi * found, np.square(roots), rtol=1e-7)


def test_its_motion_and_weight_in_any_shape() -> None:
    """Kinetic energy and potential beside those of the beam alone: m v^2 / 2 and -m g r where it rides."""
    rng, modes = np.random.default_rng(0), Modes(4)
    theta, rate = rng.normal(size=4), rng.normal(size=4)
    alone, laden = (body(beam, modes, grid=body(LADEN, modes).grid) for beam in (BEAM, LADEN))
    places, step = np.array([0.37, 1.0]), 1e-6
    ahead, behind = (alone.xy(places, theta[None] + way * rate)[0] for way in (step, -step))
    masses, speed = np.array([one.mass for one in CLIPS]), (ahead - behind) / (2.0 * step)
    added = kinetic_energy(laden, theta, rate) - kinetic_energy(alone, theta, rate)
    assert added == pytest.approx(0.5 * np.sum(masses[:, None] * speed**2), rel=1e-7)
    potential = weight_energy(laden, theta, GRAVITY) - weight_energy(alone, theta, GRAVITY)
    where = alone.xy(places, theta[None])[0]
    assert potential == pytest.approx(-np.sum(masses * (where @ GRAVITY)), rel=1e-9)
    slope = [
        (weight_energy(laden, theta + way, GRAVITY) - weight_energy(laden, theta - way, GRAVITY)) / (2.0 * step)
        for way in step * np.eye(4)
    ]
    np.testing.assert_allclose(gravity_vector(laden, theta, GRAVITY), slope, rtol=1e-6, atol=1e-10)


def test_it_is_written_down_with_the_beam() -> None:
    assert Beam.from_dict(LADEN.as_dict()) == LADEN
    assert "masses" not in BEAM.as_dict()
    with pytest.raises(MechanicsError, match="rides at s in"):
        replace(BEAM, masses=(PointMass(1.2, 0.1),))


def test_a_chain_carries_it_and_other_exports_refuse_it() -> None:
    """Mass, and first and second moment about the clamp of the straight chain."""
    plain, laden = chain_of(rod_sample(BEAM), 5), chain_of(rod_sample(LADEN), 5)
    begins = np.concatenate([[0.0], np.cumsum(plain.link_length)[:-1]])
    moments: list[Array] = []
    for chain in (plain, laden):
        arm = begins + chain.link_centre
        second = np.sum(chain.link_inertia + chain.link_mass * arm**2)
        moments.append(np.array([np.sum(chain.link_mass), np.sum(chain.link_mass * arm), second]))
    lever = np.array([one.s for one in CLIPS]) * BEAM.length
    added = [np.sum(lever**i * [one.mass for one in CLIPS]) for i in range(3)]
    np.testing.assert_allclose(moments[1] - moments[0], added, rtol=1e-12)
    kinds: tuple[Kind, ...] = ("python", "pyelastica")
    for kind in kinds:
        with pytest.raises(ExportError, match="2 masses ride on this beam"):
            export(LADEN, kind)
