"""The equilibrium of a static pose. A soft beam has several stable ones; the points show which."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.beam.clamped_ends import end_pose, hold_near, with_end_wrench
from onebend.beam.continuation import ContinuationSettings, follow, let_fall, refine, stable_equilibria
from onebend.beam.problem import Problem, Resolution
from onebend.beam.sensitivity import of_force, of_moment, respond
from onebend.beam.statics import Equilibrium, correct, is_convex, is_stable
from onebend.beam.stiffness import UncertainStiffness, half_width
from onebend.learning.outcome import Notice
from onebend.learning.parameters import KnownShape, Layout, forced, known_shape, needs_mass
from onebend.records import UNKNOWN_ANGLE_SD, Array, BoolArray, IntArray, Observations, left_of, tags_among, unit

_SAME_BRANCH = 0.7  # rad, the largest turn of Newton's method from a shape that is still on its branch
_ROPE = 20.0  # of `int sqrt(L N / k) ds`: above it the search may miss equilibria, and the shape seen is let fall, too
_FAR = 0.03  # of the length: equilibria of a pose that are apart are farther apart than this, as a rule
_FARTHER = 5.0  # times what is usual of the other poses
_FARTHEST_TURN = 3.0  # sds of the clamp's direction
_MOST_LEFT_OUT = 0.4  # of the poses


@dataclass(frozen=True)
class SeenPoses:
    """What the F static poses of a recording show."""

    s: Array  # (m,)
    xy: Array  # (F, m, 2) m, NaN where missing
    angle: Array  # (F, m) rad, NaN where missing
    sd: Array  # (F, m, 3) m, m, rad

    def take(self, chosen: IntArray | BoolArray) -> SeenPoses:
        """Some of the poses."""
        return SeenPoses(self.s, self.xy[chosen], self.angle[chosen], self.sd[chosen])


def seen_poses(o: Observations, frames: BoolArray) -> SeenPoses | None:
    """Those of some frames (T,); None for a film, without a free end, or with rulers and zeroed gauges, which read
    small deflections."""
    plain = o.readings.at == "mark" and o.readings.bare < 0
    if not o.static or not plain or (o.held is not None and bool(np.all(o.held[frames]))):
        return None
    sd = np.sqrt(np.diagonal(o.covariance, axis1=-2, axis2=-1))
    sd[:, ~tags_among(o), 2] = UNKNOWN_ANGLE_SD  # the direction of a curve is no measurement of its own
    return SeenPoses(o.marker_s, o.xy, o.angle, sd).take(frames)


def nearest(problem: Problem, seen: SeenPoses) -> Equilibrium:
    """The stable equilibria (F,) nearest to the points."""
    q, frame = _every(problem, seen)
    off = _misfit(problem.take(frame), q, seen.take(frame))
    least = np.full(problem.size, np.inf)
    np.minimum.at(least, frame, off)
    at_least = np.flatnonzero(off == least[frame])
    chosen, found = np.zeros(problem.dead_force.shape[:2]), np.isfinite(least)
    chosen[frame[at_least]] = q[at_least]
    return _solved(problem, chosen, found)


def stay(problem: Problem, start: Array) -> Equilibrium:
    """The equilibria near known shapes (F, Q) by Newton's method; after the end of a branch, that to which the beam
    falls."""
    full = np.ones(problem.size)
    q, near, _ = correct(problem, start, full, trust=_SAME_BRANCH * full, remaining=1e-13 * full, max_iterations=12)
    near[near] &= is_stable(problem.take(near), q[near])
    lost = np.flatnonzero(~near)
    if lost.size:
        q[lost], near[lost] = let_fall(problem.take(lost), start[lost])
    return _solved(problem, q, near)


def pose_names(o: Observations, frames: BoolArray) -> tuple[str, ...]:
    """Those of some frames (T,); numbers where nobody named them."""
    every = [str(i + 1) for i in range(len(frames))] if o.pose_names is None else o.pose_names
    return tuple(name for name, wanted in zip(every, frames.tolist(), strict=True) if wanted)


def pose_rms(off: Array) -> Array:
    """(F,) m RMS over the points of each pose of how far off (F, m, 2) they are; 0 where none was measured."""
    count = np.sum(np.isfinite(off).any(axis=2), axis=1)
    return np.asarray(np.sqrt(np.nansum(off**2, axis=(1, 2)) / np.maximum(count, 1)))


def across_curve(o: Observations, frames: BoolArray, off: Array) -> Array:
    """(F, m, 2) m, of distances in some frames (T,) what counts: of a curve's points the part across it."""
    direction = np.where(tags_among(o), np.nan, o.angle[frames])
    normal = left_of(unit(direction))
    return np.where(np.isfinite(normal), np.sum(off * normal, axis=-1, keepdims=True) * normal, off)


