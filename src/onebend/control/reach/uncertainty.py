"""The error of a reached point that follows from the band on k(s), through the exact equilibrium."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.beam.statics.continuation import refine
from onebend.beam.statics.problem import make_problems
from onebend.beam.statics.sensitivity import of_stiffness, respond
from onebend.blas import one_blas_thread
from onebend.control.reach.reach import Reach
from onebend.errors import ControlError
from onebend.records import Array

SURE = 0.95  # probability of the ellipse that is shown and written


def _squared_radius(level: float) -> float:
    """Squared Mahalanobis distance within which a plane normal variable lies with probability `level`."""
    return -2.0 * math.log1p(-level)


@dataclass(frozen=True)
class ErrorEllipse:
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

    point: Array  # (2,) m, under the most probable k(s)
    mean: Array  # (2,) m: bending is not linear in log k, so it lies a little beside
    covariance: Array  # (2, 2) m^2
    lost: float  # share of the drawn beams that have no stable shape nearby: they would snap away

    def ellipse(self, level: float = SURE) -> ErrorEllipse:
        """The ellipse around `mean` that holds the real point with probability `level`."""
        values, vectors = np.linalg.eigh(self.covariance)
        size = np.sqrt(np.maximum(values[::-1], 0.0) * _squared_radius(level))
        return ErrorEllipse(size, math.atan2(vectors[1, 1], vectors[0, 1]))

    def distance(self, xy: Array) -> Array:
        """(...) squared Mahalanobis distance of places (..., 2): chi-square with 2 degrees of freedom."""
        away = np.asarray(xy, dtype=float) - self.mean
        return np.asarray(np.einsum("...i,ij,...j->...", away, np.linalg.pinv(self.covariance), away))

    def holds(self, xy: Array, level: float = SURE) -> bool:
        """Whether a place lies in the ellipse of `level`."""
        return bool(self.distance(xy) <= _squared_radius(level))


@one_blas_thread
def predicted_error(
    beam: Beam,
    uncertain: UncertainStiffness,
    result: Reach,
    *,
    same_sensor: bool = False,
    draws: int = 400,
    seed: int = 0,
) -> PredictedError:
    """The uncertainty of the point's position under the load that was found.

    Args:
        beam: the beam that was led to the goal.
        uncertain: its k(s) with the band.
        same_sensor: the force is given by the sensor that the beam was learned with. Then its scale error, which
            makes all of k wrong alike, makes the force wrong as much, and cancels.
        draws: beams drawn from the band and put into equilibrium under the load; 0: to first order in log k, which
            takes a millisecond, and makes the ellipse too thin where it is long.
        seed: of the draws.

    Raises:
        ControlError: beam, band and result do not belong together; or so few of the beams within the band stand near
            the shape that nothing can be said.
    """
    s = np.linspace(0.0, 1.0, 41)
    if beam != result.beam or not np.allclose(uncertain.profile(s), beam.stiffness(s), rtol=1e-6):
        raise ControlError("the band is not that of the beam that was led: give beam, band and result of one model")
    known = replace(uncertain, gain_sd=0.0) if same_sensor else uncertain
    if draws == 0:
        return PredictedError(result.reached[:2], result.reached[:2], _first_order(known, result), 0.0)
    beams = [replace(beam, stiffness=profile) for profile in known.draw(draws, seed=seed)]
    problem = make_problems(beams, result.loads, result.resolution)
    solved = refine(problem, np.repeat(result.solved.q, draws, axis=0))
    stands = solved.converged & solved.stable
    if np.sum(stands) < max(3, draws // 2):
        raise ControlError(
            f"{np.sum(~stands)} of {draws} beams within the band do not stand under this load: its error has no bound. "
            "Learn the beam better, or take a goal with a smaller force"
        )
    places = solved.xy(np.array([result.point_s]))[stands, 0]
    return PredictedError(result.reached[:2], np.mean(places, axis=0), np.cov(places.T), float(np.mean(~stands)))


def _first_order(known: UncertainStiffness, result: Reach) -> Array:
    """(2, 2) m^2, by the derivatives of the equilibrium with log k."""
    nodes = result.solved.problem.grid.nodes
    basis = np.column_stack([known.basis(nodes), np.ones(len(nodes))])
    functions = np.asarray(result.beam.stiffness(nodes))[:, None] * basis
    moved = respond(result.solved, of_stiffness(result.solved, functions)).xy(np.array([result.point_s]))[0, 0]
    if not np.all(np.isfinite(moved)):
        raise ControlError("the shape is at a limit point, where the smallest error of k(s) is too much")
    common = known.gain_sd**2 * np.outer(moved[:, -1], moved[:, -1])
    return np.asarray(moved[:, :-1] @ known.covariance @ moved[:, :-1].T + common)
