"""The beam stretches and shears: EA and kGA follow from k(s) and the thickness of its section."""

from __future__ import annotations

import numpy as np

from onebend.learning.allowances.allowance import Allowance

USUAL_THICKNESS = 0.08  # of the length, in the direction of bending
UNKNOWN_SD, KNOWN_SD = 0.8, 0.1  # of the log of the thickness


def section(*, known: bool) -> Allowance:
    """The log of the thickness over the stated one, or over the usual one where nobody says it."""
    sd = np.array([KNOWN_SD if known else UNKNOWN_SD])
    return Allowance("section", "section", "1", ("log of section thickness",), sd, np.zeros(0), shared=True)
