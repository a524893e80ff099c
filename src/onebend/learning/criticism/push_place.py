"""Where the push acts, asked of the whole recording: the evidence at other places than the one written down.

The moment of a push is its force times the way to it, so to first order a push said at a' that acts at a makes k(s)
wrong by `(a' - s) / (a - s)`: zero or infinite at the nearer of the two. Such a k hardly misses the tags, but none like
it is expected of a beam. So the evidence is compared, in which the prior of k takes part: the fit is made again with
the push at places farther and farther from the written one, on a few frames, from the fit that was found.

A place that was written down is wrong with a small probability, and then may be anywhere. The places make a mixture
with weights by that and by the evidence. About the fit at the written place its second moment is the posterior's
covariance and `sum_j w_j d_j d_j'`, d_j being how far the parameters are from it with the push at place j. So what the
recording cannot tell stands in the band; where another place has far more evidence, the written one is accused.
Where no test of the fit's model gives a reason, places on either side are asked first, and mostly that is the end.

Farther out than the written place the fit has to explain tags that nothing bent, and what a real beam and bench do
beyond the model speaks for such places by up to 22 of the log evidence where the written place was right. So out there
only far more counts, and less than that does not widen the band.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from onebend.errors import LearningError
from onebend.learning.criticism.criticism import Criticism
from onebend.learning.inference.descent import MapEstimate, rows_of
from onebend.learning.inference.fit_problem import FitProblem
from onebend.learning.inference.hyperparameters import Evidence
from onebend.learning.inference.joint_covariance import JointCovariance
from onebend.learning.inference.linear_gaussian import data_information
from onebend.learning.inference.optimizer import OptimizerSettings, Optimum, find_maximum
from onebend.learning.inference.stages import FitSettings, carried_over, first_problem
from onebend.progress import Silent
from onebend.records import Array

MISTAKEN = 0.3  # of the weight before the data is for other places: not how often people err, but what the band holds
AT_TIP = 0.5  # of that for the tip, where most pushes act; the rest is even between INNERMOST and the tip
INNERMOST = 0.3  # s: nobody pushes a cantilever nearer to its clamp
ACCUSED = 12.0  # of the log evidence: by so much more the written place is not believed. Right ones came to 9
ACCUSED_BEYOND = 40.0  # the same by places farther out
LIKELY = 0.05  # weight of a place, or of several together, that is worth a word
_REASON = -1.0  # log10 p of the test of the place from which on the evidence is asked
_STEPS = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])  # of the length, away from the written place
_FIRST = 0.1  # of the length: where it is asked first
_WORSE = -3.0  # of the log evidence there: the written place is then well known
_FRAMES = 50  # that are fitted
_ROUNDS = OptimizerSettings(most_steps=20, coarse_rounds=0, rounds=4, on_the_way=0.3, tolerance=0.3)
_HOPELESS = 12.0  # of the log evidence, below the best place: places beyond are worse still
_NEAR = 0.03  # of the length: so near to a push nothing bends, and the ratio of two moments tells nothing
_LARGEST = 10.0  # of k over that at another place, to begin with
_TOLERANCES = 4.0  # sds of the written place within which another one is as written


@dataclass(frozen=True)
class PlaceSearch:
    """Other places of the push than the written one, and what speaks for them."""

    written: float
    s: Array  # (n,) places that were tried
    gain: Array  # (n,) of the log evidence, over the written place; minus infinity where it does not count
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


@dataclass(frozen=True)
class _Tried:
    place: float
    problem: FitProblem
    estimate: MapEstimate
    log_evidence: float


def doubtful(criticism: Criticism) -> bool:
    """Whether a test of the fit's model gives a reason to doubt the place of the push."""
    places = [one.score.log10_p for one in criticism.findings if one.score.suspect.name == "push place"]
    return bool(criticism.striking) or any(p < _REASON for p in places)


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
    few = replace(settings, first_frames=_FRAMES)
    found_there = MapEstimate(optimum.x, optimum.hyperparameters, optimum.predictions)
    here = _tried(problem, found_there, written, written, few)
    if here is None:
        return None
    found = []
    for side in (-1.0, 1.0):
        if thorough or _likely_beside(here, side, few):
            found += [*_outwards(here, side, few)]
    if not found:
        return None
    s = np.array([one.place for one in found])
    gain = counted(s, np.array([one.log_evidence for one in found]) - here.log_evidence, written)
    away = np.stack([_away(problem, here, one, length) for one in found])
    far = np.abs(s - written) * length > _TOLERANCES * block.prior_sd[0]
    weight, accused = _weights(s, gain, written), bool(np.any(far & (gain > ACCUSED)))
    return PlaceSearch(written, s, gain, weight, away, accused)


