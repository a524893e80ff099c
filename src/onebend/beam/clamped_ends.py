"""A beam held at both ends: the pose of s = 1 is given, the wrench there is unknown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.continuation import to_the_left
from onebend.beam.grid import apply, solve_each, transposed
from onebend.beam.loads import Loads
from onebend.beam.problem import Problem, Resolution, Rod, make_problem
from onebend.beam.sensitivity import clamp_wrench
from onebend.beam.statics import (
    Equilibrium,
    centreline_slope,
    gradient,
    nodal_forces,
    node_angles,
    positive_definite,
    potential,
    strain_by_force,
    tangent,
)
from onebend.errors import MechanicsError
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray, IntArray

# The end s = 1 at a given pose: its derivatives, equilibrium with the wrench as unknown, stability, and letting down.
#
# With the wrench (F, M) as multipliers of the end's pose the conditions are `g(q) = C^T (F, M)` and `c(q) = pose`,
# where `c(q) = (x, y, alpha)` of the end and C its derivative: Newton's method on both together (a bordered system).
# The equilibrium stands if the second variation is positive on all changes of shape that leave the end where it is.
#
# Where the beam stretches and shears, the wrench also strains it: `c(q, F, M) = pose`, and the balance is that under
# the wrench as a dead load. With D = dc/dF at fixed q the step's matrix is `[T, -C^T; C, D]`, and the equilibrium
# stands if `[T, C^T; C, -D]` has three negative eigenvalues, one for each condition: strains minimise the energy at
# any shape.

_TOLERANCE = 1e-11  # of the last update, as an angle
_FLAT = 1e-3  # least curvature of the energy assumed in a descent, as a share of the bending stiffness


def end_pose(problem: Problem, q: Array) -> Array:
    """(T, 3) x, y, angle of the end s = 1, under the problem's loads."""
    lw, slope = problem.length * problem.weights, centreline_slope(problem, q)
    x, y = np.sum(lw * slope[..., 0], axis=-1), np.sum(lw * slope[..., 1], axis=-1)
    angle = np.sum(problem.weights * q, axis=-1) + np.ravel(problem.alpha0)
    return np.stack([x, y, angle], axis=-1)


def end_jacobian(problem: Problem, q: Array) -> Array:
    """(T, 3, Q) derivative of the end's pose with the curvature at the nodes."""
    lw, ways = problem.length * problem.weights, nodal_forces(problem, q).lever
    turning = np.stack([lw * ways[..., 0], lw * ways[..., 1]], axis=-2)
    angle = np.broadcast_to(problem.weights, q.shape)[:, None, :]
    return np.concatenate([turning @ problem.to_nodes, angle], axis=-2)


def second_variation(problem: Problem, q: Array, wrench: Array) -> Array:
    """(T, Q, Q) tangent less what the wrench's own force takes off it."""
    if problem.compliance is not None:
        return tangent(with_end_wrench(problem, wrench), q)
    alpha = node_angles(problem, q)
    along = wrench[:, :1] * np.cos(alpha) + wrench[:, 1:2] * np.sin(alpha)
    b = problem.to_nodes
    return tangent(problem, q) + transposed(b) @ ((problem.length * problem.weights * along)[..., None] * b)


def with_end_wrench(problem: Problem, wrench: Array) -> Problem:
    """With a force and a moment (T, 3) N, N, N m more at the end."""
    return replace(
        problem,
        dead_force=problem.dead_force + wrench[:, None, :2],
        moment=problem.moment + wrench[:, 2:],
    )


def newton(
    problem: Problem, start: Array, wrench: Array, goal: Array, *, trust: float, max_iterations: int = 12
) -> tuple[Array, Array, BoolArray]:
    """Shape and wrench by Newton's method; True where it settled without turning by more than `trust` on the way."""
    q, w, nodes = start.copy(), wrench.copy(), start.shape[1]
    settled, strayed = np.zeros(len(q), dtype=bool), np.zeros(len(q), dtype=bool)
    for _ in range(max_iterations):
        todo = np.flatnonzero(~(settled | strayed))
        if todo.size == 0:
            break
        part = problem.take(todo)
        step = _bordered_step(part, q[todo], w[todo], goal[todo])
        turned = node_angles(part, step[:, :nodes]) - part.alpha0
        q[todo] += step[:, :nodes]
        w[todo] += step[:, nodes:]
        settled[todo] = np.max(np.abs(turned), axis=-1) < _TOLERANCE
        moved = node_angles(part, q[todo]) - node_angles(part, start[todo])
        strayed[todo] = ~(np.max(np.abs(moved), axis=-1) < trust)
    return q, w, np.asarray(settled & ~strayed)


