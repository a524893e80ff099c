"""Pushes, cameras and sensors that have a name: what `onebend film` offers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isnan, nan, radians
from typing import Literal, get_args

from onebend.beam.model import Beam
from onebend.errors import RecordingError
from onebend.lab.designs import Design
from onebend.lab.filming.film_setup import Filming
from onebend.lab.filming.viewpoint import Camera
from onebend.lab.pushes import PushProfile
from onebend.lab.random_beams import force_that_bends
from onebend.lab.sensors import FRANKA, WRIST, ForceSensor
from onebend.lab.virtual import VirtualBench, VirtualClock, VirtualTag

PushName = Literal["slow", "fast", "s08", "s06", "free"]
CameraName = Literal["hd", "full-hd", "phone", "webcam", "wide", "tilted"]
SensorName = Literal["franka", "wrist", "ideal"]

SLOW = PushProfile(nan, before=1.5, rise=6.0, hold=1.0, fall=6.0, after=1.5)
FAST = PushProfile(nan, before=1.0, rise=2.2, hold=0.5, fall=1.6, after=1.7)
PUSHES: dict[str, PushProfile] = {
    "slow": SLOW,
    "fast": FAST,
    "s08": replace(SLOW, at_s=0.8, rise=3.5, fall=3.0),
    "s06": replace(SLOW, at_s=0.6, rise=3.5, fall=3.0),
    "free": replace(FAST, hold=0.8, fall=0.03, after=4.0),
}
SWINGING = ("fast", "free")  # those that need the equation of motion
CAMERAS: dict[str, tuple[Camera, float]] = {  # and frames/s
    "hd": (Camera(), 30.0),
    "full-hd": (Camera(1920, 1080, 1750.0), 30.0),
    "phone": (Camera(1920, 1080, 1500.0, dist=(0.04, -0.06, 0.0003, -0.0005, 0.0), tilt=(0.06, 0.05)), 60.0),
    "webcam": (Camera(960, 540, 800.0, dist=(0.08, -0.15, 0.0008, 0.0006, 0.0), tilt=(0.05, -0.04)), 15.0),
    "wide": (Camera(focal=700.0, dist=(-0.22, 0.06, 0.0004, -0.0003, 0.0)), 30.0),
    "tilted": (Camera(tilt=(0.25, -0.12), roll=0.1), 30.0),
}
SENSORS: dict[str, tuple[ForceSensor, str]] = {  # and what recording.toml calls it
    "franka": (FRANKA, "franka-estimate"),
    "wrist": (WRIST, "wrist six-axis"),
    "ideal": (ForceSensor(rate=500.0), "without errors"),
}


@dataclass(frozen=True)
class FilmRequest:
    """A film as requested; NaN: the value of the named push or camera."""

    push: PushName = "slow"
    at_s: float = nan
    force: float = nan  # N, peak
    bend: float = radians(65.0)  # rad, turn of the pushed place at the peak where no force is given
    direction: float = nan  # rad
    seconds: float = nan  # s, from first to last contact
    camera: CameraName = "hd"
    fps: float = nan
    tilt: float = nan  # rad
    distance: float = nan  # m
    sensor: SensorName = "franka"
    gravity: float = 0.0  # m/s^2
    base_angle: float = 0.0  # rad
    calibrated: bool = True


def push_of(request: FilmRequest, beam: Beam) -> PushProfile:
    """The push that is asked for, with a peak that bends this beam as far.

    Raises:
        RecordingError: a time, place or force that cannot be.
    """
    push = PUSHES[check_name(request.push, PushName, "push")]
    if not isnan(request.at_s):
        push = replace(push, at_s=request.at_s)
    if not isnan(request.direction):
        push = replace(push, direction=request.direction)
    if not isnan(request.seconds):
        begin, end = push.contact
        share = request.seconds / (end - begin)
        sudden = request.push == "free"
        push = replace(
            push,
            rise=share * push.rise,
            hold=share * push.hold,
            fall=push.fall if sudden else share * push.fall,
        )
    if not isnan(request.force):
        if not request.force > 0.0:
            raise RecordingError(f"a push needs a force above zero, got {request.force} N")
        return replace(push, peak=request.force)
    return replace(push, peak=force_that_bends(beam, request.bend, push.direction, push.at_s))


def camera_of(request: FilmRequest) -> tuple[Camera, float]:
    """The camera that is asked for, and its frames/s."""
    camera, fps = CAMERAS[check_name(request.camera, CameraName, "camera")]
    if not isnan(request.tilt):
        camera = replace(camera, tilt=(request.tilt, 0.0))
    return replace(camera, distance=request.distance), fps if isnan(request.fps) else request.fps


def filming_of(design: Design, request: FilmRequest, name: str) -> Filming:
    """A design filmed as asked for: tags at thirds, mounted well; a clock that is 0.4 s off what is written down.

    Raises:
        RecordingError: a name that is not known, or a number that cannot be.
    """
    beam = design.beam()
    camera, fps = camera_of(request)
    sensor, called = SENSORS[check_name(request.sensor, SensorName, "sensor")]
    bench = VirtualBench(
        beam=beam,
        push=push_of(request, beam),
        tags=(VirtualTag(1, 0.333333), VirtualTag(2, 0.666667), VirtualTag(3, 1.0)),
        sensor=sensor,
        fps=fps,
        clock=VirtualClock(offset=250.0, declared=250.4, uncertainty=2.0),
        name=name,
    )
    return Filming(
        bench,
        width=design.width,
        rotary_inertia=design.along.rotary_inertia,
        camera=camera,
        swings=request.push in SWINGING,
        gravity=request.gravity,
        base_angle=request.base_angle,
        sensor_name=called,
        calibrated=request.calibrated,
    )


def check_name(name: str, names: object, what: str) -> str:
    """`name`, if it is one of them."""
    known = get_args(names)
    if name not in known:
        raise RecordingError(f"there is no {what} {name!r}. Take one of {', '.join(known)}.")
    return name
