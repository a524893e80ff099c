"""The search for the equilibria of a beam held at both ends: for made recordings, and as a peer of `hold_near`.

A held beam has several equilibria. `hold` is for a beam brought to its pose in no particular way: several shapes
through the pose are each followed, with the end at its pose all the way, from being stress-free to the true rest
curvature and loads. Of the stable equilibria the one of least potential energy is returned. `hold_along` follows a
beam from pose to pose, and says where it snaps over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam import clamped_ends
from onebend.beam.clamped_ends import (
    end_jacobian,
    end_pose,
    follow_homotopy,
    newton,
    release,
    restore,
    rigid,
    second_variation,
    stands,
    with_end_wrench,
)
from onebend.beam.continuation import to_the_left
from onebend.beam.loads import Loads
from onebend.beam.problem import Problem, Resolution, Rod, make_problem
from onebend.beam.statics import Equilibrium, gradient, node_angles, potential
from onebend.errors import MechanicsError
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray, IntArray
from tests.beam.wrench import clamp_wrench

_NEIGHBOUR = 0.05  # rad, the largest turn from a coarser grid's equilibrium to that of a finer grid
_FAR = 2.0  # rad, from a circular arc's chord: beyond it turning the other way to the chord may be the easier
_COARSEST = Resolution(order=16, widest=0.5)
_FINEST = 1.0 / 8.0  # widest panel at the end of refinement
_BATCH = 4_000_000  # entries of the tangents solved together: what stays within some ten MB


@dataclass(frozen=True)
class ClampedEquilibrium:
    """Equilibria of a beam held at both ends.

    Where it stretches and shears, the wrench is among the loads of `solved.problem`, since it strains the beam.
    """

    solved: Equilibrium  # `converged`: the end is at its pose in equilibrium; `stable`: with both ends held
    wrench: Array  # (T, 3) N, N, N m: what the second end's holder puts on the beam
    jumped: BoolArray  # (T,) the branch lost stability on the way here and the beam fell to a lower equilibrium

    @property
    def clamp_wrench(self) -> Array:
        """(T, 3) N, N, N m: what the clamp at s = 0 puts on the beam; with `wrench` and all loads it cancels."""
        if self.solved.problem.compliance is not None:
            return clamp_wrench(self.solved)
        x, y, _ = end_pose(self.solved.problem, self.solved.q).T
        fx, fy, moment = self.wrench.T
        return np.asarray(clamp_wrench(self.solved) - np.stack([fx, fy, x * fy - y * fx + moment], axis=-1))


@one_blas_thread
def hold(
    beam: Rod, end: ArrayLike, loads: Loads = Loads(), *, resolution: Resolution | None = None
) -> ClampedEquilibrium:
    """Equilibria with the end s = 1 held at `end`: (3,) or (T, 3) of x [m], y [m], angle [rad].

    The angle counts full turns. Where two equilibria have the same energy (a pose on the clamp's axis) the beam bows to
    its left. Without a `resolution` the grid is refined until the curvature is resolved, to 128 nodes a beam at most;
    `solved.resolved` says whether that was enough.

    Raises:
        MechanicsError: a pose at least as far away as the beam is long, or k(s) not positive.
    """
    goal = _goals(beam, end, loads)
    loads = loads.spread(len(goal))
    held = _hold(beam, goal, loads, resolution or _COARSEST)
    widest = _COARSEST.widest
    while resolution is None and widest > _FINEST and not np.all(held.solved.resolved):
        widest *= 0.5
        held = _resolve(held, make_problem(beam, loads, replace(_COARSEST, widest=widest)), goal)
    return _under_wrench(held)


@one_blas_thread
def hold_along(
    beam: Rod, path: ArrayLike, loads: Loads = Loads(), *, resolution: Resolution = Resolution(order=16, widest=0.25)
) -> ClampedEquilibrium:
    """The beam while its end is led along `path` (P, 3) of x [m], y [m], angle [rad]; one equilibrium a pose.

    Between two poses the end moves in a straight line and turns evenly, in as many steps as it takes. `jumped` marks
    the poses on the way to which the beam snapped over: it is then let down the energy at that pose.

    Raises:
        MechanicsError: as `hold`; loads for more than one frame (they act all along the path).
    """
    poses = _goals(beam, path, Loads())
    if loads.size != 1:
        raise MechanicsError(f"loads for {loads.size} frames: along a path one set of loads acts all the way")
    solutions = [_hold(beam, _goals(beam, poses[:1], loads), loads, resolution)]
    problem = solutions[0].solved.problem
    for before, after in pairwise(poses):
        here = solutions[-1]

        def on_the_way(_: IntArray, share: Array, a: Array = before, b: Array = after) -> tuple[Problem, Array]:
            return problem, a + share[:, None] * (b - a)

        q, wrench, share = follow_homotopy(on_the_way, here.solved.q, here.wrench)
        solutions.append(_land(problem, q, wrench, after[None], share))
    return _under_wrench(_join(make_problem(beam, loads.spread(len(poses)), resolution), solutions))


def _goals(beam: Rod, end: ArrayLike, loads: Loads) -> Array:
    """(T, 3) poses, checked."""
    goal = np.atleast_2d(np.asarray(end, dtype=float))
    if goal.ndim != 2 or goal.shape[1] != 3 or not np.all(np.isfinite(goal)):
        raise MechanicsError(f"a pose is three finite numbers x, y, angle; got an array of shape {np.shape(end)}")
    goal = np.array(np.broadcast_to(goal, (max(len(goal), loads.size), 3)))
    reach = np.linalg.norm(goal[:, :2], axis=1)
    if np.any(reach >= beam.length):
        frame = int(np.argmax(reach))
        raise MechanicsError(
            f"pose {frame}: the end is held {reach[frame]:.4g} m from the clamp, but the beam is {beam.length:.4g} m "
            "long at rest; bring the ends closer"
        )
    return goal


def _hold(beam: Rod, goal: Array, loads: Loads, resolution: Resolution) -> ClampedEquilibrium:
    """From every first shape to equilibrium, and the lowest of those, in batches that fit the memory."""
    problem = make_problem(beam, loads.spread(len(goal)), resolution)
    several = max(1, _BATCH // problem.to_nodes.shape[-1] ** 2)
    parts = [np.arange(i, min(i + several, len(goal))) for i in range(0, len(goal), several)]
    return _join(problem, [_lowest(problem.take(frames), goal[frames]) for frames in parts])


def _resolve(held: ClampedEquilibrium, finer: Problem, goal: Array) -> ClampedEquilibrium:
    """The same equilibria on a finer grid; sought anew where the finer one is not close by."""
    start = held.solved.q @ held.solved.problem.grid.value_at(finer.grid.nodes).T
    q, wrench, near = newton(finer, start, held.wrench, goal, trust=_NEIGHBOUR)
    near &= held.solved.stable
    near[near] &= stands(finer.take(near), q[near], wrench[near])
    jumped = held.jumped.copy()
    lost = np.flatnonzero(~near)
    if lost.size:
        again = _lowest(finer.take(lost), goal[lost])
        q[lost], wrench[lost] = again.solved.q, again.wrench
        near[lost], jumped[lost] = again.solved.stable, again.jumped
    return _held(finer, q, wrench, near, jumped)


def _lowest(problem: Problem, goal: Array) -> ClampedEquilibrium:
    """The beam without strain at its lowest, and then as it strains."""
    held = _lowest_rigid(rigid(problem), goal)
    if problem.compliance is None:
        return held
    q, wrench, there = clamped_ends.let_strain(problem, held.solved.q, held.wrench, goal)
    return _held(problem, q, wrench, np.asarray(there & held.solved.stable), held.jumped)


def _lowest_rigid(problem: Problem, goal: Array) -> ClampedEquilibrium:
    """Of the equilibria that grow from the first shapes, the stable one of least energy; the first where equal.

    Where none of the walks came to its end, the beam is let down from where the longest of them stopped.
    """
    rows = np.arange(len(goal))
    q, wrench = np.zeros((4, *np.shape(problem.dead_force)[:2])), np.zeros((4, len(goal), 3))
    share, energy = np.full((4, len(goal)), -1.0), np.full((4, len(goal)), np.inf)
    for i, (frames, begin) in enumerate(_first_shapes(problem, goal)):
        part = problem.take(frames)
        q[i, frames], wrench[i, frames], share[i, frames] = release(part, begin, goal[frames])
        energy[i, frames] = np.where(share[i, frames] == 1.0, potential(part, q[i, frames]), np.inf)
    least = np.min(energy, axis=0)
    equal = 1e-9 * np.ravel(np.sum(problem.weights * problem.k, axis=-1))
    best = np.where(np.isfinite(least), np.argmax(energy <= least + equal, axis=0), np.argmax(share, axis=0))
    return _land(problem, q[best, rows], wrench[best, rows], goal, share[best, rows])


def _first_shapes(problem: Problem, goal: Array) -> list[tuple[IntArray, Array]]:
    """Frames, and shapes (frames, Q) through their pose without regard to forces.

    For small angles curvature `turn + slope (s - 1/2)` has the end's angle and the chord's direction; the part
    `1 - 6 s + 6 s^2` changes neither, but shortens the chord. Both signs of it; and where the chord is far from a
    circular arc's (half the end's turn), both ways of turning to it.
    """
    begin = np.ravel(problem.alpha0) + np.zeros(len(goal))
    turn = goal[:, 2] - begin
    chord = np.arctan2(goal[:, 1], goal[:, 0]) - begin
    chord = chord + 2.0 * np.pi * np.round((0.5 * turn - chord) / (2.0 * np.pi))
    other = chord + 2.0 * np.pi * np.where(chord < 0.5 * turn, 1.0, -1.0)
    everywhere, far = np.arange(len(goal)), np.flatnonzero(np.abs(chord - 0.5 * turn) > _FAR)
    return [
        (frames, _bowed(problem.take(frames), goal[frames], direction[frames], side))
        for frames, direction in ((everywhere, chord), (far, other))
        for side in (1.0, -1.0)
        if frames.size
    ]


def _bowed(problem: Problem, goal: Array, chord: Array, side: float) -> Array:
    """(T, Q) one first shape, brought to the pose."""
    s = problem.grid.nodes
    turn = (goal[:, 2] - np.ravel(problem.alpha0))[:, None]
    q = turn + 6.0 * (turn - 2.0 * chord[:, None]) * (s - 0.5)
    alpha = node_angles(problem, q)
    spread = np.mean((alpha - np.mean(alpha, axis=1, keepdims=True)) ** 2, axis=1, keepdims=True)
    reach = np.linalg.norm(goal[:, :2], axis=1, keepdims=True) / problem.length
    missing = np.maximum(2.0 * (1.0 - reach) - spread, 1e-3)
    bow = np.sqrt(210.0 * missing) * (1.0 - 6.0 * s + 6.0 * s**2)  # 1/210: mean square of its angle
    return restore(problem, q + side * bow, goal)[0]


def _land(problem: Problem, q: Array, wrench: Array, goal: Array, share: Array) -> ClampedEquilibrium:
    """Frames whose walk ended early have lost stability: they fall from there to a stable equilibrium, if any."""
    jumped = share < 1.0
    stable = ~jumped
    for i in np.flatnonzero(jumped):
        part, end = problem.take(np.array([i])), goal[i : i + 1]
        fallen = let_down(rigid(part), q[i : i + 1], end)
        if fallen is not None:
            q[i : i + 1], wrench[i : i + 1], stable[i : i + 1] = clamped_ends.let_strain(part, *fallen, end)
    return _held(problem, q, wrench, stable, jumped)


def _held(problem: Problem, q: Array, wrench: Array, stable: BoolArray, jumped: BoolArray) -> ClampedEquilibrium:
    """A record of what was found; only stable equilibria are."""
    solved = Equilibrium(
        problem=problem,
        q=q,
        converged=stable,
        stable=stable,
        load_factor=np.where(stable, 1.0, np.nan),
        buckled_at=np.full(len(q), np.nan),
        fell=jumped,
        iterations=0,
    )
    return ClampedEquilibrium(solved, wrench, jumped)


def _under_wrench(held: ClampedEquilibrium) -> ClampedEquilibrium:
    """The same, the wrench among the loads where it strains the beam."""
    problem = held.solved.problem
    if problem.compliance is None:
        return held
    return replace(held, solved=replace(held.solved, problem=with_end_wrench(problem, held.wrench)))


def _join(problem: Problem, parts: list[ClampedEquilibrium]) -> ClampedEquilibrium:
    """Several results as one, in their order."""
    return _held(
        problem,
        np.concatenate([p.solved.q for p in parts]),
        np.concatenate([p.wrench for p in parts]),
        np.concatenate([p.solved.stable for p in parts]),
        np.concatenate([p.jumped for p in parts]),
    )


_FLAT = 1e-3  # least curvature of the energy in a descent, over the bending stiffness


def let_down(problem: Problem, start: Array, goal: Array) -> tuple[Array, Array] | None:
    """One frame without strain: descends the energy with the end fixed, by shortened Newton steps. Returns shape and
    wrench, or None."""
    q, there = restore(problem, start, goal)
    if not there[0]:
        return None
    for _ in range(200):
        step, wrench, rising = _way_down(problem, q)
        turn = float(np.max(np.abs(node_angles(problem, step) - problem.alpha0)))
        if turn < 1e-5 and rising:
            shape, end_wrench, near = newton(problem, q, wrench, goal, trust=0.1)
            return (shape, end_wrench) if near[0] and stands(problem, shape, end_wrench)[0] else None
        step, energy = step * min(1.0, 0.3 / max(turn, 1e-300)), potential(problem, q)[0]
        for _ in range(30):
            lower, there = restore(problem, q + step, goal)
            if there[0] and potential(problem, lower)[0] < energy:
                break
            step = 0.5 * step
        else:
            return None
        q = lower
    return None


def _way_down(problem: Problem, q: Array) -> tuple[Array, Array, bool]:
    """One frame: a step along the free directions, the balancing wrench, whether the energy is convex."""
    scale = np.broadcast_to(problem.unbend, q.shape)[0]
    c = end_jacobian(problem, q)[0] * scale
    free = np.linalg.qr(c.T, mode="complete")[0][:, 3:]
    slope = gradient(problem, q)[0] * scale
    wrench = np.linalg.lstsq(c.T, slope, rcond=None)[0][None]
    second = second_variation(problem, q, wrench)[0] * scale[:, None] * scale
    values, vectors = np.linalg.eigh(free.T @ second @ free)
    modes = free @ vectors * scale[:, None]  # (Q, Q - 3) curvature
    amplitude = (free @ vectors).T @ slope
    down = -amplitude / np.maximum(np.abs(values), _FLAT)
    falling = values < 0.0
    # At a perfect bifurcation: to the left.
    left = to_the_left(problem, q, modes[None])[0]
    down = np.where(falling & (np.abs(down) < 1e-4), 1e-4 * left, down)
    return (modes @ down)[None], wrench, not np.any(falling)
