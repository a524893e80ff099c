"""Rest under steady loads, and small vibrations about an equilibrium.

Near an equilibrium `B x'' + T x = 0` with the exact tangent T and the mass matrix B, so `T x = omega^2 B x`. With the
curvature at Gauss nodes as coordinates the frequencies converge spectrally for any k(s).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh

from onebend.beam.dynamics import Actions, Body, acting, body, mass_matrix
from onebend.beam.integration import MotionState
from onebend.beam.problem import Resolution, Rod, refuse_section
from onebend.beam.statics import Equilibrium, tangent
from onebend.beam.stiffness import Profile, Uniform
from onebend.errors import MechanicsError
from onebend.progress import one_blas_thread
from onebend.records import Array, PointMass


@dataclass(frozen=True)
class Vibration:
    """Small vibrations about an equilibrium, slowest first."""

    body: Body
    theta: Array  # (n,) rad
    squared: Array  # (m,) (rad/s)^2; negative if unstable
    shapes: Array  # (n, m) kg^-1/2 m^-1, scaled to x^T B x = 1

    @property
    def frequency(self) -> Array:
        """(m,) Hz; NaN if unstable."""
        with np.errstate(invalid="ignore"):
            return np.sqrt(self.squared) / (2.0 * np.pi)

    def moved(self, s: ArrayLike) -> Array:
        """(m, S, 2) 1 / sqrt(kg): motion of `s` (S,) per unit of each mode."""
        places = np.atleast_1d(np.asarray(s, dtype=float))
        alpha = self.body.rest_angle + self.body.to_angle @ self.theta
        turning = (self.body.to_angle @ self.shapes).T
        rows = self.body.length * self.body.grid.integral_to(places)
        return np.stack([(-np.sin(alpha) * turning) @ rows.T, (np.cos(alpha) * turning) @ rows.T], axis=-1)


def settle(on: Body, actions: Actions = Actions(), time: float = 0.0, *, load_steps: int = 20) -> MotionState:
    """Equilibrium (8) under the actions at `time`, in equal load steps.

    Raises `MechanicsError`: no equilibrium, or an unstable one.
    """
    pull = acting(on, actions, np.array([time]))[:, :, 0]
    theta = np.zeros(on.n)
    for factor in np.linspace(0.0, 1.0, load_steps + 1)[1:]:
        for _ in range(30):
            alpha = on.rest_angle + on.to_angle @ theta
            across = np.cos(alpha) * pull[1] - np.sin(alpha) * pull[0]
            gradient = on.stiffness @ theta - factor * across @ on.to_angle
            update = np.linalg.solve(_tangent(on, alpha, factor * pull), gradient)
            theta = theta - update
            if np.max(np.abs(update)) < 1e-12 * (1.0 + np.max(np.abs(theta))):
                break
        else:
            raise MechanicsError(f"no equilibrium within {on.n} coordinates at {factor:.0%} of the load")
    if not np.linalg.eigvalsh(_tangent(on, on.rest_angle + on.to_angle @ theta, pull))[0] > 0.0:
        raise MechanicsError("the equilibrium under these actions is not stable: a beam at rest there would not stay")
    return MotionState(theta, np.zeros(on.n), time)


def vibration_of(on: Body, state: MotionState, actions: Actions = Actions(), *, count: int = 6) -> Vibration:
    """The `count` slowest vibrations of a body about `state` under steady actions.

    Raises `MechanicsError`: the state is not an equilibrium.
    """
    pull = acting(on, actions, np.array([state.time]))[:, :, 0]
    alpha = on.rest_angle + on.to_angle @ state.theta
    across = np.cos(alpha) * pull[1] - np.sin(alpha) * pull[0]
    terms = on.stiffness @ state.theta, across @ on.to_angle
    residual = np.max(np.abs(terms[0] - terms[1]))
    if residual > 1e-6 * np.max(np.abs(terms)):
        raise MechanicsError(f"vibrations are about an equilibrium, but {residual:.3g} N m are left unbalanced here")
    squared, shapes = _modes(_tangent(on, alpha, pull), mass_matrix(on, state.theta), count)
    return Vibration(on, state.theta, squared, shapes)


def vibration(
    beam: Rod, solved: Equilibrium, *, frame: int = 0, rotary_inertia: Profile = Uniform(0.0), count: int = 6
) -> Vibration:
    """The `count` slowest vibrations about an equilibrium of the statics with a free end.

    `frame` picks one of the batch. `rotary_inertia`: iota(s) = rho I, kg m; None: Euler-Bernoulli.

    Raises `MechanicsError`: no equilibrium of this frame, another beam, no mass, or a thickness.
    """
    if not solved.converged[frame]:
        raise MechanicsError(f"load {frame} has no equilibrium to vibrate about")
    refuse_section(beam, "the equation of motion")
    problem = solved.problem.take(np.array([frame]))
    grid = problem.grid if problem.grid.edges.ndim == 1 else replace(problem.grid, edges=problem.grid.edges[0])
    on = body(beam, rotary_inertia=rotary_inertia, grid=grid)
    if not (np.allclose(problem.k, beam.stiffness(grid.nodes)) and np.allclose(problem.length, beam.length)):
        raise MechanicsError(f"the equilibrium of load {frame} is not one of this beam")
    theta, stiff = solved.q[frame] - on.rest_curvature, tangent(problem, solved.q[frame : frame + 1])[0]
    squared, shapes = _modes(stiff, mass_matrix(on, theta), count)
    return Vibration(on, theta, squared, shapes)


def _tangent(on: Body, alpha: Array, pull: Array) -> Array:
    """(n, n) N m at node angles (Q,) under dead loads (2, Q)."""
    along = np.cos(alpha) * pull[0] + np.sin(alpha) * pull[1]
    return np.asarray(on.stiffness + on.to_angle.T @ (along[:, None] * on.to_angle))


def _modes(stiff: Array, mass: Array, count: int) -> tuple[Array, Array]:
    """omega^2 rising and shapes, from `mass x = (stiff + shift mass) x / (omega^2 + shift)`.

    The nearly singular mass matrix stands on the left, so the slow modes have full relative precision. The shift makes
    the right side positive.
    """
    shift, scale = 0.0, float(np.max(np.diag(stiff)) / np.max(np.diag(mass)))
    for i in range(40):
        right = stiff + shift * mass
        if np.linalg.eigvalsh(right)[0] > 1e-13 * np.max(np.diag(right)):
            inverse, shapes = eigh(mass, right)
            order = np.argsort(inverse)[::-1][: min(count, len(inverse))]
            inverse, shapes = inverse[order], shapes[:, order]
            if np.any(inverse <= 0.0):
                raise MechanicsError("some modes carry no mass: ask for fewer modes, or refine the grid")
            return 1.0 / inverse - shift, shapes / np.sqrt(inverse)
        shift = scale * 2.0 ** (i - 10)
    raise MechanicsError("the tangent at this equilibrium has no finite frequencies")


# Natural frequencies of a clamped beam about its equilibrium under gravity, and their derivatives. Weight is an axial
# force, and makes the beam sag. With `T v = omega^2 B v`, to first order (Rayleigh)
#
#     d omega^2 = v' (dT - omega^2 dB) v,     v' B v = 1.
#
# T and B also change with the shape at rest, whose change follows from the balance.

_RESOLUTION = Resolution(order=12, widest=0.25)
_MOST = 12  # modes resolved to 1e-5


@dataclass(frozen=True)
class FrequencySlopes:
    """Derivatives of log frequencies of M modes at the beam's Q nodes."""

    log_k: Array  # (M, Q)
    mass_per_length: Array  # (M, Q) m/kg
    rest_curvature: Array  # (M, Q) 1/rad
    log_length: Array  # (M,), k [N m] and masses [kg] fixed


