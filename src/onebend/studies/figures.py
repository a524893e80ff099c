"""The paper's figures, drawn from a run. Lengths in mm, forces in N, stiffness in N m."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from onebend.progress import Progress, Silent
from onebend.recording.toml.source_entries import VideoEntry
from onebend.recording.video import frame_at
from onebend.report.figures.pictures import Draw, Pictures, draw
from onebend.report.figures.reaching import draw_reach
from onebend.report.figures.simulated import centreline, largest_push
from onebend.report.figures.style import BLUE, FAINT, GREEN, INK, MUTED, ORANGE, blank, colour, shape, styled
from onebend.studies.films import RECORDINGS
from onebend.studies.outcome import BeamOutcome, S, StudyOutcome, ValidatedFilm
from onebend.studies.printed import printed_m3

MM = 1000.0
WORST, MIDDLE, BEST = "worst", "average", "best"
SHOWN = ("slow", "s06")  # Fig. 4


def draw_figures(outcome: StudyOutcome, *, progress: Progress = Silent()) -> Pictures:
    """By name; Fig. 4 only where there are films."""
    wanted: dict[str, Draw] = {
        "summary": partial(summary, outcome),
        "figure-3": partial(designs, outcome),
        "training": partial(training, outcome),
        "figure-6": partial(stiffness, outcome),
        "figure-7": partial(three_validations, outcome),
        "figure-8": partial(manipulations, outcome),
    }
    if outcome.setting.video:
        wanted["figure-4"] = partial(frames, outcome)
    return draw(wanted, progress)


@styled
def summary(outcome: StudyOutcome) -> Figure:
    """The error at the tip in every validation: printed, the paper's method, the fit, the true beam."""
    figure, axes = blank(3.5, 1, len(outcome.beams), sharey=True)
    kinds = (("printed in the paper", FAINT), ("paper's method", ORANGE), ("onebend's fit", BLUE))
    for panel, beam in zip(axes, outcome.beams, strict=True):
        for x, film in enumerate(beam.films[1:]):
            printed = printed_m3(beam.name, film.strategy.name)
            values = (printed, None if film.paper is None else film.paper.rms[-1], film.fit.rms[-1])
            for i, (value, (_, tint)) in enumerate(zip(values, kinds, strict=True)):
                if value is not None:
                    panel.bar(x + 0.27 * (i - 1), MM * value, width=0.25, color=tint)
            panel.plot([x - 0.4, x + 0.4], [MM * film.true.rms[-1]] * 2, color=INK, linewidth=1.4)
        if printed_m3(beam.name, "fast") is None:
            panel.annotate("no printed figures\nat hand", (0.02, 0.98), xycoords="axes fraction", va="top", fontsize=8,
                        color=MUTED)  # fmt: skip
        panel.set_xticks(range(len(beam.films) - 1), [film.strategy.name for film in beam.films[1:]])
        panel.set_title(f"{beam.name} beam")
        panel.grid(visible=False, axis="x")
    axes[0].set_ylabel("RMS error at the tip [mm]")
    for name, tint in kinds:
        axes[0].bar([0.0], [0.0], color=tint, label=name)
    axes[0].plot([], [], color=INK, linewidth=1.4, label="the true beam under the logged force")
    figure.legend(loc="outside lower center", ncols=2)
    return figure


@styled
def designs(outcome: StudyOutcome) -> Figure:
    """Fig. 3: the three beams, to scale."""
    figure, axes = blank(3.6, len(outcome.beams), 1, sharex=True)
    for panel, beam in zip(axes, outcome.beams, strict=True):
        half = 0.5 * MM * np.asarray(beam.design.width(S))
        panel.fill_between(MM * beam.design.length * S, -half, half, color=BLUE, alpha=0.25, linewidth=0)
        panel.plot(MM * beam.design.length * S, half, color=BLUE)
        panel.plot(MM * beam.design.length * S, -half, color=BLUE)
        panel.axvspan(-6.0, 0.0, color=MUTED, alpha=0.5, linewidth=0)
        for i, s in enumerate(beam.films[0].observations.marker_s):
            panel.plot(MM * beam.design.length * s, 0.0, shape(i), color=colour(i), markersize=5)
        panel.set(aspect="equal", ylim=(-12, 12), ylabel="[mm]", title=f"{beam.name} width")
    axes[-1].set_xlabel("along the beam, from the clamp [mm]")
    return figure


@styled
def frames(outcome: StudyOutcome) -> Figure:
    """Fig. 4: frames of the films at the largest push, at s = 1 and s = 0.6."""
    figure, axes = blank(2.15 * len(outcome.beams), len(outcome.beams), len(SHOWN))
    pairs = [
        (beam, film) for beam in outcome.beams for name in SHOWN for film in beam.films if film.strategy.name == name
    ]
    for panel, (one, film) in zip(axes, pairs, strict=True):
        panel.set_axis_off()
        t = largest_push(film.fit)
        file = outcome.work / RECORDINGS / film.observations.source.name / "video.mp4"
        panel.imshow(frame_at(VideoEntry(file=file), int(film.fit.frame[t])))
        panel.set_title(f"{one.name}, pushed at s = {film.fit.push_s[t]:.2g}, {np.hypot(*film.fit.force[t]):.2f} N")
    return figure


