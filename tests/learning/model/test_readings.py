"""Errors that points have in common, rulers, zeros, a rest shape of each recording's own: the fit's model of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.continuation import follow
from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.problem import make_problem
from onebend.beam.statics import Equilibrium
from onebend.beam.stiffness import Uniform
from onebend.learning.allowances import BETWEEN, EVERY_ALLOWANCE
from onebend.learning.fit_data import fit_data
from onebend.learning.frames import (
    from_the_clamp,
    points_of,
    pose_whitening,
    ruler_places,
    unwhitened,
    whitened,
    whitening,
)
from onebend.learning.optimizer import FitSettings
from onebend.learning.parameters import Layout, Spline, make_layout
from onebend.learning.posterior import Posterior, fit
from onebend.learning.prediction import predict
from onebend.learning.start import start_of
from onebend.records import Array, Observations, PointMass, Readings, Source, Stated

pytestmark = pytest.mark.usefixtures("no_other_places")

LENGTH, G, DOWN = 0.5, 9.81, np.array([0.0, -1.0])
PLACES = np.array([0.2, 0.4, 0.6, 0.8, 1.0])
FORCE = np.array([0.0, 0.08, 0.16, 0.24])[:, None] * DOWN
ROD = Beam(LENGTH, Uniform(0.2), mass_per_length=Uniform(0.06))
FEW = FitSettings(functions=8, allowances=EVERY_ALLOWANCE - {BETWEEN})
EVERY = np.ones(4, dtype=bool)


def bent(beam: Beam = ROD) -> Equilibrium:
    return follow(make_problem(beam, push(FORCE) + weight(np.tile(G * DOWN, (4, 1)))))


def made(
    xy: Array, sd: float = 1e-4, readings: Readings = Readings(), s: Array = PLACES, name: str = "rod", **stated: object
) -> Observations:
    """Four poses of the rod, read to `sd`."""
    poses, m = xy.shape[:2]
    covariance = np.tile(np.diag([sd**2, sd**2, np.pi**2]), (poses, m, 1, 1))
    known: dict[str, object] = {"rest": "straight", "mass": 0.03, "placement_sd": 5e-4, "clamp_sd": 0.01, **stated}
    return Observations(
        source=Source(name),
        stated=Stated(**known),  # type: ignore[arg-type]
        length=LENGTH,
        time=np.arange(poses, dtype=float),
        frame=np.arange(poses),
        tag_id=np.arange(1, m + 1),
        marker_s=s,
        xy=xy,
        angle=np.full((poses, m), np.nan),
        covariance=covariance,
        force=FORCE,
        force_sd=np.zeros(2),
        push_s=np.ones(poses),
        loaded=np.ones(poses, dtype=bool),
        rest_xy=np.full((m, 2), np.nan),
        rest_angle=np.full(m, np.nan),
        rest_covariance=np.full((m, 3, 3), np.nan),
        gravity=np.tile(G * DOWN, (poses, 1)),
        readings=readings,
        static=True,
    )


def matern(apart: Array, half: float) -> Array:
    share = 1.678346990016661 * apart / half
    return np.asarray((1.0 + share) * np.exp(-share))


def test_errors_alike_along_the_beam_are_made_independent() -> None:
    """`W C W' = 1` for the covariance written down pair by pair; a point without x has its y alone."""
    o = made(bent().xy(PLACES), readings=Readings(error_length=0.1))
    xy = o.xy.copy()
    xy[1, 2, 0], xy[2, 3] = np.nan, np.nan
    rng = np.random.default_rng(0)
    roots = 1e-4 * rng.normal(size=(4, 5, 2, 2))
    covariance = o.covariance.copy()
    covariance[..., :2, :2] = roots @ np.swapaxes(roots, -1, -2) + 1e-9 * np.eye(2)
    measured = np.concatenate([xy, o.angle[..., None]], axis=-1)
    whiten = pose_whitening(o, measured, covariance, np.zeros((4, 5, 2)))
    assert whiten.shape == (4, 15, 15)
    alike = matern(LENGTH * np.abs(PLACES[:, None] - PLACES), 0.1)
    assert matern(np.array(0.1), 0.1) == pytest.approx(0.5)
    for pose in range(4):
        seen = np.flatnonzero(np.isfinite(measured[pose]).ravel())
        there = np.isfinite(measured[pose, :, :2])
        known = np.where(there[:, :, None] & there[:, None, :], covariance[pose, :, :2, :2], np.eye(2))
        values, vectors = np.linalg.eigh(known)
        half = (vectors * np.sqrt(values)[:, None]) @ np.swapaxes(vectors, -1, -2)
        full = np.zeros((5, 3, 5, 3))
        for i in range(5):
            for j in range(5):
                full[i, :2, j, :2] = alike[i, j] * half[i] @ half[j].T
        one = whiten[pose] @ full.reshape(15, 15) @ whiten[pose].T
        np.testing.assert_allclose(one[np.ix_(seen, seen)], np.eye(len(seen)), atol=1e-9)
        assert np.all(whiten[pose][np.setdiff1d(np.arange(15), seen)] == 0.0)
    away = np.where(np.isfinite(measured), 1e-3 * rng.normal(size=measured.shape), 0.0)
    np.testing.assert_allclose(unwhitened(whiten, whitened(whiten, away[..., None])[..., 0]), away, atol=1e-12)
    plain = pose_whitening(replace(o, readings=Readings()), measured, covariance, np.zeros((4, 5, 2)))
    np.testing.assert_array_equal(plain, whitening(measured, covariance))
    np.testing.assert_allclose(unwhitened(plain, whitened(plain, away[..., None])[..., 0]), away, atol=1e-12)


def test_errors_across_a_curve_are_alike_along_it() -> None:
    """A point has one row; a tenth of its variance is its own, the rest alike along the curve."""
    o = made(bent().xy(PLACES), readings=Readings(error_length=0.1))
    measured = np.concatenate([o.xy, np.full((4, 5, 1), np.nan)], axis=-1)
    measured[1, 2] = np.nan
    angle = bent().angle(PLACES)
    across = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    sd = 1e-4 * np.arange(1.0, 6.0)
    whiten = pose_whitening(o, measured, sd[:, None, None] ** 2 * np.eye(3) * np.ones((4, 1, 1, 1)), across)
    assert whiten.shape == (4, 15, 15)
    alike = 0.9 * matern(LENGTH * np.abs(PLACES[:, None] - PLACES), 0.1) + 0.1 * np.eye(5)
    for pose in range(4):
        rows = np.flatnonzero(np.any(whiten[pose] != 0.0, axis=1))
        seen = np.isfinite(measured[pose, :, 0])
        assert (rows // 3).tolist() == np.flatnonzero(seen).tolist()
        onto = np.zeros((15, 5))
        for i in range(5):
            onto[3 * i : 3 * i + 2, i] = across[pose, i]
        full = onto @ (sd[:, None] * alike * sd) @ onto.T
        np.testing.assert_allclose(
            (whiten[pose] @ full @ whiten[pose].T)[np.ix_(rows, rows)], np.eye(len(rows)), atol=1e-9
        )
        along = np.zeros((15, 5))
        for i in range(5):
            along[3 * i : 3 * i + 2, i] = np.cos(angle[pose, i]), np.sin(angle[pose, i])
        np.testing.assert_allclose(1e-4 * whiten[pose] @ along, 0.0, atol=1e-9)


def test_rulers_find_what_passes_beneath_them() -> None:
    """The first crossing from the clamp on; beyond the tip along its tangent."""
    solved = bent()
    x = np.tile([0.0, 0.15, 0.3, 0.499], (4, 1))
    s, over = ruler_places(solved, x)
    tip, way = solved.xy(np.ones(1))[:, 0, 0], np.cos(solved.angle(np.ones(1)))[:, 0]
    np.testing.assert_allclose(solved.xy(s)[:, :3, 0], x[:, :3], atol=1e-12)
    assert np.all(over[:, :3] == 0.0)
    np.testing.assert_allclose(tip + over[:, 3] * way, 0.499, atol=1e-12)


def test_zeroed_readings_count_from_their_pose_or_from_the_whole() -> None:
    solved = bent()
    xy = solved.xy(PLACES)
    o = made(xy - xy[2], readings=Readings(bare=2))
    predicted = points_of(o, EVERY, solved)
    np.testing.assert_allclose(from_the_clamp(o, EVERY, predicted), xy, atol=1e-14)
    without = np.array([True, True, False, True])
    np.testing.assert_allclose(from_the_clamp(o, without, predicted[without]), xy[without], atol=1e-14)


@pytest.mark.parametrize("at", ["mark", "x"])
def test_derivatives_are_those_of_differences(at: str) -> None:
    """Of rulers and zeros and of a rest shape of a recording's own, some rulers beyond the tip."""
    places = np.array([0.1, 0.2, 0.3, 0.42, 0.499])
    readings = Readings(at=at, bare=0)  # type: ignore[arg-type]
    xy = bent().xy(PLACES)
    if at == "x":
        xy = np.stack([np.broadcast_to(places, (4, 5)), xy[..., 1]], axis=-1)
    recordings = [made(xy, readings=readings, rest="unknown", rest_change_sd=0.1, name=name) for name in "ab"]
    spline = Spline(6)
    layout = make_layout(spline, recordings, [0, 0])
    data = fit_data(recordings[1], 1, EVERY, spline)
    x = 0.02 * np.random.default_rng(0).normal(size=layout.size)
    for name in ("along", "across", "origin"):
        block = layout.index[name, 1 if name == "origin" else -1]
        x[block.where] *= 0.05
    x[:6] += np.log(0.2)
    now = predict(data, layout, x, None)
    exact = now.slopes.written[:, :, :2]
    for column, i in enumerate(layout.known_to(1).tolist()):
        step = 1e-6 * np.eye(layout.size)[i]
        ahead, behind = (predict(data, layout, x + way, now.solved.q).pose for way in (step, -step))
        central = (ahead - behind)[:, :, :2] / 2e-6
        np.testing.assert_allclose(exact[..., column], central, atol=2e-6, err_msg=label(layout, i))


