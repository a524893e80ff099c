"""The files of a population and its summary."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from onebend.files.arrow import as_csv, as_parquet
from onebend.files.manifest import write_summary
from onebend.population.outcome import PopulationOutcome
from onebend.population.page import page
from onebend.population.tables import tables
from onebend.report.figures.pictures import Pictures

POPULATION_FORMAT = "onebend-population-1"


def summary_of(outcome: PopulationOutcome, *, written_by: str) -> dict[str, Any]:
    """What `--json` prints and `summary.json` holds."""
    named, judged = outcome.named, outcome.judgement
    trial = named.trial
    return {
        "format": POPULATION_FORMAT,
        "written_by": written_by,
        "by": outcome.setting.by,
        "object": outcome.setting.same,
        "wished_half_band": outcome.setting.wished,
        "groups": [
            {
                "group": name,
                "objects": int(np.sum(trial.group_of == i)),
                "half_band": float(np.expm1(outcome.half[i])),
                "objects_needed": outcome.needed[i],
                "next_object_inside": None if outcome.next_inside is None else float(outcome.next_inside[i]),
            }
            for i, name in enumerate(named.groups)
        ],
        "spread": {name: vars(one) for name, one in vars(outcome.shares).items()},
        "outliers": [
            {"object": name, "reason": why} for name, why in zip(named.objects, outcome.outliers, strict=True) if why
        ],
        "tolerance": None
        if judged is None
        else {
            "passed": int(judged.passed.sum()),
            "objects": trial.objects,
            "false_passes": judged.false_passes,
            "false_fails": judged.false_fails,
        },
        "left_out": [{"recording": name, "reason": why} for name, why in named.left_out],
    }


def writer(
    outcome: PopulationOutcome, pictures: Pictures, summary: Mapping[str, Any], *, name: str, version: str
) -> Callable[[Path], None]:
    """What `publish` needs to fill a folder."""

    def write(folder: Path) -> None:
        for key, table in tables(outcome).items():
            (folder / f"{key}.parquet").write_bytes(as_parquet(table))
            (folder / f"{key}.csv").write_bytes(as_csv(table))
        (folder / "report.html").write_text(page(outcome, pictures.drawn, name=name, version=version), encoding="utf-8")
        write_summary(folder, summary)

    return write
