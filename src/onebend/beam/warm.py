"""The beam as it stands now: one equilibrium after another for control loops, each found from the one before.

The forces of a loop change little from one call to the next. Newton's method on the balance (8) of `statics.py` then
needs two or three steps from the last shape, after a predictor that costs almost nothing: the out-of-balance of the old
shape under the new forces, solved with the factor of the last tangent, is `dq/dF dF`. The factor is Cholesky's, so that
every step also proves the tangent positive definite, i.e. the shape stable. Where Newton strays, `continuation.follow`
finds the shape from rest.

The plane is taken as complex numbers: with `u = exp(i alpha)` and N the sum of all forces beyond s (times L w),
`z = conj(N) u` holds both products that the balance needs, the pull along the tangent and (negative) across it:

    T = diag(w k) + B^T diag(Re z) B,        g = w (k (q - q0) - m) + B^T Im z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dposv, dpotrf, dpotrs

from onebend.beam.continuation import follow
from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.problem import Resolution, Rod, pose
from onebend.errors import MechanicsError
from onebend.records import Array

_TRUST = 0.3  # rad: a step that turns the beam by more anywhere may have left the branch
_MOST = 6  # Newton iterations before the search from rest
_CARRIED = 1e-5  # share of the curvature's last Legendre coefficients below which markers are good to 1e-7 L: measured
# on 3 stiffnesses, 8 to 16 nodes and loads of F L / k from 1 to 1000, against 8 panels of 24 nodes
_TOLERANCE = 3e-7  # rad, of the last Newton update: convergence is quadratic, the error its square


@dataclass(frozen=True, slots=True)
class Standing:
    """One equilibrium, seen at the markers."""

    xy: Array  # (S, 2) m, positions of the markers
    angle: Array  # (S,) rad, the tangent's angle there
    route: Literal["warm", "rest"]  # Newton from the shape before, or the branch followed from rest
    iterations: int  # Newton iterations

    @property
    def stable(self) -> bool:
        """True, as `WarmBeam.solve` raises where there is no stable shape."""
        return True


@dataclass(frozen=True, slots=True)
class MarkerResponse:
    """How the markers move with P loads: the components of the forces in turn, then the moment if there is one."""

    xy: Array  # (S, 2, P) m/N, and 1/N for the moment
    angle: Array  # (S, P) rad/N, and rad/(N m) for the moment


class WarmBeam:
    """A clamped beam under dead forces at fixed places, which remembers the shape in which it stands.

    Where several stable shapes exist (strong compression), it stays on the one it stands in as long as that one is
    stable and the forces change gradually, as a beam does; after a search from rest it is on the branch of
    `continuation.follow`, which need not be where a jump of a real beam ends. Quasi-static: no inertia.

    Not for two threads at once.
    """

    def __init__(
        self,
        beam: Rod,
        *,
        at_s: Sequence[float] = (1.0,),
        moment_at: float | None = None,
        markers: Sequence[float] = (1.0 / 3.0, 2.0 / 3.0, 1.0),
        gravity: ArrayLike = (0.0, 0.0),
        resolution: Resolution = Resolution(),
    ) -> None:
        """The beam at rest under its weight alone.

        Args:
            beam: length, stiffness, rest curvature, clamp's angle, mass.
            at_s: (a,) places of the forces.
            moment_at: place of the moment.
            markers: (S,) places looked at.
            gravity: (2,) m/s^2 in the beam's frame.
            resolution: nodes and panels; places of loads and jumps of k add edges. The default is good to 1e-7 L where
                k is smooth and F L / k below about 30; `resolved` says whether it is for the shape at hand.

        Raises:
            MechanicsError: a place outside [0, 1], k(s) not positive somewhere, or no stable shape under the weight.
        """
        s = np.asarray(markers, dtype=float)
        if s.ndim != 1 or not np.all((s >= 0.0) & (s <= 1.0)):
            raise MechanicsError(f"markers are at s in [0, 1], got {markers}")
        loads = weight(gravity) + sum((push((0.0, 0.0), place) for place in at_s), Loads())
        if moment_at is not None:
            loads = loads + twist(0.0, moment_at)
        self._problem = problem = pose(beam, loads, resolution)
        grid, count = problem.grid, problem.to_nodes.shape[-1]
        scale = problem.length * problem.weights
        self._b = np.ascontiguousarray(problem.to_nodes)
        self._beyond = np.array(grid.nodes[:, None] < np.asarray(at_s, dtype=float), dtype=float)  # (Q, a)
        self._moment_beyond = np.array(grid.nodes < (-1.0 if moment_at is None else moment_at), dtype=float)
        self._pull = scale[:, None] * self._beyond
        self._weight_pull = scale[:, None] * problem.dead_force[0] * [1.0, -1.0]
        self._stiff = problem.weights * problem.k
        self._rest = self._stiff * problem.q0
        self._has_moment = moment_at is not None
        self._rows = np.ascontiguousarray(grid.integral_to(s))
        self._xy_rows = problem.length * self._rows
        self._clamp = float(problem.alpha0)
        self._allocate(count)
        self._lost = True  # no shape yet: the first is found from rest
        self.solve(np.zeros((len(at_s), 2)))

    def _allocate(self, count: int) -> None:
        """Buffers that `solve` works in, and their views."""
        self._q, self._alpha, self._before = np.zeros(count), np.zeros(count), np.zeros(count)
        self._turn, self._constant = np.zeros(count), np.zeros(count)
        self._u = np.zeros((count, 2))  # cos, sin
        self._load = np.zeros((count, 2))  # conj(N) L w
        self._z = np.zeros(count, dtype=complex)
        self._u_complex, self._load_complex = self._u.view(complex)[:, 0], self._load.view(complex)[:, 0]
        self._cos, self._sin = self._u[:, 0], self._u[:, 1]
        self._along, self._across = self._z.real[:, None], self._z.imag
        self._out, self._scaled = np.zeros(count), np.zeros((count, count))
        self._out_column = self._out[:, None]
        self._tangent = np.zeros((count, count), order="F")  # holds its Cholesky factor after a step
        self._diagonal = self._tangent.reshape(-1, order="F")[:: count + 1]

    def solve(self, force: ArrayLike, moment: float = 0.0) -> Standing:
        """The shape under the forces, from the shape before.

        Args:
            force: (a, 2) N in the beam's frame, or (2,) where there is one place.
            moment: N m about z, at `moment_at`.

        Raises:
            MechanicsError: the forces are not finite or do not fit the places (the beam stays as it is); the branch
                from rest ends before the full load, or is unstable there (the next call then starts from rest).
        """
        pushes = self._checked(force, moment)
        self._set_load(pushes, moment)
        iterations = 0 if self._lost else self._newton()
        route: Literal["warm", "rest"] = "warm"
        if iterations == 0:
            iterations, route = self._from_rest(pushes, moment), "rest"
        np.cos(self._alpha, out=self._cos)
        np.sin(self._alpha, out=self._sin)
        return Standing(self._xy_rows @ self._u, self._rows @ self._q + self._clamp, route, iterations)

    def response(self) -> MarkerResponse:
        """Derivatives of the markers with respect to the loads, in the shape of the last `solve`.

        From the factor at hand, whose shape is within 3e-7 rad of the last: so is, relatively, the answer. Raises
        `MechanicsError` where the last `solve` found no shape.
        """
        if self._lost:
            raise MechanicsError("the last load was refused: there is no shape to take derivatives of")
        sides = self._pull[:, :, None] * np.stack([-self._sin, self._cos], axis=1)[:, None, :]
        right = self._b.T @ sides.reshape(len(self._q), -1)
        if self._has_moment:
            right = np.column_stack([right, self._problem.weights * self._moment_beyond])
        q, _ = dpotrs(self._tangent, right, lower=1)
        turned = self._b @ q
        moved = [self._xy_rows @ (-self._sin[:, None] * turned), self._xy_rows @ (self._cos[:, None] * turned)]
        return MarkerResponse(np.stack(moved, axis=1), self._rows @ q)

    def resolved(self) -> bool:
        """Whether the nodes carry the shape of the last `solve`, so that the markers are good to 1e-7 L.

        For a first look at the loads to come, not for every turn of a loop. False after a refused load.
        """
        return not self._lost and bool(self._problem.grid.legendre_tail(self._q) < _CARRIED)

    def _checked(self, force: ArrayLike, moment: float) -> Array:
        """(a, 2) N."""
        pushes = np.asarray(force, dtype=float)
        count = self._beyond.shape[1]
        if pushes.shape == (2,) and count == 1:
            pushes = pushes[None]
        if pushes.shape != (count, 2):
            raise MechanicsError(f"{count} places need forces of shape ({count}, 2), got {pushes.shape}")
        # One sum of squares says in a moment that all is finite; only where it does not, each number is looked at.
        if not math.isfinite(np.vdot(pushes, pushes) + moment) and not np.isfinite([*pushes.flat, moment]).all():
            raise MechanicsError(f"forces must be finite numbers, got {pushes.tolist()} N and {moment} N m")
        if moment != 0.0 and not self._has_moment:
            raise MechanicsError("a moment needs a place: give moment_at when the beam is made")
        return pushes

    def _set_load(self, pushes: Array, moment: float) -> None:
        np.dot(self._pull, pushes, out=self._load)
        np.negative(self._load[:, 1], out=self._load[:, 1])
        self._load += self._weight_pull
        np.copyto(self._constant, self._rest)
        if moment != 0.0:
            self._constant += moment * self._problem.weights * self._moment_beyond

    def _newton(self) -> int:
        """From the last shape to balance; the iterations, or 0 where it strays."""
        np.copyto(self._before, self._alpha)
        self._balance()
        dpotrs(self._tangent, self._out_column, lower=1, overwrite_b=1)
        moved = self._move()
        for iteration in range(1, _MOST + 1):
            np.cos(self._alpha, out=self._cos)
            np.sin(self._alpha, out=self._sin)
            self._balance()
            self._assemble()
            _, _, info = dposv(self._tangent, self._out_column, lower=1, overwrite_a=1, overwrite_b=1)
            if info != 0:
                return 0
            step = self._move()
            moved += step
            # The sum of root-sum-squares bounds the largest turn from above; that itself is only taken when in doubt.
            if not moved < _TRUST and not np.abs(self._alpha - self._before).max() < _TRUST:
                return 0
            if step < _TOLERANCE:
                return iteration
        return 0

    def _balance(self) -> None:
        """g, into `_out`; and z for the tangent."""
        np.multiply(self._load_complex, self._u_complex, out=self._z)
        np.dot(self._across, self._b, out=self._out)
        np.multiply(self._stiff, self._q, out=self._turn)
        self._turn -= self._constant
        self._out += self._turn

    def _assemble(self) -> None:
        """T, into `_tangent`. It is symmetric: the transposed product fills the column-major array in place."""
        np.multiply(self._along, self._b, out=self._scaled)
        np.dot(self._b.T, self._scaled, out=self._tangent.T)
        self._diagonal += self._stiff

    def _move(self) -> float:
        """Apply the update `-_out`; its turn, root-sum-square over the nodes (NaN stays NaN)."""
        self._q -= self._out
        turn = self._turn
        np.dot(self._b, self._out, out=turn)
        self._alpha -= turn
        return math.sqrt(np.dot(turn, turn))

    def _from_rest(self, pushes: Array, moment: float) -> int:
        """The shape on the branch that grows from rest; the iterations."""
        self._lost = True
        problem = self._problem
        total = problem.dead_force[0] + self._beyond @ pushes
        loaded = replace(problem, dead_force=total[None], moment=(moment * self._moment_beyond)[None])
        found = follow(loaded)
        if not found.converged[0]:
            raise MechanicsError(
                f"the equilibrium that grows from rest ends at {found.load_factor[0]:.1%} of the load; beyond it the "
                "beam snaps through. Give a smaller load"
            )
        np.copyto(self._q, found.q[0])
        np.copyto(self._alpha, found.alpha[0])
        np.cos(self._alpha, out=self._cos)
        np.sin(self._alpha, out=self._sin)
        self._balance()
        self._assemble()
        _, info = dpotrf(self._tangent, lower=1, overwrite_a=1)
        if info != 0 or not found.stable[0]:
            raise MechanicsError(
                f"the equilibrium that grows from rest is unstable: the beam buckles at {found.buckled_at[0]:.1%} of "
                "the load, to either side. Give a load that leans to one side, or a smaller one"
            )
        self._lost = False
        return found.iterations
