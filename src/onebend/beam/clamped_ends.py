"""A beam held at both ends: the pose of s = 1 is given, the wrench there unknown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from onebend.beam import statics
from onebend.beam.grid import apply, transposed
from onebend.beam.problem import Problem
from onebend.records import Array, BoolArray, IntArray

# The wrench (F, M) is the multiplier of the end's pose: `g(q) = C^T (F, M)`, `c(q) = (x, y, alpha) = pose`, C the
# derivative of c. Newton's method solves both (bordered system). The equilibrium is stable if the second variation is
# positive on changes that keep the end.
#
# With stretch and shear the wrench also strains the beam. With D = dc/dF at fixed q the step's matrix is
# `[T, -C^T; C, D]`, and the equilibrium is stable if `[T, C^T; C, -D]` has three negative eigenvalues.

_TOLERANCE = 1e-11  # of the last update, as an angle


def end_pose(problem: Problem, q: Array) -> Array:
    """(T, 3) x, y, angle of s = 1."""
    lw, slope = problem.length * problem.weights, statics.centreline_slope(problem, statics.nodal_forces(problem, q))
    x, y = np.sum(lw * slope[..., 0], axis=-1), np.sum(lw * slope[..., 1], axis=-1)
    angle = np.sum(problem.weights * q, axis=-1) + np.ravel(problem.alpha0)
    return np.stack([x, y, angle], axis=-1)


def end_jacobian(problem: Problem, q: Array) -> Array:
    """(T, 3, Q) derivative of the end's pose by the curvature."""
    lw, ways = problem.length * problem.weights, statics.nodal_forces(problem, q).lever
    turning = np.stack([lw * ways[..., 0], lw * ways[..., 1]], axis=-2)
    angle = np.broadcast_to(problem.weights, q.shape)[:, None, :]
    return np.concatenate([turning @ problem.to_nodes, angle], axis=-2)


def second_variation(problem: Problem, q: Array, wrench: Array) -> Array:
    """(T, Q, Q) tangent with the wrench as a dead load."""
    return statics.tangent(with_end_wrench(problem, wrench), q)


def with_end_wrench(problem: Problem, wrench: Array) -> Problem:
    """With an additional force and moment (T, 3) N, N, N m at the end."""
    return replace(
        problem,
        dead_force=problem.dead_force + wrench[:, None, :2],
        moment=problem.moment + wrench[:, 2:],
    )


def newton(
    problem: Problem, start: Array, wrench: Array, goal: Array, *, trust: float, max_iterations: int = 12
) -> tuple[Array, Array, BoolArray]:
    """Shape and wrench, and whether Newton's method converged within a turn of `trust`."""
    q, w, nodes = start.copy(), wrench.copy(), start.shape[1]
    settled, strayed = np.zeros(len(q), dtype=bool), np.zeros(len(q), dtype=bool)
    for _ in range(max_iterations):
        todo = np.flatnonzero(~(settled | strayed))
        if todo.size == 0:
            break
        part = problem.take(todo)
        step = _bordered_step(part, q[todo], w[todo], goal[todo])
        turned = statics.node_angles(part, step[:, :nodes]) - part.alpha0
        q[todo] += step[:, :nodes]
        w[todo] += step[:, nodes:]
        settled[todo] = np.max(np.abs(turned), axis=-1) < _TOLERANCE
        moved = statics.node_angles(part, q[todo]) - statics.node_angles(part, start[todo])
        strayed[todo] = ~(np.max(np.abs(moved), axis=-1) < trust)
    return q, w, np.asarray(settled & ~strayed)


def _bordered_step(problem: Problem, q: Array, wrench: Array, goal: Array) -> Array:
    loaded, nodes = with_end_wrench(problem, wrench), q.shape[1]
    system, c = np.zeros((len(q), nodes + 3, nodes + 3)), end_jacobian(loaded, q)
    system[:, :nodes, :nodes], system[:, :nodes, nodes:] = statics.tangent(loaded, q), -transposed(c)
    system[:, nodes:, :nodes], system[:, nodes:, nodes:] = c, _pose_by_wrench(loaded, q)
    return statics.solve_batch(
        system, np.concatenate([-statics.gradient(loaded, q), goal - end_pose(loaded, q)], axis=1)
    )


def stands(problem: Problem, q: Array, wrench: Array) -> BoolArray:
    """(T,) whether the second variation is positive on changes that keep both ends."""
    if len(q) == 0:
        return np.zeros(0, dtype=bool)
    scale = problem.unbend
    if problem.compliance is not None:
        return _stands_strained(with_end_wrench(problem, wrench), q, np.broadcast_to(scale, q.shape))
    scaled = second_variation(problem, q, wrench) * (scale[..., :, None] * scale[..., None, :])
    c = end_jacobian(problem, q) * np.broadcast_to(scale, q.shape)[:, None, :]
    free = np.linalg.qr(transposed(c), mode="complete")[0][..., 3:]
    return statics.positive_definite(transposed(free) @ scaled @ free)


