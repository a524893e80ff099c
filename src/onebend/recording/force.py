"""The force log made clean: sign, frame, outliers, zero, zero-phase low-pass, and what noise is left."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from onebend.errors import RecordingError
from onebend.recording.noise import first_guess
from onebend.recording.signals import at_times, low_pass, outliers, step
from onebend.records import Array, BoolArray, CleanForce, ForceLog, ForceNoise, Remark

FEWEST_ROWS = 10


def read_force_log(path: Path | str, columns: Sequence[str], push_column: str = "") -> ForceLog:
    """Read a CSV force log: a header, then one row a sample.

    `columns` names time [s] and the two forces [N]; `push_column`, where not empty, the place of the push.

    Raises
    ------
    RecordingError
        Unreadable, a missing column (those found are listed), text or NaN instead of a number, times that repeat or
        fall, too few rows, a force that is zero throughout; with the line.
    """
    path = Path(path)
    wanted = [*columns, *([push_column] if push_column else [])]
    lines: list[int] = []
    table: list[list[float]] = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            for line, values in numbers(path, stream, wanted):
                lines.append(line)
                table.append(values)
    except OSError as wrong:
        raise RecordingError(
            f"{path} cannot be read: {wrong.strerror}. Check [force] file in recording.toml."
        ) from None
    except (UnicodeDecodeError, csv.Error):
        raise RecordingError(f"{path} is not a CSV text file. Export the force log as CSV with a header.") from None
    if len(table) < FEWEST_ROWS:
        raise RecordingError(
            f"{path} holds {len(table)} rows of numbers; at least {FEWEST_ROWS} are needed. Was the log cut short?"
        )
    data = np.array(table)
    check_times(path, data[:, 0], lines)
    if not np.any(data[:, 1:3]):
        raise RecordingError(f"{path}: every force is zero: the sensor was not streaming. Record the push again.")
    return ForceLog(time=data[:, 0], force=data[:, 1:3], push_s=data[:, 3] if push_column else None)


def numbers(path: Path, stream: Iterator[str], wanted: Sequence[str]) -> Iterator[tuple[int, list[float]]]:
    """Line number and the wanted numbers of every row that is not empty."""
    rows = csv.reader(stream, skipinitialspace=True)
    header = [name.strip() for name in next(rows, [])]
    if not header:
        raise RecordingError(f"{path} is empty. Record the push again, or correct [force] file in recording.toml.")
    missing = [name for name in wanted if name not in header]
    if missing:
        raise RecordingError(
            f"{path}, line 1: no column {', '.join(missing)}; found {', '.join(header)}. "
            "Name the columns with columns in [force], or column in [push], of recording.toml."
        )
    places = [header.index(name) for name in wanted]
    for row in rows:
        if not any(cell.strip() for cell in row):
            continue
        values = []
        for name, place in zip(wanted, places, strict=True):
            cell = row[place].strip() if place < len(row) else ""
            try:
                values.append(float(cell))
            except ValueError:
                raise RecordingError(
                    f"{path}, line {rows.line_num}: {name} is {cell!r}, not a number. Correct or remove the line."
                ) from None
            if not math.isfinite(values[-1]):
                raise RecordingError(f"{path}, line {rows.line_num}: {name} is {cell}. Correct or remove the line.")
        yield rows.line_num, values


def check_times(path: Path, time: Array, lines: Sequence[int]) -> None:
    """Raise where the times do not rise strictly."""
    wrong = np.flatnonzero(np.diff(time) <= 0)
    if not len(wrong):
        return
    i = int(wrong[0])
    what = "repeats" if time[i + 1] == time[i] else "is before"
    more = f" ({len(wrong)} such lines)" if len(wrong) > 1 else ""
    raise RecordingError(
        f"{path}, line {lines[i + 1]}: the time {time[i + 1]:.6g} s {what} that of line {lines[i]} "
        f"({time[i]:.6g} s){more}. Times must rise: log them with more digits, or sort and thin the file."
    )


@dataclass(frozen=True)
class ForceSettings:
    """How the log is cleaned."""

    overtone: float = 2.0  # cut-off over the bandwidth of the markers' motion: see `choose_cutoff`
    tare_span: float = 3.0  # s of a rest used for the zero, nearest to contact: longer lets drift in, shorter noise
    outlier_sd: float = 6.0
    longest_gap: float = 0.1  # s, or as long as the filter's memory where that is longer: a longer gap stays a gap


@dataclass(frozen=True)
class Zero:
    """The log's zero at each rest, beam's frame, and how well it is known."""

    time: Array  # (r,) s, log's clock
    value: Array  # (r, 2) N
    sd: float  # N, of each value

    def at(self, time: Array) -> Array:
        """(N, 2) N: straight in time between rests, constant beyond; zero where no rest is known."""
        if not len(self.time):
            return np.zeros((len(time), 2))
        return np.stack([np.interp(time, self.time, column) for column in self.value.T], axis=1)


def choose_cutoff(motion: float, settings: ForceSettings) -> float:
    """Cut-off of the low-pass from the bandwidth `motion` [Hz] of the markers; infinite where that is not known.

    A beam that moves slowly follows the force, so the force holds no frequency that the markers do not. It is a
    nonlinear function of their displacement; its square doubles the bandwidth. Hence twice that of the markers.
    """
    return settings.overtone * motion if np.isfinite(motion) and motion > 0 else math.inf


def clean_force(
    log: ForceLog,
    rests: Sequence[tuple[float, float]],
    *,
    rotation: float = 0.0,
    acts_on: Literal["beam", "robot"] = "beam",
    cutoff: float = math.inf,
    noise: ForceNoise | None = None,
    settings: ForceSettings = ForceSettings(),
) -> CleanForce:
    """Force on the beam in the beam's frame, F = +-R(rotation) F_log, without outliers, zeroed at `rests` and filtered.

    `rests` are spans of the log's clock with a free beam. With rests on both sides of the contact the zero runs
    straight between them, which takes most of the sensor's drift off; with one it is constant; with none the force
    keeps its bias, its noise is unknown (NaN) and a warning says so. `noise` is what is known of the sensor's noise
    (from the clock search); without it the scatter at rest stands for it, and drift is not in `noise_sd`.
    """
    bad = outliers(log.force, threshold=settings.outlier_sd)
    force = log.force @ to_beam(rotation)
    if acts_on == "robot":
        force = -force
    force[bad] = np.stack([np.interp(log.time[bad], log.time[~bad], column[~bad]) for column in force.T], axis=1)
    smooth = low_pass(log.time, force, cutoff, longest_gap=gap_limit(log.time, cutoff, settings))
    zero = zero_of(log.time, force, rests, noise, settings)
    remarks = zero_remarks(zero, float(np.ptp(smooth, axis=0).max()), cutoff)
    drift = np.full(2, np.nan)
    if len(zero.time) > 1:
        drift = (zero.value[-1] - zero.value[0]) / (zero.time[-1] - zero.time[0])
    return CleanForce(
        time=log.time,
        force=smooth - zero.at(log.time),
        push_s=log.push_s,
        noise_sd=left_over(log.time, smooth, rests, zero, cutoff, noise),
        tare=zero.value[0] if len(zero.time) else np.zeros(2),
        drift=drift,
        cutoff=cutoff,
        outliers=int(bad.sum()),
        noise=None if noise is None else _with_white(noise, log.time, force),
        remarks=remarks,
    )


def _with_white(noise: ForceNoise, time: Array, force: Array) -> ForceNoise:
    """`noise` with its white part as the log's own samples show it: there it stands out from all that is slower."""
    spacing = step(time)
    return replace(noise, white=first_guess(force, spacing).white, spacing=spacing)


