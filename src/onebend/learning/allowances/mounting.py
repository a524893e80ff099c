"""A beam that is mounted anew bends a little otherwise: each recording has a k(s) of its own around that of the beam.

What differs between two mountings (how deep and how tight the clamp holds, set and temper of the material, which way up
a section lies) cannot be seen in one recording. Where there are several, the evidence chooses how much it is.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from onebend.beam.modal import Modes
from onebend.learning.allowances.allowance import Allowance
from onebend.records import Array

BETWEEN: Literal["between recordings"] = "between recordings"
# Of log k: level, slope and bow, before the evidence has chosen a factor on them. Five mountings of one cable gave
# levels that scatter by 0.11; beams that stay clamped, next to nothing.
BETWEEN_SD = np.array([0.05, 0.03, 0.03])
_SHAPES = Modes(len(BETWEEN_SD))  # Legendre polynomials over the beam: of no correlation with each other


def between_recordings(nodes: Array) -> Allowance:
    """A recording's own level, slope and bow of log k; `nodes` (Q,) or (F, Q) of the beam's grid."""
    labels = tuple(f"own {what} of log k" for what in ("level", "slope", "bow"))
    return Allowance(BETWEEN, "log k", "1", labels, BETWEEN_SD, _SHAPES.curvature(nodes), sized=True)
