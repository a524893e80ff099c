"""A beam loaded at one place, and one point of it: arrays for Newton's method.

The balance is that of `beam/statics.py` for one frame. Without weight the beam beyond the load keeps its rest
curvature: those nodes are not unknown.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigvalsh
from scipy.linalg.lapack import dgesv, dposv, dpotrf

from onebend.beam.continuation import follow
from onebend.beam.grid import Modes, jacobians, make_grid, places, positions
from onebend.beam.loads import push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Problem, Resolution, make_problem, refuse_section
from onebend.control.goals import numbers
from onebend.errors import ControlError
from onebend.options import POSITIVE, option
from onebend.records import Array

_RANK_TOLERANCE = 1e-9  # of the largest singular value


@dataclass(frozen=True)
class LoadedState:
    """Shape and load, not necessarily in equilibrium."""

    q: Array  # (n,) rad, at the loaded nodes
    load: Array  # (3,) N, N, N m at the push


class PushedBeam:
    def __init__(
        self,
        beam: Beam,
        push_s: float,
        point_s: float,
        *,
        gravity: ArrayLike = (0.0, 0.0),
        resolution: Resolution = Resolution(),
    ) -> None:
        """Raises `ControlError` for a place outside (0, 1], `MechanicsError` if no shape carries the weight, or for a
        beam with a thickness."""
        refuse_section(beam, "reaching for a point")
        for name, place in (("push_s", push_s), ("point_s", point_s)):
            if not 0.0 < place <= 1.0:
                raise ControlError(f"{name} lies in (0, 1], 1 the tip; got {place:g}")
        self._heavy = heavy = bool(np.any(np.asarray(gravity, dtype=float) != 0.0))
        loads = weight(gravity) + push((0.0, 0.0), push_s) + twist(0.0, push_s)
        self.problem: Problem = make_problem(beam, loads, resolution)
        self.beam, self.push_s, self.point_s, self.resolution = beam, push_s, point_s, resolution
        x, y = np.asarray(gravity, dtype=float).tolist()
        self.gravity: tuple[float, float] = (x, y)
        problem, nodes = self.problem, self.problem.grid.nodes
        self.count = n = len(nodes) if heavy else int(np.sum(nodes < push_s))
        if n == 0:
            raise ControlError(
                f"a force at s = {push_s:g} is too near the clamp to bend the beam. Give s from 1e-6 to 1"
            )
        self.b = np.asfortranarray(problem.to_nodes[:, :n])
        self.square = np.ascontiguousarray(problem.to_nodes[:n, :n])
        beyond = np.asarray(nodes[:n] < push_s, dtype=float)
        self._lw = problem.length * problem.weights[:n]
        self.pull, self._twist = self._lw * beyond, problem.weights[:n] * beyond
        self._weight = self._lw[:, None] * problem.dead_force[0, :n]
        self.stiff = problem.weights[:n] * problem.k[:n]
        self.rest = np.array(problem.q0[:n], dtype=float)
        self._beyond = problem.alpha0 + problem.to_nodes[:, n:] @ problem.q0[n:]
        self._angle_row = problem.grid.integral_to(np.array([point_s]))[0]
        self.row = problem.length * self._angle_row
        self._base_row = problem.grid.value_at(np.zeros(1))[0, :n]
        self.force_scale = float(np.mean(problem.k)) / (problem.length * push_s**2)
        self.scale = np.array([self.force_scale, self.force_scale, self.force_scale * problem.length])
        hangs = follow(self.problem) if heavy else None
        if hangs is not None and not (hangs.converged[0] and hangs.stable[0]):
            raise ControlError("the beam does not stand under its own weight. Turn the clamp, or the gravity")
        self.start = LoadedState(self.rest if hangs is None else hangs.q[0], np.zeros(3))

    def loaded(self, load: Array) -> Problem:
        """Under the load (3,)."""
        beyond = np.asarray(self.problem.grid.nodes < self.push_s, dtype=float)
        force = self.problem.dead_force + beyond[None, :, None] * load[:2]
        return replace(self.problem, dead_force=force, moment=load[2] * beyond[None])

    def angles(self, q: Array) -> Array:
        """(Q,) rad."""
        return np.asarray(self.b @ q + self._beyond)

    def pose(self, q: Array) -> Array:
        """(3,) m, m, rad: the point's pose."""
        alpha = self.angles(q)
        return self.place(np.cos(alpha), np.sin(alpha), q, 3)

    def whole(self, q: Array) -> Array:
        """(Q,) at all nodes."""
        return np.concatenate([q, self.problem.q0[self.count :]])

    def balance(self, q: Array, load: Array) -> tuple[Array, Array, Array, Array]:
        """Gradient (n,), tangent (n, n), cos and sin (Q,)."""
        alpha = self.angles(q)
        cos, sin = np.cos(alpha), np.sin(alpha)
        n = self.count
        across, matrix = self._pulled(load, cos[:n], sin[:n])
        return self.stiff * (q - self.rest) - load[2] * self._twist - across @ self.square, matrix, cos, sin

    def linear(self, q: Array, load: Array, cos: Array, sin: Array, loads: int) -> tuple[Array, bool]:
        """(n, 1 + P) X = T^-1 g and Y = T^-1 R (NaN if singular), and whether T is positive definite."""
        n = self.count
        across, tangent = self._pulled(load, cos[:n], sin[:n])
        rows = np.empty((3, n))
        rows[0] = across
        np.multiply(self.pull, sin[:n], out=rows[1])
        np.multiply(self.pull, cos[:n], out=rows[2])
        right = np.empty((n, 1 + loads), order="F")
        np.matmul(rows, self.square, out=right[:, :3].T)
        np.negative(right[:, :2], out=right[:, :2])
        right[:, 0] += self.stiff * (q - self.rest) - load[2] * self._twist
        if loads == 3:
            right[:, 3] = self._twist
        _, solved, info = dposv(tangent, right, lower=1)
        if info == 0:
            return np.asarray(solved), True
        _, _, solved, info = dgesv(tangent, right)
        return np.asarray(solved) if info == 0 else np.full_like(right, np.nan), False

    def _pulled(self, load: Array, cos: Array, sin: Array) -> tuple[Array, Array]:
        """The pull across (n,), and the tangent (n, n) from the pull along."""
        x, y = load[0] * self.pull, load[1] * self.pull
        if self._heavy:
            x, y = x + self._weight[:, 0], y + self._weight[:, 1]
        along = x * cos + y * sin
        tangent = self.square.T @ (along[:, None] * self.square)
        tangent.reshape(-1)[:: self.count + 1] += self.stiff
        return y * cos - x * sin, tangent

    def place(self, cos: Array, sin: Array, q: Array, size: int) -> Array:
        """(2,) m or (3,) m, m, rad: `pose` from cos and sin."""
        x, y = float(self.row @ cos), float(self.row @ sin)
        if size == 2:
            return np.array([x, y])
        n = self.count
        turn = self.problem.alpha0 + self._angle_row[:n] @ q + self._angle_row[n:] @ self.problem.q0[n:]
        return np.array([x, y, float(turn)])

    def point_motion(self, cos: Array, sin: Array, turned: Array, curved: Array, size: int) -> Array:
        """(2 or 3, P): the point's motion for curvatures (n, P) that turn the nodes by (Q, P)."""
        rows = np.empty((2, len(cos)))
        np.multiply(self.row, -sin, out=rows[0])
        np.multiply(self.row, cos, out=rows[1])
        moved = rows @ turned
        return moved if size == 2 else np.vstack([moved, self._angle_row[: self.count] @ curved])

    def of_load(self, cos: Array, sin: Array) -> Array:
        """(n, 3) R: minus the gradient's derivative by the load."""
        n = self.count
        return np.stack(
            [-(self.pull * sin[:n]) @ self.square, (self.pull * cos[:n]) @ self.square, self._twist], axis=1
        )

    def of_shape(self, cos: Array, sin: Array) -> Array:
        """(3, n) J: the pose by the curvature."""
        return self.point_motion(cos, sin, self.b, np.eye(self.count), 3)

    def bend(self, q: Array) -> float:
        """1/m: largest curvature beyond that at rest."""
        away = q - self.rest
        return float(max(np.max(np.abs(away)), abs(self._base_row @ away)) / self.problem.length)

    def response(self, state: LoadedState) -> Array:
        """(3, 3) S: the pose by the load, in equilibrium; NaN at a limit point."""
        _, tangent, cos, sin = self.balance(state.q, state.load)
        _, _, solved, info = dgesv(tangent, self.of_load(cos, sin))
        return self.of_shape(cos, sin) @ solved if info == 0 else np.full((3, 3), np.nan)

    def same(self, first: LoadedState, other: LoadedState) -> bool:
        """Equal to rounding."""
        return float(np.max(np.abs(self.b @ (first.q - other.q)))) < _SAME_SHAPE

    def stable(self, state: LoadedState) -> bool:
        _, tangent, _, _ = self.balance(state.q, state.load)
        return bool(dpotrf(tangent, lower=1)[1] == 0)


