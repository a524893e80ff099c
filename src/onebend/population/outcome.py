"""All that `onebend population` says."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from onebend.errors import ResultsError
from onebend.population.curves import Curves, Objects, banded, differences, group_means, next_object, shrunken, within
from onebend.population.fit import fit
from onebend.population.needed import NUMBERS, foretold, half_band, needed
from onebend.population.outliers import outliers
from onebend.population.reading import Named
from onebend.population.shares import Shares, shares
from onebend.population.tolerance import Judgement, Tolerance, inside_of, judge
from onebend.records import Array, BoolArray

WISHED = 0.05  # half band of a group's mean, as a share of k
MOST_COMPARED = 12  # groups whose every pair is compared; of more, each with the first


@dataclass(frozen=True)
class PopulationSettings:
    """What is asked."""

    by: str = "group"
    same: str | None = None  # column that names the object
    wished: float = WISHED  # half band of the groups' means, as a share of k
    tolerance: Tolerance | None = None
    passes: float = 0.5  # probability of lying inside, from which an object passes


@dataclass(frozen=True)
class PopulationOutcome:
    """The answers, with the trial that they are from."""

    setting: PopulationSettings
    named: Named
    means: Curves  # of log k, G
    told: BoolArray  # (G, S) where the data of half the recordings or more tell k
    pairs: tuple[tuple[int, int], ...]  # of groups
    ratios: Curves  # of the logarithm, a pair each
    objects: Objects
    curves: Curves  # of log k, O
    within: Array  # (S,) sd of log k within groups
    shares: Shares
    outliers: tuple[str, ...]  # O reasons
    half: tuple[float, ...]  # G half bands of log k, the median over the places that are told
    bands: Array  # (G, len(NUMBERS)) the same for that many objects
    needed: tuple[float, ...]  # G objects for the wished band; inf: no number gives it
    judgement: Judgement | None
    next_inside: Array | None  # (G,) probability that one more object of the group lies inside the tolerance


def population(named: Named, setting: PopulationSettings = PopulationSettings()) -> PopulationOutcome:
    """Learn the population from its objects.

    Raises:
        ResultsError: a number that was asked for makes no sense.
    """
    if not (setting.wished > 0.0 and 0.0 < setting.passes < 1.0):
        raise ResultsError("a wished band is above 0, and a probability between 0 and 1. Correct it")
    trial, found = named.trial, fit(named.trial)
    means, told = group_means(found), named.identified >= 0.5
    groups = range(trial.groups)
    pairs = list(combinations(groups, 2))
    if trial.groups > MOST_COMPARED:
        pairs = [(i, 0) for i in groups if i]
    objects, tolerance = shrunken(found), setting.tolerance
    bands = [foretold(found, means, i, told[i]) if told[i].any() else np.full(NUMBERS[-1], np.nan) for i in groups]
    return PopulationOutcome(
        setting=setting,
        named=named,
        means=means,
        told=told,
        pairs=tuple(pairs),
        ratios=differences(found, pairs) if pairs else Curves(*[np.zeros((0, len(trial.s)))] * 3),
        objects=objects,
        curves=banded(objects, trial.common_sd),
        within=within(found),
        shares=shares(found),
        outliers=outliers(found),
        half=tuple(half_band(means, i, told[i]) for i in groups),
        bands=np.array([one[np.array(NUMBERS) - 1] for one in bands]),
        needed=tuple(needed(one, float(np.log1p(setting.wished))) for one in bands),
        judgement=None if tolerance is None else judge(objects, trial.s, trial.common_sd, tolerance, setting.passes),
        next_inside=None if tolerance is None else inside_of(next_object(found), trial.s, trial.common_sd, tolerance),
    )
