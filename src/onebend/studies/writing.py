"""The files of a run, and its summary."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from onebend.files.manifest import write_summary
from onebend.files.renames import link_tree
from onebend.report.figures.pictures import Pictures
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
    outcome: StudyOutcome, pictures: Pictures, summary: Mapping[str, Any], work: Path, *, version: str
) -> Callable[[Path], None]:
    """What `publish` needs to fill a folder; recordings and models come there from `work`."""

    def write(folder: Path) -> None:
        (folder / "report.html").write_text(page(outcome, pictures.drawn, version=version), encoding="utf-8")
        for name in ("tables", "figures"):
            (folder / name).mkdir()
        for table in (*all_tables(outcome), *map(stiffness_curves, outcome.beams)):
            write_table(folder / "tables" / f"{table.key}.csv", table)
        pictures.write(folder / "figures")
        for name in (RECORDINGS, OBSERVED, LEARNED):
            if (work / name).exists():
                link_tree(work / name, folder / name)
        write_summary(folder, summary)

    return write
