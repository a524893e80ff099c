"""The virtual film: scene, camera, rendering, recording folder and its truth."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from fractions import Fraction
from functools import cache
from math import isfinite, nan, pi
from pathlib import Path
from typing import Any

import av
import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline

from onebend.beam.dynamics import Actions, AppliedForce, body
from onebend.beam.integration import converged
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.stiffness import Profile, Scaled, Uniform
from onebend.beam.vibration import settle
from onebend.errors import MechanicsError, RecordingError
from onebend.lab import rendering, virtual
from onebend.lab.bench import PushProfile, RealBench, log_of, rest_curvature, smooth
from onebend.lab.rod import RodMotion
from onebend.progress import Progress, Silent, one_blas_thread, track
from onebend.recording import bag_topics, plane, schema, tag_finder
from onebend.recording.entries import FAMILIES, BeamEntry, ForceEntry, GravityEntry, MarkersEntry, Recording
from onebend.recording.folder import FILE_NAME, FORMAT
from onebend.records import Array, ForceLog, View, left_of, rotated, unit
from onebend.text_files import plain


def in_log_axes(force: Array, rotation: float, acts_on: str) -> Array:
    """(N, 2) N in axes turned by `rotation` [rad] from the beam's; the reaction if it `acts_on` the "robot"."""
    return rotated(-force if acts_on == "robot" else force, -rotation)


def write_log(path: Path, log: ForceLog) -> None:
    """`time_s, fx_N, fy_N`, to 0.1 ms and 0.01 mN."""
    rows = np.column_stack([log.time, log.force])
    np.savetxt(path, rows, fmt=("%.4f", "%.5f", "%.5f"), delimiter=",", header="time_s,fx_N,fy_N", comments="")


# Motion of a known beam under a push: equilibria if slow, the equation of motion if fast.

PLACES = np.linspace(0.0, 1.0, 121)
BATCH = 400  # equilibria at a time
STEP, TOLERANCE = 4e-3, 1e-5  # s, first step; m, error at the markers
ORDER = 12  # curvature nodes


def shapes_at(
    beam: Beam,
    pushing: PushProfile,
    time: Array,
    *,
    gravity: tuple[float, float] = (0.0, 0.0),
    swings: bool = False,
    damping: float = 0.006,
    rotary_inertia: Profile = Uniform(0.0),
) -> Array:
    """(T, 121, 3) m, m, rad: the beam in the clamp's frame at rising times (T,) [s] and `PLACES`; at rest before 0.

    Args:
        gravity: m/s^2, clamp's frame.
        swings: by the equation of motion, else by equilibria.
        damping: s, internal (Kelvin-Voigt) damping over stiffness.
        rotary_inertia: kg m.

    Raises:
        MechanicsError: snap-through, or weight or inertia with an unknown mass.
    """
    if (swings or any(gravity)) and not float(np.min(beam.mass_per_length(PLACES))) > 0.0:
        raise MechanicsError("a beam without mass has neither weight nor inertia. Give it a mass per length")
    if not swings:
        force = pushing.force(time)
        parts = [
            virtual.standing(beam, force[i : i + BATCH], pushing.at_s, PLACES, gravity)
            for i in range(0, len(time), BATCH)
        ]
        return np.concatenate(parts)
    moving = body(
        beam, rotary_inertia=rotary_inertia, damping=Scaled(damping, beam.stiffness), resolution=Resolution(ORDER)
    )
    breaks = tuple(sorted({pushing.before, pushing.before + pushing.rise, *pushing.contact}))
    on_beam = AppliedForce(lambda t: pushing.force(np.array([t]))[0], pushing.at_s, breaks)
    actions = Actions(forces=(on_beam,), gravity=gravity)
    start, until = settle(moving, actions), float(time[-1])
    if not (isfinite(until) and until > 0.0):
        raise MechanicsError("a film lasts longer than 0 s")
    motion = converged(moving, start, until, actions, tolerance=TOLERANCE, step=STEP, at_s=(1 / 3, 2 / 3, 1.0))
    theta = motion.states_at(np.clip(time, 0.0, until))
    parts = [theta[i : i + BATCH] for i in range(0, len(theta), BATCH)]
    poses = [(moving.xy(PLACES, part), moving.angle(PLACES, part)[..., None]) for part in parts]
    return np.concatenate([np.concatenate(pose, axis=-1) for pose in poses])


def between_places(poses: Array, s: Array) -> Array:
    """(T, m, 3) of poses (T, 121, 3) at `PLACES`: at `s` (m,), cubic."""
    return np.asarray(CubicSpline(PLACES, poses, axis=1)(np.clip(s, 0.0, 1.0)))


DOWN = -0.5 * pi  # rad, gravity in the room


