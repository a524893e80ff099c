"""Frequencies against closed forms and published numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from onebend.beam.continuation import equilibrium, follow
from onebend.beam.dynamics import Actions, AppliedForce, body, mass_matrix
from onebend.beam.grid import Modes
from onebend.beam.integration import MotionState
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.section import rectangular_bar
from onebend.beam.stiffness import Powers, Profile, Uniform
from onebend.beam.vibration import settle, vibration, vibration_of
from onebend.errors import MechanicsError
from tests.beam.moving import ODD, odd_body

UNIT = Beam(1.0, Uniform(1.0), mass_per_length=Uniform(1.0))
UNLOADED = push((0.0, 0.0))


def bar(last: float) -> tuple[Beam, Profile]:
    """A square steel bar of 1 m whose side runs from 10 mm to `last`, and its rotary inertia."""
    side = Powers((0.01, last - 0.01))
    profiles = rectangular_bar(side, side, length=1.0, modulus=210e9, density=7850.0)
    return Beam(1.0, profiles.stiffness, mass_per_length=profiles.mass_per_length), profiles.rotary_inertia


@pytest.mark.parametrize(
    ("last", "published"),
    [
        (0.010, (8.3552, 52.361, 146.61, 287.30, 474.93, 709.47)),
        (0.005, (10.988, 46.438, 115.40, 218.11, 354.89, 525.78)),
    ],
)
def test_steel_bars(last: float, published: tuple[float, ...]) -> None:
    """Source of the numbers: the tests of the VirtualBow project."""
    beam, _ = bar(last)
    found = vibration(beam, equilibrium(beam, UNLOADED)).frequency
    np.testing.assert_allclose(found, published, rtol=1e-3)


def test_uniform_cantilever_has_the_roots_of_its_frequency_equation() -> None:
    """cosh(b) cos(b) = -1, omega = b^2 sqrt(EI / (mu L^4)); the error falls spectrally with the nodes."""
    roots = [brentq(lambda b: np.cos(b) + 1.0 / np.cosh(b), np.pi * (i + 0.1), np.pi * (i + 0.9)) for i in range(6)]
    exact = np.square(roots) / (2.0 * np.pi)
    errors = []
    for order in (8, 12, 16):
        solved = follow(make_problem(UNIT, UNLOADED, Resolution(order)))
        errors.append(np.max(np.abs(vibration(UNIT, solved, count=4).frequency / exact[:4] - 1.0)))
    assert np.all(np.diff(np.log(errors)) < -4.0)
    assert errors[-1] < 1e-11


def test_rotary_inertia_lowers_the_frequencies_as_rayleigh_says() -> None:
    """To first order omega loses the share `int iota w'^2 / (2 int mu w^2)`, w the mode of the thin beam."""
    beam, rotary = bar(0.010)
    solved = equilibrium(beam, UNLOADED)
    thin, thick = vibration(beam, solved), vibration(beam, solved, rotary_inertia=rotary)
    turn = thin.body.to_angle @ thin.shapes  # shapes carry unit mass, so the share's denominator is 2
    share = 0.5 * np.einsum("q,qm->m", thin.body.grid.weights * rotary(thin.body.grid.nodes), turn**2)
    np.testing.assert_allclose(1.0 - thick.frequency / thin.frequency, share, rtol=5e-3)
    assert share[0] < 3e-5 < 5e-4 < share[3]


@pytest.mark.parametrize(("load", "shear"), [(-2.0, 0.0), (1.0, 3.0)])
def test_modes_approach_the_exact_frequencies_about_a_bent_shape(load: float, shear: float) -> None:
    exact = vibration(UNIT, equilibrium(UNIT, push((load, shear)))).frequency[:3]
    errors = []
    for n in (4, 6, 8, 10):
        of, actions = body(UNIT, Modes(n)), Actions((AppliedForce((load, shear)),))
        errors.append(np.max(np.abs(vibration_of(of, settle(of, actions), actions, count=3).frequency / exact - 1.0)))
    assert np.all(np.diff(np.log(errors)) < -1.5)
    assert errors[-1] < 1e-5


def test_the_slowest_frequency_vanishes_at_the_euler_load_and_turns_imaginary_beyond() -> None:
    euler = np.pi**2 / 4.0
    at = vibration(UNIT, equilibrium(UNIT, push((-euler, 0.0))))
    assert abs(at.squared[0]) < 1e-6
    beyond = vibration(UNIT, equilibrium(UNIT, push((-1.2 * euler, 0.0))))
    assert beyond.squared[0] < 0.0
    assert np.isnan(beyond.frequency[0])
    assert np.all(beyond.frequency[1:] > 0.0)
    # Far from it, the square of the frequency falls almost linearly with the load.
    half = vibration(UNIT, equilibrium(UNIT, push((-0.5 * euler, 0.0))))
    free = vibration(UNIT, equilibrium(UNIT, UNLOADED))
    assert half.squared[0] / free.squared[0] == pytest.approx(0.5, abs=0.025)


def test_shapes_carry_unit_mass_and_move_the_places_as_they_say() -> None:
    of = odd_body(6)
    actions = Actions((AppliedForce((0.05, 0.1)),))
    rest = settle(of, actions)
    found = vibration_of(of, rest, actions)
    np.testing.assert_allclose(found.shapes.T @ mass_matrix(of, rest.theta) @ found.shapes, np.eye(6), atol=1e-9)
    s, h = np.array([0.4, 1.0]), 1e-5
    for i in range(6):
        step = h * found.shapes[:, i] / np.linalg.norm(found.shapes[:, i])
        moved = of.xy(s, (rest.theta + step)[None])[0] - of.xy(s, (rest.theta - step)[None])[0]
        expected = found.moved(s)[i] / np.linalg.norm(found.shapes[:, i])
        np.testing.assert_allclose(moved / (2.0 * h), expected, atol=1e-9)


def test_one_frame_of_a_batch() -> None:
    loads = push(np.array([[0.0, 0.05], [0.02, 0.1]]), np.array([1.0, 0.7]))
    beam = replace(ODD)
    both = equilibrium(beam, loads)
    alone = equilibrium(beam, push((0.02, 0.1), 0.7))
    np.testing.assert_allclose(vibration(beam, both, frame=1).frequency, vibration(beam, alone).frequency, rtol=1e-6)


def test_a_state_that_is_no_equilibrium_is_refused() -> None:
    of = odd_body()
    with pytest.raises(MechanicsError, match="left unbalanced"):
        vibration_of(of, MotionState(np.array([0.1, 0.0, 0.0, 0.0]), np.zeros(4)))
    with pytest.raises(MechanicsError, match="not one of this beam"):
        vibration(ODD, equilibrium(UNIT, UNLOADED))
    with pytest.raises(MechanicsError, match="mass per metre = 0"):
        vibration(Beam(1.0, Uniform(1.0)), equilibrium(UNIT, UNLOADED))
