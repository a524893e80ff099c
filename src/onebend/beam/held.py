"""A beam held at both ends: the pose of its end s = 1 is given, the wrench there is unknown.

With the wrench (F, M) as multipliers of the end's pose the conditions are `g(q) = C^T (F, M)` and `c(q) = pose`, where
`c(q) = (x, y, alpha)` of the end and C its derivative. Newton's method on both together (a bordered system).

A held beam has several equilibria. The one returned is found by continuation with the end at its pose all the way: it
starts from the least curved shape through that pose, taken as if it were the rest shape (then no wrench is needed),
and lets the rest curvature and the loads go over to the true ones. Where the branch ends unstable, the beam is let down
to the stable equilibrium below it. A gripper's history is followed with `hold_along`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.loads import Loads
from onebend.beam.statics import (
    Equilibrium,
    Problem,
    Resolution,
    Rod,
    gradient,
    node_angles,
    pose,
    positive_definite,
    tangent,
    transposed,
)
from onebend.errors import MechanicsError
from onebend.records import Array, BoolArray

_TOLERANCE = 1e-11  # of the last update, as an angle


@dataclass(frozen=True)
class Held:
    """Equilibria of a beam held at both ends."""

    solved: Equilibrium  # `converged`: the end is at its pose in equilibrium; `stable`: with both ends held
    wrench: Array  # (T, 3) N, N, N m: what the second end's holder puts on the beam
    jumped: BoolArray  # (T,) the branch lost stability on the way and the beam was let down to a stable equilibrium


def hold(
    beam: Rod,
    end: ArrayLike,
    loads: Loads = Loads(),
    *,
    resolution: Resolution = Resolution(order=16, widest=0.5),
    start: Array | None = None,
) -> Held:
    """Equilibria with the end s = 1 held at `end`: (3,) or (T, 3) of x [m], y [m], angle [rad].

    `start` (T, Q): curvature at the grid's nodes to begin from instead of the least curved shape.

    Raises:
        MechanicsError: a pose farther away than the beam is long, or k(s) not positive.
    """
    goal = np.atleast_2d(np.asarray(end, dtype=float))
    size = max(len(goal), loads.size)
    goal = np.broadcast_to(goal, (size, 3))
    reach = np.linalg.norm(goal[:, :2], axis=1)
    if np.any(reach >= beam.length):
        frame = int(np.argmax(reach))
        raise MechanicsError(
            f"pose {frame}: the end is held {reach[frame]:.4g} m from the clamp, but the beam is "
            f"{beam.length:.4g} m long and does not stretch; bring the ends closer"
        )
    problem = pose(beam, loads.spread(size), resolution)
    begin = _least_curved(problem, goal) if start is None else np.array(np.broadcast_to(start, (size, start.shape[-1])))
    return _release(problem, begin, goal)


def hold_along(
    beam: Rod, path: Array, loads: Loads = Loads(), *, resolution: Resolution = Resolution(order=16, widest=0.5)
) -> Held:
    """The beam while its end is led along `path` (P, 3), each pose from the one before; one equilibrium a pose.

    The path must be fine enough that no pose turns the beam by more than about a quarter of a radian; where the beam
    snaps over, `jumped` says so.
    """
    poses = np.asarray(path, dtype=float)
    here = hold(beam, poses[0], loads, resolution=resolution)
    found = [here]
    for goal in poses[1:]:
        q, wrench, near = _newton(here.solved.problem, here.solved.q, here.wrench, goal[None], trust=0.5)
        here = _settled(here.solved.problem, q, wrench, goal[None], near)
        found.append(here)
    return Held(
        solved=Equilibrium(
            problem=pose(beam, loads.spread(len(poses)), resolution),
            q=np.concatenate([h.solved.q for h in found]),
            converged=np.concatenate([h.solved.converged for h in found]),
            stable=np.concatenate([h.solved.stable for h in found]),
            load_factor=np.ones(len(poses)),
            buckled_at=np.full(len(poses), np.nan),
            iterations=max(h.solved.iterations for h in found),
        ),
        wrench=np.concatenate([h.wrench for h in found]),
        jumped=np.concatenate([h.jumped for h in found]),
    )


def end_pose(problem: Problem, q: Array) -> Array:
    """(T, 3) x, y, angle of the end s = 1."""
    alpha = node_angles(problem, q)
    lw = problem.length * problem.weights
    x, y = np.sum(lw * np.cos(alpha), axis=-1), np.sum(lw * np.sin(alpha), axis=-1)
    angle = np.sum(problem.weights * q, axis=-1) + np.ravel(problem.alpha0)
    return np.stack([x, y, angle], axis=-1)


def end_jacobian(problem: Problem, q: Array) -> Array:
    """(T, 3, Q) derivative of the end's pose with the curvature at the nodes."""
    alpha = node_angles(problem, q)
    lw = problem.length * problem.weights
    turning = np.stack([-lw * np.sin(alpha), lw * np.cos(alpha)], axis=-2)
    angle = np.broadcast_to(problem.weights, alpha.shape)[:, None, :]
    return np.concatenate([turning @ problem.to_nodes, angle], axis=-2)


