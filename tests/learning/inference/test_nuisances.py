"""Mean and drift of a force log's slow error, and what the fit reports of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.fit_data import FitData, at_rest, beam_points, fit_data
from onebend.learning.parameters import Block, Layout, Spline, make_layout
from onebend.learning.posterior import correlations, fit, quantities
from onebend.records import Observations
from tests.learning.bench import IDEAL, SOFT, forces, observed
from tests.made_up import with_source, with_stated

SPLINE = Spline(8)


@pytest.fixture(scope="module")
def made() -> Observations:
    return observed(SOFT, forces(30, most=0.4), at_s=0.8, noise=(2e-5, 1e-3))


def prepared(made: Observations) -> tuple[FitData, Layout]:
    one = fit_data(made, 0, np.ones(len(made.time), dtype=bool), SPLINE)
    return one, make_layout(SPLINE, [made], [len(one.error.knots)])


def test_a_straight_error_has_the_mean_and_the_drift_of_the_line(made: Observations) -> None:
    one, at = prepared(made)
    found = quantities(at.index["force", 0], [one])
    middle = float(np.mean(made.time))
    line = np.stack([0.03 + 0.02 * (one.error.knots - middle), -0.01 - 0.004 * (one.error.knots - middle)], axis=1)
    np.testing.assert_allclose(found.weights @ line.ravel(), [0.03, -0.01, 0.02, -0.004], atol=1e-12)
    assert [label.partition(": ")[2] for label in found.labels] == [
        "mean force error x",
        "mean force error y",
        "force drift x",
        "force drift y",
    ]
    assert found.units == ("N", "N", "N/s", "N/s")


def test_any_other_block_is_said_as_it_is(made: Observations) -> None:
    one, at = prepared(made)
    found = quantities(at.index["turn", -1], [one])
    assert found.labels == ("tag 1 turn", "tag 2 turn", "tag 3 turn")
    np.testing.assert_array_equal(found.weights, np.eye(3))


def test_a_bias_that_no_rest_shows_is_found_with_its_doubt(made: Observations) -> None:
    biased = with_source(
        replace(made, force=made.force + np.array([0.0, 0.04]), force_sd=np.full(2, 0.02)), clean_force=None
    )
    found = {
        one.name.partition(": ")[2]: one
        for one in fit([biased], 0.02, settings=replace(IDEAL, functions=8)).nuisances()
    }
    bias = found["mean force error y"]
    assert bias.sd < 0.5 * bias.prior_sd
    assert abs(bias.value - 0.04) < 3.0 * bias.sd
    assert bias.value > 3.0 * bias.sd
    assert found["force drift y"].unit == "N/s"


def test_an_error_under_load_declared_to_be_none_is_none(made: Observations) -> None:
    one, _ = prepared(with_stated(made, load_error_sd=0.0))
    usual, _ = prepared(made)
    assert one.error.noise.load == 0.0
    assert usual.error.noise.load > 0.0


def test_what_trades_off_is_what_is_reported(made: Observations) -> None:
    posterior = fit([made], 0.02, settings=replace(IDEAL, functions=8))
    names, _ = correlations(posterior)
    assert names[1:] == [one.name for one in posterior.nuisances()]


def test_the_tags_turns_have_the_tolerance_of_the_recording(made: Observations) -> None:
    def turns(one: Observations) -> Block:
        return make_layout(SPLINE, [one], [0]).index["turn", -1]

    np.testing.assert_allclose(turns(made).prior_sd, np.deg2rad(1.5))
    np.testing.assert_allclose(turns(with_stated(made, turn_sd=0.1)).prior_sd, 0.1)
    assert turns(with_stated(made, turn_sd=0.0)).start < 0


def test_tags_that_sit_exactly_give_the_shape_at_rest(made: Observations) -> None:
    bent = with_stated(made, rest="unknown", placement_sd=0.0, turn_sd=0.0)
    assert np.all(np.isfinite(at_rest(bent).theta0))
    away = beam_points(bent, at_rest(bent))[0] - bent.xy
    assert np.max(np.abs(away)) < 1e-4
