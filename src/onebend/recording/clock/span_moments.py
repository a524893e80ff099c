"""Turns and levers of the spans between the tags: the data of the markers on the force, without the stiffness.

The turn of a span is `F . integral of w(s) a(s) ds` with w = 1 / k the compliance along it and a the lever of a unit
force about s. This is exact for a beam that moves slowly, and linear in F. Of w, the mean over the span and the slope
are used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from onebend.recording.clock.polynomial_features import SHORTEST_SPAN, TOUCHED, Track, along, is_still, lasting
from onebend.recording.force.load_stages import displacement, load_changes
from onebend.recording.signals import MAD_TO_SD, bridged
from onebend.records import Array, BoolArray, IntArray, Markers

JUMP = 8.0  # robust sd, of a pose that is read wrongly
NODES = 5  # Gauss, on a span
LEAST = 0.02  # of the largest turn: a span that turns by less is not used
FINEST = 1e-3  # of a span's largest turn: least noise of the turn
SLACK = 0.2  # s, by which the log's error may change before or after the load does
FEWEST_SPANS = 2  # that end at or before the push
STILL = 10  # first frames, whose angles are the ones at rest


@dataclass(frozen=True)
class Moments:
    """Turns and levers of k spans in time, to be averaged over any span of time."""

    track: Track  # features (k, 5): turn, mean of the lever, its first Legendre moment
    tangent: Track  # (2,), change of all levers with the place of the push
    steps: Track  # (n,), ramps over the changes of the load
    noise: Array  # (k,) rad, one sd of a turn in one frame
    largest: Array  # (k,) rad


@dataclass(frozen=True)
class MomentsAtRows:
    """Moments at N rows; steps rise from 0 to 1 over each change of the load."""

    turn: Array  # (N, k)
    lever: Array  # (N, 2 moments, k, 2)
    tangent: Array  # (N, 2)
    steps: Array  # (N, n)

    @property
    def known(self) -> BoolArray:
        """(N,) rows that the film covers."""
        return np.asarray(np.isfinite(self.turn).all(axis=1))

    def select(self, rows: BoolArray) -> MomentsAtRows:
        """Some of the rows."""
        return MomentsAtRows(self.turn[rows], self.lever[rows], self.tangent[rows], self.steps[rows])


def make_moments(markers: Markers, *, push_s: float, longest_gap: float, hold: float) -> Moments | None:
    """Moments of the markers that are missing least; None where fewer than `FEWEST_SPANS` whole spans before the push
    turn. Most of the information is then in the places of the tags beyond, which turns do not contain.

    `push_s`: the place of the push; `longest_gap` [s] may be interpolated; a beam that stands still at an end of the
    film does so for `hold` [s] more.
    """
    used, covered = lasting(markers, longest_gap)
    if not used.any() or len(markers.time) < STILL:
        return None
    markers = without_jumps(markers)
    time, count = markers.time, len(markers.time)
    moved = bridged(time, markers.xy[:, used].reshape(count, -1))
    xy = np.concatenate([np.zeros((count, 1, 2)), moved.reshape(count, -1, 2)], axis=1)
    angle = np.concatenate([np.zeros((count, 1)), bridged(time, markers.angle[:, used])], axis=1)
    s = np.concatenate([[0.0], markers.s[used]])
    order = np.argsort(s, kind="stable")
    s, xy, angle = s[order], xy[:, order], angle[:, order]
    spans = np.flatnonzero((s[:-1] < push_s - SHORTEST_SPAN) & (np.diff(s) > 0.0))
    bend = angle - np.median(angle[:STILL], axis=0)
    turns = bend[:, spans + 1] - bend[:, spans]
    largest = np.abs(turns).max(axis=0, initial=0.0)
    good = (largest > LEAST * largest.max(initial=0.0)) & (largest > 0.0)
    if np.sum(good & (s[spans + 1] <= push_s + SHORTEST_SPAN)) < FEWEST_SPANS:
        return None
    spans, turns, largest = spans[good], turns[:, good], largest[good]
    mean, slope, tangent = span_levers(xy, angle, s, spans, push_s)
    ends = (slice(0, STILL), slice(-STILL, None))
    before, after = (hold if is_still(moved, rows) else 0.0 for rows in ends)

    def track(values: Array) -> Track:
        return Track(CubicSpline(time, values, axis=0).antiderivative(), covered, time, before, after)

    noise = MAD_TO_SD * np.median(np.abs(np.diff(turns, n=2, axis=0)), axis=0) / np.sqrt(6.0)
    return Moments(
        track(np.concatenate([turns[..., None], mean, slope], axis=-1)),
        track(np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)),
        track(load_change_ramps(time, moved.reshape(count, -1, 2))),
        np.maximum(noise, FINEST * largest),
        largest,
    )


def span_levers(xy: Array, angle: Array, s: Array, spans: IntArray, push_s: float) -> tuple[Array, Array, Array]:
    """(T, k, 2) m mean lever of a unit force over each span, its first Legendre moment, and the beam's direction
    (T, 2) at the push."""
    push = along(xy, angle, s, push_s)
    beside = np.clip((push_s - s[:-1]) / np.maximum(np.diff(s), 1e-9), 0.0, 1.0)
    direction = angle[:, 0] + np.diff(angle, axis=1) @ beside
    x, weight = np.polynomial.legendre.leggauss(NODES)
    ends = np.minimum(s[spans + 1], push_s)
    lever = np.zeros((2, len(xy), len(spans), 2))
    for node, share in zip(x, 0.5 * weight, strict=True):
        places = s[spans] + 0.5 * (node + 1.0) * (ends - s[spans])
        arm = push[:, None] - np.stack([along(xy, angle, s, place) for place in places], axis=1)
        lever += share * np.array([1.0, node])[:, None, None, None] * np.stack([-arm[..., 1], arm[..., 0]], axis=-1)
    return lever[0], lever[1], np.stack([np.cos(direction), np.sin(direction)], axis=1)


def load_change_share(rows: MomentsAtRows) -> Array:
    """(N,) share of the changes of the load that lies between each row and the one before it."""
    return np.concatenate([[0.0], np.maximum(np.diff(rows.steps, axis=0), 0.0).sum(axis=1)])


def without_jumps(markers: Markers) -> Markers:
    """Markers without single frames that are far from the cubic through the two frames before and the two after."""
    state = np.concatenate([markers.xy, markers.angle[..., None]], axis=-1)
    if len(state) < 9:
        return markers
    off = np.zeros_like(state)
    off[2:-2] = state[2:-2] - (4 * (state[1:-3] + state[3:-1]) - state[:-4] - state[4:]) / 6
    size = np.abs(off) / np.maximum(MAD_TO_SD * np.nanmedian(np.abs(off), axis=0), np.finfo(float).tiny)
    size = np.nan_to_num(size).max(axis=-1)
    peak = np.maximum(np.roll(size, 1, axis=0), np.roll(size, -1, axis=0)) <= size
    state[(size > JUMP) & peak] = np.nan
    return replace(markers, xy=state[..., :2], angle=state[..., 2])


def load_change_ramps(time: Array, xy: Array) -> Array:
    """(T, n) ramps from 0 to 1 over each change of the load, in which the log's error may change."""
    size = displacement(time, xy, np.median(xy[:STILL], axis=0))
    changes = load_changes(time, size, size > TOUCHED * size.max())
    wide = [replace(change, begin=change.begin - SLACK, end=change.end + SLACK) for change in changes]
    return np.asarray(np.stack([np.zeros(len(time)), *(change.fraction(time) for change in wide)], axis=1)[:, 1:])


def moments_at(moments: Moments, centre: Array, width: float) -> MomentsAtRows:
    """Moments averaged over `width` [s] around every `centre` (N,) [s, video clock]."""
    f = moments.track.mean(centre, width)
    return MomentsAtRows(
        f[..., 0],
        np.stack([f[..., 1:3], f[..., 3:5]], axis=1),
        moments.tangent.mean(centre, width),
        np.clip(moments.steps.mean(centre, width), 0.0, 1.0),
    )
