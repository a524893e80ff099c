"""What a real bench does beyond the ideal one: a record with every effect as an option, none by default."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.stiffness import Powers
from onebend.errors import RecordingError
from onebend.records import Array

SHEAR_FACTOR = 5.0 / 6.0  # of a rectangle
PATCH_OVER_TAG = 1.25  # length of a stiff patch over the side of the tag's black square


@dataclass(frozen=True)
class RealBench:
    """Effects of the beam, its holding and contact, of the force sensor, and of the picture (these in films alone)."""

    # The beam
    thickness: float = 0.0  # m, mean, in the plane of bending; h(s) ~ k^(1/3). 0: neither stretch nor shear
    poisson: float = 0.45
    relaxation: float = 0.0  # share of the stiffness that relaxes (standard linear solid)
    relaxation_time: float = 3.0  # s
    patch_factor: float = 1.0  # of k under each tag
    patch_length: float = PATCH_OVER_TAG * 0.012  # m, middle at the tag's; its edges are sharp
    rest_turn: tuple[float, ...] = ()  # rad, of s^0, s^1, ...: curvature at rest on top of the beam's own
    inertia: bool = False  # mass times acceleration, of the shapes that follow the push without swinging
    # How it is held and pushed
    clamp_compliance: float = 0.0  # rad/(N m)
    slide: float = 0.0  # m per rad of the beam's turn where it is pushed, outwards: the contact's way along the beam
    push_off: float = 0.0  # m, by which the contact begins further out than the push's place
    length_off: float = 0.0  # share by which the stated length is too large
    # The sensor
    posture_bias: float = 0.0  # share of the peak: largest size of an error that goes with the tool's place
    posture_shape: tuple[float, ...] = (
        1.0,
        0.5,
        -0.8,
        0.3,
        0.6,
        -0.4,
        0.9,
        0.5,
        -0.7,
        0.2,
    )  # x, y, x^2, xy, y^2; twice
    # The picture
    base_height: float = 0.0  # m, of the base tag's face over the plane of the other tags, towards the camera
    tag_heights: tuple[float, ...] = ()  # m, of the tags on the beam; one each, or none
    tag_tilts: tuple[tuple[float, float], ...] = ()  # rad, of their faces: about the beam's direction, and across it
    droop: float = 0.0  # m, by which the tip of the straight beam hangs out of the plane, away from the camera
    shake: float = 0.0  # px RMS, on each axis
    shake_band: tuple[float, float] = (3.0, 8.0)  # Hz
    drift: float = 0.0  # px, from first to last frame
    readout: float = 0.0  # s, from the first row to the last (rolling shutter)

    def __post_init__(self) -> None:
        sizes = (self.thickness, self.clamp_compliance, self.posture_bias, self.shake, self.drift, self.readout)
        if not all(np.isfinite(v) and v >= 0.0 for v in sizes):
            raise RecordingError(
                "thickness, clamp compliance, posture bias, shake, drift and read-out time are finite and not negative"
            )
        if not (0.0 <= self.relaxation < 1.0 and self.relaxation_time > 0.0):
            raise RecordingError("relaxation is a share in [0, 1), its time is above zero")
        if not (self.patch_factor > 0.0 and self.patch_length > 0.0):
            raise RecordingError("a patch needs a factor and a length above zero")
        if not (self.length_off > -1.0 and -1.0 < self.poisson <= 0.5):
            raise RecordingError("a length is off by more than -1, and Poisson's ratio is in (-1, 0.5]")
        if len(self.posture_shape) != 10 or not 0.0 < self.shake_band[0] < self.shake_band[1]:
            raise RecordingError("a posture's shape has 10 coefficients, and a shake a band of rising frequencies")

    @property
    def moves_otherwise(self) -> bool:
        """Whether the beam moves in another way than an ideal beam of its own stiffness, or is pushed elsewhere."""
        sizes = (self.thickness, self.relaxation, self.clamp_compliance, self.slide, self.push_off)
        return any(sizes) or any(self.rest_turn) or self.patch_factor != 1.0 or self.inertia

    @property
    def pictured(self) -> bool:
        """Whether the picture shows anything that an ideal one does not."""
        sizes = (self.base_height, self.droop, self.shake, self.drift, self.readout)
        return any(sizes) or any(self.tag_heights) or any(any(tilt) for tilt in self.tag_tilts)


def patch_ends(effects: RealBench, length: float, tags: Array) -> Array:
    """(m, 2) s, first and last place of the stiff patch under each tag (m,), beyond the tip too; (0, 2) without."""
    if effects.patch_factor == 1.0:
        return np.zeros((0, 2))
    half = 0.5 * effects.patch_length / length
    return np.stack([tags - half, tags + half], axis=1)


def instant_stiffness(beam: Beam, effects: RealBench, tags: Array, s: Array) -> Array:
    """k(s) [N m] before anything relaxes, with the patches under `tags` (m,)."""
    patches = patch_ends(effects, beam.length, tags)
    under = np.any((s[:, None] > patches[:, 0]) & (s[:, None] < patches[:, 1]), axis=1)
    return np.asarray(beam.stiffness(s)) * np.where(under, effects.patch_factor, 1.0)


def section_flexibility(beam: Beam, effects: RealBench, s: Array) -> tuple[Array, Array]:
    """1/EA and 1/kGA [1/N] at `s` (S,): EA = 12 EI / h^2 and kGA = 5/6 EA / (2 (1 + nu)); zeros without thickness."""
    if effects.thickness == 0.0:
        return np.zeros(len(s)), np.zeros(len(s))
    k = np.asarray(beam.stiffness(s))
    mean = float(np.mean(np.asarray(beam.stiffness(np.linspace(0.0, 1.0, 401)))))
    thickness = effects.thickness * np.cbrt(k / mean)
    per_stretch = thickness**2 / (12.0 * k * beam.length)
    return per_stretch, per_stretch * 2.0 * (1.0 + effects.poisson) / SHEAR_FACTOR


def rest_curvature(beam: Beam, effects: RealBench, s: Array) -> Array:
    """(S,) rad, the beam's own and the bench's."""
    own = np.asarray(beam.rest_curvature(s))
    return own + np.asarray(Powers(effects.rest_turn)(s)) if effects.rest_turn else own
