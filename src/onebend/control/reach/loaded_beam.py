"""A beam loaded at one place, and one point of it: balance, tangent and positions as arrays for Newton's method.

The balance is that of `beam/statics/equilibrium.py`, for one frame and without its batch. Beyond the load a beam
without weight keeps its rest curvature: those nodes are no unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dgesv, dposv, dpotrf

from onebend.beam.loads import push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.statics.continuation import follow
from onebend.beam.statics.problem import Problem, Resolution, make_problem
from onebend.beam.statics.rod import refuse_section
from onebend.errors import ControlError
from onebend.records import Array


@dataclass(frozen=True)
class LoadedState:
    """A shape and a load; an equilibrium only if a solver found it."""

    q: Array  # (n,) rad, curvature at the loaded nodes
    load: Array  # (3,) N, N, N m at the push


class PushedBeam:
    """A beam loaded at one place, and one point of it, with the arrays for Newton's method."""

    def __init__(
        self,
        beam: Beam,
        push_s: float,
        point_s: float,
        *,
        gravity: ArrayLike = (0.0, 0.0),
        resolution: Resolution = Resolution(),
    ) -> None:
        """Raises `ControlError` for a place outside (0, 1], `MechanicsError` where no shape carries the weight or the
        beam has a thickness."""
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
        self._minus_row = -problem.length * self._angle_row
        self.row = problem.length * self._angle_row
        self._push_row = problem.length * problem.grid.integral_to(np.array([push_s]))[0]
        self._base_row = problem.grid.value_at(np.zeros(1))[0, :n]
        self.force_scale = float(np.mean(problem.k)) / (problem.length * push_s**2)
        self.scale = np.array([self.force_scale, self.force_scale, self.force_scale * problem.length])
        self.start = LoadedState(self._hanging() if heavy else self.rest, np.zeros(3))

    def _hanging(self) -> Array:
        hanging = follow(self.problem)
        if not (hanging.converged[0] and hanging.stable[0]):
            raise ControlError("the beam does not stand under its own weight. Turn the clamp, or the gravity")
        return np.asarray(hanging.q[0])

    def loaded(self, load: Array) -> Problem:
        """The problem of `beam.statics` under the load (3,)."""
        beyond = np.asarray(self.problem.grid.nodes < self.push_s, dtype=float)
        force = self.problem.dead_force + beyond[None, :, None] * load[:2]
        return replace(self.problem, dead_force=force, moment=load[2] * beyond[None])

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
        """The pull across (n,), and the tangent (n, n) by the pull along."""
        x, y = load[0] * self.pull, load[1] * self.pull
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

    def point_motion(self, cos: Array, sin: Array, turned: Array, curved: Array, size: int) -> Array:
        """(2 or 3, P): the point's motion when curvatures (n, P) turn the nodes by (Q, P)."""
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
            [-(self.pull * sin[:n]) @ self.square, (self.pull * cos[:n]) @ self.square, self._twist], axis=1
        )

    def of_shape(self, cos: Array, sin: Array) -> Array:
        """(3, n) J: derivative of the point's pose with the curvature."""
        x, y = -(self.row * sin) @ self.b, (self.row * cos) @ self.b
        return np.stack([x, y, self._angle_row[: self.count]])

    def bend(self, q: Array) -> float:
        """1/m: the largest curvature beyond that at rest, at the nodes and at the clamp."""
        away = q - self.rest
        return float(max(np.max(np.abs(away)), abs(self._base_row @ away)) / self.problem.length)

    def response(self, state: LoadedState) -> Array:
        """(3, 3) S: how the point's pose goes with the load, in equilibrium; NaN at a limit point."""
        _, tangent, cos, sin = self.balance(state.q, state.load)
        _, _, solved, info = dgesv(tangent, self.of_load(cos, sin))
        return self.of_shape(cos, sin) @ solved if info == 0 else np.full((3, 3), np.nan)

    def stable(self, state: LoadedState) -> bool:
        """Whether the tangent is positive definite."""
        _, tangent, _, _ = self.balance(state.q, state.load)
        return bool(dpotrf(tangent, lower=1)[1] == 0)


def prepared(
    beam: Beam, push_s: float, point_s: float, gravity: tuple[float, float], resolution: Resolution
) -> PushedBeam:
    """The `PushedBeam`, which the beam remembers: its arrays take some milliseconds to make."""
    key = (PushedBeam, push_s, point_s, gravity, resolution)
    return beam.memory.once(key, lambda: PushedBeam(beam, push_s, point_s, gravity=gravity, resolution=resolution))
