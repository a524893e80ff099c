"""How far a reached point may be off, from the band on k(s): to first order in log k, through the exact equilibrium."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from onebend.beam.sensitivity import of_stiffness, respond
from onebend.beam.uncertain import UncertainStiffness
from onebend.control.reach import Reach
from onebend.errors import ControlError
from onebend.records import Array


@dataclass(frozen=True)
class Ellipse:
    """Where a point lies with some probability."""

    semi_axes: Array  # (2,) m, the longer first
    angle: float  # rad, of the longer

    def outline(self, count: int = 97) -> Array:
        """(count, 2) m around the centre."""
        turn = np.linspace(0.0, 2.0 * np.pi, count)
        x, y = self.semi_axes[0] * np.cos(turn), self.semi_axes[1] * np.sin(turn)
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


@dataclass(frozen=True)
class PredictedError:
    """The reached point as a normal variable."""

    point: Array  # (2,) m, the most probable place
    covariance: Array  # (2, 2) m^2

    def ellipse(self, level: float = 0.95) -> Ellipse:
        """The ellipse around `point` that holds the real one with probability `level`."""
        values, vectors = np.linalg.eigh(self.covariance)
        size = np.sqrt(np.maximum(values[::-1], 0.0) * chi2.ppf(level, 2))
        return Ellipse(size, math.atan2(vectors[1, 1], vectors[0, 1]))

    def distance(self, xy: Array) -> Array:
        """(...) squared Mahalanobis distance of places (..., 2): chi-square with 2 degrees of freedom."""
        away = np.asarray(xy, dtype=float) - self.point
        return np.asarray(np.einsum("...i,ij,...j->...", away, np.linalg.pinv(self.covariance), away))

    def holds(self, xy: Array, level: float = 0.95) -> bool:
        """Whether a place lies in the ellipse of `level`."""
        return bool(self.distance(xy) <= chi2.ppf(level, 2))


def predicted_error(
    uncertain: UncertainStiffness, found: Reach, *, same_sensor: bool = False, s: float | None = None
) -> PredictedError:
    """How sure the place of the point (or of another, `s`) is under the force that was found.

    Args:
        uncertain: the beam's k(s) with its band.
        found: the beam must have the most probable k(s) of `uncertain`.
        same_sensor: the force is given by the sensor that the beam was learned with. Then its scale error, which
            makes all of k wrong alike, makes the force wrong as much, and cancels.
        s: the point looked at; default: the one that was led to the goal.

    Raises:
        ControlError: the beam's k(s) is another, or the shape is a limit point (the error has no bound).
    """
    nodes = found.solved.problem.grid.nodes
    k = np.asarray(found.beam.stiffness(nodes))
    if not np.allclose(uncertain.profile(nodes), k, rtol=1e-6):
        raise ControlError("the band is not that of this beam's k(s): give the beam and the band of one model")
    functions = k[:, None] * np.column_stack([uncertain.basis(nodes), np.ones(len(nodes))])
    place = np.array([found.point_s if s is None else s])
    moved = respond(found.solved, of_stiffness(found.solved, functions)).xy(place)[0, 0]  # (2, p + 1)
    if not np.all(np.isfinite(moved)):
        raise ControlError("the shape is at a limit point, where the smallest error of k(s) is too much")
    covariance = moved[:, :-1] @ uncertain.covariance @ moved[:, :-1].T
    if not same_sensor:
        covariance = covariance + uncertain.gain_sd**2 * np.outer(moved[:, -1], moved[:, -1])
    return PredictedError(found.solved.xy(place)[0, 0], covariance)