def least_eigenvalue(tangent: Array, held: Array | None) -> float:
    """Of a scaled tangent (n, n), on changes that leave places alone that they move by `held` (m, n): 1 without loads,
    0 at buckling."""
    if held is not None:
        _, sizes, rows = np.linalg.svd(held)  # nothing moves a straight beam's end along it
        free = rows[int(np.sum(sizes > _RANK_TOLERANCE * sizes[0])) :]
        tangent = free @ tangent @ free.T
    return float(eigvalsh(tangent, subset_by_index=[0, 0])[0])


def prepared(
    beam: Beam, push_s: float, point_s: float, gravity: tuple[float, float], resolution: Resolution
) -> PushedBeam:
    """`PushedBeam`, cached with the beam."""
    key = (PushedBeam, push_s, point_s, gravity, resolution)
    return beam.memory.once(key, lambda: PushedBeam(beam, push_s, point_s, gravity=gravity, resolution=resolution))


# Newton's method on shape and load together: the exact (23). With balance `g(q, p) = 0`, goal `r(s_p; q) = goal`,
# `X = T^-1 g` and `Y = T^-1 R` (T the tangent, R = -dg/dp, J = dr(s_p)/dq), a step is
#
#     dq = Y dp - X,      S dp = goal - r(s_p) + J X,      S = J Y.
#
# S is J_F of (25) with the exact tangent instead of K.

