"""Equilibrium by continuation in the load, directly where all loads push to one side; falls; all stable equilibria.

With `gamma = alpha - alpha_rest`, N the force beyond s, phi in (0, pi) its angle with the rest tangent, counted to the
side to which it pushes, and eps = (1/EA - 1/kGA) N, the balance of the forces is

    -(k gamma')' = f(s, gamma) = L N sin(phi - gamma) (1 + eps cos(phi - gamma)),   gamma(0) = gamma'(1) = 0.

If phi is in (0, pi) everywhere, `0 < gamma <= max phi` on the branch from rest (maximum principle). If f / gamma also
falls with gamma in this range, it contains one solution, which is stable (Brezis and Oswald 1986) and on that branch. f
/ gamma falls for gamma up to phi if |eps| < 1/5, and beyond, up to max phi = phi + d, if
`(phi + d) (cos d - |eps|) > sin d (1 + |eps|)`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from onebend.beam import problem as problems, statics
from onebend.beam.grid import apply, transposed
from onebend.beam.loads import Loads
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray, IntArray

_AXIAL = 1e-9  # share of a force across the beam, below which it is axial
_MOST_STRAIN = 0.2  # largest |eps|
_OUTSIDE = 1e-9  # rad, tolerance of the range
_FARTHEST_FROM_LINEAR = 1.0  # rad, largest turn from the start to the equilibrium


def on_one_side(problem: problems.Problem) -> tuple[IntArray, Array, Array]:
    """Frames (n,) whose loads all push to one side, phi (n, Q) rad with the sign of that side, L w N (n, Q) N m."""
    pull = np.zeros((0, problem.to_nodes.shape[-2]))
    if problem.size == 0:
        return np.zeros(0, dtype=np.int64), pull, pull
    rest, (x, y) = statics.node_angles(problem, problem.q0), problem.dead_pull
    cos, sin = np.cos(rest), np.sin(rest)
    along, across, pull = x * cos + y * sin, y * cos - x * sin, np.sqrt(x**2 + y**2)
    side = np.sign(np.sum(across, axis=-1, keepdims=True))
    acts = pull > 0.0
    chosen = np.all((side * across > _AXIAL * pull) | ~acts, axis=-1) & np.any(acts, axis=-1)
    chosen &= ~np.any(problem.moment, axis=-1)
    strain = np.zeros(1) if problem.strain_lever is None else np.abs(problem.strain_lever) * pull
    chosen &= np.all(strain <= _MOST_STRAIN, axis=-1)
    phi = np.arctan2(side * across, along)
    beyond = np.max(np.where(acts, phi, 0.0), axis=-1, keepdims=True) - phi
    falls = (phi + beyond) * (np.cos(beyond) - strain) > np.sin(beyond) * (1.0 + strain)
    chosen &= np.all((falls & (beyond < 0.5 * np.pi)) | ~acts, axis=-1)
    return np.flatnonzero(chosen), (side * phi)[chosen], pull[chosen]


def at_once(problem: problems.Problem, tolerance: float, corrections: int) -> tuple[IntArray, Array, int]:
    """Frames (n,) on one side that were solved, their equilibria (n, Q), and the number of iterations."""
    frames, phi, pull = on_one_side(problem)
    if frames.size == 0:
        return frames, np.zeros((0, problem.to_nodes.shape[-1])), 0
    part = problem if frames.size == problem.size else problem.take(frames)
    secant, full = pull * np.sinc(phi / (2.0 * np.pi)), np.ones(frames.size)
    lever = apply(transposed(part.to_nodes), secant * phi)
    start = part.q0 + statics.solve_batch(statics.second_variation(part, secant, part.stiff), lever)
    q, near, count = statics.correct(
        part, start, full, trust=_FARTHEST_FROM_LINEAR * full, remaining=tolerance * full, max_iterations=corrections
    )
    near &= _within(part, q, phi, pull) & statics.is_stable(part, q)
    return frames[near], q[near], count + 1


def _within(problem: problems.Problem, q: Array, phi: Array, pull: Array) -> BoolArray:
    """(n,) whether gamma is in its range."""
    turned = np.sign(np.sum(phi * pull, axis=-1, keepdims=True)) * apply(problem.to_nodes, q - problem.q0)
    farthest = np.max(np.abs(phi) * (pull > 0.0), axis=-1)
    return np.asarray((np.min(turned, axis=-1) > -_OUTSIDE) & (np.max(turned, axis=-1) < farthest + _OUTSIDE))


# Derivatives of the equilibrium by the load factor.


def by_load(problem: problems.Problem, q: Array, factor: Array) -> Array:
    """(T, Q) minus the gradient's derivative by the load factor. The gradient is at most quadratic in it, so a
    difference over 1 is exact."""
    if problem.compliance is None:
        across = statics.nodal_forces(problem, q).across
        return problem.couple + apply(transposed(problem.to_nodes), across)
    return statics.gradient(problem, q, factor - 0.5) - statics.gradient(problem, q, factor + 0.5)


def terms_at_rest(problem: problems.Problem, q: Array, slope: Array) -> tuple[Array, Array]:
    """Terms of second and third order in the load at no load."""
    plain = problem if problem.compliance is None else replace(problem, section=None, stretch=None, shear=None)
    forces = statics.nodal_forces(plain, q)
    along, across, delta = forces.along, forces.across, problem.strain_lever
    back, stiff = transposed(problem.to_nodes), problem.stiff
    turn = apply(problem.to_nodes, slope)
    with np.errstate(over="ignore"):  # of a beam next to without stiffness: its shape is not found
        second = -2.0 * apply(back, along * turn) / stiff
    if delta is not None:
        second = second + 2.0 * apply(back, delta * along * across) / stiff
    third = -3.0 * apply(back, along * apply(problem.to_nodes, second) + across * turn**2) / stiff
    if delta is not None:
        third = third + 6.0 * apply(back, delta * (across**2 - along**2) * turn) / stiff
    return second / 2.0, third / 6.0


# Few unknowns (Ritz) for many nodes: a k(s) with many knots needs many nodes, its moment does not. First solve in the
# curvatures `q0 + M / k`, with M polynomial between loads. Then correct on all nodes by
#
#     dq = R T_n^-1 R^T g + (1 - R R^T S) S^-1 g,        S = diag(w k),
#
# R the basis, orthonormal in S, T_n = R^T T R its tangent. T - S is compact and acts only on smooth parts of g.

_REMAINING = 1e-12  # rad, tolerance
_NEARBY = 1e-2  # rad, largest turn from the start
_MOST = 12  # iterations


def in_basis(problem: problems.Problem, basis: problems.MomentBasis) -> problems.Problem:
    """The problem in coefficients of the basis."""
    return replace(problem, to_nodes=basis.turned, q0=basis.rest, modes=basis.modes)


def on_grid(solved: statics.Equilibrium, problem: problems.Problem, basis: problems.MomentBasis) -> Array:
    """(T, n) coefficients of shapes of the same beam on another grid."""
    q = solved.q if solved.problem.modes is None else solved.q @ solved.problem.modes.T
    rows = transposed(solved.problem.grid.value_at(problem.grid.nodes))
    return np.asarray(q @ (rows @ (problem.stiff[:, None] * basis.modes)))


def settle(problem: problems.Problem, basis: problems.MomentBasis, coefficients: Array) -> tuple[Array, BoolArray]:
    """(T, Q) equilibria near coefficients (T, n), and (T,) whether one was reached nearby."""
    begin = coefficients @ basis.modes.T
    q = begin.copy()
    forces, before = statics.nodal_forces(problem, q), np.zeros(len(q))
    off, matrices = (
        statics.gradient(problem, q, 1.0, forces),
        statics.tangent(in_basis(problem, basis), coefficients, 1.0, forces),
    )
    near = np.zeros(len(q), dtype=bool)
    todo, part, here = np.arange(len(q)), problem, q
    for _ in range(_MOST):
        within = off @ basis.modes
        update = off / problem.stiff + (statics.solve_batch(matrices, within) - within) @ basis.modes.T
        here = here - update
        size = np.max(np.abs(apply(part.to_nodes, update)), axis=-1)
        share = np.divide(size, before, out=np.ones_like(size), where=before > 0.0)  # of the previous update
        done = size * np.minimum(share, 1.0) < _REMAINING
        q[todo], near[todo] = here, done
        going = np.flatnonzero(~done & ((before == 0.0) | (share < 0.5)))
        if going.size == 0:
            break
        before = size
        if going.size < todo.size:
            todo, part = todo[going], part.take(going)
            here, matrices, before = here[going], matrices[going], before[going]
        off = statics.gradient(part, here)
    return q, near & (np.max(np.abs(apply(problem.to_nodes, q - begin)), axis=-1) < _NEARBY)


# Fall from an unstable shape: `w k q' = -g(q)`, strongly damped. It descends the potential. Steps
# `(T + sigma w k) dq = -g` are implicit, with the smallest sigma that keeps the matrix positive, bounded in turn, and
# must do work. The work `-int g . dq` needs no potential, and is accurate where the potential changes by less than
# rounding.

Side = Literal["left", "right"]

_MAX_TURN = 0.3  # rad, largest turn of a step
_MIN_TURN = 1e-9  # rad, of a step without work: the frame fails
_NUDGE = 1e-4  # rad, perturbation of an exact equilibrium
_RESIDUAL_DECIDES = 1e-9  # share of the stiffness above which the residual decides the direction
_NEWTON_TURN = 1e-2  # rad, turn of a step below which Newton's method is tried
_MAX_STEPS = 400
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(4)


def let_fall(problem: problems.Problem, start: Array, side: Side = "left") -> tuple[Array, BoolArray]:
    """Stable equilibria (T, Q) below shapes `start` (T, Q), and (T,) whether one was reached.

    An unstable equilibrium is left along its least stable mode, to the beam's left or right as `side` says. Stable
    shapes stay.
    """
    q = _nudged(problem, start, side)
    landed, given_up = np.zeros(len(q), dtype=bool), np.zeros(len(q), dtype=bool)
    reach = np.full(len(q), _MAX_TURN)
    for _ in range(_MAX_STEPS):
        todo = np.flatnonzero(~(landed | given_up))
        if todo.size == 0:
            break
        part = problem.take(todo)
        step, convex = _downhill(part, q[todo])
        turn = np.max(np.abs(apply(part.to_nodes, step)), axis=-1)
        share = np.minimum(1.0, reach[todo] / np.maximum(turn, 1e-300))
        step, turn = share[:, None] * step, share * turn
        falls = _work(part, q[todo], step) > 0.0
        q[todo[falls]] += step[falls]
        reach[todo] = np.where(falls, np.minimum(2.0 * reach[todo], _MAX_TURN), 0.25 * turn)
        given_up[todo] = ~falls & ~(turn > _MIN_TURN)
        close = todo[(turn < _NEWTON_TURN) & convex]
        landed[close], q[close] = _land(problem.take(close), q[close])
    return q, landed


def to_the_left(problem: problems.Problem, q: Array, modes: Array) -> Array:
    """(T, P) 1 or -1: the sign with which curvatures (T, Q, P) move the beam to its left, on average."""
    alpha = statics.node_angles(problem, q)[..., None]
    turned = problem.to_nodes @ modes
    x, y = -problem.to_nodes @ (np.sin(alpha) * turned), problem.to_nodes @ (np.cos(alpha) * turned)
    moved = np.sum(problem.weights[..., None] * (np.cos(alpha) * y - np.sin(alpha) * x), axis=-2)
    undecided = np.abs(moved) < 1e-9 * np.max(np.abs(turned), axis=-2)
    instead = turned[:, -1] + turned[:, turned.shape[1] // 4]
    return np.where(np.where(undecided, instead, moved) < 0.0, -1.0, 1.0)


def _nudged(problem: problems.Problem, start: Array, side: Side) -> Array:
    """Perturbed along the least stable mode: in the direction of the residual, else to `side`."""
    slope, matrices = statics.balance(problem, start)
    scale = problem.unbend
    second = statics.scaled(problem, matrices)
    _, vectors = np.linalg.eigh(0.5 * (second + transposed(second)))
    mode = scale * vectors[..., 0]
    pull = -np.sum(slope * mode, axis=-1)  # along a mode of unit energy, root of N m
    stiffness = np.sqrt(np.sum(problem.weights * problem.k, axis=-1))
    asked = to_the_left(problem, start, mode[..., None])[:, 0] * (1.0 if side == "left" else -1.0)
    sign = np.where(np.abs(pull) > _RESIDUAL_DECIDES * stiffness, np.sign(pull), asked)
    turn = np.max(np.abs(apply(problem.to_nodes, mode)), axis=-1)
    amplitude = np.where(statics.is_stable(problem, start), 0.0, sign * _NUDGE / turn)
    return np.asarray(start + amplitude[:, None] * mode)


def _downhill(problem: problems.Problem, q: Array) -> tuple[Array, BoolArray]:
    """(T, Q) the implicit step, and whether it is Newton's."""
    slope, matrices = statics.balance(problem, q)
    second = statics.scaled(problem, matrices)
    lowest = np.linalg.eigvalsh(0.5 * (second + transposed(second)))[:, 0]
    scale = problem.unbend
    sigma = np.where(lowest > 0.0, 0.0, 1.2 * np.abs(lowest) + 1e-12)
    shifted = second + sigma[:, None, None] * np.eye(second.shape[-1])
    return -scale * statics.solve_batch(shifted, scale * slope), np.asarray(lowest > 0.0)


