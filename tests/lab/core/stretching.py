"""A beam that also stretches, which the inextensible model cannot represent; independent of `beam.statics`.

With an axial strain `e = F . u / (E A)`: `r' = L (1 + e) u`, `M' = -L (1 + e) (cos alpha F_y - sin alpha F_x)`,
`alpha' = q0 + M / k` from clamp to force, M = 0 there (Reissner's beam without shear). Runge-Kutta from the clamp;
Newton's method for the moment there.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.statics import Equilibrium
from onebend.errors import MechanicsError
from onebend.records import Array

STEPS = 200
MOST_NEWTON_STEPS = 30
LARGEST_RESIDUAL = 10.0  # of the largest moment: allowed residual at the force


def stretched(
    beam: Beam, force: Array, at_s: float, s: Array, axial_stiffness: float, start: Equilibrium
) -> tuple[Array, Array]:
    """(T, S, 2) m and (T, S) rad at `s` (S,), from the unstretched shapes `start`. Raises `MechanicsError`: no shape,
    as the axial stiffness is too small for the force."""
    edges = np.unique(np.concatenate([np.linspace(0.0, 1.0, STEPS + 1), [at_s], beam.stiffness.jumps, s]))
    tip = start.xy(np.array([at_s]))[:, 0]
    moment = tip[:, 0] * force[:, 1] - tip[:, 1] * force[:, 0]
    scale = max(float(np.max(np.abs(moment))), 1e-12)
    text = f"no shape of the beam with an axial stiffness of {axial_stiffness:g} N was found. Give a larger one"
    for _ in range(MOST_NEWTON_STEPS):
        residual = shoot(beam, force, at_s, edges, axial_stiffness, moment)[-1][:, 3]
        worst = float(np.max(np.abs(residual)))
        if worst < 1e-11 * scale:
            break
        if not worst < LARGEST_RESIDUAL * scale:
            raise MechanicsError(text)
        h = 1e-5 * scale
        more = shoot(beam, force, at_s, edges, axial_stiffness, moment + h)[-1][:, 3]
        moment = moment - residual * h / (more - residual)
    else:
        raise MechanicsError(text)
    path = np.stack(shoot(beam, force, at_s, edges, axial_stiffness, moment), axis=1)[:, np.searchsorted(edges, s)]
    return path[..., :2], path[..., 2]


def shoot(beam: Beam, force: Array, at_s: float, edges: Array, axial: float, moment: Array) -> list[Array]:
    """States (T, 4) x, y, alpha, M at every edge, for clamp moments (T,)."""
    count = len(force)
    state = np.stack([np.zeros(count), np.zeros(count), np.full(count, beam.clamp_angle), moment], axis=1)
    states = [state]
    for low, high in pairwise(edges.tolist()):
        h = high - low
        inside = np.array([low + 1e-9 * h, 0.5 * (low + high), high - 1e-9 * h])  # never on a jump
        k, q0 = np.asarray(beam.stiffness(inside)), np.asarray(beam.rest_curvature(inside))
        loaded = high <= at_s + 1e-12

        def rate(y: Array, i: int, loaded: bool = loaded, k: Array = k, q0: Array = q0) -> Array:
            cos, sin = np.cos(y[:, 2]), np.sin(y[:, 2])
            f = force if loaded else np.zeros_like(force)
            stretch = beam.length * (1.0 + (f[:, 0] * cos + f[:, 1] * sin) / axial)
            bend = q0[i] + y[:, 3] / k[i] if loaded else np.full(count, q0[i])
            turn = -stretch * (cos * f[:, 1] - sin * f[:, 0])
            return np.stack([stretch * cos, stretch * sin, bend, turn], axis=1)

        a = rate(state, 0)
        b = rate(state + 0.5 * h * a, 1)
        c = rate(state + 0.5 * h * b, 1)
        d = rate(state + h * c, 2)
        state = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        if abs(high - at_s) < 1e-12:
            end = state
        states.append(state)
    states[-1] = np.concatenate([states[-1][:, :3], end[:, 3:]], axis=1)
    return states
