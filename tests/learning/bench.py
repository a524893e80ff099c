"""Observations made from a known beam: exact statics, or modes where in-family data are wanted."""

from __future__ import annotations

import numpy as np

from onebend.beam.grid import Modes, angles, places, positions
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import make_problem
from onebend.beam.stiffness import Gaussians, equidistant
from onebend.learning.optimizer import FitSettings
from onebend.learning.parameters import Spline
from onebend.records import Array, Observations, Source, Stated
from tests.beam.modal import modal_equilibrium

MARKERS = np.array([1.0 / 3.0, 2.0 / 3.0, 1.0])
SOFT = Beam(0.15, Gaussians(equidistant(3), 0.5, (0.02, 0.03, 0.015)))

IDEAL = FitSettings(allowances=frozenset())  # an ideal beam on an ideal bench, which is what `observed` makes


def forces(count: int = 80, most: float = 0.35) -> Array:
    """A push that grows and turns, and comes back: (T, 2) N."""
    phase = np.linspace(0.0, np.pi, count + 2)[1:-1]
    size = most * np.sin(phase) ** 2
    turn = 1.2 + 0.5 * np.sin(2.0 * phase)
    return np.stack([size * np.cos(turn), size * np.sin(turn)], axis=1)


def observed(
    beam: Beam,
    force: Array,
    *,
    at_s: float = 1.0,
    xy: Array | None = None,
    angle: Array | None = None,
    noise: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
) -> Observations:
    """What a perfect recording of `beam` under `force` says, plus white noise (m, rad) on the tags."""
    if xy is None or angle is None:
        shape = beam.equilibrium(force, at_s)
        xy, angle = shape.xy(MARKERS), shape.angle(MARKERS)
    rng = np.random.default_rng(seed)
    xy = xy + noise[0] * rng.normal(size=xy.shape)
    angle = angle + noise[1] * rng.normal(size=angle.shape)
    rest = beam.equilibrium((0.0, 0.0))
    count = len(force)
    sd = np.array([max(noise[0], 1e-5), max(noise[0], 1e-5), max(noise[1], 1e-4)])
    return Observations(
        source=Source(name="made", place_seen=True),  # no fit asks for other places of the push
        stated=Stated(
            rest="straight",
            mass=np.nan,
            placement_sd=5e-4,
            place_sd=5e-4,
        ),
        length=beam.length,
        time=np.arange(count) / 30.0,
        frame=np.arange(count),
        tag_id=np.array([1, 2, 3]),
        marker_s=MARKERS,
        xy=xy,
        angle=angle,
        covariance=np.tile(np.diag(sd**2), (count, len(MARKERS), 1, 1)),
        force=force,
        force_sd=np.array([0.005, 0.005]),
        push_s=np.full(count, at_s),
        loaded=np.ones(count, dtype=bool),
        rest_xy=rest.xy(MARKERS),
        rest_angle=rest.angle(MARKERS),
        rest_covariance=np.tile(np.diag(sd**2), (len(MARKERS), 1, 1)) / 30.0,
        gravity=np.zeros((count, 2)),
    )


def in_family(beam: Beam, force: Array, n: int) -> Observations:
    """Markers of the equilibrium within n modes: data that the paper's regression can explain exactly."""
    theta = modal_equilibrium(make_problem(beam, push(force)), Modes(n))
    at = places(beam.length, Modes(n), MARKERS)
    return observed(beam, force, xy=positions(at, theta), angle=angles(at, theta))


def prior_precision(spline: Spline, tau: float, rho: float) -> Array:
    """(count, count) of the coefficients' prior: a smooth part of roughness tau plus steps of size rho."""
    return np.asarray(np.linalg.inv((spline.parts * spline.variances(tau, rho)) @ spline.parts.T))