@dataclass(frozen=True)
class Filming:
    """A bench and its film. The bench's own camera (pose noise) is not used."""

    bench: virtual.VirtualBench
    width: Profile = field(default_factory=lambda: Uniform(0.014))  # m, of the drawn beam
    rotary_inertia: Profile = field(default_factory=lambda: Uniform(0.0))  # kg m; used if it swings
    camera: rendering.Camera = field(default_factory=rendering.Camera)
    scene: rendering.Scene = field(default_factory=rendering.Scene)
    swings: bool = False  # equation of motion instead of equilibria
    damping: float = 0.006  # s, internal damping over stiffness
    gravity: float = 0.0  # m/s^2, downwards in the picture; 0: across the plane of bending
    base_angle: float = 0.0  # rad, the beam's x axis in the room
    tag_size: float = 0.012  # m
    log_rotation: float = 0.0  # rad, the log's x axis from the beam's
    log_of_robot: bool = False  # the log shows the reaction
    sensor_name: str = ""
    calibrated: bool = True  # whether the calibration is given
    mass_told: bool = True
    lost: float = 0.0  # share of dropped frames


def check(filming: Filming, folder: Path) -> None:
    """Checks across parts of the setup."""
    bench = filming.bench
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise RecordingError(f"{folder} is not an empty folder. Name another one.")
    if not bench.tags or not bench.fps > 0.0:
        raise RecordingError("a film needs a frame rate above zero and at least one tag on the beam")
    if not filming.scene.exposure < 1.0 / bench.fps:
        raise RecordingError(
            f"an exposure of {filming.scene.exposure:g} s does not fit {bench.fps:g} frames/s. Shorten it."
        )
    if not 0.0 <= filming.lost < 0.5:
        raise RecordingError(f"a camera loses a share of its frames in [0, 0.5), got {filming.lost}")
    if filming.swings and (bench.effects.moves_otherwise or bench.effects.posture_bias):
        raise RecordingError("a beam that swings is filmed without effects on its motion: take a slow push")
    for given in (bench.effects.tag_heights, bench.effects.tag_tilts):
        if given and len(given) != len(bench.tags):
            raise RecordingError("tag_heights and tag_tilts have one value for each tag on the beam, or none")


def frame_times(filming: Filming, rng: np.random.Generator) -> Array:
    """(T,) s, mid-exposures from that of the first frame; dropped frames are missing."""
    count = int(np.ceil(filming.bench.push.duration * filming.bench.fps))
    kept = rng.random(count) >= filming.lost
    kept[0] = True
    return np.asarray(np.flatnonzero(kept) / filming.bench.fps)


def gravity_of(filming: Filming) -> tuple[float, float]:
    """m/s^2, clamp's frame."""
    turn = DOWN - filming.base_angle
    return filming.gravity * math.cos(turn), filming.gravity * math.sin(turn)


@dataclass(frozen=True)
class TagOutlines:
    """Polygons of a tag, in sides of its detected square: origin in its middle, x to the print's right, y up."""

    paper: Array  # (1, 4, 2)
    ink: Array  # (K, 4, 2): neighbouring black cells of a row are one patch


@cache
def outlines(tag_id: int, family: str = FAMILIES[0]) -> TagOutlines:
    """Outlines on paper at least a cell wider per side than the detected square. Raises `RecordingError`: unknown
    family or id."""
    tag = tag_finder.printed_tag(tag_id, family)
    count = len(tag.cells)
    beyond = max(1.0 - tag.margin, 0.0)
    scale, middle = np.array([1.0, -1.0]) / tag.border, 0.5 * count
    paper = (rectangle(-beyond, count + beyond, -beyond, count + beyond) - middle) * scale
    return TagOutlines(paper[None], (tag.ink - middle) * scale)


def as_printed(made: TagOutlines, size: float, dot: float, phase: Array) -> TagOutlines:
    """In metres, for a square of `size`, with every edge rounded to the printer's dots.

    `dot` [m] is the grid's step (0: exact), `phase` (2,) in [0, 1) the tag's middle on it. Edges are off by up to `dot`
    / 2, evenly distributed.
    """
    if dot == 0.0:
        return TagOutlines(size * made.paper, size * made.ink)
    on_grid = dot * (np.round(size * made.ink / dot + phase) - phase)
    return TagOutlines(size * made.paper, on_grid)


def rectangle(left: float, right: float, top: float, bottom: float) -> Array:
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]], dtype=float)


def placed(loops: Array, pose: Array) -> Array:
    """Polygons (..., corners, 2) [m] at the pose (3,) x, y [m], angle [rad]."""
    return rotated(loops, pose[2]) + pose[:2]


SHADOW = np.array([0.0025, -0.003])  # m, offset of a shadow
STRIPS = ((1.0, 0.92), (0.75, 1.0))  # of the beam: share of width, brightness
PIECE = 30  # beam nodes per piece
TOOL_LENGTH = 0.25  # m
STEEPEST = 0.4  # sine of the force's angle to the beam, from which on the tool's end reaches into it
RETREAT, APPROACH = 0.04, 0.8  # m the tool waits away; s it takes to come
HAND = (0.035, 0.022)  # m, half axes
HAND_SPEED, HAND_TIME = 0.12, 1.2  # m/s; s before and after it passes
CLAMP = (0.046, 0.05)  # m