@one_blas_thread
def natural_frequencies(
    beam: Rod, *, gravity: ArrayLike = (0.0, 0.0), points: Sequence[PointMass] = (), count: int = 3
) -> Array:
    """(count,) Hz, small and undamped, slowest first; the far end is free.

    Args:
        gravity: (2,) m/s^2 in the beam's frame: (9.81, 0) hangs, (-9.81, 0) stands, (0, -9.81) lies, (0, 0) swings
            across gravity.
        points: masses on the beam.

    Raises `MechanicsError`: no mass, a thickness, buckling under gravity, a `count` out of range, a point mass off the
    beam.
    """
    if not 1 <= count <= _MOST:
        raise MechanicsError(f"frequencies of 1 to {_MOST} modes can be had, not of {count}")
    on = body(beam, resolution=_RESOLUTION, points=points)
    actions = Actions(gravity=gravity)
    return vibration_of(
        on, settle(on, actions, load_steps=20 if np.any(np.asarray(gravity)) else 1), actions, count=count
    ).frequency


def frequency_slopes(found: Vibration, gravity: Array, modes: Sequence[int]) -> FrequencySlopes:
    """For some modes (by index) of a body in nodal curvatures, found under `gravity` (2,) m/s^2."""
    on, weights = found.body, found.body.grid.weights
    rows, length = on.to_angle, on.length
    alpha = on.rest_angle + rows @ found.theta
    cos, sin = np.cos(alpha), np.sin(alpha)
    along, across = cos * gravity[0] + sin * gravity[1], cos * gravity[1] - sin * gravity[0]
    stiff = on.stiffness + rows.T @ ((on.lever * along)[:, None] * rows)
    out = []
    for i in modes:
        squared, v = float(found.squared[i]), found.shapes[:, i]
        u = rows @ v
        carried_x, carried_y = on.carried @ (u * sin), on.carried @ (u * cos)
        by_angle = u**2 * on.lever * across + 2.0 * squared * u * (sin * carried_y - cos * carried_x)
        y = np.linalg.solve(stiff, rows.T @ by_angle)
        turned, strain = rows @ y, np.diag(on.stiffness)
        by_lever = u**2 * along + turned * across  # (Q,) of the pull beyond each node
        moved = length**2 * ((rows @ (sin * u)) ** 2 + (rows @ (cos * u)) ** 2)
        slopes = (
            strain * (v**2 - y * found.theta),
            length * weights * (length * rows @ by_lever - squared * moved),
            rows.T @ (by_angle - on.lever * along * turned),
            np.array(on.lever @ by_lever - 2.0 * squared),
        )
        out.append([0.5 * slope / squared for slope in slopes])
    return FrequencySlopes(*(np.stack(column) for column in zip(*out, strict=True)))


def shear_share(found: Vibration, compliance: Array, modes: Sequence[int]) -> Array:
    """(M,) first-order effect of shear: `squared / (1 + share)`.

    Energy of shear `1/2 int Q^2 / kGA` under the mode's inertia over `1/2 omega^2`, with `v' B v = 1`. `compliance`
    (Q,) 1/N: 1/kGA at the nodes.
    """
    on = found.body
    alpha = on.rest_angle + on.to_angle @ found.theta
    cos, sin = np.cos(alpha), np.sin(alpha)
    out = []
    for i in modes:
        squared, u = float(found.squared[i]), on.to_angle @ found.shapes[:, i]
        # (Q,) times L w: inertial forces beyond each node, x and y
        x, y = squared * (on.carried @ (-sin * u)), squared * (on.carried @ (cos * u))
        shear = (cos * y - sin * x) / (on.length * on.grid.weights)
        out.append(on.length * float(on.grid.weights @ (compliance * shear**2)) / squared)
    return np.array(out)