def _work(problem: problems.Problem, q: Array, step: Array) -> Array:
    """(T,) N m, of loads and bending from q to q + step."""
    out = np.zeros(len(q))
    for point, weight in zip(_POINTS, _WEIGHTS, strict=True):
        here = statics.gradient(problem, q + 0.5 * (point + 1.0) * step)
        out -= 0.5 * weight * np.sum(here * step, axis=-1)
    return out


def _land(problem: problems.Problem, q: Array) -> tuple[BoolArray, Array]:
    """Newton's method from nearby: (T,) whether a stable equilibrium was reached, and the shapes."""
    full = np.ones(len(q))
    corrected, near, _ = statics.correct(
        problem, q, full, trust=10.0 * _NEWTON_TURN * full, remaining=1e-13 * full, max_iterations=12
    )
    near[near] &= statics.is_stable(problem.take(near), corrected[near])
    return near, np.where(near[:, None], corrected, q)


# The equilibrium that grows from rest while all loads grow together. Each load step is predicted from the branch and
# corrected by Newton's method. It is accepted if the correction is small and the shape stable, else shortened. Where no
# step keeps stability, the branch passed a bifurcation and is followed as unstable. Where no step succeeds, it turns
# back (limit point). With `fall` the beam then falls to a stable equilibrium.


