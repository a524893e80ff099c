"""The place of the push: evidence at other places than the written one.

The moment of a push is its force times its lever, so a push written at a' that acts at a makes k(s) wrong by
`(a' - s) / (a - s)`. Such a k hardly misses the tags, but the prior of k makes it unlikely. So the fit is repeated with
the push at places farther and farther from the written one, and the evidence is compared.

The band holds whether the written place is right or wrong, unless the probability of a mistake is below LEFT_OUT. Its
half width grows by the largest change of log k among the likely places. The covariance about the fit at the written
place is `C + sum_j w_j d_j d_j'`: d_j is the change of the parameters with the push at place j, of probability w_j if
the written one is wrong. Where another place has far more evidence, the written one is accused.

Where no test of the fit's model gives a reason, only the places on either side are tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.special import ndtri

from onebend.beam.stiffness import SHAPE_LEVELS, SHAPE_PLACES
from onebend.errors import LearningError
from onebend.learning import hyperparameters, optimizer, parameters, start
from onebend.learning.criticism import ALARM, Criticism
from onebend.learning.linear import FitProblem, Hyperparameters, log_k_map, prior
from onebend.learning.normal import JointCovariance
from onebend.progress import Silent
from onebend.records import PLACE_SD, Array, BoolArray

# Evidence under one noise: every place is fitted with the noise and the sizes of one fit, as the evidence depends on
# them strongly. Shared parameters are integrated out; own ones are at their maximum, since their volume depends on the
# assumed noise (quasi-likelihood; Wedderburn 1974, Liang and Zeger 1986). Errors of the model persist from frame to
# frame, so a recording counts as _FRAMES frames (coarsening; Miller and Dunson 2019).

_FRAMES = 50.0  # that a recording counts as, at most
_FITTED = 30  # frames that are fitted
_NOISE = optimizer.OptimizerSettings(most_steps=20, coarse_rounds=0, rounds=4, on_the_way=0.3, tolerance=0.3)
_ROUNDS = 3  # of a fit, each but the last with a new prior of log k after it
_FAR_BELOW = 50.0  # of the log evidence, below the best place: another prior of log k seldom adds more than a few
_NEAR = 0.03  # of the length: so near to a push nothing bends, and the ratio of two moments tells nothing
_LARGEST = 10.0  # of k over that at another place, to begin with


@dataclass(frozen=True)
class AtPlace:
    """The fit with the push at one place."""

    place: float  # s
    problem: FitProblem
    estimate: optimizer.MapEstimate
    log_evidence: float  # but for a constant, under one noise


def at_written(
    problem: FitProblem, optimum: optimizer.Optimum, place: float, settings: optimizer.FitSettings
) -> AtPlace | None:
    """The fit to some frames with the push at the written place, under its own noise; None if it fails."""
    found = optimizer.MapEstimate(optimum.x, optimum.hyperparameters, optimum.predictions)
    few = optimizer.rewritten_problem([one.observations for one in problem.recordings], problem, settings, _FITTED)
    try:
        begin = optimizer.carried_over(problem, found, few, [0])
    except LearningError:
        return None
    return under(AtPlace(place, few, begin, np.nan), coarsened(begin.hyperparameters, few))


def with_own_noise(fit: AtPlace) -> AtPlace | None:
    """The fit with noise and sizes from its own residuals."""
    try:
        estimate = optimizer.find_maximum(fit.problem, fit.estimate, _NOISE, Silent())
    except (LearningError, np.linalg.LinAlgError):
        return None
    return under(replace(fit, estimate=estimate), coarsened(estimate.hyperparameters, fit.problem))


def coarsened(found: Hyperparameters, problem: FitProblem) -> Hyperparameters:
    """With noise so large that the frames of a recording count as at most _FRAMES, means as all their frames; and with
    normal priors that do not know the data, for sites of one place do not hold at another."""
    noise = []
    for one, data in zip(found.noise, problem.recordings, strict=True):
        means = data.observations.means
        frames = int(np.sum(data.frames if means is None else means.count[data.frames]))
        wider = float(np.sqrt(max(frames / _FRAMES, 1.0)))
        noise.append(replace(one, marker=wider * one.marker, force=wider * one.force))
    return replace(found, noise=tuple(noise), sites={})


def moved(fit: AtPlace, place: float, settings: optimizer.FitSettings, most: float = -np.inf) -> AtPlace | None:
    """The fit with the push at another place, under the noise of a neighbouring fit; None if it fails.

    It begins at the neighbour's k(s), and if that fails at the best even beam. `most`: best log evidence so far.
    """
    for even in (False, True):
        begun = _begun(fit, place, settings, even=even)
        found = None if begun is None else under(begun, fit.estimate.hyperparameters, most - _FAR_BELOW)
        if found is not None and found.estimate.converged:
            return found
    return None


def under(fit: AtPlace, common: Hyperparameters, least: float = -np.inf) -> AtPlace | None:
    """The fit under another noise, with its own prior of log k; it stops once the log evidence is below `least`."""
    problem, own = fit.problem, fit.estimate.hyperparameters
    common = replace(common, part_variances=own.part_variances, chains=own.chains)
    estimate, value = replace(fit.estimate, hyperparameters=common), np.nan
    try:
        for i in range(_ROUNDS):
            now = estimate.hyperparameters
            estimate = optimizer.descend(problem, estimate, prior(problem, now), _NOISE.most_steps, _NOISE.tolerance)
            evidence = optimizer.evidence_at(problem, estimate)
            value = evidence.posterior(now).log_evidence_of_shared
            if i + 1 == _ROUNDS or not value >= least:
                break
            estimate = replace(estimate, hyperparameters=hyperparameters.with_stiffness_prior(evidence, now))
    except (LearningError, np.linalg.LinAlgError):
        return None
    return AtPlace(fit.place, problem, estimate, value) if np.isfinite(value) else None


def _begun(fit: AtPlace, place: float, settings: optimizer.FitSettings, *, even: bool) -> AtPlace | None:
    """Initial fit with the push at another place, on the same frames: k in proportion to the moment, or `even`."""
    problem, x, p = fit.problem, fit.estimate.x.copy(), fit.problem.layout.spline.count
    o = problem.recordings[0].observations
    there = replace(o, push_s=np.where(np.isfinite(o.push_s), place, o.push_s))
    try:
        other = optimizer.rewritten_problem([there], problem, settings)
        if even:
            x[:p] = optimizer.starting(other.layout, start.start_of([there], None))[0][:p]
        else:
            x[:p] += problem.layout.spline.nearest(lambda s: log_ratio(s, fit.place, place))
        begin = optimizer.carried_over(problem, replace(fit.estimate, x=x), other, [0])
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
# Gain of log evidence, averaged over the other places, that accuses the written one. The probability that a right place
# is accused is at most `exp(-ACCUSED)` (Markov's inequality).
ACCUSED = -float(np.log(10.0)) * ALARM
FAR = float(np.sqrt(2.0 * ACCUSED))  # sds: there the place's own prior has fallen as far
BY_HAND, MEASURED = 0.5, 0.01  # probability of a mistake before the data; MEASURED: stated more closely than PLACE_SD
LEFT_OUT = 0.05  # probability of a mistake below which the band does not hold it: a 95 % band leaves out as much
LIKELIER = 1.0 - LEFT_OUT  # and beyond which a warning says so
_BEYOND_DOUBT = 2.0 * ACCUSED  # gain of log evidence at one place, with which the written one is accused in any case
_HELD = 0.95  # probability of the places that are named
_REASON = -1.0  # log10 p of the test of the place from which on the evidence is asked
_STEPS = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])  # of the length, away from the written place
_WORSE = -2.0  # gain of log evidence at the first of them: below it on both sides a mistake is unlikely
_FINE = 0.005  # of the length, between places that are told apart
_HOPELESS = 12.0  # of the log evidence, below the best place: places beyond are worse still


@dataclass(frozen=True)
class PlaceSearch:
    """Other places of the push than the written one, and their evidence."""

    written: float
    s: Array  # (n,) places that were tried
    gain: Array  # (n,) of the log evidence, over the written place
    away: Array  # (n, P) of the parameters, from where they are with the push at the written place
    places: Array  # (f,) from the innermost that was tried to the outermost, close together
    weight: Array  # (f,) their probabilities if the written place is wrong
    mistaken: float  # the probability that it is
    accused: bool  # the push does not act at the stated place, beyond doubt

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
        """(f,) the most likely places, if the written one is wrong, that together have about this probability."""
        order = np.argsort(-self.weight)
        out = np.zeros(len(order), dtype=bool)
        sorted_weight = self.weight[order]
        out[order[: int(np.searchsorted(np.cumsum(sorted_weight) - 0.5 * sorted_weight, share))]] = True
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


def moved_off(layout: parameters.Layout, mean: Array) -> float:
    """Sds by which the fit itself takes a push away from its written place, the farthest of all recordings."""
    blocks = [block for block in layout.blocks if block.name == "place" and block.start >= 0]
    return max((float(np.max(np.abs(mean[one.where]) / one.prior_sd)) for one in blocks), default=0.0)


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # of fits that fail
def search_place(
    problem: FitProblem, optimum: optimizer.Optimum, settings: optimizer.FitSettings, *, thorough: bool = True
) -> PlaceSearch | None:
    """The evidence at other places than the written one.

    None without one written place, for several recordings, where the film shows the tool there, where the log or the
    film contradict the recording already, or, unless `thorough`, where the places on either side are far less likely.
    """
    (first, *others), layout = problem.recordings, problem.layout
    block = layout.index["place", 0]
    places = first.push_s[np.any(first.force != 0.0, axis=1)]
    one_place = not others and block.start >= 0 and len(places) > 0 and float(np.ptp(places)) == 0.0
    source = first.observations.source
    contradicted = any(one.doubt and one.about != "push place" for one in source.remarks)
    if not one_place or source.place_seen or contradicted:
        return None
    written, length = float(places[0]), first.observations.length
    here = at_written(problem, optimum, written, settings)
    found = [] if here is None else _every_place(here, settings, thorough=thorough)
    if here is None or not found:
        return None
    here, found = _under_noise_of_best(here, found)
    s = np.array([one.place for one in found])
    gain = np.array([one.log_evidence for one in found]) - here.log_evidence
    away = np.stack([_away(problem, here, one, length) for one in found])
    before = MEASURED if block.prior_sd[0] < 0.999 * PLACE_SD else BY_HAND
    everywhere, weight, mistaken = place_posterior(s, gain, written, block.prior_sd[0] / length, before)
    accused = gain_of_mistake(weight, mistaken, before) > ACCUSED
    return PlaceSearch(written, s, gain, away, everywhere, weight, mistaken, accused)


def _every_place(here: AtPlace, settings: optimizer.FitSettings, *, thorough: bool) -> list[AtPlace]:
    """The fits at other places; none where those on either side have far less evidence, unless `thorough`."""
    sides = [_outwards(here, side, settings) for side in (-1.0, 1.0)]
    first = [one for one in (next(side, None) for side in sides) if one is not None]
    if not thorough and all(one.log_evidence < here.log_evidence + _WORSE for one in first):
        return []
    return [*first, *(one for side in sides for one in side)]


def _under_noise_of_best(here: AtPlace, found: list[AtPlace]) -> tuple[AtPlace, list[AtPlace]]:
    """The fits at the written place and at others, under the noise of the place of greatest evidence; as they are where
    nothing depends on it: no other place is better, or one is far better under the written place's larger noise."""
    best = max(found, key=lambda one: one.log_evidence)
    if not 0.0 < best.log_evidence - here.log_evidence < _BEYOND_DOUBT:
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


