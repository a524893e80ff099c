"""Newton's method on the balance of a batch of beams, at fixed loads."""

from __future__ import annotations

import numpy as np

from onebend.beam.grid import apply, solve_each
from onebend.beam.statics.equilibrium import balance
from onebend.beam.statics.problem import Problem
from onebend.records import Array, BoolArray

TOLERANCE = 3e-7  # rad, of the last update: what is left then is its square


def correct(
    problem: Problem, start: Array, factor: Array, *, trust: Array, remaining: Array, max_iterations: int = 8
) -> tuple[Array, BoolArray, int]:
    """Newton from `start` (T, Q) with all loads times `factor` (T,); frames that are done are not solved again.

    Returns the shapes, True where no more than about `remaining` (T,) rad is left to turn and no update took the beam
    further than `trust` (T,) rad from the start, and the number of iterations. Updates fall with the square of the one
    before: after updates u and v, `v (v / u)^2` is left. Where rounding keeps updates from falling (a tangent near
    singular), one below `TOLERANCE` will do.
    """
    q = start.copy()
    near = np.zeros(len(q), dtype=bool)
    todo, part = np.arange(len(q)), problem
    q_now, moved, count = q, np.zeros((len(q), problem.to_nodes.shape[-2])), 0
    before = np.zeros(len(q))  # rad, the update before the last
    while todo.size and count < max_iterations:
        count += 1
        residual, matrices = balance(part, q_now, factor)
        update = solve_batch(matrices, residual)
        q_now = q_now - update
        turn = apply(part.to_nodes, update)
        size = np.max(np.abs(turn), axis=-1)
        moved = moved + turn
        strayed = ~(np.max(np.abs(moved), axis=-1) < trust)
        settled = size < TOLERANCE
        if count > 1:
            settled |= size**3 < remaining * before**2
        q[todo] = q_now
        near[todo] = settled & ~strayed
        going = np.flatnonzero(~(settled | strayed))
        if going.size == 0:
            break
        if going.size < todo.size:
            todo, part = todo[going], part.take(going)
            q_now, moved, size = q_now[going], moved[going], size[going]
            factor, trust, remaining = factor[going], trust[going], remaining[going]
        before = size
    return q, near, count


def solve_batch(matrices: Array, right_side: Array) -> Array:
    """(T, n) solutions of (T, n, n) systems; frames whose matrix is singular come back as NaN."""
    return solve_each(matrices, right_side[..., None])[..., 0]
