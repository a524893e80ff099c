"""Targets and goals from CSV files; every fault is named with its file and line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from onebend.control.goals.moving_goals import Between, Goals
from onebend.control.goals.targets import Targets, curve_of_length
from onebend.errors import ControlError
from onebend.records import Array
from onebend.text_files import csv_rows, listed_columns, quoted

TARGET_COLUMNS = ("s", "x_m", "y_m", "angle_rad", "weight")
GOAL_COLUMNS = ("time_s", *TARGET_COLUMNS)
MOST_GOALS = 100_000
LARGEST = 1e30  # m, rad, s
_MAY_BE_BLANK = ("x_m", "y_m", "angle_rad")


def read_targets(path: Path, length: float) -> Targets:
    """Targets from a CSV with columns of `TARGET_COLUMNS`: one row a place.

    A blank cell, or a column that is not there, is of no concern; without `weight` all count alike. Without `s` the
    rows are a curve drawn from the clamp on, and `length` [m] gives their places.

    Raises `ControlError`: no such file, unknown or missing columns, a cell that is no number, a value out of range.
    """
    table = _table(path, TARGET_COLUMNS)
    if "s" not in table:
        _need(path, table, ("x_m", "y_m"), "targets without a column s are a drawn curve")
        with _in(path):
            return curve_of_length(np.stack([table["x_m"], table["y_m"]], axis=1), length)
    with _in(path):
        return _targets(table, np.ones(len(table["s"]), dtype=bool))


def read_goals(path: Path, *, point_s: float = 1.0, between: Between = "smooth") -> Goals:
    """Goals from a CSV with columns of `GOAL_COLUMNS`: one row a place and time, the same places at every time.

    Without `s` each row is where the point at `point_s` is wanted.

    Raises `ControlError` as `read_targets`, and where a time lacks a place or times do not rise.
    """
    table = _table(path, GOAL_COLUMNS)
    _need(path, table, ("time_s",), "a path needs times")
    if "s" not in table:
        table["s"] = np.full(len(table["time_s"]), point_s)
    time, first = np.unique(table["time_s"], return_index=True)
    if np.any(np.diff(table["time_s"]) < 0.0):
        line = int(table["line"][np.argmax(np.diff(table["time_s"]) < 0.0) + 1])
        raise ControlError(f"{path}, line {line}: the times must rise; this one is earlier than that before it")
    ends = np.append(first[1:], len(table["time_s"]))
    count = int(ends[0] - first[0])
    for a, b in zip(first, ends, strict=True):
        if b - a != count or np.any(table["s"][a:b] != table["s"][:count]):
            raise ControlError(
                f"{path}, line {int(table['line'][a])}: at {table['time_s'][a]:g} s there are other places than at the "
                "first time; give the same rows of s for every time"
            )
    with _in(path):
        every = [_targets(table, _rows_of(table, a, count)) for a in first]
        xy, angle = np.stack([row.xy for row in every]), np.stack([row.angle for row in every])
        return Goals(time, every[0], xy, angle, between)


def _rows_of(table: dict[str, Array], first: int, count: int) -> Array:
    rows = np.zeros(len(table["line"]), dtype=bool)
    rows[first : first + count] = True
    return rows


def _targets(table: dict[str, Array], rows: Array) -> Targets:
    blank = np.full(int(np.sum(rows)), np.nan)
    x, y, angle = (table[name][rows] if name in table else blank for name in _MAY_BE_BLANK)
    weight = table["weight"][rows] if "weight" in table else np.ones(len(blank))
    return Targets(table["s"][rows], np.stack([x, y], axis=1), angle, weight)


@contextmanager
def _in(path: Path) -> Iterator[None]:
    """Errors of what is made of a file, with the file's name."""
    try:
        yield
    except ControlError as error:
        raise ControlError(f"{path}: {error}") from error


def _need(path: Path, table: dict[str, Array], names: tuple[str, ...], why: str) -> None:
    missing = [name for name in names if name not in table]
    if missing:
        raise ControlError(f"{path}, line 1: no column {missing[0]}; {why}")


def _table(path: Path, known: tuple[str, ...]) -> dict[str, Array]:
    """Columns by name, and `line`."""
    reader = csv_rows(path, ControlError)
    header = [cell.strip() for cell in next(reader, (1, []))[1]]
    for name in header:
        if name not in known or header.count(name) > 1:
            what = "stands twice" if name in known else "is not known"
            shown = quoted(name) if listed_columns(path, [name]) else "in its first line"
            raise ControlError(f"{path}, line 1: column {shown} {what}; the columns are {', '.join(known)}")
    rows: list[list[float]] = []
    for line, cells in reader:
        if len(rows) == MOST_GOALS:
            raise ControlError(f"{path}, line {line}: at most {MOST_GOALS} rows are read; give fewer, farther apart")
        if len(cells) != len(header):
            raise ControlError(f"{path}, line {line}: {len(cells)} cells, but {len(header)} columns")
        where = f"{path}, line {line}"
        rows.append([line, *(_number(where, n, c) for n, c in zip(header, cells, strict=True))])
    if not rows:
        raise ControlError(f"{path}: no rows; the first line names the columns ({', '.join(known)})")
    return dict(zip(["line", *header], np.array(rows).T, strict=True))


def _number(where: str, name: str, cell: str) -> float:
    if not cell.strip() and name in _MAY_BE_BLANK:
        return float("nan")
    try:
        value = float(cell)
    except ValueError as error:
        raise ControlError(f"{where}: {name} is {quoted(cell.strip())}, not a number") from error
    if not abs(value) <= LARGEST:
        raise ControlError(f"{where}: {name} is '{cell.strip()}'; leave a cell blank where it is of no concern")
    if name == "s" and not 0.0 <= value <= 1.0:
        raise ControlError(f"{where}: s is {value:g}; places are from 0 (clamp) to 1 (tip)")
    if name == "weight" and not value > 0.0:
        raise ControlError(f"{where}: weight is {value:g}; it must be positive")
    return value
