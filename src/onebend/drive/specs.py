"""Robots, cameras and force sensors of a drive as they are named on the command line."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

from onebend.beam.stiffness import Scaled
from onebend.drive.plan import DriveSettings
from onebend.drive.robots import SERVO_LOOKAHEAD, STIFFNESS, FrankaArm, Robot, UniversalRobot
from onebend.drive.ros2 import RosCamera, RosForce, RosNetwork, RosRobot, RosTopics, Trust
from onebend.drive.virtual import VirtualRobot, VirtualSetup
from onebend.errors import RecordingError
from onebend.lab.designs import DESIGNS, find_design
from onebend.lab.random_bench import SENSORS, FilmRequest, design_with_effects, filming_of
from onebend.lab.virtual import VirtualBench, VirtualTag
from onebend.live.sources import CameraSource, ForceSource
from onebend.live.specs import CAMERAS, FORCES, Options, SourceKind, choice, made, number
from onebend.recording.entries import Recording
from onebend.results.model import FILE_NAME, read_model

MakeRobot = Callable[[Recording, DriveSettings], Robot]
_ROS = ("qos", "depth")
_ROS_ROBOT = ("pose_in", "pose_out", "wrench_in", "wrench_out", "wrench_axes", "frame")
MOST_DOMAIN = 232  # of DDS
_WHITE = {name: sensor.white_sd for sensor, name in SENSORS.values() if name}  # N, as the lab has them


def robot_of(spec: str) -> MakeRobot:
    """What makes the robot that a spec names, for a recording.

    Raises:
        RecordingError: there is no such kind, or a key that it does not know.
    """
    return made(spec, ROBOTS, "--robot")


def camera_of(spec: str) -> CameraSource:
    """As `onebend.live.camera_of`, and topics of ROS 2."""
    return made(spec, ALL_CAMERAS, "--camera")


def force_of(spec: str) -> ForceSource:
    """As `onebend.live.force_of`, and topics of ROS 2."""
    return made(spec, ALL_FORCES, "--force")


def _universal(place: str, options: Options) -> MakeRobot:
    lookahead = number(options, "lookahead_s", SERVO_LOOKAHEAD, least=0.03, most=0.2)
    return lambda _, settings: UniversalRobot(place, period=1.0 / settings.rate, lookahead=lookahead)


def _franka(place: str, options: Options) -> MakeRobot:
    gives = choice(options, "mode", ("impedance", "pose")) == "impedance"
    stiff = number(options, "stiffness", STIFFNESS[0], least=10.0, most=3000.0)
    turning = number(options, "turning", STIFFNESS[1], least=1.0, most=300.0)
    return lambda _rec, _settings: FrankaArm(place, impedance=gives, stiffness=(stiff, turning))


def _network(domain: str, options: Options) -> RosNetwork:
    trust: Trust = choice(options, "qos", get_args(Trust))  # type: ignore[assignment]
    at = int(number({"domain": domain}, "domain", 0, least=0, most=MOST_DOMAIN))
    depth = int(number(options, "depth", 1, least=1, most=1000))
    return RosNetwork(at, trust, depth, options.get("frame", "base"))


def _ros_robot(place: str, options: Options) -> MakeRobot:
    choice(options, "wrench_axes", ("base", "tool"))
    given = {key: options[key] for key in _ROS_ROBOT[:-1] if key in options}
    topics, network = RosTopics(**given), _network(place, options)  # type: ignore[arg-type]
    return lambda _rec, _settings: RosRobot(network, topics)


def _virtual(place: str, options: Options) -> MakeRobot:
    factor = number(options, "k", 1.0, least=0.05, most=20.0)
    seed = int(number(options, "seed", 0, least=0, most=2**31))
    fps = number(options, "fps", 30.0, least=1.0, most=120.0)
    delay = 1e-3 * number(options, "delay_ms", 60.0, least=0.0, most=1000.0)
    lag = 1e-3 * number(options, "lag_ms", 20.0, least=0.0, most=1000.0)
    asked = number(options, "white_N", math.nan, least=0.0, most=10.0)
    effects = bool(number(options, "effects", 0.0, least=0.0, most=1.0))
    bench = _bench(place, factor, effects, seed)

    def virtual(rec: Recording, settings: DriveSettings) -> Robot:
        tags = tuple(VirtualTag(tag.id, tag.s) for tag in rec.tags.on_beam)
        here, holds = replace(bench, tags=tags), settings.hand == "hold"
        assert rec.force is not None  # of a plan
        known = (asked, rec.force.white_sd, _WHITE.get(rec.force.sensor, VirtualSetup.white))
        white = next(one for one in known if math.isfinite(one))  # so that the log is that of the stated sensor
        return VirtualRobot(VirtualSetup(here, rec, holds=holds, lag=lag, white=white, fps=fps, delay=delay, seed=seed))

    return virtual


def _bench(place: str, factor: float, effects: bool, seed: int) -> VirtualBench:
    """A design's beam, or a learned one, its k(s) times `factor`."""
    path = Path(place)
    if place in DESIGNS or path.suffix == ".toml":
        filming = filming_of(find_design(place), FilmRequest(), place)
    elif path.is_dir() or path.name == FILE_NAME:
        filming = filming_of(find_design("linear"), FilmRequest(), path.stem)
        filming = replace(filming, bench=replace(filming.bench, beam=read_model(path).beam))
    else:
        raise RecordingError(f"virtual:{place}: this is no design ({', '.join(DESIGNS)}), and no folder with a model.")
    if effects:
        filming = design_with_effects(filming, np.random.default_rng(seed))
    beam = filming.bench.beam
    return replace(filming.bench, beam=replace(beam, stiffness=Scaled(factor, beam.stiffness)))


