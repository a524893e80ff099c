"""The region of one force whose place nobody knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from onebend.beam.loads import push
from onebend.learning.frames import whitening
from onebend.learning.sensing.forces import PLACE_PRIOR, Estimates, estimate, first, together
from onebend.learning.sensing.model import Bench
from onebend.learning.sensing.sense import SenseSettings, bench_of, priors_of, sense
from onebend.records import Array, IntArray
from tests.learning.sensing.drawn import BAND, BEAM, contacts, drawn


def log_evidence(bench: Bench, shown: Bench, frame: IntArray, found: Estimates, sd: Array) -> float:
    """Of one frame but for a constant (Laplace), from what its tags say to first order about the best fit."""
    o = bench.observations
    now = shown.predicted(shown.at(frame, found.place), found.force, None)
    seen = np.concatenate([o.xy, o.angle[..., None]], axis=-1)[frame]
    white = whitening(seen, o.covariance[frame])
    by_load = (white @ now.by_own() * sd).reshape(-1, len(sd))
    by_shared = (white @ replace(shown, root=bench.root).derivatives(now)[1]).reshape(len(by_load), -1)
    shared = np.linalg.lstsq(bench.root, shown.mean - bench.mean, rcond=None)[0]
    away = (white @ (seen - now.pose)[..., None]).ravel() + by_load @ (found.force[0] / sd) + by_shared @ shared
    whole = np.eye(len(away)) + by_load @ by_load.T + by_shared @ by_shared.T
    return float(-0.5 * (away @ np.linalg.solve(whole, away) + np.linalg.slogdet(whole)[1]))


def test_force_and_region_are_those_summed_over_a_grid_of_places() -> None:
    places, force, _ = contacts(0)
    o, _ = drawn(0, push(force, places[0]))
    settings, frame = SenseSettings(place="unknown"), np.array([3])
    bench, sd = bench_of(BEAM, o, BAND, None, settings), priors_of(BEAM, settings)
    _, found, _ = together(bench, frame, first(bench, frame, None, sd)[0], sd, seek_place=True)
    region, place, place_sd = found.covariance[0, :2, :2], found.place[0], np.sqrt(found.covariance[0, 2, 2])
    grid = place + place_sd * np.linspace(-3.5, 3.5, 11)
    log, means, covariances = [], [], []
    for at in grid[:, None]:
        begin = estimate(bench, frame, at, sd, seek_place=False, force=found.force)
        shown, said, _ = together(bench, frame, begin, sd, seek_place=False)
        log.append(log_evidence(bench, shown, frame, said, sd) - 0.5 * ((at[0] - PLACE_PRIOR[0]) / PLACE_PRIOR[1]) ** 2)
        means.append(said.force[0])
        covariances.append(said.covariance[0])
    share, each = np.exp(np.array(log) - max(log)), np.array(means)
    share /= share.sum()
    mean = share @ each
    within = np.einsum("p,pij->ij", share, np.array(covariances))
    whole = within + np.einsum("p,pi,pj->ij", share, each - mean, each - mean)
    root = np.linalg.inv(np.linalg.cholesky(region))
    assert np.linalg.norm(root @ (found.force[0] - mean)) < 0.2
    assert np.sqrt(np.linalg.eigvalsh(root @ whole @ root.T)) == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(np.linalg.eigvalsh(root @ within @ root.T))[0] < 0.8  # the place's share is what is tested
    assert place_sd == pytest.approx(np.sqrt(share @ (grid - share @ grid) ** 2), rel=0.15)


@pytest.mark.slow
def test_regions_hold_a_force_whose_place_is_sought() -> None:
    hits, placed = [], []
    for seed in range(60):
        places, near, far = contacts(seed)
        place, force = (places[1], far) if seed % 2 else (places[0], near)
        o, axes = drawn(seed, push(force, place))
        found = sense(BEAM, o, stiffness=BAND, settings=SenseSettings(place="unknown"))
        away = found.force - force @ axes.T
        distance = np.einsum("fi,fi->f", away, np.linalg.solve(found.covariance, away[..., None])[..., 0])
        hits += list(distance < chi2.ppf(0.95, 2))
        placed += list(np.abs(found.place - place) < 1.96 * found.place_sd)
    assert 0.87 < np.mean(hits) < 0.995  # frames of a run share k(s): 60 runs tell it to 0.03
    assert 0.92 < np.mean(placed) < 0.99