def unexplained(rms: Array, length: float, clamp_sd: float = 0.0) -> BoolArray:
    """(P,) poses much farther from their equilibria than the others, by their RMS (P,) [m]; none if they are many.
    `clamp_sd` rad: of a direction that the equilibria do not know."""
    usual = float(np.median(rms)) if len(rms) > 1 else 0.0
    far = _FAR + _FARTHEST_TURN * float(np.nan_to_num(clamp_sd))
    out = rms > max(far * length, _FARTHER * usual)
    return np.asarray(out & (np.sum(out) <= max(_MOST_LEFT_OUT * len(rms), 1.0)))


def shown_curvature(xy: Array, angle: Array, s: Array, nodes: Array) -> Array:
    """(Q,) rad at the nodes, from the chords between clamp and points (m, 2), and the last measured angle (m,)."""
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


def _misfit(problem: Problem, q: Array, seen: SeenPoses) -> Array:
    """(F,) chi squared of what was measured; angles count without full turns."""
    solved = _solved(problem, q, np.ones(len(q), dtype=bool))
    place = (seen.xy - solved.xy(seen.s)) / seen.sd[..., :2]
    turn = seen.angle - solved.angle(seen.s)
    turn = (turn - 2.0 * np.pi * np.round(turn / (2.0 * np.pi))) / seen.sd[..., 2]
    return np.asarray(np.nansum(place**2, axis=(1, 2)) + np.nansum(turn**2, axis=1))


def _solved(problem: Problem, q: Array, well: BoolArray) -> Equilibrium:
    nothing, count = np.full(len(q), np.nan), len(q)
    factor = np.where(well, 1.0, np.nan)
    return Equilibrium(problem, q, well, well.copy(), factor, nothing, np.zeros(count, dtype=bool), 0)


# Poses whose end s = 1 an unknown force and moment hold. The end's pose is a parameter of the fit, with a wide prior;
# the wrench follows from it. Such shapes alone give k(s) only up to a factor.

RESOLUTION = Resolution(order=6, widest=0.125)  # below 1e-7 L for physical shapes; the measurement is near 1e-4 L
HELD_RESOLUTION = Resolution(order=12, widest=0.125)  # a held beam may hang like a rope and bend sharply at its ends
_REACH = 0.999  # of the length: an end that was read as farther away is put where the way to it ends
_STRIDE = 0.3  # of the length, rad: the longest of them
_WEAK = 1e-6  # of the derivatives squared: what keeps an end in place that no point tells of


@dataclass(frozen=True)
class HeldEnds:
    """The held poses of one film: H of its F frames."""

    frames: IntArray  # (H,)
    number: IntArray  # (H,) among all held poses of the recording
    start: Array  # (H, Q) rad, curvature at the nodes as the points show it
    end: Array  # (H, 3) m, m, rad: where the parameters count from


def is_held(o: Observations) -> bool:
    """Whether in some pose an unknown wrench holds the end."""
    return o.held is not None and bool(np.any(o.held))


def resolution_of(o: Observations) -> Resolution:
    """What the beam of this recording is solved with."""
    return HELD_RESOLUTION if is_held(o) else RESOLUTION


def sets_no_scale(recordings: Sequence[Observations]) -> bool:
    """Whether nothing of known size acts: then only the shape of k(s) can be known."""
    return not any(needs_mass(o) or forced(o) for o in recordings)


