"""Tags that stiffen the beam under them, and that the reported k(s) says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.grid import Grid, make_grid
from onebend.learning.allowances import PATCH_SD, SHARES, USUAL_SIZE, WIDTHS, patch_functions, patch_means, patches
from onebend.learning.fit_data import fit_data
from onebend.learning.linear import FitProblem, Hyperparameters, RecordingNoise, log_k_map
from onebend.learning.parameters import RHO, TAU, Spline, make_layout
from onebend.learning.posterior import unknown_width
from tests.learning.allowances.allowed_bench import TAGS, course, filmed
from tests.made_up import with_stated

S = np.linspace(0.0, 1.0, 2001)
LAYERS = np.array([0.7, 0.2, 0.1])


@pytest.mark.parametrize("size", [np.nan, 0.006, 0.02])
def test_they_are_one_under_the_tags_and_nothing_between(size: float) -> None:
    made = with_stated(filmed(), tag_size=size)
    found = patch_functions(TAGS, made.length, made.stated.tag_size, S)
    square = size / made.length if np.isfinite(size) else USUAL_SIZE
    away = np.min(np.abs(S[:, None] - TAGS), axis=1)
    assert np.all(found[away < 0.25 * square] > 0.98)
    assert np.all(found[away > 1.3 * square] < 0.01)
    assert np.all(np.diff(found, axis=1) >= -1e-12)
    if np.isfinite(size):
        widths = np.sum(found, axis=0) * (S[1] - S[0]) / (3.0 * square)
        np.testing.assert_allclose(widths, WIDTHS, rtol=0.02)


def test_a_patch_reaches_as_far_as_its_widths_are_likely() -> None:
    made = replace(course(), marker_s=np.array([0.5]), on_body=np.array([True]), tags=("tag 1",), tag_size=0.01)
    size, length, one = made.tag_size, made.length, patches(made)
    assert one is not None
    basis = patch_functions(np.array([0.5]), length, size, 0.5 + 0.5 * size / length * np.array([0.5, 1.15, 1.43, 2.2]))
    found = np.sum((basis * one.prior_sd) ** 2, axis=1) / PATCH_SD**2
    np.testing.assert_allclose(found, [1.0, 0.75, 0.25, 0.0], atol=0.12)


@pytest.mark.parametrize("middle", np.linspace(0.2, 0.8, 7))
def test_nodes_see_a_patch_as_wide_as_it_is_wherever_they_lie(middle: float) -> None:
    grid, tag, length, size = make_grid((1.0,), order=6, widest=0.125), np.array([middle]), 0.15, 0.012
    exact = patch_functions(tag, length, size, S).mean(axis=0)
    found = grid.weights @ patch_means(tag, length, size, grid)
    np.testing.assert_allclose(found, exact, rtol=1e-3)
    both = Grid(np.stack([grid.edges, grid.edges**2]), grid.order)
    np.testing.assert_allclose(patch_means(tag, length, size, both)[0], patch_means(tag, length, size, grid))


def test_the_reported_stiffness_has_the_patches_in_it() -> None:
    made, spline = with_stated(filmed(), tag_size=0.02), Spline(45)
    one = fit_data(made, 0, np.ones(len(made.time), dtype=bool), spline, frozenset({"patches"}))
    layout = make_layout(spline, [made], [len(one.error.knots)], [one.allowances])
    expected = Hyperparameters(spline.variances(TAU, RHO), 1.0, 1.0, 1.0, 1.0, (RecordingNoise(1.0, 1e-4),))
    index, onto = log_k_map(FitProblem((one,), layout, 0.0, expected))
    x = np.zeros(layout.size)
    x[layout.index["stiffness", -1].where] = 0.2 * np.cos(np.arange(45) / 5.0)
    x[layout.index["patches", -1].where] = LAYERS
    reported = spline.finer.basis(S) @ onto @ x[index]
    true = spline.basis(S) @ x[layout.index["stiffness", -1].where] + (
        patch_functions(TAGS, made.length, made.stated.tag_size, S) @ LAYERS
    )
    assert np.sqrt(np.mean((reported - true) ** 2)) < 0.05 * 0.7
    assert np.max(np.abs(np.interp(TAGS, S, reported - true))) < 0.05 * 0.7
    without = make_layout(spline, [made], [len(one.error.knots)])
    bare = log_k_map(FitProblem((replace(one, allowances=()),), without, 0.0, expected))
    np.testing.assert_array_equal(bare[1], spline.on_finer)


def test_the_band_leaves_open_which_of_the_widths_a_patch_has() -> None:
    whole = 0.8
    drawn = whole * np.random.default_rng(0).multinomial(1, SHARES, 200_000)
    found = unknown_width(whole * SHARES, np.zeros((3, 3)))
    np.testing.assert_allclose(found, np.cov(drawn.T), atol=2e-3)
    np.testing.assert_allclose(found @ np.ones(3), 0.0, atol=1e-12)  # the whole effect is as well known as before
    np.testing.assert_allclose(unknown_width(whole * SHARES, 2.0 * found), 0.0, atol=1e-12)  # it was open already
    np.testing.assert_allclose(unknown_width(whole * SHARES, 0.25 * found), 0.75 * found, atol=1e-12)
    assert unknown_width(np.zeros(0), np.zeros((0, 0))).shape == (0, 0)
