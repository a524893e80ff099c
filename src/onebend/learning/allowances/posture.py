"""A robot's force estimate is off by what depends on where its arm stands: smooth in the place of the tool."""

from __future__ import annotations

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.course import PushCourse, with_rest
from onebend.records import Array

POSTURE_SD = 0.01  # of the largest force, for each term and axis; the linear term is a gain: no evidence tells its size
DEGREE = 2  # of the polynomial in the tool's displacement


def posture_bias(run: PushCourse, force: Array) -> Allowance:
    """A polynomial of second degree in the displacement, zero at rest, for each axis of the force (F, 2) [N]."""
    largest = float(np.max(np.linalg.norm(force, axis=1)))
    basis = on_each_axis(with_rest(powers(run.bend), len(force)))
    labels = tuple(f"posture bias {axis}{i}" for axis in "xy" for i in range(1, DEGREE + 1))
    return Allowance("posture", "force", "N", labels, np.full(2 * DEGREE, POSTURE_SD * largest), basis)


def powers(bend: Array) -> Array:
    """(F, 2) of displacements (F,)."""
    return np.stack([bend**i for i in range(1, DEGREE + 1)], axis=1)


def on_each_axis(terms: Array) -> Array:
    """(F, 2, 4): these terms (F, 2) for each axis of the force."""
    return np.asarray(np.einsum("fi,cd->fcdi", terms, np.eye(2)).reshape(len(terms), 2, 2 * DEGREE))
