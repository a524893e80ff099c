"""A slender beam as a chain of rigid bars with springs between: frequencies by a theory and a discretisation of their
own. Coordinates are the bars' angles; energy and equilibrium come from places and angles, nothing from curvature."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import eigh

from onebend.beam.model import Beam
from onebend.records import Array


def swinging_frequencies(
    beam: Beam, gravity: Array, bars: int, points: Sequence[tuple[float, float]] = (), count: int = 3
) -> Array:
    """(count,) Hz of small vibrations about rest. `points`: mass [kg] and place of each.

    The bars' masses sit at their middles and turn with the rod's inertia; the spring between two bars is `k / h`, the
    first between the clamp and the middle of the first bar (half a bar long). The error falls with `bars`^-2.
    """
    h = 1.0 / bars
    joint: Array = h * np.arange(bars, dtype=float)
    middle: Array = joint + 0.5 * h
    around: Array = np.maximum(joint + 0.25 * h * np.array([[-1.0], [1.0]]), 0.0)
    spring = 1.0 / (h * np.mean(1.0 / beam.stiffness(around), axis=0))
    spring[0] = 2.0 * float(beam.stiffness(np.array([0.25 * h]))[0]) / h
    rest = beam.rest_curvature(joint) * h
    rest[0] = float(beam.rest_curvature(np.array([0.25 * h]))[0]) * 0.5 * h
    to_joint = np.eye(bars) - np.eye(bars, k=-1)  # turns at the joints from angles of the bars
    stiff = to_joint.T @ (spring[:, None] * to_joint)
    at = np.concatenate([middle, [s for _, s in points]])
    mass = np.concatenate([beam.mass_per_length(middle) * beam.length * h, [m for m, _ in points]])
    arm = beam.length * np.clip(at[:, None] - joint, 0.0, h)  # (masses, bars): how far each mass lies along each bar
    pull = mass @ arm  # (bars,) kg m
    angle = np.full(bars, beam.clamp_angle) + np.cumsum(rest)
    for factor in np.linspace(0.0, 1.0, 11):
        for _ in range(8):
            cos, sin = np.cos(angle), np.sin(angle)
            turns = to_joint @ angle - rest
            turns[0] -= beam.clamp_angle
            gradient = to_joint.T @ (spring * turns) - factor * pull * (gravity[1] * cos - gravity[0] * sin)
            tangent = stiff + np.diag(factor * pull * (gravity[0] * cos + gravity[1] * sin))
            angle = angle - np.linalg.solve(tangent, gradient)
    own = beam.mass_per_length(middle) * beam.length * h * (beam.length * h) ** 2 / 12.0
    moved = np.concatenate([-arm * np.sin(angle), arm * np.cos(angle)])
    inertia = moved.T @ (np.tile(mass, 2)[:, None] * moved) + np.diag(own)
    return np.asarray(np.sqrt(eigh(tangent, inertia, eigvals_only=True)[:count]) / (2.0 * np.pi))
