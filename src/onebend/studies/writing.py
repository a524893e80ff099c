"""The files of a run, and its summary."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from onebend.results.folder import files_in, write_summary
from onebend.studies.films import OBSERVED, RECORDINGS
from onebend.studies.outcome import StudyOutcome
from onebend.studies.page import page
from onebend.studies.run import LEARNED
from onebend.studies.tables import all_tables, below_printed, stiffness_curves, write_table

REPRODUCE_FORMAT = "onebend-reproduce-1"


def summary_of(outcome: StudyOutcome, *, written_by: str) -> dict[str, Any]:
    """What `--json` prints and `summary.json` holds; SI."""
    below, known = below_printed(outcome)
    return {
        "format": REPRODUCE_FORMAT,
        "written_by": written_by,
        "setting": outcome.setting.as_dict(),
        "force_scale": outcome.gain,
        "validations_below_printed": below,
        "validations_printed": known,
        "tables": {table.key: table.as_dict() for table in all_tables(outcome)},
    }


def writer(
    outcome: StudyOutcome, figures: Mapping[str, bytes], summary: Mapping[str, Any], work: Path, *, version: str
) -> Callable[[Path], None]:
    """What `publish` needs to fill a folder; recordings and models move there from `work`, last."""

    def write(folder: Path) -> None:
        (folder / "report.html").write_text(page(outcome, figures, version=version), encoding="utf-8")
        for name in ("tables", "figures"):
            (folder / name).mkdir()
        for table in (*all_tables(outcome), *map(stiffness_curves, outcome.beams)):
            write_table(folder / "tables" / f"{table.key}.csv", table)
        for name, png in figures.items():
            (folder / "figures" / f"{name}.png").write_bytes(png)
        moved = [name for name in (RECORDINGS, OBSERVED, LEARNED) if (work / name).exists()]
        later = [f"{name}/{file}" for name in moved for file in files_in(work / name)]
        write_summary(folder / "summary.json", summary, sorted([*files_in(folder), *later]))
        for name in moved:
            (work / name).rename(folder / name)

    return write