@dataclass(frozen=True)
class MovingScene:
    """The unchanging shapes and colours of all that moves."""

    scene: rendering.Scene
    push: PushProfile
    half_width: Array  # (S,) m
    tags: tuple[TagOutlines, ...]  # m, as printed; base tag first
    base_angle: float  # rad: the clamp's frame in the room


def clamp_block(scene: rendering.Scene, base_angle: float) -> rendering.Drawing:
    """The clamp block, which ends at the base."""
    length, width = CLAMP
    block = np.array([[-length, -width / 2], [0.004, -width / 2], [0.004, width / 2], [-length, width / 2]])
    inner = 0.92 * (block - block.mean(axis=0)) + block.mean(axis=0)
    pose = np.array([0.0, 0.0, base_angle])
    outer = placed(block, pose)
    layers = [
        rendering.ColourLayer(outer, dimmed(scene.clamp, 0.8)),
        rendering.ColourLayer(placed(inner, pose), scene.clamp),
    ]
    return rendering.Drawing([rendering.Shadow(outer + SHADOW, soft=6.0)], layers)


def moment_of(cast: MovingScene, time: float, beam: Array, tags: Array, contact: float) -> rendering.Drawing:
    """At `time` [s], as one moment of `Filmed`."""
    scene, tool = cast.scene, tool_outline(cast, time, beam, contact)
    above = scene.overlap > 0.0  # otherwise it pushes the flank, and its upper edge is half a width below the tags
    lower = rendering.lifted(tool, np.full(len(tool), -0.5 * scene.tool_width))
    layers = [] if above else [rendering.ColourLayer(lower, scene.tool)]
    parts = [slice(first, first + PIECE + 2) for first in range(0, len(beam) - 1, PIECE)]
    layers += [  # in overlapping pieces, so that no seam shows
        rendering.ColourLayer(strip(beam[part], share * cast.half_width[part]), dimmed(scene.beam, bright))
        for share, bright in STRIPS
        for part in parts
    ]
    for tag, at in zip(cast.tags, tags, strict=True):
        layers.append(rendering.ColourLayer(rendering.placed_in_space(tag.paper, at), grey(scene.paper)))
        layers.append(rendering.ColourLayer(rendering.placed_in_space(tag.ink, at), grey(scene.ink)))
    if above:
        layers.append(rendering.ColourLayer(tool, scene.tool))
    if abs(time - scene.hand_at) < HAND_TIME:
        layers.append(rendering.ColourLayer(hand_outline(beam, time - scene.hand_at), scene.hand))
    shadows = [
        rendering.Shadow(strip(beam, cast.half_width)[:, :2] + SHADOW),
        rendering.Shadow(tool + SHADOW, density=0.3),
    ]
    return rendering.Drawing(shadows, layers)


def over_rows(drawings: Sequence[rendering.Drawing], shift: Array, rows: int) -> rendering.Drawing:
    """Merge drawings of the same things as exposed in the first, middle and last row.

    `shift` (3, 2) px: the camera's shift at these rows. A hand that appears or leaves meanwhile is as in the first.
    """
    first, *later = drawings
    if any(len(one.layers) != len(first.layers) for one in later):
        later = []
    layers = [replace(one, late=tuple(d.layers[i].loops for d in later)) for i, one in enumerate(first.layers)]
    shadows = [replace(one, late=tuple(d.shadows[i].loops for d in later)) for i, one in enumerate(first.shadows)]
    return rendering.Drawing(shadows, layers, shift, rows)


def grey(level: float) -> rendering.Colour:
    return (level, level, level)


def dimmed(colour: rendering.Colour, share: float) -> rendering.Colour:
    return (colour[0] * share, colour[1] * share, colour[2] * share)


def strip(beam: Array, half_width: Array) -> Array:
    """Outline (2 S, 2) m, or (2 S, 3), of the beam (S, 4)."""
    xy, angle, height = beam[:, :2], beam[:, 2], beam[:, 3]
    left = half_width[:, None] * left_of(unit(angle))
    outline = np.concatenate([xy - left, (xy + left)[::-1]])
    return rendering.lifted(outline, np.concatenate([height, height[::-1]]))


