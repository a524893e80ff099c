"""The tool looked for in a film, and what to say where it is not where recording.toml says."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isfinite, isnan

import numpy as np
from numpy.typing import NDArray

from onebend.recording.kept_frames import KeptFrames
from onebend.recording.toml.entries import Recording
from onebend.recording.tool.covered import shrink_factor, shrunk
from onebend.recording.tool.place import ToolPlace, not_seen, tool_place
from onebend.recording.video import Picture, pictures_at
from onebend.records import Array, BoolArray, IntArray, Markers, Observations, Remark

LOADED, AT_REST = 24, 8  # frames of each that are looked at; half of them are enough where these are kept
SURE = 3.0  # sds, of what is seen and what is stated together: farther apart they disagree
ACCUSES = 0.5  # of the loaded frames: what fewer show at another place is no reason to doubt the stated one

FindTool = Callable[[Markers, BoolArray, IntArray], ToolPlace]  # by tags, whether loaded, and number of each frame


@dataclass(frozen=True)
class SmallPictures:
    """Some pictures of a stream, shrunk."""

    time: Array  # (P,) s, in order
    pictures: tuple[NDArray[np.float32], ...]  # P of (h, w)
    factor: int  # pixels of the camera, each way, that make one of theirs


def tool_checked(rec: Recording, seen: Observations, base_angle: Array, find: FindTool) -> Observations:
    """With what the pictures show of the tool, by `find`: a warning where it is elsewhere than `at_s` says.
    `base_angle` (T,) [rad] is of the same frames.

    Raises:
        RecordingError: the film cannot be read.
    """
    if rec.push is None or not isfinite(rec.push.at):
        return seen
    markers = Markers(
        seen.time, seen.tag_id, seen.marker_s, seen.xy, seen.angle, seen.covariance, base_angle,
        seen.source.view,
    )  # fmt: skip
    tool = find(markers, seen.loaded, seen.frame)
    remarks, where_stated = tool_remarks(tool, rec), tool.seen and not _elsewhere(tool, rec)
    source = replace(seen.source, remarks=(*seen.source.remarks, *remarks), place_seen=where_stated)
    return replace(seen, source=source)


def tool_in_film(
    rec: Recording,
    markers: Markers,
    loaded: BoolArray,
    frame: IntArray,
    *,
    every: int = 1,
    kept: KeptFrames | None = None,
) -> ToolPlace:
    """Where the film of `rec` shows the tool. `markers`, `loaded` and `frame`, the index in the film, have a row a
    frame.

    Args:
        every: of the frames that may be `kept`, see `kept_frames.spacing_of`: others are looked at only where these
            are too few.

    Raises:
        RecordingError: the film cannot be read.
    """
    if rec.video is None or markers.view is None:
        return not_seen("there is no film")
    rows = rows_to_look_at(markers.xy, loaded, frame % every == 0 if every else None)
    factor = shrink_factor(markers.view, rec.beam.length)
    seek = pictures_at if kept is None else kept.pictures
    found = dict(seek(rec.video, frame[rows].tolist()))
    rows = np.array([row for row in rows.tolist() if int(frame[row]) in found], dtype=np.int64)
    return tool_in([found[int(frame[row])] for row in rows], rec, of_rows(markers, rows), loaded[rows], factor)


def tool_in(
    pictures: Sequence[Picture], rec: Recording, markers: Markers, loaded: BoolArray, factor: int | None = None
) -> ToolPlace:
    """Where these pictures show the tool; `markers` and `loaded` have a row a picture."""
    if markers.view is None or len(pictures) == 0:
        return not_seen("there is no film")
    factor = factor or shrink_factor(markers.view, rec.beam.length)
    small = np.stack([shrunk(picture, factor) for picture in pictures])
    return tool_place(small, factor, markers, loaded, length=rec.beam.length, tag_size=rec.tags.size)


def tool_in_small(small: SmallPictures, rec: Recording, markers: Markers, loaded: BoolArray, time: Array) -> ToolPlace:
    """Where the pictures that were kept of a stream show the tool. `markers`, `loaded` and `time` [s], by the clock of
    the pictures, have a row a frame."""
    rows = np.flatnonzero(np.isin(time, small.time))
    rows = rows[rows_to_look_at(markers.xy[rows], loaded[rows])]
    if not len(rows):
        return not_seen("no picture was kept")
    pictures = np.stack([small.pictures[i] for i in np.searchsorted(small.time, time[rows]).tolist()])
    length, size = rec.beam.length, rec.tags.size
    return tool_place(pictures, small.factor, of_rows(markers, rows), loaded[rows], length=length, tag_size=size)


def rows_to_look_at(xy: Array, loaded: BoolArray, rather: BoolArray | None = None) -> IntArray:
    """Some rows of the tags' places `xy` (T, m, 2), loaded and at rest, in order: evenly over time and way together, so
    that a beam that is held still is not taken for the background. Only of those that are `rather` (T,) looked at,
    where these are enough."""
    steps = np.nan_to_num(np.linalg.norm(np.diff(xy, axis=0, prepend=xy[:1]), axis=-1)).sum(axis=1)
    chosen = []
    for mask, most in ((loaded, LOADED), (~loaded, AT_REST)):
        rows = np.flatnonzero(mask if rather is None or np.sum(mask & rather) < most // 2 else mask & rather)
        if len(rows):
            gone = np.cumsum(np.where(mask, steps, 0.0))
            way = gone[rows] / max(float(gone[-1]), 1e-12) + np.linspace(0.0, 1.0, len(rows))
            chosen.append(rows[np.searchsorted(way, np.linspace(way[0], way[-1], min(most, len(rows))))])
    return np.unique(np.concatenate(chosen)).astype(np.int64) if chosen else np.zeros(0, dtype=np.int64)


def of_rows(markers: Markers, rows: IntArray) -> Markers:
    """The markers of some frames."""
    return Markers(
        time=markers.time[rows],
        tag_id=markers.tag_id,
        s=markers.s,
        xy=markers.xy[rows],
        angle=markers.angle[rows],
        covariance=markers.covariance[rows],
        base_angle=markers.base_angle[rows],
        view=markers.view,
    )


def tool_remarks(tool: ToolPlace, rec: Recording) -> tuple[Remark, ...]:
    """A warning where the tool is seen elsewhere than `at_s` says, farther off than both tolerances allow, in most of
    the frames under load."""
    if rec.push is None or not _elsewhere(tool, rec) or tool.shown < ACCUSES:
        return ()
    text = (
        f"The film shows the tool at s = {tool.words}; recording.toml says at_s = {rec.push.at:.3g}. k(s) follows the "
        f"place: measure it, and correct at_s in [push] (to {tool.s:.2f} if the film is right)."
    )
    return (Remark("warning", text, doubt=True, about="tool place"),)


def _elsewhere(tool: ToolPlace, rec: Recording) -> bool:
    """Whether the tool is seen farther from `at_s` than both tolerances allow."""
    if not tool.seen or rec.push is None or isnan(rec.push.at):
        return False
    stated_sd = np.hypot(rec.place_sd, rec.tags.placement_sd) / rec.beam.length  # the tags tell where s is
    return bool(abs(tool.s - rec.push.at) > SURE * np.hypot(tool.sd, stated_sd))
