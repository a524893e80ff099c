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
_CAP = 0.7  # rad, the largest turn of a step
_STRIDE, _TRUST, _SURPRISE, _LEAST = 0.7, 0.25, 0.5, 1e-3  # as `continuation.Search`
_LEAD, _SHORTEST_LEAD = 0.4, 1e-4  # rad of turn, share of the way of a step in which the goal moves
_SHORTEST = 1e-6  # share of the load: a shorter step has met the end of the branch


@dataclass(frozen=True)
class State:
    """A shape and the load it is meant for; an equilibrium only where a solver says so."""

    q: Array  # (n,) rad, curvature at the loaded nodes
    load: Array  # (3,) N, N, N m at the push


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
        heavy = bool(np.any(np.asarray(gravity, dtype=float) != 0.0))
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
        turn = self._angle_row[: self.count] @ q + self._angle_row[self.count :] @ self.problem.q0[self.count :]
        return np.array([self.row @ np.cos(alpha), self.row @ np.sin(alpha), float(self.problem.alpha0) + turn])

    def shape_xy(self, q: Array, s: Array) -> Array:
        """(S, 2) m: places `s` (S,) of the beam."""
        alpha = self.angles(q)
        return np.asarray(self.problem.length * self.problem.grid.integral_to(s) @ np.stack([np.cos(alpha), np.sin(alpha)], 1))

    def whole(self, q: Array) -> Array:
        """(Q,) the curvature at all nodes."""
        return np.concatenate([q, self.problem.q0[self.count :]])

    def balance(self, q: Array, load: Array) -> tuple[Array, Array, Array, Array]:
        """Gradient (n,), tangent (n, n), cos and sin (Q,)."""
        alpha = self.angles(q)
        cos, sin = np.cos(alpha), np.sin(alpha)
        n = self.count
        x, y = load[0] * self._pull + self._weight[:, 0], load[1] * self._pull + self._weight[:, 1]
        across = y * cos[:n] - x * sin[:n]
        along = x * cos[:n] + y * sin[:n]
        unbalanced = self.stiff * (q - self.rest) - load[2] * self._twist - across @ self.square
        tangent = self.square.T @ (along[:, None] * self.square)
        tangent.reshape(-1)[:: n + 1] += self.stiff
        return unbalanced, tangent, cos, sin

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
    on: PushedBeam, start: State, goal: Array, free: Array, *, most: int = 20, trust: float = math.inf
) -> tuple[State, int, bool]:
    """Newton from `start` to the goal (2,) or (3,); `free` (3, P) are the loads that may be given.

    Returns the state, the iterations, and whether it converged without turning the beam by more than `trust` rad.
    With more loads than the goal has numbers, the smallest (in units of `on.scale`) is found.
    """
    q, load, size = start.q, start.load, len(goal)
    moved = np.zeros(len(on.problem.weights))
    for iteration in range(1, most + 1):
        unbalanced, tangent, cos, sin = on.balance(q, load)
        right = np.column_stack([unbalanced, on.of_load(cos, sin) @ free])
        _, _, solved, info = dgesv(tangent, right, overwrite_a=1, overwrite_b=1)
        if info != 0:
            return State(q, load), iteration, False
        j = on.of_shape(cos, sin)[:size]
        at = np.array([on.row @ cos, on.row @ sin, on.pose(q)[2] if size == 3 else 0.0])[:size]
        change = _step(j @ solved[:, 1:], goal - at + j @ solved[:, 0], load, on.scale, free)
        step = solved[:, 1:] @ change - solved[:, 0]
        turn = on.b @ step
        largest = float(np.max(np.abs(turn)))
        if not math.isfinite(largest):
            return State(q, load), iteration, False
        share = min(1.0, _CAP / max(largest, 1e-300))
        q, load = q + share * step, load + share * (free @ change)
        moved += share * turn
        if not float(np.max(np.abs(moved))) < trust:
            return State(q, load), iteration, False
        if largest < TOLERANCE:
            return State(q, load), iteration, True
    return State(q, load), most, False


def _step(s: Array, wanted: Array, load: Array, scale: Array, free: Array) -> Array:
    """(P,) the change of the free loads: S dp = wanted, and of many the one that makes the load smallest."""
    if s.shape[0] == s.shape[1] == 2:
        det = s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]
        if det == 0.0:
            return np.full(2, np.nan)
        dx, dy = s[1, 1] * wanted[0] - s[0, 1] * wanted[1], s[0, 0] * wanted[1] - s[1, 0] * wanted[0]
        return np.array([dx / det, dy / det])
    if s.shape[0] == s.shape[1]:
        _, _, out, info = dgesv(s, wanted)
        return np.asarray(out) if info == 0 else np.full(len(wanted), np.nan)
    units = free.T @ scale  # the free loads are components: one unit each
    now = (free.T @ load) / units
    s = s * units
    inverse = np.linalg.pinv(s)
    return np.asarray(units * (inverse @ (wanted + s @ now) - now))


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


def lead(on: PushedBeam, start: State, goal: Array, free: Array) -> Trail:
    """Equilibria while the goal moves straight from where `start` has the point to `goal`, stable all the way.

    The loads follow the goal; `share` is of the way. It ends early where no force leads on (the edge of what can be
    reached, or of stability).
    """
    begin = on.pose(start.q)[: len(goal)]
    states, shares, step = [start], [0.0], 1.0
    while shares[-1] < 1.0 and step > _SHORTEST_LEAD:
        now = min(1.0, shares[-1] + step)
        found, _, near = solve_goal(on, states[-1], begin + now * (goal - begin), free, most=8, trust=_LEAD)
        if near and on.stable(found):
            states.append(found)
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
