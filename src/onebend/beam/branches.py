"""The stable equilibria of a beam with a free end under dead loads.

A soft beam under a load has one or two of them as a rule: it may hang to the left or to the right. They are found by
letting evenly bent shapes fall, to both sides and more than half around.
"""

from __future__ import annotations

import numpy as np

from onebend.beam.continuation import let_fall
from onebend.beam.problem import Problem
from onebend.beam.statics import node_angles
from onebend.records import Array, IntArray

_STARTS = np.array([-6.0, -3.0, -1.0, 1.0, 3.0, 6.0])  # rad, turn of the free end of the shapes that fall
_SAME = 1e-6  # rad, distance below which equilibria are one


def stable_equilibria(problem: Problem) -> tuple[Array, IntArray]:
    """Curvatures (E, Q) [rad] of the stable equilibria under dead loads, and their frames (E,), ordered by the angle of
    the free end."""
    every = np.repeat(np.arange(problem.size), len(_STARTS))
    bent = np.tile(_STARTS, problem.size)[:, None] + np.broadcast_to(problem.q0, problem.dead_force.shape[:2])[every]
    q, landed = let_fall(problem.take(every), bent)
    q, frame = q[landed], every[landed]
    alpha = node_angles(problem.take(frame), q)
    order = np.lexsort((alpha[:, -1], frame))
    q, frame, alpha = q[order], frame[order], alpha[order]
    same = (np.diff(frame) == 0) & (np.max(np.abs(np.diff(alpha, axis=0)), axis=-1, initial=0.0) < _SAME)
    new = np.append(np.ones(min(len(frame), 1), dtype=bool), ~same)
    return q[new], frame[new]