@dataclass(frozen=True)
class ContinuationSettings:
    """Angles in radians."""

    max_turn: float = 0.7  # largest predicted turn of a step
    trust: float = 0.25  # largest correction of the prediction
    correction_share: float = 0.5  # and as a share of the predicted turn: near a bifurcation two branches are close
    least_correction: float = 1e-3  # correction allowed in any case
    corrections: int = 8  # Newton iterations per step
    tolerance: float = 1e-13  # of Newton's method at the full load
    tolerance_on_the_way: float = 1e-9  # before it: near a bifurcation tiny turns decide the side
    min_step: float = 1e-9  # share of the load: a shorter step has met the end of the branch
    max_steps: int = 400
    last: float = (
        statics.TOLERANCE
    )  # of an update near a known shape: a smaller one is the last, and its square is left
    at_once: bool = True  # no steps for frames whose loads all push to one side
    grow: bool = True  # from rest, the frames that Newton's method loses near a known shape; False: they are not solved


_PROBE_FRAMES = 4  # frames that decide the resolution of a batch
_TIP = np.array([1.0])
_ROUGHLY = ContinuationSettings(tolerance=1e-6)  # for `settle`

_HIGHER_ORDER_SHARE = 0.7  # largest share of the predicted turn from higher-order terms
_LOAD_OVERSHOOT = 1e-3  # share of the load by which it passes the end of a branch before the beam falls