def held_ends(o: Observations, frames: BoolArray, problem: Problem) -> HeldEnds | None:
    """The held among some frames (T,) of a recording; None where there are none. `problem`: of those frames."""
    if not is_held(o):
        return None
    assert o.held is not None
    held = np.flatnonzero(o.held[frames])
    if held.size == 0:
        return None
    rows = np.flatnonzero(frames)[held]
    nodes = np.broadcast_to(problem.grid.nodes, problem.dead_force.shape[:2])
    start = np.stack(
        [shown_curvature(o.xy[row], o.angle[row], o.marker_s, nodes[i]) for row, i in zip(rows, held, strict=True)]
    )
    end = end_pose(problem.take(held), start)
    tip = int(np.argmax(o.marker_s))
    if o.marker_s[tip] >= 1.0 - 1e-9:
        seen = np.concatenate([o.xy[rows, tip], o.angle[rows, tip, None]], axis=1)
        seen[:, 2] -= 2.0 * np.pi * np.round((seen[:, 2] - end[:, 2]) / (2.0 * np.pi))
        near = np.linalg.norm(np.nan_to_num(seen[:, :2]), axis=1, keepdims=True) < _REACH * o.length
        end = np.where(np.isfinite(seen) & near, seen, end)
    number = np.cumsum(o.held)[rows] - 1
    return HeldEnds(held.astype(np.int64), number, start, end)


def moved(ends: HeldEnds, at: Layout, x: Array, recording: int) -> Array:
    """(H, 3) m, m, rad: of the ends from where the points put them."""
    places, turns = at.get(x, "end", recording).reshape(-1, 2), at.get(x, "end turn", recording)
    return np.column_stack([places[ends.number], turns[ends.number]])


def put_ends(out: Array, ends: HeldEnds, at: Layout, recording: int, by_end: Array) -> None:
    """Derivatives (H, m, 3, 3) of the tags with the ends' own poses into those with all parameters (F, m, 3, C)."""
    places, turns = at.columns("end", recording), at.columns("end turn", recording)
    assert places is not None
    assert turns is not None
    for i, (frame, number) in enumerate(zip(ends.frames.tolist(), ends.number.tolist(), strict=True)):
        first = places.start + 2 * number
        out[frame, :, :, first : first + 2] = by_end[i, :, :, :2]
        out[frame, :, :, turns.start + number] = by_end[i, :, :, 2]


def solve(problem: Problem, ends: HeldEnds, away: Array, start: Array | None, seen: SeenPoses | None) -> Equilibrium:
    """All frames, the held ones with their ends `away` (H, 3) from where they were put; `start` (F, Q) as `free`."""
    count, q = problem.size, np.zeros(problem.dead_force.shape[:2])
    wrench, well = np.zeros((count, 3)), np.zeros(count, dtype=bool)
    others = np.setdiff1d(np.arange(count), ends.frames)
    if others.size:
        part = problem.take(others)
        some = None if seen is None else seen.take(others)
        one = free_ends(part, some, None if start is None else start[others])
        q[others], well[others] = one.q, one.converged & one.stable
    near = ends.start if start is None else start[ends.frames]
    one, wrench[ends.frames] = hold_near(problem.take(ends.frames), near, ends.end + away, fall=start is None)
    q[ends.frames], well[ends.frames] = one.q, one.converged
    nothing, factor = np.full(count, np.nan), np.where(well, 1.0, np.nan)
    return Equilibrium(
        with_end_wrench(problem, wrench),
        q,
        well,
        well.copy(),
        factor,
        nothing,
        np.zeros(count, dtype=bool),
        one.iterations,
    )


