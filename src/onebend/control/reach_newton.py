"""Newton's method on shape and load together: the load at one place that puts a point on a goal, (23) made exact.

Unknown are the curvature q at the nodes and the load p at s_a: the balance `g(q, p) = 0` of `beam/statics.py` and the
goal `r(s_p; q) = goal`. With `X = T^-1 g` and `Y = T^-1 R` (T the tangent, R = -dg/dp) one step is

    dq = Y dp - X,      S dp = goal - r(s_p) + J X,      S = J Y,

J = dr(s_p)/dq. S is the Jacobian J_F of (25) with the exact tangent in place of K. Beyond the load a beam without
weight keeps its rest curvature: those nodes are no unknowns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dgesv, dposv, dpotrf

from onebend.beam.continuation import follow
from onebend.beam.loads import push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Problem, Resolution, pose
from onebend.errors import ControlError
from onebend.records import Array

TOLERANCE = 3e-7  # rad, of the last update: convergence is quadratic, the error its square
_LEFT, _SMALL = 1e-8, 1e-2  # rad that may be left, and of the last update where that is foretold
_MINUS = np.array([-1.0])
_CAP = 0.7  # rad, the largest turn of a step
_STRIDE, _TRUST, _SURPRISE, _LEAST = 0.7, 0.25, 0.5, 1e-3  # as `continuation.Search`
_LEAD, _SHORTEST_LEAD = 0.4, 1e-4  # rad of turn, share of the way of a step in which the goal moves
_SHORTEST = 1e-6  # share of the load: a shorter step has met the end of the branch


@dataclass(frozen=True)
class State:
    """A shape and the load it is meant for; an equilibrium only where a solver says so."""

    q: Array  # (n,) rad, curvature at the loaded nodes
    load: Array  # (3,) N, N, N m at the push


@dataclass(frozen=True, slots=True)
class Landing:
    """Where Newton's method ended, and what it knew before its last step."""

    state: State
    iterations: int
    converged: bool
    positive: bool = False  # the tangent was positive definite
    curved: Array | None = None  # (n, P) rad a unit load: Y
    seen: Array | None = None  # (2 or 3, P): S


@dataclass(frozen=True)
class Trail:
    """Equilibria under a load that grows in proportion, each reached from the one before."""

    states: tuple[State, ...]  # the first at rest
    share: tuple[float, ...]  # of the load
    arrived: bool  # at the full load, stable all the way


