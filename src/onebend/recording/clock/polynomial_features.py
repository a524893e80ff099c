"""Features of the markers on which the clock search regresses the force.

Two kinds, neither of which needs a model of the beam:

- levers: on a slowly moving beam the moment of the force about the middle of a span between two tags is proportional
  to the turn of that span. So F = sum_i k_i f_i with f_i = (A^T A + ridge)^-1 A^T e_i turn_i, A the levers of all spans
  (moment = A F) and k_i one unknown stiffness per span. The ridge (a fraction of the longest lever squared) bounds the
  force along a straight beam, which bends nothing, so that it is not fitted to noise;
- polynomials of the markers' leading principal components: any smooth function of the shape. They are used alone where
  the place of the push is not known or levers fail (a beam that swings), and with a small prior to correct the levers.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from onebend.recording.force.load_stages import displacement, load_changes
from onebend.recording.signals import bridged, runs
from onebend.records import Array, BoolArray, Markers

FREE = 10.0  # prior sd of the log's bias and of a stiffness, per largest force: free
RIDGE = 0.01  # of the longest lever squared
PLACE = 1.0  # prior sd of the change with a span's lever, per largest force
SHORTEST_SPAN = 0.05  # of the beam: a shorter span between a tag and the push does not count
TERMS = (2.0, 0.5, 0.25)  # prior sd of a polynomial's coefficient by degree, per largest force
TOUCHED = 0.02  # of the largest displacement: a smaller one counts as rest
PARTS = 5  # into which a change of the load is divided; the log's error may change in each
COMPONENTS = 3  # principal components


@dataclass(frozen=True)
class Track:
    """Features in time, to be averaged over any span."""

    integral: PPoly  # antiderivative of the features, (2 axes, p)
    covered: BoolArray  # (T,) frames whose features are known
    time: Array  # (T,) s, video clock
    before: float  # s before the film for which its first frames are taken to hold
    after: float  # s after the film for which its last frames are taken to hold

    @property
    def duration(self) -> float:
        """s, of the film."""
        return float(self.time[-1] - self.time[0])

    def mean(self, centre: Array, width: float) -> Array:
        """(N, 2, p) features averaged over `width` [s] around every `centre`; NaN where the film does not cover it."""
        first_centre, last_centre = self.time[0] + width / 2, self.time[-1] - width / 2
        centre_held = np.clip(centre, first_centre, last_centre)
        centre_held = np.where(
            (centre < first_centre - self.before) | (centre > last_centre + self.after), centre, centre_held
        )
        low, high = centre_held - width / 2, centre_held + width / 2
        average = np.asarray((self.integral(high) - self.integral(low)) / width)
        holes = np.concatenate([[0], np.cumsum(~self.covered)])
        first, last = np.searchsorted(self.time, low), np.searchsorted(self.time, high)
        inside = (low >= self.time[0] - 1e-9) & (high <= self.time[-1] + 1e-9)
        full = holes[np.minimum(last + 1, len(self.time))] == holes[np.maximum(first - 1, 0)]
        average[~(inside & full)] = np.nan
        return average


def make_track(
    markers: Markers, *, push_s: float | None, polynomials: float, longest_gap: float, hold: float, steps: float = 0.0
) -> Track | None:
    """Features of the markers that are missing least; None where there is no such marker, or no lever.

    `push_s`: the place of the push for levers, None for polynomials alone; `polynomials` scales their prior;
    `longest_gap` [s] may be interpolated; a beam that stands still at an end of the film does so for `hold` [s] more.
    `steps`: prior sd, per largest force, of an error of the log that changes where the load begins, reverses and ends.
    """
    used, covered = lasting(markers, longest_gap)
    if not used.any():
        return None
    xy = bridged(markers.time, markers.xy[:, used].reshape(len(markers.time), -1)).reshape(-1, int(used.sum()), 2)
    angle = bridged(markers.time, markers.angle[:, used])
    per_axis = np.concatenate([np.full((len(xy), 1), FREE), polynomials * monomials(xy, angle)], axis=1)
    columns = [np.stack([per_axis, 0 * per_axis], axis=1), np.stack([0 * per_axis, per_axis], axis=1)]
    if push_s is not None:
        turns = levers(xy, angle, markers.s[used], push_s)
        if not turns.shape[-1]:
            return None
        columns.append(FREE * turns)
    if steps > 0.0:
        for part in _load_steps(markers.time, xy).T:
            columns.append(steps * part[:, None, None] * np.eye(2))
    features = np.concatenate(columns, axis=2)
    flat = xy.reshape(len(xy), -1)
    before, after = (hold if is_still(flat, rows) else 0.0 for rows in (slice(0, 10), slice(-10, None)))
    spline = CubicSpline(markers.time, features, axis=0)
    return Track(spline.antiderivative(), covered, markers.time, before, after)


def _load_steps(time: Array, xy: Array) -> Array:
    """(T, n) consecutive ramps over each change of the load, scaled so that their sum has unit variance."""
    size = displacement(time, xy, np.median(xy[:10], axis=0))
    changes = load_changes(time, size, size > TOUCHED * size.max())
    ramps = [np.clip(PARTS * change.fraction(time) - i, 0.0, 1.0) for change in changes for i in range(PARTS)]
    return np.asarray(np.stack([np.zeros(len(time)), *ramps], axis=1)[:, 1:] / np.sqrt(PARTS))


def lasting(markers: Markers, longest_gap: float) -> tuple[BoolArray, BoolArray]:
    """(m,) the markers with the fewest frames in long gaps, and (T,) frames where none of these has a long gap."""
    missing = ~(np.isfinite(markers.xy).all(axis=-1) & np.isfinite(markers.angle))
    long = np.zeros_like(missing)
    for i, column in enumerate(missing.T):
        for start, stop in runs(column):
            edge = start == 0 or stop == len(column)
            if edge or markers.time[stop] - markers.time[start - 1] > longest_gap:
                long[start:stop, i] = True
    frames_missing = long.sum(axis=0)
    used = (frames_missing <= frames_missing.min()) & (frames_missing < len(long))
    return np.asarray(used), np.asarray(~long[:, used].any(axis=1))


def monomials(xy: Array, angle: Array) -> Array:
    """(T, p) products of the leading principal components of the displacements, each scaled to 1 at most."""
    reach = float(np.abs(xy).max())
    flat = np.concatenate([xy.reshape(len(xy), -1), 0.1 * reach * angle], axis=1)
    flat = flat - flat[: max(5, len(flat) // 50)].mean(axis=0)
    components, size, _ = np.linalg.svd(flat, full_matrices=False)
    count = int(min(COMPONENTS, np.sum(size > 1e-9 * max(size[0], np.finfo(float).tiny))))
    if not count:
        return np.empty((len(xy), 0))
    scores = components[:, :count] / np.abs(components[:, :count]).max(axis=0)
    terms = [
        scale * np.prod(scores[:, list(which)], axis=1)
        for degree, scale in enumerate(TERMS, start=1)
        for which in combinations_with_replacement(range(count), degree)
    ]
    return np.stack(terms, axis=1)


def levers(xy: Array, angle: Array, s: Array, push_s: float) -> Array:
    """(T, 2, p) force that gives each span up to the push its turn at unit stiffness; the largest scaled to 1.

    Where in a span the bending takes place depends on its stiffness. So for every span there are further features: the
    change of the forces when its lever is taken a quarter of the span before or behind the middle.
    """
    count = len(xy)
    s = np.concatenate([[0.0], s])
    xy = np.concatenate([np.zeros((count, 1, 2)), xy], axis=1)
    angle = np.concatenate([np.zeros((count, 1)), angle], axis=1)
    order = np.argsort(s, kind="stable")
    s, xy, angle = s[order], xy[:, order], angle[:, order]
    spans = np.flatnonzero(s[:-1] < push_s - SHORTEST_SPAN)
    bend = angle - np.median(angle[:10], axis=0)
    turns = bend[:, spans + 1] - bend[:, spans]
    push = along(xy, angle, s, push_s)

    def forces(part: Array) -> Array:
        ends = np.minimum(s[spans + 1], push_s)
        places = s[spans] + part * (ends - s[spans])
        arms = push[:, None] - np.stack([along(xy, angle, s, place) for place in places], axis=1)
        return unit_forces(arms, turns)

    middle = np.full(len(spans), 0.5)
    moved = np.abs(turns).max(axis=0, initial=0.0) > 0.02 * np.abs(turns).max(initial=0.0)
    if not moved.any():
        return np.empty((count, 2, 0))
    base = forces(middle)[..., moved]
    size = np.abs(base).max(axis=(0, 1))
    shifts = [forces(middle + 0.25 * unit) - forces(middle - 0.25 * unit) for unit in np.eye(len(spans))]
    changes = [PLACE / FREE * shift[..., moved] / size for shift in shifts]
    return np.concatenate([base / size, *changes], axis=2)


def unit_forces(arms: Array, turns: Array) -> Array:
    """(T, 2, k) the force of least ridge-weighted misfit whose moment over the `arms` (T, k, 2) is each of `turns`."""
    rows = np.stack([-arms[..., 1], arms[..., 0]], axis=-1)
    ridge = RIDGE * float((arms**2).sum(axis=-1).max())
    inner = np.einsum("tia,tib->tab", rows, rows) + ridge * np.eye(2)
    return np.asarray(np.linalg.solve(inner, rows.transpose(0, 2, 1)) * turns[:, None, :])


def along(xy: Array, angle: Array, s: Array, place: float) -> Array:
    """(T, 2) the place `place` on the beam: on the cubic through the two neighbouring tags with their directions.

    The tangents have the length of the arc over the chord, so that the cubic of a circle is exact to 0.1 %.
    """
    i = int(np.clip(np.searchsorted(s, place) - 1, 0, len(s) - 2))
    u = min((place - s[i]) / max(s[i + 1] - s[i], 1e-9), 1.0)
    chord = xy[:, i + 1] - xy[:, i]
    # sinc(x) = sin(pi x) / (pi x): arc over chord of a circle that turns by the two tags' difference.
    arc = np.linalg.norm(chord, axis=1) / np.sinc(np.clip(angle[:, i + 1] - angle[:, i], -np.pi, np.pi) / (2 * np.pi))
    ends = [arc[:, None] * np.stack([np.cos(a), np.sin(a)], axis=1) for a in (angle[:, i], angle[:, i + 1])]
    return np.asarray(
        (2 * u**3 - 3 * u**2 + 1) * xy[:, i]
        + (3 * u**2 - 2 * u**3) * xy[:, i + 1]
        + (u**3 - 2 * u**2 + u) * ends[0]
        + (u**3 - u**2) * ends[1]
    )


def is_still(moved: Array, rows: slice) -> bool:
    """Whether nothing moves in `rows` of (T, c) displacements: less than 0.2 % of the whole motion, or noise."""
    window = moved[rows]
    half = len(window) // 2
    change = np.abs(window[half:].mean(axis=0) - window[:half].mean(axis=0))
    noise = np.std(np.diff(moved, n=2, axis=0)[rows], axis=0)
    return bool(np.all(change < np.maximum(2e-3 * np.ptp(moved, axis=0).max(), 2 * noise)))
