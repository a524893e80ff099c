"""Where the search for a frame's force begins: the force that balances the curvature that the tags show best.

Inverse kinematics (22) gives a shape of few modes. Under one force F at `s_a` it would have `k (q - q0) = (r(s_a) -
r(s)) x F` below `s_a`, which is linear in F: least squares of the curvature over places, with the force's prior.
"""

from __future__ import annotations

import numpy as np

from onebend.beam.modal import Modes, places, positions
from onebend.learning.model.frames import at_frames
from onebend.learning.paper.inverse_kinematics import solve_states
from onebend.learning.sensing.bench import Bench
from onebend.records import Array, IntArray

_MODES = 4
_NODES = 0.05 + 0.9 * (np.arange(24) + 0.5) / 24  # of the way to the force
_CURVATURE_SD = 0.3  # rad, of such a shape's curvature


def first_forces(bench: Bench, frames: IntArray, place: Array, prior_sd: float) -> Array:
    """(F, 2) N in `frames` (F,) at `place` (F,) of s."""
    beam, every = bench.beam, bench.observations
    o = at_frames(every, np.isin(np.arange(len(every.time)), frames))
    states = solve_states(o, min(_MODES, 2 * len(o.marker_s)))
    theta = np.nan_to_num(states.theta)
    out = np.zeros((len(frames), 2))
    place = bench.placed(place)
    for at in np.unique(place):
        rows = np.flatnonzero(place == at)
        s = at * _NODES
        on = places(o.length, Modes(theta.shape[1]), np.append(s, at))
        xy = positions(on, theta[rows])
        lever = xy[:, -1:] - xy[:, :-1]
        bent = on.modes.curvature(s) @ theta[rows].T - np.asarray(beam.rest_curvature(s))[:, None]
        by = np.stack([-lever[..., 1], lever[..., 0]], axis=-1) / np.asarray(beam.stiffness(s))[:, None]
        weight = np.sqrt(theta.shape[1] / len(s)) / _CURVATURE_SD
        by = prior_sd * weight * by
        right = np.einsum("fsi,sf->fi", by, weight * bent)
        normal = np.einsum("fsi,fsj->fij", by, by) + np.eye(2)
        out[rows] = prior_sd * np.linalg.solve(normal, right[..., None])[..., 0]
    return out
