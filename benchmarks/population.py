"""Populations: whether the bands hold what they say over made trials, and what is asked beside them."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.stiffness import Table
from onebend.lab.filming import marker_recording
from onebend.many.batch import run_batch, summary_of, write_batch
from onebend.many.population import (
    Curves,
    Fit,
    banded,
    differences,
    fit,
    group_means,
    outliers,
    read_batch,
    shares,
    shrunken,
)
from onebend.records import Array
from tests.many.made_trials import Made, Truth, made
from tests.many.stems import bench

TRIALS, PLACES = 500, 11
LEARNED, SIZE = 4, 4  # trials that are learned from marker tracks, and objects of each of their two groups


def truth_of(rng: np.random.Generator) -> Truth:
    """One to three groups of three to ten objects, whose spread is from a tenth to five times the fits' errors."""
    noise = float(np.exp(rng.uniform(np.log(0.01), np.log(0.1))))
    level = noise * float(np.exp(rng.uniform(np.log(0.1), np.log(5.0))))
    return Truth(
        sizes=tuple(rng.integers(3, 11, int(rng.integers(1, 4))).tolist()),
        level_sd=level,
        shape_sd=level * float(rng.uniform(0.1, 1.0)),
        length=float(np.exp(rng.uniform(np.log(0.1), np.log(0.6)))),
        noise=noise,
        places=PLACES,
    )