TOLERANCE = 3e-7  # rad, of the last update; the error is its square
_REMAINING = 1e-8  # rad, remaining error
_FINAL_UPDATE = 1e-2  # rad: largest update from which the error is predicted
_MINUS_ONE = np.array([-1.0])
_LARGEST_TURN = 0.7  # rad, per step


@dataclass(frozen=True, slots=True)
class NewtonResult:
    """The end of Newton's method, with derivatives before its last step."""

    state: LoadedState
    iterations: int
    converged: bool
    positive: bool = False  # of the tangent
    compliance: Array | None = None  # (2 or 3, P): S


def solve_goal(
    pushed: PushedBeam, start: LoadedState, goal: Array, loads: int = 2, *, most: int = 20, trust: float = math.inf
) -> NewtonResult:
    """Newton from `start` to the goal (2,) or (3,) with the first 2 or all 3 `loads`.

    Stops unconverged if the beam turns by more than `trust` rad. After updates u and v the error is `v (v / u)^2`. With
    more loads than goals the smallest load (in units of `PushedBeam.scale`) is found.
    """
    q, load, size = start.q, start.load.copy(), len(goal)
    alpha = pushed.angles(q)
    begin, before = alpha, 0.0
    for iteration in range(1, most + 1):
        cos, sin = np.cos(alpha), np.sin(alpha)
        solved, positive = pushed.linear(q, load, cos, sin, loads)
        turned = pushed.b @ solved
        moved = pushed.point_motion(cos, sin, turned, solved, size)  # J X, J Y (m, 1 + P)
        away = goal - pushed.place(cos, sin, q, size)
        change = _change(moved[:, 1:], away + moved[:, 0], load, pushed.scale)
        by = np.concatenate([_MINUS_ONE, change])
        turn = turned @ by
        largest = max(float(turn.max()), -float(turn.min()))
        if not math.isfinite(largest):
            return NewtonResult(LoadedState(q, load), iteration, False)
        if largest > _LARGEST_TURN:
            shorter = _LARGEST_TURN / largest
            by, turn, change = by * shorter, turn * shorter, change * shorter
        q, alpha = q + solved @ by, alpha + turn
        load[:loads] += change
        if trust < math.inf and not float(np.abs(alpha - begin).max()) < trust:
            return NewtonResult(LoadedState(q, load), iteration, False)
        if largest < TOLERANCE or (iteration > 1 and largest**3 < _REMAINING * before**2 and largest < _FINAL_UPDATE):
            return NewtonResult(LoadedState(q, load), iteration, True, positive, moved[:, 1:])
        before = min(largest, _LARGEST_TURN)
    return NewtonResult(LoadedState(q, load), most, False)


