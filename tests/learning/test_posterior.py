"""The marker-space fit: derivatives, covariances against the slow textbook way, recovery, and an honest band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Gaussians, Powers, Steps, Uniform, equidistant
from onebend.errors import LearningError
from onebend.learning.fit_data import FitData, fit_data
from onebend.learning.linear import RecordingNoise, ResidualRows, residual_rows, tag_information
from onebend.learning.parameters import Layout, Spline, make_layout
from onebend.learning.posterior import Posterior, fit
from onebend.learning.prediction import predict
from onebend.records import Array, ClockOffset, Observations
from tests.learning.bench import IDEAL, MARKERS, SOFT, forces, observed
from tests.made_up import with_source, with_stated

S = np.linspace(0.05, 0.9, 60)
NOISE = (2e-5, 1e-3)


def prepared(made: Observations) -> tuple[FitData, Layout, Array]:
    """A film, its parameters, and a point away from the optimum."""
    spline = Spline(8)
    seen = fit_data(made, 0, np.ones(len(made.time), dtype=bool), spline)
    at = make_layout(spline, [made], [len(seen.error.knots)])
    x = 1e-3 * np.sin(np.arange(at.size))
    x[:8] = np.log(0.02) + 0.3 * np.cos(np.arange(8))
    return seen, at, x


@pytest.fixture(scope="module")
def curved() -> Observations:
    beam = Beam(0.15, SOFT.stiffness, rest_curvature=Uniform(0.2))
    return with_stated(observed(beam, forces(12), noise=NOISE), rest="unknown")


@pytest.mark.parametrize("weighs", [False, True])
def test_every_derivative_matches_differences(curved: Observations, weighs: bool) -> None:
    if weighs:
        turn = np.linspace(0.0, 2.0, len(curved.time))
        gravity = 9.81 * np.stack([np.sin(turn), -np.cos(turn)], axis=1)
        curved = with_stated(replace(curved, gravity=gravity), mass=0.03)
    clock = ClockOffset(offset=0.0, sd=0.01, stated=0.0, found=True)
    seen, at, x = prepared(with_stated(with_source(curved, clock=clock), placement_sd=5e-4))
    assert ("mass", -1) in at.index
    assert (at.columns("mass", 0) is not None) == weighs
    slopes = predict(seen, at, x, None).slopes
    exact, by_force = slopes.written, slopes.a
    h = 1e-5
    for i in range(at.size):
        step = h * np.eye(at.size)[i]
        difference = (predict(seen, at, x + step, None).pose - predict(seen, at, x - step, None).pose) / (2.0 * h)
        np.testing.assert_allclose(exact[..., i], difference, atol=1e-6 * max(1.0, float(np.max(np.abs(difference)))))
    assert by_force.shape == (13, 3, 3, 2)


def test_a_frames_covariance_is_the_dense_one(curved: Observations) -> None:
    """`S = s^2 I + f^2 A A^T`: information, right side, misfit and log determinant against explicit inverses."""
    seen, at, x = prepared(curved)
    noise = RecordingNoise(1.7, 0.004)
    rows: ResidualRows = residual_rows(predict(seen, at, x, None), noise)
    found = tag_information(rows, at, 0, x, noise)
    written = rows.slopes.written
    y = rows.r + written @ x
    h, b, c, log_noise = np.zeros((at.size, at.size)), np.zeros(at.size), 0.0, 0.0
    for r, j, a in zip(y, written, rows.a, strict=True):
        s = noise.marker**2 * np.eye(len(r)) + noise.force**2 * a @ a.T
        h += j.T @ np.linalg.solve(s, j)
        b += j.T @ np.linalg.solve(s, r)
        c += r @ np.linalg.solve(s, r)
        log_noise += 0.5 * np.linalg.slogdet(s)[1]
    np.testing.assert_allclose(found.matrix, h, rtol=1e-7, atol=1e-7 * np.max(np.abs(h)))
    np.testing.assert_allclose(found.vector, b, rtol=1e-7, atol=1e-7 * np.max(np.abs(b)))
    assert found.constant == pytest.approx(c, rel=1e-7)
    assert found.log_noise == pytest.approx(log_noise, rel=1e-9)


def wrong_force(made: Observations, seed: int, sd: float) -> Observations:
    """A slowly wandering error in the log: a random walk of `sd` over the recording, zero at both ends."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(size=made.force.shape), axis=0)
    walk -= np.linspace(0.0, 1.0, len(walk))[:, None] * walk[-1]
    walk *= sd / np.std(walk)
    return replace(made, force=made.force + walk, force_sd=np.full(2, sd))


