"""What mechanics needs to know of a beam."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from onebend.beam.profiles.rectangular import RectangularSection
from onebend.beam.profiles.stiffness import Profile
from onebend.beam.statics.nodal_beam import GridMemory
from onebend.errors import MechanicsError
from onebend.records import PointMass


class Rod(Protocol):
    """What mechanics needs to know of a beam; `model.Beam` is one."""

    @property
    def length(self) -> float: ...
    @property
    def stiffness(self) -> Profile: ...
    @property
    def rest_curvature(self) -> Profile: ...
    @property
    def clamp_angle(self) -> float: ...
    @property
    def mass_per_length(self) -> Profile: ...
    @property
    def section(self) -> RectangularSection | None: ...
    @property
    def memory(self) -> GridMemory: ...
    @property
    def masses(self) -> tuple[PointMass, ...]: ...


def has_mass(rod: Rod) -> bool:
    """Whether it has a mass of its own: without, gravity does nothing and nothing swings."""
    return bool(np.any(np.asarray(rod.mass_per_length(np.linspace(0.0, 1.0, 11))) > 0.0))


def refuse_section(rod: Rod, who: str) -> None:
    """Raises `MechanicsError` where a beam has a thickness and `who` does not know stretch and shear."""
    if rod.section is not None:
        raise MechanicsError(f"{who} takes beams that neither stretch nor shear: give the beam without its thickness")
