"""Signals of a beam that swings: places of points in a tracker's own axes, or the columns of any table over time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from onebend.errors import RecordingError
from onebend.recording.tables import read_columns, read_every_column
from onebend.recording.toml.entries import Recording
from onebend.recording.tracks.marker_tracks import read_tracks
from onebend.records import Array, Markers

TIME = "time_s"
_POINTS = ("id", "x_m", "y_m")


@dataclass(frozen=True)
class SwingSignals:
    """C signals at N times; NaN where one is not known."""

    name: str
    time: Array  # (N,) s
    value: Array  # (N, C) each in a unit of its own
    labels: tuple[str, ...]  # (C,)


def signals_of_table(path: Path) -> SwingSignals:
    """Every column of numbers beside time_s; of a table of tracks (id, x_m, y_m) the places of each point.

    Raises:
        RecordingError: the table cannot be read, or holds no numbers beside the times.
    """
    table = read_every_column(path, TIME, kind="table of a swing")
    if set(_POINTS) <= set(table.numbers):
        return _of_points(path)
    labels = tuple(name for name in table.numbers if name != TIME and np.isfinite(table.numbers[name]).any())
    if not labels:
        raise RecordingError(f"{path}: there is nothing beside {TIME}. Add a column for each signal, such as y_m.")
    return SwingSignals(path.name, table.get(TIME), np.stack([table.numbers[name] for name in labels], axis=1), labels)


def signals_of_tracks(rec: Recording) -> SwingSignals:
    """Of the markers of a recording, in the tracker's plane.

    Raises:
        RecordingError: the table cannot be used.
    """
    tracks, ids = read_tracks(rec), [tag.id for tag in rec.tags.on_beam]
    beam = tracks.xy[:, len(rec.tags.on_base) :]
    return _places(rec.name, tracks.time, beam, ids)


def signals_of_markers(markers: Markers, name: str) -> SwingSignals:
    """Of tags in a film, against the base tag."""
    return _places(name, markers.time, markers.xy, markers.tag_id.tolist())


def _of_points(path: Path) -> SwingSignals:
    table = read_columns(path, (TIME, *_POINTS), kind="table of tracks")
    time, row = np.unique(table.get(TIME), return_inverse=True)
    ids, column = np.unique(table.get("id"), return_inverse=True)
    places = np.full((len(time), len(ids), 2), np.nan)
    places[row, column] = np.stack([table.get("x_m"), table.get("y_m")], axis=1)
    return _places(path.name, time, places, [int(one) for one in ids])


def _places(name: str, time: Array, xy: Array, ids: list[int]) -> SwingSignals:
    labels = tuple(f"{axis} of {one}" for one in ids for axis in "xy")
    return SwingSignals(name, time, xy.reshape(len(time), -1), labels)