def tool_outline(cast: MovingScene, time: float, beam: Array, contact: float) -> Array:
    """A chamfered bar; its end touches the beam's edge where the line of the force to the push leaves the beam. It
    waits aside before and after."""
    push, places = cast.push, np.linspace(0.0, 1.0, len(beam))
    angle = float(push.angle(np.array([time]))[0]) + cast.base_angle
    along = unit(angle)
    *touch, turn = (np.interp(contact, places, beam[:, i]) for i in range(3))
    half = float(np.interp(contact, places, cast.half_width)) / max(abs(math.sin(angle - turn)), STEEPEST)
    begin, end = push.contact
    away = smooth(np.array([(begin - time) / APPROACH]))[0]
    if push.after > 0.0:
        away = away + smooth(np.array([(time - end) / APPROACH]))[0]
    tip = np.array(touch) + along * (cast.scene.overlap - half - RETREAT * away)
    wide, cut = 0.5 * cast.scene.tool_width, 0.25 * cast.scene.tool_width
    bar = np.array([[0, -wide + cut], [0, wide - cut], [-cut, wide], [-TOOL_LENGTH, wide]])
    bar = np.concatenate([bar, [[-TOOL_LENGTH, -wide], [-cut, -wide]]])
    return placed(bar, np.array([tip[0], tip[1], angle + cast.scene.slant]))


