"""Tables of a study: the paper's printed numbers beside ours. SI units; NaN: unknown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from math import atan2, degrees, nan
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.paper import study
from onebend.files.publish import headed
from onebend.progress import Progress, Silent
from onebend.recording.entries import VideoEntry
from onebend.recording.video import pictures_at
from onebend.report.control_figures import draw_reach
from onebend.report.figures import centreline, largest_push
from onebend.report.page import render
from onebend.report.pictures import Draw, Pictures, draw
from onebend.report.sentences import UNKNOWN, length_words, millimetres, significant
from onebend.report.style import BLUE, FAINT, GREEN, INK, MUTED, ORANGE, blank, hue_of, shape, styled
from onebend.results.tables import write_csv

Cell = float | int | str
MARKERS = ("M1", "M2", "M3")


Row = dict[str, Cell]  # by the column's name


@dataclass(frozen=True)
class ResultTable:
    """Column names end in their unit."""

    key: str  # file name
    title: str
    rows: tuple[Row, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        return tuple(self.rows[0])


def all_tables(outcome: study.StudyOutcome) -> tuple[ResultTable, ...]:
    """Tables I to VI, then the results in the paper's text."""
    return (
        *(selection_table(beam) for beam in outcome.beams),
        *(validation_table(beam) for beam in outcome.beams),
        training_table(outcome),
        manipulation_table(outcome),
        stiffness_errors(outcome),
    )


def _markers(by: str, rms: Iterable[float] | None) -> Row:
    """RMS errors of the three markers; NaN where there are none."""
    values = (nan,) * 3 if rms is None else rms
    return {f"{by}_{marker}_m": float(value) for marker, value in zip(MARKERS, values, strict=True)}


def selection_table(beam: study.BeamOutcome) -> ResultTable:
    """Tables I to III: every (n, m) by the paper's method."""
    said = study.printed()[beam.name]
    there = {(row.n, row.m): row for row in said.trials}
    rows: list[Row] = []
    for i, trial in enumerate(beam.learned.trials):
        row = there.get((trial.n, trial.m))
        who = (("paper", (trial.n, trial.m) == said.chosen), ("ours", i == beam.learned.chosen))
        rows.append(
            {"n": trial.n, "m": trial.m}
            | _markers("printed", None if row is None else row.rms)
            | {"printed_bic": nan if row is None else row.bic}
            | _markers("ours", trial.rms)
            | {"ours_bic": trial.bic if np.isfinite(trial.bic) else nan}
            | {"chosen_by": " and ".join(name for name, it_is in who if it_is), "out_because": trial.why_out}
        )
    title = f"Table {said.selection_table}: RMS of errors of the {beam.name} beam"
    return ResultTable(f"table-{said.selection_table}", title, tuple(rows))


def _compared(film: study.ValidatedFilm, there: Iterable[float] | None) -> Row:
    """Printed errors, and those of the paper's method, the fit and the true beam."""
    ours = (("paper", film.paper), ("fit", film.fit), ("true", film.true))
    row = _markers("printed", there)
    for by, comparison in ours:
        row |= _markers(by, None if comparison is None else comparison.rms)
    return row


def validation_table(beam: study.BeamOutcome) -> ResultTable:
    """Tables IV to VI: the validations; printed, paper's method, fit, and true beam."""
    said = study.printed()[beam.name]
    rows = tuple(
        Row(strategy=film.strategy.says) | _compared(film, said.validation.get(film.strategy.name))
        for film in beam.films[1:]
    )
    title = f"Table {said.validation_table}: RMS of errors, validation set of the {beam.name} beam"
    return ResultTable(f"table-{said.validation_table}", title, rows)


def training_table(outcome: study.StudyOutcome) -> ResultTable:
    """The training push: chosen row of Tables I to III beside the fit."""
    rows: list[Row] = []
    for beam in outcome.beams:
        said = study.printed()[beam.name]
        there = {(row.n, row.m): row.rms for row in said.trials}.get(said.chosen)
        fitted = _markers("fitted", beam.learned.fitted_rms)
        rows.append({"beam": beam.name} | _compared(beam.films[0], there) | fitted)
    return ResultTable("training", "The training push", tuple(rows))


def manipulation_table(outcome: study.StudyOutcome) -> ResultTable:
    """Section V-C: error within the model, and of the true beam under the same force."""
    rows: tuple[Row, ...] = tuple(
        {
            "beam": beam.name,
            "point": f"{done.task.name}, s = {done.task.s:g}",
            "way": study.WAYS[done.way],
            "goal_x_m": float(done.goal[0]),
            "goal_y_m": float(done.goal[1]),
            "force_N": float(np.hypot(*done.found.force)),
            "force_deg": degrees(atan2(done.found.force[1], done.found.force[0])),
            "iterations": done.found.iterations,
            "model_error_m": done.found.error,
            "true_error_m": done.off,
            "not_reached_because": "" if done.found.converged else done.found.reason,
        }
        for beam in outcome.beams
        for done in beam.tasks
    )
    return ResultTable("manipulation", "The six manipulation tasks", rows)


def stiffness_errors(outcome: study.StudyOutcome) -> ResultTable:
    """Error of k(s) in the force's scale, and coverage of the band."""
    rows: list[Row] = []
    for beam in outcome.beams:
        learned = beam.learned
        chosen = None if learned.chosen is None else learned.trials[learned.chosen]
        rows.append(
            {
                "beam": beam.name,
                "printed_choice": "n = {}, m = {}".format(*study.printed()[beam.name].chosen),
                "ours_choice": "none" if chosen is None else f"n = {chosen.n}, m = {chosen.m}",
                "paper_log_k_rms_percent": nan if learned.paper is None else 100.0 * beam.error(learned.paper),
                "fit_log_k_rms_percent": 100.0 * beam.error(learned.fit),
                "band_holds_percent": 100.0 * beam.inside,
            }
        )
    return ResultTable("stiffness", "k(s) against the truth", tuple(rows))


def stiffness_curves(beam: study.BeamOutcome) -> ResultTable:
    """k(s) at 201 places [N m]."""
    s = np.linspace(0.0, 1.0, 201)
    band, paper = beam.learned.uncertain.band(s), beam.learned.paper
    columns = {
        "s": s,
        "true_k_N_m": np.asarray(beam.design.beam().stiffness(s)),
        "true_k_as_logged_N_m": np.asarray(beam.true.stiffness(s)),
        "paper_k_N_m": np.full(len(s), nan) if paper is None else np.asarray(paper.stiffness(s)),
        "fit_k_N_m": band.k,
        "fit_lo_N_m": band.low,
        "fit_hi_N_m": band.high,
    }
    rows: tuple[Row, ...] = tuple({name: float(values[i]) for name, values in columns.items()} for i in range(len(s)))
    return ResultTable(f"stiffness-{beam.name}", f"k(s) of the {beam.name} beam", rows)


def write_table(path: Path, table: ResultTable) -> None:
    """Nine significant digits."""
    write_csv(path, table.columns, ([_text(cell) for cell in row.values()] for row in table.rows))


def _text(cell: Cell) -> str:
    return f"{cell:.9g}" if isinstance(cell, float) else str(cell)


def below_printed(outcome: study.StudyOutcome) -> tuple[int, int]:
    """Number of validations where the fit's tip error is below the printed one, and number printed."""
    films = [
        (film, study.printed_m3(beam.name, film.strategy.name)) for beam in outcome.beams for film in beam.films[1:]
    ]
    known = [(film.fit.rms[-1], printed) for film, printed in films if printed is not None]
    return sum(bool(ours < printed) for ours, printed in known), len(known)


def largest(values: Iterable[float]) -> float:
    """NaN if none is known."""
    known: Sequence[float] = [value for value in values if np.isfinite(value)]
    return max(known, default=nan)


# The paper's figures from a run, in mm, N and N m.

MM = 1000.0
WORST, MIDDLE, BEST = "worst", "average", "best"
SHOWN = ("slow", "s06")  # Fig. 4


def draw_figures(outcome: study.StudyOutcome, *, progress: Progress = Silent()) -> Pictures:
    """By name; Fig. 4 only with films."""
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
def summary(outcome: study.StudyOutcome) -> Figure:
    """Tip error of every validation: printed, paper's method, fit, true beam."""
    figure, axes = blank(3.5, 1, len(outcome.beams), sharey=True)
    kinds = (("printed in the paper", FAINT), ("paper's method", ORANGE), ("onebend's fit", BLUE))
    for panel, beam in zip(axes, outcome.beams, strict=True):
        for x, film in enumerate(beam.films[1:]):
            printed = study.printed_m3(beam.name, film.strategy.name)
            values = (printed, None if film.paper is None else film.paper.rms[-1], film.fit.rms[-1])
            for i, (value, (_, tint)) in enumerate(zip(values, kinds, strict=True)):
                if value is not None:
                    panel.bar(x + 0.27 * (i - 1), MM * value, width=0.25, color=tint)
            panel.plot([x - 0.4, x + 0.4], [MM * film.true.rms[-1]] * 2, color=INK, linewidth=1.4)
        if study.printed_m3(beam.name, "fast") is None:
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
def designs(outcome: study.StudyOutcome) -> Figure:
    """Fig. 3: the beams to scale."""
    figure, axes = blank(3.6, len(outcome.beams), 1, sharex=True)
    for panel, beam in zip(axes, outcome.beams, strict=True):
        half = 0.5 * MM * np.asarray(beam.design.width(study.S))
        panel.fill_between(MM * beam.design.length * study.S, -half, half, color=BLUE, alpha=0.25, linewidth=0)
        panel.plot(MM * beam.design.length * study.S, half, color=BLUE)
        panel.plot(MM * beam.design.length * study.S, -half, color=BLUE)
        panel.axvspan(-6.0, 0.0, color=MUTED, alpha=0.5, linewidth=0)
        for i, s in enumerate(beam.films[0].observations.marker_s):
            panel.plot(MM * beam.design.length * s, 0.0, shape(i), color=hue_of(i), markersize=5)
        panel.set(aspect="equal", ylim=(-12, 12), ylabel="[mm]", title=f"{beam.name} width")
    axes[-1].set_xlabel("along the beam, from the clamp [mm]")
    return figure


@styled
def frames(outcome: study.StudyOutcome) -> Figure:
    """Fig. 4: frames at the largest push, at s = 1 and s = 0.6."""
    figure, axes = blank(2.15 * len(outcome.beams), len(outcome.beams), len(SHOWN))
    pairs = [
        (beam, film) for beam in outcome.beams for name in SHOWN for film in beam.films if film.strategy.name == name
    ]
    for panel, (one, film) in zip(axes, pairs, strict=True):
        panel.set_axis_off()
        t = largest_push(film.fit)
        file = outcome.work / study.RECORDINGS / film.observations.source.name / "video.mp4"
        [(_, picture)] = pictures_at(VideoEntry(file=file), [int(film.fit.frame[t])], colour=True)
        panel.imshow(picture)
        panel.set_title(f"{one.name}, pushed at s = {film.fit.push_s[t]:.2g}, {np.hypot(*film.fit.force[t]):.2f} N")
    return figure


@styled
def training(outcome: study.StudyOutcome) -> Figure:
    """Force and markers of each training push: measured (dots), and simulated under the logged force."""
    figure, axes = blank(4.8, 2, len(outcome.beams), sharex=True)
    for i, beam in enumerate(outcome.beams):
        above, below, film = axes[i], axes[i + len(outcome.beams)], beam.films[0]
        time = film.fit.time - film.fit.time[0]
        for axis, tint, name in ((0, GREEN, "Fx"), (1, BLUE, "Fy")):
            above.plot(time, film.fit.force[:, axis], color=tint, linewidth=1.3, label=name)
        step = max(1, len(time) // 60)
        for m in range(len(film.fit.tag_id)):
            below.plot(time[::step], MM * film.fit.measured[::step, m, 1], shape(m), color=hue_of(m), markersize=3,
                       alpha=0.6, label=f"M{m + 1}")  # fmt: skip
            below.plot(time, MM * film.fit.predicted[:, m, 1], color=hue_of(m), linewidth=1.3)
        above.set_title(f"{beam.name} beam")
        below.set_xlabel("time in contact [s]")
    axes[0].set_ylabel("logged force [N]")
    axes[len(outcome.beams)].set_ylabel("markers' y [mm]")
    for panel in (axes[0], axes[len(outcome.beams)]):
        panel.margins(y=0.25)
        panel.legend(loc="upper center", fontsize=8, ncols=3, columnspacing=1.0, handlelength=1.2)
    return figure


def _with_legend(figure: Figure) -> Figure:
    """The figure with its legend below."""
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


@styled
def stiffness(outcome: study.StudyOutcome) -> Figure:
    """Fig. 6: k(s): true, paper's method, fit with its 95 % band."""
    figure, axes = blank(3.9, 1, len(outcome.beams))
    for panel, beam in zip(axes, outcome.beams, strict=True):
        band, true = beam.learned.uncertain.band(study.S), np.asarray(beam.true.stiffness(study.S))
        panel.fill_between(study.S, band.low, band.high, color=BLUE, alpha=0.2, linewidth=0, label="its 95 % band")
        panel.plot(study.S, band.k, color=BLUE, label="onebend's fit")
        if beam.learned.paper is not None:
            panel.plot(
                study.S, beam.learned.paper.stiffness(study.S), color=ORANGE, linestyle="--", label="paper's method"
            )
        panel.plot(study.S, true, color=INK, linewidth=1.3, label="true")
        panel.set(ylim=(0.0, 1.6 * float(true.max())), xlabel="s", title=f"{beam.name} beam")
    axes[0].set_ylabel("k(s) [N m], on the scale of the log")
    return _with_legend(figure)


def ranked(outcome: study.StudyOutcome) -> tuple[tuple[str, study.BeamOutcome, study.ValidatedFilm], ...]:
    """Validations with the fit's largest, middle and smallest tip error."""
    every = [(beam, film) for beam in outcome.beams for film in beam.films[1:]]
    order = sorted(every, key=lambda pair: -float(pair[1].fit.rms[-1]))
    return tuple((word, *order[i]) for word, i in ((WORST, 0), (MIDDLE, len(order) // 2), (BEST, len(order) - 1)))


@styled
def three_validations(outcome: study.StudyOutcome) -> Figure:
    """Fig. 7: worst, average and best validation: markers, and learned beams under the logged force."""
    figure, axes = blank(3.5, 1, 3, sharex=True, sharey=True)
    for panel, (word, one, film) in zip(axes, ranked(outcome), strict=True):
        t = largest_push(film.fit)
        _shape(panel, one, film, t)
        title = f"{word}: {one.name}, {film.strategy.name}\n{MM * film.fit.rms[-1]:.1f} mm at M3"
        panel.set(aspect="equal", xlabel="x [mm]", title=title)
    axes[0].set_ylabel("y [mm]")
    return _with_legend(figure)


def _shape(panel: Axes, one: study.BeamOutcome, film: study.ValidatedFilm, t: int) -> None:
    pairs = ((one.learned.fit, BLUE, "-", "onebend's fit"), (one.learned.paper, ORANGE, "--", "paper's method"))
    for beam, tint, line, name in pairs:
        drawn = None if beam is None else centreline(beam, film.fit, film.observations, t)
        if drawn is not None:
            panel.plot(*(MM * drawn.T), color=tint, linestyle=line, label=name)
    for m in range(len(film.fit.tag_id)):
        panel.plot(*(MM * film.fit.measured[t, m]), shape(m), color=hue_of(m), markersize=7, markerfacecolor="none",
                markeredgewidth=1.8, label=f"M{m + 1} measured", zorder=5)  # fmt: skip
    panel.plot(0.0, 0.0, "s", color=INK, markersize=5)


@styled
def manipulations(outcome: study.StudyOutcome) -> Figure:
    """Fig. 8: two tasks per beam, the way to the goal, and the true beam under the same force."""
    shown = [(beam, done) for beam in outcome.beams for done in beam.tasks if done.way == "fit"]
    figure, axes = blank(2.6 * len(outcome.beams), len(outcome.beams), 2)
    for panel, (one, done) in zip(axes, shown, strict=True):
        draw_reach(panel, done.found, None)
        panel.plot(*(MM * done.landed), "+", color=GREEN, markersize=11, markeredgewidth=2, zorder=9, label="true beam")
        panel.set_title(f"{one.name}, {done.task.name}: {MM * done.off:.2f} mm off")
    return _with_legend(figure)


GROUPS = {
    "printed": "printed",
    "ours": "ours, the paper's method",
    "paper": "the paper's method",
    "fit": "onebend's fit",
    "true": "true beam",
    "fitted": "fitted",
}
NAMES = {
    "chosen_by": "chosen by",
    "out_because": "out, because",
    "ours_choice": "chosen here",
    "printed_choice": "chosen in the paper",
    "paper_log_k_rms_percent": "error, paper's method [%]",
    "fit_log_k_rms_percent": "error, fit [%]",
    "band_holds_percent": "of s inside the band [%]",
    "force_N": "force [N]",
    "force_deg": "direction [deg]",
    "goal_x_m": "goal x [mm]",
    "goal_y_m": "goal y [mm]",
    "model_error_m": "error in the model [m]",
    "true_error_m": "true beam [mm]",
    "not_reached_because": "not reached, because",
}
FILES = (
    ("report.html", "this page"),
    ("summary.json", "all tables for scripts, in SI"),
    ("tables/*.csv", "every table, and k(s) of each beam at 201 places"),
    ("figures/*.png", "every figure"),
    ("learned/BEAM/model.json", "the beam by the fit, for every command that takes a MODEL"),
    ("learned/BEAM/paper-model.json", "the beam by the paper's method"),
    ("recordings/BEAM-PUSH", "the films, with the truth of each: recordings like any other"),
    ("observed/BEAM-PUSH.parquet", "what each recording says"),
)


def page(outcome: study.StudyOutcome, figures: Mapping[str, bytes]) -> str:
    """One self-contained page. `figures`: PNGs by name; missing ones are skipped."""
    setting = outcome.setting
    content = {
        "video": setting.video,
        "seed": setting.seed,
        "quick": study.quick_words(setting),
        "cards": cards(outcome),
        "selections": [shown(selection_table(beam)) for beam in outcome.beams],
        "training": shown(training_table(outcome)),
        "stiffness": shown(stiffness_errors(outcome)),
        "validations": [shown(validation_table(beam)) for beam in outcome.beams],
        "manipulation": shown(manipulation_table(outcome)),
        "assumed": study.assumed(outcome),
        "remarks": [f"{beam.name} beam, {text}" for beam in outcome.beams for text in beam.learned.remarks],
        "files": [file for file in FILES if setting.video or not file[0].startswith("recordings")],
    }
    return render("benchmarks.paper", "study.html", figures, content)


def cards(outcome: study.StudyOutcome) -> list[tuple[str, str, str]]:
    below, known = below_printed(outcome)
    films = [film for beam in outcome.beams for film in beam.films[1:]]
    tasks = [done for beam in outcome.beams for done in beam.tasks if done.way == "fit"]
    reached = [done for done in tasks if done.found.converged]
    papers = [100.0 * beam.error(beam.learned.paper) for beam in outcome.beams if beam.learned.paper is not None]
    fits = [100.0 * beam.error(beam.learned.fit) for beam in outcome.beams]
    worst = largest(float(film.fit.rms[-1]) for film in films)
    floor = largest(float(film.true.rms[-1]) for film in films)
    off = largest(done.off for done in reached)
    largest_tip = f"the largest of all: {millimetres(worst)} mm, the true beam's: {millimetres(floor)} mm"
    others = f"the paper's method: {significant(min(papers), 2)} … {significant(max(papers), 2)} %" if papers else ""
    return [
        ("validations below the printed tip error", f"{below} of {known}", f"of Tables IV and V; {largest_tip}"),
        (
            "k(s) is off by",
            f"{significant(min(fits), 2)} … {significant(max(fits), 2)} %",
            others or "the paper's method gave no beam",
        ),
        (
            "tasks reached in the model",
            f"{len(reached)} of {len(tasks)}",
            f"to {length_words(largest(done.found.error for done in reached))}",
        ),
        ("the true beam is then off by", f"{millimetres(off)} mm", "at most, under the same force"),
    ]


def shown(table: ResultTable) -> dict[str, Any]:
    groups: list[dict[str, Any]] = []
    alike = not any(name.endswith("_bic") for name in table.columns)  # all of a group are mm: stated once, above
    for name in table.columns:
        group = _group(name)
        group += " [mm]" if group and alike else ""
        if groups and group and groups[-1]["name"] == group:
            groups[-1]["wide"] += 1
        else:
            groups.append({"name": group, "wide": 1})
    heads = [
        {"name": _head(name, said=alike), "text": any(isinstance(row[name], str) for row in table.rows)}
        for name in table.columns
    ]
    rows = [
        {
            "cells": [_cell(name, cell) for name, cell in row.items()],
            "chosen": "ours" in str(row.get("chosen_by", "")),
        }
        for row in table.rows
    ]
    return {
        "title": table.title,
        "heads": heads,
        "rows": rows,
        "groups": groups if any(g["name"] for g in groups) else [],
    }


def _group(column: str) -> str:
    by = column.split("_")[0]
    return GROUPS.get(by, "") if "_M" in column or column.endswith("_bic") else ""


def _head(column: str, *, said: bool) -> str:
    if column in NAMES:
        return NAMES[column]
    if column.endswith("_bic"):
        return "BIC"
    if not _group(column):
        return column
    return column.split("_")[1] + ("" if said else " [mm]")


def _cell(column: str, cell: Cell) -> str:
    if isinstance(cell, str | int):
        return str(cell)
    if not np.isfinite(cell):
        return UNKNOWN
    if column == "model_error_m":
        return f"{cell:.1g}"
    if column.endswith("_m"):
        return millimetres(cell)
    return f"{cell:.2f}" if column.endswith("_bic") else significant(cell)


REPRODUCE_FORMAT = "onebend-reproduce-1"


def summary_of(outcome: study.StudyOutcome) -> dict[str, Any]:
    below, known = below_printed(outcome)
    return headed(REPRODUCE_FORMAT) | {
        "setting": asdict(outcome.setting),
        "force_scale": outcome.gain,
        "validations_below_printed": below,
        "validations_printed": known,
        "tables": {one.key: {"title": one.title, "rows": one.rows} for one in all_tables(outcome)},
    }


def write_report(folder: Path, outcome: study.StudyOutcome, figures: Mapping[str, bytes]) -> None:
    """Page and tables. `figures`: PNGs by name."""
    (folder / "report.html").write_text(page(outcome, figures), encoding="utf-8")
    (folder / "tables").mkdir(exist_ok=True)
    for table in (*all_tables(outcome), *map(stiffness_curves, outcome.beams)):
        write_table(folder / "tables" / f"{table.key}.csv", table)
