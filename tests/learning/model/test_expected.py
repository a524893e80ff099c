"""What is expected before the data: covariances, priors and weights, each against its own definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.fit_data import fit_data
from onebend.learning.force_error import filtered, force_error, ramp
from onebend.learning.frames import whitening
from onebend.learning.parameters import LEVEL_SD, RHO, TAU, Spline, clamp_sd, make_layout
from onebend.records import CleanForce, ClockOffset, ForceNoise
from tests.learning.bench import MARKERS, SOFT, forces, observed
from tests.made_up import with_source, with_stated

MADE = observed(SOFT, forces(12), noise=(2e-5, 1e-3))
SPLINE = Spline(8)


def test_a_filter_that_lets_all_through_leaves_the_process_as_it_is() -> None:
    lag = np.linspace(0.0, 1.0, 9)
    passed = filtered(lag, 100.0).covariance(0.3, 0.2)
    np.testing.assert_allclose(passed, 0.09 * np.exp(-lag / 0.2), atol=0.01 * 0.09)
    np.testing.assert_allclose(filtered(lag, np.inf).covariance(0.3, 0.2), 0.09 * np.exp(-lag / 0.2))


@pytest.mark.parametrize("even", [True, False])
def test_the_covariance_behind_the_filter_is_the_cosine_transform_of_what_it_lets_through(even: bool) -> None:
    lag, sd, tau, white = np.linspace(0.0, 3.0, 14), 0.3, 0.2, 1e-3
    lag = lag if even else np.sort(np.append(lag, 1.234))
    behind = filtered(lag, 2.0)
    f = behind.frequency
    density = white + 4.0 * tau * sd**2 / (1.0 + (2.0 * np.pi * f * tau) ** 2)
    dense = np.cos(2.0 * np.pi * lag[:, None] * f) @ (behind.weight * density)
    np.testing.assert_allclose(behind.covariance(sd, tau, white), dense, atol=1e-13 * dense[0])


def test_white_noise_has_its_variance_below_half_the_rate_of_its_samples() -> None:
    error = replace(force_error(MADE, MADE.time), noise=ForceNoise(0.02, 0.01, 0.2, 0.0, spacing=0.005))
    assert error.white * 0.5 / 0.005 == pytest.approx(0.02**2)


def test_a_zero_that_ran_between_rests_is_put_back() -> None:
    time = np.array([0.0, 10.0])
    clean = CleanForce(
        time=time,
        force=np.zeros((2, 2)),
        push_s=None,
        noise_sd=np.zeros(2),
        tare=np.zeros(2),
        drift=np.zeros(2),
        cutoff=1.0,
        outliers=0,
        noise=None,
        zero_time=np.array([2.0, 6.0]),
        zero=np.array([[0.1, 0.0], [0.3, -0.4]]),
    )
    np.testing.assert_allclose(
        ramp(clean, np.array([0.0, 4.0, 8.0])), [[0.0, 0.0], [-0.1, 0.2], [-0.2, 0.4]], atol=1e-12
    )


def test_a_tare_may_have_missed_three_times_the_sd_and_no_more_than_the_largest_force() -> None:
    largest = float(np.max(np.linalg.norm(MADE.force, axis=1)))
    assert force_error(MADE, MADE.time).noise.level == pytest.approx(3.0 * 0.005)
    unknown = replace(MADE, force_sd=np.full(2, np.nan))
    assert force_error(unknown, MADE.time).noise.level == pytest.approx(largest)
    assert force_error(unknown, MADE.time).noise.coloured == pytest.approx(0.02 * largest)


def test_whitened_poses_have_covariance_one_also_where_a_number_is_missing() -> None:
    root = np.array([[1.0, 0.0, 0.0], [0.4, 2.0, 0.0], [-0.3, 0.5, 0.7]])
    covariance = np.tile(root @ root.T, (2, 1, 1))
    measured = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.nan]])
    w = whitening(measured, covariance)
    np.testing.assert_allclose(w[0] @ covariance[0] @ w[0].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(w[1] @ covariance[1] @ w[1].T, np.diag([1.0, 1.0, 0.0]), atol=1e-12)


def test_the_beam_at_rest_counts_as_one_frame() -> None:
    data = fit_data(MADE, 0, np.ones(12, dtype=bool), SPLINE)
    np.testing.assert_allclose(data.whiten[-1], data.whiten[0], rtol=1e-12)
    assert not np.any(data.force[-1])
    assert not np.any(data.error_weights[-1])


def test_the_clock_is_trusted_half_as_much_as_it_says() -> None:
    clock = ClockOffset(offset=0.0, sd=0.01, stated=0.0, found=True)
    layout = make_layout(SPLINE, [with_source(MADE, clock=clock)], [4])
    assert layout.index["clock", 0].prior_sd[0] == pytest.approx(0.02)


def test_the_clamps_direction_is_known_as_well_as_the_tags_places_tell_it() -> None:
    o = with_stated(MADE, clamp_sd=0.003, placement_sd=5e-4)
    line = 2.0 * 5e-4 / np.linalg.norm(0.15 * MARKERS)
    assert clamp_sd(o) == pytest.approx(np.hypot(0.003, line), rel=1e-12)
    assert clamp_sd(with_stated(o, clamp_sd=0.0)) == 0.0


def test_k_that_is_one_number_varies_by_a_hundredth() -> None:
    layout = make_layout(SPLINE, [with_stated(MADE, stiffness_along="even")], [4])
    root = layout.stiffness_root(layout.first_variances)
    np.testing.assert_allclose(root @ root.T, LEVEL_SD**2 + 0.01**2 * np.eye(8), rtol=1e-12, atol=1e-12)
    free = make_layout(SPLINE, [MADE], [4])
    np.testing.assert_array_equal(free.first_variances, SPLINE.variances(TAU, RHO))
