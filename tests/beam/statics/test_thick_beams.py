"""Beams with a thickness: as users make them, in batches, and where they are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.continuation import equilibrium, follow, refine
from onebend.beam.dynamics import body
from onebend.beam.loads import push, twist
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem, make_problems
from onebend.beam.statics import Equilibrium
from onebend.beam.stiffness import Gaussians, RectangularSection, Steps, Uniform
from onebend.beam.vibration import vibration
from onebend.control.reach import reach
from onebend.control.shape import Pusher, resting_state
from onebend.errors import MechanicsError
from tests.beam.extensible import PointForce, shoot

THICK = Beam(0.15, Gaussians((0.0, 0.5, 1.0), 0.4, (0.01, 0.03, 0.02)), thickness=0.02)
FINE = Resolution(16, 0.25)
TIP = np.array([1.0])
S = np.array([0.3, 0.62, 1.0])


def test_refine_and_follow_agree_and_frames_do_not_disturb_each_other() -> None:
    force = np.random.default_rng(2).normal(size=(30, 2)) * [0.2, 0.5]
    solved = follow(make_problem(THICK, push(force, 0.9), FINE))
    again = refine(solved.problem, solved.q + 0.02)
    np.testing.assert_allclose(again.q, solved.q, atol=1e-9)
    alone = follow(make_problem(THICK, push(force[7], 0.9), FINE))
    np.testing.assert_allclose(solved.q[7], alone.q[0], atol=1e-11)


def test_places_of_their_own_in_every_frame() -> None:
    """Quadrature of each frame's own panels gives the same mean of k, and the same shapes."""
    force, at = np.tile([0.1, 0.5], (3, 1)), np.array([0.5, 0.75, 1.0])
    together = equilibrium(THICK, push(force, at), resolution=FINE)
    for i, place in enumerate(at):
        alone = equilibrium(THICK, push(force[i], float(place)), resolution=FINE)
        np.testing.assert_allclose(together.xy(S)[i], alone.xy(S)[0], atol=1e-8)


def test_beams_of_one_batch_have_their_own_thickness() -> None:
    beams = [replace(THICK, thickness=h) for h in (0.01, 0.03)]
    together = follow(make_problems(beams, push((0.1, 0.5)), FINE))
    part = together.problem.take(np.array([1]))
    assert part.section is not None
    assert np.shape(part.section.thickness) == (1, 1)
    for i, beam in enumerate(beams):
        np.testing.assert_allclose(
            together.xy(S)[i], equilibrium(beam, push((0.1, 0.5)), resolution=FINE).xy(S)[0], atol=1e-13
        )
    with pytest.raises(MechanicsError, match="solve them apart"):
        make_problems([replace(THICK, thickness=None), THICK], push((0.1, 0.5)))
    with pytest.raises(MechanicsError, match="Poisson's ratio"):
        make_problems([replace(THICK, poisson=0.3), THICK], push((0.1, 0.5)))


def test_a_beam_with_a_thickness_as_users_meet_it() -> None:
    """The paper's silicone: 12 x 30 mm, E 0.7 MPa, L 150 mm: EA 252 N, kGA 70 N."""
    k = 0.7e6 * 0.03 * 0.012**3 / 12.0 / 0.15
    beam = Beam(0.15, Uniform(k), thickness=0.012, poisson=0.5)
    tip, without = (
        beam.equilibrium((0.0, 0.005)).xy(1.0),
        replace(beam, thickness=None).equilibrium((0.0, 0.005)).xy(1.0),
    )
    assert tip[1] - without[1] == pytest.approx(0.005 * 0.15 / 70.0, rel=1e-2)
    assert beam.section is not None
    stretch, shear = beam.section.compliance(np.array([k]), np.ones(1), np.asarray(0.15))
    assert 1.0 / stretch[0] == pytest.approx(0.7e6 * 0.03 * 0.012, rel=1e-12)
    assert 1.0 / shear[0] == pytest.approx(70.0, rel=1e-12)
    assert Beam.from_dict(beam.as_dict()) == beam
    assert "thickness_m" not in replace(beam, thickness=None).as_dict()


@pytest.mark.parametrize(
    ("thickness", "poisson", "varies", "message"),
    [
        (-1e-3, 0.48, "width", "thickness must be positive"),
        (1e-3, 0.6, "width", "Poisson"),
        (1e-3, 0.48, "length", "'thickness' or 'width'"),
    ],
)
def test_what_no_section_has_is_refused(thickness: float, poisson: float, varies: str, message: str) -> None:
    with pytest.raises(MechanicsError, match=message):
        RectangularSection(thickness, poisson, varies)  # type: ignore[arg-type]


def test_compliance_from_two_sources_or_below_zero_is_refused() -> None:
    problem = make_problem(THICK, push((0.0, 0.1)))
    with pytest.raises(MechanicsError, match="not both"):
        follow(replace(problem, stretch=np.ones(16)))
    with pytest.raises(MechanicsError, match="0 or more"):
        follow(replace(problem, section=None, stretch=-np.ones(16)))


def test_thickness_of_steps_keeps_the_panels() -> None:
    beam = Beam(0.15, Steps((0.0, 0.37, 1.0), (0.03, 0.015)), thickness=0.02)
    found: Equilibrium = equilibrium(beam, push((0.05, 0.3)) + twist(0.002, 0.5))
    assert found.resolved[0]
    expected = shoot(beam, (PointForce(1.0, (0.05, 0.3)), PointForce(0.37, (0.0, 0.0))), (0.0, 0.0), TIP, 0.03)
    plain = equilibrium(beam, push((0.05, 0.3)))
    np.testing.assert_allclose(plain.xy(TIP)[0], expected[:, :2], atol=1e-8 * 0.15)


def test_who_does_not_know_stretch_and_shear_says_so() -> None:
    heavy = replace(THICK, mass_per_length=Uniform(0.1))
    thin = replace(heavy, thickness=None)
    for ask in (
        lambda: body(heavy),
        lambda: vibration(heavy, equilibrium(heavy, push((0.0, 0.0)))),
        lambda: reach(heavy, (0.1, 0.05)),
        lambda: resting_state(heavy, (Pusher(1.0),), None, None, FINE),
    ):
        with pytest.raises(MechanicsError, match="neither stretch nor shear"):
            ask()
    assert vibration(thin, equilibrium(thin, push((0.0, 0.0)))).frequency[0] > 0.0
