"""`index.html` of a batch: a table to sort, a small picture of each k(s), what is unlike the others and why."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from onebend.batch.outcome import BatchOutcome
from onebend.batch.outliers import FALSE_ALARMS
from onebend.batch.record import PLACES, Record
from onebend.batch.tables import recordings_table
from onebend.escaping import one_line
from onebend.records import Array
from onebend.report.page.template import render
from onebend.report.wording import UNKNOWN, significant

LEFT_OUT = ("hash", "path", "finished", "warnings")  # columns of the Parquet table that the page does not show
WIDE, HIGH = 100.0, 60.0  # of a small picture
STEP = 4  # of PLACES: points of a small picture


def page(outcome: BatchOutcome, *, version: str) -> str:
    """The page as HTML, which carries everything in itself."""
    least, most = _range(outcome.records)
    names = sorted({item.group for item in outcome.items})
    content = {
        "version": version,
        "title": one_line(f"Batch {outcome.out.name}"),
        "cards": _cards(outcome),
        "outliers": [(one_line(item.name), why) for item, why in outcome.outliers],
        "failed": [(one_line(item.name), one_line(why)) for item, why in outcome.failed],
        "alarms": significant(200.0 * FALSE_ALARMS),
        **_table(outcome),
        "groups": [one for name in names if (one := _group(outcome, name, least, most))["pictures"]],
        "least": significant(least),
        "most": significant(most),
        "data": "{}",
    }
    return render("onebend.batch", "page.html", {}, content, scripts=("sort.js",))


def _cards(outcome: BatchOutcome) -> list[dict[str, str]]:
    learned = [one for one in outcome.records if one.k is not None]
    doubted = sum(bool(one.doubts) for one in learned)
    return [
        {"what": "learned", "value": f"{len(learned)} of {len(outcome.records)}", "note": "recordings"},
        {"what": "in doubt", "value": str(doubted), "note": "with a doubt as to all of k(s)"},
        {"what": "unlike the others", "value": str(len(outcome.outliers)), "note": "of their group"},
    ]


def _table(outcome: BatchOutcome) -> dict[str, Any]:
    table = recordings_table(outcome)
    names = [name for name in table.column_names if name not in LEFT_OUT]
    columns = [table[name].to_pylist() for name in names]
    heads = [
        {"name": one_line(name), "text": any(isinstance(cell, str) for cell in column)}
        for name, column in zip(names, columns, strict=True)
    ]
    return {"heads": heads, "rows": [[_cell(cell) for cell in row] for row in zip(*columns, strict=True)]}


def _cell(cell: Any) -> dict[str, str]:
    """What is shown, and what is sorted by."""
    if isinstance(cell, str):
        return {"words": one_line(cell), "value": one_line(cell)}
    if not np.isfinite(cell):
        return {"words": UNKNOWN, "value": ""}
    return {"words": str(cell) if isinstance(cell, int) else significant(cell), "value": repr(cell)}


def _range(records: Sequence[Record]) -> tuple[float, float]:
    """The axis of k [N m] of all pictures: every curve, and no band farther away than a factor of two."""
    curves = [one.k for one in records if one.k is not None]
    if not curves:
        return 1.0, 10.0
    every = np.concatenate(curves)
    return float(every.min()) / 2.0, float(every.max()) * 2.0


def _group(outcome: BatchOutcome, name: str, least: float, most: float) -> dict[str, Any]:
    pictures = []
    for item, one, why in zip(outcome.items, outcome.records, outcome.scores.reasons, strict=True):
        if item.group != name or one.k is None or one.low is None or one.high is None:
            continue
        s = PLACES[::STEP]
        band = [*_points(s, one.low[::STEP], least, most), *_points(s, one.high[::STEP], least, most)[::-1]]
        curve = _points(s, one.k[::STEP], least, most)
        pictures.append(
            {"name": one_line(item.name), "far": bool(why), "band": " ".join(band), "curve": " ".join(curve)}
        )
    return {"name": one_line(name), "pictures": pictures}


def _points(s: Array, k: Array, least: float, most: float) -> list[str]:
    share = np.clip(np.log(k / least) / np.log(most / least), 0.0, 1.0)
    return [f"{WIDE * x:.4g},{HIGH * (1.0 - y):.4g}" for x, y in zip(s, share, strict=True)]
