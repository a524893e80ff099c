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

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.ndimage import maximum_filter

from onebend.learning.model.frames import moved_by, whitening
from onebend.learning.sensing.bench import INNERMOST, Bench, problem_of, solve
from onebend.learning.sensing.estimate import PLACE_PRIOR, Estimates, estimate
from onebend.learning.sensing.joint import together
from onebend.learning.sensing.search import MOVED, touches
from onebend.learning.sensing.tags import by_forces_at, tags_of
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
        _evidence(benches((own,)), some, np.full(len(some), at), np.full(2, sd), seek_place=False)
        for at, own in zip(places, place_sds, strict=True)
    ]
    both = _evidence(benches(place_sds), some, np.tile(places, (len(some), 1)), np.full(4, sd), seek_place=False)
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


def _evidence(bench: Bench, some: IntArray, place: Array, sd: Array, *, seek_place: bool) -> float:
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