class PushedBeam:
    """A beam with one loaded place and one point looked at; the arrays of Newton's method on them."""

    def __init__(
        self,
        beam: Beam,
        push_s: float,
        point_s: float,
        *,
        gravity: ArrayLike = (0.0, 0.0),
        resolution: Resolution = Resolution(),
    ) -> None:
        """Raises `ControlError` for a place outside (0, 1], `MechanicsError` where no shape carries the weight."""
        for name, place in (("push_s", push_s), ("point_s", point_s)):
            if not 0.0 < place <= 1.0:
                raise ControlError(f"{name} lies in (0, 1], 1 the tip; got {place}")
        self._heavy = heavy = bool(np.any(np.asarray(gravity, dtype=float) != 0.0))
        loads = weight(gravity) + push((0.0, 0.0), push_s) + twist(0.0, push_s)
        self.problem: Problem = pose(beam, loads, resolution)
        self.beam, self.push_s, self.point_s, self.resolution = beam, push_s, point_s, resolution
        problem, nodes = self.problem, self.problem.grid.nodes
        self.count = n = len(nodes) if heavy else int(np.sum(nodes < push_s))
        self.b = np.asfortranarray(problem.to_nodes[:, :n])
        self.square = np.ascontiguousarray(problem.to_nodes[:n, :n])
        beyond = np.asarray(nodes[:n] < push_s, dtype=float)
        self._lw = problem.length * problem.weights[:n]
        self._pull, self._twist = self._lw * beyond, problem.weights[:n] * beyond
        self._weight = self._lw[:, None] * problem.dead_force[0, :n]
        self.stiff = problem.weights[:n] * problem.k[:n]
        self.rest = np.array(problem.q0[:n], dtype=float)
        self._beyond = problem.alpha0 + problem.to_nodes[:, n:] @ problem.q0[n:]
        self._angle_row = problem.grid.integral_to(np.array([point_s]))[0]
        self._minus_row = -problem.length * self._angle_row
        self.row = problem.length * self._angle_row
        self._push_row = problem.length * problem.grid.integral_to(np.array([push_s]))[0]
        self._base_row = problem.grid.value_at(np.zeros(1))[0, :n]
        self.force_scale = float(np.mean(problem.k)) / (problem.length * push_s**2)
        self.scale = np.array([self.force_scale, self.force_scale, self.force_scale * problem.length])
        self.start = State(self._hanging() if heavy else self.rest, np.zeros(3))

    def _hanging(self) -> Array:
        found = follow(self.problem)
        if not (found.converged[0] and found.stable[0]):
            raise ControlError("the beam does not stand under its own weight. Turn the clamp, or the gravity")
        return np.asarray(found.q[0])

    def angles(self, q: Array) -> Array:
        """(Q,) rad at all nodes."""
        return np.asarray(self.b @ q + self._beyond)

    def pose(self, q: Array) -> Array:
        """(3,) m, m, rad: the point's place and the tangent's angle there."""
        alpha = self.angles(q)
        return self.place(np.cos(alpha), np.sin(alpha), q, 3)

    def shape_xy(self, q: Array, s: Array) -> Array:
        """(S, 2) m: places `s` (S,) of the beam."""
        alpha = self.angles(q)
        return np.asarray(
            self.problem.length * self.problem.grid.integral_to(s) @ np.stack([np.cos(alpha), np.sin(alpha)], 1)
        )

    def whole(self, q: Array) -> Array:
        """(Q,) the curvature at all nodes."""
        return np.concatenate([q, self.problem.q0[self.count :]])

    def balance(self, q: Array, load: Array) -> tuple[Array, Array, Array, Array]:
        """Gradient (n,), tangent (n, n), cos and sin (Q,)."""
        alpha = self.angles(q)
        cos, sin = np.cos(alpha), np.sin(alpha)
        n = self.count
        across, tangent = self._pulled(load, cos[:n], sin[:n])
        unbalanced = self.stiff * (q - self.rest) - load[2] * self._twist - across @ self.square
        return unbalanced, tangent, cos, sin

    def linear(self, q: Array, load: Array, cos: Array, sin: Array, loads: int) -> tuple[Array, bool]:
        """(n, 1 + P) X = T^-1 g and Y = T^-1 R beside it, NaN for a singular T; whether T is positive definite."""
        n = self.count
        across, tangent = self._pulled(load, cos[:n], sin[:n])
        rows = np.empty((3, n))
        rows[0] = across
        np.multiply(self._pull, sin[:n], out=rows[1])
        np.multiply(self._pull, cos[:n], out=rows[2])
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
        """The pull across (n,), and the tangent (n, n) by the pull along."""
        x, y = load[0] * self._pull, load[1] * self._pull
        if self._heavy:
            x, y = x + self._weight[:, 0], y + self._weight[:, 1]
        along = x * cos + y * sin
        tangent = self.square.T @ (along[:, None] * self.square)
        tangent.reshape(-1)[:: self.count + 1] += self.stiff
        return y * cos - x * sin, tangent

    def place(self, cos: Array, sin: Array, q: Array, size: int) -> Array:
        """(2,) m or (3,) m, m, rad: as `pose`, where cos and sin are known."""
        x, y = float(self.row @ cos), float(self.row @ sin)
        return np.array([x, y]) if size == 2 else np.array([x, y, self._turn(q)])

    def sees(self, cos: Array, sin: Array, turned: Array, curved: Array, size: int) -> Array:
        """(2 or 3, P): how the point moves with turns (Q, P) of the nodes by curvatures (n, P)."""
        rows = np.empty((2, len(cos)))
        np.multiply(self._minus_row, sin, out=rows[0])
        np.multiply(self.row, cos, out=rows[1])
        moved = rows @ turned
        return moved if size == 2 else np.vstack([moved, self._angle_row[: self.count] @ curved])

    def _turn(self, q: Array) -> float:
        n = self.count
        return float(self.problem.alpha0 + self._angle_row[:n] @ q + self._angle_row[n:] @ self.problem.q0[n:])

    def of_load(self, cos: Array, sin: Array) -> Array:
        """(n, 3) R: minus the derivative of the gradient with the load."""
        n = self.count
        return np.stack(
            [-(self._pull * sin[:n]) @ self.square, (self._pull * cos[:n]) @ self.square, self._twist], axis=1
        )

    def of_shape(self, cos: Array, sin: Array) -> Array:
        """(3, n) J: derivative of the point's pose with the curvature."""
        x, y = -(self.row * sin) @ self.b, (self.row * cos) @ self.b
        return np.stack([x, y, self._angle_row[: self.count]])

    def bend(self, q: Array) -> float:
        """1/m: the largest curvature beyond that at rest, at the nodes and at the clamp."""
        away = q - self.rest
        return float(max(np.max(np.abs(away)), abs(self._base_row @ away)) / self.problem.length)

    def response(self, state: State) -> Array:
        """(3, 3) S: how the point's pose goes with the load, in equilibrium; NaN at a limit point."""
        _, tangent, cos, sin = self.balance(state.q, state.load)
        _, _, solved, info = dgesv(tangent, self.of_load(cos, sin))
        return self.of_shape(cos, sin) @ solved if info == 0 else np.full((3, 3), np.nan)

    def stable(self, state: State) -> bool:
        """Whether the tangent is positive definite."""
        _, tangent, _, _ = self.balance(state.q, state.load)
        return bool(dpotrf(tangent, lower=1)[1] == 0)


