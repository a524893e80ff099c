"""k(s) from points of an outline, whose place along the body is free."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import LogSpline
from onebend.learning.allowances import EVERY_ALLOWANCE
from onebend.learning.condensed import white_share
from onebend.learning.fit_data import fit_data
from onebend.learning.frames import of_tags, pose_whitening, read_alone, with_seen_tags
from onebend.learning.instruments import instruments_of, setup_of
from onebend.learning.optimizer import FitSettings
from onebend.learning.parameters import Spline
from onebend.learning.posterior import fit
from onebend.live.hyperparameters import OnlineSettings
from onebend.live.replayed import replay
from onebend.records import END_ID, Array, Observations, Remark, left_of, read_before_fit, unit
from tests.learning.bench import IDEAL, SOFT, forces, observed
from tests.made_up import with_source

S = np.linspace(0.08, 0.98, 22)
SD = 2e-5  # m


def traced(slipped: float = 0.0, seed: int = 0) -> Observations:
    """The outline of the soft beam under a push; every point is `slipped` m farther along the body than written, and
    `SD` off across it."""
    force = forces(40)
    shape = SOFT.equilibrium(force, 1.0)
    s = np.clip(S + slipped / SOFT.length, 0.0, 1.0)
    angle = shape.angle(s)
    normal = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    noise = SD * np.random.default_rng(seed).normal(size=angle.shape)
    plain = observed(SOFT, force)
    m, rest = len(S), np.stack([SOFT.length * s, np.zeros(len(s))], axis=1)
    covariance = np.diag([SD**2, SD**2, (0.01) ** 2])
    return replace(
        plain,
        tag_id=100_000 + np.arange(m),
        marker_s=S,
        xy=shape.xy(s) + noise[..., None] * normal,
        angle=angle,
        covariance=np.tile(covariance, (len(force), m, 1, 1)),
        rest_xy=rest,
        rest_angle=np.zeros(m),
        rest_covariance=np.tile(covariance, (m, 1, 1)) / 30.0,
        traced=np.ones(m, dtype=bool),
    )


def with_end(off: float = 0.0) -> Observations:
    """The same and the body's end, `off` m beyond the tip."""
    one, force, end = traced(), forces(40), np.ones(1)
    shape = SOFT.equilibrium(force, 1.0)
    angle = shape.angle(end)
    rest = np.array([[SOFT.length + off, 0.0]])
    sd = np.diag([1e-3, 1e-3, 1.0])
    return replace(
        one,
        tag_id=np.append(one.tag_id, END_ID),
        marker_s=np.append(one.marker_s, 1.0),
        xy=np.concatenate([one.xy, shape.xy(end) + off * unit(angle)], axis=1),
        angle=np.concatenate([one.angle, angle], axis=1),
        covariance=np.concatenate([one.covariance, np.tile(sd**2, (len(force), 1, 1, 1))], axis=1),
        rest_xy=np.concatenate([one.rest_xy, rest]),
        rest_angle=np.append(one.rest_angle, 0.0),
        rest_covariance=np.concatenate([one.rest_covariance, sd[None] ** 2]),
        traced=np.ones(len(S) + 1, dtype=bool),
    )


def beside_tags() -> Observations:
    """The tags of the same push, and the outline's points between them, in the order of their places."""
    tags, points = observed(SOFT, forces(40), noise=(2e-5, 1e-3), seed=1), traced()
    order = np.argsort(np.concatenate([tags.marker_s, points.marker_s]), kind="stable")
    names = {"tag_id": 0, "marker_s": 0, "rest_xy": 0, "rest_angle": 0, "rest_covariance": 0}
    names |= {"xy": 1, "angle": 1, "covariance": 1}
    joined: dict[str, Any] = {
        name: np.take(np.concatenate([getattr(tags, name), getattr(points, name)], axis=axis), order, axis=axis)
        for name, axis in names.items()
    }
    return replace(tags, traced=order >= len(tags.marker_s), **joined)


