"""`report.html` of a run: one page that carries everything in itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from onebend.report.page.template import render
from onebend.report.wording import UNKNOWN, length_words, millimetres, significant
from onebend.studies.assumed import assumed, quick_words
from onebend.studies.outcome import StudyOutcome
from onebend.studies.tables import (
    Cell,
    ResultTable,
    below_printed,
    largest,
    manipulation_table,
    selection_table,
    stiffness_errors,
    training_table,
    validation_table,
)

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


def page(outcome: StudyOutcome, figures: Mapping[str, bytes], *, version: str) -> str:
    """The report as HTML. `figures`: PNGs by name, as `draw_figures` gives them; missing ones are left out."""
    setting = outcome.setting
    content = {
        "version": version,
        "video": setting.video,
        "seed": setting.seed,
        "quick": quick_words(setting),
        "cards": cards(outcome),
        "selections": [shown(selection_table(beam)) for beam in outcome.beams],
        "training": shown(training_table(outcome)),
        "stiffness": shown(stiffness_errors(outcome)),
        "validations": [shown(validation_table(beam)) for beam in outcome.beams],
        "manipulation": shown(manipulation_table(outcome)),
        "assumed": assumed(outcome),
        "remarks": [f"{beam.name} beam, {text}" for beam in outcome.beams for text in beam.learned.remarks],
        "files": [file for file in FILES if setting.video or not file[0].startswith("recordings")],
    }
    return render("onebend.studies", "page.html", figures, content)


def cards(outcome: StudyOutcome) -> list[dict[str, str]]:
    """The outcome in four figures."""
    below, known = below_printed(outcome)
    films = [film for beam in outcome.beams for film in beam.films[1:]]
    tasks = [done for beam in outcome.beams for done in beam.tasks if done.way == "fit"]
    reached = [done for done in tasks if done.found.converged]
    papers = [100.0 * beam.error(beam.learned.paper) for beam in outcome.beams if beam.learned.paper is not None]
    fits = [100.0 * beam.error(beam.learned.fit) for beam in outcome.beams]
    worst = largest(float(film.fit.rms[-1]) for film in films)
    floor = largest(float(film.true.rms[-1]) for film in films)
    off = largest(done.off for done in reached)
    return [
        {
            "what": "validations below the printed tip error",
            "value": f"{below} of {known}",
            "note": f"of Tables IV and V; the largest of all: {millimetres(worst)} mm, the true beam's: "
            f"{millimetres(floor)} mm",
        },
        {
            "what": "k(s) is off by",
            "value": f"{significant(min(fits), 2)} … {significant(max(fits), 2)} %",
            "note": f"the paper's method: {significant(min(papers), 2)} … {significant(max(papers), 2)} %"
            if papers
            else "the paper's method gave no beam",
        },
        {
            "what": "tasks reached in the model",
            "value": f"{len(reached)} of {len(tasks)}",
            "note": f"to {length_words(largest(done.found.error for done in reached))}",
        },
        {
            "what": "the true beam is then off by",
            "value": f"{millimetres(off)} mm",
            "note": "at most, under the same force",
        },
    ]


def shown(table: ResultTable) -> dict[str, Any]:
    """A table as the page shows it: lengths in mm, groups of columns above."""
    groups: list[dict[str, Any]] = []
    alike = not any(name.endswith("_bic") for name in table.columns)  # all of a group are mm: said once, above
    for name in table.columns:
        group = _group(name)
        group += " [mm]" if group and alike else ""
        if groups and group and groups[-1]["name"] == group:
            groups[-1]["wide"] += 1
        else:
            groups.append({"name": group, "wide": 1})
    heads = [{"name": _head(name, said=alike), "text": _is_text(table, i)} for i, name in enumerate(table.columns)]
    rows = [
        {
            "cells": [_cell(name, cell) for name, cell in zip(table.columns, row, strict=True)],
            "chosen": "ours" in str(dict(zip(table.columns, row, strict=True)).get("chosen_by", "")),
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


def _is_text(table: ResultTable, i: int) -> bool:
    return any(isinstance(row[i], str) for row in table.rows)


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