def _bordered_step(problem: Problem, q: Array, wrench: Array, goal: Array) -> Array:
    """(T, Q + 3): Newton's step of shape and wrench."""
    nodes = q.shape[1]
    system = np.zeros((len(q), nodes + 3, nodes + 3))
    if problem.compliance is not None:
        loaded = with_end_wrench(problem, wrench)
        c = end_jacobian(loaded, q)
        system[:, :nodes, :nodes], system[:, :nodes, nodes:] = tangent(loaded, q), -transposed(c)
        system[:, nodes:, :nodes], system[:, nodes:, nodes:] = c, _pose_by_wrench(loaded, q)
        right = np.concatenate([-gradient(loaded, q), goal - end_pose(loaded, q)], axis=1)
        return solve_each(system, right[..., None])[..., 0]
    c = end_jacobian(problem, q)
    system[:, :nodes, :nodes] = second_variation(problem, q, wrench)
    system[:, :nodes, nodes:] = -transposed(c)
    system[:, nodes:, :nodes] = c
    residual = gradient(problem, q) - np.einsum("tcq,tc->tq", c, wrench)
    return solve_each(system, np.concatenate([-residual, goal - end_pose(problem, q)], axis=1)[..., None])[..., 0]


def stands(problem: Problem, q: Array, wrench: Array) -> BoolArray:
    """(T,) whether the second variation is positive on all changes of shape that leave both ends where they are."""
    if len(q) == 0:
        return np.zeros(0, dtype=bool)
    scale = 1.0 / np.sqrt(problem.weights * problem.k)
    if problem.compliance is not None:
        return _stands_strained(with_end_wrench(problem, wrench), q, np.broadcast_to(scale, q.shape))
    scaled = second_variation(problem, q, wrench) * (scale[..., :, None] * scale[..., None, :])
    c = end_jacobian(problem, q) * np.broadcast_to(scale, q.shape)[:, None, :]
    free = np.linalg.qr(transposed(c), mode="complete")[0][..., 3:]
    return positive_definite(transposed(free) @ scaled @ free)


def _stands_strained(loaded: Problem, q: Array, scale: Array) -> BoolArray:
    """(T,) the same where the beam stretches and shears, from the number of negative eigenvalues."""
    nodes, c = q.shape[1], end_jacobian(loaded, q) * scale[:, None, :]
    root = np.sqrt(np.sum(np.broadcast_to(loaded.weights * loaded.k, q.shape), axis=-1, keepdims=True))
    unit = root * np.concatenate([1.0 / (loaded.length * np.ones((len(q), 2))), np.ones((len(q), 1))], axis=1)
    matrix = np.zeros((len(q), nodes + 3, nodes + 3))
    matrix[:, :nodes, :nodes] = tangent(loaded, q) * scale[..., :, None] * scale[..., None, :]
    matrix[:, nodes:, :nodes] = c * unit[..., None]
    matrix[:, :nodes, nodes:] = transposed(matrix[:, nodes:, :nodes])
    matrix[:, nodes:, nodes:] = -_pose_by_wrench(loaded, q) * unit[..., :, None] * unit[..., None, :]
    return np.asarray(np.sum(np.linalg.eigvalsh(matrix) < 0.0, axis=-1) == 3)


def _pose_by_wrench(loaded: Problem, q: Array) -> Array:
    """(T, 3, 3) of the end's pose with the wrench at fixed q: what it strains."""
    out = np.zeros((len(q), 3, 3))
    lw = (loaded.length * loaded.weights)[..., None, None]
    out[:, :2, :2] = np.sum(lw * strain_by_force(loaded, nodal_forces(loaded, q)), axis=1)
    return out


def restore(problem: Problem, start: Array, goal: Array) -> tuple[Array, BoolArray]:
    """Without strain: shapes near `start` with the end at `goal`, by Gauss-Newton steps of least `int dq^2`.

    True where the goal was reached.
    """
    q = start.copy()
    weights = np.broadcast_to(problem.weights, q.shape)[:, None, :]
    for _ in range(60):
        c, away = end_jacobian(problem, q), goal - end_pose(problem, q)
        if np.max(np.abs(away)) < 1e-13 * float(np.max(problem.length)):
            break
        scaled = c / weights
        step = np.einsum("tcq,tc->tq", scaled, solve_each(c @ transposed(scaled), away[..., None])[..., 0])
        turn = np.max(np.abs(node_angles(problem, step) - problem.alpha0), axis=-1, keepdims=True)
        q = q + step * np.minimum(1.0, 0.5 / np.maximum(turn, 1e-300))
    return q, np.asarray(np.max(np.abs(goal - end_pose(problem, q)), axis=-1) < 1e-10 * np.max(problem.length))