def off(one: Observations) -> Array:
    """Of log k(s) along the body."""
    s = np.linspace(0.05, 0.9, 40)
    return np.log(fit([one], settings=IDEAL).band(s).k / SOFT.stiffness(s))


def test_k_is_found_from_an_outline_alone() -> None:
    away = off(traced())
    assert float(np.sqrt(np.mean(away**2))) < 0.05


def test_the_place_along_the_body_is_free() -> None:
    straight, slipped = off(traced()), off(traced(slipped=3e-4))
    assert float(np.max(np.abs(slipped - straight))) < 0.02


def test_only_the_distance_across_the_outline_counts() -> None:
    one = traced()
    data = fit_data(one, 0, np.ones(len(one.time), dtype=bool), Spline(9))
    rows = np.linalg.matrix_rank(data.whiten[:-1])
    assert np.all(rows == 1)
    along = np.stack([np.cos(one.angle), np.sin(one.angle)], axis=-1)
    np.testing.assert_allclose(np.einsum("fmij,fmj->fmi", data.whiten[:-1, :, :, :2], along), 0.0, atol=1e-6)
    assert len(data.tags) == 0
    assert not np.isfinite(data.measured[..., 2]).any()


def test_errors_across_the_outline_do_not_move_the_end() -> None:
    one = with_end()
    data = fit_data(one, 0, np.ones(len(one.time), dtype=bool), Spline(9), EVERY_ALLOWANCE)
    of_outline = [a.basis for a in data.allowances if a.name in ("outline", "light")]
    assert len(of_outline) == 2
    for basis in of_outline:
        assert np.any(basis[:, -2])
        assert not np.any(basis[:, -1])


def test_a_point_that_was_not_seen_counts_for_nothing() -> None:
    across = np.tile([0.0, 1.0], (2, 3, 1))
    measured = np.zeros((2, 3, 3))
    measured[0, 1] = np.nan
    whiten = pose_whitening(traced(), measured, np.tile(1e-8 * np.eye(3), (2, 3, 1, 1)), across)
    assert np.all(whiten[0, 1] == 0.0)
    np.testing.assert_allclose(whiten[1, 1, 1, :2], [0.0, 1e4])


def test_white_noise_across_is_told_as_white() -> None:
    one = traced()
    poses = np.concatenate([one.xy, one.angle[..., None]], axis=-1)
    assert 0.6 < float(np.median(white_share(one, poses))) <= 1.0


def test_without_tags_few_points_stand_for_the_outline() -> None:
    few = read_alone(traced())
    assert len(few.tag_id) == 6
    assert read_alone(few) is few
    assert read_before_fit(few).tolist() == list(range(6))


@pytest.mark.slow
def test_the_end_of_the_body_counts_along_it_and_tells_its_length() -> None:
    """One millimetre beyond the tip is a longer beam; one beside it is nothing."""
    longer, beside = with_end(1e-3), with_end()
    beside.xy[:, -1] += 1e-3 * left_of(unit(beside.angle[:, -1]))
    found = [fit([one], settings=FitSettings(allowances=frozenset({"length"}))).nuisances() for one in (longer, beside)]
    by, not_by = (next(one for one in each if one.name == "log of length") for each in found)
    assert 0.3e-3 < SOFT.length * by.value < 1.1e-3
    assert by.sd < 0.5 * by.prior_sd
    assert abs(SOFT.length * not_by.value) < 0.1e-3


@pytest.mark.slow
def test_only_the_fit_reads_the_end_of_the_body() -> None:
    one = with_end()
    assert END_ID not in read_alone(one).tag_id
    live = [replay(each, 0.03, settings=OnlineSettings(functions=12)).stiffness for each in (one, traced())]
    np.testing.assert_array_equal(live[0].log_at(S)[0], live[1].log_at(S)[0])