class _State:
    """State of each frame on its branch, inside `follow`."""

    def __init__(self, rest: Array, size: int) -> None:
        self.q = rest
        self.factor, self.step = np.zeros(size), np.ones(size)
        self.buckled_at = np.full(size, np.nan)
        self.lost = np.zeros(size, dtype=bool)  # no stable continuation
        self.fell = np.zeros(size, dtype=bool)
        self.slope, self.turn = np.zeros_like(rest), np.zeros(size)
        self.curl = np.zeros(size)
        self.second, self.third = np.zeros_like(rest), np.zeros_like(rest)
        self.fresh = np.zeros(size, dtype=bool)  # slope, turn, second and third belong to `q`
        self.q_before, self.factor_before = np.zeros_like(rest), np.full(size, np.nan)  # of the last step
        self.iterations = 0


@one_blas_thread
def equilibrium(
    beam: problems.Rod,
    loads: Loads,
    *,
    resolution: problems.Resolution | None = None,
    fall: Side | None = None,
) -> statics.Equilibrium:
    """Shapes under loads, on the branch that grows from rest (8).

    Without a `resolution` the grid is refined until it resolves the curvature of the most loaded frames (angles to 1e-9
    rad), or until refinement moves their tips by less than 1e-11 L. Tables of k(s), which are not smooth, stop at
    panels of 1/32 (tip to about 1e-8 L). The grid depends only on the beam and these loads. For `fall` see `follow`.

    Raises `MechanicsError`: k(s) is not positive.
    """
    if resolution is not None:
        return follow(problems.make_problem(beam, loads, resolution), fall=fall)
    return _on_fine_enough_grid(beam, loads, fall)


