"""A force log on disk, read and checked: a CSV file with one row per sample."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from onebend.errors import RecordingError
from onebend.escaping import is_number
from onebend.recording.dropped_samples import false_zeros, held, missing_remarks
from onebend.recording.force import franka
from onebend.recording.force.implausible_force import at_its_end, still_columns, unit_in_name
from onebend.recording.signals import LATEST, check_span
from onebend.records import Array, ForceLog, Remark
from onebend.text_files import csv_rows, listed_columns, quoted

FEWEST_ROWS = 10
STRONGEST = 1e6  # N, or counts: more no sensor says
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
TWICE = "rows of the force log repeat a time; their mean is taken"
LOST = (
    "rows of the force log are exactly zero amid others (a robot that did not stream, or near a singularity) and are "
    "left out"
)
HUNG = "rows of the force log only repeat the row before, for long (the sensor or the logger hung), and are left out"
MANY = 0.1  # of the rows: if more are left out or share a time, it is a warning


def read_force_log(
    path: Path | str,
    columns: Sequence[str],
    push_column: str = "",
    *,
    time_unit: Literal["s", "ms", "us", "ns"] = "s",
) -> ForceLog:
    """Read a CSV force log: a header, then one row a sample.

    `columns` names time [`time_unit`] and two forces [N]; `push_column`, where not empty, the place of the push.
    Rows with an empty or infinite entry or NaN are left out, rows of one time become their mean; a remark says how
    many.

    Raises:
        RecordingError: unreadable, a missing column (those found are listed), text instead of a number, times that
            fall, too few rows, a force that is zero throughout; with the line.
    """
    path = Path(path)
    if unit_advice := unit_in_name(columns, time_unit):
        raise RecordingError(f"{path}: {unit_advice}.")
    wanted = [*columns, *([push_column] if push_column else [])]
    lines: list[int] = []
    table: list[list[float]] = []
    for line, values in numbers(path, wanted):
        lines.append(line)
        table.append(values)
    read = np.array(table).reshape(-1, len(wanted))
    for name, column in zip(wanted, read.T, strict=True):
        if len(read) and not np.isfinite(column).any():
            raise RecordingError(f"{path}: the column {name} holds no number in any row. Is it the right one?")
    read[:, 0] *= TIME_UNITS[time_unit]
    refuse_absurd(path, wanted, read, lines)
    full = np.isfinite(read).all(axis=1)
    check_times(path, read[full, 0], np.array(lines, dtype=int)[full])
    return whole_log(str(path), read)


def refuse_absurd(path: Path, wanted: Sequence[str], read: Array, lines: Sequence[int]) -> None:
    """Raise where a number of the rows (N, c) is finite, but neither a time nor a force of this world."""
    for i, (name, most) in enumerate(zip(wanted, (LATEST, STRONGEST, STRONGEST, STRONGEST), strict=False)):
        absurd = np.isfinite(read[:, i]) & (np.abs(read[:, i]) > most)
        if absurd.any():
            row = int(np.argmax(absurd))
            said = f"{name} is {read[row, i]:.3g}, more than {most:g}"
            raise RecordingError(f"{path}, line {lines[row]}: {said}. Correct or remove the line.")


def whole_log(where: str, read: Array, remarks: tuple[Remark, ...] = ()) -> ForceLog:
    """The log from rows (N, 3 or 4) of time, two forces and perhaps the place of the push; times do not fall.

    Raises:
        RecordingError: too few rows are left, or every force is zero.
    """
    full = np.isfinite(read).all(axis=1)
    zeros = false_zeros(read[full, 1:3])
    measured = read[full][~zeros]
    hung = held(measured[:, 0], measured[:, 1:3])
    data = one_row_a_time(measured[~hung])
    if len(data) < FEWEST_ROWS:
        raise RecordingError(
            f"{where} holds {len(data)} rows of numbers with times of their own; at least {FEWEST_ROWS} are needed. "
            "Was the log cut short?"
        )
    check_span(data[:, 0], where)
    if not np.any(data[:, 1:3]):
        raise RecordingError(f"{where}: every force is zero: the sensor was not streaming. Record the push again.")
    if not np.ptp(data[:, 1:3], axis=0).any():
        raise RecordingError(
            f"{where}: neither force ever changes: the sensor was not streaming. Record the push again."
        )
    remarks = (
        *remarks,
        *remark(int(np.sum(~full)), len(read), "rows of the force log hold no number (empty or NaN) and are left out"),
        *remark(int(np.sum(zeros)), len(read), LOST),
        *remark(int(np.sum(hung)), len(read), HUNG),
        *missing_remarks(data[:, 0], "rows of the force log"),
        *remark(len(hung) - int(np.sum(hung)) - len(data), len(read), TWICE),
        *still_columns(data[:, 1:3]),
        *at_its_end(data[:, 1:3]),
    )
    push_s = data[:, 3] if data.shape[1] > 3 else None
    return ForceLog(time=data[:, 0], force=data[:, 1:3], push_s=push_s, remarks=remarks)


def numbers(path: Path, wanted: Sequence[str]) -> Iterator[tuple[int, list[float]]]:
    """Line number and the wanted numbers of every row that is not empty; NaN for an empty cell."""
    rows = csv_rows(path, RecordingError)
    header = [name.strip() for name in next(rows, (1, []))[1]]
    if not header:
        raise RecordingError(f"{path} is empty. Record the push again, or correct [force] file in recording.toml.")
    twice = [name for name in wanted if header.count(name) > 1]
    if twice:
        raise RecordingError(f"{path}, line 1: the column {twice[0]} is there twice. Remove or rename one.")
    missing = [name for name in wanted if name not in header]
    if missing:
        hint_of_robot = franka.hint(header)
        hint = header_hint(header, wanted)
        there = listed_columns(path, header)
        raise RecordingError(
            f"{path}, line 1: no column {', '.join(missing)}{there and '; '}{there}.{hint} "
            f"Name the columns with columns in [force], or column in [push], of recording.toml.{hint_of_robot}"
        )
    places = [header.index(name) for name in wanted]
    for line, row in rows:
        values = []
        for name, index in zip(wanted, places, strict=True):
            cell = row[index].strip() if index < len(row) else ""
            try:
                values.append(float(cell) if cell else math.nan)
            except ValueError:
                raise RecordingError(
                    f"{path}, line {line}: {name} is {quoted(cell)}, not a number. Correct or remove the line."
                ) from None
        yield line, values


def header_hint(header: Sequence[str], wanted: Sequence[str]) -> str:
    """The probable mistake of a header that lacks wanted columns: a sentence after a space, or ""."""
    if len(header) == 1 and set(header[0]) & set(";\t"):
        return " Columns must be separated by commas, and decimals written with a point."
    if all(is_number(name) for name in header if name):
        return f" The first line holds numbers: write the header {','.join(wanted)} above it."
    if header[0].startswith("#"):
        return " The header must be the first line: remove the lines above it."
    return ""


def check_times(path: Path, time: Array, lines: Array) -> None:
    """Raise where a time falls."""
    wrong = np.flatnonzero(np.diff(time) < 0)
    if not len(wrong):
        return
    i = int(wrong[0])
    count = f" ({len(wrong)} such lines)" if len(wrong) > 1 else ""
    raise RecordingError(
        f"{path}, line {lines[i + 1]}: the time {time[i + 1]:.6g} s is before that of line {lines[i]} "
        f"({time[i]:.6g} s){count}. Times must rise: sort the file, or cut it where a second log begins."
    )


def one_row_a_time(data: Array) -> Array:
    """The mean of the rows (N, c) that share a time; times do not fall."""
    begins = np.flatnonzero(np.diff(data[:, 0], prepend=-np.inf) > 0)
    if len(begins) == len(data):
        return data
    count = np.diff(np.append(begins, len(data)))
    return np.asarray(np.add.reduceat(data, begins, axis=0) / count[:, None])


def remark(count: int, rows: int, what: str) -> tuple[Remark, ...]:
    """Nothing, a note or a warning on `count` of the rows."""
    if not count:
        return ()
    if count <= MANY * rows:
        return (Remark("note", f"{count} of {rows} {what}.", about="bad rows"),)
    return (Remark("warning", f"{count} of {rows} {what}. Check the logger, and record again.", about="bad rows"),)
