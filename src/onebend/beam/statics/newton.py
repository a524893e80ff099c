"""Newton's method on the balance of a batch of beams, at fixed loads."""

from __future__ import annotations

import numpy as np

from onebend.beam.grid import apply, solve_each
from onebend.beam.statics.equilibrium import balance
from onebend.beam.statics.problem import Problem
from onebend.records import Array, BoolArray

TOLERANCE = 3e-7  # rad, of the last update: what is left then is its square


def correct(
    problem: Problem, start: Array, factor: Array, *, trust: Array, left: Array, most: int = 8
) -> tuple[Array, BoolArray, int]:
    """Newton from `start` (T, Q) with all loads times `factor` (T,); frames that are done are not solved again.

    Returns the shapes, True where no more than about `left` (T,) rad is left to turn and no update took the beam
    further than `trust` (T,) rad from the start, and the number of iterations. Updates fall with the square of the one
    before: after updates u and v, `v (v / u)^2` is left. Where rounding keeps updates from falling (a tangent near
    singular), one below `TOLERANCE` will do.
    """
    q = start.copy()
    near = np.zeros(len(q), dtype=bool)
    todo, part = np.arange(len(q)), problem
    at, moved, count = q, np.zeros_like(q), 0
    before = np.zeros(len(q))  # rad, the update before the last
    while todo.size and count < most:
        count += 1
        unbalanced, matrices = balance(part, at, factor)
        update = solve_batch(matrices, unbalanced)
        at = at - update
        turn = apply(part.to_nodes, update)
        size = np.max(np.abs(turn), axis=-1)
        moved = moved + turn
        strayed = ~(np.max(np.abs(moved), axis=-1) < trust)
        settled = size < TOLERANCE
        if count > 1:
            settled |= size**3 < left * before**2
        q[todo] = at
        near[todo] = settled & ~strayed
        going = np.flatnonzero(~(settled | strayed))
        if going.size < todo.size:
            todo, part = todo[going], part.take(going)
            at, moved, size = at[going], moved[going], size[going]
            factor, trust, left = factor[going], trust[going], left[going]
        before = size
    return q, near, count


def solve_batch(matrices: Array, right: Array) -> Array:
    """(T, n) solutions of (T, n, n) systems; frames whose matrix is singular come back as NaN."""
    return solve_each(matrices, right[..., None])[..., 0]
