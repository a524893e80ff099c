"""Tables of numbers on disk (CSV): named columns, empty cells as NaN; errors name the line."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from onebend.errors import RecordingError
from onebend.records import Array, IntArray
from onebend.text_files import QUOTED, csv_rows, listed_columns, quoted

EMPTY = ("", "nan", "na", "n/a", "-")  # a cell that holds no number
LARGEST = 1e30  # of a number: nothing that is measured is larger, and squares stay numbers


@dataclass(frozen=True)
class Columns:
    """Columns of one table, all of one length; `rows` are their numbers in the file, for messages."""

    path: Path
    rows: IntArray  # (N,)
    numbers: dict[str, Array]  # (N,) each; NaN where the cell is empty
    labels: dict[str, tuple[str, ...]]  # (N,) each

    def get(self, name: str) -> Array:
        """(N,) a column, NaN throughout where the table lacks it."""
        return self.numbers.get(name, np.full(len(self.rows), np.nan))

    def refuse(self, wrong: np.ndarray, text: str) -> None:
        """Raise `RecordingError` with the first row where `wrong` (N,)."""
        if np.any(wrong):
            row = int(self.rows[int(np.argmax(wrong))])
            raise RecordingError(f"{self.path}, line {row}: {text}")


def read_columns(
    path: Path,
    needed: Sequence[str],
    known: Sequence[str] = (),
    *,
    labels: Sequence[str] = (),
    kind: str = "table",
    unknown: Sequence[str] = (),
    strict: bool = False,
    advice: Callable[[list[str]], str] = lambda _: "Name the columns in the first line as docs/recording.md does.",
    endless: bool = False,
) -> Columns:
    """The columns `needed`, those of `known` that are there, and the text columns `labels` (needed, too).

    Other columns are ignored; where `strict`, only those without a number. `kind` names the table in messages. In the
    columns `unknown` that word may stand for a number, and becomes infinity. `advice` is what to do where a column is
    missing, by the header; with `endless` an infinite number is none."""
    cells, rows = _csv(path, (*labels, *needed, *known))
    missing = [name for name in (*labels, *needed) if name not in cells]
    if missing:
        there = listed_columns(path, cells)
        raise RecordingError(
            f"{path}, line 1: no column {', '.join(missing)}{there and '; '}{there}. {advice(list(cells))}"
        )
    if not len(rows):
        raise RecordingError(f"{path}: the {kind} has no rows. Was it cut short?")
    if strict:
        _refuse_others(path, cells, (*labels, *needed, *known), kind)
    wanted = [name for name in (*needed, *known) if name in cells]
    numbers = {name: _numbers(path, name, cells[name], rows, name in unknown, endless) for name in wanted}
    return Columns(path, rows, numbers, {name: tuple(cell.strip() for cell in cells[name]) for name in labels})


def read_every_column(path: Path, needed: str, *, kind: str = "table") -> Columns:
    """All columns that hold nothing but numbers and empty cells; `needed` must be one of them."""
    cells, _ = _csv(path)
    numbers = {name: all(_is_number(one) or one.strip().lower() in EMPTY for one in cells[name]) for name in cells}
    return read_columns(path, (needed,), [name for name in cells if numbers[name] and name != needed], kind=kind)


def _refuse_others(path: Path, cells: dict[str, list[str]], known: Sequence[str], kind: str) -> None:
    """An error where a column that is not known holds numbers: it is probably misnamed, or in another unit."""
    for name in (name for name in cells if name not in known):
        if any(_is_number(cell) for cell in cells[name]):
            similar = difflib.get_close_matches(name[:QUOTED], known, n=1, cutoff=0.5)
            hint = f"did you mean {similar[0]}? " if similar else ""
            raise RecordingError(
                f"{path}: the {kind} has numbers in a column {name[:QUOTED]}, which is not known: {hint}Known are "
                f"{', '.join(known)}, in these units. Rename it, or take it out."
            )


def _is_number(cell: str) -> bool:
    try:
        return float(cell) == float(cell)
    except ValueError:
        return False


def _csv(path: Path, once: Sequence[str] = ()) -> tuple[dict[str, list[str]], IntArray]:
    """Cells by column, empty lines left out, and the line of each row; the columns `once` must not stand twice."""
    lines, rows = [], []
    for line, row in csv_rows(path, RecordingError):
        lines.append(line)
        rows.append(row)
    if not rows:
        raise RecordingError(f"{path} is empty. Write it anew, or correct its name.")
    header = [name.strip() for name in rows[0]]
    if len(header) == 1 and set(header[0]) & set(";\t"):
        raise RecordingError(
            f"{path}, line 1: columns must be separated by commas, and decimals written with a point; no semicolons."
        )
    its_own = bool(set(once) & set(header))  # else it is no such table, and that is told
    for line, row in zip(lines, rows, strict=True):
        if its_own and any(cell.strip() for cell in row[len(header) :]):
            raise RecordingError(
                f"{path}, line {line}: {len(row)} cells, but the header names {len(header)} columns. Write decimals "
                "with a point, and a name above each column."
            )
    twice = [name for name in once if header.count(name) > 1]
    if twice:
        raise RecordingError(f"{path}, line 1: the column {quoted(twice[0])} is there twice. Remove or rename one.")
    body = [row + [""] * (len(header) - len(row)) for row in rows[1:]]
    return {name: [row[i] for row in body] for i, name in enumerate(header) if name}, np.array(lines[1:], dtype=int)


def _numbers(path: Path, name: str, cells: list[str], rows: IntArray, unknown: bool, endless: bool) -> Array:
    numbers = np.full(len(cells), np.nan)
    words = np.zeros(len(cells), dtype=bool)  # cells that say that a number is unknown
    for i, cell in enumerate(cells):
        word = cell.strip().lower()
        if word in EMPTY:
            continue
        try:
            words[i] = unknown and word == "unknown"
            numbers[i] = np.nan if words[i] else float(word)
        except ValueError:
            raise RecordingError(
                f"{path}, line {rows[i]}: {name} is {quoted(cell)}, not a number. Correct it, or leave the cell empty."
            ) from None
    if endless:
        numbers[np.isinf(numbers)] = np.nan
    elif (huge := np.abs(numbers) > LARGEST).any():
        where = f"{path}, line {rows[int(np.argmax(huge))]}: {name}"
        raise RecordingError(f"{where} is infinite, or beyond {LARGEST:g}. Leave it empty where unknown.")
    return np.where(words, np.inf, numbers)