def let_down(problem: Problem, start: Array, goal: Array) -> tuple[Array, Array] | None:
    """One frame, without strain: down the energy, the end at its pose all the way, to where the beam stands.

    Newton's steps on the free directions with the second variation made positive, shortened until the energy falls.
    Returns shape and wrench; None where no stable equilibrium was reached.
    """
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
    """One frame: a step along the free directions, the wrench that balances the rest, whether the energy is convex."""
    scale = 1.0 / np.sqrt(np.broadcast_to(problem.weights * problem.k, q.shape))[0]
    c = end_jacobian(problem, q)[0] * scale
    free = np.linalg.qr(c.T, mode="complete")[0][:, 3:]
    slope = gradient(problem, q)[0] * scale
    wrench = np.linalg.lstsq(c.T, slope, rcond=None)[0][None]
    second = second_variation(problem, q, wrench)[0] * scale[:, None] * scale
    values, vectors = np.linalg.eigh(free.T @ second @ free)
    modes = free @ vectors * scale[:, None]  # (Q, Q - 3) as curvature
    amplitude = (free @ vectors).T @ slope
    down = -amplitude / np.maximum(np.abs(values), _FLAT)
    falling = values < 0.0
    # At a perfect bifurcation the slope has no part along the unstable direction: to the left then.
    left = to_the_left(problem, q, modes[None])[0]
    down = np.where(falling & (np.abs(down) < 1e-4), 1e-4 * left, down)
    return (modes @ down)[None], wrench, not np.any(falling)


# A held beam followed while its loads, rest shape, pose or strains go over from one setting to another.

_LARGEST_TURN = 0.4  # rad, the largest turn that one step may take
_SHORTEST = 1e-5  # share of the way: where no step above this keeps the beam stable, it snaps

Homotopy = Callable[[IntArray, Array], tuple[Problem, Array]]  # frames, share of the way -> problem and pose there


def rigid(problem: Problem) -> Problem:
    """The same beam without stretch and shear."""
    return problem if problem.compliance is None else replace(problem, section=None, stretch=None, shear=None)


def let_strain(problem: Problem, q: Array, wrench: Array, goal: Array) -> tuple[Array, Array, BoolArray]:
    """Shapes and wrenches (T, 3) of `rigid` beams as stretch and shear grow from nothing; True where they got there."""
    if problem.compliance is None:
        return q, wrench, np.ones(len(q), dtype=bool)

    def partly(frames: IntArray, share: Array) -> tuple[Problem, Array]:
        return problem.take(frames).strained(share), goal[frames]

    q, wrench, share = follow_homotopy(partly, q, wrench)
    return q, wrench, np.asarray(share == 1.0)


def release(problem: Problem, begin: Array, goal: Array) -> tuple[Array, Array, Array]:
    """From `begin` as a stress-free shape over to the true rest curvature and loads, the end held at `goal`."""

    def partly(frames: IntArray, share: Array) -> tuple[Problem, Array]:
        part, f = problem.take(frames), share[:, None]
        blended = replace(
            part,
            q0=(1.0 - f) * begin[frames] + f * part.q0,
            dead_force=f[..., None] * part.dead_force,
            moment=f * part.moment,
        )
        return blended, goal[frames]

    return follow_homotopy(partly, begin, np.zeros((len(begin), 3)))


def follow_homotopy(homotopy: Homotopy, start: Array, wrench: Array) -> tuple[Array, Array, Array]:
    """Stable equilibria (T, Q) and their wrench (T, 3) while a setting goes over to its end; the share (T,) reached.

    A step counts if Newton's method settled within `_TRUST` and the second variation stayed positive on the way.
    """
    q, w = start.copy(), wrench.copy()
    done, step = np.zeros(len(q)), np.full(len(q), 0.25)
    while True:
        todo = np.flatnonzero((done < 1.0) & (step > _SHORTEST))
        if todo.size == 0:
            return q, w, done
        target = np.minimum(done[todo] + step[todo], 1.0)
        problem, goal = homotopy(todo, target)
        shape, end_wrench, near = newton(problem, q[todo], w[todo], goal, trust=_LARGEST_TURN)
        near[near] &= stands(problem.take(near), shape[near], end_wrench[near])
        q[todo[near]], w[todo[near]], done[todo[near]] = shape[near], end_wrench[near], target[near]
        step[todo] = np.where(near, 2.0, 0.25) * step[todo]


