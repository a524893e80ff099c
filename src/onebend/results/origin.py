"""Where a learned beam comes from, as `model.json` says it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from onebend.learning.outcome import Comparison, Learned

if TYPE_CHECKING:  # for the type alone: the fit takes a quarter of a second to load
    from onebend.learning.posterior import Posterior


@dataclass(frozen=True)
class Origin:
    """Where a model comes from. For people: nothing is computed from it."""

    recording: str  # several: with " + " between them
    method: str
    family: str
    n: int | None  # curvature modes; None where none were used
    m: int  # stiffness functions
    marker_s: tuple[float, ...]  # places of the tags
    push_s: float | None  # furthest place pushed; what lies beyond was not loaded
    training_rms_m: tuple[float | None, ...]  # per tag


def origin_of(learned: Learned | None, posterior: Posterior | None, trainings: Sequence[Comparison]) -> Origin:
    """The provenance written beside a learned beam: the fit's where there is one, else the regression's."""
    from onebend.learning.model.frames import marker_rms  # here: who reads a model loads no fit

    pushed = np.concatenate([comparison.push_s[np.isfinite(comparison.push_s)] for comparison in trainings])
    rms = marker_rms(np.concatenate([comparison.measured - comparison.predicted for comparison in trainings]))
    if posterior is not None:
        made: tuple[str, str, int | None, int] = ("fit", "log-spline", None, posterior.layout.spline.count)
    else:
        assert learned is not None
        trial = learned.trials[learned.chosen]
        made = (learned.method, learned.family, trial.n, trial.m)
    return Origin(
        " + ".join(comparison.name for comparison in trainings),
        *made,
        marker_s=tuple(float(s) for s in trainings[0].marker_s),
        push_s=float(pushed.max()) if pushed.size else None,
        training_rms_m=tuple(float(r) if np.isfinite(r) else None for r in rms),
    )
