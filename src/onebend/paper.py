"""The paper's own method: the regression (12)-(20). It has no band; `onebend.learn` and `onebend.fit` have."""

from __future__ import annotations

from onebend.learning.outcome import Learned, Trial
from onebend.learning.paper.learn import regress
from onebend.learning.paper.selection import RegressionSettings

__all__ = [
    "Learned",
    "RegressionSettings",
    "Trial",
    "regress",
]
