"""A beam that hangs out of its plane of bending under its own weight."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid

from onebend.beam.model import Beam
from onebend.records import Array


def droop(beam: Beam, tip: float, s: Array, xy: Array, angle: Array) -> tuple[Array, Array]:
    """(T, S) m and (T, S) rad: heights of shapes xy (T, S, 2), angle (T, S) at `s` (S,), and slopes along the beam.

    The weight across the plane bends each piece by its moment about the piece's normal, z'' = -m / (E I across) with
    I across ~ k^(1/3), that of a bar of even depth; twist is left out. Scaled so that the tip of the straight beam
    hangs by `tip` [m].
    """
    if tip == 0.0:
        return np.zeros(angle.shape), np.zeros(angle.shape)
    mass = np.asarray(beam.mass_per_length(s))
    mass = mass if np.all(mass > 0.0) else np.ones(len(s))
    softness = 1.0 / np.cbrt(np.asarray(beam.stiffness(s)))
    straight = np.stack([beam.length * s, np.zeros(len(s))], axis=-1)[None]
    at_tip = heights(straight, np.zeros((1, len(s))), s, mass, softness)[0][0, -1]
    z, slope = heights(xy, angle, s, mass, softness)
    return tip / -at_tip * z, tip / -at_tip * slope / beam.length


def heights(xy: Array, angle: Array, s: Array, mass: Array, softness: Array) -> tuple[Array, Array]:
    """(T, S) height and its derivative with s, up to a factor that all shapes share."""

    def beyond(values: Array) -> Array:  # integral from s to the tip, along axis 1
        whole = cumulative_trapezoid(values, s, axis=1, initial=0.0)
        return np.asarray(whole[:, -1:] - whole)

    weight = np.broadcast_to(mass, angle.shape)
    arm = beyond(weight[..., None] * xy) - beyond(weight)[..., None] * xy
    moment = arm[..., 0] * np.cos(angle) + arm[..., 1] * np.sin(angle)
    slope = cumulative_trapezoid(-moment * softness, s, axis=1, initial=0.0)
    return cumulative_trapezoid(slope, s, axis=1, initial=0.0), slope