@pytest.mark.slow
def test_beside_tags_the_set_up_and_the_planner_speak_of_the_tags() -> None:
    both = beside_tags()
    found = fit([both], settings=IDEAL)
    tags = tuple(observed(SOFT, forces(2)).marker_s.tolist())
    planned, setup = instruments_of(found), setup_of(found)
    assert setup is not None
    assert planned.tags == setup.tags == tags
    assert planned.tag_sd.shape == (len(tags), 3)
    bent = setup.bent(found.beam, found.stiffness, both.force[-1:])
    assert bent.tags().shape == (1, len(tags), 3)


def test_without_its_outline_a_recording_shows_no_width() -> None:
    width = np.column_stack([S, np.full(len(S), 0.01)])
    assert read_alone(replace(beside_tags(), width=width)).width is None
    assert read_alone(replace(traced(), width=width)).width is width


@pytest.mark.slow
def test_an_outline_that_spoils_the_fit_is_left_out_of_it() -> None:
    both, few = beside_tags(), replace(IDEAL, functions=10, most_frames=20, first_frames=10)
    assert both.traced is not None
    far = np.where(both.traced, 2e-3, 0.0) * np.random.default_rng(0).normal(size=both.angle.shape)
    strayed = replace(both, xy=both.xy + far[..., None])
    spoilt = fit([strayed], settings=few)
    assert spoilt.without_outline
    tags = fit([read_alone(both)], settings=few)
    np.testing.assert_allclose(spoilt.stiffness.log_at(S)[0], tags.stiffness.log_at(S)[0], atol=1e-9)
    assert not fit([both], settings=few).without_outline
    doubted = Remark("warning", "The log is of another push.", doubt=True, about="axes")
    contradicted = fit([with_source(strayed, remarks=(doubted,))], settings=few)
    assert contradicted.doubts  # as they would be without the outline
    assert not contradicted.without_outline


def test_recordings_of_one_beam_keep_the_points_that_all_of_them_have() -> None:
    both = beside_tags()
    fewer = of_tags(both, both.tag_id != 100_003)
    first, second = with_seen_tags([both, fewer])
    np.testing.assert_array_equal(first.tag_id, second.tag_id)
    assert len(first.tag_id) == len(both.tag_id) - 1


def noded(height: float) -> LogSpline:
    """k(s) [N m] of a taper with a node that is stiffer by `height` in log k."""
    spline = Spline(45)
    return LogSpline(
        tuple(spline.knots.tolist()),
        tuple(spline.nearest(lambda s: -3.5 - 0.6 * s + height * np.exp(-0.5 * ((s - 0.55) / 0.04) ** 2)).tolist()),
    )


@pytest.mark.parametrize(("height", "power"), [(0.6, 3.0), (0.0, 0.0)])
def test_the_width_tells_what_tags_do_not_resolve_and_its_power_is_learned(height: float, power: float) -> None:
    """A node between two tags is in k(s) as in the width; where only a sleeve is thicker there, k(s) has none."""
    k, s = noded(height), np.linspace(0.1, 0.9, 120)
    plain = observed(Beam(0.15, k), forces(60, most=1.0), noise=(1e-4, 5e-3))
    thicker = np.column_stack([s, 0.01 * np.exp(0.2 * np.exp(-0.5 * ((s - 0.55) / 0.04) ** 2))])
    with_it, without = (fit([one], settings=IDEAL) for one in (replace(plain, width=thicker), plain))
    places = np.linspace(0.1, 0.9, 40)
    band, away = with_it.band(places), [np.log(one.band(places).k / k(places)) for one in (with_it, without)]
    assert float(np.mean((band.low <= k(places)) & (k(places) <= band.high))) > 0.9
    if height:
        assert np.std(away[0]) < 0.5 * np.std(away[1])
        live = [replay(one, 0.03).stiffness.band(places) for one in (replace(plain, width=thicker), plain)]
        told = [np.std(np.log(one.k / k(places))) for one in live]
        assert told[0] < 0.5 * told[1]
    found = next(one for one in with_it.nuisances() if one.name.startswith("power"))
    assert abs(found.value - power) < 2.5 * found.sd
    assert found.sd < 1.0
    assert all(not one.name.startswith("power") for one in without.nuisances())