ROBOTS: Mapping[str, SourceKind[MakeRobot]] = {
    "ur": SourceKind("ur:HOST", "a Universal Robot (pip install 'onebend[ur]')", ("lookahead_s",), _universal),
    "franka": SourceKind(
        "franka:HOST", "a Franka arm (pip install 'onebend[franka]')", ("mode", "stiffness", "turning"), _franka
    ),
    "ros2": SourceKind(
        "ros2:DOMAIN,pose_in=/tool_pose,pose_out=/target_pose",
        "a robot whose controller listens to ROS 2; no ROS is needed here (pip install 'onebend[ros2]')",
        (*_ROS, *_ROS_ROBOT), _ros_robot,
    ),
    "virtual": SourceKind(
        "virtual:linear", "a design's beam, or a results folder's, in a process of its own",
        ("k", "seed", "fps", "delay_ms", "lag_ms", "white_N", "effects"), _virtual,
    ),
}  # fmt: skip
ALL_CAMERAS: Mapping[str, SourceKind[CameraSource]] = CAMERAS | {
    "ros2": SourceKind(
        "ros2:DOMAIN,topic=/camera/image_raw", "pictures of a ROS 2 topic (packed=1: CompressedImage)",
        (*_ROS, "topic", "packed"),
        lambda place, options: RosCamera(
            _topic("--camera", options), _network(place, options), packed=options.get("packed", "0") != "0"
        ),
    )
}  # fmt: skip
ALL_FORCES: Mapping[str, SourceKind[ForceSource]] = FORCES | {
    "ros2": SourceKind(
        "ros2:DOMAIN,topic=/wrench", "WrenchStamped of a ROS 2 topic", (*_ROS, "topic"),
        lambda place, options: RosForce(_topic("--force", options), _network(place, options)),
    )
}  # fmt: skip


def _topic(option: str, options: Options) -> str:
    if not options.get("topic"):
        raise RecordingError(f"{option} ros2: say which topic, behind a comma: topic=/NAME.")
    return options["topic"]
