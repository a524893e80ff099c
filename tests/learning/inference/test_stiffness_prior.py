"""The prior of log k, and its posterior with unknown sizes: against formulas, and draws weighed one by one."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline
from scipy.special import ndtri

from onebend.beam.stiffness import SHAPE_LEVELS, SHAPE_PLACES
from onebend.learning.normal import (
    JUMP,
    RHO,
    SPREAD,
    TAU,
    Draws,
    InformationForm,
    drawn_sizes,
    part_variances,
    stiffness_mixture,
    target_of,
)
from onebend.learning.parameters import LEVEL_SD, POWER, SLOPE_SD, Spline, with_width
from tests.learning.bench import prior_precision

S = np.linspace(0.0, 1.0, 101)


def drawn(spline: Spline, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (N, p) from the prior, and their weights (N,)."""
    tau, rho = np.array([[TAU], [RHO]]) * np.exp(SPREAD[:, None] * rng.standard_normal((2, count)))
    local = rho[:, None] * spline.share * rng.standard_cauchy((count, 2 * spline.count - 1))
    line = np.array([LEVEL_SD, SLOPE_SD]) * rng.standard_normal((count, 2))
    bent = tau[:, None] * rng.standard_normal((count, spline.count - 2))
    weight = np.exp(-0.5 * np.sum((local / JUMP) ** 2, axis=1))
    return np.concatenate([line, bent, local], axis=1) @ spline.parts.T, weight


def test_parts_are_level_slope_bends_steps_and_bumps() -> None:
    spline = Spline(9)
    level, slope = (spline.basis(S) @ spline.parts[:, i] for i in (0, 1))
    np.testing.assert_allclose(level, 1.0, atol=1e-12)
    np.testing.assert_allclose(slope, S - 0.5, atol=1e-12)
    bent = spline.parts[:, 2 : spline.count]
    second = np.gradient(
        np.gradient(Spline(9).basis(np.linspace(0, 1, 4001)) @ bent, 1 / 4000, axis=0), 1 / 4000, axis=0
    )
    np.testing.assert_allclose(second.T @ second / 4000, np.eye(7), atol=0.03)
    np.testing.assert_allclose((spline.basis(S) @ bent).mean(axis=0), 0.0, atol=1e-12)
    steps, bumps = spline.parts[:, spline.count : 2 * spline.count - 1], spline.parts[:, 2 * spline.count - 1 :]
    np.testing.assert_allclose(np.diff(steps, axis=0), np.eye(8), atol=1e-12)
    level = np.mean(spline.basis(S), axis=0)
    np.testing.assert_allclose(level @ spline.parts[:, spline.count :], 0.0, atol=1e-12)
    assert bumps.shape == (9, 9)


def test_a_bump_is_a_wider_spline_of_height_one() -> None:
    spline, s = Spline(23), np.linspace(0.0, 1.0, 401)
    bump = spline.basis(s) @ spline.parts[:, 2 * spline.count - 1 + 11]
    bump = bump - bump[0]
    h = 1.0 / 20.0
    wide = BSpline.basis_element(0.5 + 2.0 * h * np.arange(-2.0, 3.0), extrapolate=False)(s)
    np.testing.assert_allclose(bump, 1.5 * np.nan_to_num(wide), atol=1e-12)


def test_the_width_goes_into_log_k_with_an_unknown_power_and_its_own_errors() -> None:
    """Of a body with a thicker node, hidden beside the clamp: the part is the log of the width where that is seen, and
    its errors are largest where it is not."""
    s = np.linspace(0.15, 1.0, 150)
    log_width = np.log(0.01) - 0.3 * s + 0.2 * np.exp(-0.5 * ((s - 0.6) / 0.03) ** 2)
    shown = np.exp(log_width + 0.004 * np.random.default_rng(2).standard_normal(len(s)))
    spline = with_width(Spline(45), np.column_stack([s, shown]))
    assert spline.besides is not None
    at, rows = S[S > 0.15], spline.besides.T / POWER
    away = np.interp(at, s, log_width) - spline.basis(at) @ rows[0]
    sd, hidden = (np.linalg.norm(rows[1:] @ spline.basis(one).T, axis=0) for one in (at, np.zeros(1)))
    assert hidden > 5.0 * np.median(sd)
    assert 0.4 < np.sqrt(np.mean((away / sd) ** 2)) < 1.6
    assert np.median(sd) < 0.004
    variances = spline.variances(TAU, RHO)
    assert len(variances) == spline.parts.shape[1]
    np.testing.assert_array_equal(variances[spline.local.stop :], 1.0)


