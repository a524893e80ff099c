"""Natural frequencies of a clamped beam about its static equilibrium under gravity, and their derivatives.

A beam that hangs, stands or lies swings at three frequencies: its weight is an axial force, which stiffens or softens
it, and makes it sag. Near rest the motion obeys `T v = omega^2 B v`, see `vibration.py`, so that to first order

    d omega^2 = v' (dT - omega^2 dB) v,     v' B v = 1

(Rayleigh). T and B also change with the shape at rest, whose change follows from the balance of moments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.motion.actions import Actions
from onebend.beam.motion.dynamics import body
from onebend.beam.motion.vibration import Vibration, settle, vibration_of
from onebend.beam.statics.problem import Resolution
from onebend.beam.statics.rod import Rod
from onebend.blas import one_blas_thread
from onebend.errors import MechanicsError
from onebend.records import Array, PointMass

_RESOLUTION = Resolution(order=12, widest=0.25)
_MOST = 12  # modes: more are not resolved to 1e-5


@dataclass(frozen=True)
class FrequencySlopes:
    """Derivatives of log frequencies of M modes with what the beam is, at its Q nodes."""

    log_k: Array  # (M, Q)
    mass_per_length: Array  # (M, Q) m/kg
    rest_curvature: Array  # (M, Q) 1/rad
    log_length: Array  # (M,), k [N m] and all masses [kg] staying as they are


@one_blas_thread
def natural_frequencies(
    beam: Rod, *, gravity: ArrayLike = (0.0, 0.0), points: Sequence[PointMass] = (), count: int = 3
) -> Array:
    """(count,) Hz, undamped and small, the slowest first, about the beam's rest under its weight; its far end is free.

    Args:
        beam: with a mass; it neither stretches nor shears, and its sections have no rotary inertia.
        gravity: (2,) m/s^2 in the beam's frame: (9.81, 0) hangs, (-9.81, 0) stands, (0, -9.81) lies, and (0, 0) swings
            across gravity (level, and so stiff that it does not sag).
        points: masses on the beam.

    Raises:
        MechanicsError: a beam without a mass, or with a thickness; one that gravity makes buckle; a `count` out of
            range, a point mass off the beam.
    """
    if not 1 <= count <= _MOST:
        raise MechanicsError(f"frequencies of 1 to {_MOST} modes can be had, not of {count}")
    on = body(beam, resolution=_RESOLUTION, points=points)
    actions = Actions(gravity=gravity)
    return vibration_of(on, settle(on, actions, load_steps=_steps(gravity)), actions, count=count).frequency


def frequency_slopes(found: Vibration, gravity: Array, modes: Sequence[int]) -> FrequencySlopes:
    """Derivatives for some modes (by index) of a body whose coordinates are the curvatures at its nodes.

    `gravity` (2,) m/s^2 is that under which it was found.
    """
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
        by_lever = u**2 * along + turned * across  # (Q,) of what pulls beyond each node
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
    """(M,) by which shear lowers the squares of frequencies, to first order: `squared / (1 + share)`.

    The largest energy of shear, `1/2 int Q^2 / kGA`, over that of bending and weight, `1/2 omega^2` of a mode scaled to
    `v' B v = 1`, with Q the shear force of the mode's own inertia. `compliance` (Q,) 1/N: 1/kGA at the nodes.
    """
    on = found.body
    alpha = on.rest_angle + on.to_angle @ found.theta
    cos, sin = np.cos(alpha), np.sin(alpha)
    out = []
    for i in modes:
        squared, u = float(found.squared[i]), on.to_angle @ found.shapes[:, i]
        # (Q,) of each node, times L w: the inertial forces of all that lies beyond it, along x and y
        x, y = squared * (on.carried @ (-sin * u)), squared * (on.carried @ (cos * u))
        shear = (cos * y - sin * x) / (on.length * on.grid.weights)
        out.append(on.length * float(on.grid.weights @ (compliance * shear**2)) / squared)
    return np.array(out)


def _steps(gravity: ArrayLike) -> int:
    return 20 if np.any(np.asarray(gravity)) else 1
