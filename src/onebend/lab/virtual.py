"""Virtual recordings: a known beam pushed, filmed and logged, with known errors.

They replace tag detection and the log file (`Markers`, `ForceLog`, the entries of recording.toml); all later steps are
those of a real recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isnan, nan
from pathlib import Path

import numpy as np

from onebend import records
from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.errors import MechanicsError, RecordingError
from onebend.lab import bench as benches
from onebend.lab.designs import RESOLUTION
from onebend.lab.rod import STEP, RodMotion, RodTask, march
from onebend.progress import one_blas_thread
from onebend.recording.entries import BeamEntry, ForceEntry, PushEntry, Recording, TagEntry, TagsEntry, VideoEntry
from onebend.recording.observe import ObserveSettings, assemble

LOG_BEFORE = 1.0  # s, the log extends beyond the film at both ends
DENSE = 1e-3  # s, step of the true force


@dataclass(frozen=True)
class VirtualTag:
    """A tag's stated place, and its true offset from there."""

    id: int
    s: float
    along: float = 0.0  # m
    across: float = 0.0  # m
    turn: float = 0.0  # rad


@dataclass(frozen=True)
class VirtualClock:
    """`log time = film time + offset`, and the stated offset."""

    offset: float = 250.0  # s
    declared: float = 250.0  # s
    uncertainty: float = 2.0  # s, largest error of `declared`


@dataclass(frozen=True)
class DeclaredValues:
    """Stated values in recording.toml; NaN: the truth."""

    length: float = nan  # m
    push_s: float = nan
    placement_sd: float = 5e-4  # m
    place_sd: float = records.PLACE_SD  # m, place of the push
    axes: float = 0.0  # rad, stated turn of the log's x axis from the beam's; truly 0
    axes_sd: float = records.DIRECTION_SD  # rad
    rest: records.Rest = "straight"
    gain_sd: float = nan
    tag_size: float = 0.012  # m


@dataclass(frozen=True)
class VirtualBench:
    """Beam, push, tags, instruments, and what recording.toml states."""

    beam: Beam
    push: benches.PushProfile
    tags: tuple[VirtualTag, ...] = (VirtualTag(1, 1.0 / 3.0), VirtualTag(2, 2.0 / 3.0), VirtualTag(3, 1.0))
    base: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, m, rad: base tag in the clamp's frame
    sensor: benches.ForceSensor = field(default_factory=benches.ForceSensor)
    camera: benches.TagNoise = field(default_factory=benches.TagNoise)
    fps: float = 15.0
    clock: VirtualClock = field(default_factory=VirtualClock)
    declared: DeclaredValues = field(default_factory=DeclaredValues)
    effects: benches.RealBench = field(default_factory=benches.RealBench)  # those of the picture in films only
    name: str = "virtual"


@dataclass(frozen=True)
class VirtualRecording:
    bench: VirtualBench
    recording: Recording
    markers: records.Markers
    log: records.ForceLog
    force: records.Array  # (T, 2) N, true, at the frames; clamp's frame
    pose: records.Array  # (T, m, 3) m, m, rad: true tags in the clamp's frame
    motion: RodMotion | None = None  # present if effects change poses or force


@dataclass(frozen=True)
class TrueStiffness:
    """k(s) [N m]: the best a static model can find, before relaxation, and that without patches."""

    k: records.Array  # secant modulus times `k_instant`
    k_instant: records.Array
    k_bare: records.Array


@one_blas_thread
def virtual_recording(bench: VirtualBench, *, seed: int) -> VirtualRecording:
    """Film and log one push. Camera and sensor have separate random streams. Raises `MechanicsError`: snap-through.
    Raises `RecordingError`: frame rate not positive, or no tag."""
    if not bench.fps > 0.0 or not bench.tags:
        raise RecordingError("a virtual recording needs a frame rate above zero and at least one tag on the beam")
    camera_rng, sensor_rng = (np.random.default_rng([seed, stream]) for stream in (0, 1))
    time = np.arange(0.0, bench.push.duration, 1.0 / bench.fps)
    force = bench.push.force(time)
    motion = motion_of(bench, time[-1])
    if motion is None:
        pose = tag_poses(bench, force)
    else:
        pose = tag_poses_on(bench, motion.poses(time, np.clip(tag_places(bench), 0.0, 1.0)))
    poses, covariance = benches.filmed(bench.camera, from_base(pose, bench.base), 1.0 / bench.fps, camera_rng)
    markers = markers_of(bench.tags, time, poses, covariance)
    dense = np.arange(-LOG_BEFORE, bench.push.duration + LOG_BEFORE, DENSE)
    log = benches.log_of(bench.sensor, dense, sensed(bench, dense, motion), sensor_rng, offset=bench.clock.offset)
    return VirtualRecording(bench, declared_recording(bench), markers, log, force, pose, motion)


def markers_of(
    tags: Sequence[VirtualTag], time: records.Array, poses: records.Array, covariance: records.Array
) -> records.Markers:
    """Tags with poses (T, m, 3) [m, m, rad] relative to the base tag and covariance (T, m, 3, 3)."""
    return records.Markers(
        time=time,
        tag_id=np.array([tag.id for tag in tags], dtype=np.int64),
        s=np.array([tag.s for tag in tags]),
        xy=poses[..., :2],
        angle=poses[..., 2],
        covariance=covariance,
        base_angle=np.zeros(len(time)),
        view=None,
    )