def label(layout: Layout, i: int) -> str:
    return next(b.labels[i - b.start] for b in layout.blocks if 0 <= b.start <= i < b.where.stop)


def learned(*recordings: Observations) -> Posterior:
    return fit(recordings, start_of(recordings, None), settings=FEW)


def holds(posterior: Posterior) -> bool:
    band = posterior.band(np.linspace(0.1, 0.7, 7))
    return bool(np.all((band.low < 0.2) & (band.high > 0.2)))


@pytest.mark.slow
def test_a_curve_whose_errors_are_alike_tells_less_than_its_points() -> None:
    """Forty points a pose, read to 1 mm, alike over 0.15 m: taken as each its own, the band misses the truth."""
    s = np.arange(1, 41) / 40
    exact = bent().xy(s)
    root = np.linalg.cholesky(matern(LENGTH * np.abs(s[:, None] - s), 0.15) + 1e-9 * np.eye(40))
    away = 1e-3 * root @ np.random.default_rng(5).normal(size=(4, 40, 2))
    alike, own = (
        learned(made(exact + away, 1e-3, Readings(error_length=way), s, stiffness_along="even", clamp_sd=1e-3)).band(
            np.array([0.5])
        )
        for way in (0.15, 0.0)
    )
    assert alike.low[0] < 0.2 < alike.high[0]
    assert not own.low[0] < 0.2 < own.high[0]
    assert np.log(alike.high[0] / alike.low[0]) > 1.5 * np.log(own.high[0] / own.low[0])


