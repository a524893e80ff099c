"""The rod that is followed in time: against the statics of the package, closed forms, and itself at finer steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Steps, Uniform
from onebend.errors import MechanicsError
from onebend.lab.bench import PushProfile, RealBench
from onebend.lab.designs import force_that_bends, random_stiffness
from onebend.lab.rod import RodMotion, RodTask, march
from onebend.records import Array

L, K = 0.15, 0.02
TAGS = np.array([1.0 / 3.0, 2.0 / 3.0, 1.0])
EVEN = Beam(L, Uniform(K), mass_per_length=Uniform(0.1))
HELD = PushProfile(0.02, direction=0.5 * np.pi, turn=0.0, before=0.1, rise=0.4, hold=6.0, fall=0.4, after=0.2)


def followed(beam: Beam = EVEN, pushing: PushProfile = HELD, **effects: object) -> RodMotion:
    real = RealBench(**effects)  # type: ignore[arg-type]
    return march(RodTask(beam, real, TAGS, pushing.force, pushing.at_s, pushing.duration))


def holding(motion: RodMotion, at: float) -> Array:
    """(3,) tip's pose `at` [s]."""
    return np.asarray(motion.poses(np.array([at]), np.array([1.0]))[0, 0])


@pytest.mark.parametrize("kind", ["smooth", "stepped", "joint"])
def test_an_ideal_beam_lies_as_statics_have_it(kind: str) -> None:
    beam = Beam(L, random_stiffness(kind, np.random.default_rng(3)), rest_curvature=Powers((0.1, -0.2)))  # type: ignore[arg-type]
    pushing = PushProfile(force_that_bends(beam, 1.0, 1.75), at_s=0.83)
    motion = followed(beam, pushing)
    time = np.linspace(0.0, pushing.duration - 0.1, 40)
    exact = beam.equilibrium(pushing.force(time), 0.83)
    poses = motion.poses(time, TAGS)
    np.testing.assert_allclose(poses[..., :2], exact.xy(TAGS), atol=2e-7)
    np.testing.assert_allclose(poses[..., 2], exact.angle(TAGS), atol=3e-6)
    assert motion.secant == 1.0


def test_its_weight_bends_it_as_statics_have_it() -> None:
    task = RodTask(EVEN, RealBench(), TAGS, HELD.force, 1.0, 1.0, (0.0, -9.81))
    loads = push(np.zeros((1, 2)), 1.0) + weight(np.array([[0.0, -9.81]]))
    np.testing.assert_allclose(
        march(task).poses(np.zeros(1), TAGS)[..., :2], equilibrium(EVEN, loads).xy(TAGS), atol=1e-7
    )


def test_stretch_is_hookes_and_shear_is_timoshenkos() -> None:
    thickness, nu = 0.012, 0.3
    stretch = 12.0 * K * L / thickness**2
    shear = 5.0 / 6.0 * stretch / (2.0 * (1.0 + nu))
    force = replace(HELD, peak=1e-3)
    across = holding(followed(EVEN, force, thickness=thickness, poisson=nu), 3.0)
    assert across[1] == pytest.approx(1e-3 * (L**2 / (3.0 * K) + L / shear), rel=1e-5)
    along = holding(followed(EVEN, replace(HELD, direction=0.0, peak=0.5), thickness=thickness), 3.0)
    assert along[0] == pytest.approx(L * (1.0 + 0.5 / stretch), rel=1e-9)


def test_thickness_follows_the_cube_root_of_k() -> None:
    beam = Beam(L, Steps((0.0, 0.5, 1.0), (8 * K, K)))
    mean, pull = 4.5 * K, 0.2
    motion = followed(beam, replace(HELD, direction=0.0, peak=pull), thickness=0.01)
    at = motion.poses(np.array([3.0]), np.array([0.5, 1.0]))[0, :, 0]
    strain = pull * 1e-4 * np.cbrt([8 * K / mean, K / mean]) ** 2 / (12.0 * L * np.array([8 * K, K]))
    np.testing.assert_allclose(np.diff(at, prepend=0.0) / (0.5 * L) - 1.0, strain, rtol=5e-3)


@pytest.mark.slow
def test_under_a_held_push_the_beam_creeps_as_a_standard_linear_solid() -> None:
    share, tau = 0.1, 1.2
    sudden = replace(HELD, rise=0.01, hold=4.0, before=0.1, peak=1e-3)
    task = RodTask(EVEN, RealBench(relaxation=share, relaxation_time=tau), TAGS, sudden.force, 1.0, 4.0)
    motion = march(task, 1e-3)
    since = np.array([0.05, 0.5, 1.0, 2.0, 3.5])
    size = motion.poses(0.105 + since, np.array([1.0]))[:, 0, 2]
    elastic = 1e-3 * L / (2.0 * K)
    late = share / (1.0 - share) * (1.0 - np.exp(-(1.0 - share) * since / tau))  # creep at constant moment
    np.testing.assert_allclose(size, elastic * (1.0 + late), rtol=5e-4)