def with_places(
    problem: FitProblem, optimum: optimizer.Optimum, search: PlaceSearch | None, sd: Array
) -> optimizer.Optimum:
    """The optimum with what is not known of the place of the push; `sd` (S,) of log k at SHAPE_PLACES without it.

    Beyond a band of probability p lies `1 - p`: of the places that the push has with probability `mistaken` the least
    likely `(1 - p) / mistaken` may lie there. The covariance counts what is beyond LEFT_OUT: the band widens steadily.
    """
    if search is None or not search.open:
        return optimum
    mistaken, beyond = search.mistaken, search.mistaken - LEFT_OUT
    (pair,), covariance, shifts = optimum.covariance.pairs, optimum.covariance, search.shifts
    wider = pair + beyond * (shifts.T * search.weight) @ shifts
    index, onto = log_k_map(problem)
    of_log_k = shifts[:, index] @ (problem.layout.spline.finer.basis(SHAPE_PLACES) @ onto).T  # (f, S)
    inside = [search.likely(share) for share in 1.0 - (1.0 - SHAPE_LEVELS) / mistaken]
    farthest = np.stack([np.max(np.abs(of_log_k[places]), axis=0, initial=0.0) for places in inside])
    normal = ndtri(0.5 + 0.5 * SHAPE_LEVELS)[:, None]
    wider_sd = np.sqrt(sd**2 + beyond * (search.weight @ of_log_k**2))
    shape = (optimum.shape * sd + farthest / normal) / wider_sd
    return replace(
        optimum, covariance=JointCovariance(covariance.shared, (wider,), covariance.parts), shape=np.asarray(shape)
    )


