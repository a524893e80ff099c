"""Shared by the live learner's tests: plain settings, and recordings drawn from its own model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push, twist
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.stiffness import LogSpline
from onebend.learning.normal import JUMP, RHO, SPREAD, TAU
from onebend.learning.parameters import Spline
from onebend.live.hyperparameters import OnlineSettings
from onebend.live.learner import OnlineLearner, Update
from onebend.recording.beam_frame import MOUNTING_SD
from onebend.records import DIRECTION_SD, PLACE_SD, Array, Observations
from tests.learning.bench import MARKERS, SOFT, forces, observed, prior_precision
from tests.learning.test_posterior import wrong_force

S = np.linspace(0.05, 0.9, 60)
FINE = Resolution(order=12, widest=0.5)  # as the learner's own
NOISE = (2e-5, 1e-3)  # m, rad
IDEAL_LIVE = OnlineSettings(allowances=frozenset())  # an ideal beam on an ideal bench, which is what `observed` makes
PLAIN = replace(IDEAL_LIVE, functions=8, adapt=False, bulk=np.inf, gate=np.inf, marker_noise=1.0)
PLAIN = replace(PLAIN, force=replace(PLAIN.force, load=1e-9))


def tags_of(
    beam: Beam, logged: Array, farther: float, turned: float, along: Array, across: Array
) -> tuple[Array, Array]:
    """Tags (T, 3, 2) and the beam's angle under them: the log's axes turned, the push and the tags off their places."""
    axes = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
    force = logged @ axes.T
    shape = equilibrium(beam, push(force, 1.0), resolution=FINE)
    for _ in range(4):  # a force beyond the tip is one at the tip and its moment
        tip = shape.angle(np.ones(1))[:, 0]
        moment = farther * (np.cos(tip) * force[:, 1] - np.sin(tip) * force[:, 0])
        shape = equilibrium(beam, push(force, 1.0) + twist(moment, 1.0), resolution=FINE)
    places = MARKERS + along / beam.length
    s = np.minimum(places, 1.0)
    angle, over = shape.angle(s), beam.length * (places - s)
    ride = [np.cos(angle) * over - np.sin(angle) * across, np.sin(angle) * over + np.cos(angle) * across]
    return shape.xy(s) + np.stack(ride, axis=-1), angle


def smooth_beam(rng: np.random.Generator) -> Array:
    """(8,) coefficients of log k, of a known roughness; level and slope, of broad prior, are tamed."""
    spline = Spline(8)
    rough = np.linalg.cholesky(np.linalg.inv(prior_precision(spline, 3.0, 0.1))) @ rng.normal(size=8)
    places = np.array([np.mean(spline.knots[i + 1 : i + 4]) for i in range(8)])  # coefficients there: log k = s
    line = np.polynomial.Polynomial.fit(places, rough, 1)(places)
    return np.asarray(np.log(0.025) + rough - line + 0.3 * rng.normal())


def any_beam(rng: np.random.Generator) -> Array:
    """(8,) coefficients of log k, its sizes drawn from what the learner expects of them. Those that no push could bend
    without breaking off the search for their shape, of a factor of seven and more, are drawn again."""
    spline = Spline(8)
    while True:
        tau, rho = np.exp(np.log([TAU, RHO]) + SPREAD * rng.normal(size=2))
        variance = spline.variances(tau, rho)
        free = (rho * spline.share) ** 2 / rng.gamma(0.5, 2.0, size=len(spline.share))
        variance[8:], variance[:2] = free / (1.0 + free / JUMP**2), (0.3**2, 0.5**2)
        coefficients = spline.parts @ (np.sqrt(variance) * rng.normal(size=len(variance)))
        if np.ptp(coefficients) < 2.0:
            return np.asarray(np.log(0.025) + coefficients)


def drawn(log_k: Array, rng: np.random.Generator, count: int, sizes: tuple[float, float, float]) -> Observations:
    """A push of a beam with these coefficients (8,), its nuisances drawn as the learner expects them.

    `sizes`: N, s, N of the force's error: coloured, its correlation time, white.
    """
    coloured, memory, white = sizes
    spline = LogSpline(tuple(Spline(8).knots), tuple(log_k))
    beam, force = Beam(0.15, spline, clamp_angle=np.hypot(3e-3, MOUNTING_SD) * rng.normal()), forces(count)
    along, across, turn = 5e-4 * rng.normal(size=3), 5e-4 * rng.normal(size=3), np.deg2rad(1.5) * rng.normal(size=3)
    xy, angle = tags_of(beam, force, PLACE_SD * rng.normal(), DIRECTION_SD * rng.normal(), along, across)
    made = observed(beam, force, xy=xy, angle=angle, noise=NOISE, seed=int(rng.integers(1 << 30)))
    keep, error = np.exp(-1.0 / 30.0 / memory), np.zeros((count, 2))
    for t in range(count):
        fresh = coloured * rng.normal(size=2)
        error[t] = keep * error[t - 1] + np.sqrt(1.0 - keep**2) * fresh if t else fresh
    error += 0.05 * 0.35 * rng.normal(size=2) + white * rng.normal(size=(count, 2))
    return replace(
        made,
        xy=made.xy + 5e-4 * rng.normal(size=2),
        angle=made.angle + turn,
        force=force + error,
        force_sd=np.zeros(2),  # the settings say it
        rest_xy=np.full((3, 2), np.nan),
    )


def many_pushes(turns: int, each: int, noise: tuple[float, float] = NOISE, wrong: float = 0.004) -> Observations:
    """Push after push, with rests between them; `wrong`: N, sd of the log's wandering error."""
    made = observed(SOFT, np.tile(np.concatenate([np.zeros((5, 2)), forces(each)]), (turns, 1)), noise=noise, seed=1)
    seen = wrong_force(made, 1, wrong) if wrong else made
    return replace(seen, loaded=np.any(made.force != 0.0, axis=1))


def shown(learner: OnlineLearner, made: Observations, frames: range) -> list[Update]:
    """These frames, given to the learner."""
    return [
        learner.update(
            made.time[t], made.xy[t], made.angle[t], made.covariance[t], made.force[t], loaded=bool(made.loaded[t])
        )
        for t in frames
    ]


def learned(made: Observations, start: float, settings: OnlineSettings) -> OnlineLearner:
    """A learner that has seen all of it."""
    learner = OnlineLearner(made.length, MARKERS, start, settings=settings)
    shown(learner, made, range(len(made.time)))
    return learner
