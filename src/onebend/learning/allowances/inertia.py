"""The beam's own inertia in a push that is not slow: its mass times the accelerations that the tags show.

Where the mass is stated, the force is known; where it is not, the mass is one more unknown.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.profiles.stiffness import Profile, Uniform
from onebend.beam.statics.problem import Problem
from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.course import with_rest
from onebend.records import Array, BoolArray, Observations, PointMass

_WINDOW, _DEGREE = 7, 3  # frames and degree of the polynomial whose curvature is the acceleration
MASS_SD = 25.0  # kg/m^3, of the length cubed: a solid rubber beam, 0.08 by 0.2 of its length thick and wide, has 18


def unknown_mass(observations: Observations, frames: BoolArray, problem: Problem, count: int) -> Allowance | None:
    """The mass [kg] of a beam whose mass nobody states, evenly spread; None where it is stated, or nothing tells."""
    if observations.static or np.isfinite(observations.stated.mass):
        return None
    force = inertial_force(observations, frames, problem, Uniform(1.0 / observations.length), count)
    if not np.any(force):
        return None
    sd = np.array([MASS_SD * observations.length**3])
    return Allowance("inertia", "load", "kg", ("mass in motion",), sd, force[..., None], shared=True)


def inertial_force(
    observations: Observations,
    frames: BoolArray,
    problem: Problem,
    mass_per_length: Profile,
    count: int,
    masses: Sequence[PointMass] = (),
) -> Array:
    """(count, Q, 2) N beyond each node: `-L int_s^1 mu a ds`, and -m a of the `masses` there; zero at rest, and where
    the motion is not known.

    Between clamp and tags the acceleration a is linear in s, beyond the last tag as there.
    """
    nodes = problem.grid.nodes
    still = np.zeros((count, nodes.shape[-1], 2))
    acceleration = tag_accelerations(observations)
    if acceleration is None:
        return still
    places = np.append(0.0, observations.marker_s)
    of_tags = np.concatenate([np.zeros((int(np.sum(frames)), 1, 2)), acceleration[frames]], axis=1)
    at_nodes = np.broadcast_to(nodes, (len(still), nodes.shape[-1]))[: len(of_tags)]
    along = np.stack(
        [[np.interp(s, places, a[:, c]) for s, a in zip(at_nodes, of_tags, strict=True)] for c in range(2)], axis=-1
    )
    line = with_rest(-float(problem.length) * along, count) * np.asarray(mass_per_length(nodes))[..., None]
    beyond = [
        np.sum(problem.weights * line[..., c], axis=-1, keepdims=True) - apply(problem.to_nodes, line[..., c])
        for c in range(2)
    ]
    riding = np.zeros_like(still)
    for one in masses:
        there = np.stack([[np.interp(one.s, places, a[:, c]) for a in of_tags] for c in range(2)], axis=-1)
        riding -= with_rest(one.mass * there, count)[:, None, :] * (nodes < one.s)[..., None]
    return np.stack(beyond, axis=-1) + riding


def tag_accelerations(observations: Observations) -> Array | None:
    """(T, m, 2) m/s^2 by polynomials over a few frames; None for films that are too short, or of uneven frames."""
    if observations.means is not None:
        return observations.means.acceleration
    return second_derivative(observations.time, observations.xy)


def second_derivative(time: Array, values: Array) -> Array | None:
    """(T, ...) of values (T, ...) with `time` (T,), as in `tag_accelerations`; NaN counts as not measured."""
    if len(time) < 2 * _WINDOW:
        return None
    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    if len(even) > 2 * len(time):
        return None
    flat = values.reshape(len(time), -1)
    known = [np.isfinite(column) for column in flat.T]
    if any(np.sum(k) < _WINDOW for k in known):
        return None
    filled = np.stack([np.interp(even, time[k], c[k]) for k, c in zip(known, flat.T, strict=True)], axis=1)
    powers = np.vander((np.arange(_WINDOW) - _WINDOW // 2) * step, _DEGREE + 1, increasing=True)
    weights = 2.0 * np.linalg.pinv(powers)[2]  # of the best polynomial, in the middle (Savitzky, Golay)
    second = np.stack([np.convolve(np.pad(c, _WINDOW // 2, mode="edge"), weights[::-1], "valid") for c in filled.T], 1)
    back = np.stack([np.interp(time, even, c) for c in second.T], axis=1)
    return np.asarray(back.reshape(values.shape))
