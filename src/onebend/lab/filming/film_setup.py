"""What is filmed and how: a bench, and all that a film shows of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi
from pathlib import Path

import numpy as np

from onebend.beam.profiles.stiffness import Profile, Uniform
from onebend.errors import RecordingError
from onebend.lab.filming.movement import MotionSettings
from onebend.lab.filming.scene import Scene
from onebend.lab.filming.viewpoint import Camera
from onebend.lab.virtual import VirtualBench
from onebend.records import Array

DOWN = -0.5 * pi  # rad, of gravity in the room


@dataclass(frozen=True)
class Filming:
    """A bench and all that a film shows of it. The bench's own camera (noise of poses) has no part in it."""

    bench: VirtualBench
    width: Profile = field(default_factory=lambda: Uniform(0.014))  # m, of the beam as drawn
    rotary_inertia: Profile = field(default_factory=lambda: Uniform(0.0))  # kg m, where it swings
    camera: Camera = field(default_factory=Camera)
    scene: Scene = field(default_factory=Scene)
    swings: bool = False  # the equation of motion instead of equilibria
    damping: float = 0.006  # s, internal damping over stiffness
    gravity: float = 0.0  # m/s^2, in the plane of bending, downwards in the picture; 0: across the plane
    base_angle: float = 0.0  # rad, of the beam's x axis in the room
    tag_size: float = 0.012  # m
    log_rotation: float = 0.0  # rad, of the log's x axis against the beam's
    log_of_robot: bool = False  # the log shows the reaction
    log_before: float = 1.0  # s, and as long after the film
    sensor_name: str = ""
    zeroed: bool = False
    calibrated: bool = True  # whether the camera's calibration is told
    mass_told: bool = True
    lost: float = 0.0  # share of frames that the camera drops


def check(filming: Filming, folder: Path) -> None:
    """Checks that need several parts of the setup."""
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
    if np.isfinite(bench.axial_stiffness):
        raise RecordingError("axial_stiffness is not filmed: leave it infinite, and give a thickness in `effects`")
    if filming.swings and (bench.effects.moves_otherwise or bench.effects.posture_bias):
        raise RecordingError("a beam that swings is filmed without effects on its motion: take a slow push")
    for given in (bench.effects.tag_heights, bench.effects.tag_tilts):
        if given and len(given) != len(bench.tags):
            raise RecordingError("tag_heights and tag_tilts have one value for each tag on the beam, or none")


def frame_times(filming: Filming, rng: np.random.Generator) -> Array:
    """(T,) s, the middle of each exposure since that of the first; dropped frames are missing."""
    count = int(np.ceil(filming.bench.push.duration * filming.bench.fps))
    kept = rng.random(count) >= filming.lost
    kept[0] = True
    return np.asarray(np.flatnonzero(kept) / filming.bench.fps)


def motive_of(filming: Filming) -> MotionSettings:
    """What moves the beam apart from the push, in the clamp's frame."""
    pull = filming.gravity * np.array([np.cos(DOWN - filming.base_angle), np.sin(DOWN - filming.base_angle)])
    return MotionSettings((float(pull[0]), float(pull[1])), filming.swings, filming.damping, filming.rotary_inertia)
