"""Where the search for a frame's force begins: the force that balances the curvature that the tags show best.

Inverse kinematics (22) gives a shape of few modes. Under one force F at `s_a` it would have `k (q - q0) = (r(s_a) -
r(s)) x F` below `s_a`, which is linear in F: least squares of the curvature over places, with the force's prior. So it
is with a second force, and with a moment.
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


def first_forces(bench: Bench, frames: IntArray, place: Array, prior_sd: Array) -> Array:
    """(F, n) loads in `frames` (F,) at `place` (F,) or (F, 2) of s; `prior_sd` (n,) of each number."""
    beam, every = bench.beam, bench.observations
    o = at_frames(every, np.isin(np.arange(len(every.time)), frames))
    states = solve_states(o, min(_MODES, 2 * len(o.marker_s)))
    theta = np.nan_to_num(states.theta)
    out = np.zeros((len(frames), len(prior_sd)))
    place = bench.placed(place).reshape(len(frames), -1)
    for at in np.unique(place, axis=0):
        rows = np.flatnonzero(np.all(place == at, axis=1))
        s = np.max(at) * _NODES
        on = places(o.length, Modes(theta.shape[1]), np.concatenate([s, at]))
        xy = positions(on, theta[rows])
        bent = on.modes.curvature(s) @ theta[rows].T - np.asarray(beam.rest_curvature(s))[:, None]
        by = np.zeros((len(rows), len(s), len(prior_sd)))
        for which, one in enumerate(at):
            lever = np.where((s < one)[:, None], xy[:, len(s) + which, None] - xy[:, : len(s)], 0.0)
            by[..., 2 * which], by[..., 2 * which + 1] = -lever[..., 1], lever[..., 0]
        if len(prior_sd) % 2:
            by[..., -1] = 1.0
        weight = np.sqrt(theta.shape[1] / len(s)) / _CURVATURE_SD
        by = weight * prior_sd * by / np.asarray(beam.stiffness(s))[:, None]
        right = np.einsum("fsi,sf->fi", by, weight * bent)
        normal = np.einsum("fsi,fsj->fij", by, by) + np.eye(len(prior_sd))
        out[rows] = prior_sd * np.linalg.solve(normal, right[..., None])[..., 0]
    return out
