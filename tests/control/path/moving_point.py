"""Goals of one point of a beam."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from onebend.control.goals import Between, Goals, points


def point_goals(time: ArrayLike, xy: ArrayLike, *, point_s: float = 1.0, between: Between = "smooth") -> Goals:
    """One point of the beam, at `point_s`, wanted at xy (K, 2) m at times (K,) s."""
    times, wanted = np.asarray(time, dtype=float), np.asarray(xy, dtype=float)
    nowhere = np.full((len(times), 1), np.nan)
    return Goals(times, points(point_s, wanted[0]), wanted[:, None], nowhere, between)
