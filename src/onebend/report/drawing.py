"""All figures of a report, by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from onebend.beam.model import Beam
from onebend.errors import OnebendError
from onebend.learning.outcome import Comparison
from onebend.progress import Progress, Silent, track
from onebend.recording.entries import VideoEntry
from onebend.recording.video import frame_at
from onebend.records import Observations
from onebend.report import curves, figures
from onebend.report.findings import Findings
from onebend.report.simulated import largest_push
from onebend.report.style import png_of

Draw = Callable[[], Figure | None]


def draw_all(findings: Findings, *, progress: Progress = Silent()) -> dict[str, bytes]:
    """PNGs of every figure that the findings allow, in the order of the page."""
    beam, learned, posterior = findings.beam, findings.learned, findings.posterior
    training, seen = findings.trainings[0], findings.recordings[0]
    wanted: dict[str, Draw] = {"stiffness": partial(_stiffness, findings)}
    if posterior is not None:
        wanted["nuisances"] = partial(curves.nuisances, posterior.nuisances())
    wanted |= {
        "fit": partial(fit, beam, training, seen),
        "shapes": partial(figures.shapes, beam, training, seen),
        "markers": partial(figures.markers, training),
        "residuals": partial(figures.residuals, training),
    }
    for i, (one, where) in enumerate(list(zip(findings.trainings, findings.recordings, strict=True))[1:], start=2):
        wanted[f"learned-{i}-shapes"] = partial(figures.shapes, beam, one, where)
        wanted[f"learned-{i}-residuals"] = partial(figures.residuals, one)
    if learned is not None:
        wanted["selection"] = partial(figures.selection, learned)
    if not seen.static:  # poses have no time
        wanted["force"] = partial(figures.force, seen)
    pairs = list(zip(findings.validations, findings.validation_observations, strict=True))
    wanted |= validation_figures(beam, pairs, *findings.trainings)
    return draw(wanted, progress)


def _stiffness(findings: Findings) -> Figure:
    """k(s) with its band, and the regression's beside it where it is not the result itself."""
    posterior, learned = findings.posterior, findings.learned
    pushed = np.concatenate([one.push_s[np.isfinite(one.push_s)] for one in findings.trainings])
    return curves.stiffness(
        findings.beam,
        uncertain=None if posterior is None else posterior.stiffness,
        regression=None if posterior is None or learned is None else learned.beam.stiffness,
        marker_s=findings.trainings[0].marker_s,
        push_s=float(pushed.max()) if pushed.size else None,
    )


def validation_figures(
    beam: Beam, pairs: Sequence[tuple[Comparison, Observations]], *others: Comparison
) -> dict[str, Draw]:
    """The bars over all recordings (`others` first), and shapes and residuals of each."""
    if not pairs:
        return {}
    wanted: dict[str, Draw] = {"validation": partial(figures.validation, (*others, *(one for one, _ in pairs)))}
    for i, (one, where) in enumerate(pairs, start=1):
        wanted[f"validation-{i}-shapes"] = partial(figures.shapes, beam, one, where)
        wanted[f"validation-{i}-residuals"] = partial(figures.residuals, one)
    return wanted


def draw(wanted: dict[str, Draw], progress: Progress) -> dict[str, bytes]:
    """PNGs of what could be drawn."""
    drawn = {}
    for name, make in track(progress, "drawing the figures", list(wanted.items()), len(wanted)):
        figure = make()
        if figure is not None:
            drawn[name] = png_of(figure)
    return drawn


def fit(beam: Beam, one: Comparison, seen: Observations) -> Figure | None:
    """The fit over the video frame; None where there is no video any more, or no camera."""
    if seen.view is None or seen.video is None:
        return None
    try:
        film = VideoEntry(file=seen.video, topic=seen.video_topic, damaged="keep" if seen.video_topic else "refuse")
        image = frame_at(film, int(one.frame[largest_push(one)]))
    except OnebendError:
        return None
    return figures.fit_over_frame(image, seen.view, beam, one, seen)