def main(trials: int = TRIALS, learned: int = LEARNED) -> None:
    """The tables of the page."""
    coverage(trials)
    repeated(max(trials // 10, 2))
    if learned:
        through_learning(learned)


def held(curves: Curves, true: Array) -> float:
    """Share of the places at which the band holds the truth."""
    return float(np.mean((curves.low < true) & (true < curves.high)))


def coverage(trials: int) -> None:
    rows: dict[str, list[tuple[float, float]]] = {}
    alarms, groups, found_far, far_trials = 0, 0, 0, 0
    for i in range(trials):
        rng = np.random.default_rng([1, i])
        truth = truth_of(rng)
        one = made(truth, 10_000 + i)
        found = fit(one.trial)
        means, small = group_means(found), min(truth.sizes) <= 4
        for name, curves, true in _pairs(found, means, one):
            width = float(np.median(curves.high - curves.low)) / 2.0
            rows.setdefault(name, []).append((held(curves, true), width))
            if name == "mean of a group" and small:
                rows.setdefault("the same, a group of 3 or 4 in the trial", []).append((held(curves, true), width))
        named = outliers(found)
        for group in range(one.trial.groups):
            groups += 1
            alarms += any(why for why, at in zip(named, one.trial.group_of, strict=True) if at == group)
        if i % 5 == 0 and truth.sizes[0] >= 5:
            log_k = one.trial.log_k.copy()
            log_k[0] += 5.0 * np.hypot(truth.level_sd, truth.noise)
            far_trials += 1
            found_far += bool(outliers(fit(replace(one.trial, log_k=log_k)))[0])
    print("## Bands\n")
    print(
        f"{trials} made trials of one to three groups of three to ten objects, without learning: spread within groups"
    )
    print("from a tenth to five times the fits' errors, correlation along s from 0.1 to 0.6.\n")
    print("| 95 % band | holds the truth [% of places] | +- (a standard error) | half width, median [%] |")
    print("| --- | --- | --- | --- |")
    for name, values in rows.items():
        hits, widths = np.array(values).T
        error = hits.std() / np.sqrt(len(hits))
        print(f"| {name} | {100 * hits.mean():.1f} | {100 * error:.1f} | {100 * np.median(widths):.1f} |")
    print(f"\nGroups in which nothing differs that name an object: {100 * alarms / groups:.1f} % of {groups}. Objects")
    print(f"five sd off (spread and error together), in groups of 5 to 10: {found_far} of {far_trials} named.\n")


def _pairs(found: Fit, means: Curves, one: Made) -> list[tuple[str, Curves, Array]]:
    pairs = [("mean of a group", means, one.means)]
    if one.trial.groups > 1:
        ratio = one.means[0] - one.means[1]
        pairs.append(("ratio of two means", differences(found, [(0, 1)]), ratio[None]))
    pairs.append(("an object, drawn to its group", banded(shrunken(found), 0.0), one.objects))
    return pairs


def repeated(trials: int) -> None:
    """Repeatability and the share between groups."""
    hits, values = [], []
    for i in range(trials):
        rng = np.random.default_rng([2, i])
        lasting, between = rng.uniform(0.2, 0.9, 2)
        truth = Truth((3,) * 8, 2, lasting=float(lasting), between=float(between), places=5)
        found = shares(fit(made(truth, 20_000 + i).trial))
        ratio = between / (1.0 - between)
        pairs = ((found.repeatability, lasting), (found.between, ratio / (ratio + lasting)))
        hits.append([one.low < true < one.high for one, true in pairs])
        values.append([abs(one.value - true) for one, true in pairs])
    print("## Shares\n")
    print(f"{trials} made trials of eight groups of three objects, each recorded twice.\n")
    print("| | 95 % interval holds it [%] | off, median |")
    print("| --- | --- | --- |")
    for i, name in enumerate(("repeatability", "share between groups")):
        print(f"| {name} | {100 * np.mean(hits, axis=0)[i]:.0f} | {np.median(values, axis=0)[i]:.2f} |")
    print()


def through_learning(trials: int) -> None:
    """Stems drawn from two groups, filmed as marker tracks, learned by a batch."""
    rows = []
    s = np.linspace(0.0, 1.0, 21)
    for i in range(trials):
        rng = np.random.default_rng([5, i])
        with tempfile.TemporaryDirectory() as name:
            stems, out = Path(name) / "stems", Path(name) / "out"
            centre = {group: np.log(0.1) + rng.uniform(-0.4, 0.4) + rng.uniform(-1.0, -0.3) * s for group in "ab"}
            objects = {}
            for group, mean in centre.items():
                for j in range(SIZE):
                    log_k = mean + 0.1 * rng.standard_normal() + 0.1 * rng.standard_normal() * (s - 0.5)
                    objects[f"{group}/{j}"] = log_k
                    beam = Beam(0.15, Table(tuple(s.tolist()), tuple(np.exp(log_k).tolist())))
                    scale = float(np.exp(log_k.mean())) / 0.085
                    marker_recording(bench(beam, scale=scale, name=f"{j}"), stems / group / f"{j}", seed=100 * i + j)
            outcome = run_batch(stems, out, workers=1)
            write_batch(outcome, summary_of(outcome))
            found = read_batch(out, "group")
            fitted = fit(found.trial)
            told = found.identified >= 0.5
            means, curves = group_means(fitted), banded(shrunken(fitted), found.trial.common_sd)
            true = np.array([centre[group] for group in found.groups])
            each = np.array([objects[name] for name in found.objects])
            inside = (means.low < true) & (true < means.high)
            own = (curves.low < each) & (each < curves.high)
            rows.append(
                (inside[told].mean(), inside.mean(), own.mean(), 0.5 * np.median((means.high - means.low)[told]))
            )
    print("## Through the learning\n")
    print(f"{trials} trials of two groups of {SIZE} stems, each learned from its own marker tracks (38 frames): sd of")
    print("the level 10 %, of the slope 10 %. % of places at which the 95 % band holds the truth.\n")
    print("| trial | mean of a group, where the data tell k | everywhere | an object | half width of a mean [%] |")
    print("| --- | --- | --- | --- | --- |")
    for i, row in enumerate([*rows, np.mean(rows, axis=0)]):
        cells = " | ".join(f"{100 * value:.0f}" for value in row[:3])
        print(f"| {i + 1 if i < len(rows) else 'all'} | {cells} | {100 * row[3]:.1f} |")


def _options(words: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=TRIALS, help="made trials")
    parser.add_argument("--learned", type=int, default=LEARNED, help="trials through the learning")
    return parser.parse_args(words)


if __name__ == "__main__":
    options = _options()
    main(options.trials, options.learned)