def end_curvature(problem: Problem, q: Array, wrench: Array) -> Array:
    """(T, Q, Q) second derivative of the end's pose times the wrench: what the wrench takes off the tangent."""
    alpha = node_angles(problem, q)
    along = wrench[:, :1] * np.cos(alpha) + wrench[:, 1:2] * np.sin(alpha)
    b = problem.to_nodes
    return -transposed(b) @ ((problem.length * problem.weights * along)[..., None] * b)


def _least_curved(problem: Problem, goal: Array) -> Array:
    """(T, Q) curvature of least `int q^2` that brings the end to its pose, from a cubic curve as a first guess."""
    even = replace(
        problem,
        k=np.ones_like(problem.k) * np.mean(problem.k),
        q0=np.zeros_like(problem.q0),
        dead_force=np.zeros_like(problem.dead_force),
        moment=np.zeros_like(problem.moment),
        follower=np.zeros_like(problem.follower),
    )
    q = _guess(problem, goal)
    for _ in range(60):  # Gauss-Newton onto the constraint, minimum norm in the weighted sense
        c = end_jacobian(even, q)
        away = goal - end_pose(even, q)
        scaled = c / np.broadcast_to(problem.weights, q.shape)[:, None, :]
        step = np.einsum("tcq,tc->tq", scaled, np.linalg.solve(c @ transposed(scaled), away[..., None])[..., 0])
        largest = np.max(np.abs(node_angles(even, step) - even.alpha0), axis=-1, keepdims=True)
        q = q + step * np.minimum(1.0, 0.5 / np.maximum(largest, 1e-300))
        if np.max(np.abs(away)) < 1e-13 * float(np.max(problem.length)):
            break
    return q


def _guess(problem: Problem, goal: Array) -> Array:
    """Quadratic curvature with the right end angle, bowed enough to shorten the chord to the goal's distance."""
    s = problem.grid.nodes
    turn = goal[:, 2:] - np.ravel(problem.alpha0)[:, None]
    chord = np.arctan2(goal[:, 1], goal[:, 0])[:, None] - np.ravel(problem.alpha0)[:, None]
    slope = 6.0 * (turn - 2.0 * chord)  # of q, from the end's angle and the chord's direction for small angles
    q = turn + 0.5 * slope * (2.0 * s - 1.0)
    # A bow of curvature ~ (1 - 6 s + 6 s^2) turns neither end nor chord but shortens: (amplitude/2pi)^2 roughly.
    reach = np.linalg.norm(goal[:, :2], axis=1, keepdims=True) / problem.length
    alpha = node_angles(problem, q)
    spread = np.mean((alpha - np.mean(alpha, axis=1, keepdims=True)) ** 2, axis=1, keepdims=True)
    missing = np.maximum(2.0 * (1.0 - reach) - spread, 0.0)
    side = np.where(turn * chord >= 0.0, 1.0, -1.0) * np.where(chord + turn >= 0.0, 1.0, -1.0)
    return np.asarray(q + side * np.sqrt(missing * 210.0) * (1.0 - 6.0 * s + 6.0 * s**2) / 1.0)


def _release(problem: Problem, begin: Array, goal: Array) -> Held:
    """From `begin` as a stress-free shape over to the true rest curvature and loads, the end held at `goal`."""
    size = len(begin)
    q, wrench = begin.copy(), np.zeros((size, 3))
    factor, step = np.zeros(size), np.full(size, 0.25)
    jumped = np.zeros(size, dtype=bool)
    for _ in range(200):
        todo = np.flatnonzero((factor < 1.0) & (step > 1e-6))
        if todo.size == 0:
            break
        part = problem.take(todo)
        target = np.minimum(factor[todo] + step[todo], 1.0)
        blended = _blend(part, begin[todo], target)
        found, push, near = _newton(blended, q[todo], wrench[todo], goal[todo], trust=0.4)
        near &= _stable(blended, found, push) | (step[todo] < 1e-3)
        q[todo[near]], wrench[todo[near]], factor[todo[near]] = found[near], push[near], target[near]
        step[todo] = np.where(near, 2.0 * step[todo], 0.25 * step[todo])
    return _settled(problem, q, wrench, goal, factor >= 1.0, jumped)


def _blend(problem: Problem, begin: Array, factor: Array) -> Problem:
    """The problem with a share `factor` of its true rest curvature and loads."""
    f = factor[:, None]
    return replace(
        problem,
        q0=(1.0 - f) * begin + f * problem.q0,
        dead_force=f[..., None] * problem.dead_force,
        moment=f * problem.moment,
        follower=f[..., None] * problem.follower,
    )