def test_the_bands_of_a_mixture_are_its_quantiles() -> None:
    """One step of unknown place, seen from afar: few draws are far off, most are near, and the 50 % band is narrow."""
    spline, at = Spline(16), np.linspace(0.02, 0.98, 12)
    rows = spline.basis(at) / 0.05
    found = stiffness_mixture(
        spline, [InformationForm(rows.T @ rows, rows.T @ (20.0 * (at > 0.5)))], 0.0, Draws(30, 40, 60)
    )
    assert found.shape.shape == (len(SHAPE_LEVELS), len(SHAPE_PLACES))
    assert np.min(found.shape[0]) < 0.9
    assert np.all(np.diff(found.shape * ndtri(0.5 + 0.5 * SHAPE_LEVELS)[:, None], axis=0) > 0.0)


def test_finer_splines_have_the_same_prior_of_a_step() -> None:
    """Half of the beam steps by a Cauchy number of scale rho / 2 whatever the spline."""
    for count in (16, 45):
        spline, rng = Spline(count), np.random.default_rng(1)
        half = spline.share[: spline.count - 1][np.cumsum(spline.gaps) <= 0.5 + 1e-9]
        total = np.sum(half * rng.standard_cauchy((20000, len(half))), axis=1)
        assert abs(np.median(np.abs(total)) - half.sum()) < 0.02


def test_precision_is_that_of_the_sum_of_the_parts() -> None:
    spline = Spline(7)
    variances = spline.variances(5.0, 0.4)
    covariance = (spline.parts * variances) @ spline.parts.T
    np.testing.assert_allclose(prior_precision(spline, 5.0, 0.4) @ covariance, np.eye(7), atol=1e-8)


def test_the_finer_splines_hold_the_same_functions_and_what_a_step_may_be() -> None:
    spline = Spline(12)
    np.testing.assert_allclose(spline.finer.basis(S) @ spline.on_finer, spline.basis(S), atol=1e-12)
    variance = np.einsum("si,jik,sk->js", spline.finer.basis(S), spline.unseen, spline.finer.basis(S))
    assert np.all(variance > -1e-12)
    assert np.all(variance.max(axis=1) < 0.5)
    middle = np.add(*[np.cumsum(np.append(spline.knots[2], spline.gaps))[i:][: spline.count - 1] for i in (0, 1)]) / 2
    assert np.all(np.abs(S[np.argmax(variance, axis=1)] - middle) < 0.1)
    assert np.all(variance[np.abs(S - middle[:, None]) > 0.35] < 1e-12)


def test_mean_and_covariance_are_those_of_the_exact_posterior() -> None:
    spline, rng = Spline(6), np.random.default_rng(0)
    rows = np.vstack([spline.basis(np.array([0.1, 0.35, 0.5, 0.8])), np.full((1, 6), 1.0 / 6.0)])
    told = np.array([0.0, 0.3, 0.9, 1.1, 0.6]) + 0.1 * rng.standard_normal(5) - 4.0
    sd = np.array([0.5, 0.3, 0.3, 0.5, 1.0])
    information, b = (rows.T / sd**2) @ rows, (rows.T / sd**2) @ told
    found = stiffness_mixture(spline, [InformationForm(information, b)], -4.0, Draws(200, 60, 200))
    c, weight = drawn(spline, 300_000, rng)
    c -= 4.0
    weight = weight * np.exp(-0.5 * np.sum(((told - c @ rows.T) / sd) ** 2, axis=1))
    mean = weight @ c / np.sum(weight)
    covariance = ((c - mean).T * weight) @ (c - mean) / np.sum(weight)
    sds = np.sqrt(np.diag(covariance))
    assert np.sum(weight) ** 2 / np.sum(weight**2) > 1000.0
    np.testing.assert_allclose(found.mean, mean, atol=0.1 * sds.min())
    np.testing.assert_allclose(found.covariance / np.outer(sds, sds), covariance / np.outer(sds, sds), atol=0.12)