def _stands_strained(loaded: Problem, q: Array, scale: Array) -> BoolArray:
    """The same with stretch and shear, by counting negative eigenvalues."""
    nodes, c = q.shape[1], end_jacobian(loaded, q) * scale[:, None, :]
    root = np.sqrt(np.sum(np.broadcast_to(loaded.weights * loaded.k, q.shape), axis=-1, keepdims=True))
    unit = root * np.concatenate([1.0 / (loaded.length * np.ones((len(q), 2))), np.ones((len(q), 1))], axis=1)
    matrix = np.zeros((len(q), nodes + 3, nodes + 3))
    matrix[:, :nodes, :nodes] = statics.tangent(loaded, q) * scale[..., :, None] * scale[..., None, :]
    matrix[:, nodes:, :nodes] = c * unit[..., None]
    matrix[:, :nodes, nodes:] = transposed(matrix[:, nodes:, :nodes])
    matrix[:, nodes:, nodes:] = -_pose_by_wrench(loaded, q) * unit[..., :, None] * unit[..., None, :]
    return np.asarray(np.sum(np.linalg.eigvalsh(matrix) < 0.0, axis=-1) == 3)


def _pose_by_wrench(loaded: Problem, q: Array) -> Array:
    """(T, 3, 3) of the end's pose by the wrench at fixed q."""
    out = np.zeros((len(q), 3, 3))
    if loaded.compliance is None:
        return out
    lw = (loaded.length * loaded.weights)[..., None, None]
    out[:, :2, :2] = np.sum(lw * statics.strain_by_force(loaded, statics.nodal_forces(loaded, q)), axis=1)
    return out


def restore(problem: Problem, start: Array, goal: Array) -> tuple[Array, BoolArray]:
    """Without strain: shapes near `start` with the end at `goal`, by Gauss-Newton steps of least `int dq^2`, and
    whether they reached it."""
    q = start.copy()
    weights = np.broadcast_to(problem.weights, q.shape)[:, None, :]
    for _ in range(60):
        c, away = end_jacobian(problem, q), goal - end_pose(problem, q)
        if np.max(np.abs(away)) < 1e-13 * float(np.max(problem.length)):
            break
        scaled = c / weights
        step = np.einsum("tcq,tc->tq", scaled, statics.solve_batch(c @ transposed(scaled), away))
        turn = np.max(np.abs(statics.node_angles(problem, step) - problem.alpha0), axis=-1, keepdims=True)
        q = q + step * np.minimum(1.0, 0.5 / np.maximum(turn, 1e-300))
    return q, np.asarray(np.max(np.abs(goal - end_pose(problem, q)), axis=-1) < 1e-10 * np.max(problem.length))


_LARGEST_TURN = 0.4  # rad, largest turn of a step
_SHORTEST = 1e-5  # share of the way: shortest stable step before a snap

Homotopy = Callable[[IntArray, Array], tuple[Problem, Array]]  # frames, share -> problem and pose


def rigid(problem: Problem) -> Problem:
    """Without stretch and shear."""
    return problem if problem.compliance is None else replace(problem, section=None, stretch=None, shear=None)


def let_strain(problem: Problem, q: Array, wrench: Array, goal: Array) -> tuple[Array, Array, BoolArray]:
    """Shapes and wrenches (T, 3) of `rigid` beams as strain grows from zero, and whether they got there."""
    if problem.compliance is None:
        return q, wrench, np.ones(len(q), dtype=bool)

    def partly(frames: IntArray, share: Array) -> tuple[Problem, Array]:
        return problem.take(frames).strained(share), goal[frames]

    q, wrench, share = follow_homotopy(partly, q, wrench)
    return q, wrench, np.asarray(share == 1.0)


def release(problem: Problem, begin: Array, goal: Array) -> tuple[Array, Array, Array]:
    """From `begin` as stress-free shape to the true rest curvature and loads, the end at `goal`."""

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
    """Stable equilibria (T, Q) and wrenches (T, 3) along the homotopy, and the share (T,) reached."""
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


_SAME_EQUILIBRIUM = 0.7  # rad, largest turn within one equilibrium
_MAX_ITERATIONS = 25


def hold_near(problem: Problem, start: Array, end: Array, *, fall: bool) -> tuple[statics.Equilibrium, Array]:
    """Equilibria near shapes `start` (T, Q) with the end s = 1 at `end` (T, 3) m, m, rad, and the wrench (T, 3).

    They are those of the problem with that wrench as a dead load (`under`), as are their derivatives. With `fall` a
    start may be far from balance.
    """
    wrench = balancing_wrench(rigid(problem), start)
    q, w, near = newton(problem, start, wrench, end, trust=_SAME_EQUILIBRIUM, max_iterations=_MAX_ITERATIONS)
    near[near] &= stands(problem.take(near), q[near], w[near])
    lost = np.flatnonzero(~near)
    q[lost], w[lost] = start[lost], wrench[lost]
    if fall and lost.size:
        q[lost], w[lost], near[lost] = _let_go(problem.take(lost), start[lost], end[lost])
    return statics.found_near(with_end_wrench(problem, w), q, near), w


def _let_go(problem: Problem, start: Array, end: Array) -> tuple[Array, Array, BoolArray]:
    """From shapes (T, Q) as stress-free to the true rest and loads; strains last."""
    plain = rigid(problem)
    begin, there = restore(plain, start, end)
    q, w, share = release(plain, begin, end)
    q, w, strained = let_strain(problem, q, w, end)
    return q, w, np.asarray(there & (share == 1.0) & strained)


def balancing_wrench(problem: Problem, q: Array) -> Array:
    """(T, 3) end wrench that balances shapes (T, Q) best, in the norm of the bending energy."""
    scale = np.broadcast_to(problem.unbend, q.shape)
    c = end_jacobian(problem, q) * scale[:, None, :]
    return statics.solve_batch(c @ transposed(c), apply(c, statics.gradient(problem, q) * scale))
