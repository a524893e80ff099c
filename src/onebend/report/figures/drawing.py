"""All figures of a report, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from onebend.beam.model import Beam
from onebend.errors import OnebendError
from onebend.learning.explained import explained
from onebend.learning.outcome import Comparison, Explained
from onebend.progress import Progress, Silent
from onebend.recording.kept_frames import KeptFrames
from onebend.records import Observations
from onebend.report.figures import curves, recordings
from onebend.report.figures.film import film_of, film_strip
from onebend.report.figures.pictures import Draw, Pictures, draw, reason_of
from onebend.report.figures.simulated import push_to_show
from onebend.report.findings import Findings
from onebend.report.kinds import only_frequencies, words_of


def draw_all(findings: Findings, *, frames: KeptFrames | None = None, progress: Progress = Silent()) -> Pictures:
    """Every figure that the findings allow, in the order of the page. The film is read for those of its frames that
    are not in `frames`."""
    wanted: dict[str, Draw] = {"stiffness": partial(_stiffness, findings)}
    posterior = findings.posterior
    if posterior is not None and (rows_told := curves.told(posterior.nuisances())):
        wanted["nuisances"] = partial(curves.nuisances, rows_told)
    if only_frequencies(findings.recordings):  # no tag moved
        return draw(wanted, progress)
    fits: Sequence[Explained | None] = [None] * len(findings.trainings) if posterior is None else explained(posterior)
    kept = frames or KeptFrames()
    return _with_film(findings, draw(wanted | _of_recordings(findings, fits, kept), progress), fits[0], kept)


def _of_recordings(findings: Findings, fits: Sequence[Explained | None], kept: KeptFrames) -> dict[str, Draw]:
    """What the recordings show, and how near the fit comes."""
    beam, learned = findings.beam, findings.learned
    training, recording = findings.trainings[0], findings.recordings[0]
    wanted: dict[str, Draw] = {
        "fit": partial(fit, beam, training, recording, fits[0], kept),
        "shapes": partial(recordings.shapes, beam, training, recording, fits[0]),
    }
    if not recording.static:  # poses have no time
        wanted["markers"] = partial(recordings.markers, training, fits[0])
    rows = zip(findings.trainings, findings.recordings, fits, strict=True)
    for i, (comparison, observations, fitted) in enumerate(rows, start=1):
        before = "" if i == 1 else f"learned-{i}-"
        if i > 1:
            wanted[f"{before}shapes"] = partial(recordings.shapes, beam, comparison, observations, fitted)
        if fitted is not None:
            wanted[f"{before}fitted"] = partial(recordings.residuals, fitted.comparison, "left by the fit")
        if fitted is None or not observations.static:  # of static poses the fit's own distance is the one that counts
            under = words_of(observations).under
            wanted[f"{before}residuals"] = partial(recordings.residuals, comparison, under)
    if learned is not None:
        wanted["selection"] = partial(recordings.selection, learned)
    if not recording.static:
        wanted["force"] = partial(recordings.force, recording, fits[0])
    pairs = list(zip(findings.validations, findings.validation_observations, strict=True))
    own = [
        fitted.comparison if fitted is not None and one.static else one
        for one, fitted in zip(findings.trainings, fits, strict=True)
    ]
    return wanted | validation_figures(beam, pairs, *own)


def _with_film(findings: Findings, pictures: Pictures, fitted: Explained | None, kept: KeptFrames) -> Pictures:
    """The film's frames beside the pictures, where there are any; why not, where they could not be made."""
    if fitted is None or findings.posterior is None or "fit" not in pictures.drawn:
        return pictures
    try:
        film = film_strip(findings.recordings[0], fitted, findings.beam, findings.posterior.stiffness, kept)
        return replace(pictures, film=film)
    except Exception as error:  # as with every picture
        pictures.failed["film"] = reason_of(error)
        return pictures


def _stiffness(findings: Findings) -> Figure:
    """k(s) with its band, and the regression's beside it where it is not the result itself."""
    posterior, learned, first = findings.posterior, findings.learned, findings.trainings[0]
    pushed = np.concatenate([comparison.push_s[np.isfinite(comparison.push_s)] for comparison in findings.trainings])
    return curves.stiffness(
        findings.beam,
        uncertain=None if posterior is None else posterior.stiffness,
        regression=None if posterior is None or learned is None else learned.beam.stiffness,
        tags=dict(zip(first.tag_id.tolist(), first.marker_s.tolist(), strict=True)),
        push_s=float(pushed.max()) if pushed.size else None,
    )


def validation_figures(
    beam: Beam, pairs: Sequence[tuple[Comparison, Observations]], *others: Comparison
) -> dict[str, Draw]:
    """The bars over all recordings (`others` first), and shapes and residuals of each."""
    if not pairs:
        return {}
    wanted: dict[str, Draw] = {
        "validation": partial(recordings.validation, (*others, *(comparison for comparison, _ in pairs)))
    }
    for i, (one, where) in enumerate(pairs, start=1):
        wanted[f"validation-{i}-shapes"] = partial(recordings.shapes, beam, one, where)
        wanted[f"validation-{i}-residuals"] = partial(recordings.residuals, one)
    return wanted


def fit(
    beam: Beam,
    comparison: Comparison,
    observations: Observations,
    fitted: Explained | None = None,
    kept: KeptFrames | None = None,
) -> Figure | None:
    """The fit over the video frame; None where there is no video any more, or no camera."""
    if observations.source.view is None or observations.source.video is None:
        return None
    shown = comparison if fitted is None else fitted.comparison
    wanted, film = int(shown.frame[push_to_show(shown)]), film_of(observations.source.video, observations)
    try:
        found = dict((kept or KeptFrames()).pictures(film, [wanted], colour=True))
    except OnebendError:
        return None
    image = found.get(wanted)
    return (
        None
        if image is None
        else recordings.fit_over_frame(image, observations.source.view, beam, comparison, observations, fitted)
    )