@pytest.fixture(scope="module")
def fits() -> list[Posterior]:
    """Five seeds of noisy tags and a wandering force log."""
    made = [wrong_force(observed(SOFT, forces(60), noise=NOISE, seed=s), s, 0.005) for s in range(5)]
    return [fit([one], 0.03, settings=replace(IDEAL, functions=12)) for one in made]


def test_stiffness_comes_back_and_the_band_holds_it(fits: list[Posterior]) -> None:
    inside, errors = [], []
    for one in fits:
        band = one.band(S)
        errors.append(np.sqrt(np.mean((band.k / SOFT.stiffness(S) - 1.0) ** 2)))
        inside.append(np.mean((SOFT.stiffness(S) > band.low) & (SOFT.stiffness(S) < band.high)))
    assert np.median(errors) < 0.05
    assert np.mean(inside) > 0.8


def test_the_search_says_that_it_converged_and_why(fits: list[Posterior]) -> None:
    assert all(one.optimum.converged for one in fits)
    assert "sd" in fits[0].optimum.stopped


def test_nuisances_are_reported_with_their_sd_before_and_after(fits: list[Posterior]) -> None:
    found = {n.name: n for n in fits[0].nuisances()}
    assert {"tag 1 along", "tag 3 turn", "made: clamp angle"} <= set(found)
    assert all(0.0 < n.sd <= 1.001 * n.prior_sd for n in found.values())


@pytest.mark.slow
def test_poor_starts_lead_to_the_same_optimum() -> None:
    made = observed(SOFT, forces(40), noise=NOISE, seed=3)
    ends = [fit([made], start, settings=replace(IDEAL, functions=10)).band(S).k for start in (0.01, 0.3)]
    np.testing.assert_allclose(ends[0], ends[1], rtol=5e-3)


@pytest.mark.slow
def test_the_band_opens_where_a_push_at_mid_span_says_nothing() -> None:
    one = fit([observed(SOFT, forces(40, most=0.6), at_s=0.6, noise=NOISE)], 0.02, settings=IDEAL)
    band = one.band(np.array([0.3, 0.95]))
    assert band.identified.tolist() == [True, False]
    ratio = band.high / band.low
    assert ratio[1] > 3.0 * ratio[0]


@pytest.mark.slow
def test_declared_gain_widens_the_whole_band_alike() -> None:
    made = observed(SOFT, forces(30), noise=NOISE)
    plain, wide = (fit([made], 0.02, gain_sd=g, settings=replace(IDEAL, functions=8)).band(S) for g in (0.0, 0.1))
    np.testing.assert_allclose(plain.k, wide.k)
    half = np.log(wide.high / wide.k) / 1.959964
    np.testing.assert_allclose(half**2 - (np.log(plain.high / plain.k) / 1.959964) ** 2, 0.01, rtol=1e-4)


@pytest.mark.slow
def test_several_recordings_in_one_fit_tell_more_than_one() -> None:
    tip = wrong_force(observed(SOFT, forces(40), noise=NOISE, seed=1), 1, 0.005)
    side = with_source(wrong_force(observed(SOFT, forces(40), at_s=0.7, noise=NOISE, seed=2), 2, 0.005), name="side")
    alone, both = fit([tip], 0.02, settings=IDEAL), fit([tip, side], 0.02, settings=IDEAL)
    assert np.mean(both.stiffness.log_at(S)[1]) < np.mean(alone.stiffness.log_at(S)[1])


def test_stiffness_is_positive_for_a_step_that_defeats_the_regression() -> None:
    stepped = Beam(0.15, Steps((0.0, 0.4, 1.0), (0.03, 0.012)))
    k = fit([observed(stepped, forces(40), noise=NOISE)], 0.02, settings=IDEAL).band(S).k
    assert np.all(k > 0.0)
    np.testing.assert_allclose(k[(S < 0.25) | (S > 0.55)], stepped.stiffness(S[(S < 0.25) | (S > 0.55)]), rtol=0.25)


@pytest.mark.parametrize(
    ("recordings", "start", "words"),
    [
        ([], 0.02, "no recording"),
        ([observed(SOFT, forces(4))], 0.02, "at least 5"),
        ([observed(SOFT, forces(20))], -1.0, "positive"),
        ([observed(SOFT, forces(20)), replace(observed(SOFT, forces(20)), length=0.2)], 0.02, "not of the beam"),
    ],
)
def test_what_cannot_be_fitted_is_refused(recordings: list[Observations], start: float, words: str) -> None:
    with pytest.raises(LearningError, match=words):
        fit(recordings, start)


@pytest.mark.slow
def test_an_uneven_mass_is_not_taken_for_stiffness() -> None:
    """Hung and turned under its weight, pushed besides: k is right although the mass per metre is not even."""
    mass, length = 0.08, 0.15
    uneven = Powers((1.4 * mass / length, -0.8 * mass / length))
    beam = Beam(length, Gaussians(equidistant(3), 0.5, (0.02, 0.03, 0.015)), mass_per_length=uneven)
    turn = np.linspace(-0.6, 0.6, 40)
    gravity = 9.81 * np.stack([np.sin(turn), -np.cos(turn)], axis=1)
    force = forces(40, most=0.08)
    shape = beam.equilibrium(force, gravity=gravity)
    made = observed(beam, force, xy=shape.xy(MARKERS), angle=shape.angle(MARKERS), noise=NOISE)
    unknown = np.full((3, 2), np.nan)
    made = with_stated(replace(made, gravity=gravity, rest_xy=unknown, rest_angle=unknown[:, 0]), mass=mass)
    band = fit([made], 0.03, settings=replace(IDEAL, functions=12)).band(S)
    assert np.max(np.abs(np.log(band.k / beam.stiffness(S)))) < 0.1
    even = fit([with_stated(made, mass_along="even")], 0.03, settings=replace(IDEAL, functions=12)).band(S)
    error, worse = (np.mean(np.abs(np.log(k / beam.stiffness(S)))) for k in (band.k, even.k))
    assert worse > 1.5 * error  # the clamp's own freedom takes part of the rest


def test_weight_without_a_mass_is_refused(curved: Observations) -> None:
    hung = replace(curved, gravity=np.tile([0.0, -9.81], (len(curved.time), 1)))
    with pytest.raises(LearningError, match=r"mass_kg in \[beam\]"):
        fit([hung], 0.03, settings=IDEAL)


def test_a_film_without_a_force_log_has_no_force_error(curved: Observations) -> None:
    hung = with_stated(
        replace(curved, gravity=np.tile([0.0, -9.81], (len(curved.time), 1)), force=0.0 * curved.force), mass=0.03
    )
    seen, at, _ = prepared(hung)
    assert len(seen.error.knots) == 0
    assert at.columns("force", 0) is None


def test_a_log_whose_error_is_as_large_as_its_force_is_refused_in_one_message() -> None:
    seen, phase = observed(SOFT, forces(20, most=0.05), noise=(2e-5, 1e-3)), np.linspace(0.0, np.pi, 20)
    error = 0.1 * np.stack([np.sin(2.0 * phase), np.cos(3.0 * phase)], axis=1)
    log = replace(seen, force=seen.force + error, force_sd=np.array([0.1, 0.1]))
    with pytest.raises(LearningError, match=r"made: the error of the force log changes by .* push harder"):
        fit([log], 0.02, settings=replace(IDEAL, functions=8))