def _outwards(here: AtPlace, side: float, settings: optimizer.FitSettings) -> Iterator[AtPlace]:
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


def place_posterior(
    s: Array, gain: Array, written: float, sd: float, before: float = BY_HAND
) -> tuple[Array, Array, float]:
    """Places (f,), their probabilities (f,) if the written one is wrong, and the probability that it is.

    `gain` (n,) of log evidence at places s (n,); `before`: prior probability of a mistake. Where the tolerance of the
    written place, of this `sd`, is the likelier reason to be off, there is no mistake: the fit allows for it.
    """
    known, order = np.append(s, written), np.argsort(np.append(s, written))
    inner, outer = float(np.min(known)), float(np.max(known))
    places = np.linspace(inner, outer, int(np.ceil((outer - inner) / _FINE)) + 1)
    gains = PchipInterpolator(known[order], np.append(gain, 0.0)[order])(places)
    share = np.gradient(places) / (1.0 - INNERMOST)
    share[[0, -1]] *= 0.5
    if written < 1.0 - 0.5 * _STEPS[0]:
        share *= 1.0 - AT_TIP
        share[-1] += AT_TIP * (outer > 1.0 - 1e-9)
    tolerance = np.exp(-0.5 * ((places - written) / sd) ** 2) / (np.sqrt(2.0 * np.pi) * sd)
    share[(1.0 - before) * tolerance > before / (1.0 - INNERMOST)] = 0.0
    most = max(float(np.max(gains)), 0.0)
    evidence = share * np.exp(gains - most)
    of_mistake = max(float(np.sum(evidence)), np.finfo(float).tiny)
    return places, evidence / of_mistake, of_mistake / (of_mistake + float(np.exp(-most)) * (1.0 - before) / before)


@np.errstate(divide="ignore")  # a probability may be 1
def gain_of_mistake(weight: Array, mistaken: float, before: float = BY_HAND) -> float:
    """Gain of log evidence of a mistake that led to one of some places: `weight` (f,) of them, the probability of a
    mistake, and the prior one."""
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
