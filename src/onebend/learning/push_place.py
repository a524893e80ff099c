"""Where the push acts, asked of the whole recording: the evidence at other places than the one written down.

The moment of a push is its force times the way to it, so to first order a push said at a' that acts at a makes k(s)
wrong by `(a' - s) / (a - s)`: zero or infinite at the nearer of the two. Such a k hardly misses the tags, but none like
it is expected of a beam. So the evidence is compared, in which the prior of k takes part: the fit is made again with
the push at places farther and farther from the written one (`place_evidence.py`), first under the noise of the fit at
the written place, then under that of the best.

A place that was written wrongly may be anywhere, and how often that happens nobody knows. So the band does not go by
how likely it is, but holds in either case, unless the recording rules the mistake out: a place that has nothing to do
with the true one seldom agrees with the tags as well as a right one does. Where the probability of the mistake is left
above LEFT_OUT (before the data it is an even chance, or a small one where the place is stated more closely than a hand
puts it), the band is that with the push at any of the places that are likely then: to half its width comes the largest
change of log k among them. The covariance is that about the fit at the written place, `C + sum_j w_j d_j d_j'`, d_j
being how far the parameters are from it with the push at place j, of probability w_j if the written one is wrong. So
what the recording cannot tell stands in the band; where another place has far more evidence, the written one is
accused.

Where no test of the fit's model gives a reason, places on either side are asked first, and mostly that is the end.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.special import ndtri

from onebend.beam.stiffness import SHAPE_LEVELS, SHAPE_PLACES
from onebend.errors import LearningError
from onebend.learning.criticism import ALARM, Criticism
from onebend.learning.fit_data import FitData
from onebend.learning.hyperparameters import Evidence, with_stiffness_prior
from onebend.learning.linear import FitProblem, Hyperparameters, RecordingNoise, data_information, log_k_map, prior
from onebend.learning.normal import JointCovariance
from onebend.learning.optimizer import (
    FitSettings,
    MapEstimate,
    OptimizerSettings,
    Optimum,
    carried_over,
    descend,
    find_maximum,
    rewritten_problem,
    rows_of,
    starting,
)
from onebend.learning.parameters import Layout
from onebend.learning.start import start_of
from onebend.progress import Silent
from onebend.records import PLACE_SD, Array, BoolArray

# The evidence for a place of the push.
#
# Evidences can be compared under one noise only. The noise of the tags and of the log is not that of greatest
# evidence (its correlation in time is counted in, and it settles slowly), so the evidence goes with it to first
# order: one part in twenty of the noise is worth five of its logarithm. So every place is fitted with the noise, and
# the sizes of the force error and of the allowances, of one fit. What that fit misses counts as noise, at every place
# alike.
#
# k(s), and all that recordings share, are integrated out. What a recording has of its own (a hundred numbers of the
# log's error, mostly) is at its most probable instead: how closely the tags tell it goes by where the push acts, but
# by what is assumed of the noise too, and no bench keeps to that. So the tags have one working covariance for all
# places, and its determinant is no evidence (quasi-likelihood; Wedderburn 1974, Liang and Zeger 1986).
#
# A bench is not quite as the model says, in ways that stay from frame to frame, and more frames do not tell more of
# the place then. So a recording counts as a few frames, and the likelihood of all its frames is raised to the power
# that makes it so (coarsening; Miller and Dunson 2019). A few frames by themselves would do, but for which ones they
# are.

_FRAMES = 50.0  # that a recording counts as, at most
_NOISE = OptimizerSettings(most_steps=20, coarse_rounds=0, rounds=4, on_the_way=0.3, tolerance=0.3)
_ROUNDS = 3  # of a fit, each but the last with a new prior of log k after it
_FAR_BELOW = 50.0  # of the log evidence, below the best place: another prior of log k seldom adds more than a few
_NEAR = 0.03  # of the length: so near to a push nothing bends, and the ratio of two moments tells nothing
_LARGEST = 10.0  # of k over that at another place, to begin with


@dataclass(frozen=True)
class AtPlace:
    """The fit with the push at one place."""

    place: float  # s
    problem: FitProblem
    estimate: MapEstimate
    log_evidence: float  # but for a constant, under one noise


def at_written(problem: FitProblem, optimum: Optimum, place: float) -> AtPlace | None:
    """The fit with the push where it is written, with a noise of its own; None where there is none."""
    found = MapEstimate(optimum.x, optimum.hyperparameters, optimum.predictions)
    return with_own_noise(AtPlace(place, problem, found, np.nan))


def with_own_noise(fit: AtPlace) -> AtPlace | None:
    """The fit with noise and sizes from its own residuals."""
    try:
        estimate = find_maximum(fit.problem, fit.estimate, _NOISE, Silent())
    except (LearningError, np.linalg.LinAlgError):
        return None
    return under(replace(fit, estimate=estimate), coarsened(estimate.hyperparameters, fit.problem))


def frames_of_film(recording: FitData) -> int:
    """How many frames of the film are fitted, means counted as the frames that they are of."""
    o = recording.observations
    return int(np.sum(recording.frames if o.means is None else o.means.count[recording.frames]))


def coarsened(found: Hyperparameters, problem: FitProblem) -> Hyperparameters:
    """With noise so large that the frames of a recording tell as much as _FRAMES of them."""

    def of(noise: RecordingNoise, frames: int) -> RecordingNoise:
        wider = float(np.sqrt(max(frames / _FRAMES, 1.0)))
        return RecordingNoise(wider * noise.marker, wider * noise.force)

    each_one = zip(found.noise, problem.recordings, strict=True)
    return replace(found, noise=tuple(of(noise, frames_of_film(recording)) for noise, recording in each_one))


def moved(fit: AtPlace, place: float, settings: FitSettings, most: float = -np.inf) -> AtPlace | None:
    """The fit with the push at another place, under the noise of one beside it; None where there is none. `most`: the
    log evidence of the best place so far.

    It begins at the k(s) found there, and where that leads nowhere at the even beam that is nearest to the tags: a k(s)
    that makes up for a wrong place may be one that no step leads away from.
    """
    for even in (False, True):
        begun = _begun(fit, place, settings, even=even)
        found = None if begun is None else under(begun, fit.estimate.hyperparameters, most - _FAR_BELOW)
        if found is not None and found.estimate.converged:
            return found
    return None


def under(fit: AtPlace, common: Hyperparameters, least: float = -np.inf) -> AtPlace | None:
    """The fit under a noise that is not its own; the prior of log k stays its own. With less log evidence than `least`
    after a round it is left as it is."""
    problem, own = fit.problem, fit.estimate.hyperparameters
    common = replace(common, part_variances=own.part_variances, chains=own.chains)
    estimate, value = replace(fit.estimate, hyperparameters=common), np.nan
    try:
        for i in range(_ROUNDS):
            now = estimate.hyperparameters
            estimate = descend(problem, estimate, prior(problem, now), _NOISE.most_steps, _NOISE.tolerance)
            evidence = Evidence(problem, data_information(problem, rows_of(estimate), estimate.x, now))
            value = evidence.posterior(now).log_evidence_of_shared
            if i + 1 == _ROUNDS or not value >= least:
                break
            estimate = replace(estimate, hyperparameters=with_stiffness_prior(evidence, now))
    except (LearningError, np.linalg.LinAlgError):
        return None
    return AtPlace(fit.place, problem, estimate, value) if np.isfinite(value) else None


def _begun(fit: AtPlace, place: float, settings: FitSettings, *, even: bool) -> AtPlace | None:
    """Where to begin with the push at another place, on the same frames: as near as `fit`, k as much larger as the
    moment, or `even`."""
    problem, x, p = fit.problem, fit.estimate.x.copy(), fit.problem.layout.spline.count
    o = problem.recordings[0].observations
    there = replace(o, push_s=np.where(np.isfinite(o.push_s), place, o.push_s))
    try:
        other = rewritten_problem([there], problem, settings)
        if even:
            x[:p] = starting(other.layout, start_of([there], None))[0][:p]
        else:
            x[:p] += problem.layout.spline.nearest(lambda s: log_ratio(s, fit.place, place))
        begin = carried_over(problem, replace(fit.estimate, x=x), other, [0])
        return AtPlace(place, other, begin, np.nan)
    except (LearningError, np.linalg.LinAlgError):
        return None


def log_ratio(s: Array, before: float, after: float) -> Array:
    """(S,) log of the moments of a push at `after` over those of one at `before`; as at its end beyond both."""
    inside = np.minimum(s, min(before, after) - _NEAR)
    ratio = np.maximum(after - inside, _NEAR) / np.maximum(before - inside, _NEAR)
    return np.asarray(np.log(np.clip(ratio, 1.0 / _LARGEST, _LARGEST)))


AT_TIP = 0.5  # share of the tip, where most pushes act, if another place is written; the rest is even from INNERMOST on
INNERMOST = 0.3  # s: nobody pushes a cantilever nearer to its clamp
# Of the log evidence: by so much more, averaged over the other places, the written one is not believed. The chance that
# a right place loses by as much is at most `exp` of minus this (Markov's inequality), as small as that beyond which
# other tests count.
ACCUSED = -float(np.log(10.0)) * ALARM
FAR = float(np.sqrt(2.0 * ACCUSED))  # sds: there the place's own prior has fallen as far
BY_HAND, MEASURED = 0.5, 0.01  # probability of a mistake before the data; MEASURED: stated more closely than PLACE_SD
LEFT_OUT = 0.05  # probability of a mistake below which the band does not hold it: a 95 % band leaves out as much
LIKELIER = 1.0 - LEFT_OUT  # and beyond which a warning says so
_HELD = 0.95  # probability of the places that are named
_REASON = -1.0  # log10 p of the test of the place from which on the evidence is asked
_STEPS = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])  # of the length, away from the written place
# Of the log evidence at the first of them. Below it on both sides the tags tell the place to 0.025 of the length (sd),
# and against a right place one written at random has less than LEFT_OUT: `0.5 sqrt(2 pi) 0.025 / (1 - INNERMOST)`.
_WORSE = -2.0
_FINE = 0.005  # of the length, between places that are told apart
_HOPELESS = 12.0  # of the log evidence, below the best place: places beyond are worse still
_TOLERANCES = 4.0  # sds of the written place within which another one is as written


@dataclass(frozen=True)
class PlaceSearch:
    """Other places of the push than the written one, and what speaks for them."""

    written: float
    s: Array  # (n,) places that were tried
    gain: Array  # (n,) of the log evidence, over the written place
    away: Array  # (n, P) of the parameters, from where they are with the push at the written place
    places: Array  # (f,) from the innermost that was tried to the outermost, close together
    weight: Array  # (f,) their probabilities if the written place is wrong
    mistaken: float  # the probability that it is
    accused: bool  # the push hardly acts where it is said to

    @property
    def open(self) -> bool:
        """Whether the recording leaves it possible that the written place is wrong."""
        return self.mistaken > LEFT_OUT

    @property
    def range(self) -> tuple[float, float]:
        """Between these places the push is likely to act."""
        likely = self.places[self.likely(_HELD)]
        return float(np.min(likely)), float(np.max(likely))

    def likely(self, share: float) -> BoolArray:
        """(f,) the most likely places, if the written one is wrong, that together have this probability."""
        order = np.argsort(-self.weight)
        out = np.zeros(len(order), dtype=bool)
        out[order[: int(np.searchsorted(np.cumsum(self.weight[order]), share)) + 1]] = True
        return out

    @property
    def shifts(self) -> Array:
        """(f, P) of the parameters with the push at each of `places`, in between those that were tried."""
        order = np.argsort(self.s)
        s, at = self.s[order], int(np.searchsorted(self.s[order], self.written))
        known, away = np.insert(s, at, self.written), np.insert(self.away[order], at, 0.0, axis=0)
        right = np.clip(np.searchsorted(known, self.places), 1, len(known) - 1)
        share = ((self.places - known[right - 1]) / (known[right] - known[right - 1]))[:, None]
        return np.asarray((1.0 - share) * away[right - 1] + share * away[right])


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
    here = at_written(problem, optimum, written)
    found = [] if here is None else _every_place(here, settings, thorough=thorough)
    if here is None or not found:
        return None
    here, found = _under_noise_of_best(here, found)
    s = np.array([one.place for one in found])
    gain = np.array([one.log_evidence for one in found]) - here.log_evidence
    away = np.stack([_away(problem, here, one, length) for one in found])
    before = MEASURED if block.prior_sd[0] < 0.999 * PLACE_SD else BY_HAND
    everywhere, weight, mistaken = place_posterior(s, gain, written, before)
    far = np.abs(everywhere - written) * length > _TOLERANCES * block.prior_sd[0]
    accused = gain_of_mistake(weight[far], mistaken, before) > ACCUSED
    return PlaceSearch(written, s, gain, away, everywhere, weight, mistaken, accused)


def _every_place(here: AtPlace, settings: FitSettings, *, thorough: bool) -> list[AtPlace]:
    """The fits at other places; none where those on either side have far less evidence, unless `thorough`."""
    sides = [_outwards(here, side, settings) for side in (-1.0, 1.0)]
    first = [one for one in (next(side, None) for side in sides) if one is not None]
    if not thorough and all(one.log_evidence < here.log_evidence + _WORSE for one in first):
        return []
    return [*first, *(one for side in sides for one in side)]


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
    out = [settled]
    for one in found:
        behind = best.log_evidence - one.log_evidence
        if behind > 2.0 * _HOPELESS:  # under any noise
            out.append(replace(one, log_evidence=settled.log_evidence - behind))
        elif one is not best and (under_it := under(one, settled.estimate.hyperparameters)) is not None:
            out.append(under_it)
    return again, out


def with_places(problem: FitProblem, optimum: Optimum, search: PlaceSearch | None, sd: Array) -> Optimum:
    """The optimum with what is not known of the place of the push; `sd` (S,) of log k at SHAPE_PLACES without it."""
    if search is None or not search.open:
        return optimum
    (pair,), covariance, shifts = optimum.covariance.pairs, optimum.covariance, search.shifts
    wider = pair + (shifts.T * search.weight) @ shifts
    index, onto = log_k_map(problem)
    of_log_k = shifts[:, index] @ (problem.layout.spline.finer.basis(SHAPE_PLACES) @ onto).T  # (f, S)
    farthest = np.stack([np.max(np.abs(of_log_k[search.likely(level)]), axis=0) for level in SHAPE_LEVELS])
    normal, wider_sd = ndtri(0.5 + 0.5 * SHAPE_LEVELS)[:, None], np.sqrt(sd**2 + search.weight @ of_log_k**2)
    shape = (optimum.shape * sd + farthest / normal) / wider_sd
    return replace(
        optimum, covariance=JointCovariance(covariance.shared, (wider,), covariance.parts), shape=np.asarray(shape)
    )


def _outwards(here: AtPlace, side: float, settings: FitSettings) -> Iterator[AtPlace]:
    """Place after place on one side of the written one, until the evidence has dropped for good."""
    last, most = here, here.log_evidence
    for step in _STEPS:
        place = float(np.clip(here.place + side * step, INNERMOST, 1.0))
        place = 1.0 if 1.0 - place < 0.5 * _STEPS[0] else place
        if abs(place - last.place) < 0.5 * _STEPS[0]:
            return
        tried = moved(last, place, settings, most)
        if tried is None:
            return
        yield tried
        most = max(most, tried.log_evidence)
        if tried.log_evidence < most - _HOPELESS:
            return
        last = tried


def place_posterior(s: Array, gain: Array, written: float, before: float = BY_HAND) -> tuple[Array, Array, float]:
    """Places (f,) with their probabilities (f,) if the written one is wrong, and the probability that it is, from the
    gains of log evidence (n,) at places s (n,) and its probability before. What was not tried has no evidence."""
    known, order = np.append(s, written), np.argsort(np.append(s, written))
    inner, outer = float(np.min(known)), float(np.max(known))
    places = np.linspace(inner, outer, int(np.ceil((outer - inner) / _FINE)) + 1)
    gains = PchipInterpolator(known[order], np.append(gain, 0.0)[order])(places)
    share = np.gradient(places) / (1.0 - INNERMOST)
    share[[0, -1]] *= 0.5
    if written < 1.0 - 0.5 * _STEPS[0]:
        share *= 1.0 - AT_TIP
        share[-1] += AT_TIP * (outer > 1.0 - 1e-9)
    most = max(float(np.max(gains)), 0.0)
    evidence = share * np.exp(gains - most)
    of_mistake = float(np.sum(evidence))
    return places, evidence / of_mistake, of_mistake / (of_mistake + float(np.exp(-most)) * (1.0 - before) / before)


@np.errstate(divide="ignore")  # so sure of either that the other has none
def gain_of_mistake(weight: Array, mistaken: float, before: float = BY_HAND) -> float:
    """Of the log evidence, over the written place, of a mistake that led to one of some places: `weight` (f,) of them,
    the probability of a mistake, and that before."""
    odds = mistaken * (1.0 - before) / np.float64((1.0 - mistaken) * before)
    return float(np.log(odds * np.sum(weight)))


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
