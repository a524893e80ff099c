"""A quick check of a recording: its files, and some frames of its film."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from onebend.errors import ObservationError, OnebendError, told
from onebend.recording import bag_topics, beam_frame, clock, force_axes, force_log, photos, stated
from onebend.recording.entries import Recording, VideoEntry
from onebend.recording.folder import read_recording
from onebend.recording.force import check_pace, read_log, to_beam
from onebend.recording.observe import FEWEST_FRAMES, observe
from onebend.recording.poses import read_loads, read_points
from onebend.recording.preview import Preview, bent, look_at, moved
from onebend.recording.signals import outliers, step
from onebend.recording.tracks import read_tracks
from onebend.recording.video import opened
from onebend.records import Array, ForceLog, Markers, Observations, OutlineTrack, Remark
from onebend.report.sentences import counted, say, significant, size_words

STEP, MOST_OFFSETS = 0.05, 2000  # s between tried clock offsets, and their largest number
SURE = 0.9  # correlation of force and bending with which film and log show one push
SOFTWARE = "onebend check"  # written into the picture; only such a picture is replaced
SMOOTH = 0.1  # s, average of the log before its maximum


@dataclass(frozen=True)
class Overview:
    """What was read, remarks, and errors that would stop `learn`."""

    name: str
    rows: tuple[tuple[str, str], ...]
    remarks: tuple[Remark, ...]
    faults: tuple[str, ...]  # errors of `learn`
    recording: Recording
    preview: Preview | None  # of a film
    observations: Observations | None  # without a film
    log: ForceLog | None
    curves: tuple[OutlineTrack, ...] = ()  # in photos without tags on the body, one each

    @property
    def verdict(self) -> str:
        """What `learn` would make of it, in one line."""
        if self.faults:
            return say("check: refused", errors=counted(len(self.faults), "error"))
        if any(remark.doubt for remark in self.remarks):
            return say("check: doubted")
        warnings = sum(remark.level == "warning" for remark in self.remarks)
        return say("check: warned", warnings=counted(warnings, "warning")) if warnings else say("check: fine")

    def as_dict(self) -> dict[str, Any]:
        """For `--json`."""
        remarks = [remark.as_dict() for remark in self.remarks]
        return {
            "recording": self.name, "verdict": self.verdict, "understood": dict(self.rows), "remarks": remarks
        }  # fmt: skip


@dataclass(frozen=True)
class FilmInfo:
    width: int
    height: int
    frames: int | None  # None if unknown
    seconds: float  # NaN if unknown


def overview(folder: Path | str) -> Overview:
    """Reads and checks every file, and searches some frames for tags. Raises `RecordingError` for unreadable files,
    `ObservationError` for tracks or poses that make no observations."""
    recording = read_recording(folder)
    section = stated.stated_in(recording).section
    if recording.gravity is not None and recording.gravity.base_angle_file is not None:
        beam_frame.read_base_log(recording.gravity.base_angle_file)
    log = read_log(recording)
    preview = None if recording.video is None else look_at(recording)
    seen: Observations | None = None
    curves: tuple[OutlineTrack, ...] = ()
    if recording.photos is not None:
        seen, curves = photos.photo_observations(recording)
    elif recording.video is None:
        seen = observe(recording)
    film = None if preview is None or recording.video is None else film_info(recording.video, preview)
    sizes = [] if section is None else [("section", ", ".join(size_words(section)))]
    rows = [
        *_beam_rows(recording),
        *sizes,
        *_film_rows(recording, film),
        *_tag_rows(preview),
        *_log_rows(recording, log, preview),
    ]
    remarks = [*recording.remarks, *(log.remarks if log else ())]
    if seen is not None:
        remarks = [*seen.source.remarks]
    if preview is not None:
        remarks += preview.remarks
        remarks += () if log is None else force_log.size_remarks(_largest(recording, log), recording.beam.mass)
    faults = [] if preview is None else _faults(recording, preview, film, log)
    return Overview(recording.name, tuple(rows), tuple(remarks), tuple(faults), recording, preview, seen, log, curves)


def film_info(video: VideoEntry, preview: Preview) -> FilmInfo:
    """As read to the end, else as the file says."""
    height, width = preview.looked[0].luma.shape
    if preview.whole:
        return FilmInfo(width, height, preview.frames, preview.looked[-1].time)
    if video.topic:
        frames, seconds = bag_topics.bag_span(video)
        return FilmInfo(width, height, frames, seconds)
    with opened(video.file) as container:
        seconds = container.duration / 1e6 if container.duration else float("nan")
    return FilmInfo(width, height, None, seconds)


def _faults(description: Recording, preview: Preview, film: FilmInfo | None, log: ForceLog | None) -> list[str]:
    """Errors of `learn`."""
    faults = [preview.fault] if preview.fault else []
    if preview.whole and preview.frames < FEWEST_FRAMES:
        faults.append(
            f"{description.name}: there are {preview.frames} frames; at least {FEWEST_FRAMES} are needed. Film the "
            "whole push, with the beam at rest before it."
        )
    if log is None:
        return faults
    checks: list[Callable[[], None]] = [
        lambda: force_log.refuse_other_unit(_largest(description, log), description.beam.mass, description.name)
    ]
    if film is not None and np.isfinite(film.seconds):
        checks.append(lambda: _refuse_apart(description, film.seconds, log))
    markers = preview.markers
    if markers is not None:
        checks.append(lambda: check_pace(description, markers, log))
        checks.append(lambda: _refuse_axes(description, markers, log))
    return faults + [words for words in map(_words, checks) if words]


def _words(check: Callable[[], None]) -> str:
    try:
        check()
    except OnebendError as wrong:
        return told(wrong)
    return ""


def _largest(description: Recording, log: ForceLog) -> Array:
    """(1, 2) N, approximately."""
    force = tared(description, log)
    return force[[int(np.argmax(np.linalg.norm(force, axis=1)))]]


def tared(description: Recording, log: ForceLog) -> Array:
    """(N, 2) N on the beam, without spikes, fast noise and the initial force."""
    bad = outliers(log.force, spacing=step(log.time))
    span = max(1, round(SMOOTH / step(log.time)))
    values = [np.interp(log.time, log.time[~bad], column[~bad]) for column in log.force.T]
    smooth = uniform_filter1d(np.stack(values, axis=1), min(span, len(bad) // 4), axis=0, mode="nearest")
    force = smooth @ to_beam(description.force.rotation if description.force else 0.0)
    if description.force is not None and description.force.acts_on == "robot":
        force = -force
    first = max(5, len(force) // 50)
    return np.asarray(force - np.median(force[:first], axis=0))


def _refuse_apart(description: Recording, seconds: float, log: ForceLog) -> None:
    start, doubt = description.start
    if not np.isfinite(start + doubt):
        return
    slack = clock.reach_of(doubt)
    if start + seconds + slack < log.time[0] or start - slack > log.time[-1]:
        raise ObservationError(
            f"The film ({start:.1f} to {start + seconds:.1f} s on the log's clock, give or take {doubt:.2g} s) and the "
            f"force log ({log.time[0]:.1f} to {log.time[-1]:.1f} s) do not overlap. Check start_s in recording.toml, "
            "and that the log belongs to this film.",
            about="no overlap",
        )


def _refuse_axes(description: Recording, markers: Markers, log: ForceLog) -> None:
    """Raises if the force contradicts the bending. Clocks are matched by the sizes of force and bending, whatever the
    axes."""
    away, force = moved(markers), tared(description, log)
    start, doubt = description.start
    place = np.nan if description.push is None else description.push.at
    if not np.isfinite(start + doubt + place) or not away.max() > 0.0:
        return
    size, reach = np.linalg.norm(force, axis=1), clock.reach_of(doubt)
    offsets = np.arange(start - reach, start + reach + STEP, STEP) if doubt > 0.0 else np.array([start])
    if len(offsets) > MOST_OFFSETS:
        return
    alike = [_likeness(markers.time + offset, away, log.time, size) for offset in offsets]
    if max(alike) < SURE:
        return
    time = markers.time + offsets[int(np.argmax(alike))]
    at_frames = np.stack([np.interp(time, log.time, column) for column in force.T], axis=1)
    loaded = bent(markers)
    rest = beam_frame.rest_shape(markers, ~loaded)
    force_axes.check_direction(description, markers, rest, at_frames, np.full(len(time), place), loaded, refuse=True)


def _likeness(time: Array, away: Array, log_time: Array, size: Array) -> float:
    """Correlation of bending at `time` [s, the log's clock] with the force's size; 0 without overlap."""
    inside = (time >= log_time[0]) & (time <= log_time[-1])
    if inside.sum() < 0.6 * len(time) or not np.ptp(away[inside]) > 0.0:
        return 0.0
    return float(np.nan_to_num(np.corrcoef(np.interp(time[inside], log_time, size), away[inside])[0, 1]))


def _tag_rows(preview: Preview | None) -> list[tuple[str, str]]:
    if preview is None:
        return []
    seen = sorted({tag.tag_id for found in preview.sightings for tag in found})
    ids = ", ".join(map(str, seen)) or "none"
    return [("tags seen", f"{ids}, in {len(preview.looked)} frames spread over the film")]


def _beam_rows(description: Recording) -> list[tuple[str, str]]:
    beam, tags = description.beam, description.tags
    mass = f"{1000 * beam.mass:.4g} g" if np.isfinite(beam.mass) else "mass not given"
    places = ", ".join(f"tag {tag.id} at s = {tag.s:.3g}" for tag in tags.on_beam) or "none on the body"
    places += "; the body's outline is looked for" if description.traces_outline else ""
    base = ", ".join(f"tag {tag.id}" for tag in tags.on_base)
    weight = "acts in the plane of bending" if description.gravity is not None else "across the plane of bending"
    swings = [f"{one.hz:.5g} Hz (sd {one.sd:.2g})" for one in description.frequencies]
    size = f"{tags.family}, {1000 * tags.size:.4g} mm; " if np.isfinite(tags.size) else ""
    return [
        ("beam", f"{1000 * beam.length:.4g} mm long, {mass}, at rest: {beam.rest}; gravity {weight}"),
        *([] if description.only_frequencies else [("tags", f"{size}{base or 'none'} on the base; {places}")]),
        *([("swings", ", ".join(swings))] if swings else []),
    ]


def _film_rows(description: Recording, film: FilmInfo | None) -> list[tuple[str, str]]:
    if description.poses is not None or description.photos is not None:
        return _pose_rows(description)
    if description.markers is not None:
        tracks = read_tracks(description)
        rate = (len(tracks.time) - 1) / max(float(np.ptp(tracks.time)), 1e-9)
        seen = 100.0 * float(np.mean(np.isfinite(tracks.xy).all(axis=-1)))
        said = f"{len(tracks.time)} frames, {np.ptp(tracks.time):.2f} s at {significant(rate)} Hz, {seen:.3g} % of the"
        return [("markers", f"{description.markers.file.name}, {said} points there")]
    if film is None or description.video is None:
        return []
    length = f", {film.seconds:.2f} s" if np.isfinite(film.seconds) else ""
    count = f", {film.frames} frames" if film.frames else ""
    camera = description.camera
    how = "not calibrated: the tags' size gives the scale"
    if camera is not None:
        how = f"calibrated at {camera.width} x {camera.height}, fx = {camera.fx:.0f} px"
    if np.isfinite(description.scale_sd):
        how += f"; lengths to {100.0 * description.scale_sd:.3g} % (sd)"
    video = " ".join((description.video.file.name, description.video.topic)).strip()
    return [("video", f"{video}, {film.width} x {film.height}{count}{length}"), ("camera", how)]


def _pose_rows(description: Recording) -> list[tuple[str, str]]:
    source = description.poses or description.photos
    assert source is not None
    loads = read_loads(source.loads, description, source.axes)
    forces = np.linalg.norm(loads.force, axis=1)
    more = "; further forces or moments besides" if loads.others is not None else ""
    said = f"{source.loads.name}, {len(loads.names)} poses, {forces.min():.3g} … {forces.max():.3g} N{more}"
    if description.photos is not None:
        return [("photos", description.photos.folder.name), ("loads", said)]
    assert description.poses is not None
    points, name = read_points(description, loads), description.poses.file.name
    # without the zero pose, which has no readings
    known = np.isfinite(points.xy[np.arange(len(points.xy)) != points.readings.bare])
    seen, both = int(known.any(axis=-1).sum()), int(known.all(axis=-1).sum())
    return [("poses", f"{name}, {seen} points, {both} of them with both coordinates"), ("loads", said)]


def _log_rows(description: Recording, log: ForceLog | None, preview: Preview | None) -> list[tuple[str, str]]:
    if log is None or description.force is None or description.push is None:
        return [] if description.poses is not None or description.photos is not None else [("force", "none")]
    span = log.time[-1] - log.time[0]
    rate = 1.0 / float(np.median(np.diff(log.time)))
    reach = ", ".join(f"{low:.2f} … {high:.2f} N" for low, high in zip(log.force.min(0), log.force.max(0), strict=True))
    column = description.push.column
    place = f"column {column}" if column else f"s = {description.push.at:.3g}"
    place += f"; the film shows the tool at s = {preview.tool.words}" if preview and preview.tool.seen else ""
    start, doubt = description.start
    source = " ".join((description.force.file.name, description.force.topic)).strip()
    what = "the video starts" if description.video is not None else "the tracks start"
    told = f"give or take {doubt:.2g} s" if doubt > 0.0 else "as written: exact, nothing is looked for"
    said = f"{what} at {start:.3f} s of the log, {told}"
    return [
        ("force log", f"{source}, {len(log.time)} rows, {span:.2f} s at {significant(rate)} Hz"),
        ("force as logged (x, y)", f"{reach}; on the {description.force.acts_on}, turned by "
                                   f"{np.rad2deg(description.force.rotation):.4g} deg"),
        ("push", place),
        ("clocks", said if np.isfinite(start) else "the start is not given and will be looked for in the whole log"),
    ]  # fmt: skip
