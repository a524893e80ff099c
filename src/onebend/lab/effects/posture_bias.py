"""An error of a robot's force estimate that goes with its posture: smooth in the place of the tool."""

from __future__ import annotations

import numpy as np

from onebend.lab.effects.real_bench import RealBench
from onebend.records import Array


def posture_bias(effects: RealBench, tool: Array, length: float, peak: float) -> Array:
    """(T, 2) N at the tool's places (T, 2) [m], first at rest: a polynomial of second degree, zero there.

    Its largest size over these places is `posture_bias` of the peak [N].
    """
    x, y = ((tool - tool[0]) / length).T
    terms = np.stack([x, y, x**2, x * y, y**2], axis=-1)
    error = terms @ np.asarray(effects.posture_shape).reshape(2, 5).T
    largest = float(np.max(np.linalg.norm(error, axis=1)))
    return np.asarray(error * (effects.posture_bias * peak / largest if largest > 0.0 else 0.0))
