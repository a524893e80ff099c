"""From observations to a learned beam: states (22), regression (18), selection (20), in the paper's order."""

from __future__ import annotations

import numpy as np

from onebend.blas import one_blas_thread
from onebend.learning.model.rest import AtRest, at_rest
from onebend.learning.outcome import Learned
from onebend.learning.paper.selection import MOST_FRAMES, RegressionSettings, standing, table
from onebend.progress import Progress, Silent
from onebend.records import Observations, Remark


@one_blas_thread
def regress(
    observations: Observations,
    settings: RegressionSettings = RegressionSettings(),
    *,
    most_frames: int = MOST_FRAMES,
    progress: Progress = Silent(),
) -> Learned:
    """The stiffness distribution of the observed beam, from at most so many frames.

    Raises:
        LearningError: too few loaded frames, or no (n, m) gives a beam that can be simulated.
    """
    rest = at_rest(observations)
    candidates = table(observations, rest, settings, progress, most_frames)
    chosen, training = standing(candidates, observations, rest)
    beam = candidates[chosen].beam
    assert beam is not None  # its BIC is finite
    return Learned(
        beam=beam,
        method=settings.method,
        family=settings.family,
        trials=tuple(c.trial for c in candidates),
        chosen=chosen,
        training=training,
        remarks=_remarks(rest, observations) + training.remarks,
    )


def _remarks(rest: AtRest, observations: Observations) -> tuple[Remark, ...]:
    """What was assumed about the beam at rest."""
    if not rest.seen:
        text = "no frame shows the beam at rest: it is taken as straight, its tags as perfectly placed"
        return (Remark("warning", text, about="no rest"),)
    shift = float(np.max(np.linalg.norm(rest.offset, axis=1)))
    turn = float(np.rad2deg(np.max(np.abs(rest.turn))))
    text = f"at rest the tags sit up to {1e3 * shift:.2f} mm and {turn:.2f} deg off their places; taken off every frame"
    if shift > 4.0 * observations.stated.placement_sd:
        text += ". That is more than the placement tolerance allows: check the tags' s"
        return (Remark("warning", text, about="tag places"),)
    return (Remark("note", text),)