@pytest.mark.slow
def test_force_of_a_held_shape_relaxes_by_its_share() -> None:
    share, tau = 0.12, 0.8
    time: Array = 2e-3 * np.arange(2001.0)
    modulus = 1.0 - share * (1.0 - np.exp(-time / tau))

    def force(at: Array) -> Array:  # what holds a small bend: 1 - a (1 - exp(-t/tau)) of the first
        return np.stack([np.zeros(len(at)), 1e-3 * np.interp(at, time, modulus)], axis=1)

    effects = RealBench(relaxation=share, relaxation_time=tau)
    from_rest = RodTask(EVEN, effects, TAGS, lambda at: force(at) * (at > 0.0)[:, None], 1.0, 4.0)
    tip = march(from_rest, 2e-3).poses(time[5:], np.array([1.0]))[:, 0, 1]
    np.testing.assert_allclose(tip, tip[0], rtol=3e-4)
    np.testing.assert_allclose(tip, 1e-3 * L**2 / (3.0 * K), rtol=3e-4)


def test_the_secant_modulus_lies_between_the_ends_of_relaxation() -> None:
    quick, slow = (followed(relaxation=0.1, relaxation_time=tau).secant for tau in (0.01, 1e4))
    assert quick == pytest.approx(0.9, abs=1e-3)
    assert slow == pytest.approx(1.0, abs=1e-3)


def test_contact_slides_with_the_turn_and_begins_where_it_is_off() -> None:
    pushing = replace(HELD, peak=0.2, at_s=0.8)
    motion = followed(EVEN, pushing, slide=0.003, push_off=-0.0015)
    assert motion.contact[0] == pytest.approx(0.79)
    turn = motion.poses(motion.time, np.array([0.79]))[:, 0, 2]
    np.testing.assert_allclose(motion.contact, 0.79 + 0.02 * turn, atol=1e-6)
    assert np.ptp(turn) > 0.3
    there = [np.interp(motion.contact[200], motion.s, motion.pose[200, :, i]) for i in range(2)]
    np.testing.assert_allclose(motion.tool[200], there, atol=1e-9)
    moved = EVEN.equilibrium(pushing.force(motion.time[200:201]), motion.contact[200])
    np.testing.assert_allclose(motion.poses(motion.time[200:201], TAGS)[..., :2], moved.xy(TAGS), atol=5e-7)


def test_patches_stiffen_the_beam_under_the_tags() -> None:
    motion = followed(patch_factor=3.0, patch_length=0.015)
    stiff = Beam(L, Steps((0.0, 17 / 60, 23 / 60, 37 / 60, 43 / 60, 57 / 60, 1.0), (K, 3 * K, K, 3 * K, K, 3 * K)))
    exact = stiff.equilibrium(HELD.force(np.array([3.0])))
    np.testing.assert_allclose(motion.poses(np.array([3.0]), TAGS)[..., :2], exact.xy(TAGS), atol=2e-7)


def test_a_clamp_gives_by_its_compliance() -> None:
    soft = followed(clamp_compliance=0.5).poses(np.array([3.0]), np.array([0.0, 1.0]))[0]
    assert soft[0, 2] == pytest.approx(0.5 * HELD.peak * soft[1, 0], rel=1e-6)


def test_curvature_at_rest_adds_to_the_beams_own() -> None:
    curved = replace(EVEN, rest_curvature=Powers((0.1, 0.3)))
    np.testing.assert_allclose(followed(rest_turn=(0.1, 0.3)).pose, followed(curved).pose, atol=1e-12)
    with pytest.raises(AssertionError):
        np.testing.assert_allclose(followed().pose, followed(curved).pose, atol=1e-3)


@pytest.mark.slow
def test_inertia_holds_a_quick_push_back() -> None:
    """A tip push bends a cantilever as if 33/140 of its mass sat at the tip (Rayleigh)."""
    quick = replace(HELD, rise=0.5, hold=0.3, fall=0.5, peak=1e-3)
    effects = RealBench(inertia=True)
    task = RodTask(EVEN, effects, TAGS, quick.force, 1.0, quick.duration)
    time, tip = np.linspace(0.15, 0.55, 9), np.array([1.0])
    with_it = march(task, 1e-3).poses(time, tip)[:, 0, 1]
    plain = march(replace(task, effects=RealBench()), 1e-3)
    step = 0.01
    curve = (plain.poses(time + step, TAGS) - 2 * plain.poses(time, TAGS) + plain.poses(time - step, TAGS)) / step**2
    # static shape of a tip force y = y1 (3 s^2 - s^3) / 2; a load m y'' so shaped turns the tip by 33/140 m y1''
    held = -33.0 / 140.0 * 0.1 * L * curve[:, 2, 1] * L**2 / (3.0 * K)
    np.testing.assert_allclose(with_it - plain.poses(time, tip)[:, 0, 1], held, atol=0.05 * np.max(np.abs(held)))
    with pytest.raises(MechanicsError, match="without mass"):
        march(replace(task, beam=Beam(L, Uniform(K))))


def test_a_beam_that_snaps_through_is_refused() -> None:
    pushed = PushProfile(60.0 * K / L, direction=np.pi - 0.02, turn=0.0)
    with pytest.raises(MechanicsError, match="snaps through"):
        followed(EVEN, pushed)