def _change(s: Array, wanted: Array, load: Array, scale: Array) -> Array:
    """(P,) dp of S dp = wanted, with the smallest load if underdetermined; NaN if none."""
    if s.shape == (2, 2):
        (a, b), (c, d) = s.tolist()
        x, y = wanted.tolist()
        det = a * d - b * c
        return np.array([(d * x - b * y) / det, (a * y - c * x) / det]) if det != 0.0 else np.full(2, np.nan)
    if not np.all(np.isfinite(s)):
        return np.full(3, np.nan)
    now = load / scale
    return np.asarray(scale * (np.linalg.pinv(s * scale) @ (wanted + s @ load) - now))


LARGEST_STEP_TURN = 0.7  # rad, of a prediction
# rad, share of the way: largest turn and shortest step while the goal moves
_GOAL_TRUST, _SHORTEST_GOAL_STEP = 0.4, 1e-4
_SHORTEST_LOAD_STEP = 1e-6  # share of the load: a shorter step has met the branch's end
_SAME_SHAPE = 1e-6  # rad, between different shapes


@dataclass(frozen=True)
class EquilibriumPath:
    """Equilibria under a load that grows in proportion."""

    states: tuple[LoadedState, ...]  # the first at rest
    arrived: bool  # at the full load, always stable


def trace(
    pushed: PushedBeam,
    load: Array,
    *,
    start: LoadedState | None = None,
    widest: float = 1.0,
    shortest: float = _SHORTEST_LOAD_STEP,
) -> EquilibriumPath:
    """Stable shapes while the load grows from that of `start` (default: rest) straight to `load` (3,).

    `widest`, `shortest`: steps as shares of the way. A step is accepted if the correction is small and the shape
    stable.
    """
    states = [start or pushed.start]
    begin, q = states[0].load, states[0].q
    way, share, step = load - begin, 0.0, 1.0
    _, tangent, cos, sin = pushed.balance(q, begin)
    while share < 1.0:
        _, slope, info = dposv(tangent, pushed.of_load(cos, sin) @ way, lower=1)
        if info != 0:
            return EquilibriumPath(tuple(states), False)
        turn = float(np.max(np.abs(pushed.b @ slope)))
        step = min(step, 1.0 - share, widest, LARGEST_STEP_TURN / max(turn, 1e-300))
        corrected = None
        while corrected is None:
            if step < shortest:
                return EquilibriumPath(tuple(states), False)
            now = 1.0 if share + step > 1.0 - 1e-12 else share + step
            corrected = _correct(pushed, q + step * slope, begin + now * way, trusted(step * turn))
            step = step * (2.0 if corrected is not None else 0.25)
        q, tangent, cos, sin = corrected
        share = now
        states.append(LoadedState(q, begin + share * way))
    return EquilibriumPath(tuple(states), True)