def hand_outline(beam: Array, since: float) -> Array:
    """A blunt shape crossing the beam's middle, `since` [s]."""
    turn = np.linspace(0.0, 2.0 * np.pi, 41)[:-1]
    bump = 1.0 + 0.12 * np.cos(5.0 * turn)
    shape = bump[:, None] * np.stack([HAND[0] * np.cos(turn), HAND[1] * np.sin(turn)], axis=-1)
    middle = beam[len(beam) // 2, :2] + np.array([0.3, 1.0]) * HAND_SPEED * since
    return placed(shape, np.array([middle[0], middle[1], 1.2]))


def recording_toml(recording: Recording) -> str:
    """The text of a `recording.toml` for `recording`, the inverse of `read_recording`; unknown values are left out."""
    parts = [f"format = {FORMAT}\nname = {json.dumps(recording.name)}\n"]
    tags = recording.tags
    parts += [table("[beam]", recording.beam), table("[tags]", tags)]
    parts += [table("[[tags.on_base]]", tag) for tag in tags.on_base]
    parts += [table("[[tags.on_beam]]", tag) for tag in tags.on_beam]
    named = {name: getattr(recording, name) for name in ("camera", "video", "markers", "force", "push", "gravity")}
    parts += [table(f"[{name}]", entry) for name, entry in named.items() if entry is not None]
    return "\n".join(parts)


def table(header: str, entry: Any) -> str:
    """One table with its known keys; those of bags only for a bag."""
    lines = [header]
    bagged = bool(getattr(entry, "topic", ""))
    for name, (key, _) in schema.keys_of(type(entry)).items():
        if key.name in bag_topics.BAG_KEYS and not bagged:
            continue
        value = getattr(entry, name)
        unknown = value is None or value == "" or (isinstance(value, float) and not math.isfinite(value))
        if not unknown:
            lines.append(f"{key.name} = {as_toml(value, key)}")
    return "\n".join(lines) + "\n"


def as_toml(value: Any, key: schema.Key) -> str:
    """In the file's units."""
    if isinstance(value, Path):
        return json.dumps(value.name)
    if isinstance(value, tuple):
        return "[" + ", ".join(as_toml(item, key) for item in value) + "]"
    if isinstance(value, float):
        written = math.degrees(value) if key.name.endswith("_deg") else value
        short = f"{written:.10g}"
        return short if math.isclose(float(short), written, rel_tol=1e-15) else repr(written)
    return json.dumps(value)


# MP4 files: H.264, yuv420p, one timestamp per frame.

TIME_BASE = Fraction(1, 90_000)
PRESET = "veryfast"
# In pictures of 960 x 540 macroblock trees differ from run to run: a seed would not give the same film again.
SAME = {"x264-params": "mbtree=0"}


def write_video(
    path: Path, frames: Iterable[tuple[float, rendering.Picture]], size: tuple[int, int], fps: float, crf: int
) -> None:
    """Write frames (time [s], 8 bit planes) in order. Raises `RecordingError`: encoder missing or failing."""
    try:
        with av.open(str(path), "w") as container:
            stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
            stream.width, stream.height = size
            stream.pix_fmt = "yuv420p"
            stream.codec_context.time_base = TIME_BASE
            stream.options = {"crf": str(crf), "preset": PRESET, "threads": "1", **SAME}
            for time, picture in frames:
                planes = np.concatenate([plane.ravel() for plane in picture.planes]).reshape(-1, size[0])
                frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
                frame.pts, frame.time_base = round(time / TIME_BASE), TIME_BASE
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
    except av.error.FFmpegError as wrong:
        raise RecordingError(f"{path} cannot be encoded as H.264: {wrong.strerror}") from None


WAVES = 24  # of a shake, per axis


@dataclass(frozen=True)
class CameraMotion:
    """Shift of the picture of a shaking, drifting camera: waves of equal amplitude plus linear drift."""

    frequency: Array  # (W, 2) Hz
    phase: Array  # (W, 2) rad
    amplitude: float  # px, of each wave
    rate: Array  # (2,) px/s

    @property
    def still(self) -> bool:
        return self.amplitude == 0.0 and not np.any(self.rate)

    def shift(self, time: Array) -> Array:
        """(T, 2) px at `time` (T,) [s]; the drift begins at 0 s."""
        waves = np.sin(2.0 * np.pi * time[:, None, None] * self.frequency + self.phase)
        return np.asarray(self.amplitude * waves.sum(axis=1) + time[:, None] * self.rate)


def camera_motion(effects: RealBench, until: float, rng: np.random.Generator) -> CameraMotion:
    """Random motion of the sizes in `effects` over `until` [s]."""
    low, high = effects.shake_band
    turn = rng.uniform(0.0, 2.0 * np.pi)
    return CameraMotion(
        frequency=rng.uniform(low, high, (WAVES, 2)),
        phase=rng.uniform(0.0, 2.0 * np.pi, (WAVES, 2)),
        amplitude=effects.shake * float(np.sqrt(2.0 / WAVES)),
        rate=effects.drift / until * unit(turn),
    )


def droop(beam: Beam, tip: float, s: Array, poses: Array) -> tuple[Array, Array]:
    """Heights (T, S) [m] and slopes along the beam (T, S) [rad] of poses (T, S, 3) at `s` (S,) that sag out of the
    plane.

    Weight bends each piece by its moment about the piece's normal: z'' = -m / (E I across), I across ~ k^(1/3) (a bar
    of even depth); twist is neglected. Scaled so that the straight beam's tip hangs by `tip` [m].
    """
    if tip == 0.0:
        return np.zeros(poses.shape[:2]), np.zeros(poses.shape[:2])
    mass = np.asarray(beam.mass_per_length(s))
    mass = mass if np.all(mass > 0.0) else np.ones(len(s))
    softness = 1.0 / np.cbrt(np.asarray(beam.stiffness(s)))
    straight = np.stack([beam.length * s, 0.0 * s, 0.0 * s], axis=-1)[None]
    at_tip = heights(straight, s, mass, softness)[0][0, -1]
    z, slope = heights(poses, s, mass, softness)
    return tip / -at_tip * z, tip / -at_tip * slope / beam.length


def heights(poses: Array, s: Array, mass: Array, softness: Array) -> tuple[Array, Array]:
    """(T, S) height and its derivative with s, up to a common factor."""

    def beyond(values: Array) -> Array:  # integral from s to the tip along axis 1
        whole = cumulative_trapezoid(values, s, axis=1, initial=0.0)
        return np.asarray(whole[:, -1:] - whole)

    xy, angle = poses[..., :2], poses[..., 2]
    weight = np.broadcast_to(mass, angle.shape)
    arm = beyond(weight[..., None] * xy) - beyond(weight)[..., None] * xy
    moment = arm[..., 0] * np.cos(angle) + arm[..., 1] * np.sin(angle)
    slope = cumulative_trapezoid(-moment * softness, s, axis=1, initial=0.0)
    return cumulative_trapezoid(slope, s, axis=1, initial=0.0), slope


@dataclass(frozen=True)
class Filmed:
    """Beam, tags and contact at T moments."""

    time: Array  # (T,) s
    poses: Array  # (T, 121, 3) x, y, angle at `PLACES`, clamp's frame
    beam: Array  # (T, 121, 4) the same and z, room
    tags: Array  # (T, m + 1, 6) x, y, angle, z and tilts, room; base tag first
    contact: Array  # (T,) s, place of the tool

    def part(self, which: slice) -> Filmed:
        return Filmed(*(values[which] for values in vars(self).values()))

    def at(self, u: float) -> tuple[Array, Array, float]:
        """Beam (121, 4), tags (m + 1, 6) and contact at moment `u` of one exposure, by a parabola through its begin,
        middle and end."""
        weights = np.array([0.5 * u * (u - 1.0), 1.0 - u * u, 0.5 * u * (u + 1.0)])
        beam, tags = (np.tensordot(weights, values, 1) for values in (self.beam, self.tags))
        return beam, tags, float(weights @ self.contact)


def followed(filming: Filming, until: float) -> RodMotion | None:
    """The beam through the whole film if effects change its motion, else None."""
    return virtual.motion_of(filming.bench, until, at=PLACES, gravity=gravity_of(filming))


def moments_at(filming: Filming, motion: RodMotion | None, time: Array) -> Filmed:
    """The state at rising times (T,) [s]; at rest before 0. Raises `MechanicsError`: snap-through, or the mass is
    needed and unknown."""
    bench = filming.bench
    if motion is None:
        inertia = {name: getattr(filming, name) for name in ("swings", "damping", "rotary_inertia")}
        poses = shapes_at(bench.beam, bench.push, time, gravity=gravity_of(filming), **inertia)
        contact = np.full(len(time), bench.push.at_s)
    else:
        poses, contact = motion.poses(time, PLACES), motion.contacts(time)
    z, slope = droop(bench.beam, bench.effects.droop, PLACES, poses)
    beam, tags = np.concatenate([poses, z[..., None]], axis=-1), tag_faces(filming, poses, z, slope)
    return Filmed(time, poses, in_room(beam, filming.base_angle), in_room(tags, filming.base_angle), contact)


def tag_faces(filming: Filming, poses: Array, z: Array, slope: Array) -> Array:
    """(T, m + 1, 6) base tag and beam tags, clamp's frame: x, y, angle, z, tilts about and along it."""
    bench, count = filming.bench, len(poses)
    effects, s = bench.effects, np.clip(virtual.tag_places(bench), 0.0, 1.0)
    under = between_places(poses, s)
    flat = virtual.tag_poses_on(bench, under)
    heights = np.array(effects.tag_heights) if effects.tag_heights else np.zeros(len(s))
    tilts = np.array(effects.tag_tilts) if effects.tag_tilts else np.zeros((len(s), 2))
    up = np.stack([np.array([np.interp(s, PLACES, one) for one in of]) for of in (z, slope)], axis=-1)
    about = np.broadcast_to(tilts[:, :1], (count, len(s), 1))
    on_beam = [flat, up[..., :1] + heights[:, None], about, up[..., 1:] + tilts[:, 1:]]
    base = np.tile(np.array([*bench.base, effects.base_height, 0.0, 0.0]), (count, 1, 1))
    return np.concatenate([base, np.concatenate(on_beam, axis=-1)], axis=1)


def in_room(pose: Array, base_angle: float) -> Array:
    """Poses (..., 3 or more) from the clamp's frame into the room."""
    return np.concatenate([rotated(pose[..., :2], base_angle), pose[..., 2:3] + base_angle, pose[..., 3:]], axis=-1)


S = np.linspace(0.0, 1.0, 401)


def write_truth(folder: Path, facts: Mapping[str, Any], **arrays: Any) -> None:
    """Write `truth.npz` and `truth.json` into the `folder`. For comparison only: learning never reads them."""
    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / "truth.npz", **arrays)
    text = json.dumps(plain(facts), indent=1, allow_nan=False)
    (folder / "truth.json").write_text(text + "\n", encoding="utf-8")


