"""Tables of numbers on disk (CSV): named columns, empty cells as NaN; errors name the line."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from onebend.errors import ObservationError, RecordingError
from onebend.recording.outline import POINTS
from onebend.records import Array, BoolArray, IntArray
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
    good = [name for name, column in cells.items() if all(_is_number(one) or _is_empty(one) for one in column)]
    return read_columns(path, (needed,), [name for name in good if name != needed], kind=kind)


def _is_empty(cell: str) -> bool:
    return cell.strip().lower() in EMPTY


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


# Curves in tables: vertices in their order from the clamp to the tip, whose places along the body nobody measured.

MOST_VERTICES = 2 * POINTS  # between which the curve is bent smoothly; of more, neighbours are averaged first
FINE = 8  # places at which each point is averaged
TOO_LONG = 1.05  # of the length: a longer curve is of another body, or in another unit
FEWEST = 4  # vertices of a curve
_SAME = 1e-6  # of the length: vertices nearer to each other are one


@dataclass(frozen=True)
class CurvePoints:
    """Points of curves in T frames at the same places along the body; NaN where a curve does not reach."""

    xy: Array  # (T, n, 2) m
    angle: Array  # (T, n) rad, of the curve there
    share: Array  # (T,) vertices that each point stands for, at least one


def curve_rows(table: Columns, otherwise: str = "") -> BoolArray:
    """(N,) rows that are vertices of curves, by their order; checked against those of points, which have an id. There
    must be some where recording.toml names no points, which `otherwise` would do."""
    order, number = np.isfinite(table.get("order")), np.isfinite(table.get("id"))
    table.refuse(order & number, "both id and order: a row is a point with an id, or a vertex of a curve.")
    table.refuse(~(order | number), "neither id nor order. A point has an id, a vertex of a curve its order.")
    for name in ("x_m", "y_m"):
        table.refuse(order & ~np.isfinite(table.get(name)), f"a vertex of a curve needs {name}.")
    if otherwise and not order.any():
        raise ObservationError(
            f"{table.path}: recording.toml names no point on the beam, and there is no curve here. Add {otherwise} "
            "with id and s, or a column order: vertices of the body's curve, numbered from the clamp to the tip."
        )
    return np.asarray(order)


def vertices_of(
    table: Columns, drawn: BoolArray, frame: IntArray, count: int, columns: tuple[str, ...] = ("x_m", "y_m")
) -> Array:
    """(T, n, c) vertices of the curve in each of `count` frames in their order, NaN behind the last; `drawn` (N,) rows
    are vertices, of frame `frame` (N,)."""
    rows = np.flatnonzero(drawn)
    rows = rows[np.lexsort((table.get("order")[rows], frame[rows]))]
    here, order = frame[rows], table.get("order")[rows]
    twice = np.zeros(len(frame), dtype=bool)
    twice[rows[1:]] = (np.diff(here) == 0) & (np.diff(order) == 0.0)
    table.refuse(twice, "its order is there twice in one curve. Number the vertices from the clamp to the tip.")
    number = np.arange(len(rows)) - np.searchsorted(here, here)
    out = np.full((count, int(number.max(initial=-1)) + 1, len(columns)), np.nan)
    out[here, number] = np.stack([table.get(name)[rows] for name in columns], axis=1)
    return out


def stated_sd(table: Columns, drawn: BoolArray, frame: IntArray, count: int, otherwise: float) -> Array:
    """(T,) m, one sd of a vertex in each of `count` frames, as sd_m says, or `otherwise`; rows as of `vertices_of`."""
    sd = np.full(count, otherwise)
    said = drawn & np.isfinite(table.get("sd_m"))
    sd[frame[said]] = table.get("sd_m")[said]
    return sd


def points_on(vertices: Array, length: float, name: str, origin: Array | None = None) -> CurvePoints:
    """Points at `outline.PLACES` of curves (T, n, 2) [m] of a body `length` m long. A curve begins at the clamp, or
    where its first vertex lies before `origin` (2,) m.

    Raises:
        ObservationError: a curve of few vertices, or longer than the body.
    """
    count = np.sum(np.isfinite(vertices).all(axis=-1), axis=1)
    if np.any((count > 0) & (count < FEWEST)):
        raise ObservationError(f"{name}: a curve of {count[(count > 0)].min()} points. Give {FEWEST} or more.")
    xy, angle = np.full((len(vertices), POINTS, 2), np.nan), np.full((len(vertices), POINTS), np.nan)
    for t in np.flatnonzero(count).tolist():
        xy[t], angle[t], end = _resampled(vertices[t, : count[t]], length, origin)
        if end > TOO_LONG:
            raise ObservationError(
                f"{name}: a curve is {1e3 * end * length:.4g} mm long, the body {1e3 * length:.4g} mm. Are x_m and "
                "y_m in metres, and do the vertices rise from the clamp to the tip? Check length_m.",
                about="unit",
            )
    return CurvePoints(xy, angle, np.maximum(count / POINTS, 1.0))


def _resampled(vertices: Array, length: float, origin: Array | None) -> tuple[Array, Array, float]:
    """(n, 2) m and (n,) rad at the places, and s of the curve's end."""
    groups = np.array_split(vertices, min(len(vertices), MOST_VERTICES))
    middle = np.stack([group.mean(axis=0) for group in groups])
    middle = middle[np.append(True, np.linalg.norm(np.diff(middle, axis=0), axis=1) > _SAME * length)]
    away = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1)))
    line = make_interp_spline(away, middle, k=min(3, len(away) - 1))
    fine = np.linspace(0.0, away[-1], 8 * len(away))
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line(fine), axis=0), axis=1)))
    lost = 0.5 * (len(groups[0]) - 1) / len(groups[0]) * away[1]  # from the first vertex to the first mean
    begin = lost if origin is None else float(np.linalg.norm(middle[0] - origin))
    s = (begin + way) / length
    asked = ((np.arange(FINE * POINTS) + 0.5) / (FINE * POINTS)).reshape(POINTS, FINE)
    near = 0.5 / POINTS
    inside = np.all((asked >= s[0] - near) & (asked <= s[-1] + near), axis=1)
    at = np.interp(asked, s, fine) + length * (np.minimum(asked - s[0], 0.0) + np.maximum(asked - s[-1], 0.0))
    tangent = line.derivative()(at).mean(axis=1)
    xy = np.where(inside[:, None], line(at).mean(axis=1), np.nan)
    return xy, np.arctan2(tangent[:, 1], tangent[:, 0]), float(s[-1])
