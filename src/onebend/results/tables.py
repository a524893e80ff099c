"""Tables as CSV: one header line, units in the names, `nan` for unknown numbers."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

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
    low = high = np.full(PLACES, np.nan)
    said = ["unknown"] * PLACES
    if uncertain is not None:
        band = uncertain.band(s)
        low, high, said = band.low, band.high, ["yes" if known else "no" for known in band.identified]
    header, more = ["s", "k_N_m", "k_lo_N_m", "k_hi_N_m", "identified"], np.zeros((PLACES, 0))
    if section is not None:
        modulus = modulus_band(uncertain or beam.stiffness, beam.length, section, s)
        header += ["E_Pa", "E_lo_Pa", "E_hi_Pa"]
        more = np.stack([modulus.modulus, modulus.low, modulus.high], axis=1)
    columns = zip(s, beam.stiffness(s), low, high, said, more, strict=True)
    rows = (
        [f"{place:.3f}", *map(_number, values), word, *map(_number, others)] for place, *values, word, others in columns
    )
    write_csv(path, header, rows)


def write_nuisances(path: Path, nuisances: Sequence[Nuisance]) -> None:
    """One row per nuisance: value, and sd before and after the data, in `unit`."""
    rows = ([n.name, n.unit, _number(n.value), _number(n.sd), _number(n.prior_sd)] for n in nuisances)
    write_csv(path, ["name", "unit", "value", "sd", "prior_sd"], rows)


def write_selection(path: Path, learned: Learned) -> None:
    """One row per (n, m): RMS per marker, BIC, lowest k, condition, coefficients joined by `;`."""
    tags = [f"rms_{tag}_m" for tag in learned.training.tag_id]
    header = ["n", "m", *tags, "bic", "lowest_k_N_m", "condition", "coefficients_N_m", "chosen", "why_out"]
    rows = (
        [
            trial.n,
            trial.m,
            *map(_number, trial.rms),
            _number(trial.bic),
            _number(trial.lowest_k),
            _number(trial.condition),
            ";".join(map(_number, trial.coefficients)),
            "yes" if i == learned.chosen else "no",
            trial.why_out,
        ]
        for i, trial in enumerate(learned.trials)
    )
    write_csv(path, header, rows)


def write_markers(path: Path, comparisons: Sequence[Comparison]) -> None:
    """One row per recording, frame and tag: measured, predicted, residual."""
    header = "recording,time_s,frame,tag,s,x_m,y_m,predicted_x_m,predicted_y_m,residual_x_m,residual_y_m"
    forces = ["force_x_N", "force_y_N", "push_s", "stable"]
    write_csv(
        path, [*header.split(","), *forces], (row for comparison in comparisons for row in _marker_rows(comparison))
    )


def _marker_rows(comparison: Comparison) -> Iterable[list[Any]]:
    residual = comparison.measured - comparison.predicted
    for t, frame in enumerate(comparison.frame):
        load = [
            *map(_number, comparison.force[t]),
            _number(comparison.push_s[t]),
            "yes" if comparison.stable[t] else "no",
        ]
        for i, tag in enumerate(comparison.tag_id):
            places = (*comparison.measured[t, i], *comparison.predicted[t, i], *residual[t, i])
            yield [
                comparison.name,
                f"{comparison.time[t]:.6f}",
                frame,
                tag,
                _number(comparison.marker_s[i]),
                *map(_number, places),
                *load,
            ]


def write_validation(path: Path, comparisons: Sequence[Comparison]) -> None:
    """Tables IV to VI: one row per recording and tag, with force noise and likely error."""
    header = ["recording", "frames", "tag", "s", "rms_m", "sensor_rms_m", "likely_rms_m"]
    rows = (
        [
            comparison.name,
            len(comparison.frame),
            tag,
            _number(comparison.marker_s[i]),
            _number(comparison.rms[i]),
            _number(comparison.sensor_rms[i]),
            _number(comparison.likely_rms[i]),
        ]
        for comparison in comparisons
        for i, tag in enumerate(comparison.tag_id)
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
    """Cells by `csv_cell`, Unix line ends."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv_rows(file, header, rows)


def csv_rows(stream: TextIO, header: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(map(csv_cell, row) for row in rows)