def motion_of(
    bench: VirtualBench, until: float, *, at: records.Array | None = None, gravity: tuple[float, float] = (0.0, 0.0)
) -> RodMotion | None:
    """The motion if effects change beam or log; None: as `beam.statics`. Raises `MechanicsError`: snap-through, or
    weight or inertia with an unknown mass."""
    effects = bench.effects
    if not (effects.moves_otherwise or effects.posture_bias):
        return None
    task = RodTask(bench.beam, effects, tag_places(bench), bench.push.force, bench.push.at_s, until, gravity)
    parts = int(np.ceil(1.0 / (bench.fps * STEP)))
    return march(task, 1.0 / (bench.fps * parts), at=at)


def sensed(bench: VirtualBench, time: records.Array, motion: RodMotion | None) -> records.Array:
    """(N, 2) N at `time` (N,) [s]: true force plus posture bias."""
    force = bench.push.force(time)
    if motion is None or not bench.effects.posture_bias:
        return force
    error = benches.posture_bias(bench.effects, motion.tool, bench.beam.length, bench.push.peak)
    return np.asarray(force + np.stack([np.interp(time, motion.time, column) for column in error.T], axis=1))


def true_stiffness(bench: VirtualBench, motion: RodMotion | None, s: records.Array) -> TrueStiffness:
    bare = np.asarray(bench.beam.stiffness(s))
    instant = benches.instant_stiffness(bench.beam, bench.effects, tag_places(bench), s)
    return TrueStiffness((1.0 if motion is None else motion.secant) * instant, instant, bare)


@one_blas_thread
def observe_virtual(virtual: VirtualRecording, settings: ObserveSettings = ObserveSettings()) -> records.Observations:
    """The usual way from markers and log to observations. Raises `ObservationError`: as for a real recording."""
    return assemble(virtual.recording, virtual.markers, virtual.log, None, settings)


def standing(
    beam: Beam, force: records.Array, at_s: float, s: records.Array, gravity: tuple[float, float] = (0.0, 0.0)
) -> records.Array:
    """(T, S, 3) m, m, rad at `s` (S,): equilibria under forces (T, 2) N. Raises `MechanicsError`: snap-through."""
    solved = equilibrium(beam, push(force, at_s) + weight(gravity), resolution=RESOLUTION)
    if not np.all(solved.converged):
        largest = float(np.max(np.linalg.norm(force, axis=1)))
        raise MechanicsError(f"the virtual beam snaps through under {largest:.3g} N or less. Give a smaller force")
    return solved.poses(s)


def tag_poses(bench: VirtualBench, force: records.Array) -> records.Array:
    """(T, m, 3) the tags in the clamp's frame under forces (T, 2)."""
    return tag_poses_on(bench, standing(bench.beam, force, bench.push.at_s, np.clip(tag_places(bench), 0.0, 1.0)))


def tag_places(bench: VirtualBench) -> records.Array:
    """(m,) true places; outside 0..1 where a tag sticks out."""
    return np.array([tag.s + tag.along / bench.beam.length for tag in bench.tags])


def tag_poses_on(bench: VirtualBench, beam: records.Array) -> records.Array:
    """(T, m, 3) tags from the beam's poses (T, m, 3) at their places clipped to 0..1."""
    real, angle = tag_places(bench), beam[..., 2]
    beyond = bench.beam.length * (real - np.clip(real, 0.0, 1.0))  # a tag may stick out over the tip
    across = np.array([tag.across for tag in bench.tags])
    xy = beam[..., :2] + records.rotated(records.paired(beyond, across), angle)
    turn = np.array([tag.turn for tag in bench.tags])
    return np.concatenate([xy, (angle + turn)[..., None]], axis=-1)


def from_base(pose: records.Array, base: tuple[float, float, float]) -> records.Array:
    """Poses (T, m, 3) relative to the base tag."""
    x, y, turn = base
    return np.concatenate([records.rotated(pose[..., :2] - np.array([x, y]), -turn), pose[..., 2:] - turn], axis=-1)


def declared_recording(bench: VirtualBench) -> Recording:
    declared, clock, at = bench.declared, bench.clock, Path("virtual") / bench.name
    length = bench.beam.length if isnan(declared.length) else declared.length
    return Recording(
        folder=at,
        name=bench.name,
        beam=BeamEntry(length=length * (1.0 + bench.effects.length_off), rest=declared.rest),
        tags=TagsEntry(
            size=declared.tag_size,
            placement_sd=declared.placement_sd,
            on_base=(TagEntry(id=0, s=0.0),),
            on_beam=tuple(TagEntry(id=tag.id, s=tag.s) for tag in bench.tags),
        ),
        camera=None,
        video=VideoEntry(file=at / "video.mp4", start=clock.declared, start_uncertainty=clock.uncertainty),
        force=ForceEntry(
            file=at / "force.csv",
            rotation=declared.axes,
            rotation_sd=declared.axes_sd,
            gain_sd=bench.sensor.gain_sd if isnan(declared.gain_sd) else declared.gain_sd,
        ),
        push=PushEntry(at=bench.push.at_s if isnan(declared.push_s) else declared.push_s, at_sd=declared.place_sd),
        gravity=None,
    )
