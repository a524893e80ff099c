"""What one push tells: against dense algebra on differences, against the scatter of repeated fits, and by symmetry."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from onebend.beam.continuation import follow
from onebend.beam.loads import push as load, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.stiffness import LogSpline, Powers, Uniform
from onebend.errors import LearningError, MechanicsError
from onebend.learning.design import STEPS, force_covariance, information, with_better_sensor
from onebend.learning.instruments import ForceDoubt, Instruments, PlannedPush
from onebend.learning.parameters import Spline
from onebend.records import Array

SPLINE = Spline(5)
TRUE = np.log([0.02, 0.03, 0.02, 0.016, 0.02])
MASS = 0.06  # kg
TAGS = (1 / 3, 2 / 3, 1.0)
TIP = PlannedPush(1.0, 2.0, 0.3)


def bench(**changes: object) -> Instruments:
    """Typical tags, camera and sensor; nothing is known from earlier pushes."""
    made = Instruments(
        length=0.15,
        tags=TAGS,
        tag_sd=np.array([[3e-5, 5e-5, 1e-3], [3e-5, 6e-5, 1e-3], [4e-5, 8e-5, 2e-3]]),
        frames=400,
        seconds=10.0,
        rest_before=3.0,
        rest_after=2.0,
        placement_sd=5e-4,
        turn_sd=0.02,
        curvature_sd=0.1,
        mass_sd=0.0,
        mass_spread_sd=0.0,
        clamp_sd=3e-3,
        origin_sd=4e-4,
        scale_sd=3e-3,
        clock_sd=0.03,
        force=ForceDoubt(level=0.02, coloured=0.006, tau=0.3, cutoff=2.0, walk=0.003, frame=0.002),
        gain_sd=0.0,
        gravity=(0.0, 0.0),
        curvature=3.0,
        pushes=(),
        shared=("curvature", "along", "across", "turn"),
        shared_slope=np.zeros((12, 5)),
        shared_covariance=np.eye(12),
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def beam(coefficients: Array = TRUE) -> Beam:
    stiffness = LogSpline(tuple(SPLINE.knots.tolist()), tuple(coefficients.tolist()))
    return Beam(0.15, stiffness, mass_per_length=Uniform(MASS / 0.15))


@dataclass(frozen=True)
class Wrong:
    """A draw, or a difference step, of everything that a fit must find or live with."""

    coefficients: Array  # (5,)
    curvature: Array  # (3,) Legendre states
    mass: Array  # (4,) Legendre parts, in units of the mass
    along: Array  # (3,)
    across: Array  # (3,)
    turn: Array  # (3,)
    clamp: Array  # (1,)
    origin: Array  # (2,)
    scale: Array  # (1,)
    place: Array  # (1,)
    axes: Array  # (1,)
    force: Array  # (STEPS, 2)

    @staticmethod
    def of(vector: Array) -> Wrong:
        sizes = [5, 3, 4, 3, 3, 3, 1, 2, 1, 1, 1]
        parts = np.split(vector, np.cumsum(sizes))
        k, q0, mass, along, across, turn, clamp, origin, scale, place, axes, force = parts
        steps = force.reshape(STEPS, 2)
        return Wrong(k, q0, mass, along, across, turn, clamp, origin, scale, place, axes, steps)


SIZE = 27 + 2 * STEPS


def powers(states: Array) -> Powers:
    """Legendre polynomials on [0, 1] as powers of s."""
    series = np.polynomial.Legendre(states, domain=[0.0, 1.0])
    return Powers(tuple(series.convert(kind=np.polynomial.Polynomial, domain=[-1.0, 1.0]).coef.tolist()))


def filmed(push: PlannedPush, vector: Array, gravity: tuple[float, float] = (0.0, 0.0)) -> Array:
    """(STEPS + 1, 3, 3) poses of the tags, by the mechanics alone; at rest last."""
    wrong = Wrong.of(vector)
    bent = replace(
        beam(TRUE + wrong.coefficients),
        rest_curvature=powers(wrong.curvature),
        clamp_angle=float(wrong.clamp[0]),
        mass_per_length=powers(MASS / 0.15 * (np.eye(4)[0] + wrong.mass)),
    )
    size = push.largest * (np.arange(STEPS) + 0.5) / STEPS
    unit = np.array([np.cos(push.direction), np.sin(push.direction)])
    turned = np.array([[np.cos(wrong.axes[0]), -np.sin(wrong.axes[0])], [np.sin(wrong.axes[0]), np.cos(wrong.axes[0])]])
    force = np.vstack([size[:, None] * unit @ turned.T + wrong.force, np.zeros(2)])
    loads = load(force, push.at_s) + weight(gravity)
    if wrong.place[0] != 0.0:  # a force farther out, also where there is no beam: the same with its moment
        here = follow(make_problem(bent, loads, Resolution(16, 0.5))).angle(np.array([push.at_s]))[:, 0]
        loads = loads + twist(wrong.place[0] * (np.cos(here) * force[:, 1] - np.sin(here) * force[:, 0]), push.at_s)
    shape = follow(make_problem(bent, loads, Resolution(16, 0.5)))
    places = np.asarray(TAGS) + wrong.along / 0.15
    s = np.minimum(places, 1.0)
    angle, over = shape.angle(s), 0.15 * (places - s)
    x = shape.xy(s)[..., 0] + np.cos(angle) * over - np.sin(angle) * wrong.across
    y = shape.xy(s)[..., 1] + np.sin(angle) * over + np.cos(angle) * wrong.across
    xy = (1.0 + wrong.scale) * np.stack([x, y], axis=-1) + wrong.origin
    return np.concatenate([xy, (angle + wrong.turn)[..., None]], axis=-1)


def prior_covariance(known: Instruments, push: PlannedPush) -> Array:
    """(SIZE - 5, SIZE - 5) of everything but the coefficients."""
    one = (
        [known.curvature_sd] * 3
        + [known.mass_sd]
        + [known.mass_spread_sd] * 3
        + [known.placement_sd] * 6
        + [known.turn_sd] * 3
    )
    one += [known.clamp_sd] + [known.origin_sd] * 2 + [known.scale_sd, known.place_sd, known.direction_sd]
    out = np.zeros((SIZE - 5, SIZE - 5))
    out[:22, :22] = np.diag(np.square(one))
    out[22:, 22:] = force_covariance(known, push)
    return out


def dense(known: Instruments, push: PlannedPush) -> tuple[Array, Array]:
    """Jacobian (rows, 5) by differences and the full covariance (rows, rows) of all poses."""
    h = 1e-5
    steps = h * np.eye(SIZE)
    j = np.stack(
        [(filmed(push, +d, known.gravity) - filmed(push, -d, known.gravity)).ravel() / (2.0 * h) for d in steps], axis=1
    )
    counts = np.append(np.full(STEPS, known.frames / STEPS), 1.0)
    noise = (known.tag_sd**2 / counts[:, None, None]).ravel()
    nuisance = j[:, 5:]
    return j[:, :5], np.diag(noise) + nuisance @ prior_covariance(known, push) @ nuisance.T


@pytest.mark.slow
@pytest.mark.parametrize("push", [TIP, PlannedPush(0.6, -1.3, 0.5)])
def test_information_is_that_of_dense_algebra_on_differences(push: PlannedPush) -> None:
    j, covariance = dense(bench(), push)
    expected = j.T @ np.linalg.solve(covariance, j)
    np.testing.assert_allclose(information(beam(), bench(), push), expected, rtol=2e-5, atol=2e-5 * np.max(expected))


def test_information_under_gravity_is_that_of_dense_algebra_too() -> None:
    names = ("curvature", "mass", "along", "across", "turn")
    changes = {"shared_slope": np.zeros((16, 5)), "shared_covariance": np.eye(16)}
    known = bench(gravity=(-2.0, -6.0), mass_sd=0.05, mass_spread_sd=0.3, shared=names, **changes)
    j, covariance = dense(known, TIP)
    expected = j.T @ np.linalg.solve(covariance, j)
    np.testing.assert_allclose(information(beam(), known, TIP), expected, rtol=2e-5, atol=2e-5 * np.max(expected))


@pytest.mark.slow
def test_scatter_of_repeated_fits_is_what_information_says() -> None:
    """300 films with everything wrong drawn anew, each fitted by weighted least squares through the exact beam.

    All errors are a fifth of the usual, where the scatter is linear in them; at their usual size it is 7 % wider.
    """
    usual = bench(placement_sd=1e-4, turn_sd=3e-3, curvature_sd=0.02)
    own = ("tag_sd", "placement_sd", "turn_sd", "curvature_sd", "clamp_sd", "origin_sd", "scale_sd", "clock_sd")
    names = (*own, "place_sd", "direction_sd")
    known = replace(usual, force=usual.force.times(0.2), **{name: 0.2 * getattr(usual, name) for name in names})
    push = TIP
    j, covariance = dense(known, push)
    told = information(beam(), known, push)
    gain = np.linalg.solve(told, np.linalg.solve(covariance, j).T)
    counts = np.append(np.full(STEPS, known.frames / STEPS), 1.0)
    sd = known.tag_sd / np.sqrt(counts[:, None, None])
    root = np.linalg.cholesky(prior_covariance(known, push) + 1e-17 * np.eye(SIZE - 5))
    rng = np.random.default_rng(5)
    found = []
    for _ in range(300):
        wrong = np.concatenate([np.zeros(5), root @ rng.normal(size=SIZE - 5)])
        seen = filmed(push, wrong) + sd * rng.normal(size=sd.shape)
        guess = np.zeros(SIZE)
        for _ in range(6):
            guess[:5] += gain @ (seen - filmed(push, guess)).ravel()
        found.append(guess[:5].copy())
    whitened = np.cov(np.array(found).T) @ told
    values = np.linalg.eigvals(whitened).real
    assert np.mean(values) == pytest.approx(1.0, abs=0.1)
    assert np.min(values) > 0.7
    assert np.max(values) < 1.45


def test_a_straight_beam_has_two_equal_sides() -> None:
    up, down = (information(beam(), bench(), PlannedPush(0.8, d, 0.4)) for d in (1.2, -1.2))
    np.testing.assert_allclose(up, down, rtol=1e-8, atol=1e-8 * np.max(up))


def test_a_stiffer_beam_pushed_harder_is_the_same_to_a_sensor_as_much_coarser() -> None:
    coarse = bench().force.times(2.0)
    soft = information(beam(), bench(), TIP)
    hard = information(beam(TRUE + np.log(2.0)), bench(force=coarse), replace(TIP, largest=2.0 * TIP.largest))
    np.testing.assert_allclose(soft, hard, rtol=1e-8, atol=1e-8 * np.max(soft))


@pytest.mark.parametrize(
    "better",
    [
        {"frames": 800},
        {"rest_after": 6.0},
        {"clock_sd": 0.0},
        {"placement_sd": 1e-4},
        {"clamp_sd": 0.0},
        {"origin_sd": 0.0},
        {"scale_sd": 0.0},
        {"turn_sd": 1e-3},
        {"curvature_sd": 1e-3},
    ],
)
def test_a_better_bench_tells_more_in_every_direction(better: dict[str, float]) -> None:
    plain, more = information(beam(), bench(), TIP), information(beam(), bench(**better), TIP)
    values = np.linalg.eigvalsh(more - plain)
    assert values[0] > -1e-6 * values[-1]
    assert values[-1] > 0.0


def test_a_better_sensor_tells_more_and_its_errors_are_that_much_smaller() -> None:
    good = with_better_sensor(bench(gain_sd=0.1, clock_sd=0.0), 4.0)
    assert good.gain_sd == pytest.approx(0.025)
    assert good.force.tau == bench().force.tau
    ratio = force_covariance(bench(clock_sd=0.0), TIP) / 16.0
    np.testing.assert_allclose(force_covariance(good, TIP), ratio, rtol=1e-9, atol=1e-15)
    assert np.linalg.eigvalsh(information(beam(), good, TIP) - information(beam(), bench(clock_sd=0.0), TIP))[0] > -1e-6


def test_rests_show_the_force_logs_constant_error() -> None:
    blind = bench(rest_before=0.0, rest_after=0.0, clock_sd=0.0)
    level = blind.force.level**2
    assert np.min(np.diag(force_covariance(blind, TIP))) >= level
    assert np.max(np.diag(force_covariance(bench(clock_sd=0.0), TIP))) < 0.5 * level


def test_what_cannot_be_told_is_refused() -> None:
    with pytest.raises(LearningError, match="log-spline"):
        information(Beam(0.15, Uniform(0.02)), bench(), TIP)
    with pytest.raises(MechanicsError, match="buckles"):
        information(beam(), bench(), PlannedPush(1.0, np.pi, 5.0))