def _on_fine_enough_grid(beam: problems.Rod, loads: Loads, fall: Side | None) -> statics.Equilibrium:
    """Refines the grid for the few frames that bend most."""
    first, own = problems.first_resolution(beam, loads)
    resolution, problem = first, problems.make_problem(beam, loads, first)
    on_first, chosen, before = problem, _hardest(problem), None
    while True:
        part, nodal = problem if chosen is None else problem.take(chosen), problems.remembered(beam, loads, resolution)
        basis = None if nodal is None else nodal.basis
        result = _solved(part, basis, fall, before)
        missed = problems.missed_by_angles(part.grid, result.q)
        if resolution.widest <= problems.NARROW or np.all(missed < max(problems.RESOLVED, problems.AS_ROUGH * own)):
            break
        if before is not None and np.max(np.abs(result.xy(_TIP) - before.xy(_TIP))) < 1e-11 * beam.length:
            break
        resolution, before = replace(resolution, widest=0.5 * float(np.max(np.diff(part.grid.edges)))), result
        problem = problems.make_problem(beam, loads, resolution)
    if chosen is None:
        return result
    rough, coarse = None, problems.remembered(beam, loads, first)
    if resolution != first and basis is not None and coarse is not None and fall is None:
        rough = follow(in_basis(on_first, coarse.rough), settings=_ROUGHLY)
    return _solved(problem, basis, fall, rough)


def _solved(
    problem: problems.Problem,
    basis: problems.MomentBasis | None,
    fall: Side | None,
    before: statics.Equilibrium | None = None,
) -> statics.Equilibrium:
    """As `follow`; with few unknowns, or from a coarser grid, where that leads to a stable equilibrium."""
    if basis is None or fall is not None:
        return follow(problem, fall=fall)
    if before is None:
        found = follow(in_basis(problem, basis), settings=_ROUGHLY)
        begin = found.q
    else:
        found, begin = before, on_grid(before, problem, basis)
    q, near = settle(problem, basis, begin)
    near &= found.stable & np.isnan(found.buckled_at)
    near &= statics.is_stable(problem, q)
    lost = np.flatnonzero(~near)
    if lost.size == 0:
        return replace(found, problem=problem, q=q)
    if lost.size == len(q):
        return follow(problem)
    return replace(found, problem=problem, q=q).put(lost, follow(problem.take(lost)))


