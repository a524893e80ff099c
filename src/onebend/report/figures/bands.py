"""What the bands of k(s) look like, in pictures and on the page alike; without Matplotlib."""

from __future__ import annotations

import numpy as np

from onebend.beam.profiles.uncertain import UncertainStiffness

LEVELS = ((0.95, 0.14), (0.80, 0.20), (0.50, 0.32))  # of the bands, and how strongly each is drawn
_S = np.linspace(0.0, 1.0, 401)


def highest_shown(uncertain: UncertainStiffness) -> float:
    """N m, the top of an axis of k(s): the known part sets it, and k where it is not known may add three tenths."""
    band = uncertain.band(_S)
    known = float(np.max(band.high[uncertain.best_known(_S)]))
    return max(known, min(float(np.max(band.k)), 1.3 * known))