def solve_goal(
    on: PushedBeam, start: State, goal: Array, loads: int = 2, *, most: int = 20, trust: float = math.inf
) -> Landing:
    """Newton from `start` to the goal (2,) or (3,) with the first 2 or all 3 `loads`.

    It converges where it does without turning the beam by more than `trust` rad: updates u and v, one after the
    other, leave `v (v / u)^2`. With more loads than the goal has numbers, the smallest (in units of `on.scale`) is
    found.
    """
    q, load, size = start.q, start.load.copy(), len(goal)
    alpha = on.angles(q)
    begin, before = alpha, 0.0
    for iteration in range(1, most + 1):
        cos, sin = np.cos(alpha), np.sin(alpha)
        solved, positive = on.linear(q, load, cos, sin, loads)
        turned = on.b @ solved
        moved = on.sees(cos, sin, turned, solved, size)  # (m, 1 + P): J X, J Y
        away = goal - on.place(cos, sin, q, size)
        change = _change(moved[:, 1:], away + moved[:, 0], load, on.scale)
        by = np.concatenate([_MINUS, change])
        turn = turned @ by
        largest = max(float(turn.max()), -float(turn.min()))
        if not math.isfinite(largest):
            return Landing(State(q, load), iteration, False)
        if largest > _CAP:
            by, turn, change = by * (_CAP / largest), turn * (_CAP / largest), change * (_CAP / largest)
        q, alpha = q + solved @ by, alpha + turn
        load[:loads] += change
        if trust < math.inf and not float(np.abs(alpha - begin).max()) < trust:
            return Landing(State(q, load), iteration, False)
        if largest < TOLERANCE or (iteration > 1 and largest**3 < _LEFT * before**2 and largest < _SMALL):
            return Landing(State(q, load), iteration, True, positive, solved[:, 1:], moved[:, 1:])
        before = min(largest, _CAP)
    return Landing(State(q, load), most, False)


