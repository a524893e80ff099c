"""Outliers, numbers of objects, tolerances: what is asked of a population beside its means."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr

from onebend.errors import OnebendError
from onebend.many.population import (
    Objects,
    Tolerance,
    fit,
    foretold,
    group_means,
    half_band,
    inside_of,
    judge,
    needed,
    next_object,
    outliers,
    read_tolerance,
    shrunken,
)
from tests.many.made_trials import Truth, made

EVERYWHERE = np.ones(5, dtype=bool)


def test_who_is_unlike_the_others_is_named_with_the_reason() -> None:
    trial = made(Truth(sizes=(8, 8), places=5), 1).trial
    log_k = trial.log_k.copy()
    log_k[3] += np.log(2.5)
    log_k[12] += np.where(trial.s > 0.6, np.log(0.4), 0.0)
    found = outliers(fit(replace(trial, log_k=log_k)))
    assert [i for i, why in enumerate(found) if why] == [3, 12]
    assert found[3].startswith("k is 2.")
    assert "the shape of k(s) is 0.5" in found[12]
    assert "at s = 0.75" in found[12] or "at s = 1" in found[12]


def test_few_groups_in_which_nothing_differs_name_one() -> None:
    named = [any(outliers(fit(made(Truth(sizes=(5,), places=3), 100 + i).trial))) for i in range(40)]
    assert sum(named) <= 6  # of 40 at 5 %: more has a chance of 1 %


def test_a_group_of_two_names_nobody() -> None:
    trial = made(Truth(sizes=(2, 6), places=3), 2).trial
    log_k = trial.log_k.copy()
    log_k[0] += 3.0
    assert not outliers(fit(replace(trial, log_k=log_k)))[0]


def test_the_foretold_band_is_that_of_a_larger_trial() -> None:
    ratios = []
    for seed in range(6):
        large = made(Truth(sizes=(24,), places=5), seed).trial
        rows = np.arange(8)
        few = replace(
            large,
            log_k=large.log_k[rows],
            covariance=large.covariance[rows],
            object_of=rows,
            group_of=large.group_of[rows],
        )
        found = fit(few)
        bands = foretold(found, group_means(found), 0, EVERYWHERE)
        assert bands[7] == pytest.approx(half_band(group_means(found), 0, EVERYWHERE), rel=1e-9)
        assert np.all(np.diff(bands[2:]) < 0.0)
        assert bands[int(needed(bands, 0.05)) - 1] <= 0.05 < bands[int(needed(bands, 0.05)) - 2]
        ratios.append(bands[23] / half_band(group_means(fit(large)), 0, EVERYWHERE))
    assert 0.75 < np.median(ratios) < 1.35


def test_what_all_share_sets_an_end_to_the_band() -> None:
    trial = replace(made(Truth(sizes=(6,), places=5), 3).trial, common_sd=0.05)
    found = fit(trial)
    bands = foretold(found, group_means(found), 0, EVERYWHERE)
    assert bands[-1] == pytest.approx(1.96 * 0.05, rel=1e-2)
    assert needed(bands, 0.05) == np.inf


def test_the_probability_of_lying_inside_is_the_normals() -> None:
    s, sd = np.linspace(0.0, 1.0, 5), 0.1
    level = Objects(np.log([[0.1] * 5, [0.12] * 5]), np.full((2, 5, 5), sd**2))
    band = Tolerance(np.array([0.0, 1.0]), np.array([0.08, 0.08]), np.array([0.12, 0.12]))
    found = inside_of(level, s, 0.0, band)
    exact = [ndtr(np.log(0.12 / k) / sd) - ndtr(np.log(0.08 / k) / sd) for k in (0.1, 0.12)]
    assert found == pytest.approx(exact, abs=0.025)
    wider = inside_of(level, s, 0.2, band)
    assert wider[0] < found[0] - 0.1
    judged = judge(level, s, 0.0, band, 0.6)
    assert judged.passed.tolist() == [True, False]
    assert judged.false_passes == pytest.approx(1.0 - found[0])
    assert judged.false_fails == pytest.approx(found[1])


def test_expected_errors_of_judgements_are_those_that_happen() -> None:
    wrong, expected, count = 0.0, 0.0, 0
    for seed in range(12):
        truth = made(Truth(sizes=(10,), places=5, noise=0.06), 200 + seed)
        means = truth.means[0]
        band = Tolerance(truth.trial.s, 0.87 * np.exp(means), 1.15 * np.exp(means))
        found = shrunken(fit(truth.trial))
        inside = inside_of(found, truth.trial.s, 0.0, band)
        right = np.all((np.exp(truth.objects) > band.low) & (np.exp(truth.objects) < band.high), axis=1)
        wrong += np.sum((inside >= 0.5) != right)
        expected += np.sum(np.minimum(inside, 1.0 - inside))
        count += len(inside)
    assert wrong == pytest.approx(expected, abs=4.0 * np.sqrt(expected))
    assert wrong < 0.3 * count


def test_the_next_object_varies_as_those_that_are_there() -> None:
    truth = made(Truth(sizes=(30,), places=5), 5)
    found = next_object(fit(truth.trial))
    sd = np.sqrt(np.diagonal(found.covariance[0]))
    assert np.all(np.abs(sd / truth.objects.std(axis=0, ddof=1) - 1.0) < 0.4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("s,low_N_m\n0,1\n", "no column high_N_m"),
        ("s,low_N_m,high_N_m\n0,1,2\n", "one line of numbers"),
        ("s,low_N_m,high_N_m\n0,1,2\n1,x,2\n", "line 3: .*x"),
        ("s,low_N_m,high_N_m\n0,2,1\n1,1,2\n", "line 2: s is from 0 to 1"),
        ("s,low_N_m,high_N_m\n1,1,2\n0,1,2\n", "line 3: s does not grow"),
        ("s,low_N_m,high_N_m\n0,nan,2\n1,1,2\n", "line 2"),
    ],
)
def test_mistakes_in_a_tolerance_are_named(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "band.csv").write_text(text)
    with pytest.raises(OnebendError, match=said):
        read_tolerance(tmp_path / "band.csv")
