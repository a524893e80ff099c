"""Tables as CSV: one header line, units in the names, `nan` for unknown numbers."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.section import modulus_band
from onebend.beam.stiffness import UncertainStiffness
from onebend.learning.outcome import Comparison, Learned
from onebend.records import Array, StatedSection
from onebend.text_files import csv_cell

if TYPE_CHECKING:  # for types only: the fit loads slowly
    from onebend.learning.posterior import Nuisance

PLACES = 201  # rows of stiffness.csv


def write_stiffness(
    path: Path, beam: Beam, uncertain: UncertainStiffness | None, section: StatedSection | None = None
) -> None:
    """`s,k_N_m,k_lo_N_m,k_hi_N_m,identified`, with a section also `E_Pa,E_lo_Pa,E_hi_Pa`. Without a band (`uncertain`
    None) `identified` is `unknown`; in doubt it is `no`."""
    s = np.linspace(0.0, 1.0, PLACES)
    header = ["s", "k_N_m", "k_lo_N_m", "k_hi_N_m", "identified"]
    columns: list[Iterable[Any]] = [[f"{place:.3f}" for place in s]]
    columns += [beam.stiffness(s), *np.full((2, PLACES), np.nan), ["unknown"] * PLACES]
    if uncertain is not None:
        band = uncertain.band(s)
        columns[2:] = [band.low, band.high, band.identified]
    if section is not None:
        modulus = modulus_band(uncertain or beam.stiffness, beam.length, section, s)
        header += ["E_Pa", "E_lo_Pa", "E_hi_Pa"]
        columns += [modulus.modulus, modulus.low, modulus.high]
    write_csv(path, header, zip(*columns, strict=True))


def write_nuisances(path: Path, nuisances: Sequence[Nuisance]) -> None:
    """One row per nuisance: value, and sd before and after the data, in `unit`."""
    header = ["name", "unit", "value", "sd", "prior_sd"]
    write_csv(path, header, ([getattr(one, name) for name in header] for one in nuisances))


def write_selection(path: Path, learned: Learned) -> None:
    """One row per (n, m): RMS per marker, BIC, lowest k, condition, coefficients joined by `;`."""
    tags = [f"rms_{tag}_m" for tag in learned.training.tag_id]
    header = ["n", "m", *tags, "bic", "lowest_k_N_m", "condition", "coefficients_N_m", "chosen", "why_out"]
    rows = (
        [one.n, one.m, *one.rms, one.bic, one.lowest_k, one.condition, ";".join(map(_number, one.coefficients)),
         i == learned.chosen, one.why_out]
        for i, one in enumerate(learned.trials)
    )  # fmt: skip
    write_csv(path, header, rows)


def write_markers(path: Path, comparisons: Sequence[Comparison]) -> None:
    """One row per recording, frame and tag: measured, predicted, residual."""
    header = "recording,time_s,frame,tag,s,x_m,y_m,predicted_x_m,predicted_y_m,residual_x_m,residual_y_m"
    forces = ["force_x_N", "force_y_N", "push_s", "stable"]
    rows = (
        [one.name, f"{one.time[t]:.6f}", frame, tag, one.marker_s[i], *measured, *predicted, *(measured - predicted),
         *one.force[t], one.push_s[t], one.stable[t]]
        for one in comparisons
        for t, frame in enumerate(one.frame)
        for i, (tag, measured, predicted) in enumerate(
            zip(one.tag_id, one.measured[t], one.predicted[t], strict=True)
        )
    )  # fmt: skip
    write_csv(path, [*header.split(","), *forces], rows)


def write_validation(path: Path, comparisons: Sequence[Comparison]) -> None:
    """Tables IV to VI: one row per recording and tag, with force noise and likely error."""
    header = ["recording", "frames", "tag", "s", "rms_m", "sensor_rms_m", "likely_rms_m"]
    rows = (
        [one.name, len(one.frame), *cells]
        for one in comparisons
        for cells in zip(one.tag_id, one.marker_s, one.rms, one.sensor_rms, one.likely_rms, strict=True)
    )
    write_csv(path, header, rows)


def _number(value: float) -> str:
    """Nine significant digits; not for times, which may count from 1970."""
    return f"{float(value):.9g}"


def write_columns(path: Path, columns: Mapping[str, Array]) -> None:
    """Columns of numbers, equally long; an unknown number is an empty cell."""
    cells = ([_number(value) if np.isfinite(value) else "" for value in one.tolist()] for one in columns.values())
    write_csv(path, list(columns), zip(*cells, strict=True))


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    """Cells by `csv_cell`, flags as yes and no, Unix line ends."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(map(_cell, row) for row in rows)


def _cell(value: Any) -> object:
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    return _number(value) if isinstance(value, float) else csv_cell(value)