def shown_truth(filming: Filming, shown: Filmed, motion: RodMotion | None) -> dict[str, Array]:
    """Of beam and tags at the frames' first rows."""
    beam, truth = filming.bench.beam, virtual.true_stiffness(filming.bench, motion, S)
    return {
        "s": S,
        "k": truth.k,
        "k_instant": truth.k_instant,
        "k_bare": truth.k_bare,
        "EI": truth.k * beam.length,
        "width": np.asarray(filming.width(S)),
        "rhoA": np.asarray(beam.mass_per_length(S)),
        "kappa0": rest_curvature(beam, filming.bench.effects, S) / beam.length,
        "t_frame": shown.time,
        "s_shape": PLACES,
        "x": shown.poses[..., 0],
        "y": shown.poses[..., 1],
        "alpha": shown.poses[..., 2],
        "F": filming.bench.push.force(shown.time),
        "s_a": shown.contact,
        "z": shown.beam[..., 3],
        "base": np.full(len(shown.time), filming.base_angle),
        "tag_id": np.array([0, *(tag.id for tag in filming.bench.tags)], dtype=np.int64),
        "tag_xya": shown.tags[..., :3],
        "tag_xyaz": shown.tags[..., :4],
        "tag_tilts": shown.tags[..., 4:],
    }


def facts_of(filming: Filming, view: View, motion: RodMotion | None, seed: int) -> dict[str, Any]:
    """Contents of `truth.json`."""
    bench, clock = filming.bench, filming.bench.clock
    return {
        "beam": bench.name,
        "L": bench.beam.length,
        "seed": seed,
        "eta": filming.damping,
        "s_a": bench.push.at_s,
        "clock": {
            "log_minus_video_true": clock.offset,
            "said": clock.declared,
            "error_said_minus_true": clock.declared - clock.offset,
        },
        "camera": {
            **{"K": view.matrix, "dist": view.dist, "R": view.rotation, "t": view.translation},
            "C": -view.rotation.T @ view.translation,
            "calibrated_for_user": filming.calibrated,
        },
        "scene": asdict(filming.scene),
        "push": {**asdict(bench.push), "contact": bench.push.contact},
        "tags": {"base": bench.base, "on_beam": [asdict(tag) for tag in bench.tags], "size": filming.tag_size},
        "force": {**asdict(bench.sensor), "rotation": filming.log_rotation, "reaction": filming.log_of_robot},
        "gravity": {"magnitude": filming.gravity, "base_angle": filming.base_angle},
        "effects": asdict(bench.effects),
        "secant_modulus": 1.0 if motion is None else motion.secant,
    }


STEPS = 0.7  # px: largest motion between two drawn moments of an exposure
MOST_MOMENTS = 8
INCH = 0.0254  # m
SHARPEST = 0.8  # least bend radius in half widths


