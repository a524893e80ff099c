"""Gravity in the beam's frame, from its direction in the room and the angle of the base, constant or logged."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from onebend.errors import ObservationError, RecordingError
from onebend.recording.clock.offset_prior import ROUGHLY, reach_of
from onebend.recording.signals import LATEST
from onebend.recording.toml.entries import GravityEntry
from onebend.records import Array, ClockOffset, Markers
from onebend.text_files import csv_rows

MOST_DEGREES = 1e6
MILLISECONDS = 100.0  # times the film's length: a longer log is probably in another unit


@dataclass(frozen=True)
class BaseLog:
    """The angle of the base, on the force log's clock."""

    time: Array  # (N,) s
    angle: Array  # (N,) rad, the beam's x axis in the room


def read_base_log(path: Path) -> BaseLog:
    """Read a CSV with the columns time_s and base_deg.

    Raises:
        RecordingError: a missing column, text or NaN, times that do not rise, fewer than two rows; with the line.
    """
    time: list[float] = []
    angle: list[float] = []
    rows = csv_rows(path, RecordingError)
    header = [name.strip() for name in next(rows, (1, []))[1]]
    missing = {"time_s", "base_deg"} - set(header)
    if missing:
        raise RecordingError(f"{path}, line 1: no column {', '.join(sorted(missing))}. Name them time_s, base_deg.")
    places = header.index("time_s"), header.index("base_deg")
    for line, row in rows:
        try:
            t, degrees = (float(row[place]) for place in places)
        except (IndexError, ValueError):
            t = degrees = math.nan
        if not (abs(t) < LATEST and abs(degrees) < MOST_DEGREES):
            raise RecordingError(f"{path}, line {line}: not two numbers. Correct or remove the line.")
        if time and t <= time[-1]:
            raise RecordingError(f"{path}, line {line}: the time {t:g} s does not rise. Sort the file.")
        time.append(t)
        angle.append(math.radians(degrees))
    if len(time) < 2:
        raise RecordingError(f"{path} holds {len(time)} rows; at least 2 are needed. Give base_angle_deg instead.")
    return BaseLog(np.array(time), np.unwrap(angle))


def base_clock(
    markers: Markers, log: BaseLog, stated: float, uncertainty: float, *, margin: float = 2.0
) -> ClockOffset:
    """The offset at which the base tag's angle in the film fits the logged angle (least squares, one constant free).

    `sd` counts the residuals as correlated over a second, as from a log that is sampled sparsely.
    """
    if not math.isfinite(stated) or not math.isfinite(uncertainty):
        stated = float(log.time[0] - markers.time[0]) if not math.isfinite(stated) else stated
        uncertainty = float(np.ptp(log.time))
    unsettled = ClockOffset(offset=stated, sd=uncertainty, stated=stated, found=False)
    if np.ptp(markers.base_angle) < math.radians(1.0):
        return unsettled
    measured = np.isfinite(markers.base_angle)
    time, angle = markers.time[measured], markers.base_angle[measured]

    def misfit(offset: float) -> float:
        log_time = time + offset
        inside = (log_time >= log.time[0]) & (log_time <= log.time[-1])
        if inside.sum() < 0.5 * len(log_time):
            return math.inf
        return float(np.var(np.interp(log_time[inside], log.time, log.angle) - angle[inside]))

    farthest = reach_of(uncertainty, margin)
    reach, centre, width = farthest, stated, 0.02
    for width in (0.02, 0.002):
        tries = np.arange(centre - reach, centre + reach + width / 2, width)
        cost = np.array([misfit(trial) for trial in tries])
        best = int(np.argmin(cost))
        centre, reach = float(tries[best]), 0.05
    if not math.isfinite(cost[best]) or cost[best] > 0.05 * float(np.var(angle)):
        return unsettled
    around = slice(max(best - 10, 0), best + 11)
    curve = float(np.polyfit(tries[around] - centre, cost[around], 2)[0])
    independent = max(float(np.ptp(time)), 2.0)
    sd = max(math.sqrt(cost[best] / (independent * curve)) if curve > 0 else uncertainty, width)
    if uncertainty < ROUGHLY and (sd > 0.5 * uncertainty or abs(centre - stated) > farthest):
        return unsettled  # what is written is known better
    return ClockOffset(offset=centre, sd=sd, stated=stated, found=True)


def gravity_in_frame(entry: GravityEntry | None, log: BaseLog | None, markers: Markers, time: Array) -> Array:
    """(T, 2) m/s^2 along and across the beam's x axis; zeros where gravity acts across the plane.

    `time` is on the base log's clock. A base whose angle is written as a constant but turns in the film is followed
    by its tag.
    """
    if entry is None:
        return np.zeros((len(time), 2))
    base = np.interp(time, log.time, log.angle) if log is not None else entry.base_angle + markers.base_angle
    angle = entry.direction - base
    return np.asarray(entry.magnitude * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def check_overlap(markers: Markers, log_time: Array, offset: float, what: str) -> None:
    """Raise where no frame lies inside the log."""
    film = markers.time[[0, -1]] + offset
    if film[1] < log_time[0] or film[0] > log_time[-1]:
        long = log_time[-1] - log_time[0] > MILLISECONDS * (film[1] - film[0])
        hint = ' Its times look like milliseconds: write time_unit = "ms" in [force].' if long else ""
        raise ObservationError(
            f"The film ({film[0]:.1f} to {film[1]:.1f} s on the log's clock) and the {what} ({log_time[0]:.1f} to "
            f"{log_time[-1]:.1f} s) do not overlap. Check start_s in recording.toml, and that the log "
            f"belongs to this film.{hint}",
            about="no overlap",
        )
