"""Where the push acts, asked of the whole recording: the evidence at other places than the one written down.

The moment of a push is its force times the way to it, so to first order a push said at a' that acts at a makes k(s)
wrong by `(a' - s) / (a - s)`: zero or infinite at the nearer of the two. Such a k hardly misses the tags, but none like
it is expected of a beam. So the evidence is compared, in which the prior of k takes part: the fit is made again with
the push at places farther and farther from the written one, on a few frames (`place_evidence.py`), first under the
noise of the fit at the written place, then under that of the best.

A place that was written down is wrong with a small probability, and then may be anywhere. The places make a mixture
with weights by that and by the evidence. About the fit at the written place its second moment is the posterior's
covariance and `sum_j w_j d_j d_j'`, d_j being how far the parameters are from it with the push at place j. So what the
recording cannot tell stands in the band; where another place has far more evidence, the written one is accused.
Where no test of the fit's model gives a reason, places on either side are asked first, and mostly that is the end.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from onebend.learning.criticism.criticism import ALARM, Criticism
from onebend.learning.criticism.place_evidence import AtPlace, at_written, moved, under, with_own_noise
from onebend.learning.inference.fit_problem import FitProblem
from onebend.learning.inference.joint_covariance import JointCovariance
from onebend.learning.inference.optimizer import Optimum
from onebend.learning.inference.stages import FitSettings
from onebend.learning.model.parameters import Layout
from onebend.records import Array

MISTAKEN = 0.3  # of the weight before the data is for other places: not how often people err, but what the band holds
AT_TIP = 0.5  # of that for the tip, where most pushes act; the rest is even between INNERMOST and the tip
INNERMOST = 0.3  # s: nobody pushes a cantilever nearer to its clamp
# Of the log evidence: by so much more the written place is not believed. The chance that a right place loses by as much
# is at most `exp` of minus this (Markov's inequality), as small as that beyond which other tests count.
ACCUSED = -float(np.log(10.0)) * ALARM
FAR = float(np.sqrt(2.0 * ACCUSED))  # sds: there the place's own prior has fallen as far
LIKELY = 0.05  # weight of a place, or of several together, that is worth a word
_REASON = -1.0  # log10 p of the test of the place from which on the evidence is asked
_STEPS = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])  # of the length, away from the written place
_FIRST = 0.1  # of the length: where it is asked first
_WORSE = -3.0  # of the log evidence there: the written place is then well known
_HOPELESS = 12.0  # of the log evidence, below the best place: places beyond are worse still
_TOLERANCES = 4.0  # sds of the written place within which another one is as written


@dataclass(frozen=True)
class PlaceSearch:
    """Other places of the push than the written one, and what speaks for them."""

    written: float
    s: Array  # (n,) places that were tried
    gain: Array  # (n,) of the log evidence, over the written place
    weight: Array  # (n,) probability of the places; that of the written one is what is left
    away: Array  # (n, P) of the parameters, from where they are with the push at the written place
    accused: bool  # the push hardly acts where it is said to

    @property
    def open(self) -> bool:
        """Whether another place than the written one is likely enough to be said."""
        return bool(np.sum(self.weight) > LIKELY)

    @property
    def range(self) -> tuple[float, float]:
        """Between these places the push is likely to act."""
        every, weight = np.append(self.s, self.written), np.append(self.weight, 1.0 - np.sum(self.weight))
        likely = every[weight > min(LIKELY, float(np.max(weight)) / 2.0)]
        return float(np.min(likely)), float(np.max(likely))


def doubtful(criticism: Criticism) -> bool:
    """Whether a test of the fit's model gives a reason to doubt the place of the push."""
    places = [one.score.log10_p for one in criticism.findings if one.score.suspect.name == "push place"]
    return bool(criticism.striking) or any(p < _REASON for p in places)


