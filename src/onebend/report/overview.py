"""What a recording's files say before any tag is looked for: enough to find most mistakes in a second."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from onebend.recording.bags.recorded_topics import bag_span
from onebend.recording.folder import read_recording
from onebend.recording.pairing import read_log
from onebend.recording.toml.entries import Recording
from onebend.recording.toml.source_entries import VideoEntry
from onebend.recording.tracks.marker_tracks import read_tracks
from onebend.recording.tracks.pose_loads import read_loads
from onebend.recording.tracks.pose_tables import read_points
from onebend.recording.video import frame_count, opened, read_frames
from onebend.records import ForceLog, Remark
from onebend.report.wording import significant


@dataclass(frozen=True)
class Overview:
    """What was read from the files, row by row, and what looked odd."""

    name: str
    rows: tuple[tuple[str, str], ...]
    remarks: tuple[Remark, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data for `--json`."""
        remarks = [remark.as_dict() for remark in self.remarks]
        return {"recording": self.name, "understood": dict(self.rows), "remarks": remarks}


@dataclass(frozen=True)
class FilmInfo:
    """What the container and the first frame show."""

    width: int
    height: int
    frames: int | None  # None where the container does not say
    seconds: float  # NaN where the container does not say


def overview(folder: Path | str) -> Overview:
    """Read and check the recording's files; no tag is looked for and only the first frame is decoded.

    Raises `RecordingError` as `read_recording` and the readers of the single files do.
    """
    recording = read_recording(folder)
    film = None if recording.video is None else first_look(recording.video)
    log = read_log(recording)
    rows = [*_beam_rows(recording), *_film_rows(recording, film), *_log_rows(recording, log)]
    remarks = (*recording.remarks, *(log.remarks if log else ()), *_oddities(recording, film, log))
    return Overview(recording.name, tuple(rows), remarks)


def first_look(video: VideoEntry) -> FilmInfo:
    """Size, and what the container says of its length."""
    height, width = next(read_frames(video)).luma.shape
    if video.topic:
        frames, seconds = bag_span(video)
        return FilmInfo(width, height, frames, seconds)
    with opened(video.file) as container:
        seconds = container.duration / 1e6 if container.duration else float("nan")
    return FilmInfo(width, height, frame_count(video), seconds)


def _beam_rows(recording: Recording) -> list[tuple[str, str]]:
    beam, tags = recording.beam, recording.tags
    mass = f"{1000 * beam.mass:.4g} g" if np.isfinite(beam.mass) else "mass not given"
    places = ", ".join(f"tag {tag.id} at s = {tag.s:.3g}" for tag in tags.on_beam)
    base = ", ".join(f"tag {tag.id}" for tag in tags.on_base)
    weight = "acts in the plane of bending" if recording.gravity is not None else "across the plane of bending"
    size = f"{tags.family}, {1000 * tags.size:.4g} mm; " if np.isfinite(tags.size) else ""
    return [
        ("beam", f"{1000 * beam.length:.4g} mm long, {mass}, at rest: {beam.rest}; gravity {weight}"),
        ("tags", f"{size}{base or 'none'} on the base; {places}"),
    ]


def _film_rows(recording: Recording, film: FilmInfo | None) -> list[tuple[str, str]]:
    if recording.poses is not None or recording.photos is not None:
        return _pose_rows(recording)
    if recording.markers is not None:
        tracks = read_tracks(recording)
        rate = (len(tracks.time) - 1) / max(float(np.ptp(tracks.time)), 1e-9)
        seen = 100.0 * float(np.mean(np.isfinite(tracks.xy).all(axis=-1)))
        said = f"{len(tracks.time)} frames, {np.ptp(tracks.time):.2f} s at {significant(rate)} Hz, {seen:.3g} % of the"
        return [("markers", f"{recording.markers.file.name}, {said} points there")]
    if film is None or recording.video is None:
        return []
    length = f", {film.seconds:.2f} s" if np.isfinite(film.seconds) else ""
    count = f", {film.frames} frames" if film.frames else ""
    camera = recording.camera
    how = "not calibrated: the tags' size gives the scale"
    if camera is not None:
        how = f"calibrated at {camera.width} x {camera.height}, fx = {camera.fx:.0f} px"
    if np.isfinite(recording.scale_sd):
        how += f"; lengths to {100.0 * recording.scale_sd:.3g} % (sd)"
    video = " ".join((recording.video.file.name, recording.video.topic)).strip()
    return [("video", f"{video}, {film.width} x {film.height}{count}{length}"), ("camera", how)]