@one_blas_thread
def film(filming: Filming, folder: Path | str, *, seed: int, progress: Progress = Silent()) -> Path:
    """Make the recording in `folder`; returns the folder. Equal seeds give equal files.

    Raises `MechanicsError`: snap-through, or the mass is needed and unknown. Raises `RecordingError`: the folder is not
    empty, the camera cannot show the push, or encoding fails.
    """
    folder, bench = Path(folder), filming.bench
    check(filming, folder)
    time = frame_times(filming, np.random.default_rng([seed, 2]))
    exposed = (time[:, None] + 0.5 * filming.scene.exposure * np.array([-1.0, 0.0, 1.0])).ravel()
    readout = bench.effects.readout
    motion = followed(filming, float(exposed[-1]) + readout)
    moments = moments_at(filming, motion, exposed)
    refuse_sharp_bends(filming, moments.poses)
    later = [moments_at(filming, motion, exposed + part * readout) for part in (0.5, 1.0)] if readout else []
    camera_moves = camera_motion(bench.effects, bench.push.duration, np.random.default_rng([seed, 13]))
    cast = cast_of(filming, np.random.default_rng([seed, 12]))
    view = rendering.view_from(filming.camera, to_be_seen(cast, moments))
    staged = stage_of(filming, cast, view, moments.beam, seed)
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([seed, 0])
    frames = pictures(staged, cast, camera_moves, [moments, *later], time, readout, rng)
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
    told = shown_truth(filming, moments.part(slice(1, None, 3)), motion)
    told |= {"camera_px": camera_moves.shift(time), "log_t": log.time, "log_F": clean.force}
    write_truth(folder / "truth", facts_of(filming, view, motion, seed), **told)
    return folder


def refuse_sharp_bends(filming: Filming, poses: Array) -> None:
    """Raises where a bend is so sharp that its inner side would fold."""
    turn = np.abs(np.diff(poses[..., 2], axis=1)) / np.diff(PLACES) / filming.bench.beam.length
    half = 0.5 * np.asarray(filming.width(0.5 * (PLACES[1:] + PLACES[:-1])))
    tightest = float(np.max(turn * half))
    if tightest >= SHARPEST:
        peak, middle = filming.bench.push.peak, 1e3 * float(half.mean())
        raise RecordingError(
            f"{peak:.3g} N would bend the beam to a radius of {middle / tightest:.2g} mm, which its width of "
            f"{2.0 * middle:.2g} mm does not allow. Give a smaller force."
        )


def cast_of(filming: Filming, rng: np.random.Generator) -> MovingScene:
    """Shapes and colours; each tag's position on the printer's dots is random."""
    told = virtual.declared_recording(filming.bench).tags
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


