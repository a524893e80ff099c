"""Outliers of a population."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.many.population import fit, outliers
from tests.many.made_trials import Truth, made


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


@pytest.mark.slow
def test_few_groups_in_which_nothing_differs_name_one() -> None:
    named = [any(outliers(fit(made(Truth(sizes=(5,), places=3), 100 + i).trial))) for i in range(40)]
    assert sum(named) <= 6  # of 40 at 5 %: more has a chance of 1 %


def test_a_group_of_two_names_nobody() -> None:
    trial = made(Truth(sizes=(2, 6), places=3), 2).trial
    log_k = trial.log_k.copy()
    log_k[0] += 3.0
    assert not outliers(fit(replace(trial, log_k=log_k)))[0]
