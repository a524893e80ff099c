"""What is rehearsed: a beam, pushes, tags and instruments, and their tolerances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import isfinite, isnan, nan
from pathlib import Path

import numpy as np

from onebend.beam.model import Beam
from onebend.blas import one_blas_thread
from onebend.errors import MechanicsError, RecordingError
from onebend.lab.design_file import find_design
from onebend.lab.film_request import SENSORS, SWINGING, FilmRequest, SensorName, camera_of, check_name, push_of
from onebend.lab.filming.viewpoint import Camera, view_from
from onebend.lab.pushes import PushProfile
from onebend.lab.sensors import FRANKA, ForceSensor
from onebend.lab.tag_errors import TagNoise
from onebend.lab.virtual import VirtualBench, VirtualTag, tag_poses
from onebend.recording.camera.lens import project
from onebend.records import TURN_SD, Rest
from onebend.results.model import FILE_NAME, read_model

THIRDS = (1.0 / 3.0, 2.0 / 3.0, 1.0)
CORNER_SD = 0.1  # px, of a tag's corner: the centre is good to half of it
TAG_SHARE = 0.08  # of the length: a tag's side
NEAREST_TAGS = 0.02  # in s: nearer tags would overlap
LEAST_TURN_DEG, MOST_TURN_DEG = 3.0, 150.0  # of the pushed place
FEWEST_FRAMES = 20  # of a push


@dataclass(frozen=True)
class Setup:
    """One or more pushes of a known beam, as they would be filmed and logged. Errors are one sd."""

    name: str
    beam: Beam
    pushes: tuple[PushProfile, ...]
    tags: tuple[float, ...] = THIRDS
    sensor: ForceSensor = FRANKA
    noise: TagNoise = field(default_factory=TagNoise)
    fps: float = 30.0
    placement_sd: float = 5e-4  # m, a tag's place along and across
    turn_sd: float = TURN_SD  # rad, a tag's turn on the beam
    clock_sd: float = nan  # s, how well the two clocks are known; 0: one clock; NaN: found from the data

    def __post_init__(self) -> None:
        check(self)

    @property
    def gain_sd(self) -> float:
        """Of the force's scale, as it would be declared."""
        return self.sensor.gain_sd

    @property
    def rest(self) -> Rest:
        """What the recording would say of the shape at rest."""
        s = np.linspace(0.0, 1.0, 101)
        return "unknown" if np.any(np.asarray(self.beam.rest_curvature(s)) != 0.0) else "straight"


def check(setup: Setup) -> None:
    """Raises `RecordingError` where a setup makes no sense, with what to change."""
    _check_tags(setup.tags)
    if not setup.pushes:
        raise RecordingError("a rehearsal needs at least one push")
    for push in setup.pushes:
        _check_push(setup, push)
    for what, size in (("placement_sd", setup.placement_sd), ("turn_sd", setup.turn_sd)):
        if not (isfinite(size) and size > 0.0):
            raise RecordingError(f"{what} must be above zero, got {size}: no tag is put on without an error")
    if not setup.fps > 0.0 or setup.clock_sd < 0.0:
        raise RecordingError("the frame rate must be above zero, and the clock's sd, where it is given, not below")


def _check_tags(tags: tuple[float, ...]) -> None:
    if not tags:
        raise RecordingError("a rehearsal needs at least one tag on the beam. Give --tags, such as 0.33,0.67,1")
    for s in tags:
        if not 0.0 < s <= 1.0:
            where = "beyond the tip (s = 1)" if s > 1.0 else "not on the beam: s = 0 is the clamp"
            raise RecordingError(f"a tag at s = {s:g} is {where}. Give places in (0, 1]")
    for place, other in zip(sorted(tags), sorted(tags)[1:], strict=False):
        if other - place < NEAREST_TAGS:
            raise RecordingError(f"tags at s = {place:g} and {other:g} would overlap. Keep them {NEAREST_TAGS:g} apart")


def _check_push(setup: Setup, push: PushProfile) -> None:
    first = min(setup.tags)
    if push.at_s < first - 1e-6:
        raise RecordingError(
            f"a push at s = {push.at_s:g} is before the first tag (s = {first:.3g}): nothing would be seen between "
            "clamp and push. Push farther out, or put a tag nearer to the clamp"
        )
    if not (isfinite(push.peak) and push.peak > 0.0):
        raise RecordingError(f"a push needs a force above zero, got {push.peak} N")
    seconds = push.contact[1] - push.contact[0]
    if seconds * setup.fps < FEWEST_FRAMES:
        raise RecordingError(
            f"a push of {seconds:.3g} s at {setup.fps:g} frames/s gives {seconds * setup.fps:.0f} frames; at least "
            f"{FEWEST_FRAMES} are needed. Push for longer"
        )
    if push.before < 0.5:
        raise RecordingError("a push needs half a second of rest before it, which shows the beam and the log at rest")


