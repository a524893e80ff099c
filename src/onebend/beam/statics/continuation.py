"""Following the equilibrium that grows from the rest shape while all loads grow together from nothing.

Each step of the load is predicted from the branch so far and corrected by Newton's method. A step counts only if
the corrector moved the shape by a small angle and the new shape is stable: then it cannot have landed on another
branch. Otherwise it is shortened. Where no step however short keeps stability, the branch has passed a bifurcation
(a perfectly straight beam under a perfectly axial load) and is followed on, marked unstable. Where no step succeeds at
all, the branch itself turns back (a limit point): a real beam would snap through. On request the beam falls from such
a place to a stable equilibrium (`snap_through.py`) and is followed on from there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.loads import Loads
from onebend.beam.statics.by_load import by_load, terms_at_rest
from onebend.beam.statics.equilibrium import Equilibrium, is_stable, tangent
from onebend.beam.statics.moment_basis import in_basis, on_grid, settle
from onebend.beam.statics.newton import correct, solve_batch
from onebend.beam.statics.nodal_beam import AS_ROUGH, NARROW, RESOLVED, MomentBasis, missed_by_angles
from onebend.beam.statics.one_sided import at_once
from onebend.beam.statics.problem import Problem, Resolution, first_resolution, make_problem, remembered
from onebend.beam.statics.rod import Rod
from onebend.beam.statics.snap_through import Side, let_fall
from onebend.blas import one_blas_thread
from onebend.records import Array, IntArray


@dataclass(frozen=True)
class ContinuationSettings:
    """How the branch is followed. Angles in radians."""

    max_turn: float = 0.7  # the largest predicted turn of a step
    trust: float = 0.25  # the largest turn that the corrector may add to the prediction,
    correction_share: float = 0.5  # and as a share of the predicted turn: next to a bifurcation two branches are close
    least_correction: float = 1e-3  # which is allowed however small the prediction
    corrections: int = 8  # Newton iterations a step
    tolerance: float = 1e-13  # what Newton's method may leave of the way to equilibrium at the full load,
    tolerance_on_the_way: float = 1e-9  # and before: next to a bifurcation the side is decided by tiny turns
    min_step: float = 1e-9  # share of the load: a step below this has met the end of the branch
    max_steps: int = 400  # steps
    at_once: bool = True  # frames whose loads all push to one side (`one_sided.py`) without steps


_PROBE_FRAMES = 4  # frames that decide the resolution of a batch
_TIP = np.array([1.0])
_ROUGHLY = 1e-6  # rad, of shapes from which `settle` goes on

_HIGHER_ORDER_SHARE = 0.7  # share of the predicted turn that the terms beyond the slope may change
_LOAD_OVERSHOOT = 1e-3  # share of the load by which it grows past the end of a branch while the beam falls


class _State:
    """Where each frame of a batch stands on its branch. Lives only inside `follow`."""

    def __init__(self, rest: Array, size: int) -> None:
        self.q = rest
        self.factor, self.step = np.zeros(size), np.ones(size)
        self.buckled_at = np.full(size, np.nan)
        self.lost = np.zeros(size, dtype=bool)  # the branch has no stable continuation here
        self.fell = np.zeros(size, dtype=bool)
        self.slope, self.turn = np.zeros_like(rest), np.zeros(size)
        self.curl = np.zeros(size)
        self.second, self.third = np.zeros_like(rest), np.zeros_like(rest)
        self.fresh = np.zeros(size, dtype=bool)  # whether slope, turn, second and third belong to `q`
        self.q_before, self.factor_before = np.zeros_like(rest), np.full(size, np.nan)  # of the last step
        self.iterations = 0


@one_blas_thread
def equilibrium(
    beam: Rod,
    loads: Loads,
    *,
    resolution: Resolution | None = None,
    settings: ContinuationSettings = ContinuationSettings(),
    fall: Side | None = None,
) -> Equilibrium:
    """Shapes of the beam under dead loads, on the branch that grows from its rest shape (8).

    Without a `resolution` the grid is refined until it carries the curvature of the most heavily loaded frames (their
    angles then are good to 1e-9 rad) as it carries the beam's own, or a finer one moves their tips by less than
    1e-11 L; measured tables of k(s), which are not smooth, stop at panels of 1/32, where the tip is good
    to about 1e-8 L. The grid depends on the beam and these loads alone, not on what was solved before.

    With `fall`, a beam that loses its branch falls to where it stands; see `follow`.

    Raises:
        MechanicsError: k(s) is not positive somewhere.
    """
    if resolution is not None:
        return follow(make_problem(beam, loads, resolution), settings=settings, fall=fall)
    return _on_fine_enough_grid(beam, loads, settings, fall)


def _on_fine_enough_grid(beam: Rod, loads: Loads, settings: ContinuationSettings, fall: Side | None) -> Equilibrium:
    """On the coarsest grid that is fine enough for the few frames that bend the beam most."""
    first, own = first_resolution(beam, loads)
    resolution, problem = first, make_problem(beam, loads, first)
    on_first, chosen, before = problem, _hardest(problem), None
    while True:
        part = problem if chosen is None else problem.take(chosen)
        result = _solved(part, _basis(beam, loads, resolution), settings, fall, before)
        missed = missed_by_angles(part.grid, result.q)
        if resolution.widest <= NARROW or np.all(missed < max(RESOLVED, AS_ROUGH * own)):
            break
        if before is not None and np.max(np.abs(result.xy(_TIP) - before.xy(_TIP))) < 1e-11 * beam.length:
            break
        resolution, before = replace(resolution, widest=0.5 * float(np.max(np.diff(part.grid.edges)))), result
        problem = make_problem(beam, loads, resolution)
    if chosen is None:
        return result
    rough, basis, nodal = None, _basis(beam, loads, resolution), remembered(beam, loads, first)
    if resolution != first and basis is not None and nodal is not None and fall is None:
        rough = follow(in_basis(on_first, nodal.rough), settings=replace(settings, tolerance=_ROUGHLY))
    return _solved(problem, basis, settings, fall, rough)


def _basis(beam: Rod, loads: Loads, resolution: Resolution) -> MomentBasis | None:
    nodal = remembered(beam, loads, resolution)
    return None if nodal is None else nodal.basis


def _solved(
    problem: Problem,
    basis: MomentBasis | None,
    settings: ContinuationSettings,
    fall: Side | None,
    before: Equilibrium | None = None,
) -> Equilibrium:
    """As `follow`; on many nodes in few unknowns, or from the same on a coarser grid, where that leads to a stable
    equilibrium."""
    if basis is None or fall is not None:
        return follow(problem, settings=settings, fall=fall)
    if before is None:
        found = follow(in_basis(problem, basis), settings=replace(settings, tolerance=_ROUGHLY))
        begin = found.q
    else:
        found, begin = before, on_grid(before, problem, basis)
    q, near = settle(problem, basis, begin)
    near &= found.stable & np.isnan(found.buckled_at)
    if problem.follower.shape[1] == 0:
        near &= is_stable(problem, q)
    lost = np.flatnonzero(~near)
    if lost.size == 0:
        return replace(found, problem=problem, q=q)
    if lost.size == len(q):
        return follow(problem, settings=settings)
    rest = follow(problem.take(lost), settings=settings)
    q[lost] = rest.q
    out = replace(found, problem=problem, q=q, iterations=max(found.iterations, rest.iterations))
    for name in ("converged", "stable", "load_factor", "buckled_at"):
        getattr(out, name)[lost] = getattr(rest, name)
    return out


def _hardest(problem: Problem) -> IntArray | None:
    """The few frames with the largest loads; None for all of them."""
    if problem.size <= _PROBE_FRAMES:
        return None
    size = np.sqrt(np.max(np.sum(problem.dead_force**2, axis=-1), axis=1)) * float(problem.length)
    size += np.max(np.abs(problem.moment), axis=1) + np.sum(np.abs(problem.follower), axis=(1, 2)) * problem.length
    return np.sort(np.argsort(size)[-_PROBE_FRAMES:])


def follow(
    problem: Problem, *, settings: ContinuationSettings = ContinuationSettings(), fall: Side | None = None
) -> Equilibrium:
    """Equilibria of a batch by load continuation from rest.

    With `fall`, a frame whose branch loses stability or ends falls there to a stable equilibrium
    (`snap_through.let_fall`; `fall` gives the side where the loads leave it open) and is followed on from there.
    """
    size = problem.size
    rest = np.broadcast_to(problem.q0, (size, problem.to_nodes.shape[-1])).copy()
    state = _State(rest, size)
    open_frames = np.arange(size)
    if settings.at_once:
        _look_ahead(problem, state, open_frames)
        far = np.flatnonzero(_stride(state, open_frames, settings) < 1.0)
        part = problem if far.size == size else problem.take(far)
        reached, q, state.iterations = at_once(part, settings.tolerance, settings.corrections)
        state.q[far[reached]], state.factor[far[reached]] = q, 1.0
        open_frames = np.flatnonzero(state.factor < 1.0)
    for _ in range(settings.max_steps):
        if open_frames.size == 0:
            break
        _advance(problem, state, open_frames, settings)
        if fall is not None:
            _fall(problem, state, open_frames[state.lost[open_frames]], fall)
        open_frames = open_frames[(state.factor[open_frames] < 1.0) & (state.step[open_frames] >= settings.min_step)]
    converged = state.factor >= 1.0
    stable = converged & ~state.lost
    doubtful = np.flatnonzero(converged & state.lost)
    if doubtful.size:
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


def refine(problem: Problem, start: Array, *, settings: ContinuationSettings = ContinuationSettings()) -> Equilibrium:
    """Equilibria near known shapes `start` (T, Q): Newton alone, and `follow` for the frames where it goes astray."""
    full, size = np.ones(problem.size), problem.size
    q, near, iterations = correct(
        problem,
        start,
        full,
        trust=settings.max_turn * full,
        remaining=settings.tolerance * full,
        max_iterations=settings.corrections,
    )
    near &= is_stable(problem, q)  # an unstable neighbour may belong to another branch: follow from rest instead
    stable, buckled_at = near.copy(), np.full(size, np.nan)
    lost = np.flatnonzero(~near)
    if lost.size:
        again = follow(problem.take(lost), settings=settings)
        q[lost], near[lost], stable[lost], buckled_at[lost] = again.q, again.converged, again.stable, again.buckled_at
        iterations += again.iterations
    factor = np.where(near, 1.0, np.nan)
    return Equilibrium(problem, q, near, stable, factor, buckled_at, np.zeros(size, dtype=bool), iterations)


def _advance(problem: Problem, state: _State, frames: IntArray, settings: ContinuationSettings) -> None:
    """One load step of the frames that are under way: accepted frames move on, the others shorten their step."""
    part = problem if frames.size == problem.size else problem.take(frames)
    q, factor = state.q[frames], state.factor[frames]
    _look_ahead(part, state, frames)
    turn, step = state.turn[frames], _stride(state, frames, settings)
    last = factor + step >= 1.0 - 1e-12
    target = np.where(last, 1.0, factor + step)
    remaining = np.where(last, settings.tolerance, settings.tolerance_on_the_way)
    trust = np.minimum(settings.trust, settings.least_correction + settings.correction_share * step * turn)
    begin = _predicted(part, state, frames, step)
    corrected, near, count = correct(
        part, begin, target, trust=trust, remaining=remaining, max_iterations=settings.corrections
    )
    state.iterations += count
    guarded = near & ~state.lost[frames]
    loses_stability = np.zeros_like(near)
    if np.all(guarded):
        loses_stability = ~is_stable(part, corrected, target)
    elif np.any(guarded):
        loses_stability[guarded] = ~is_stable(part.take(guarded), corrected[guarded], target[guarded])
    at_last = loses_stability & (step < 4.0 * settings.min_step)  # stability is lost however short the step
    first = at_last & np.isnan(state.buckled_at[frames])
    state.buckled_at[frames[first]] = target[first]
    state.lost[frames[at_last]] = True
    near &= ~loses_stability | at_last
    moved = frames[near]
    state.q_before[moved], state.factor_before[moved] = q[near], factor[near]
    state.q[moved], state.factor[moved], state.fresh[moved] = corrected[near], target[near], False
    state.step[frames] = np.where(near, 2.0 * step, 0.25 * step)
    ended = ~near & (state.step[frames] < settings.min_step)
    state.lost[frames[ended]] = True


def _stride(state: _State, frames: IntArray, settings: ContinuationSettings) -> Array:
    """(n,) share of the load by which the frames go on: as far as the branch can be told ahead."""
    turn, curl = state.turn[frames], np.maximum(state.curl[frames], 1e-300)
    step = np.minimum(state.step[frames], settings.max_turn / np.maximum(turn, 1e-300))
    step = np.minimum(step, np.maximum(_HIGHER_ORDER_SHARE * turn, settings.least_correction) / curl)
    return np.minimum(step, 1.0 - state.factor[frames])


def _look_ahead(problem: Problem, state: _State, frames: IntArray) -> None:
    """Slope of the branch with the load, and its next two terms, where a frame has moved since they were known."""
    stale = np.flatnonzero(~state.fresh[frames])
    if stale.size == 0:
        return
    chosen = frames[stale]
    part = problem if stale.size == frames.size else problem.take(stale)
    q, factor = state.q[chosen], state.factor[chosen]
    right = by_load(part, q, factor)
    if np.all(factor == 0.0):  # then the tangent is diagonal
        slope = right / part.stiff
        second, third = terms_at_rest(part, q, slope)
    else:
        slope = solve_batch(tangent(part, q, factor), right)
        second, third = _terms_behind(state, chosen, slope)
    state.slope[chosen], state.second[chosen], state.third[chosen] = slope, second, third
    state.turn[chosen] = np.max(np.abs(apply(part.to_nodes, slope)), axis=-1)
    state.curl[chosen] = np.max(np.abs(apply(part.to_nodes, second)), axis=-1)
    state.fresh[chosen] = True


def _terms_behind(state: _State, frames: IntArray, slope: Array) -> tuple[Array, Array]:
    """The same of the cubic through the last two places on the branch and the slopes there; 0 where there is one."""
    h = (state.factor[frames] - state.factor_before[frames])[:, None]
    with np.errstate(invalid="ignore"):
        mean, before = (state.q[frames] - state.q_before[frames]) / h, state.slope[frames]
        second, third = (2.0 * slope + before - 3.0 * mean) / h, (slope + before - 2.0 * mean) / h**2
    return np.where(np.isnan(h), 0.0, second), np.where(np.isnan(h), 0.0, third)


def _predicted(problem: Problem, state: _State, frames: IntArray, step: Array) -> Array:
    """(T, Q) where the branch is a step ahead: along its slope, bent as it was so far if that changes little."""
    t = step[:, None]
    with np.errstate(invalid="ignore", over="ignore"):  # after a very short step the cubic is none: NaN is not little
        bent = t**2 * (state.second[frames] + t * state.third[frames])
    turn = np.max(np.abs(apply(problem.to_nodes, bent)), axis=-1)
    little = turn < _HIGHER_ORDER_SHARE * step * state.turn[frames]
    return state.q[frames] + t * state.slope[frames] + np.where(little[:, None], bent, 0.0)


def _fall(problem: Problem, state: _State, frames: IntArray, side: Side) -> None:
    """Frames that have lost their branch fall, the load a little beyond, to another; or end where they are."""
    if frames.size == 0:
        return
    beyond = np.minimum(1.0, (1.0 + _LOAD_OVERSHOOT) * state.factor[frames])
    q, landed = let_fall(problem.take(frames).loaded(beyond), state.q[frames], side)
    down = frames[landed]
    state.q[down], state.factor[down], state.step[down] = q[landed], beyond[landed], _LOAD_OVERSHOOT
    state.fell[down], state.lost[down], state.fresh[down] = True, False, False
    state.factor_before[down] = np.nan
    state.step[frames[~landed]] = 0.0
