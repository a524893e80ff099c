"""Following the equilibrium that grows from the rest shape while all loads grow together from nothing.

Each step of the load is predicted along the branch's tangent and corrected by Newton's method. A step counts only if
the corrector moved the shape by a small angle and the new shape is stable: then it cannot have landed on another
branch. Otherwise it is shortened. Where no step however short keeps stability, the branch has passed a bifurcation
(a perfectly straight beam under a perfectly axial load) and is followed on, marked unstable. Where no step succeeds at
all, the branch itself turns back (a limit point): a real beam would snap through. On request the beam falls from such
a place to a stable equilibrium (`falling.py`) and is followed on from there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.falling import Side, let_fall
from onebend.beam.grid import apply
from onebend.beam.loads import Loads
from onebend.beam.newton import correct, solve_batch
from onebend.beam.problem import Problem, Resolution, Rod, pose
from onebend.beam.statics import Equilibrium, gradient, is_stable, tangent
from onebend.records import Array, IntArray


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


_BEYOND = 1e-3  # share of the load by which it grows past the end of a branch while the beam falls


class _State:
    """Where each frame of a batch stands on its branch. Lives only inside `follow`."""

    def __init__(self, rest: Array, size: int) -> None:
        self.q = rest
        self.factor, self.step = np.zeros(size), np.ones(size)
        self.buckled_at = np.full(size, np.nan)
        self.lost = np.zeros(size, dtype=bool)  # the branch has no stable continuation here
        self.fell = np.zeros(size, dtype=bool)
        self.slope, self.turn = np.zeros_like(rest), np.zeros(size)
        self.fresh = np.zeros(size, dtype=bool)  # whether `slope` and `turn` belong to `q`
        self.iterations = 0


def equilibrium(
    beam: Rod,
    loads: Loads,
    *,
    resolution: Resolution | None = None,
    search: Search = Search(),
    fall: Side | None = None,
) -> Equilibrium:
    """Shapes of the beam under dead loads, on the branch that grows from its rest shape (8).

    Without a `resolution` the grid is refined until it carries the curvature of the most heavily loaded frames (see
    `Equilibrium.resolved`) or a finer one moves their tips by less than 1e-11 L; measured tables of k(s), which are not
    smooth, stop at the finest of `_FINEST` halvings, where the tip is good to about 1e-8 L.

    With `fall`, a beam that loses its branch falls to where it stands; see `follow`.

    Raises:
        MechanicsError: k(s) is not positive somewhere.
    """
    if resolution is None:
        resolution = _resolve(beam, loads, search, fall)
    return follow(pose(beam, loads, resolution), search=search, fall=fall)


def _resolve(beam: Rod, loads: Loads, search: Search, fall: Side | None) -> Resolution:
    """The coarsest resolution that is fine enough for the few frames that bend the beam most."""
    resolution, tip = Resolution(), None
    coarse = pose(beam, loads, resolution)
    size = np.max(np.linalg.norm(coarse.dead_force, axis=-1), axis=1) * beam.length
    size += np.max(np.abs(coarse.moment), axis=1) + np.sum(np.abs(coarse.follower), axis=(1, 2)) * beam.length
    hardest = loads.spread(loads.size).take(np.sort(np.argsort(size)[-_PROBES:]))
    for _ in range(_FINEST):
        result = follow(pose(beam, hardest, resolution), search=search, fall=fall)
        there = result.xy(np.array([1.0]))
        if np.all(result.resolved) or (tip is not None and np.max(np.abs(there - tip)) < 1e-11 * beam.length):
            break
        resolution, tip = resolution.finer(), there
    return resolution


def follow(problem: Problem, *, search: Search = Search(), fall: Side | None = None) -> Equilibrium:
    """Equilibria of a batch by load continuation from rest.

    With `fall`, a frame whose branch loses stability or ends falls there to a stable equilibrium (`falling.let_fall`;
    `fall` says to which side where that is undecided), and is followed on from there.
    """
    size = problem.size
    rest = np.broadcast_to(problem.q0, (size, problem.to_nodes.shape[-1])).copy()
    state = _State(rest, size)
    open_frames = np.arange(size)
    for _ in range(search.most):
        if open_frames.size == 0:
            break
        _advance(problem, state, open_frames, search)
        if fall is not None:
            _fall(problem, state, open_frames[state.lost[open_frames]], fall)
        open_frames = open_frames[(state.factor[open_frames] < 1.0) & (state.step[open_frames] >= search.shortest)]
    converged = state.factor >= 1.0
    stable = converged & ~state.lost
    doubtful = np.flatnonzero(converged & state.lost)
    stable[doubtful] = is_stable(problem.take(doubtful), state.q[doubtful])
    return Equilibrium(
        problem=problem,
        q=state.q,
        converged=converged,
        stable=stable,
        load_factor=state.factor,
        buckled_at=state.buckled_at,
        fell=state.fell,
        iterations=state.iterations,
    )


def refine(problem: Problem, start: Array, *, search: Search = Search()) -> Equilibrium:
    """Equilibria near known shapes `start` (T, Q): Newton alone, and `follow` for the frames where it goes astray."""
    full, size = np.ones(problem.size), problem.size
    q, near, iterations = correct(
        problem, start, full, search.stride * full, search.tolerance * full, search.corrections
    )
    near &= is_stable(problem, q)  # an unstable neighbour may belong to another branch: follow from rest instead
    stable, buckled_at = near.copy(), np.full(size, np.nan)
    lost = np.flatnonzero(~near)
    if lost.size:
        again = follow(problem.take(lost), search=search)
        q[lost], near[lost], stable[lost], buckled_at[lost] = again.q, again.converged, again.stable, again.buckled_at
        iterations += again.iterations
    factor = np.where(near, 1.0, np.nan)
    return Equilibrium(problem, q, near, stable, factor, buckled_at, np.zeros(size, dtype=bool), iterations)


def _advance(problem: Problem, state: _State, frames: IntArray, search: Search) -> None:
    """One load step of the frames that are under way: accepted frames move on, the others shorten their step."""
    part = problem if frames.size == problem.size else problem.take(frames)
    q, factor = state.q[frames], state.factor[frames]
    slope, turn = _slope(part, state, frames)
    step = np.minimum(state.step[frames], search.stride / np.maximum(turn, 1e-300))
    step = np.minimum(step, 1.0 - factor)
    last = factor + step >= 1.0 - 1e-12
    target = np.where(last, 1.0, factor + step)
    tolerance = np.where(last, search.tolerance, search.on_the_way)
    trust = np.minimum(search.trust, search.least_surprise + search.surprise * step * turn)
    found, near, count = correct(part, q + step[:, None] * slope, target, trust, tolerance, search.corrections)
    state.iterations += count
    guarded = near & ~state.lost[frames]
    buckles = np.zeros_like(near)
    buckles[guarded] = ~is_stable(part.take(guarded), found[guarded], target[guarded])
    at_last = buckles & (step < 4.0 * search.shortest)  # stability is lost however short the step
    first = at_last & np.isnan(state.buckled_at[frames])
    state.buckled_at[frames[first]] = target[first]
    state.lost[frames[at_last]] = True
    near &= ~buckles | at_last
    moved = frames[near]
    state.q[moved], state.factor[moved], state.fresh[moved] = found[near], target[near], False
    state.step[frames] = np.where(near, 2.0 * step, 0.25 * step)
    ended = ~near & (state.step[frames] < search.shortest)
    state.lost[frames[ended]] = True


def _slope(problem: Problem, state: _State, frames: IntArray) -> tuple[Array, Array]:
    """(T, Q) how the shapes go with the load, and (T,) the largest turn of that; kept while a frame does not move."""
    stale = np.flatnonzero(~state.fresh[frames])
    if stale.size:
        chosen = frames[stale]
        part = problem if stale.size == frames.size else problem.take(stale)
        q, factor = state.q[chosen], state.factor[chosen]
        right = gradient(part, q, 0.0) - gradient(part, q, 1.0)
        at_rest = np.all(factor == 0.0)  # then the tangent is diagonal
        slope = right / (part.weights * part.k) if at_rest else solve_batch(tangent(part, q, factor), right)
        state.slope[chosen], state.fresh[chosen] = slope, True
        state.turn[chosen] = np.max(np.abs(apply(part.to_nodes, slope)), axis=-1)
    return state.slope[frames], state.turn[frames]


def _fall(problem: Problem, state: _State, frames: IntArray, side: Side) -> None:
    """Frames that have lost their branch fall, the load a little beyond, to another; or end where they are."""
    if frames.size == 0:
        return
    beyond = np.minimum(1.0, (1.0 + _BEYOND) * state.factor[frames])
    q, landed = let_fall(problem.take(frames).loaded(beyond), state.q[frames], side)
    down = frames[landed]
    state.q[down], state.factor[down], state.step[down] = q[landed], beyond[landed], _BEYOND
    state.fell[down], state.lost[down], state.fresh[down] = True, False, False
    state.step[frames[~landed]] = 0.0
