"""A recording folder of a known beam: the film as pixels, the force log, `recording.toml`, and the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path

import numpy as np

from onebend.blas import one_blas_thread
from onebend.errors import RecordingError
from onebend.lab.effects.camera_motion import CameraMotion, camera_motion
from onebend.lab.effects.rod_march import RodMotion
from onebend.lab.filming.film_setup import DOWN, Filming, check, frame_times
from onebend.lab.filming.force_log_file import in_log_axes, write_log
from onebend.lab.filming.moments import Moments, followed, moments_at
from onebend.lab.filming.movement import PLACES, BeamShapes
from onebend.lab.filming.moving_scene import BeamPose, MovingScene, clamp_block, moment_of, over_rows
from onebend.lab.filming.printed_tag import as_printed, outlines, placed
from onebend.lab.filming.recording_toml import recording_toml
from onebend.lab.filming.render import Drawing, StaticScene, YuvFrame, frame_of, stage
from onebend.lab.filming.truth_file import FilmTruth, write_truth
from onebend.lab.filming.video_file import write_video
from onebend.lab.filming.viewpoint import calibration, view_from
from onebend.lab.sensors import log_of
from onebend.lab.virtual import DENSE, declared_recording, sensed
from onebend.progress import Progress, Silent, track
from onebend.recording.camera.lens import project
from onebend.recording.folder import FILE_NAME
from onebend.recording.toml.beam_entry import BeamEntry
from onebend.recording.toml.entries import ForceEntry, GravityEntry, Recording
from onebend.records import Array, ForceLog, View

STEPS = 0.7  # px: how far the picture may move from one drawn moment of an exposure to the next
MOST_MOMENTS = 8
INCH = 0.0254  # m
SHARPEST = 0.8  # half widths a radius


@dataclass(frozen=True)
class Shot:
    """All that the frames are made of: three moments of each exposure, at its begin, middle and end."""

    staged: StaticScene
    cast: MovingScene
    first: Moments  # (3 T,) as the first row of the picture is exposed
    last: Moments  # as the last one is
    camera: CameraMotion
    readout: float  # s, from one to the other


@one_blas_thread
def film(filming: Filming, folder: Path | str, *, seed: int, progress: Progress = Silent()) -> Path:
    """Make the recording in `folder`, which must not hold one; return the folder. The same `seed` makes the same files.

    Raises:
        MechanicsError: the beam snaps through, or its mass is needed and not known.
        RecordingError: the folder holds something, the camera cannot show the push, or the film cannot be encoded.
    """
    folder, bench = Path(folder), filming.bench
    check(filming, folder)
    time = frame_times(filming, np.random.default_rng([seed, 2]))
    exposed = (time[:, None] + 0.5 * filming.scene.exposure * np.array([-1.0, 0.0, 1.0])).ravel()
    readout = bench.effects.readout
    motion = followed(filming, float(exposed[-1]) + readout)
    moments = moments_at(filming, motion, exposed)
    refuse_sharp_bends(filming, moments.shapes)
    late = moments_at(filming, motion, exposed + readout) if readout else moments
    camera_moves = camera_motion(bench.effects, bench.push.duration, np.random.default_rng([seed, 13]))
    cast = cast_of(filming, np.random.default_rng([seed, 12]))
    view = view_from(filming.camera, to_be_seen(cast, moments))
    staged = stage_of(filming, cast, view, moments.beam, seed)
    folder.mkdir(parents=True, exist_ok=True)
    shot = Shot(staged, cast, moments, late, camera_moves, readout)
    frames = pictures(shot, time, np.random.default_rng([seed, 0]))
    camera = filming.camera
    write_video(
        folder / "video.mp4",
        track(progress, "Filming", frames, len(time)),
        (camera.width, camera.height),
        bench.fps,
        filming.scene.crf,
    )
    log, clean = force_log(filming, motion, np.random.default_rng([seed, 1]))
    write_log(folder / "force.csv", log)
    (folder / FILE_NAME).write_text(recording_toml(entries(filming, folder)), encoding="utf-8")
    shown = moments.part(slice(1, None, 3))
    moved = camera_moves.shift(time)
    write_truth(folder / "truth", FilmTruth(filming, shown, motion, moved, view, log, clean, seed))
    return folder


def refuse_sharp_bends(filming: Filming, shapes: BeamShapes) -> None:
    """An error where a bend's inner side would fold: no beam of this width bends so."""
    turn = np.abs(np.diff(shapes.angle, axis=1)) / np.diff(PLACES) / filming.bench.beam.length
    half = 0.5 * np.asarray(filming.width(0.5 * (PLACES[1:] + PLACES[:-1])))
    tightest = float(np.max(turn * half))
    if tightest >= SHARPEST:
        peak, middle = filming.bench.push.peak, 1e3 * float(half.mean())
        raise RecordingError(
            f"{peak:.3g} N would bend the beam to a radius of {middle / tightest:.2g} mm, which its width of "
            f"{2.0 * middle:.2g} mm does not allow. Give a smaller force."
        )


def cast_of(filming: Filming, rng: np.random.Generator) -> MovingScene:
    """What moves, but for its motion. Where each tag falls on the printer's grid of dots is drawn."""
    told = declared_recording(filming.bench).tags
    ids = [tag.id for tag in (*told.on_base, *told.on_beam)]
    made = [outlines(tag, told.family) for tag in ids]
    dot = INCH / filming.scene.print_dpi if filming.scene.print_dpi > 0.0 else 0.0
    return MovingScene(
        scene=filming.scene,
        push=filming.bench.push,
        half_width=0.5 * np.asarray(filming.width(PLACES), dtype=float),
        tags=tuple(as_printed(outline, filming.tag_size, dot, rng.random(2)) for outline in made),
        base_angle=filming.base_angle,
    )


