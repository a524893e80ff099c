"""Whether one contact explains the shapes or two, and where two are.

Hypotheses are compared by their evidence (Laplace) on the same frames: forces of each frame, and all that the frames
share, k's band with it, are integrated out. One contact may act where it is said, at one place that is not known, or at
another place in each frame; two act at places that stay. Places of which nothing is known are even over the beam.

Places are sought on a grid. About shapes that explain the frames the tags are linear in the forces, wherever these act:
what changes the load much, and the shape little, is all that is looked for. So the evidence of every place, and of
every pair, is that of a normal density, of all frames at once. The best are then followed on the exact equilibria, and
the grid is looked through again about the shapes that fit best.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, solve_continuous_lyapunov, solve_triangular
from scipy.ndimage import maximum_filter

from onebend.learning.endings import RUN, ContactFrames, Edge
from onebend.learning.frames import moved_by, whitening
from onebend.learning.sensing.bench import INNERMOST, Bench, by_forces_at, problem_of, solve, tags_of
from onebend.learning.sensing.forces import (
    MOVED,
    PLACE_PRIOR,
    Estimates,
    FrameForces,
    estimate,
    estimated,
    together,
    touches,
)
from onebend.records import Array, BoolArray, IntArray

Benches = Callable[[tuple[float, ...]], Bench]  # the bench by the sd [m] of the place of each contact

SURE = 5.0  # of the log evidence: two are told from there on
_FRAMES = 8  # that are compared
_SCAN = np.linspace(0.115, 1.0, 60)
# Forces at the first pair bend a beam into about any shape that two make; others where nothing was found that fits.
_SPREADS = (np.array([0.5, 1.0]), np.array([0.65, 0.95]), np.array([0.35, 0.75]))
_TRIED = (2, 3)  # places, and pairs of places, that are followed
_NEAR = 0.06  # of s: of places no farther from each other one is followed
_FOLLOWED = 25.0  # of the log evidence to first order: places that are less likely by more are not followed
_HOPELESS = 100.0  # of it: one place that does not move is not followed where two are more likely by more
STRIDE = 0.03  # of s, one sd of each place about that of the round before
_POOR = 1e-3  # probability of a misfit from which a search is begun with more care
_ROUNDS, _STILL = 8, 2e-3  # of s
APART = 0.08  # of s: closer places are one
_AS_WELL = 3.0  # of the log evidence: a pair of places that is less likely by no more is named


@dataclass(frozen=True)
class TwoContacts:
    """How much more likely two contacts are than one."""

    evidence: float  # log, of two over the best of one
    places: tuple[float, float]  # s, from the clamp on
    place_sds: tuple[float, float]  # of s
    others: tuple[tuple[float, float], ...]  # pairs of places that explain the shapes about as well

    @property
    def found(self) -> bool:
        """Whether the shapes show two."""
        return self.evidence > SURE


@dataclass(frozen=True)
class _Placed:
    """A hypothesis with its places where they fit best."""

    places: Array  # (c,)
    covariance: Array  # (c, c)
    evidence: float
    began: Array  # (c,) where the search for them began
    force: Array  # (F, 2 c) N
    fits: bool  # whether the misfit is one that chance makes


def two_said(
    benches: Benches, frames: IntArray, places: Array, place_sds: tuple[float, float], sd: float
) -> TwoContacts:
    """Contacts at both `places` (2,), or at one of them; `sd`: N, of each component of a force."""
    some = _frames(benches(place_sds[:1]), frames)
    one = [
        _evidence_of_two(benches((own,)), some, np.full(len(some), at), np.full(2, sd), seek_place=False)
        for at, own in zip(places, place_sds, strict=True)
    ]
    both = _evidence_of_two(benches(place_sds), some, np.tile(places, (len(some), 1)), np.full(4, sd), seek_place=False)
    length = benches(place_sds).observations.length
    sds = place_sds[0] / length, place_sds[1] / length
    return TwoContacts(both - max(one), (float(places[0]), float(places[1])), sds, ())


def two_sought(benches: Benches, frames: IntArray, sd: float) -> TwoContacts:
    """Contacts at places of which nothing is known."""
    bench, either = benches((0.0, 0.0)), benches((0.0,))
    some, one_sd, both_sd = _frames(either, frames), np.full(2, sd), np.full(4, sd)
    found: list[_Placed] = []
    for place in _SPREADS:
        force = None
        for _ in range(2):
            at = np.tile(place, (len(some), 1))
            begin = estimate(bench, some, at, both_sd, seek_place=False, force=force)
            scan = _scanned(bench, some, begin, both_sd)
            pairs, most = scan.best(2)
            for pair in pairs:
                if all(np.max(np.abs(pair - at)) > _NEAR for other in found for at in (other.began, other.places)):
                    found.append(_placed(benches, some, pair, both_sd, replace(begin, force=scan.forces(pair))))
            found.sort(key=lambda one: -one.evidence)
            place, force = found[0].places, found[0].force
        if found[0].fits:
            break
    best = found[0]
    last = _moving(either, some, scan, one_sd)
    alone, likely = scan.best(1)
    alone = alone if likely > most - _HOPELESS else []
    still = [_placed(benches, some, at, one_sd, replace(begin, force=scan.forces(at))) for at in alone]
    others: list[Array] = []
    for one in found[1:]:
        far = all(np.max(np.abs(one.places - other)) > APART for other in (best.places, *others))
        if far and one.evidence > best.evidence - _AS_WELL:
            others.append(one.places)
    sds = np.sqrt(np.diag(best.covariance))
    return TwoContacts(
        best.evidence - max([last, *(one.evidence for one in still)]),
        (float(best.places[0]), float(best.places[1])),
        (float(sds[0]), float(sds[1])),
        tuple((float(a), float(b)) for a, b in others),
    )


@dataclass(frozen=True)
class _Scan:
    """Forces (F frames, 2 components over their prior's sd) at each of P places, to first order about some shapes, all
    that the frames share being integrated out: of all frames at once, and of each frame by itself."""

    gram: Array  # (P, P, F, 2, F, 2)
    right: Array  # (P, F, 2)
    own_gram: Array  # (F, P, 2, 2)
    own_right: Array  # (F, P, 2)
    sd: float  # N

    def best(self, count: int) -> tuple[list[Array], float]:
        """Places, the most likely first, that are followed, and the log evidence of the first."""
        tried = np.array([one for one in combinations(range(len(_SCAN)), count) if _apart(_SCAN[list(one)])])
        normal, right = self._normal(tried)
        solved = np.linalg.solve(normal, right[..., None])[..., 0]
        evidence = 0.5 * (np.sum(right * solved, axis=1) - np.linalg.slogdet(normal)[1])
        on_grid = np.full((len(_SCAN),) * count, -np.inf)
        on_grid[tuple(tried.T)] = evidence
        most = float(np.max(evidence))
        peak = (evidence == maximum_filter(on_grid, 3)[tuple(tried.T)]) & (evidence > most - _FOLLOWED)
        some: list[Array] = []
        for i in np.argsort(np.where(peak, -evidence, np.inf))[: np.sum(peak)]:
            if all(np.max(np.abs(_SCAN[tried[i]] - other)) > _NEAR for other in some):
                some.append(_SCAN[tried[i]])
        return some[: _TRIED[count - 1]], most

    def forces(self, places: Array) -> Array:
        """(F, 2 c) N, the most likely at places (c,) of the grid."""
        normal, right = self._normal(np.searchsorted(_SCAN, places - 1e-9)[None])
        forces = self.sd * np.linalg.solve(normal[0], right[0]).reshape(len(places), -1, 2)
        return np.asarray(np.moveaxis(forces, 0, 1).reshape(forces.shape[1], -1))

    def moving(self) -> tuple[Array, Array]:
        """(n, F) s and (n, F, 2) N: the places where one force explains each frame best, and the force there; a second
        one only where it explains some frame about as well."""
        force = np.linalg.solve(np.eye(2) + self.own_gram, self.own_right[..., None])[..., 0]
        better = np.pad(np.sum(self.own_right * force, axis=-1), ((0, 0), (1, 1)), constant_values=-np.inf)
        peak = (better[:, 1:-1] >= better[:, 2:]) & (better[:, 1:-1] >= better[:, :-2])
        value = np.where(peak, better[:, 1:-1], -np.inf)
        order, every = np.argsort(-value, axis=1)[:, : _TRIED[0]].T, np.arange(len(force))
        as_well = value[every, order] > value[every, order[0]] - 2.0 * _FOLLOWED
        order = np.where(as_well, order, order[0])[np.any(as_well, axis=1)]
        return _SCAN[order], np.asarray(self.sd * force[every, order])

    def _normal(self, which: IntArray) -> tuple[Array, Array]:
        """(n, c F 2, c F 2) and (n, c F 2) normal equations of the places (n, c) of the grid."""
        right = self.right[which].reshape(len(which), -1)
        gram = self.gram[which[:, :, None], which[:, None]]  # (n, c, c, F, 2, F, 2)
        gram = gram.transpose(0, 1, 3, 4, 2, 5, 6).reshape(*right.shape, -1)
        return np.eye(right.shape[1]) + gram, right


def _apart(places: Array) -> bool:
    return bool(np.all(np.diff(places) > APART))


def _scanned(bench: Bench, some: IntArray, begin: Estimates, sd: Array) -> _Scan:
    """About the shapes of the frames `some` (F,) that `begin`, two forces a frame, explains."""
    o, place, load = bench.observations, begin.place, np.nan_to_num(begin.force)
    seen = np.concatenate([o.xy[some], o.angle[some][..., None]], axis=-1)
    whiten = whitening(seen, o.covariance[some])
    solved = solve(bench, problem_of(bench, some, place), load, place, None)
    tags = tags_of(bench, some, solved, load, place)
    use = solved.converged & np.isfinite(begin.force).all(axis=1)

    def flat(of_tags: Array) -> Array:
        return np.asarray(
            (whiten @ np.where(use[:, None, None, None], of_tags, 0.0)).reshape(len(some), -1, of_tags.shape[-1])
        )

    away = np.nan_to_num(seen - tags.pose)[..., None] + tags.by_load @ load[:, None, :, None]
    by_place = by_forces_at(bench, some, solved, _SCAN)
    own = flat(sd[0] * by_place.reshape(*by_place.shape[:3], -1))  # (F, N, 2 P)
    shared, left = flat(tags.by_shared @ bench.root), flat(away)
    count, rows = own.shape[:2]
    columns = np.concatenate([block_diag(*own), left.reshape(-1, 1)], axis=1)
    every = shared.reshape(count * rows, -1)
    columns = solve_triangular(np.linalg.cholesky(np.eye(len(every)) + every @ every.T), columns, lower=True)
    shape = (count, len(_SCAN), 2)
    gram = (columns[:, :-1].T @ columns[:, :-1]).reshape(*shape, *shape)
    right = (columns[:, :-1].T @ columns[:, -1]).reshape(shape)
    alone = np.linalg.solve(np.eye(rows) + shared @ np.swapaxes(shared, 1, 2), np.concatenate([own, left], axis=-1))
    own = own.reshape(count, rows, len(_SCAN), 2)
    return _Scan(
        gram.transpose(1, 4, 0, 2, 3, 5),
        right.transpose(1, 0, 2),
        np.einsum("fnpc,fnpd->fpcd", own, alone[..., :-1].reshape(own.shape)),
        np.einsum("fnpc,fn->fpc", own, alone[..., -1]),
        float(sd[0]),
    )


def _moving(bench: Bench, some: IntArray, scan: _Scan, sd: Array) -> float:
    """The evidence of one contact at another place in each frame."""
    tried = [
        estimate(bench, some, place, sd, seek_place=True, force=force, restarts=1)
        for place, force in zip(*scan.moving(), strict=True)
    ]
    best = np.argmin([one.objective for one in tried], axis=0)
    every = np.arange(len(some))
    chosen = Estimates(
        *(np.stack(each)[best, every] for each in zip(*(vars(one).values() for one in tried), strict=True))
    )
    return together(bench, some, chosen, sd, seek_place=True)[2].evidence


def _frames(bench: Bench, frames: IntArray) -> IntArray:
    """Some that show a force, whatever explains it: evenly spread among those in which the tags moved."""
    moved = np.nan_to_num(moved_by(bench.observations)[frames])
    rows = np.flatnonzero(moved >= MOVED * np.max(moved))
    return np.asarray(frames[rows[np.unique(np.linspace(0, len(rows) - 1, min(_FRAMES, len(rows))).astype(int))]])


def _evidence_of_two(bench: Bench, some: IntArray, place: Array, sd: Array, *, seek_place: bool) -> float:
    begin = estimate(bench, some, place, sd, seek_place=seek_place)
    return together(bench, some, begin, sd, seek_place=seek_place)[2].evidence


def _placed(benches: Benches, some: IntArray, places: Array, sd: Array, begin: Estimates) -> _Placed:
    """The places that fit best near by, found a stride at a time from `places` (c,) and the forces of `begin`, and the
    evidence with places even over the beam."""
    count, began = len(places), places
    length = benches((0.0,)).observations.length
    bench = benches((STRIDE * length,) * count)
    for turn in range(_ROUNDS):
        at = _in_each(places, some)
        shown, found, fit = together(bench, some, replace(begin, place=at), sd, seek_place=False)
        if not (turn or fit.probability > _POOR):  # each frame by itself first, from more than one force
            begin = estimate(bench, some, at, sd, seek_place=False, force=begin.force)
            shown, found, fit = together(bench, some, begin, sd, seek_place=False)
        begin = found
        part = shown.parts["place"]
        off, root = shown.mean[part] / length, shown.root[part] / length
        last, places = places, np.sort(np.clip(places + off, INNERMOST, 1.0))
        if np.max(np.abs(places - last)) < _STILL:
            break
    inner = np.linalg.inv(root @ root.T) - np.eye(count) / STRIDE**2
    values, ways = np.linalg.eigh(inner)
    covariance = (ways / np.maximum(values, PLACE_PRIOR[1] ** -2)) @ ways.T
    # the stride's prior gives way to an even one: for two, that of places in order
    more = 0.5 * count * np.log(2.0 * np.pi) + count * np.log(STRIDE) + np.log(count)
    more += 0.5 * (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(root @ root.T)[1])
    return _Placed(places, covariance, fit.evidence + float(more), began, begin.force, fit.probability > _POOR)


def _in_each(places: Array, some: IntArray) -> Array:
    """(F,) or (F, 2) of places (c,)."""
    return np.tile(places, (len(some), 1)) if len(places) > 1 else np.full(len(some), places[0])


def both_touch(found: Estimates) -> tuple[BoolArray, BoolArray]:
    """(F,) of each of two forces: whether zero lies outside its 95 % region."""
    each = []
    for c in (slice(0, 2), slice(2, 4)):
        alone = Estimates(
            found.force[:, c], found.place, found.covariance[:, c, c], found.common[:, c], found.objective, found.chi2,
            found.pose,
        )  # fmt: skip
        each.append(touches(alone))
    return each[0], each[1]


# The force as a process over the frames of a contact: what neighbouring frames say of it counts too.
#
# Each component is a Matern process of order 5/2 (twice differentiable), mean zero, with the sd of the force's prior;
# how fast it changes is chosen by the evidence, and it begins anew with each contact. Kalman filter and the backward
# recursion of Bryson and Frazier; the state is the force and its derivatives, each over a power of the rate.
#
# A frame weighs as much as its whole region says, so that many frames which are all wrong alike do not make sure what
# none of them knows. What is left unknown of all that they share goes through the smoother as it is, and is added: no
# number of frames averages it down.

_ORDER = 3  # numbers of the state of a component
_TIMES = 24  # correlation times that are tried
_SHORTEST, _LONGEST = 0.5, 100.0  # of them: of the time between frames, and of all frames


@dataclass(frozen=True)
class Smoothed:
    """The force of T frames with what their neighbours say."""

    force: Array  # (T, 2) N
    covariance: Array  # (T, 2, 2) N^2
    memory: float  # s, the process's correlation time
    widened: float  # of the variance of the frames' own noise, for its memory

    def turned(self, axes: Array) -> Smoothed:
        """In other axes, (2, 2)."""
        return replace(self, force=self.force @ axes.T, covariance=axes @ self.covariance @ axes.T)


class _Frame(NamedTuple):
    """What a Kalman filter leaves of a frame, for G processes of n numbers: the state before it, and the innovation,
    each at `e` zero (first column) and its change with each number of `e`."""

    mean: Array  # (G, n, 1 + r)
    spread: Array  # (G, n, n)
    weigh: Array  # (2, n)
    surprise: Array  # (G, 2, 1 + r), over its covariance
    inner: Array  # (G, 2, 2) inverse of that
    gain: Array  # (G, n, 2)
    step: Array  # (G, n, n) to the frame from the one before


@dataclass(frozen=True)
class _Filtered:
    """And of all T frames."""

    frames: list[_Frame]
    evidence: Array  # (G,) log but for a constant, all that the frames share being known


def smoothed(time: Array, found: Estimates, runs: list[tuple[int, int]], prior_sd: float, widened: float) -> Smoothed:
    """Of frames at `time` (F,) [s], from what each shows by itself; `runs`: first and last of each contact, outside
    which the force is that of each frame; `widened`: how much wider the variance of the frames' own noise counts."""
    readings = [estimated(time, found, widened, prior_sd).take(slice(a, b + 1)) for a, b in runs]
    force, covariance = found.force[:, :2].copy(), found.covariance[:, :2, :2].copy()
    if not runs:
        return Smoothed(force, covariance, float("nan"), widened)
    memory = _memory(readings, prior_sd)
    for (a, b), one in zip(runs, readings, strict=True):
        known = np.isfinite(found.force[a : b + 1]).all(axis=1)
        mean, spread = _backward(_filtered(one, prior_sd, np.array([memory])))
        force[a : b + 1][known], covariance[a : b + 1][known] = mean[known], spread[known]
    return Smoothed(force, covariance, memory, widened)


def _memory(readings: list[FrameForces], prior_sd: float) -> float:
    """s, the correlation time of greatest evidence."""
    every = [one.time for one in readings]
    shortest = float(np.median(np.concatenate([np.diff(time) for time in every])))
    times = np.geomspace(_SHORTEST * shortest, _LONGEST * max(float(t[-1] - t[0]) for t in every), _TIMES)
    evidence = np.sum([_filtered(one, prior_sd, times).evidence for one in readings], axis=0)
    return float(times[np.argmax(evidence)])


def _filtered(readings: FrameForces, prior_sd: float, times: Array) -> _Filtered:
    """For processes of correlation times `times` (G,) [s]."""
    rate, powers, still = np.sqrt(2.0 * _ORDER - 1.0) / times, *_matern(_ORDER)
    still = np.tile(prior_sd**2 * still, (len(times), 1, 1))
    columns = np.concatenate([readings.told[..., None], -readings.common], axis=-1)
    count = columns.shape[-1]
    mean, spread = np.zeros((len(times), 2 * _ORDER, count)), still
    kept: list[_Frame] = []
    evidence, last = np.zeros(len(times)), readings.time[0]
    for time, weigh, told in zip(readings.time, readings.weigh, columns, strict=True):
        step = _step(rate * (time - last), powers)
        mean = step @ mean
        spread = still + step @ (spread - still) @ np.swapaxes(step, 1, 2)
        h = np.zeros((2, 2 * _ORDER))
        h[:, ::_ORDER] = weigh
        across = spread @ h.T
        whole = np.eye(2) + h @ across
        inner = np.linalg.inv(whole)
        away = told - h @ mean
        surprise, gain = inner @ away, across @ inner
        evidence -= 0.5 * (np.einsum("gd,gd->g", away[..., 0], surprise[..., 0]) + np.linalg.slogdet(whole)[1])
        kept.append(_Frame(mean, spread, h, surprise, np.asarray(inner), gain, step))
        mean = mean + across @ surprise
        left = np.eye(2 * _ORDER) - gain @ h  # of Joseph: it stays symmetric and positive
        spread = left @ spread @ np.swapaxes(left, 1, 2) + gain @ np.swapaxes(gain, 1, 2)
        last = time
    return _Filtered(kept, evidence)


def _matern(order: int) -> tuple[Array, Array]:
    """(order, n, n) powers of `A + 1`, `dx/dt = A x + noise` at rate one, and (n, n) the covariance of the state; n is
    twice `order`: of the one component, and of the other."""
    one = np.diag(np.ones(order - 1), 1)
    one[-1] = [-math.comb(order, j) for j in range(order)]
    noise = np.zeros((order, order))
    noise[-1, -1] = -1.0
    still = solve_continuous_lyapunov(one, noise)
    powers = [np.linalg.matrix_power(one + np.eye(order), k) for k in range(order)]
    return np.stack([np.kron(np.eye(2), each) for each in powers]), np.kron(np.eye(2), still / still[0, 0])


def _step(turns: Array, powers: Array) -> Array:
    """(G, n, n): the state after times `turns` (G,) over the rates: `exp(A t) = exp(-t) exp((A + 1) t)`, a
    polynomial."""
    series = [turns**k / math.factorial(k) for k in range(len(powers))]
    return np.asarray(np.exp(-turns)[:, None, None] * np.einsum("kg,kij->gij", np.stack(series), powers))


def _backward(filtered: _Filtered) -> tuple[Array, Array]:
    """(T, 2) N and (T, 2, 2) N^2, of the first process."""
    count, size = len(filtered.frames), 2 * _ORDER
    force, covariance = np.zeros((count, 2)), np.zeros((count, 2, 2))
    pull, told = np.zeros_like(filtered.frames[0].mean[0]), np.zeros((size, size))
    for t in range(count - 1, -1, -1):
        one = filtered.frames[t]
        h, spread, step = one.weigh, one.spread[0], one.step[0]
        left = np.eye(size) - one.gain[0] @ h
        pull = left.T @ pull + h.T @ one.surprise[0]
        told = left.T @ told @ left + h.T @ one.inner[0] @ h
        mean = (one.mean[0] + spread @ pull)[::_ORDER]
        own = (spread - spread @ told @ spread)[::_ORDER, ::_ORDER]
        force[t] = mean[:, 0]
        covariance[t] = own + mean[:, 1:] @ mean[:, 1:].T
        pull, told = step.T @ pull, step.T @ told @ step
    return force, 0.5 * (covariance + np.swapaxes(covariance, 1, 2))


# When a contact begins and ends.
#
# The force is zero until `t0`, and then `j + v t + a t^2 / 2 + c t^3 / 3 + w(t)` of the time `t` since, all unknown:
# `w` is white noise, integrated twice. That is normal at given sizes of the five, so the evidence of each `t0` is
# known in closed form, all that the frames share being integrated out; it is summed over sizes, and gives mean and sd
# of `t0`. An end is a beginning with time reversed, where the bending does not tell it (`endings`).

_BEFORE, _AFTER = 48, 24  # frames that tell when it begins
_LATER = 5  # frames that show a force, and still may be from before
_PLACES = 48  # times that are tried, and again where it is likely
_LIKELY = 12.0  # of the log evidence below the best: farther down it is not
_LAST = (3e-3, 3e-2, 0.3, 1.0)  # w's sd at the end
# Of a jump, of what begins with the first, second and third power of time, and of w. A robot's hand that begins as
# smoothly as it can (least jerk) begins with the third.
_SIZES = (*product((0.0, 1.0), (0.0, 1.0), (2.0,), (0.0,), _LAST), *product((0.0,), (0.0,), (0.0,), (3.0,), _LAST))


def runs_of(touched: BoolArray) -> list[tuple[int, int]]:
    """First and last frame of each contact."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], touched, [False]]).astype(int)))
    runs = [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    joined: list[tuple[int, int]] = []
    for first, last in runs:
        if joined and first - joined[-1][1] <= RUN:
            joined[-1] = joined[-1][0], last
        else:
            joined.append((first, last))
    return [(a, b) for a, b in joined if np.sum(touched[a : b + 1]) >= RUN]


def within(runs: list[tuple[int, int]], count: int) -> BoolArray:
    """(count,) whether a frame is of a contact."""
    inside: BoolArray = np.zeros(count, dtype=np.bool_)
    for first, last in runs:
        inside[first : last + 1] = True
    return inside


def frames_at_edges(runs: list[tuple[int, int]], count: int) -> IntArray:
    """Those of `count` frames that tell when contacts begin and end."""
    some: list[int] = []
    for first, last in runs:
        some += range(max(first - _BEFORE, 0), min(first + _AFTER, count))
        some += range(max(last - _AFTER + 1, 0), min(last + _BEFORE + 1, count))
    return np.unique(np.array(some, dtype=np.int64))


def edges_of(
    readings: FrameForces, frames: IntArray, contacts: list[ContactFrames], count: int, prior_sd: float
) -> list[tuple[Edge, Edge]]:
    """Beginning and end of each contact; `readings` are of `frames` out of `count`."""
    out = []
    for i, one in enumerate(contacts):
        first, last = one.first, one.last
        before = contacts[i - 1].moves if i else -1
        after = contacts[i + 1].first if i + 1 < len(contacts) else count
        middle = (first + last + 1) // 2
        early, late = max(before + 1, first - _BEFORE), min(max(middle, first + RUN), first + _AFTER)
        begin = _begin(readings.take(np.flatnonzero((frames >= early) & (frames < late))), first - early, prior_sd)
        if one.end is not None:
            out.append((begin, one.end))
            continue
        early, late = max(middle, last - _AFTER + 1), min(after, last + _BEFORE + 1)
        back = readings.take(np.flatnonzero((frames >= min(early, last - RUN + 1)) & (frames < late))[::-1])
        end = _begin(replace(back, time=-back.time), late - 1 - last, prior_sd)
        out.append((begin, Edge(-end.time, end.sd)))
    return out


def _begin(readings: FrameForces, first: int, prior_sd: float) -> Edge:
    """When the force begins that the frames from `first` on show."""
    time = readings.time
    if first == 0 or len(time) < RUN + 1:
        return Edge(float("nan"), float("inf"))
    low, high = float(time[0]), float(time[min(first + _LATER, len(time) - 1)])
    for _ in range(2):
        at = np.linspace(low, high, _PLACES)
        evidence = _evidence_of_edges(readings, at, first, prior_sd)
        likely = at[evidence > np.max(evidence) - _LIKELY]
        low, high = max(low, float(likely[0] - at[1] + at[0])), min(high, float(likely[-1] + at[1] - at[0]))
    weight = np.exp(evidence - np.max(evidence))
    weight /= np.sum(weight)
    mean = float(weight @ at)
    return Edge(mean, float(np.sqrt(weight @ (at - mean) ** 2 + (at[1] - at[0]) ** 2 / 12.0)))


def _evidence_of_edges(readings: FrameForces, at: Array, first: int, prior_sd: float) -> Array:
    """(n,) log, of beginnings `at` (n,) [s], but for a constant."""
    tells = np.any(readings.weigh != 0.0, axis=-1)  # (W, 2)
    weigh, told, common = readings.weigh[tells], readings.told[tells], readings.common[tells]
    noise = np.eye(len(told)) + common @ common.T
    since = np.maximum(np.repeat(readings.time[:, None], 2, axis=1)[tells] - at[:, None], 0.0)  # (n, R)
    long = max(float(readings.time[-1] - readings.time[first]), 1e-9)
    size = _size(readings, first, prior_sd)
    on = (since > 0.0).astype(float)
    less = np.minimum(since[:, :, None], since[:, None]) / long
    more = np.maximum(since[:, :, None], since[:, None]) / long
    kinds = [on[:, :, None] * on[:, None]]
    kinds += [(since[:, :, None] * since[:, None] / long**2) ** n / n**2 for n in (1, 2, 3)]
    kinds.append(1.5 * less**2 * (more - less / 3.0))  # of variance one at the end
    alike = size**2 * (weigh @ weigh.T)
    rows = []
    for sizes in _SIZES:
        whole = noise + alike * sum(one**2 * kind for one, kind in zip(sizes, kinds, strict=True) if one > 0.0)
        root = np.linalg.cholesky(whole)
        left = np.linalg.solve(root, np.broadcast_to(told[:, None], (len(at), len(told), 1)))[..., 0]
        rows.append(-0.5 * np.sum(left**2, axis=1) - np.sum(np.log(np.einsum("nrr->nr", root)), axis=1))
    every = np.stack(rows)
    best = np.max(every)
    return np.asarray(best + np.log(np.maximum(np.mean(np.exp(every - best), axis=0), 1e-300)))


def _size(readings: FrameForces, first: int, prior_sd: float) -> float:
    """N, of the forces that the frames from `first` on show."""
    normal = np.swapaxes(readings.weigh, 1, 2) @ readings.weigh + np.eye(2) / prior_sd**2
    right = np.einsum("fdc,fd->fc", readings.weigh, readings.told)
    force = np.linalg.solve(normal, right[..., None])[..., 0]
    return max(float(np.max(np.hypot(*force[first:].T))), 1e-9 * prior_sd)
