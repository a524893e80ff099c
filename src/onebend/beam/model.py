"""The beam as users meet it: a frozen record with a length, profiles along it, and its shape under a load."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from onebend.beam.stiffness import Profile, Uniform, profile_from_dict
from onebend.errors import MechanicsError


@dataclass(frozen=True)
class Beam:
    """A planar, inextensible, unshearable slender beam, clamped at s = 0."""

    length: float  # L, m
    stiffness: Profile  # k(s) = E I / L, N m
    rest_curvature: Profile = field(default_factory=lambda: Uniform(0.0))  # q0(s), rad
    clamp_angle: float = 0.0  # alpha0, rad
    mass_per_length: Profile = field(default_factory=lambda: Uniform(0.0))  # mu(s), kg/m

    def __post_init__(self) -> None:
        if not self.length > 0.0:
            raise MechanicsError(f"a beam's length must be positive, got {self.length} m")

    def as_dict(self) -> dict[str, Any]:
        """Plain data from which `Beam.from_dict` makes an equal beam."""
        return {
            "length_m": self.length,
            "stiffness_N_m": self.stiffness.as_dict(),
            "rest_curvature_rad": self.rest_curvature.as_dict(),
            "clamp_angle_rad": self.clamp_angle,
            "mass_per_length_kg_m": self.mass_per_length.as_dict(),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Beam:
        """Inverse of `as_dict`. Raises `MechanicsError` where an entry is missing."""
        try:
            return cls(
                length=float(data["length_m"]),
                stiffness=profile_from_dict(data["stiffness_N_m"]),
                rest_curvature=profile_from_dict(data["rest_curvature_rad"]),
                clamp_angle=float(data["clamp_angle_rad"]),
                mass_per_length=profile_from_dict(data["mass_per_length_kg_m"]),
            )
        except KeyError as error:
            raise MechanicsError(f"the beam's data lack {error}") from error
