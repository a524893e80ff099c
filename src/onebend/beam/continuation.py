"""Following the equilibrium that grows from the rest shape while all loads grow together from nothing.

Each step of the load is predicted along the branch's tangent and corrected by Newton's method. A step counts only if
the corrector moved the shape by a small angle and the new shape is stable: then it cannot have landed on another
branch. Otherwise it is shortened. Where no step however short keeps stability, the branch has passed a bifurcation
(a perfectly straight beam under a perfectly axial load) and is followed on, marked unstable. Where no step succeeds at
all, the branch itself turns back (a limit point): a real beam would snap through.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.loads import Loads
from onebend.beam.problem import Problem, Resolution, Rod, pose
from onebend.beam.statics import Equilibrium, gradient, is_stable, node_angles, tangent
from onebend.records import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Search:
    """How the branch is followed. Angles in radians."""

    stride: float = 0.7  # the largest predicted turn of a step
    trust: float = 0.25  # the largest turn that the corrector may add to the prediction,
    surprise: float = 0.5  # and as a share of the predicted turn: next to a bifurcation two branches are close
    least_surprise: float = 1e-3  # which is allowed however small the prediction
    corrections: int = 8  # Newton iterations a step
    tolerance: float = 3e-7  # of the last Newton update, as an angle: convergence is quadratic, the error its square
    on_the_way: float = 1e-6  # the same before the full load: next to a bifurcation the side is decided by tiny turns
    shortest: float = 1e-9  # share of the load: a step below this has met the end of the branch
    most: int = 400  # steps


_PROBES = 4  # frames that decide the resolution of a batch
_FINEST = 5  # halvings of the panels


@dataclass
class _State:
    """Where each frame of a batch stands on its branch. Lives only inside `follow`."""

    q: Array
    factor: Array
    step: Array
    buckled_at: Array
    iterations: int = 0


def equilibrium(
    beam: Rod, loads: Loads, *, resolution: Resolution | None = None, search: Search = Search()
) -> Equilibrium:
    """Shapes of the beam under dead loads, on the branch that grows from its rest shape (8).

    Without a `resolution` the grid is refined until it carries the curvature of the most heavily loaded frames (see
    `Equilibrium.resolved`) or a finer one moves their tips by less than 1e-11 L; measured tables of k(s), which are not
    smooth, stop at the finest of `_FINEST` halvings, where the tip is good to about 1e-8 L.

    Raises:
        MechanicsError: k(s) is not positive somewhere.
    """
    if resolution is None:
        resolution = _resolve(beam, loads, search)
    return follow(pose(beam, loads, resolution), search=search)


def _resolve(beam: Rod, loads: Loads, search: Search) -> Resolution:
    """The coarsest resolution that is fine enough for the few frames that bend the beam most."""
    resolution, tip = Resolution(), None
    coarse = pose(beam, loads, resolution)
    size = np.max(np.linalg.norm(coarse.dead_force, axis=-1), axis=1) * beam.length
    size += np.max(np.abs(coarse.moment), axis=1) + np.sum(np.abs(coarse.follower), axis=(1, 2)) * beam.length
    hardest = loads.spread(loads.size).take(np.sort(np.argsort(size)[-_PROBES:]))
    for _ in range(_FINEST):
        result = follow(pose(beam, hardest, resolution), search=search)
        there = result.xy(np.array([1.0]))
        if np.all(result.resolved) or (tip is not None and np.max(np.abs(there - tip)) < 1e-11 * beam.length):
            break
        resolution, tip = resolution.finer(), there
    return resolution


def follow(problem: Problem, *, search: Search = Search()) -> Equilibrium:
    """Equilibria of a batch by load continuation from rest."""
    size = problem.size
    rest = np.broadcast_to(problem.q0, (size, problem.to_nodes.shape[-1])).copy()
    state = _State(q=rest, factor=np.zeros(size), step=np.ones(size), buckled_at=np.full(size, np.nan))
    open_frames = np.arange(size)
    for _ in range(search.most):
        if open_frames.size == 0:
            break
        _advance(problem, state, open_frames, search)
        unfinished = (state.factor[open_frames] < 1.0) & (state.step[open_frames] >= search.shortest)
        open_frames = open_frames[unfinished]
    return Equilibrium(
        problem=problem,
        q=state.q,
        converged=state.factor >= 1.0,
        stable=is_stable(problem, state.q) & (state.factor >= 1.0),
        load_factor=state.factor,
        buckled_at=state.buckled_at,
        iterations=state.iterations,
    )


def refine(problem: Problem, start: Array, *, search: Search = Search()) -> Equilibrium:
    """Equilibria near known shapes `start` (T, Q): Newton alone, and `follow` for the frames where it goes astray."""
    tolerance = np.full(problem.size, search.tolerance)
    trust = np.full(problem.size, search.stride)
    q, near = _correct(problem, start, np.ones(problem.size), trust, tolerance, search.corrections)
    near &= is_stable(problem, q)  # an unstable neighbour may belong to another branch: follow from rest instead
    lost = np.flatnonzero(~near)
    buckled_at = np.full(problem.size, np.nan)
    iterations = search.corrections
    if lost.size:
        again = follow(problem.take(lost), search=search)
        q[lost] = again.q
        near[lost] = again.converged
        iterations += again.iterations
        buckled_at[lost] = again.buckled_at
    factor = np.where(near, 1.0, np.nan)
    return Equilibrium(problem, q, near, is_stable(problem, q) & near, factor, buckled_at, iterations)


def _advance(problem: Problem, state: _State, frames: IntArray, search: Search) -> None:
    """One load step of the frames that are under way: accepted frames move on, the others shorten their step."""
    part = problem if frames.size == problem.size else problem.take(frames)
    q, factor = state.q[frames], state.factor[frames]
    slope = solve_batch(tangent(part, q, factor), -_load_gradient(part, q))
    turn = np.max(np.abs(node_angles(part, slope) - part.alpha0), axis=-1)
    step = np.minimum(state.step[frames], search.stride / np.maximum(turn, 1e-300))
    step = np.minimum(step, 1.0 - factor)
    last = factor + step >= 1.0 - 1e-12
    target = np.where(last, 1.0, factor + step)
    tolerance = np.where(last, search.tolerance, search.on_the_way)
    trust = np.minimum(search.trust, search.least_surprise + search.surprise * step * turn)
    found, near = _correct(part, q + step[:, None] * slope, target, trust, tolerance, search.corrections)
    unbuckled = np.isnan(state.buckled_at[frames])
    buckles = near & unbuckled
    buckles[buckles] = ~is_stable(part.take(buckles), found[buckles], target[buckles])
    at_last = buckles & (step < 4.0 * search.shortest)  # stability is lost however short the step
    state.buckled_at[frames[at_last]] = target[at_last]
    near &= ~buckles | at_last
    state.iterations += search.corrections
    state.q[frames[near]] = found[near]
    state.factor[frames[near]] = target[near]
    state.step[frames] = np.where(near, 2.0 * step, 0.25 * step)


def _correct(
    problem: Problem, start: Array, factor: Array, trust: Array, tolerance: Array, most: int
) -> tuple[Array, BoolArray]:
    """Newton from `start` at fixed load; True where it settled without turning by more than `trust` on the way."""
    q = start.copy()
    settled = np.zeros(problem.size, dtype=bool)
    strayed = np.zeros(problem.size, dtype=bool)
    moved = np.zeros_like(q)
    for _ in range(most):
        todo = np.flatnonzero(~(settled | strayed))
        if todo.size == 0:
            break
        part = problem if todo.size == problem.size else problem.take(todo)
        update = solve_batch(tangent(part, q[todo], factor[todo]), -gradient(part, q[todo], factor[todo]))
        q[todo] += update
        turn = node_angles(part, update) - part.alpha0
        moved[todo] += turn
        settled[todo] = np.max(np.abs(turn), axis=-1) < tolerance[todo]
        strayed[todo] = ~(np.max(np.abs(moved[todo]), axis=-1) < trust[todo])
    return q, settled & ~strayed


def _load_gradient(problem: Problem, q: Array) -> Array:
    """(T, Q) derivative of the gradient with respect to the load factor."""
    return gradient(problem, q, 1.0) - gradient(problem, q, 0.0)


def solve_batch(matrices: Array, right: Array) -> Array:
    """Batched solve; frames whose tangent is singular come back as NaN, and are then seen as strayed."""
    try:
        return np.asarray(np.linalg.solve(matrices, right[..., None])[..., 0])
    except np.linalg.LinAlgError:
        out = np.full_like(right, np.nan)
        for i, (matrix, r) in enumerate(zip(matrices, right, strict=True)):
            try:
                out[i] = np.linalg.solve(matrix, r)
            except np.linalg.LinAlgError:
                continue
        return out