# A beam held at both ends: the pose of its end s = 1 is given, the wrench there is unknown.
#
# A held beam has several equilibria, and which of them a real beam takes depends on how it came there. `hold` answers
# for a beam brought to its pose in no particular way: several shapes through the pose (bowed to either side, its
# chord reached by turning either way) are each followed, with the end at its pose all the way, from being stress-free
# to the true rest curvature and loads; of the stable equilibria found the one of least potential energy is returned.
# Where the beam stretches and shears, all this is done without; then the strains grow from nothing. `hold_along`
# answers for a known history: it follows the beam from pose to pose, and says where it snaps over.

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
    `solved.resolved` says whether that was enough. Follower loads are not taken: without an energy there is no saying
    which equilibrium is lower.

    Raises:
        MechanicsError: a pose at least as far away as the beam is long, follower loads, or k(s) not positive.
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
    if loads.follower.shape[1]:
        raise MechanicsError("follower loads on a beam held at both ends are not taken; give dead forces")
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
    q, wrench, there = let_strain(problem, held.solved.q, held.wrench, goal)
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
            q[i : i + 1], wrench[i : i + 1], stable[i : i + 1] = let_strain(part, *fallen, end)
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


# A beam held at both ends, near the shape in which it was seen: no search among equilibria, the picture tells which.
#
# Newton's method from that shape; where it strays, the shape is taken as free of stress and led over to the true rest
# and loads, its end in place.

_SAME_EQUILIBRIUM = 0.7  # rad, the largest turn from the known shape that is still the same equilibrium
_MAX_ITERATIONS = 25


def hold_near(problem: Problem, start: Array, end: Array, *, fall: bool) -> tuple[Equilibrium, Array]:
    """Equilibria near shapes `start` (T, Q) with the end s = 1 at `end` (T, 3) m, m, rad, and the wrench there (T, 3).

    The equilibria are those of the problem under that wrench as a dead load (`under`), so that their derivatives are
    those of any others. With `fall` a start may be far off balance; without it such a frame has not converged.
    """
    wrench = balancing_wrench(rigid(problem), start)
    q, w, near = newton(problem, start, wrench, end, trust=_SAME_EQUILIBRIUM, max_iterations=_MAX_ITERATIONS)
    near[near] &= stands(problem.take(near), q[near], w[near])
    lost = np.flatnonzero(~near)
    q[lost], w[lost] = start[lost], wrench[lost]
    if fall and lost.size:
        q[lost], w[lost], near[lost] = _let_go(problem.take(lost), start[lost], end[lost])
    none = np.full(len(q), np.nan)
    factor = np.where(near, 1.0, np.nan)
    return Equilibrium(
        with_end_wrench(problem, w), q, near, near.copy(), factor, none, np.zeros(len(q), dtype=bool), 0
    ), w


def _let_go(problem: Problem, start: Array, end: Array) -> tuple[Array, Array, BoolArray]:
    """From shapes (T, Q) as if free of stress to the true rest and loads, or down the energy; strains last."""
    plain = rigid(problem)
    begin, there = restore(plain, start, end)
    q, w, share = release(plain, begin, end)
    well = there & (share == 1.0)
    for i in np.flatnonzero(there & ~well).tolist():
        down = let_down(plain.take(np.array([i])), q[i : i + 1], end[i : i + 1])
        if down is not None:
            q[i], w[i], well[i] = down[0][0], down[1][0], True
    q, w, strained = let_strain(problem, q, w, end)
    return q, w, np.asarray(well & strained)


def balancing_wrench(problem: Problem, q: Array) -> Array:
    """(T, 3) the wrench at the end that brings shapes (T, Q) nearest to balance, in the norm of the bending energy."""
    scale = 1.0 / np.sqrt(np.broadcast_to(problem.weights * problem.k, q.shape))
    c = end_jacobian(problem, q) * scale[:, None, :]
    return solve_each(c @ transposed(c), apply(c, gradient(problem, q) * scale)[..., None])[..., 0]