def to_beam(rotation: float) -> Array:
    """(2, 2) matrix that turns rows of force in the log's axes into the beam's: F_beam = R(rotation) F_log."""
    cos, sin = math.cos(rotation), math.sin(rotation)
    return np.array([[cos, sin], [-sin, cos]])


def within(time: Array, span: tuple[float, float]) -> BoolArray:
    return np.asarray((time >= span[0]) & (time <= span[1]))


def zero_of(
    time: Array, force: Array, rests: Sequence[tuple[float, float]], noise: ForceNoise | None, settings: ForceSettings
) -> Zero:
    """Mean force over each rest, of the part nearest to contact where the rest is long."""
    places, values, sizes = [], [], []
    for i, span in enumerate(rests):
        rows = np.flatnonzero(within(time, span))
        if len(rows) < 2:
            continue
        # The first rest is followed by contact, later ones are preceded by it.
        near = time[rows[-1]] - time[rows] if i == 0 else time[rows] - time[rows[0]]
        rows = rows[near <= settings.tare_span]
        if len(rows) >= 2:
            places.append(float(np.mean(time[rows])))
            values.append(np.mean(force[rows], axis=0))
            sizes.append(float(np.ptp(time[rows])))
    shortest = min(sizes, default=math.nan)
    sd = math.nan
    if noise is not None and sizes:
        # Mean of a process of correlation time tau over a span; the walk within the span.
        sd = math.sqrt(min(1.0, 2 * noise.tau / shortest) * noise.coloured**2 + noise.walk**2 * shortest / 3)
    return Zero(np.array(places), np.array(values).reshape(-1, 2), sd)


