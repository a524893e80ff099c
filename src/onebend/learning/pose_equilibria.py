"""Which equilibrium a static pose of a free end is in: of all that are stable, the one that its points show.

A soft beam on a turned base has several, and which of them it is in depends on how it came there; the points tell.
Where they do not (too few, or alike in both), it is the one to which the stated history leads, if any.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.statics.continuation import follow
from onebend.beam.statics.equilibrium import Equilibrium, is_convex, is_stable
from onebend.beam.statics.newton import correct
from onebend.beam.statics.problem import Problem
from onebend.beam.statics.shooting import stable_equilibria
from onebend.beam.statics.snap_through import let_fall
from onebend.beam.statics.turning import lead, turn_into, turned_loads
from onebend.records import Array, BoolArray, IntArray, Observations

_SAME_BRANCH = 0.7  # rad, the largest turn of Newton's method from a shape that is still on its branch
_ROPE = 20.0  # of `int sqrt(L N / k) ds`: above it the search may miss equilibria, and the shape seen is let fall, too
_FAR = 0.03  # of the length: equilibria of a pose that are apart are farther apart than this, as a rule
_FARTHER = 5.0  # times what is usual of the other poses
_MOST_LEFT_OUT = 0.4  # of the poses
_TIE = 9.0  # of chi squared over that of a reading: equilibria that differ by less are as good as each other


@dataclass(frozen=True)
class SeenPoses:
    """What the F static poses of a recording show, and how the beam came into them."""

    s: Array  # (m,)
    xy: Array  # (F, m, 2) m, NaN where missing
    angle: Array  # (F, m) rad, NaN where missing
    sd: Array  # (F, m, 3) m, m, rad
    clamp: Array  # (F,) rad; this and the next as in `records.BenchPoses`
    turned_from: Array  # (F,) rad
    order: Array  # (F,)

    def take(self, chosen: IntArray | BoolArray) -> SeenPoses:
        """Some of the poses."""
        parts = (self.xy, self.angle, self.sd, self.clamp, self.turned_from, self.order)
        return SeenPoses(self.s, *(part[chosen] for part in parts))


def seen_poses(o: Observations, frames: BoolArray) -> SeenPoses | None:
    """Those of some frames (T,); None where the recording is a film, where no end is free, or where readings do not
    say where marks are: rulers and zeroed gauges read small deflections."""
    plain = o.readings.at == "mark" and o.readings.bare < 0
    if not o.static or not plain or (o.held is not None and bool(np.all(o.held[frames]))):
        return None
    unknown = np.full(len(o.time), np.nan)
    told = (unknown, unknown, unknown) if o.poses is None else (o.poses.clamp, o.poses.turned_from, o.poses.order)
    sd = np.sqrt(np.diagonal(o.covariance, axis1=-2, axis2=-1))
    return SeenPoses(o.marker_s, o.xy, o.angle, sd, *told).take(frames)


def nearest(problem: Problem, seen: SeenPoses, *, with_history: bool = True) -> Equilibrium:
    """Of all stable equilibria (F,) under the loads of each pose, those nearest to the points.

    `with_history`: where several are as near, the one to which the stated history leads.
    """
    q, frame = _every(problem, seen)
    off = _misfit(problem.take(frame), q, seen.take(frame))
    least = np.full(problem.size, np.inf)
    np.minimum.at(least, frame, off)
    at_least = np.flatnonzero(off == least[frame])
    chosen, found = np.zeros(problem.dead_force.shape[:2]), np.isfinite(least)
    chosen[frame[at_least]] = q[at_least]
    if with_history:
        shapes, there = led(problem, seen)
        here = np.flatnonzero(there)
        as_near = _as_near(_misfit(problem.take(here), shapes[here], seen.take(here)), least[here], seen.take(here))
        chosen[here[as_near]], found[here[as_near]] = shapes[here[as_near]], True
    return _solved(problem, chosen, found)


def stay(problem: Problem, start: Array) -> Equilibrium:
    """The equilibria near known shapes (F, Q): Newton's method, and where a branch has ended, that to which the beam
    falls from it."""
    full = np.ones(problem.size)
    q, near, _ = correct(problem, start, full, trust=_SAME_BRANCH * full, remaining=1e-13 * full, max_iterations=12)
    near[near] &= is_stable(problem.take(near), q[near])
    lost = np.flatnonzero(~near)
    if lost.size:
        q[lost], near[lost] = let_fall(problem.take(lost), start[lost])
    return _solved(problem, q, near)


def pose_names(o: Observations, frames: BoolArray) -> tuple[str, ...]:
    """Those of some frames (T,); numbers where nobody named them."""
    every = [str(i + 1) for i in range(len(frames))] if o.poses is None else o.poses.name
    return tuple(name for name, wanted in zip(every, frames.tolist(), strict=True) if wanted)


def pose_rms(off: Array) -> Array:
    """(F,) m RMS over the points of each pose of how far off (F, m, 2) they are; 0 where none was measured."""
    count = np.sum(np.isfinite(off).any(axis=2), axis=1)
    return np.asarray(np.sqrt(np.nansum(off**2, axis=(1, 2)) / np.maximum(count, 1)))


def unexplained(rms: Array, length: float) -> BoolArray:
    """(P,) poses that are much farther from their equilibria than the others are, by their RMS (P,) [m].

    None where these are many: then what is wrong is no single pose.
    """
    usual = float(np.median(rms)) if len(rms) > 1 else 0.0
    out = rms > max(_FAR * length, _FARTHER * usual)
    return np.asarray(out & (np.sum(out) <= max(_MOST_LEFT_OUT * len(rms), 1.0)))


def elsewhere(solved: Equilibrium, seen: SeenPoses) -> tuple[Array, BoolArray]:
    """(F,) m RMS of the points from the equilibria to which the stated histories lead, and True where these are others
    than `solved`, and farther from the points by more than their noise."""
    problem = solved.problem
    shapes, there = led(problem, seen)
    here = np.flatnonzero(there)
    part, some = problem.take(here), seen.take(here)
    least = _misfit(part, solved.q[here], some)
    out, other = np.full(problem.size, np.nan), np.zeros(problem.size, dtype=bool)
    out[here] = pose_rms(some.xy - _solved(part, shapes[here], np.ones(len(here), dtype=bool)).xy(some.s))
    other[here] = ~_as_near(_misfit(part, shapes[here], some), least, some)
    return out, other


def led(problem: Problem, seen: SeenPoses) -> tuple[Array, BoolArray]:
    """Shapes (F, Q) to which the histories that are stated lead, falls on the way included, and True where one does."""
    q, there = np.zeros(problem.dead_force.shape[:2]), np.zeros(problem.size, dtype=bool)
    turned = seen.clamp - seen.turned_from
    some = np.flatnonzero(np.isfinite(turned))
    if some.size:
        part = problem.take(some)
        begin = follow(turned_loads(part, turned[some]), fall="left")
        shape, well, _ = turn_into(part, begin.q, turned[some])
        q[some], there[some] = shape, well & begin.converged & begin.stable
    chain = np.flatnonzero(np.isfinite(seen.order))
    before = -1
    for i in chain[np.argsort(seen.order[chain], kind="stable")].tolist():
        one = problem.take(np.array([i]))
        if before < 0 or not there[before]:
            first = follow(one, fall="left")
            q[i], there[i] = first.q[0], first.converged[0] & first.stable[0]
        else:
            shape, well, _ = _led_on(problem, seen, before, i, q[before])
            q[i], there[i] = shape[0], well[0]
        before = i
    return q, there


def shown_curvature(xy: Array, angle: Array, s: Array, nodes: Array) -> Array:
    """(Q,) rad at the nodes, from the chords between the points (m, 2) of one pose, the clamp (along x) and the angle
    (m,) of the last of them, if measured."""
    seen = np.flatnonzero(np.isfinite(xy).all(axis=1))
    seen = seen[np.argsort(s[seen], kind="stable")]
    place = np.concatenate([[0.0], s[seen]])
    points = np.concatenate([np.zeros((1, 2)), xy[seen]])
    apart = np.append(np.diff(place) > 1e-9, True)
    place, points = place[apart], points[apart]
    chords = np.diff(points, axis=0)
    turned = np.unwrap(np.concatenate([[0.0], np.arctan2(chords[:, 1], chords[:, 0])]))
    at = np.concatenate([[0.0], 0.5 * (place[1:] + place[:-1])])
    last = angle[seen[-1]] if seen.size else np.nan
    if np.isfinite(last):
        last -= 2.0 * np.pi * np.round((last - turned[-1]) / (2.0 * np.pi))
        at, turned = np.append(at, place[-1]), np.append(turned, last)
    if len(at) < 2:
        return np.zeros(len(nodes))
    slope = np.diff(turned) / np.diff(at)
    return np.asarray(slope[np.clip(np.searchsorted(at, nodes) - 1, 0, len(slope) - 1)])


def _every(problem: Problem, seen: SeenPoses) -> tuple[Array, IntArray]:
    """Shapes (E, Q) and frames (E,) of the equilibria to choose from."""
    grown = follow(problem)
    one = is_convex(problem) & grown.converged
    several = np.flatnonzero(~one)
    q, frame = stable_equilibria(problem.take(several))
    q, frame = np.concatenate([grown.q[one], q]), np.concatenate([np.flatnonzero(one), several[frame]])
    pull = np.linalg.norm(problem.dead_force, axis=-1)
    rope = np.sum(problem.weights * np.sqrt(problem.length * pull / problem.k), axis=-1) > _ROPE
    long = np.flatnonzero(rope | (np.bincount(frame, minlength=problem.size) == 0))
    if not long.size:
        return q, frame
    part, nodes = problem.take(long), np.broadcast_to(problem.grid.nodes, problem.dead_force.shape[:2])
    shown = [shown_curvature(seen.xy[i], seen.angle[i], seen.s, nodes[i]) for i in long.tolist()]
    fallen, landed = let_fall(part, np.stack(shown))
    well = long[(grown.converged & grown.stable)[long]]
    return np.concatenate([q, fallen[landed], grown.q[well]]), np.concatenate([frame, long[landed], well])


def _led_on(problem: Problem, seen: SeenPoses, a: int, b: int, start: Array) -> tuple[Array, BoolArray, IntArray]:
    """From the shape (Q,) of pose a to that (1, Q) of pose b, clamp and loads going over evenly."""
    last, there = problem.take(np.array([a])), problem.take(np.array([b]))
    nodes, new = np.ravel(last.grid.nodes), np.ravel(there.grid.nodes)
    if len(nodes) != len(new) or np.any(nodes != new):  # loads at other places: the way need not be exact
        start = np.interp(new, nodes, start)
        force = np.stack([np.interp(new, nodes, last.dead_force[0, :, i]) for i in (0, 1)], axis=-1)[None]
        last = replace(there, dead_force=force, moment=np.interp(new, nodes, last.moment[0])[None])
    turn = np.nan_to_num(seen.clamp[b] - seen.clamp[a])
    before = turned_loads(last, np.array([-turn])).dead_force  # those of a, in the frame of b

    def way(_: IntArray, share: Array) -> Problem:
        f = float(share[0])
        force = (1.0 - f) * before + f * there.dead_force
        mixed = replace(there, dead_force=force, moment=(1.0 - f) * last.moment + f * there.moment)
        return turned_loads(mixed, np.array([(1.0 - f) * turn]))

    return lead(way, start[None])


def _misfit(problem: Problem, q: Array, seen: SeenPoses) -> Array:
    """(F,) chi squared of what was measured; angles count without full turns."""
    solved = _solved(problem, q, np.ones(len(q), dtype=bool))
    place = (seen.xy - solved.xy(seen.s)) / seen.sd[..., :2]
    turn = seen.angle - solved.angle(seen.s)
    turn = (turn - 2.0 * np.pi * np.round(turn / (2.0 * np.pi))) / seen.sd[..., 2]
    return np.asarray(np.nansum(place**2, axis=(1, 2)) + np.nansum(turn**2, axis=1))


def _as_near(off: Array, least: Array, seen: SeenPoses) -> BoolArray:
    """(F,) whether chi squared is that of the nearest equilibrium but for noise, of the size that this leaves."""
    count = np.sum(np.isfinite(seen.xy), axis=(1, 2)) + np.sum(np.isfinite(seen.angle), axis=1)
    noise = np.maximum(least / np.maximum(count, 1), 1.0)
    return np.asarray(off <= np.where(np.isfinite(least), least + _TIE * noise, np.inf))


def _solved(problem: Problem, q: Array, well: BoolArray) -> Equilibrium:
    """A record of stable equilibria; a frame without any has not converged."""
    nothing, count = np.full(len(q), np.nan), len(q)
    factor = np.where(well, 1.0, np.nan)
    return Equilibrium(problem, q, well, well.copy(), factor, nothing, np.zeros(count, dtype=bool), 0)
