"""The beam stretches and shears: EA and kGA follow from k(s) and the thickness of its section.

1/EA and 1/kGA go with the thickness squared, and that is the parameter: what they do to the tags is linear in it, and a
beam that hardly stretches is one number among others, not one infinitely far away as it is on a scale of logs.
"""

from __future__ import annotations

import numpy as np

from onebend.beam.profiles.rectangular import RectangularSection
from onebend.learning.allowances.allowance import Allowance

USUAL_THICKNESS = 0.08  # of the length, in the direction of bending
UNKNOWN_SD, KNOWN_SD = 1.2, 0.2  # of the square of the thickness, over the usual or the stated one
_LEAST = 0.1  # of it: where the parameter would make the square smaller or negative, it levels off above zero


def section(*, known: bool) -> Allowance:
    """The relative change of the square of the thickness, from the stated one or the usual one."""
    sd = np.array([KNOWN_SD if known else UNKNOWN_SD])
    label = "change of section thickness squared"
    return Allowance("section", "section", "1", (label,), sd, np.zeros(0), shared=True)


def section_at(change: float, stated: float, beam_length: float) -> tuple[RectangularSection, float]:
    """The section at this value of the parameter, and how the log of its thickness goes with it; `stated` m, NaN where
    nobody says it."""
    usual = stated if np.isfinite(stated) else USUAL_THICKNESS * beam_length
    factor, slope = thickness_factor(change)
    return RectangularSection(usual * factor), slope


def thickness_factor(change: float) -> tuple[float, float]:
    """The thickness over the stated or usual one, and how its log goes with the parameter."""
    wanted = 1.0 + change
    root = float(np.hypot(wanted, 2.0 * _LEAST))
    square = 0.5 * (wanted + root) if wanted > 0.0 else 2.0 * _LEAST**2 / (root - wanted)
    return float(np.sqrt(square)), 0.5 / root
