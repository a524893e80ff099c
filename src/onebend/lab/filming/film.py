"""A recording folder of a known beam: the film as pixels, the force log, `recording.toml`, and the truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np

from onebend.blas import one_blas_thread
from onebend.errors import RecordingError
from onebend.lab.filming.film_setup import DOWN, Filming, check, frame_times, motive_of
from onebend.lab.filming.force_log_file import in_log_axes, write_log
from onebend.lab.filming.movement import PLACES, BeamShapes, shapes_at
from onebend.lab.filming.moving_scene import BeamPose, MovingScene, clamp_block, moment_of
from onebend.lab.filming.printed_tag import as_printed, outlines, placed
from onebend.lab.filming.recording_toml import recording_toml
from onebend.lab.filming.render import Drawing, StaticScene, YuvFrame, frame_of, stage
from onebend.lab.filming.scene import Scene
from onebend.lab.filming.truth_file import FilmTruth, write_truth
from onebend.lab.filming.video_file import write_video
from onebend.lab.filming.viewpoint import calibration, view_from
from onebend.lab.sensors import log_of
from onebend.lab.virtual import DENSE, declared_recording, tag_places, tag_poses_on
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
    before, middle, after = (time + part * 0.5 * filming.scene.exposure for part in (-1.0, 0.0, 1.0))
    shapes = shapes_at(bench.beam, bench.push, np.stack([before, middle, after], axis=1).ravel(), motive_of(filming))
    refuse_sharp_bends(filming, shapes)
    tags = in_room(tag_poses(filming, shapes), filming.base_angle)
    beam = in_room(np.concatenate([shapes.xy, shapes.angle[..., None]], axis=-1), filming.base_angle)
    cast = cast_of(filming, np.random.default_rng([seed, 12]))
    view = view_from(filming.camera, to_be_seen(cast, beam, tags))
    staged = stage_of(filming, cast, view, beam, seed)
    folder.mkdir(parents=True, exist_ok=True)
    frames = pictures(staged, cast, time, beam, tags, np.random.default_rng([seed, 0]))
    camera = filming.camera
    write_video(
        folder / "video.mp4",
        track(progress, "Filming", frames, len(time)),
        (camera.width, camera.height),
        bench.fps,
        filming.scene.crf,
    )
    log, clean = force_log(filming, np.random.default_rng([seed, 1]))
    write_log(folder / "force.csv", log)
    (folder / FILE_NAME).write_text(recording_toml(entries(filming, folder)), encoding="utf-8")
    inner = slice(1, None, 3)
    shown = BeamShapes(time, shapes.force[inner], shapes.xy[inner], shapes.angle[inner])
    write_truth(folder / "truth", FilmTruth(filming, shown, tags[inner], view, log, clean, seed))
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


def tag_poses(filming: Filming, shapes: BeamShapes) -> Array:
    """(T, m + 1, 3) the base tag and those on the beam, clamp's frame."""
    bench = filming.bench
    xy, angle = shapes.at(tag_places(bench))
    base = np.tile(np.array(bench.base), (len(shapes.time), 1, 1))
    return np.concatenate([base, tag_poses_on(bench, xy, angle)], axis=1)


def in_room(pose: Array, base_angle: float) -> Array:
    """Poses (..., 3) in the room, from the clamp's frame."""
    cos, sin = np.cos(base_angle), np.sin(base_angle)
    xy = pose[..., :2] @ np.array([[cos, sin], [-sin, cos]])
    return np.concatenate([xy, pose[..., 2:] + base_angle], axis=-1)


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


def to_be_seen(cast: MovingScene, beam: Array, tags: Array) -> Array:
    """(N, 2) m: the paper of every tag at every time, and the beam."""
    corners = [
        placed(tag.paper[0], pose) for i, tag in enumerate(cast.tags) for pose in tags[:: max(1, len(tags) // 200), i]
    ]
    return np.concatenate([*corners, beam[::5, :, :2].reshape(-1, 2)])


def stage_of(filming: Filming, cast: MovingScene, view: View, beam: Array, seed: int) -> StaticScene:
    """The table with the clamp on it."""
    reach = 0.03 + float(np.max(cast.half_width)) + filming.tag_size
    xy = beam[:: max(1, len(beam) // 100), :, :2].reshape(-1, 2)
    corners = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) * reach
    moving = (xy[:, None] + corners).reshape(-1, 2)
    still = clamp_block(filming.scene, filming.base_angle)
    return stage(filming.scene, view, (filming.camera.width, filming.camera.height), still, moving, seed)


def pictures(
    staged: StaticScene, cast: MovingScene, time: Array, beam: Array, tags: Array, rng: np.random.Generator
) -> Iterator[tuple[float, YuvFrame]]:
    """Frames in order with their times. `beam` (3 T, S, 3), `tags` (3 T, m, 3): begin, middle, end of exposures."""
    for i, now in enumerate(time.tolist()):
        part = slice(3 * i, 3 * i + 3)
        moments = moments_of(staged, beam[part], tags[part])
        shown = [drawn(cast, staged.scene, now, u, beam[part], tags[part]) for u in moments]
        yield now, frame_of(staged, shown, now, rng)


def moments_of(staged: StaticScene, beam: Array, tags: Array) -> list[float]:
    """Moments of one exposure that are drawn, -1 at its beginning and 1 at its end."""
    ends = project(staged.view, np.concatenate([tags[[0, 2], :, :2], beam[[0, 2], ::30, :2]], axis=1))
    moved = float(np.max(np.abs(ends[1] - ends[0])))
    count = int(np.clip(np.ceil(moved / STEPS), 1, MOST_MOMENTS))
    return [(2.0 * i + 1.0) / count - 1.0 for i in range(count)]


def drawn(cast: MovingScene, scene: Scene, time: float, u: float, beam: Array, tags: Array) -> Drawing:
    """All that moves at moment `u` of an exposure, by a parabola through its begin, middle and end."""
    weights = np.array([0.5 * u * (u - 1.0), 1.0 - u * u, 0.5 * u * (u + 1.0)])
    shape, at = np.tensordot(weights, beam, 1), np.tensordot(weights, tags, 1)
    return moment_of(cast, BeamPose(time + 0.5 * u * scene.exposure, shape[:, :2], shape[:, 2], at))


def force_log(filming: Filming, rng: np.random.Generator) -> tuple[ForceLog, ForceLog]:
    """What the sensor logs, and the true force on the log's clock; both in the log's axes and with its sign."""
    bench, margin = filming.bench, filming.log_before
    step = min(DENSE, 0.5 / bench.sensor.rate)
    dense = np.arange(-margin, bench.push.duration + margin, step)
    acts_on = "robot" if filming.log_of_robot else "beam"
    force = in_log_axes(bench.push.force(dense), filming.log_rotation, acts_on)
    log = log_of(bench.sensor, dense, force, rng, offset=bench.clock.offset)
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