@styled
def training(outcome: StudyOutcome) -> Figure:
    """Force and markers of each training push over time: measured (dots) and simulated under the logged force."""
    figure, axes = blank(4.8, 2, len(outcome.beams), sharex=True)
    for i, beam in enumerate(outcome.beams):
        above, below, film = axes[i], axes[i + len(outcome.beams)], beam.films[0]
        time = film.fit.time - film.fit.time[0]
        for axis, tint, name in ((0, GREEN, "Fx"), (1, BLUE, "Fy")):
            above.plot(time, film.fit.force[:, axis], color=tint, linewidth=1.3, label=name)
        step = max(1, len(time) // 60)
        for m in range(len(film.fit.tag_id)):
            below.plot(time[::step], MM * film.fit.measured[::step, m, 1], shape(m), color=colour(m), markersize=3,
                       alpha=0.6, label=f"M{m + 1}")  # fmt: skip
            below.plot(time, MM * film.fit.predicted[:, m, 1], color=colour(m), linewidth=1.3)
        above.set_title(f"{beam.name} beam")
        below.set_xlabel("time in contact [s]")
    axes[0].set_ylabel("logged force [N]")
    axes[len(outcome.beams)].set_ylabel("markers' y [mm]")
    for panel in (axes[0], axes[len(outcome.beams)]):
        panel.margins(y=0.25)
        panel.legend(loc="upper center", fontsize=8, ncols=3, columnspacing=1.0, handlelength=1.2)
    return figure


@styled
def stiffness(outcome: StudyOutcome) -> Figure:
    """Fig. 6: k(s) of each beam: true, the paper's method, the fit with its 95 % band."""
    figure, axes = blank(3.9, 1, len(outcome.beams))
    for panel, beam in zip(axes, outcome.beams, strict=True):
        band, true = beam.learned.uncertain.band(S), np.asarray(beam.true.stiffness(S))
        panel.fill_between(S, band.low, band.high, color=BLUE, alpha=0.2, linewidth=0, label="its 95 % band")
        panel.plot(S, band.k, color=BLUE, label="onebend's fit")
        if beam.learned.paper is not None:
            panel.plot(S, beam.learned.paper.stiffness(S), color=ORANGE, linestyle="--", label="paper's method")
        panel.plot(S, true, color=INK, linewidth=1.3, label="true")
        panel.set(ylim=(0.0, 1.6 * float(true.max())), xlabel="s", title=f"{beam.name} beam")
    axes[0].set_ylabel("k(s) [N m], on the scale of the log")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def ranked(outcome: StudyOutcome) -> tuple[tuple[str, BeamOutcome, ValidatedFilm], ...]:
    """The validations with the fit's largest, middle and smallest error at the tip."""
    every = [(beam, film) for beam in outcome.beams for film in beam.films[1:]]
    order = sorted(every, key=lambda pair: -float(pair[1].fit.rms[-1]))
    return tuple((word, *order[i]) for word, i in ((WORST, 0), (MIDDLE, len(order) // 2), (BEST, len(order) - 1)))


@styled
def three_validations(outcome: StudyOutcome) -> Figure:
    """Fig. 7: worst, average and best validation: measured markers, and the learned beams under the logged force."""
    figure, axes = blank(3.5, 1, 3, sharex=True, sharey=True)
    for panel, (word, one, film) in zip(axes, ranked(outcome), strict=True):
        t = largest_push(film.fit)
        _shape(panel, one, film, t)
        title = f"{word}: {one.name}, {film.strategy.name}\n{MM * film.fit.rms[-1]:.1f} mm at M3"
        panel.set(aspect="equal", xlabel="x [mm]", title=title)
    axes[0].set_ylabel("y [mm]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def _shape(panel: Axes, one: BeamOutcome, film: ValidatedFilm, t: int) -> None:
    pairs = ((one.learned.fit, BLUE, "-", "onebend's fit"), (one.learned.paper, ORANGE, "--", "paper's method"))
    for beam, tint, line, name in pairs:
        drawn = None if beam is None else centreline(beam, film.fit, film.observations, t)
        if drawn is not None:
            panel.plot(*(MM * drawn.T), color=tint, linestyle=line, label=name)
    for m in range(len(film.fit.tag_id)):
        panel.plot(*(MM * film.fit.measured[t, m]), shape(m), color=colour(m), markersize=7, markerfacecolor="none",
                markeredgewidth=1.8, label=f"M{m + 1} measured", zorder=5)  # fmt: skip
    panel.plot(0.0, 0.0, "s", color=INK, markersize=5)


@styled
def manipulations(outcome: StudyOutcome) -> Figure:
    """Fig. 8: two tasks a beam, on the way to the goal, and where the same force puts the true beam."""
    shown = [(beam, done) for beam in outcome.beams for done in beam.tasks if done.way == "fit"]
    figure, axes = blank(2.6 * len(outcome.beams), len(outcome.beams), 2)
    for panel, (one, done) in zip(axes, shown, strict=True):
        draw_reach(panel, done.found, None)
        panel.plot(*(MM * done.landed), "+", color=GREEN, markersize=11, markeredgewidth=2, zorder=9, label="true beam")
        panel.set_title(f"{one.name}, {done.task.name}: {MM * done.off:.2f} mm off")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure
