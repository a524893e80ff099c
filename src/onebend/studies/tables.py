"""The tables of a study: the paper's printed numbers beside ours. SI units; an unknown number is NaN."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import atan2, degrees, nan
from pathlib import Path
from typing import Any

import numpy as np

from onebend.learning.outcome import Trial
from onebend.results.tables import write_csv
from onebend.studies.manipulation import WAYS
from onebend.studies.outcome import BeamOutcome, StudyOutcome, ValidatedFilm, rms_or_nan
from onebend.studies.printed import PRINTED, PrintedTrial, printed_m3

Cell = float | int | str
MARKERS = ("M1", "M2", "M3")
BY = ("printed", "paper", "fit", "true")


@dataclass(frozen=True)
class ResultTable:
    """Rows under columns whose names end in their unit."""

    key: str  # of the file
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON; what is not known is null."""
        rows = [dict(zip(self.columns, map(_or_none, row), strict=True)) for row in self.rows]
        return {"title": self.title, "rows": rows}


def all_tables(outcome: StudyOutcome) -> tuple[ResultTable, ...]:
    """Tables I to VI, then what the paper says in its text alone."""
    return (
        *(selection_table(beam) for beam in outcome.beams),
        *(validation_table(beam) for beam in outcome.beams),
        training_table(outcome),
        manipulation_table(outcome),
        stiffness_errors(outcome),
    )


def selection_table(beam: BeamOutcome) -> ResultTable:
    """Tables I to III: every (n, m) by the paper's method on the training push."""
    said = PRINTED[beam.name]
    printed = {(row.n, row.m): row for row in said.trials or ()}
    rows: list[tuple[Cell, ...]] = []
    for i, trial in enumerate(beam.learned.trials):
        there = printed.get((trial.n, trial.m))
        who = (("paper", (trial.n, trial.m) == said.chosen), ("ours", i == beam.learned.chosen))
        chosen = [name for name, it_is in who if it_is]
        rows.append((trial.n, trial.m, *_printed(there), *_ours(trial), " and ".join(chosen), trial.why_out))
    return ResultTable(
        f"table-{said.selection_table}",
        f"Table {said.selection_table}: RMS of errors of the {beam.name} beam",
        ("n", "m", *_named("printed"), "printed_bic", *_named("ours"), "ours_bic", "chosen_by", "out_because"),
        tuple(rows),
    )


def _printed(row: PrintedTrial | None) -> tuple[float, ...]:
    return (nan,) * 4 if row is None else (*row.rms, row.bic)


def _ours(trial: Trial) -> tuple[float, ...]:
    return (*map(float, trial.rms), trial.bic if np.isfinite(trial.bic) else nan)


def _named(by: str) -> tuple[str, ...]:
    return tuple(f"{by}_{marker}_m" for marker in MARKERS)


def validation_table(beam: BeamOutcome) -> ResultTable:
    """Tables IV to VI: each other push; printed, the paper's method, the fit, and the true beam."""
    said = PRINTED[beam.name]
    printed = dict(said.validation or ())
    unknown = (nan,) * 3
    rows: list[tuple[Cell, ...]] = [
        (film.strategy.says, *printed.get(film.strategy.name, unknown), *_three(film)) for film in beam.films[1:]
    ]
    return ResultTable(
        f"table-{said.validation_table}",
        f"Table {said.validation_table}: RMS of errors, validation set of the {beam.name} beam",
        ("strategy", *(name for by in BY for name in _named(by))),
        tuple(rows),
    )


def _three(film: ValidatedFilm) -> tuple[float, ...]:
    return tuple(float(v) for each in (film.paper, film.fit, film.true) for v in rms_or_nan(each))


def training_table(outcome: StudyOutcome) -> ResultTable:
    """The training push: the chosen row of Tables I to III beside the fit."""
    rows: list[tuple[Cell, ...]] = []
    for beam in outcome.beams:
        said = PRINTED[beam.name]
        printed = {(row.n, row.m): row.rms for row in said.trials or ()}.get(said.chosen, (nan,) * 3)
        fitted = map(float, beam.learned.fitted_rms)
        rows.append((beam.name, *printed, *_three(beam.films[0]), *fitted))
    columns = ("beam", *(name for by in (*BY, "fitted") for name in _named(by)))
    return ResultTable("training", "The training push", columns, tuple(rows))


def manipulation_table(outcome: StudyOutcome) -> ResultTable:
    """Section V-C: the six tasks; the error within the model, and of the true beam under the same force."""
    rows: list[tuple[Cell, ...]] = []
    for beam in outcome.beams:
        for done in beam.tasks:
            force = done.found.force
            rows.append(
                (
                    beam.name,
                    f"{done.task.name}, s = {done.task.s:g}",
                    WAYS[done.way],
                    *map(float, done.goal),
                    float(np.hypot(*force)),
                    degrees(atan2(force[1], force[0])),
                    done.found.iterations,
                    done.found.error,
                    done.off,
                    "" if done.found.converged else done.found.reason,
                )
            )
    columns = ("beam", "point", "way", "goal_x_m", "goal_y_m", "force_N", "force_deg", "iterations", "model_error_m")
    return ResultTable(
        "manipulation", "The six manipulation tasks", (*columns, "true_error_m", "not_reached_because"), tuple(rows)
    )


def stiffness_errors(outcome: StudyOutcome) -> ResultTable:
    """How far k(s) is from the truth as the force's scale shows it, and whether the band holds it."""
    rows: list[tuple[Cell, ...]] = []
    for beam in outcome.beams:
        paper = beam.learned.paper
        chosen = None if beam.learned.chosen is None else beam.learned.trials[beam.learned.chosen]
        rows.append(
            (
                beam.name,
                "n = {}, m = {}".format(*PRINTED[beam.name].chosen),
                "none" if chosen is None else f"n = {chosen.n}, m = {chosen.m}",
                nan if paper is None else 100.0 * beam.error(paper),
                100.0 * beam.error(beam.learned.fit),
                100.0 * beam.inside,
            )
        )
    columns = ("beam", "printed_choice", "ours_choice", "paper_log_k_rms_percent", "fit_log_k_rms_percent")
    return ResultTable("stiffness", "k(s) against the truth", (*columns, "band_holds_percent"), tuple(rows))


def stiffness_curves(beam: BeamOutcome) -> ResultTable:
    """k(s) at 201 places [N m]."""
    s = np.linspace(0.0, 1.0, 201)
    band, paper = beam.learned.uncertain.band(s), beam.learned.paper
    columns = [
        s,
        np.asarray(beam.design.beam().stiffness(s)),
        np.asarray(beam.true.stiffness(s)),
        np.full(len(s), nan) if paper is None else np.asarray(paper.stiffness(s)),
        band.k,
        band.low,
        band.high,
    ]
    names = ("s", "true_k_N_m", "true_k_as_logged_N_m", "paper_k_N_m", "fit_k_N_m", "fit_lo_N_m", "fit_hi_N_m")
    rows = tuple(tuple(float(value) for value in row) for row in zip(*columns, strict=True))
    return ResultTable(f"stiffness-{beam.name}", f"k(s) of the {beam.name} beam", names, rows)


def write_table(path: Path, table: ResultTable) -> None:
    """Nine significant digits; `nan` where a figure is not known."""
    write_csv(path, table.columns, ([_text(cell) for cell in row] for row in table.rows))


def _text(cell: Cell) -> str:
    return f"{cell:.9g}" if isinstance(cell, float) else str(cell)


def _or_none(cell: Cell) -> Cell | None:
    return None if isinstance(cell, float) and not np.isfinite(cell) else cell


def below_printed(outcome: StudyOutcome) -> tuple[int, int]:
    """In how many validations that the paper prints the fit's error at the tip is below the printed one, and of how
    many."""
    films = [(film, printed_m3(beam.name, film.strategy.name)) for beam in outcome.beams for film in beam.films[1:]]
    known = [(film.fit.rms[-1], printed) for film, printed in films if printed is not None]
    return sum(bool(ours < printed) for ours, printed in known), len(known)


def largest(values: Iterable[float]) -> float:
    """The largest that is known; NaN where none is."""
    known: Sequence[float] = [value for value in values if np.isfinite(value)]
    return max(known, default=nan)