@dataclass(frozen=True)
class KnownBeam:
    """A known beam, and the places of its tags where it was learned from tags."""

    name: str
    beam: Beam
    tags: tuple[float, ...] = THIRDS


def known_beam(name_or_path: str) -> KnownBeam:
    """A named design, a design's TOML, or a learned beam: a model.json or the folder that holds one.

    Raises:
        MechanicsError, ResultsError: there is none, or it cannot be read.
    """
    path = Path(name_or_path)
    if path.suffix == ".json" or (path.is_dir() and (path / FILE_NAME).is_file()):
        stored = read_model(path)
        k = np.asarray(stored.beam.stiffness(np.linspace(0.0, 1.0, 201)))
        if not np.all(k > 0.0):
            raise MechanicsError(f"{path}: k(s) is not positive everywhere, so this beam cannot be rehearsed")
        tags = stored.bench.tags if stored.bench is not None else stored.origin.marker_s if stored.origin else THIRDS
        return KnownBeam(path.resolve().parent.name if path.suffix else path.resolve().name, stored.beam, tuple(tags))
    design = find_design(name_or_path)
    return KnownBeam(design.name, design.beam())


@one_blas_thread
def setup_of(
    known: KnownBeam,
    requests: Sequence[FilmRequest],
    *,
    tags: Sequence[float] = (),
    gain_sd: float = nan,
    placement_sd: float = Setup.placement_sd,
    turn_sd: float = Setup.turn_sd,
    clock_sd: float = nan,
) -> Setup:
    """The setup that is asked for; camera, frame rate and sensor are those of the first request.

    Raises:
        RecordingError: a number that cannot be, or a push in which the beam swings.
        MechanicsError: the beam snaps through under a push.
    """
    first = requests[0]
    for request in requests:
        if request.push in SWINGING:
            raise RecordingError(
                f"a {request.push} push makes the beam swing, and is not learned from. Take a slow one"
            )
    camera, fps = camera_of(first)
    sensor = SENSORS[check_name(first.sensor, SensorName, "sensor")][0]
    sensor = sensor if isnan(gain_sd) else replace(sensor, gain_sd=gain_sd)
    places = tuple(sorted(float(s) for s in tags)) or known.tags
    pushes = tuple(push_of(request, known.beam) for request in requests)
    setup = Setup(known.name, known.beam, pushes, places, sensor, TagNoise(), fps, placement_sd, turn_sd, clock_sd)
    for push in pushes:
        if push.peak < 1e-9:
            raise MechanicsError(f"the beam buckles under any push at s = {push.at_s:g} in this direction")
    return replace(setup, noise=tag_noise(camera, setup))


def check_bending(setup: Setup) -> None:
    """Raises `MechanicsError` where a push does not bend the beam, or bends it beyond what a tool can follow."""
    rest = VirtualBench(setup.beam, setup.pushes[0], tags=(VirtualTag(0, 1.0),))
    for push in setup.pushes:
        bench = replace(rest, push=push, tags=(VirtualTag(0, push.at_s),))
        angle = tag_poses(bench, push.force(np.linspace(*push.contact, 25)))[:, 0, 2]
        turn = float(np.rad2deg(np.max(np.abs(angle - angle[0]))))
        what = f"{push.peak:.3g} N at s = {push.at_s:g} would turn the beam there by"
        if turn < LEAST_TURN_DEG:
            raise MechanicsError(
                f"{what} only {turn:.2g} deg, from which nothing is learned. Push harder, or across the beam"
            )
        if turn > MOST_TURN_DEG:
            raise MechanicsError(f"{what} {turn:.0f} deg, which no tool can follow. Give a smaller force")


def tag_noise(camera: Camera, setup: Setup) -> TagNoise:
    """What a camera that shows the whole push makes of a tag's corners: `CORNER_SD` in its pixels.

    A square's centre is known to half of a corner's sd, its angle to the sd over the diagonal.

    Raises:
        MechanicsError: the beam snaps through under a push.
    """
    edge = 0.75 * TAG_SHARE * setup.beam.length  # from a tag's middle to the edge of its paper
    places = [np.zeros((1, 2))]
    for push in setup.pushes:
        bench = VirtualBench(setup.beam, push, tags=tuple(VirtualTag(i, s) for i, s in enumerate(setup.tags)))
        poses = tag_poses(bench, push.force(np.linspace(*push.contact, 25)))
        places.append(poses[..., :2].reshape(-1, 2))
    corners = edge * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    view = view_from(camera, (np.concatenate(places)[:, None] + corners).reshape(-1, 2))
    middle = np.mean(np.concatenate(places), axis=0)
    step = 1e-3 * setup.beam.length
    px = project(view, middle + step * np.array([[-1.0, 0.0], [1.0, 0.0]]))
    size = 2.0 * step / float(np.hypot(*(px[1] - px[0])))  # m a pixel
    diagonal = np.sqrt(2.0) * TAG_SHARE * setup.beam.length / size
    return TagNoise(white_xy=0.5 * CORNER_SD * size, white_angle=CORNER_SD / float(diagonal))
