"""A force log on disk, read and checked: a CSV file with one row per sample."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from onebend.errors import ObservationError, RecordingError
from onebend.recording.signals import LATEST, check_span, false_zeros, held, missing_remarks, runs, step, within_noise
from onebend.recording.tables import read_columns
from onebend.records import Array, ForceLog, IntArray, Remark
from onebend.text_files import is_number

# O_F_ext_hat_K[0], field.O_F_ext_hat_K0, state.K_F_ext_hat_K_0, .../wrench/force/x, field.wrench.force.x, ...
ESTIMATE = re.compile(r"^(?:.*[./ ])?([OK]_F_ext_hat_K)[\[_.]?(\d)\]?$", re.IGNORECASE)
VECTOR = re.compile(r"^(.*force[./_ ]?|f[_ ]?)([xyz])([_ \[(/].*)?$", re.IGNORECASE)  # and fx_N, Force X (N), ...
TIMES = {"%time": "ns", "field.header.stamp": "ns", "time": "ms", "timestamp": "", "stamp": "", "t": "", "__time": "s"}


def likely_forces(header: Sequence[str]) -> tuple[str, str] | None:
    """The columns of the force along x and y, the base's axes before the tool's."""
    sets: dict[str, dict[str, str]] = {}
    for name in header:
        if match := ESTIMATE.match(name):
            sets.setdefault("0" if match[1][0] in "Oo" else "1", {})[match[2]] = name
        elif match := VECTOR.match(name):
            sets.setdefault(f"2{match[1]}", {})[str("xyz".index(match[2].lower()))] = name
    for _, columns in sorted(sets.items()):
        if "0" in columns and "1" in columns:
            return columns["0"], columns["1"]
    return None


AXES = ("first", "second")
BENT, MOVES = 0.3, 0.05  # of the largest bending: from where on, and by how much, a beam moves under another force
FINE = 0.02  # of what a column ranges over: with coarser digits it stands still while the force changes
LARGEST, SMALLEST = 100.0, 5e-3  # N: a soft beam bends under less, and sensors for it do not resolve so little
TOO_MANY_WEIGHTS, TOO_FEW_WEIGHTS = 700.0, 0.01  # a rod of carbon fibre bends under some hundred times its weight
OF_WEIGHT = 50.0  # times the beam's weight; the force that bends a soft beam is near its weight
OTHER_UNIT = re.compile(r"[_\s\[(/](mN|kN|uN|g|gf|kg|kgf|lbf?|ozf?|counts|V|mV)[\])]?$")
OTHER_TIME = re.compile(r"[_\s\[(/](ms|us|ns)[\])]?$")


def still_columns(force: Array) -> tuple[Remark, ...]:
    """A warning for each column of the forces (N, 2) that never changes."""
    sentence = "The {} force of the log never changes ({:g} N): is its channel connected? Check columns."
    return tuple(
        Remark("warning", sentence.format(axis, column[0]), about="constant force")
        for axis, column in zip(AXES, force.T, strict=True)
        if np.ptp(column) == 0.0
    )


def at_its_end(force: Array, bent: Array | None = None) -> tuple[Remark, ...]:
    """A warning for each column of the forces (N, 2) that often takes its own largest or smallest value.

    A sensor at the end of its range repeats one number; a measured force scatters about its largest one. Columns
    without visible noise repeat numbers anyway: these are judged where it is known how far the beam is `bent` (N,) of
    its largest, and only where it goes on moving.
    """
    remarks, loaded = [], np.ones(len(force), dtype=bool) if bent is None else bent > BENT
    for axis, column in zip(AXES, force.T, strict=True):
        values, counts = np.unique(column, return_counts=True)
        for end, index, inward in (("largest", -1, -2), ("smallest", 0, 1)):
            # A hundredth of the rows, three times as many as at the next value, and five: fewer are chance.
            at_extreme = loaded & (column == values[index])
            count = int(np.sum(at_extreme))
            if len(values) < 3 or count < max(0.01 * len(column), 3.0 * counts[inward], 5):
                continue
            stands = runs(at_extreme)
            alone = sum(end - begin == 1 for begin, end in stands)
            clear = within_noise(column[~at_extreme])
            if bent is not None:
                fine = float(np.min(np.diff(values))) < FINE * float(np.ptp(column))
                clear = not clear and fine and max(float(np.ptp(bent[a:b])) for a, b in stands) > MOVES
            if 2 * alone < count and clear:  # spikes are alone
                text = (
                    f"The {axis} force of the log stands at exactly its {end} value, {values[index]:g} N, in "
                    f"{100 * count / len(column):.0f} % of its rows: the sensor is at the end of its range, and the "
                    "force was larger. k(s) comes out wrong; push less, or take a wider range."
                )
                remarks.append(Remark("warning", text, doubt=True, about="sensor's end"))
    return tuple(remarks)


UNITS = {  # by where a force comes from: what is asked where it seems too large, and too small
    "log": ("is the log in millinewtons, grams or counts?", "is the log in kilonewtons, or a force in kilograms?"),
    "loads": ("is mass_kg of the loads in grams, or weight_N in grams?", "is weight_N in kilograms?"),
}


def refuse_other_unit(force: Array, mass: float, where: str, source: Literal["log", "loads"] = "log") -> None:
    """`ObservationError` with the fitting unit where the forces (N, 2) [N] are a thousand times off what bends a soft
    beam of `mass` [kg; NaN: unknown]."""
    largest = float(np.max(np.linalg.norm(force, axis=1), initial=0.0))
    weights = largest / (9.81 * mass) if mass > 0 else math.nan
    times = f", {weights:.3g} times the beam's weight" if mass > 0 else ""
    small = 0.0 < largest < SMALLEST and weights < TOO_FEW_WEIGHTS
    if small or largest > 500.0 or weights > TOO_MANY_WEIGHTS:  # N: what a person could not hold bends no soft beam
        raise ObservationError(
            f"{where}: the largest force on the beam is {largest:.3g} N{times}: {UNITS[source][small]} Convert it; "
            "else all of k(s) is wrong by the same factor. If the force is right, correct mass_kg in [beam].",
            about="force unit",
        )


def size_remarks(force: Array, mass: float, source: Literal["log", "loads"] = "log") -> tuple[Remark, ...]:
    """A warning where the forces (N, 2) [N] on a beam of `mass` [kg; NaN: unknown] seem to be in another unit."""
    largest = float(np.max(np.linalg.norm(force, axis=1), initial=0.0))
    heavy = largest / (9.81 * mass) if mass > 0 else 0.0
    small = 0.0 < largest < SMALLEST
    if not (small or largest > LARGEST or heavy > OF_WEIGHT):
        return ()
    times = f", {heavy:.0f} times the beam's weight" if heavy > OF_WEIGHT else ""
    text = f"The largest force on the beam is {largest:.3g} N{times}: {UNITS[source][small]}"
    return (Remark("warning", f"{text} If so, all of k(s) is wrong by the same factor.", about="force unit"),)


SENSOR_NOISE = {"franka-estimate": 0.035}  # N RMS at rest, by the maker's data sheet
OTHER_NOISE = 5.0  # times a sensor's noise, or one over it: sensors of one kind differ by less
WHITE = 0.5  # of the noise's variance in its differences: what has less was filtered, and is quiet for that
STILL = 0.5  # s: within such a span at rest a force has no drift
STILLEST = 0.2  # of these spans that are surely at rest


def noise_remarks(log: ForceLog, sensor: str, stated: float) -> tuple[Remark, ...]:
    """A doubt where the log is far quieter or louder at rest than its sensor, whose noise [N] is `stated` or known by
    its name: a log in kilograms is 9.8 times quieter, one in grams 102 times louder."""
    usual = stated if stated > 0.0 else SENSOR_NOISE.get(sensor, math.nan)
    rows = round(STILL / step(log.time))
    if not usual > 0.0 or rows < 8 or len(log.time) < 4 * rows:
        return ()
    spans = log.force[: len(log.force) // rows * rows].reshape(-1, rows, 2)
    fast = spans - np.mean(spans, axis=1, keepdims=True)
    sds = np.sqrt(np.mean(fast**2, axis=(1, 2)))
    still = sds <= np.quantile(sds, STILLEST)
    sd = float(np.max(sds[still]))
    white = 0.5 * np.mean(np.diff(fast[still], axis=1) ** 2) > WHITE * np.mean(fast[still] ** 2)
    if sd < usual * OTHER_NOISE and (sd > usual / OTHER_NOISE or not white):
        return ()
    whose = "white_sd_N" if stated > 0.0 else sensor
    unit = "kilograms" if sd < usual else "grams or millinewtons"
    text = (
        f"At rest the force scatters by {sd:.2g} N, which is {sd / usual:.3g} times what {whose} says "
        f"({usual:.2g} N): is the log in {unit}? If so, all of k(s) is wrong by the same factor. If it is in newtons, "
        "correct sensor or white_sd_N in [force]."
    )
    return (Remark("warning", text, doubt=True, about="force unit"),)


def unit_in_name(columns: Sequence[str], time_unit: str) -> str:
    """What to do about columns (time, two forces) whose own names give another unit; "" where none does."""
    time, *forces = columns
    if (match := OTHER_TIME.search(time)) and match[1] != time_unit:
        return f'the column {time} is in {match[1]} by its name: write time_unit = "{match[1]}" in [force]'
    for name in forces:
        if match := OTHER_UNIT.search(name):
            return f"the column {name} is in {match[1]} by its name: convert it to newtons, and name it so"
    return ""


FEWEST_ROWS = 10  # a guard, and no limit of the method
STRONGEST = 1e6  # N, or counts: more no sensor says
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
TWICE = "rows of the force log repeat a time; their mean is taken"
LOST = (
    "rows of the force log are exactly zero amid others (a robot that did not stream, or near a singularity) and are "
    "left out"
)
HUNG = "rows of the force log only repeat the row before, for long (the sensor or the logger hung), and are left out"


def read_force_log(
    path: Path | str,
    columns: Sequence[str],
    push_column: str = "",
    *,
    time_unit: Literal["s", "ms", "us", "ns"] = "s",
) -> ForceLog:
    """Read a CSV force log: a header, then one row a sample.

    `columns` names time [`time_unit`] and two forces [N]; `push_column`, where not empty, the place of the push. Rows
    with an empty or infinite entry are left out, rows of one time become their mean; remarks say how many.

    Raises:
        RecordingError: the file cannot be read as a log; with the line or the columns found.
    """
    path = Path(path)
    if unit_advice := unit_in_name(columns, time_unit):
        raise RecordingError(f"{path}: {unit_advice}.")
    wanted = [*columns, *([push_column] if push_column else [])]
    table = read_columns(path, wanted, kind="force log", advice=lambda header: _advice(header, wanted), endless=True)
    lines, read = table.rows, np.stack([table.get(name) for name in wanted], axis=1)
    for name, column in zip(wanted, read.T, strict=True):
        if not np.isfinite(column).any():
            raise RecordingError(f"{path}: the column {name} holds no number in any row. Is it the right one?")
    read[:, 0] *= TIME_UNITS[time_unit]
    refuse_absurd(path, wanted, read, lines)
    full = np.isfinite(read).all(axis=1)
    check_times(path, read[full, 0], lines[full])
    return whole_log(str(path), read)


def refuse_absurd(path: Path, wanted: Sequence[str], read: Array, lines: IntArray) -> None:
    """Raise where a number of the rows (N, c) is finite, but neither a time nor a force of this world."""
    for i, (name, most) in enumerate(zip(wanted, (LATEST, STRONGEST, STRONGEST, STRONGEST), strict=False)):
        absurd = np.isfinite(read[:, i]) & (np.abs(read[:, i]) > most)
        if absurd.any():
            row = int(np.argmax(absurd))
            said = f"{name} is {read[row, i]:.3g}, more than {most:g}"
            unit = " If its unit is not the second, state time_unit in [force]." if i == 0 else ""
            raise RecordingError(f"{path}, line {lines[row]}: {said}. Correct or remove the line.{unit}")


def whole_log(where: str, read: Array, remarks: tuple[Remark, ...] = ()) -> ForceLog:
    """The log from rows (N, 3 or 4) of time, two forces and perhaps the place of the push; times do not fall."""
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


def _advice(header: list[str], wanted: Sequence[str]) -> str:
    """What to do about a header that lacks wanted columns."""
    advice = "Name the columns with columns in [force], or column in [push], of recording.toml."
    if header and all(is_number(name) for name in header):
        return f"The first line holds numbers: write the header {','.join(wanted)} above it. {advice}"
    if header and header[0].startswith("#"):
        return f"The header must be the first line: remove the lines above it. {advice}"
    return advice


def check_times(path: Path, time: Array, lines: IntArray) -> None:
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
    if count <= 0.1 * rows:  # of the rows: if more are left out or share a time, it is a warning
        return (Remark("note", f"{count} of {rows} {what}.", about="bad rows"),)
    return (Remark("warning", f"{count} of {rows} {what}. Check the logger, and record again.", about="bad rows"),)
