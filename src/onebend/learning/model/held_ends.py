"""Poses whose end s = 1 somebody or something holds with a force and a moment that nobody measured.

Where the end was in such a pose counts among the parameters of the fit (three a pose, next to no prior); the wrench
follows from it. So an end seen badly, or only its direction not seen, costs what it must, and no wrench is guessed.
The wrench sets no scale: from shapes alone, with neither weight nor a force of known size, k(s) is known but for a
factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.beam.clamped_ends.end_pose import end_pose, with_end_wrench
from onebend.beam.clamped_ends.near_shape import hold_near
from onebend.beam.profiles.uncertain import UncertainStiffness, half_width
from onebend.beam.statics.continuation import follow, refine
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.problem import Problem, Resolution
from onebend.beam.statics.sensitivity import of_force, of_moment, respond
from onebend.learning.known_shape import KnownShape, known_shape
from onebend.learning.model.mass import forced, needs_mass
from onebend.learning.model.parameters import Layout
from onebend.learning.pose_equilibria import SeenPoses, nearest, seen_poses, shown_curvature, stay
from onebend.records import Array, BoolArray, IntArray, Observations, Remark

RESOLUTION = Resolution(order=6, widest=0.125)  # below 1e-7 L for physical shapes; the measurement is near 1e-4 L
HELD_RESOLUTION = Resolution(order=12, widest=0.125)  # a held beam may hang like a rope and bend sharply at its ends
_REACH = 0.999  # of the length: an end that was read as farther away is put where the way to it ends
_SETTLE = 3  # steps of the ends towards the points
_STRIDE = 0.3  # of the length, rad: the longest of them
_WEAK = 1e-6  # of the derivatives squared: what keeps an end in place that no point tells of
_PLACES = (0.1, 0.5, 0.9)  # where k is compared if only its shape is known


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
    """Derivatives of poses (F, m, 3, P), those of the end s = 1 last among the m and the wrench's last among the P.

    Returns them for the m - 1 others and the P - 3 others, the end staying where it is in the held frames, and there
    (H, m - 1, 3, 3) with the end's own pose: `dp = R dx + W dw` with `0 = R1 dx + W1 dw`.
    """
    others = poses[:, :-1, :, :-3].copy()
    held = poses[ends.frames]
    by_end = held[:, :-1, :, -3:] @ np.linalg.inv(held[:, -1, :, -3:])[:, None]
    others[ends.frames] -= by_end @ held[:, -1:, :, :-3]
    return others, by_end


def free_ends(problem: Problem, seen: SeenPoses | None, start: Array | None) -> Equilibrium:
    """Equilibria of free ends near shapes `start` (F, Q), else those that grow from rest, or that static poses show."""
    if seen is None:
        return follow(problem) if start is None else refine(problem, start)
    return nearest(problem, seen) if start is None else stay(problem, start)


def shapes_of(o: Observations, frames: BoolArray, problem: Problem) -> Equilibrium:
    """Equilibria of some frames (T,) under a `problem` that is theirs, held ends where the points are met best."""
    ends, seen = held_ends(o, frames, problem), seen_poses(o, frames)
    if ends is None:
        return free_ends(problem, seen, None)
    away = np.zeros((len(ends.frames), 3))
    solved = solve(problem, ends, away, None, seen)
    for _ in range(_SETTLE):
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


def stated_remarks(recordings: Sequence[Observations], stiffness: UncertainStiffness) -> tuple[Remark, ...]:
    """What was stated of how k varies; and what can be said of it where nothing sets its scale."""
    known = known_shape(recordings)
    said = () if known is None else (_of_shape(known),)
    return said + (_no_scale(stiffness) if sets_no_scale(recordings) else ())


def _of_shape(known: KnownShape) -> Remark:
    text = 'k is taken as one number along the beam, as stiffness_along = "even" says'
    if known.section is not None:
        text = 'k is taken as one modulus times the section\'s I(s), as stiffness_along = "section" says'
        if known.errors(np.zeros(1)).size == 0:
            sd = "I_sd" if known.section.moment is not None else "section_sd_m"
            text += f" (exact, as no {sd} is stated)"
    if known.varies > 0.0:
        text += f", and as free to vary slowly by {100.0 * known.varies:.2g} % (sd) beside that"
    return Remark("note", text)


def _no_scale(stiffness: UncertainStiffness) -> tuple[Remark, ...]:
    s = np.array(_PLACES)
    rows, logs = stiffness.basis(s), stiffness.log_at(s)[0]
    rows = rows[[0, 2]] - rows[1]
    sd = np.sqrt(np.einsum("si,ij,sj->s", rows, stiffness.covariance, rows))
    ratio, wide = np.exp(logs[[0, 2]] - logs[1]), np.exp(half_width(sd))
    said = ", ".join(
        f"{r:.3g} at s = {place:g} ({r / w:.3g} to {r * w:.3g})"
        for r, w, place in zip(ratio, wide, s[[0, 2]], strict=True)
    )
    text = (
        "the size of k(s) is not identifiable: neither weight nor a force of known size acts, only holders with "
        f"unknown ones. Only ratios are known; k over k(0.5), with its 95 % band: {said}. Weigh the beam and let its "
        "weight act, or hang on or measure one force"
    )
    return (Remark("warning", text, about="no scale"),)