def _pose_rows(recording: Recording) -> list[tuple[str, str]]:
    """Poses and loads; photos are not searched for tags."""
    source = recording.poses or recording.photos
    assert source is not None
    loads = read_loads(source.loads, recording, source.axes)
    forces = np.linalg.norm(loads.force, axis=1)
    more = "; further forces or moments besides" if loads.others is not None else ""
    said = f"{source.loads.name}, {len(loads.names)} poses, {forces.min():.3g} … {forces.max():.3g} N{more}"
    if recording.photos is not None:
        return [("photos", recording.photos.folder.name), ("loads", said)]
    assert recording.poses is not None
    points, name = read_points(recording, loads), recording.poses.file.name
    seen = int(np.isfinite(points.xy).any(axis=-1).sum())
    both = int(np.isfinite(points.xy).all(axis=-1).sum())
    return [("poses", f"{name}, {seen} points, {both} of them with both coordinates"), ("loads", said)]


def _log_rows(recording: Recording, log: ForceLog | None) -> list[tuple[str, str]]:
    if log is None or recording.force is None or recording.push is None:
        return [] if recording.poses is not None or recording.photos is not None else [("force", "none")]
    span = log.time[-1] - log.time[0]
    rate = 1.0 / float(np.median(np.diff(log.time)))
    reach = ", ".join(f"{low:.2f} … {high:.2f} N" for low, high in zip(log.force.min(0), log.force.max(0), strict=True))
    column = recording.push.column
    place = f"column {column}" if column else f"s = {recording.push.at:.3g}"
    start, doubt = recording.start
    source = " ".join((recording.force.file.name, recording.force.topic)).strip()
    what = "the video starts" if recording.video is not None else "the tracks start"
    told = f"give or take {doubt:.2g} s" if doubt > 0.0 else "as written: exact, nothing is looked for"
    said = f"{what} at {start:.3f} s of the log, {told}"
    return [
        ("force log", f"{source}, {len(log.time)} rows, {span:.2f} s at {significant(rate)} Hz"),
        ("force as logged (x, y)", f"{reach}; on the {recording.force.acts_on}, turned by "
                                   f"{np.rad2deg(recording.force.rotation):.4g} deg"),
        ("push", place),
        ("clocks", said if np.isfinite(start) else "the start is not given and will be looked for in the whole log"),
    ]  # fmt: skip


def _oddities(recording: Recording, film: FilmInfo | None, log: ForceLog | None) -> list[Remark]:
    found = []
    camera, video = recording.camera, recording.video
    if camera is not None and film is not None and (camera.width, camera.height) != (film.width, film.height):
        text = (
            f"the camera was calibrated at {camera.width} x {camera.height}, the video is {film.width} x {film.height}"
        )
        found.append(Remark("warning", f"{text}. Calibrate at the video's size, or remove [camera]."))
    if log is not None and film is not None and video is not None and np.isfinite(video.start + film.seconds):
        begin, end = video.start, video.start + film.seconds
        slack = video.start_uncertainty
        if end + slack < log.time[0] or begin - slack > log.time[-1]:
            text = (
                f"the video ({begin:.1f} to {end:.1f} s) and the force log ({log.time[0]:.1f} to {log.time[-1]:.1f} s)"
            )
            found.append(Remark("warning", f"{text} do not overlap. Check start_s in [video]."))
    return found