def left_over(
    time: Array,
    smooth: Array,
    rests: Sequence[tuple[float, float]],
    zero: Zero,
    cutoff: float,
    noise: ForceNoise | None,
) -> Array:
    """(2,) N, sd of what is wrong with the clean force in mid-contact: the filtered noise, the zero's own error, and
    the drift that the zero could not follow (random walk: a bridge between two rests, free after one). NaN without a
    rest."""
    if not len(zero.time):
        return np.full(2, math.nan)
    at_rest = np.any([within(time, span) for span in rests], axis=0)
    scatter = np.sqrt(np.mean((smooth - zero.at(time))[at_rest] ** 2, axis=0))
    if noise is None:
        return np.asarray(scatter)
    if len(zero.time) > 1:
        wander = noise.walk**2 * float(np.diff(zero.time).max()) / 6
    else:
        wander = noise.walk**2 * (time[-1] - zero.time[0]) / 2
    filtered = np.maximum(noise.passed(cutoff), scatter)
    return np.asarray(np.sqrt(filtered**2 + zero.sd**2 + wander))


def zero_remarks(zero: Zero, largest: float, cutoff: float) -> tuple[Remark, ...]:
    """What a person should know of the zero and the filter."""
    out = []
    if not len(zero.time):
        text = "The force log shows no rest: its zero is unknown and nothing was taken off. Start it before the push."
        out.append(Remark("warning", text))
    elif len(zero.time) == 1:
        text = "The force's drift cannot be seen: the beam is not free again. Let go before the log ends."
        out.append(Remark("note", text))
    elif float(np.ptp(zero.value, axis=0).max()) > 0.2 * largest:
        change = float(np.ptp(zero.value, axis=0).max())
        out.append(Remark("warning", f"The force's zero drifted by {change:.2g} N between the rests."))
    if not math.isfinite(cutoff):
        out.append(Remark("note", "The force is not low-passed: no motion tells its bandwidth."))
    return tuple(out)


def gap_limit(time: Array, cutoff: float, settings: ForceSettings = ForceSettings()) -> float:
    """Longest span between two rows that may be interpolated, s."""
    memory = 1 / (2 * math.pi * cutoff) if math.isfinite(cutoff) and cutoff > 0 else 0.0
    return max(settings.longest_gap, memory, 3 * step(time))


def force_at(clean: CleanForce, at: Array, *, settings: ForceSettings = ForceSettings()) -> Array:
    """(T, 2) N at the times `at` [s, log's clock]; NaN outside the log and in its gaps."""
    return at_times(clean.time, clean.force, at, longest_gap=gap_limit(clean.time, clean.cutoff, settings))