def _change(s: Array, wanted: Array, load: Array, scale: Array) -> Array:
    """(P,) the change of the loads: S dp = wanted, and of many the one that makes the load smallest; NaN for none."""
    if s.shape == (2, 2):
        (a, b), (c, d) = s.tolist()
        x, y = wanted.tolist()
        det = a * d - b * c
        return np.array([(d * x - b * y) / det, (a * y - c * x) / det]) if det != 0.0 else np.full(2, np.nan)
    if s.shape == (3, 3):
        _, _, out, info = dgesv(s, wanted)
        return np.asarray(out) if info == 0 else np.full(3, np.nan)
    if not np.all(np.isfinite(s)):
        return np.full(3, np.nan)
    now = load / scale
    return np.asarray(scale * (np.linalg.pinv(s * scale) @ (wanted + s @ load) - now))


def trace(on: PushedBeam, load: Array, *, start: State | None = None, widest: float = 1.0) -> Trail:
    """Shapes while the load grows from that of `start` (default: rest) straight to `load` (3,), stable all the way.

    `widest`: the largest step, as a share of the way.

    As in `beam/continuation.py`: a step counts only where the corrector moved the shape little and it is stable.
    """
    at = start or on.start
    begin, way = at.load, load - at.load
    states, shares = [at], [0.0]
    share, step = 0.0, 1.0
    q = at.q
    _, tangent, cos, sin = on.balance(q, begin)
    while share < 1.0:
        _, slope, info = dposv(tangent, on.of_load(cos, sin) @ way, lower=1)
        if info != 0:
            return Trail(tuple(states), tuple(shares), False)
        turn = float(np.max(np.abs(on.b @ slope)))
        step = min(step, 1.0 - share, widest, _STRIDE / max(turn, 1e-300))
        found = None
        while found is None:
            if step < _SHORTEST:
                return Trail(tuple(states), tuple(shares), False)
            now = 1.0 if share + step > 1.0 - 1e-12 else share + step
            trust = min(_TRUST, _LEAST + _SURPRISE * step * turn)
            found = _correct(on, q + step * slope, begin + now * way, trust)
            step = step * (2.0 if found is not None else 0.25)
        q, tangent, cos, sin = found
        share = now
        states.append(State(q, begin + share * way))
        shares.append(share)
    return Trail(tuple(states), tuple(shares), True)


def lead(on: PushedBeam, start: State, goal: Array, loads: int = 2) -> Trail:
    """Equilibria while the goal moves straight from where `start` has the point to `goal`, stable all the way.

    The loads follow the goal; `share` is of the way. It ends early where no force leads on (the edge of what can be
    reached, or of stability).
    """
    begin = on.pose(start.q)[: len(goal)]
    states, shares, step = [start], [0.0], 1.0
    while shares[-1] < 1.0 and step > _SHORTEST_LEAD:
        now = min(1.0, shares[-1] + step)
        found = solve_goal(on, states[-1], begin + now * (goal - begin), loads, most=8, trust=_LEAD)
        if found.converged and on.stable(found.state):
            states.append(found.state)
            shares.append(now)
            step *= 2.0
        else:
            step *= 0.25
    return Trail(tuple(states), tuple(shares), shares[-1] == 1.0)


def _correct(on: PushedBeam, q: Array, load: Array, trust: float) -> tuple[Array, Array, Array, Array] | None:
    """Newton at a fixed load, proved stable by Cholesky's factor at every iteration."""
    moved: Array | float = 0.0
    for _ in range(8):
        unbalanced, tangent, cos, sin = on.balance(q, load)
        _, update, info = dposv(tangent, unbalanced, lower=1)
        if info != 0:
            return None
        q = q - update
        turn = on.b @ update
        moved = moved + turn
        if not float(np.max(np.abs(moved))) < trust:
            return None
        if float(np.max(np.abs(turn))) < TOLERANCE:
            return q, tangent, cos, sin
    return None
