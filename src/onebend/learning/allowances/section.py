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
_NEAR_NONE = 1e-9  # of it: as good as none, where nothing may be divided by


def section(*, known: bool) -> Allowance:
    """The relative change of the square of the thickness, from the stated one or the usual one."""
    sd = np.array([KNOWN_SD if known else UNKNOWN_SD])
    label = "change of section thickness squared"
    return Allowance("section", "section", "1", (label,), sd, np.zeros(0), shared=True)


def section_at(change: float, stated: float, beam_length: float) -> tuple[RectangularSection, float]:
    """By which the beam stretches and shears, and half of how the log of that goes with the parameter.

    `stated` m, NaN where nobody says it. Less than no stretch is taken too: then noise moves a beam that hardly
    stretches to either side of nothing alike.
    """
    usual, share = stated if np.isfinite(stated) else USUAL_THICKNESS * beam_length, 1.0 + change
    if abs(share) < _NEAR_NONE:
        share = _NEAR_NONE
    return RectangularSection(usual, share=share), 0.5 / share
