"""The files of a rehearsal: a figure, a table along the beam, and all of it as JSON."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from onebend.files.manifest import write_summary
from onebend.forecast.rehearsal import MEDIAN, NINETY, Rehearsal
from onebend.learning.design.proposals import PLACES
from onebend.report.figures.pictures import Pictures
from onebend.results.tables import write_csv

REHEARSE_FORMAT = "onebend-rehearse-1"
COLUMNS = (
    "s",
    "k_N_m",
    "predicted_sd",
    "predicted_median",
    "predicted_90",
    "predicted_identified",
    "obtained_sd",
    "obtained_median",
    "obtained_90",
    "obtained_identified",
    "coverage",
)


def summary_of(rehearsal: Rehearsal, *, written_by: str) -> dict[str, Any]:
    """What `--json` prints, and `summary.json` holds."""
    return {"format": REHEARSE_FORMAT, "written_by": written_by, **rehearsal.as_dict()}


def writer_of(rehearsal: Rehearsal, pictures: Pictures, *, written_by: str) -> Callable[[Path], None]:
    """What `publish` needs to fill a folder."""

    def write(folder: Path) -> None:
        write_table(folder / "rehearsal.csv", rehearsal)
        pictures.write(folder)
        runs = [run.as_dict() for run in rehearsal.runs]
        whole = {**summary_of(rehearsal, written_by=written_by), "runs": runs}
        write_summary(folder, whole)

    return write


def write_table(path: Path, rehearsal: Rehearsal) -> None:
    """A row a place; sizes are of log k, empty where nothing was simulated."""
    p, o = rehearsal.predicted, rehearsal.obtained
    columns = [PLACES, p.k, p.sd, MEDIAN * p.error, NINETY * p.error, p.identified]
    unknown = np.full(len(PLACES), np.nan)
    columns += [unknown] * 5 if o is None else [o.sd, o.median, o.ninety, o.identified, o.coverage]
    write_csv(path, COLUMNS, ([_cell(value) for value in row] for row in zip(*columns, strict=True)))


def _cell(value: Any) -> str:
    if isinstance(value, np.bool_):
        return str(bool(value)).lower()
    return f"{value:.6g}" if np.isfinite(value) else ""
