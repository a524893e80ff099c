"""The beam's length as it was measured is off a little: loads have other levers, and tags sit farther out."""

from __future__ import annotations

import numpy as np

from onebend.learning.allowances.allowance import Allowance

LENGTH_SD = 0.005  # of the length


def length() -> Allowance:
    """The log of the length, over what is written."""
    return Allowance("length", "length", "1", ("log of length",), np.array([LENGTH_SD]), np.zeros(0), shared=True)
