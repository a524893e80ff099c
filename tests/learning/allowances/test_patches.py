"""Tags that stiffen the beam under them, and that the reported k(s) says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.allowances.patches import RIM, USUAL_SIZE, patch_function
from onebend.learning.inference.fit_problem import FitProblem, Hyperparameters, RecordingNoise, log_k_map
from onebend.learning.model.fit_data import fit_data
from onebend.learning.model.parameters import Priors, make_layout
from onebend.learning.model.spline import RHO, TAU, Spline
from tests.learning.allowances.allowed_bench import TAGS, filmed
from tests.made_up import with_stated

S = np.linspace(0.0, 1.0, 2001)


@pytest.mark.parametrize("size", [np.nan, 0.006, 0.02])
def test_it_is_one_under_the_tags_and_nothing_between(size: float) -> None:
    made = with_stated(filmed(), tag_size=size)
    half = 0.5 * RIM * (size / made.length if np.isfinite(size) else USUAL_SIZE)
    away, found = np.min(np.abs(S[:, None] - TAGS), axis=1), patch_function(TAGS, made.length, made.stated.tag_size, S)
    assert np.all(found[away < 0.6 * half] > 0.99)
    assert np.all(found[away > 1.4 * half] < 0.01)
    assert 0.5 * np.sum(found) * (S[1] - S[0]) == pytest.approx(3 * half, rel=0.05)


def test_the_reported_stiffness_has_the_patches_in_it() -> None:
    made, spline = with_stated(filmed(), tag_size=0.02), Spline(45)
    one = fit_data(made, 0, np.ones(len(made.time), dtype=bool), spline, frozenset({"patches"}))
    layout = make_layout(spline, [made], [len(one.error.knots)], Priors(), [one.allowances])
    expected = Hyperparameters(spline.variances(TAU, RHO), 1.0, 1.0, 1.0, 1.0, (RecordingNoise(1.0, 1e-4),))
    index, onto = log_k_map(FitProblem((one,), layout, 0.0, expected))
    x = np.zeros(layout.size)
    x[layout.index["stiffness", -1].where] = 0.2 * np.cos(np.arange(45) / 5.0)
    x[layout.index["patches", -1].start] = 0.7
    reported = spline.finer.basis(S) @ onto @ x[index]
    true = spline.basis(S) @ x[layout.index["stiffness", -1].where] + 0.7 * patch_function(
        TAGS, made.length, made.stated.tag_size, S
    )
    assert np.sqrt(np.mean((reported - true) ** 2)) < 0.05 * 0.7
    assert np.max(np.abs(np.interp(TAGS, S, reported - true))) < 0.05 * 0.7
    without = make_layout(spline, [made], [len(one.error.knots)], Priors())
    bare = log_k_map(FitProblem((replace(one, allowances=()),), without, 0.0, expected))
    np.testing.assert_array_equal(bare[1], spline.on_finer)