def _hardest(problem: problems.Problem) -> IntArray | None:
    """The few frames with the largest loads; None for all."""
    if problem.size <= _PROBE_FRAMES:
        return None
    size = np.sqrt(np.max(np.sum(problem.dead_force**2, axis=-1), axis=1)) * float(problem.length)
    size += np.max(np.abs(problem.moment), axis=1)
    return np.sort(np.argsort(size)[-_PROBE_FRAMES:])


def follow(
    problem: problems.Problem, *, settings: ContinuationSettings = ContinuationSettings(), fall: Side | None = None
) -> statics.Equilibrium:
    """Equilibria of a batch by load continuation from rest.

    With `fall`, a frame whose branch loses stability or ends falls to a stable equilibrium (`let_fall`) and is followed
    from there; `fall` gives the side where the loads do not decide it.
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
        stable[doubtful] = statics.is_stable(problem.take(doubtful), state.q[doubtful])
    return statics.Equilibrium(
        problem=problem,
        q=state.q,
        converged=converged,
        stable=stable,
        load_factor=state.factor,
        buckled_at=state.buckled_at,
        fell=state.fell,
        iterations=state.iterations,
    )


def refine(
    problem: problems.Problem, start: Array, *, settings: ContinuationSettings = ContinuationSettings()
) -> statics.Equilibrium:
    """Equilibria near known shapes `start` (T, Q) by Newton's method, else by `follow` (`grow`)."""
    full = np.ones(problem.size)
    trust, remaining = settings.max_turn * full, settings.tolerance * full
    q, near, iterations = statics.correct(problem, start, full, trust=trust, remaining=remaining, last=settings.last)
    found = statics.found_near(problem, q, near, iterations)
    stands = near & statics.is_stable(problem, q, forces=found.forces)  # an unstable one may belong to another branch
    if stands.all():
        return found
    found, lost = statics.found_near(problem, q, stands, iterations), np.flatnonzero(~stands)
    return found.put(lost, follow(problem.take(lost), settings=settings)) if settings.grow else found


def _advance(problem: problems.Problem, state: _State, frames: IntArray, settings: ContinuationSettings) -> None:
    """One load step: accepted frames advance, the others shorten their step."""
    part = problem if frames.size == problem.size else problem.take(frames)
    q, factor = state.q[frames], state.factor[frames]
    _look_ahead(part, state, frames)
    turn, step = state.turn[frames], _stride(state, frames, settings)
    last = factor + step >= 1.0 - 1e-12
    target = np.where(last, 1.0, factor + step)
    remaining = np.where(last, settings.tolerance, settings.tolerance_on_the_way)
    trust = np.minimum(settings.trust, settings.least_correction + settings.correction_share * step * turn)
    begin = _predicted(part, state, frames, step)
    corrected, near, count = statics.correct(
        part, begin, target, trust=trust, remaining=remaining, max_iterations=settings.corrections
    )
    state.iterations += count
    guarded = near & ~state.lost[frames]
    loses_stability = np.zeros_like(near)
    if np.all(guarded):
        loses_stability = ~statics.is_stable(part, corrected, target)
    elif np.any(guarded):
        loses_stability[guarded] = ~statics.is_stable(part.take(guarded), corrected[guarded], target[guarded])
    at_last = loses_stability & (step < 4.0 * settings.min_step)  # stability is lost at any step length
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
    """(n,) load steps over which the prediction is reliable."""
    turn, curl = state.turn[frames], np.maximum(state.curl[frames], 1e-300)
    step = np.minimum(state.step[frames], settings.max_turn / np.maximum(turn, 1e-300))
    step = np.minimum(step, np.maximum(_HIGHER_ORDER_SHARE * turn, settings.least_correction) / curl)
    return np.minimum(step, 1.0 - state.factor[frames])