def counted(s: Array, gain: Array, written: float) -> Array:
    """(n,) the gains at places s (n,), without those farther out than the written place that are not large enough."""
    return np.where((s > written) & (gain <= ACCUSED_BEYOND), -np.inf, gain)


def _likely_beside(here: _Tried, side: float, settings: FitSettings) -> bool:
    place = min(here.place + side * _FIRST, 1.0)
    if abs(place - here.place) < 0.5 * _STEPS[0]:
        return False
    beside = _tried(here.problem, here.estimate, here.place, place, settings)
    return beside is not None and beside.log_evidence > here.log_evidence + _WORSE


def with_places(optimum: Optimum, search: PlaceSearch | None) -> Optimum:
    """The optimum, its covariance with what is not known of the place of the push."""
    if search is None:
        return optimum
    (pair,), covariance = optimum.covariance.pairs, optimum.covariance
    wider = pair + (search.away.T * search.weight) @ search.away
    return replace(optimum, covariance=JointCovariance(covariance.shared, (wider,), covariance.parts))


def _outwards(here: _Tried, side: float, settings: FitSettings) -> Iterator[_Tried]:
    """Place after place on one side of the written one, until the evidence has dropped for good."""
    last, most, before = here, here.log_evidence, here.place
    for step in _STEPS:
        place = float(np.clip(here.place + side * step, INNERMOST, 1.0))
        if abs(place - before) < 0.5 * _STEPS[0]:
            return
        before = place
        tried = _tried(last.problem, last.estimate, last.place, place, settings)
        if tried is None:
            return
        yield tried
        most = max(most, tried.log_evidence)
        if tried.log_evidence < most - _HOPELESS:
            return
        last = tried


def _tried(problem: FitProblem, near: MapEstimate, before: float, place: float, settings: FitSettings) -> _Tried | None:
    """The fit of a few frames with the push at `place`, from one with it at `before`; None where there is none."""
    o = problem.recordings[0].observations
    moved = replace(o, push_s=np.where(np.isfinite(o.push_s), place, o.push_s))
    try:
        few, _ = first_problem([moved], 1.0, settings)
        few = replace(few, level=problem.level)
        x, p = near.x.copy(), problem.layout.spline.count
        x[:p] += few.layout.spline.nearest(lambda s: _log_ratio(s, before, place))
        begin = carried_over(problem, replace(near, x=x), few, [0])
        estimate = find_maximum(few, begin, _ROUNDS, Silent())
        told = data_information(few, rows_of(estimate), estimate.x, estimate.hyperparameters)
        evidence = Evidence(few, told).posterior(estimate.hyperparameters).log_evidence
    except (LearningError, np.linalg.LinAlgError):
        return None
    return _Tried(place, few, estimate, evidence) if np.isfinite(evidence) else None


def _log_ratio(s: Array, before: float, after: float) -> Array:
    """(S,) log of the moments of a push at `after` over those of one at `before`; as at its end beyond both."""
    inside = np.minimum(s, min(before, after) - _NEAR)
    ratio = np.maximum(after - inside, _NEAR) / np.maximum(before - inside, _NEAR)
    return np.asarray(np.log(np.clip(ratio, 1.0 / _LARGEST, _LARGEST)))


def _weights(s: Array, gain: Array, written: float) -> Array:
    """(n,) of the places tried: each stands for those nearer to it than to another one."""
    order = np.argsort(s)
    every = np.sort(np.append(s, written))
    edges = np.concatenate([[INNERMOST], 0.5 * (every[1:] + every[:-1]), [1.0]])
    own = np.diff(edges)[np.searchsorted(every, s[order])]
    share = MISTAKEN * ((1.0 - AT_TIP) * own / (1.0 - INNERMOST) + AT_TIP * (s[order] == 1.0))
    most = max(float(np.max(gain)), 0.0)
    weight = share * np.exp(gain[order] - most)
    out = np.zeros(len(s))
    out[order] = weight / (np.sum(weight) + (1.0 - MISTAKEN) * np.exp(-most))
    return out


def _away(problem: FitProblem, here: _Tried, there: _Tried, length: float) -> Array:
    """(P,) of the parameters, between two places of the push; the place itself is counted from the written one."""
    out = np.zeros(problem.layout.size)
    for key, block in problem.layout.index.items():
        one, other = here.problem.layout.index[key], there.problem.layout.index[key]
        if min(block.start, one.start, other.start) < 0 or len({len(b.prior_sd) for b in (block, one, other)}) > 1:
            continue
        out[block.where] = there.estimate.x[other.where] - here.estimate.x[one.where]
    out[problem.layout.index["place", 0].where] += (there.place - here.place) * length
    return out