def trusted(turn: float) -> float:
    """rad, allowed correction of a shape predicted to turn by `turn`."""
    return min(0.25, 1e-3 + 0.5 * turn)


def lead(
    pushed: PushedBeam,
    start: LoadedState,
    goal: Array,
    loads: int = 2,
    allowed: Callable[[LoadedState], bool] | None = None,
) -> EquilibriumPath:
    """Equilibria while the goal moves straight from the point of `start` to `goal`. Ends early at the edge of reach, or
    where they are not `allowed` (default: not stable)."""
    begin = pushed.pose(start.q)[: len(goal)]
    states, share, step = [start], 0.0, 1.0
    while share < 1.0 and step > _SHORTEST_GOAL_STEP:
        now = min(1.0, share + step)
        result = solve_goal(pushed, states[-1], begin + now * (goal - begin), loads, most=8, trust=_GOAL_TRUST)
        if result.converged and (allowed or pushed.stable)(result.state):
            states.append(result.state)
            share, step = now, 2.0 * step
        else:
            step *= 0.25
    return EquilibriumPath(tuple(states), share == 1.0)


def _correct(pushed: PushedBeam, q: Array, load: Array, trust: float) -> tuple[Array, Array, Array, Array] | None:
    """Newton at fixed load, with Cholesky's factor at every iteration."""
    moved: Array | float = 0.0
    for _ in range(8):
        unbalanced, tangent, cos, sin = pushed.balance(q, load)
        _, update, info = dposv(tangent, unbalanced, lower=1)
        if info != 0:
            return None
        q = q - update
        turn = pushed.b @ update
        moved = moved + turn
        if not float(np.max(np.abs(moved))) < trust:
            return None
        if float(np.max(np.abs(turn))) < TOLERANCE:
            return q, tangent, cos, sin
    return None