def _look_ahead(problem: problems.Problem, state: _State, frames: IntArray) -> None:
    """Slope of the branch by the load, and its next two terms, for frames that moved."""
    stale = np.flatnonzero(~state.fresh[frames])
    if stale.size == 0:
        return
    chosen = frames[stale]
    part = problem if stale.size == frames.size else problem.take(stale)
    q, factor = state.q[chosen], state.factor[chosen]
    right = by_load(part, q, factor)
    if np.all(factor == 0.0):  # the tangent is diagonal
        slope = right / part.stiff
        second, third = terms_at_rest(part, q, slope)
    else:
        slope = statics.solve_batch(statics.tangent(part, q, factor), right)
        second, third = _terms_behind(state, chosen, slope)
    state.slope[chosen], state.second[chosen], state.third[chosen] = slope, second, third
    state.turn[chosen] = np.max(np.abs(apply(part.to_nodes, slope)), axis=-1)
    state.curl[chosen] = np.max(np.abs(apply(part.to_nodes, second)), axis=-1)
    state.fresh[chosen] = True


def _terms_behind(state: _State, frames: IntArray, slope: Array) -> tuple[Array, Array]:
    """The same two terms from the cubic through the last two points and slopes; 0 if there is one point."""
    h = (state.factor[frames] - state.factor_before[frames])[:, None]
    with np.errstate(invalid="ignore"):
        mean, before = (state.q[frames] - state.q_before[frames]) / h, state.slope[frames]
        second, third = (2.0 * slope + before - 3.0 * mean) / h, (slope + before - 2.0 * mean) / h**2
    return np.where(np.isnan(h), 0.0, second), np.where(np.isnan(h), 0.0, third)


def _predicted(problem: problems.Problem, state: _State, frames: IntArray, step: Array) -> Array:
    """(T, Q) prediction along the slope, with higher terms if they change little."""
    t = step[:, None]
    with np.errstate(invalid="ignore", over="ignore"):  # after a very short step the cubic is NaN
        bent = t**2 * (state.second[frames] + t * state.third[frames])
    turn = np.max(np.abs(apply(problem.to_nodes, bent)), axis=-1)
    little = turn < _HIGHER_ORDER_SHARE * step * state.turn[frames]
    return state.q[frames] + t * state.slope[frames] + np.where(little[:, None], bent, 0.0)


def _fall(problem: problems.Problem, state: _State, frames: IntArray, side: Side) -> None:
    """Frames off their branch fall under a slightly larger load, or end."""
    if frames.size == 0:
        return
    beyond = np.minimum(1.0, (1.0 + _LOAD_OVERSHOOT) * state.factor[frames])
    q, landed = let_fall(problem.take(frames).loaded(beyond), state.q[frames], side)
    down = frames[landed]
    state.q[down], state.factor[down], state.step[down] = q[landed], beyond[landed], _LOAD_OVERSHOOT
    state.fell[down], state.lost[down], state.fresh[down] = True, False, False
    state.factor_before[down] = np.nan
    state.step[frames[~landed]] = 0.0


# The stable equilibria of a beam with a free end under dead loads.
#
# A soft beam under a load has one or two of them as a rule: it may hang to the left or to the right. They are found by
# letting evenly bent shapes fall, to both sides and more than half around.

_STARTS = np.array([-6.0, -3.0, -1.0, 1.0, 3.0, 6.0])  # rad, turn of the free end of the shapes that fall
_SAME = 1e-6  # rad, distance below which equilibria are one


def stable_equilibria(problem: problems.Problem) -> tuple[Array, IntArray]:
    """Curvatures (E, Q) [rad] of the stable equilibria under dead loads, and their frames (E,), ordered by the angle of
    the free end."""
    every = np.repeat(np.arange(problem.size), len(_STARTS))
    bent = np.tile(_STARTS, problem.size)[:, None] + np.broadcast_to(problem.q0, problem.dead_force.shape[:2])[every]
    q, landed = let_fall(problem.take(every), bent)
    q, frame = q[landed], every[landed]
    alpha = statics.node_angles(problem.take(frame), q)
    order = np.lexsort((alpha[:, -1], frame))
    q, frame, alpha = q[order], frame[order], alpha[order]
    same = (np.diff(frame) == 0) & (np.max(np.abs(np.diff(alpha, axis=0)), axis=-1, initial=0.0) < _SAME)
    new = np.append(np.ones(min(len(frame), 1), dtype=bool), ~same)
    return q[new], frame[new]