def to_be_seen(cast: MovingScene, moments: Moments) -> Array:
    """(N, 2) m: the paper of every tag at every time, and the beam."""
    tags = moments.tags[..., :3]
    corners = [
        placed(tag.paper[0], pose) for i, tag in enumerate(cast.tags) for pose in tags[:: max(1, len(tags) // 200), i]
    ]
    return np.concatenate([*corners, moments.beam[::5, :, :2].reshape(-1, 2)])


def stage_of(filming: Filming, cast: MovingScene, view: View, beam: Array, seed: int) -> StaticScene:
    """The table with the clamp on it."""
    reach = 0.03 + float(np.max(cast.half_width)) + filming.tag_size
    xy = beam[:: max(1, len(beam) // 100), :, :2].reshape(-1, 2)
    corners = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) * reach
    moving = (xy[:, None] + corners).reshape(-1, 2)
    still = clamp_block(filming.scene, filming.base_angle)
    return stage(filming.scene, view, (filming.camera.width, filming.camera.height), still, moving, seed)


def pictures(shot: Shot, time: Array, rng: np.random.Generator) -> Iterator[tuple[float, YuvFrame]]:
    """Frames in order with their times."""
    for i, now in enumerate(time.tolist()):
        part = slice(3 * i, 3 * i + 3)
        first = shot.first.part(part)
        last = first if shot.last is shot.first else shot.last.part(part)
        exposure = replace(shot, first=first, last=last)
        yield now, frame_of(shot.staged, [drawn(exposure, now, u) for u in moments_of(exposure)], now, rng)


def moments_of(shot: Shot) -> list[float]:
    """Moments of one exposure that are drawn, -1 at its beginning and 1 at its end."""
    tags, beam = shot.first.tags, shot.first.beam
    ends = project(shot.staged.view, np.concatenate([tags[[0, 2], :, :2], beam[[0, 2], ::30, :2]], axis=1))
    moved = float(np.max(np.abs(ends[1] - ends[0])))
    count = int(np.clip(np.ceil(moved / STEPS), 1, MOST_MOMENTS))
    return [(2.0 * i + 1.0) / count - 1.0 for i in range(count)]


def drawn(shot: Shot, time: float, u: float) -> Drawing:
    """All that moves at moment `u` of an exposure, by a parabola through its begin, middle and end."""
    weights = np.array([0.5 * u * (u - 1.0), 1.0 - u * u, 0.5 * u * (u + 1.0)])
    now = time + 0.5 * u * shot.cast.scene.exposure

    def at(moments: Moments, when: float) -> Drawing:
        beam, tags = np.tensordot(weights, moments.beam, 1), np.tensordot(weights, moments.tags, 1)
        contact = float(weights @ moments.contact)
        return moment_of(shot.cast, BeamPose(when, beam[:, :2], beam[:, 2], tags, beam[:, 3], contact))

    first = at(shot.first, now)
    if shot.last is shot.first and shot.camera.still:
        return first
    last = at(shot.last, now + shot.readout)
    shift = shot.camera.shift(np.array([now, now + shot.readout]))
    return over_rows(first, last, shift, shot.staged.table.y.shape[0])


def force_log(filming: Filming, motion: RodMotion | None, rng: np.random.Generator) -> tuple[ForceLog, ForceLog]:
    """What the sensor logs, and the true force on the log's clock; both in the log's axes and with its sign."""
    bench, margin = filming.bench, filming.log_before
    step = min(DENSE, 0.5 / bench.sensor.rate)
    dense = np.arange(-margin, bench.push.duration + margin, step)
    acts_on = "robot" if filming.log_of_robot else "beam"
    force = in_log_axes(bench.push.force(dense), filming.log_rotation, acts_on)
    felt = in_log_axes(sensed(bench, dense, motion), filming.log_rotation, acts_on)
    log = log_of(bench.sensor, dense, felt, rng, offset=bench.clock.offset)
    clean = np.stack([np.interp(log.time - bench.clock.offset, dense, column) for column in force.T], axis=1)
    return log, ForceLog(log.time, clean)


def entries(filming: Filming, folder: Path) -> Recording:
    """What `recording.toml` says."""
    bench, told = filming.bench, declared_recording(filming.bench)
    assert told.video is not None
    assert told.force is not None
    mass = nan
    if filming.mass_told and float(np.min(bench.beam.mass_per_length(PLACES))) > 0.0:
        mass = round(float(np.trapezoid(bench.beam.mass_per_length(PLACES), PLACES)) * bench.beam.length, 5)
    return replace(
        told,
        folder=folder,
        beam=BeamEntry(length=told.beam.length, mass=mass, rest=told.beam.rest),
        tags=replace(told.tags, size=filming.tag_size),
        camera=calibration(filming.camera) if filming.calibrated else None,
        video=replace(told.video, file=folder / "video.mp4", fps=bench.fps),
        force=ForceEntry(
            file=folder / "force.csv",
            rotation=filming.log_rotation,
            acts_on="robot" if filming.log_of_robot else "beam",
            sensor=filming.sensor_name,
            zeroed=filming.zeroed,
            gain_sd=told.force.gain_sd,
        ),
        gravity=GravityEntry(direction=DOWN, magnitude=filming.gravity, base_angle=filming.base_angle)
        if filming.gravity > 0.0
        else None,
    )
