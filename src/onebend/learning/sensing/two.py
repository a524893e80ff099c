"""Whether one contact explains the shapes or two, and where two are.

Hypotheses are compared by their evidence (Laplace) on the same frames: forces of each frame, and all that the frames
share, k's band with it, are integrated out. One contact may act where it is said, at one place that is not known, or at
another place in each frame; two act at places that stay. Places of which nothing is known are even over the beam.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from onebend.learning.model.frames import moved_by
from onebend.learning.sensing.bench import INNERMOST, Bench
from onebend.learning.sensing.estimate import PLACE_PRIOR, Estimates, estimate
from onebend.learning.sensing.joint import together
from onebend.learning.sensing.search import MOVED, first, touches
from onebend.records import Array, BoolArray, IntArray

Benches = Callable[[tuple[float, ...]], Bench]  # the bench by the sd [m] of the place of each contact

SURE = 5.0  # of the log evidence: two are told from there on
_FRAMES = 8  # that are compared
_SCAN = np.linspace(0.25, 1.0, 7)
_TRIED = 3  # pairs of places that are followed
STRIDE = 0.03  # of s, one sd of each place about that of the round before
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
    bench = benches((0.0,))
    some, one_sd, both_sd = _frames(bench, frames), np.full(2, sd), np.full(4, sd)
    moving, _ = first(bench, some, None, one_sd)
    last = together(bench, some, moving, one_sd, seek_place=True)[2].evidence
    still = [_placed(benches, some, np.array([at]), one_sd) for at in _best(benches, some, 1, one_sd)[:2]]
    found = [_placed(benches, some, at, both_sd) for at in _best(benches, some, 2, both_sd)[:_TRIED]]
    found.sort(key=lambda one: -one.evidence)
    best = found[0]
    others: list[Array] = []
    for one in found[1:]:
        far = all(np.max(np.abs(one.places - other)) > APART for other in (best.places, *others))
        if far and one.evidence > best.evidence - _AS_WELL:
            others.append(one.places)
    sds = np.sqrt(np.diag(best.covariance))
    return TwoContacts(
        best.evidence - max(last, *(one.evidence for one in still)),
        (float(best.places[0]), float(best.places[1])),
        (float(sds[0]), float(sds[1])),
        tuple((float(a), float(b)) for a, b in others),
    )


def _frames(bench: Bench, frames: IntArray) -> IntArray:
    """Some that show a force, whatever explains it: evenly spread among those in which the tags moved."""
    moved = np.nan_to_num(moved_by(bench.observations)[frames])
    rows = np.flatnonzero(moved >= MOVED * np.max(moved))
    return np.asarray(frames[rows[np.unique(np.linspace(0, len(rows) - 1, min(_FRAMES, len(rows))).astype(int))]])


def _evidence(bench: Bench, some: IntArray, place: Array, sd: Array, *, seek_place: bool) -> float:
    begin = estimate(bench, some, place, sd, seek_place=seek_place)
    return together(bench, some, begin, sd, seek_place=seek_place)[2].evidence


def _best(benches: Benches, some: IntArray, count: int, sd: Array) -> list[Array]:
    """Places, the most likely first, that explain the frames, each by itself, better than places beside them do."""
    bench = benches((0.0,) * count)
    tried = np.array(list(combinations(_SCAN, count)))
    sums = np.zeros(len(tried))
    for i, places in enumerate(tried):
        at = np.tile(places, (len(some), 1)) if count > 1 else np.full(len(some), places[0])
        found = estimate(bench, some, at, sd, seek_place=False, restarts=0)
        sums[i] = np.sum(np.minimum(found.objective, 1e12))
    step = _SCAN[1] - _SCAN[0]
    beside = np.max(np.abs(tried[:, None] - tried), axis=-1) < 1.5 * step
    lowest = [i for i in np.argsort(sums) if sums[i] <= np.min(sums[beside[i]])]
    return [tried[i] for i in lowest]


def _placed(benches: Benches, some: IntArray, places: Array, sd: Array) -> _Placed:
    """The places that fit best near by, found a stride at a time, and the evidence with places even over the beam."""
    count, begin = len(places), None
    length = benches((0.0,)).observations.length
    for _ in range(_ROUNDS):
        bench = benches((STRIDE * length,) * count)
        at = np.tile(places, (len(some), 1))
        at = at if count > 1 else at[:, 0]
        begin = estimate(bench, some, at, sd, seek_place=False)
        shown, _, fit = together(bench, some, begin, sd, seek_place=False)
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
    return _Placed(places, covariance, fit.evidence + float(more))


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