def to_be_seen(cast: MovingScene, moments: Filmed) -> Array:
    """(N, 2) m: the beam, and the paper of every tag at every time."""
    tags = moments.tags[..., :3]
    corners = [
        placed(tag.paper[0], pose) for i, tag in enumerate(cast.tags) for pose in tags[:: max(1, len(tags) // 200), i]
    ]
    return np.concatenate([*corners, moments.beam[::5, :, :2].reshape(-1, 2)])


def stage_of(filming: Filming, cast: MovingScene, view: View, beam: Array, seed: int) -> rendering.StaticScene:
    reach = 0.03 + float(np.max(cast.half_width)) + filming.tag_size
    xy = beam[:: max(1, len(beam) // 100), :, :2].reshape(-1, 2)
    corners = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) * reach
    moving = (xy[:, None] + corners).reshape(-1, 2)
    still = clamp_block(filming.scene, filming.base_angle)
    return rendering.stage(filming.scene, view, (filming.camera.width, filming.camera.height), still, moving, seed)


def pictures(
    staged: rendering.StaticScene,
    cast: MovingScene,
    camera: CameraMotion,
    at_rows: Sequence[Filmed],
    time: Array,
    readout: float,
    rng: np.random.Generator,
) -> Iterator[tuple[float, rendering.Picture]]:
    """The frames at `time` (T,) [s]. `at_rows`: the begin, middle and end of each exposure (3 T,), as the first, middle
    and last row is exposed, `readout` [s] apart; one if all rows are at once."""
    rows = staged.table.y.shape[0]
    for i, now in enumerate(time.tolist()):
        exposure = [one.part(slice(3 * i, 3 * i + 3)) for one in at_rows]
        drawings = []
        for u in moments_of(staged.view, exposure[0]):
            when = now + 0.5 * u * cast.scene.exposure + readout * np.array([0.0, 0.5, 1.0])
            drawn = [moment_of(cast, t, *one.at(u)) for one, t in zip(exposure, when.tolist(), strict=False)]
            still = len(drawn) == 1 and camera.still
            drawings.append(drawn[0] if still else over_rows(drawn, camera.shift(when), rows))
        yield now, rendering.frame_of(staged, drawings, now, rng)


def moments_of(view: View, exposure: Filmed) -> list[float]:
    """Moments of one exposure that are drawn, -1 at its begin and 1 at its end."""
    tags, beam = exposure.tags, exposure.beam
    ends = plane.project(view, np.concatenate([tags[[0, 2], :, :2], beam[[0, 2], ::30, :2]], axis=1))
    moved = float(np.max(np.abs(ends[1] - ends[0])))
    count = int(np.clip(np.ceil(moved / STEPS), 1, MOST_MOMENTS))
    return [(2.0 * i + 1.0) / count - 1.0 for i in range(count)]


def force_log(filming: Filming, motion: RodMotion | None, rng: np.random.Generator) -> tuple[ForceLog, ForceLog]:
    """The sensor's log and the true force on its clock, both in the log's axes and sign."""
    bench, margin = filming.bench, virtual.LOG_BEFORE
    step = min(virtual.DENSE, 0.5 / bench.sensor.rate)
    dense = np.arange(-margin, bench.push.duration + margin, step)
    acts_on = "robot" if filming.log_of_robot else "beam"
    force = in_log_axes(bench.push.force(dense), filming.log_rotation, acts_on)
    felt = in_log_axes(virtual.sensed(bench, dense, motion), filming.log_rotation, acts_on)
    log = log_of(bench.sensor, dense, felt, rng, offset=bench.clock.offset)
    clean = np.stack([np.interp(log.time - bench.clock.offset, dense, column) for column in force.T], axis=1)
    return log, ForceLog(log.time, clean)


def entries(filming: Filming, folder: Path) -> Recording:
    bench, told = filming.bench, virtual.declared_recording(filming.bench)
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
        camera=rendering.calibration(filming.camera) if filming.calibrated else None,
        video=replace(told.video, file=folder / "video.mp4", fps=bench.fps),
        force=ForceEntry(
            file=folder / "force.csv",
            rotation=filming.log_rotation,
            acts_on="robot" if filming.log_of_robot else "beam",
            sensor=filming.sensor_name,
            gain_sd=told.force.gain_sd,
        ),
        gravity=GravityEntry(direction=DOWN, magnitude=filming.gravity, base_angle=filming.base_angle)
        if filming.gravity > 0.0
        else None,
    )


TABLE = "markers.csv"
TRUTH_PLACES = np.linspace(0.0, 1.0, 201)  # s


def check_trackable(filming: Filming) -> None:
    """Raises `RecordingError`: the film needs more than marker tracks of a beam in equilibrium."""
    refused = {"a push that swings the beam": filming.swings, "gravity in the plane of bending": filming.gravity > 0.0}
    for what, wrong in refused.items():
        if wrong:
            raise RecordingError(f"{what} is filmed, not given as markers. Leave out the markers, or take a slow push.")


def marker_recording(bench: virtual.VirtualBench, folder: Path | str, *, seed: int) -> Path:
    """Push the bench's beam; write `recording.toml`, `markers.csv`, `force.csv` and `truth/`, as from motion capture.

    Returns the folder. Equal seeds give equal files. Raises `MechanicsError`: snap-through. Raises `RecordingError`:
    the folder holds a recording.
    """
    folder = Path(folder)
    if (folder / FILE_NAME).exists():
        raise RecordingError(f"{folder} holds a recording. Name another folder.")
    made = virtual.virtual_recording(bench, seed=seed)
    folder.mkdir(parents=True, exist_ok=True)
    _write_tracks(folder / TABLE, made)
    write_log(folder / "force.csv", made.log)
    told = made.recording
    assert told.video is not None
    assert told.force is not None
    markers = MarkersEntry(
        file=folder / TABLE,
        start=told.video.start,
        start_uncertainty=told.video.start_uncertainty,
        sd=bench.camera.white_xy,
        clamp=(0.0, 0.0),
        x_axis=(1.0, 0.0),
    )
    entry = replace(
        told,
        folder=folder,
        tags=replace(told.tags, on_base=()),
        video=None,
        markers=markers,
        force=replace(told.force, file=folder / "force.csv"),
    )
    (folder / FILE_NAME).write_text(recording_toml(entry), encoding="utf-8")
    truth, length = virtual.true_stiffness(made.bench, made.motion, TRUTH_PLACES), bench.beam.length
    facts = {"length_m": length, "force_max_N": bench.push.peak, "seed": seed}
    write_truth(folder / "truth", facts, s=TRUTH_PLACES, k=truth.k, EI=truth.k * length)
    return folder


def _write_tracks(path: Path, made: virtual.VirtualRecording) -> None:
    """`time_s, id, x_m, y_m, angle_rad`, one row per visible marker."""
    seen = made.markers
    t, i = np.nonzero(np.isfinite(seen.xy[..., 0]))
    rows = np.column_stack([seen.time[t], seen.tag_id[i], seen.xy[t, i], seen.angle[t, i]])
    formats = ("%.6f", "%d", "%.8f", "%.8f", "%.6f")
    np.savetxt(path, rows, fmt=formats, delimiter=",", header="time_s,id,x_m,y_m,angle_rad", comments="")
