"""The live learner over many pushes: what is folded away stays known, and memory does not grow."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from onebend.learning.allowances import LIVE_ALLOWANCES
from onebend.live.hyperparameters import OnlineSettings
from onebend.live.learner import OnlineLearner
from onebend.records import Array, Observations
from tests.learning.bench import MARKERS, SOFT
from tests.live.streamed_recording import IDEAL_LIVE, S, learned, many_pushes, shown

IDEAL, USUAL = IDEAL_LIVE.allowances, LIVE_ALLOWANCES
TRUTH = np.log(SOFT.stiffness(S))


@pytest.mark.slow
def test_memory_does_not_grow_and_the_past_is_kept() -> None:
    made = many_pushes(12, 30)
    learner = OnlineLearner(made.length, MARKERS, 0.03, settings=replace(IDEAL_LIVE, functions=10))
    sizes, sds = [], []
    for frames in (range(140), range(140, 420)):
        shown(learner, made, frames)
        sds.append(float(np.median(learner.stiffness.log_at(S)[1])))
        sizes.append(len(pickle.dumps(learner)))
    assert learner.frames == 420
    assert learner.doubts == ()
    assert sizes[1] < 1.1 * sizes[0]  # the search for sizes keeps some of its own, up to a bound
    assert sds[1] < sds[0]  # the sizes of the force's error are learned too, and may grow
    mean, sd = learner.stiffness.log_at(S)
    assert np.sqrt(np.mean(((mean - TRUTH) / sd) ** 2)) < 1.8  # of one drawn recording: 0.2 to 1.5 over six of them
    assert np.sqrt(np.mean(np.expm1(mean - TRUTH) ** 2)) < 0.06


@cache
def kept(allowances: frozenset[str]) -> tuple[Observations, OnlineSettings, tuple[Array, Array]]:
    """Pushes with exact data, settings, and log k with its sd where there is room for every frame."""
    made = many_pushes(8, 15, (0.0, 0.0), 0.0)
    sds = {"place": made.stated.place_sd}
    settings = replace(IDEAL_LIVE, functions=10, adapt=False, sds=sds, allowances=allowances)
    return made, settings, learned(made, 0.03, replace(settings, key_frames=300)).stiffness.log_at(S)


@pytest.mark.slow
@pytest.mark.parametrize(("keys", "start", "allowances"), [(5, 0.008, IDEAL), (8, 0.03, USUAL)])
def test_what_is_folded_is_as_if_it_were_kept(keys: int, start: float, allowances: frozenset[str]) -> None:
    """Exact data, sizes that stay: against a learner with room for every frame. A poor start does not stay in it."""
    made, settings, whole = kept(allowances)
    folded = learned(made, start, replace(settings, key_frames=keys))
    mean, sd = folded.stiffness.log_at(S)
    assert folded.doubts == ()
    assert np.max(np.abs(mean - whole[0]) / whole[1]) < 1.0
    np.testing.assert_allclose(sd, whole[1], rtol=0.2)
    assert np.sqrt(np.mean((mean - TRUTH) ** 2)) < (0.03 if allowances else 0.005)  # it is a thin beam, as few are


def test_so_it_is_where_the_sizes_are_learned() -> None:
    made = many_pushes(4, 30)
    whole = learned(made, 0.03, replace(IDEAL_LIVE, functions=10, key_frames=300)).stiffness.log_at(S)
    mean, sd = learned(made, 0.03, replace(IDEAL_LIVE, functions=10)).stiffness.log_at(S)
    assert np.max(np.abs(mean - whole[0]) / whole[1]) < 1.0
    assert abs(np.median(sd / whole[1]) - 1.0) < 0.2