def moved_off(layout: Layout, mean: Array) -> float:
    """Sds by which the fit itself takes a push away from its written place, the farthest of all recordings."""
    blocks = [block for block in layout.blocks if block.name == "place" and block.start >= 0]
    return max((float(np.max(np.abs(mean[one.where]) / one.prior_sd)) for one in blocks), default=0.0)


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # on the way to places that cannot be
def search_place(
    problem: FitProblem, optimum: Optimum, settings: FitSettings, *, thorough: bool = True
) -> PlaceSearch | None:
    """The evidence at other places than the written one; None where nothing is written of one place, where several
    recordings are learned from, where the film shows the tool at the written place, or, unless `thorough`, where the
    places on either side are far less likely."""
    (first, *others), layout = problem.recordings, problem.layout
    block = layout.index["place", 0]
    places = first.push_s[np.any(first.force != 0.0, axis=1)]
    one_place = not others and block.start >= 0 and len(places) > 0 and float(np.ptp(places)) == 0.0
    if not one_place or first.observations.source.place_seen:
        return None
    written, length = float(places[0]), first.observations.length
    here = at_written(problem, optimum, written, settings)
    found: list[AtPlace] = []
    if here is not None:
        for side in (-1.0, 1.0):
            if thorough or _likely_beside(here, side, settings):
                found += [*_outwards(here, side, settings)]
    if here is None or not found:
        return None
    here, found = _under_noise_of_best(here, found)
    s = np.array([one.place for one in found])
    gain = np.array([one.log_evidence for one in found]) - here.log_evidence
    away = np.stack([_away(problem, here, one, length) for one in found])
    far = np.abs(s - written) * length > _TOLERANCES * block.prior_sd[0]
    weight, accused = _weights(s, gain, written), bool(np.any(far & (gain > ACCUSED)))
    return PlaceSearch(written, s, gain, weight, away, accused)


def _under_noise_of_best(here: AtPlace, found: list[AtPlace]) -> tuple[AtPlace, list[AtPlace]]:
    """The fits at the written place and at others, under the noise that is left where the evidence is greatest: a wrong
    place takes what it misses for noise."""
    best = max(found, key=lambda one: one.log_evidence)
    if best.log_evidence <= here.log_evidence:
        return here, found
    settled = with_own_noise(best)
    again = None if settled is None else under(here, settled.estimate.hyperparameters)
    if settled is None or again is None:
        return here, found
    every = [under(one, settled.estimate.hyperparameters) for one in found if one is not best]
    return again, [settled, *(one for one in every if one is not None)]


def _likely_beside(here: AtPlace, side: float, settings: FitSettings) -> bool:
    place = min(here.place + side * _FIRST, 1.0)
    if abs(place - here.place) < 0.5 * _STEPS[0]:
        return False
    beside = moved(here, place, settings)
    return beside is not None and beside.log_evidence > here.log_evidence + _WORSE


def with_places(optimum: Optimum, search: PlaceSearch | None) -> Optimum:
    """The optimum, its covariance with what is not known of the place of the push."""
    if search is None:
        return optimum
    (pair,), covariance = optimum.covariance.pairs, optimum.covariance
    wider = pair + (search.away.T * search.weight) @ search.away
    return replace(optimum, covariance=JointCovariance(covariance.shared, (wider,), covariance.parts))


def _outwards(here: AtPlace, side: float, settings: FitSettings) -> Iterator[AtPlace]:
    """Place after place on one side of the written one, until the evidence has dropped for good."""
    last, most = here, here.log_evidence
    for step in _STEPS:
        place = float(np.clip(here.place + side * step, INNERMOST, 1.0))
        if abs(place - last.place) < 0.5 * _STEPS[0]:
            return
        tried = moved(last, place, settings)
        if tried is None:
            return
        yield tried
        most = max(most, tried.log_evidence)
        if tried.log_evidence < most - _HOPELESS:
            return
        last = tried


def _weights(s: Array, gain: Array, written: float) -> Array:
    """(n,) of the places tried: each stands for those nearer to it than to another one."""
    order = np.argsort(s)
    every = np.sort(np.append(s, written))
    edges = np.concatenate([[INNERMOST], 0.5 * (every[1:] + every[:-1]), [1.0]])
    own = np.diff(edges)[np.searchsorted(every, s[order])]
    share = MISTAKEN * ((1.0 - AT_TIP) * own / (1.0 - INNERMOST) + AT_TIP * (s[order] > 1.0 - 1e-9))
    most = max(float(np.max(gain)), 0.0)
    weight = share * np.exp(gain[order] - most)
    out = np.zeros(len(s))
    out[order] = weight / (np.sum(weight) + (1.0 - MISTAKEN) * np.exp(-most))
    return out


def _away(problem: FitProblem, here: AtPlace, there: AtPlace, length: float) -> Array:
    """(P,) of the parameters, between two places of the push; the place itself is counted from the written one."""
    out = np.zeros(problem.layout.size)
    for key, block in problem.layout.index.items():
        one, other = here.problem.layout.index[key], there.problem.layout.index[key]
        if min(block.start, one.start, other.start) < 0 or len({len(b.prior_sd) for b in (block, one, other)}) > 1:
            continue
        out[block.where] = there.estimate.x[other.where] - here.estimate.x[one.where]
    out[problem.layout.index["place", 0].where] += (there.place - here.place) * length
    return out