@pytest.mark.slow
def test_repeats_between_which_the_beam_took_a_set() -> None:
    """Their turn at rest differs by 0.2 rad: with a shape of its own each, k(s) is what it is."""
    sets = [replace(ROD, rest_curvature=Uniform(turn)) for turn in (-0.1, 0.1)]
    shown = [
        bent(beam).xy(PLACES) + 1e-4 * np.random.default_rng(i).normal(size=(4, 5, 2)) for i, beam in enumerate(sets)
    ]
    own = learned(*(made(xy, name=f"r{i}", rest="unknown", rest_change_sd=0.15) for i, xy in enumerate(shown)))
    assert holds(own)
    np.testing.assert_allclose(own.band(np.linspace(0.1, 0.7, 7)).k, 0.2, rtol=0.1)
    turns = [one.value for one in own.nuisances() if one.name.endswith("q0 mean")]
    assert len(turns) == 3
    assert turns[2] - turns[1] == pytest.approx(0.2, abs=0.02)
    one = learned(*(made(xy, name=f"r{i}", rest="unknown") for i, xy in enumerate(shown)))
    assert one.misses
    assert not own.misses


@pytest.mark.slow
def test_what_rides_on_the_beam_weighs() -> None:
    """Nothing but weight bends it, in one recording with a clip of 10 g near the tip: left out, k(s) is another."""
    clip, rng = PointMass(0.9, 0.01), np.random.default_rng(0)

    def recordings(told: bool) -> list[Observations]:
        out = []
        for name, masses in (("bare", ()), ("laden", (clip,))):
            sagging = follow(make_problem(replace(ROD, masses=masses), weight(np.tile(G * DOWN, (4, 1)))))
            shown = sagging.xy(PLACES) + 1e-4 * rng.normal(size=(4, 5, 2))
            o = made(shown, name=name, masses=masses if told else (), mass_along="even", clamp_sd=1e-3)
            out.append(replace(o, force=np.zeros((4, 2))))
        return out

    told, left_out = learned(*recordings(told=True)), learned(*recordings(told=False))
    assert holds(told)
    assert told.grade == "holds"
    assert told.beam.masses == ()  # the clip is no part of the beam
    assert left_out.grade == "not to be trusted"
    assert learned(recordings(told=True)[1]).beam.masses == (clip,)