def with_ends_held(poses: Array, ends: HeldEnds) -> tuple[Array, Array]:
    """Derivatives of poses (F, m, 3, P), with the end s = 1 last among m and the wrench last among P, as those of the
    other m - 1 with the other P - 3, the end fixed in the held frames; and (H, m - 1, 3, 3) with the end's pose: `dp =
    R dx + W dw` with `0 = R1 dx + W1 dw`."""
    others = poses[:, :-1, :, :-3].copy()
    held = poses[ends.frames]
    by_end = held[:, :-1, :, -3:] @ np.linalg.inv(held[:, -1, :, -3:])[:, None]
    others[ends.frames] -= by_end @ held[:, -1:, :, :-3]
    return others, by_end


def free_ends(
    problem: Problem,
    seen: SeenPoses | None,
    start: Array | None,
    settings: ContinuationSettings = ContinuationSettings(),
) -> Equilibrium:
    """Equilibria of free ends near shapes `start` (F, Q), else those that grow from rest, or that static poses show."""
    if seen is None:
        return follow(problem) if start is None else refine(problem, start, settings=settings)
    return nearest(problem, seen) if start is None else stay(problem, start)


def shapes_of(o: Observations, frames: BoolArray, problem: Problem) -> Equilibrium:
    """Equilibria of some frames (T,) under a `problem` that is theirs, held ends where the points are met best."""
    ends, seen = held_ends(o, frames, problem), seen_poses(o, frames)
    if ends is None:
        return free_ends(problem, seen, None)
    away = np.zeros((len(ends.frames), 3))
    solved = solve(problem, ends, away, None, seen)
    for _ in range(3):
        step = _closer(o.xy[frames][ends.frames], o.marker_s, solved, ends)
        there = solve(problem, ends, away + step, solved.q, seen)
        if not np.all(there.converged):
            break
        away, solved = away + step, there
    return solved


def _closer(xy: Array, s: Array, solved: Equilibrium, ends: HeldEnds) -> Array:
    """(H, 3) m, m, rad: a Gauss-Newton step of the ends towards the points (H, m, 2), at most `_STRIDE`."""
    wrench = of_force(solved.problem, np.ones(1)) + of_moment(solved.problem, np.ones(1))
    _, by_end = with_ends_held(respond(solved, wrench).poses(np.append(s, 1.0)), ends)
    left = xy - solved.xy(s)[ends.frames]
    rows = np.where(np.isfinite(left)[..., None], by_end[:, :, :2], 0.0).reshape(len(left), -1, 3)
    rows[..., 2] /= (length := float(np.max(solved.problem.length)))  # all three in metres
    flat = np.nan_to_num(left).reshape(len(left), -1, 1)
    across = np.swapaxes(rows, 1, 2)
    step = np.linalg.solve(across @ rows + _WEAK * np.eye(3), across @ flat)[..., 0] / [1.0, 1.0, length]
    size = np.max(np.abs(step) * [1.0 / length, 1.0 / length, 1.0], axis=1, keepdims=True)
    return np.asarray(step * np.minimum(1.0, _STRIDE / np.maximum(size, 1e-300)))


def stated_notices(recordings: Sequence[Observations], stiffness: UncertainStiffness) -> tuple[Notice, ...]:
    """A note on how k was stated to vary, and a warning if nothing determines the size of k(s)."""
    shape = known_shape(recordings)
    known = () if shape is None else (_of_shape(shape),)
    if not sets_no_scale(recordings):
        return known
    s = np.array([0.1, 0.5, 0.9])
    rows, logs = stiffness.basis(s), stiffness.log_at(s)[0]
    rows = rows[[0, 2]] - rows[1]
    sd = np.sqrt(np.einsum("si,ij,sj->s", rows, stiffness.covariance, rows))
    ratio, wide = np.exp(logs[[0, 2]] - logs[1]), np.exp(half_width(sd))
    ratios = np.stack([s[[0, 2]], ratio, ratio / wide, ratio * wide], axis=1)
    return (*known, Notice("no scale", {"ratios": ratios.tolist()}))


def _of_shape(known: KnownShape) -> Notice:
    code, exact = "even k", ""
    if known.section is not None:
        code = "k by section"
        if known.errors(np.zeros(1)).size == 0:
            exact = "I_sd" if known.section.moment is not None else "section_sd_m"
    return Notice(code, {"exact": exact, "varies": known.varies})
