"""From a recording on disk to observations (the paper's section IV-C)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from onebend import records
from onebend.errors import ObservationError, RecordingError
from onebend.options import option
from onebend.progress import Progress, Silent, one_blas_thread
from onebend.recording import force as forces, force_axes, outline, photos, poses, stated, tracks
from onebend.recording.beam_frame import BaseLog, RestShape, gravity_in_frame, read_base_log, rest_shape, to_beam_frame
from onebend.recording.camera import measure_markers, measure_tags, with_checked_turns
from onebend.recording.entries import Recording, TagsEntry, VideoEntry
from onebend.recording.folder import FILE_NAME, read_recording
from onebend.recording.force_log import at_its_end
from onebend.recording.force_noise import displacement
from onebend.recording.signals import MOST_FRAMES, check_span
from onebend.recording.tags import detect_tags
from onebend.recording.tool import tool_checked, tool_in_film
from onebend.recording.video import KeptFrames, spacing_of

FEWEST_FRAMES = 10  # a guard, as for the force log


@dataclass(frozen=True)
class ObserveSettings:
    """How a recording is read."""

    threads: int | None = option("--threads", None, metavar="N", within=(1, None))
    epsilon: float | None = option("--epsilon-s", None, within=(0.0, 1e9))
    check_force: bool = True  # refuse a force that contradicts the bending


class Detect(Protocol):
    """A function that finds the tags: `detect_tags`, or one with a cache around it."""

    def __call__(
        self, video: VideoEntry, tags: TagsEntry, *, threads: int | None = None, progress: Progress = Silent()
    ) -> records.Detections: ...


@one_blas_thread
def observe(
    recording: Recording | Path | str,
    *,
    settings: ObserveSettings = ObserveSettings(),
    detections: records.Detections | None = None,
    detect: Detect = detect_tags,
    frames: KeptFrames | None = None,
    progress: Progress = Silent(),
) -> records.Observations:
    """The observations of a recording, on the force log's clock and in the beam's frame.

    `detections` are tags found earlier in the same video; without them the video is searched by `detect`, once the
    other files are known to be good. `frames` of it that `detect` has kept are not read from it again.

    Raises:
        RecordingError: a file is missing or cannot be read.
        ObservationError: no tags, no overlap of film and log, or a force that contradicts the bending.
    """
    rec = recording if isinstance(recording, Recording) else read_recording(recording)
    if rec.frequencies and rec.only_frequencies:
        return tracks.frequency_observations(rec)
    return tracks.with_frequencies(_shown(rec, settings, detections, detect, frames, progress), rec)


def _shown(
    rec: Recording,
    settings: ObserveSettings,
    detections: records.Detections | None,
    detect: Detect,
    frames: KeptFrames | None,
    progress: Progress,
) -> records.Observations:
    """What film, tracks, photos or poses show of the beam."""
    if rec.poses is not None:
        return poses.pose_observations(rec)
    if rec.photos is not None:
        return photos.photo_observations(rec, progress=progress)[0]
    log = forces.read_log(rec)
    base = read_base_log(rec.gravity.base_angle_file) if rec.gravity and rec.gravity.base_angle_file else None
    if rec.markers is not None:
        return assemble(rec, tracks.track_markers(rec), log, base, settings)
    if rec.video is None:
        raise ObservationError(f"{rec.folder}: recording.toml names no [video]. Add one.")
    if detections is None:
        detections = detect(rec.video, rec.tags, threads=settings.threads, progress=progress)
    searched, number = detections.of_searched()
    tags = measure_tags(searched, rec)
    markers = with_checked_turns(tags.markers(), rec)
    if rec.traces_outline:
        frames = KeptFrames() if frames is None else frames
        markers = outline.with_outline(tags, markers, number, kept=frames, progress=progress)
    seen = assemble(rec, markers, log, base, settings)
    base_angle = markers.base_angle[seen.frame]
    seen = replace(seen, frame=number[seen.frame])
    if not rec.video.file.exists():
        return seen
    every = spacing_of(len(detections.time), detections.width * detections.height)
    return tool_checked(rec, seen, base_angle, partial(tool_in_film, rec, every=every, kept=frames))


def observe_markers(
    rec: Recording,
    markers: records.Markers,
    log: records.ForceLog | None,
    settings: ObserveSettings = ObserveSettings(),
) -> records.Observations:
    """The observations of tags and force that were read elsewhere, as from a live camera; raises as `observe`."""
    return tracks.with_frequencies(assemble(rec, markers, log, None, settings), rec)


def swing_signals(
    source: Path | str, *, threads: int | None = None, detect: Detect = detect_tags, progress: Progress = Silent()
) -> tracks.SwingSignals:
    """What swings in a recording (a film or tracks; no rest and no force is needed), or in a table over time.

    Raises:
        RecordingError: a file is missing or cannot be read, or is of static poses.
        ObservationError: no tags.
    """
    if Path(source).is_file() and Path(source).name != FILE_NAME:
        return tracks.signals_of_table(Path(source))
    rec = read_recording(source)
    if rec.markers is not None:
        return tracks.signals_of_tracks(rec)
    if rec.video is None:
        raise RecordingError(f"{rec.folder}: nothing in it moves. Give a film or tracks of a free swing, or a table")
    detections = detect(rec.video, rec.tags, threads=threads, progress=progress)
    markers = measure_markers(detections.of_searched()[0], rec)
    return tracks.signals_of_places(rec.name, markers.time, markers.xy)


@one_blas_thread
def assemble(
    rec: Recording,
    markers: records.Markers,
    log: records.ForceLog | None,
    base: BaseLog | None,
    settings: ObserveSettings,
) -> records.Observations:
    """Markers and logs on one clock and in one frame. Where the force contradicts the bending from the stated start on,
    but fits it from another one, that start is said to be wrong."""
    try:
        return _assembled(rec, markers, log, base, settings)
    except ObservationError as wrong:
        if wrong.about != "axes" or not np.isfinite(rec.start[0]):
            raise
        name = "video" if rec.video else "markers"
        unknown = replace(getattr(rec, name), start=np.nan, start_uncertainty=np.inf)
        try:
            found = _assembled(replace(rec, **{name: unknown}), markers, log, base, settings).source
        except ObservationError:
            raise wrong from None
        if found.clock is None or not found.clock.found or any(one.about == "axes" for one in found.remarks):
            raise
        raise ObservationError(
            f"{rec.name}: The force contradicts the bending if the film (or the tracks) starts near {rec.start[0]:g} s "
            f"on the log's clock, and fits it from {found.clock.offset:.2f} s on. Correct start_s.",
            about="clock",
        ) from None


def _assembled(
    rec: Recording,
    markers: records.Markers,
    log: records.ForceLog | None,
    base: BaseLog | None,
    settings: ObserveSettings,
) -> records.Observations:
    if len(markers.time) < FEWEST_FRAMES:
        raise ObservationError(
            f"{rec.name}: there are {len(markers.time)} frames; at least {FEWEST_FRAMES} are needed. Film (or track) "
            "the whole push, with the beam at rest before it."
        )
    check_span(markers.time, rec.name, most=MOST_FRAMES)
    # Clocks and contact are read with angles; only measured ones are learned from.
    reading = tracks.with_angles(records.of_markers(markers, records.read_before_fit(markers)))
    log, fit = forces.match_clocks(rec, reading, log, base)
    contact = forces.find_contact(reading, log, offset=fit.clock.offset)
    time, clean = markers.time + fit.clock.offset, None
    force, push_s, loaded = np.zeros((len(time), 2)), np.full(len(time), np.nan), np.zeros(len(time), dtype=bool)
    if log is not None:
        moved = displacement(time, reading.xy, reading.xy[0])
        bent = np.interp(log.time, time, moved / max(float(np.max(moved)), np.finfo(float).tiny))
        log = replace(log, remarks=(*log.remarks, *at_its_end(log.force, bent)))
        clean = forces.cleaned(rec, log, contact, fit)
        at_s = rec.push.at if rec.push else np.nan
        force, push_s = forces.force_at(clean, time, at_s, epsilon=settings.epsilon)
        loaded = contact.loaded
    gravity = gravity_in_frame(rec.gravity, base, markers, time)
    in_frame, rest, frame_remarks = to_beam_frame(markers, contact.still, rec.tags.placement_sd, gravity)
    few = records.of_markers(in_frame, records.read_before_fit(in_frame))
    angled = tracks.with_angles(few)
    bare = rest_shape(angled, contact.still)
    implausible = force_axes.check_direction(rec, angled, bare, force, push_s, loaded, refuse=settings.check_force)
    if np.any(records.tags_among(few)):  # points of an outline have no angle of their own
        implausible += force_axes.check_place(rec, few, rest_shape(few, contact.still), push_s, loaded)
    use, drop_remarks = forces.usable(markers, force)
    remarks = (*rec.remarks, *markers.remarks, *fit.remarks)
    remarks += frame_remarks if clean is None else (*contact.remarks, *frame_remarks, *clean.remarks)
    source = records.Source(
        name=rec.name,
        video=rec.video.file if rec.video else None,
        video_topic=rec.video.topic if rec.video else "",
        view=in_frame.view,
        clock=fit.clock,
        clean_force=clean,
        remarks=(*remarks, *implausible, *drop_remarks),
    )
    force_sd = np.zeros(2) if clean is None else clean.noise_sd
    loads = {"time": time, "gravity": gravity, "force": force, "push_s": push_s, "loaded": loaded}
    return observations_of(rec, source, in_frame, rest, force_sd, use, **loads)


def observations_of(
    rec: Recording,
    source: records.Source,
    markers: records.Markers,
    rest: RestShape,
    force_sd: records.Array,
    use: records.BoolArray,
    **loads: Any,
) -> records.Observations:
    """The frames `use` (T,) of what was read, in one record; `loads`: fields of it with a row a frame."""
    of_frames = loads | {name: getattr(markers, name) for name in ("xy", "angle", "covariance")}
    return records.Observations(
        source=source,
        stated=stated.stated_in(rec),
        length=rec.beam.length,
        frame=np.flatnonzero(use).astype(np.int64),
        tag_id=markers.tag_id,
        marker_s=markers.s,
        force_sd=force_sd,
        rest_xy=rest.xy,
        rest_angle=rest.angle,
        rest_covariance=rest.covariance,
        by_camera=None if markers.by_camera is None else markers.by_camera[use],
        traced=markers.traced,
        width=markers.width,
        **{name: values[use] for name, values in of_frames.items()},
    )
