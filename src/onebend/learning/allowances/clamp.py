"""The clamp gives way: it turns in proportion to the moment that the beam puts on it."""

from __future__ import annotations

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.course import PushCourse, with_rest

GIVE_SD = 0.01  # rad per rad that the first tag turns


def giving(run: PushCourse, count: int) -> Allowance:
    """The moment at the clamp follows the turn of the tag next to it; `count` frames, those at rest last."""
    basis = with_rest(run.turn[:, :1], count)
    return Allowance("clamp gives", "clamp", "1", ("clamp gives",), np.array([GIVE_SD]), basis)