def densified(pushed: PushedBeam, states: tuple[LoadedState, ...], steps: int) -> tuple[LoadedState, ...]:
    """The path with at least `steps` steps, by adding equilibria where possible."""
    between = -(-steps // max(len(states) - 1, 1))
    out = [states[0]]
    for begin, end in pairwise(states):
        finer = trace(pushed, end.load, start=begin, widest=1.0 / between)
        same = finer.arrived and pushed.same(finer.states[-1], end)
        out += [*(finer.states[1:-1] if same else ()), end]
    return tuple(out)


# Algorithm 1 of the paper, (23)-(25): `theta <- theta0 + K^-1 J(s_a)^T F` (line 2), the point by forward kinematics
# (line 3), `F <- F + gamma J_F^+ (goal - point)` with `J_F = J(s_p) K^-1 J(s_a)^T` (lines 4, 5, (25)); K is that of
# (6). The paper leaves gamma, tolerance and pseudo-inverse cutoff open. Without a cutoff the iteration diverges from
# rest.


@dataclass(frozen=True)
class PaperSettings:
    """Choices that the paper leaves open."""

    n: int = 5
    gamma: float = 0.3
    cutoff: float = 0.01  # singular values of J_F below this share of the largest are dropped
    tolerance: float = 1e-3  # m; the paper reports errors of a millimetre or less
    most: int = 500  # iterations


def paper_force(
    beam: Beam, goal: Array, push_s: float, point_s: float, settings: PaperSettings = PaperSettings()
) -> tuple[Array, int, bool]:
    """Algorithm 1 from zero force, for a goal (2,) m: the force (2,) N, the iterations, and whether the modal point is
    within the tolerance."""
    modes = Modes(settings.n)
    grid = make_grid(beam.stiffness.jumps, order=30)
    phi, weights = modes.curvature(grid.nodes), grid.weights
    flexible = np.linalg.inv(phi.T @ ((weights * beam.stiffness(grid.nodes))[:, None] * phi))
    mass = phi.T @ (weights[:, None] * phi)
    rest = np.linalg.solve(mass, phi.T @ (weights * beam.rest_curvature(grid.nodes)))
    at = places(beam.length, modes, np.array([push_s, point_s]))
    theta, force = np.asarray(rest, dtype=float), np.zeros(2)
    for turn in range(1, settings.most + 1):
        push = jacobians(at, theta[None], beam.clamp_angle)[0, 0]
        theta = np.asarray(rest + flexible @ (push.T @ force), dtype=float)
        away = goal - positions(at, theta[None], beam.clamp_angle)[0, 1]
        if np.linalg.norm(away) <= settings.tolerance:
            return force, turn, True
        both = jacobians(at, theta[None], beam.clamp_angle)[0]
        step = np.linalg.pinv(both[1] @ flexible @ both[0].T, rcond=settings.cutoff) @ away
        force = force + settings.gamma * step
        if not np.all(np.isfinite(force)) or np.max(np.abs(theta)) > 1e3:
            return np.nan_to_num(force), turn, False
    return force, settings.most, False


FARTHEST_GOAL = 1e9  # m or rad


@dataclass(frozen=True)
class ReachSettings:
    """Bounds and method of the search for a force."""

    method: Literal["newton", "paper"] = option("--method", "newton")
    max_force: float | None = option("--max-force-N", None, within=POSITIVE)  # infinity means none
    max_curvature: float | None = option("--max-curvature-per-m", None, within=POSITIVE)
    moment: bool = option("--moment", False)
    gravity: tuple[float, float] = (0.0, 0.0)  # m/s^2
    tolerance: float = 1e-6  # m, of the point
    steps: int = 20  # least steps of the path of forces
    paper: PaperSettings = field(default_factory=PaperSettings)

    def __post_init__(self) -> None:
        for name, words in (("max_force", "the largest force"), ("max_curvature", "the largest curvature")):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise ControlError(f"{words} must be positive, got {value:g}")
            if value == math.inf:
                object.__setattr__(self, name, None)
        if not self.tolerance > 0.0 or self.steps < 1:
            raise ControlError("the tolerance must be positive, and the path needs at least one step")
        bounded = self.max_force is not None or self.max_curvature is not None
        if self.method == "paper" and (bounded or self.moment or any(self.gravity)):
            raise ControlError("the paper's iteration knows no bounds, moment or weight; take the method newton")

    @property
    def loads(self) -> int:
        """Number of free load components."""
        return 3 if self.moment else 2


def checked_goal(goal: ArrayLike, settings: ReachSettings) -> Array:
    """(2,) or (3,). Raises `ControlError`."""
    wanted = np.asarray(goal, dtype=float)
    if wanted.shape not in ((2,), (3,)) or not np.all(np.abs(wanted) < FARTHEST_GOAL):
        raise ControlError(f"a goal is a place (x, y) [m], or with an angle (x, y, angle [rad]); got {numbers(wanted)}")
    if len(wanted) == 3 and not settings.moment:
        raise ControlError("a force alone cannot hold a point at an angle: allow a moment, or leave the angle out")
    return wanted


def broken_bound(size: float, bend: float, settings: ReachSettings) -> str:
    """The bound that a force of `size` [N] or a curvature `bend` [1/m] violates, in words, or ""."""
    if settings.max_force is not None and size > settings.max_force * (1.0 + 1e-9):
        return f"it needs {size:.3g} N, and {settings.max_force:.3g} N are allowed"
    if settings.max_curvature is not None and bend > settings.max_curvature * (1.0 + 1e-9):
        return f"it bends the beam by {bend:.3g} 1/m, and {settings.max_curvature:.3g} 1/m are allowed"
    return ""