def test_several_tellings_are_averaged_by_their_weights() -> None:
    spline = Spline(6)
    rows = 30.0 * spline.basis(np.linspace(0.0, 1.0, 12))
    low, high = (
        InformationForm(rows.T @ rows, rows.T @ np.full(12, 30.0 * v), weight=w)
        for v, w in ((-4.1, 0.25), (-3.9, 0.75))
    )
    found = stiffness_mixture(spline, [low, high], -4.0, Draws(8, 20, 30))
    np.testing.assert_allclose(found.mean, -3.95, atol=0.01)
    assert np.sqrt(found.covariance[2, 2]) > 0.08


def test_one_step_among_even_pieces_is_found_and_the_rest_kept_even() -> None:
    spline, at = Spline(16), np.linspace(0.02, 0.98, 40)
    rng = np.random.default_rng(3)
    truth = np.where(at > 0.5, 0.8, 0.0)
    rows = spline.basis(at) / 0.05
    seen = (truth + 0.05 * rng.standard_normal(len(at))) / 0.05
    found = stiffness_mixture(spline, [InformationForm(rows.T @ rows, rows.T @ seen)], 0.0, Draws(30, 40, 80))
    steps = np.abs(found.steps)
    assert np.sort(steps)[-3:].sum() > 0.6 * steps.sum()
    assert 5 <= int(np.argmax(steps)) <= 9
    even = np.linalg.inv(rows.T @ rows + prior_precision(spline, 8.0, 0.3))
    assert found.covariance[3, 3] < even[3, 3]


def test_steps_and_bumps_before_the_data_are_cauchy() -> None:
    spline, rng = Spline(8), np.random.default_rng(0)
    logs = np.tile(np.log([2.0, 0.2]), (3000, 1))
    scale, local = 0.2 * spline.share, np.zeros((3000, 15))
    for _ in range(30):  # in turn from sizes given steps, and steps given sizes
        local = scale * np.sqrt(drawn_sizes(spline, logs, local, rng)) * rng.standard_normal(local.shape)
    np.testing.assert_allclose(np.median(np.abs(local), axis=0), scale, rtol=0.1)
    np.testing.assert_allclose(np.quantile(np.abs(local) / scale, 0.9), np.tan(0.45 * np.pi), rtol=0.1)


def test_no_step_is_expected_to_be_much_larger_than_one_of_log_k() -> None:
    spline = Spline(8)
    variances, _ = part_variances(spline, np.log([[2.0, 0.2]]), np.full((1, 15), 1e12))
    np.testing.assert_allclose(variances[0, 8:], 1.0, rtol=1e-6)
    usual, over = part_variances(spline, np.log([[2.0, 0.2]]), np.full((1, 15), 1e-6))
    np.testing.assert_allclose(usual[0, 8:], 1e-6 * (0.2 * spline.share) ** 2, rtol=1e-4)
    np.testing.assert_allclose(over[0], usual[0, 8:], rtol=1e-4)


def test_steps_given_their_sizes_are_drawn_from_their_normal_posterior() -> None:
    spline, rng, count = Spline(6), np.random.default_rng(0), 20000
    root = rng.standard_normal((6, 6))
    target = target_of(spline, [InformationForm(100.0 * root @ root.T, rng.standard_normal(6))], -4.0, 1)
    now = target.at(np.log([[2.0, 3.0]]), np.ones((1, 11)))
    variance, on = now.variance[0], target.on_parts[0]
    gain = np.linalg.solve(on * variance @ on.T + np.eye(6), on * variance)  # (r, n)
    mean, covariance = gain.T @ target.seen[0], np.diag(variance) - (variance[:, None] * on.T) @ gain
    target.seen, target.on_parts = np.repeat(target.seen, count, axis=0), np.repeat(target.on_parts, count, axis=0)
    target.on_local = np.repeat(target.on_local, count, axis=0)
    drawn = target._drawn(np.repeat(now.variance, count, axis=0), np.repeat(now.root, count, axis=0), rng)
    local = slice(6, 17)
    sd = np.sqrt(np.diag(covariance)[local])
    np.testing.assert_allclose((np.mean(drawn, axis=0) - mean[local]) / sd, 0.0, atol=0.04)
    np.testing.assert_allclose(
        np.cov(drawn.T) / np.outer(sd, sd), covariance[local, local] / np.outer(sd, sd), atol=0.05
    )