def _settled(
    problem: Problem, q: Array, wrench: Array, goal: Array, near: BoolArray, jumped: BoolArray | None = None
) -> Held:
    """Stability at the end; frames that lost it are let down the energy to a stable equilibrium, and said to have."""
    jumped = np.zeros(len(q), dtype=bool) if jumped is None else jumped
    stable = _stable(problem, q, wrench) & near
    for i in np.flatnonzero(~stable):
        one = problem.take(np.array([i]))
        found = _descend(one, q[i : i + 1], goal[i : i + 1])
        if found is not None:
            q[i], wrench[i] = found[0][0], found[1][0]
            stable[i] = near[i] = jumped[i] = True
    solved = Equilibrium(
        problem=problem,
        q=q,
        converged=near.copy(),
        stable=stable,
        load_factor=np.where(near, 1.0, np.nan),
        buckled_at=np.full(len(q), np.nan),
        iterations=0,
    )
    return Held(solved, wrench, jumped)


def _newton(
    problem: Problem, start: Array, wrench: Array, goal: Array, *, trust: float, most: int = 12
) -> tuple[Array, Array, BoolArray]:
    """Newton on shape and wrench; True where it settled without turning by more than `trust`."""
    q, w = start.copy(), wrench.copy()
    settled = np.zeros(len(q), dtype=bool)
    nodes = q.shape[1]
    system = np.zeros((len(q), nodes + 3, nodes + 3))
    for _ in range(most):
        c = end_jacobian(problem, q)
        system[:, :nodes, :nodes] = tangent(problem, q) - end_curvature(problem, q, w)
        system[:, :nodes, nodes:] = -transposed(c)
        system[:, nodes:, :nodes] = c
        unbalanced = gradient(problem, q) - np.einsum("tcq,tc->tq", c, w)
        right = np.concatenate([-unbalanced, goal - end_pose(problem, q)], axis=1)
        try:
            step = np.linalg.solve(system, right[..., None])[..., 0]
        except np.linalg.LinAlgError:
            step = np.stack([np.linalg.lstsq(m, r, rcond=None)[0] for m, r in zip(system, right, strict=True)])
        q, w = q + step[:, :nodes], w + step[:, nodes:]
        turn = np.max(np.abs(node_angles(problem, step[:, :nodes]) - problem.alpha0), axis=-1)
        settled = turn < _TOLERANCE
        if np.all(settled | ~np.isfinite(turn)):
            break
    moved = np.max(np.abs(node_angles(problem, q) - node_angles(problem, start)), axis=-1)
    return q, w, np.asarray(settled & (moved < trust))


def _stable(problem: Problem, q: Array, wrench: Array) -> BoolArray:
    """(T,) whether the second variation is positive on all changes of shape that leave both ends where they are."""
    second = tangent(problem, q) - end_curvature(problem, q, wrench)
    scale = 1.0 / np.sqrt(problem.weights * problem.k)
    scaled = second * (scale[..., :, None] * scale[..., None, :])
    c = end_jacobian(problem, q) * np.broadcast_to(scale, q.shape)[:, None, :]
    free = np.linalg.qr(transposed(c), mode="complete")[0][..., 3:]
    return positive_definite(transposed(free) @ scaled @ free)


def _descend(problem: Problem, start: Array, goal: Array) -> tuple[Array, Array] | None:
    """One frame: Newton with the second variation made positive on the free directions, halved until energy falls."""
    q = start.copy()
    scale = 1.0 / np.sqrt(np.broadcast_to(problem.weights * problem.k, q.shape))[0]
    for _ in range(300):
        c = end_jacobian(problem, q)[0] * scale
        basis = np.linalg.qr(c.T, mode="complete")[0]
        fixed, free = basis[:, :3], basis[:, 3:]
        normal = -fixed @ np.linalg.lstsq(c @ fixed, (end_pose(problem, q) - goal)[0], rcond=None)[0]
        slope = gradient(problem, q)[0] * scale
        wrench = np.linalg.lstsq(c.T, slope, rcond=None)[0]
        second = (tangent(problem, q) - end_curvature(problem, q, wrench[None]))[0] * scale[:, None] * scale
        values, vectors = np.linalg.eigh(free.T @ second @ free)
        down = free.T @ slope
        amplitude = vectors.T @ down
        # On a perfect bifurcation the slope has no part along the unstable direction: a nudge decides the side.
        amplitude = amplitude + np.where(values < 0.0, 1e-6, 0.0)
        step = (normal + free @ (vectors @ (-amplitude / np.maximum(np.abs(values), 1e-3)))) * scale
        turn = float(np.max(np.abs(problem.to_nodes @ step)))
        q = q + step * min(1.0, 0.2 / max(turn, 1e-300))
        if turn < 1e-7 and values[0] > 0.0:
            found, push, near = _newton(problem, q, wrench[None], goal, trust=0.1)
            return (found, push) if near[0] and _stable(problem, found, push)[0] else None
    return None
