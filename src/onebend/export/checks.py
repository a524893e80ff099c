"""What every export asks of a beam, and how it writes numbers."""

from __future__ import annotations

import numpy as np

from onebend.beam.model import Beam
from onebend.errors import ExportError
from onebend.records import Array

MASSES = (1e-9, 1e6)  # kg, that a beam may have
TIMES = (1e-9, 1e6)  # s, of damping over stiffness


def plain(value: float) -> str:
    """Enough digits to read the very same number back."""
    return repr(float(value))


def checked_damping(damping_time: float) -> float:
    """The damping time, or an `ExportError` where it is none."""
    if not TIMES[0] <= damping_time <= TIMES[1]:
        raise ExportError(
            f"the damping time must be a positive number of seconds ({TIMES[0]:g} to {TIMES[1]:g}), got "
            f"{damping_time}; without damping a chain of light links and stiff hinges rings for ever"
        )
    return damping_time


def checked_stiffness(beam: Beam, s: Array) -> Array:
    """k at `s` [N m], or an `ExportError` where it is not positive."""
    k = np.asarray(beam.stiffness(s))
    if not np.all(k > 0.0):
        raise ExportError(f"k(s) is not positive at s = {s[~(k > 0.0)][0]:.3f}; no simulator can bend such a beam")
    return k


def refuse_masses(beam: Beam, what: str) -> None:
    """Raises `ExportError` where something rides on the beam that an export does not carry."""
    if beam.masses:
        raise ExportError(f"{what} holds a mass per metre only, and {len(beam.masses)} masses ride on this beam")


def checked_mass(beam: Beam, mass: float | None, s: Array) -> Array:
    """Mass per metre at `s` [kg/m], `mass` [kg] spread evenly where given; or an `ExportError` where none is known."""
    if mass is not None:
        if not MASSES[0] <= mass <= MASSES[1]:
            raise ExportError(f"the mass must be a positive number of kg ({MASSES[0]:g} to {MASSES[1]:g}), got {mass}")
        return np.full(np.shape(s), mass / beam.length)
    out = np.asarray(beam.mass_per_length(s))
    if not np.all(out > 0.0):
        raise ExportError(
            "the beam's mass is not known, and a simulator in time needs it: weigh the beam and give --mass-kg "
            "(mass in Python), or write mass_kg under [beam] into recording.toml and learn again"
        )
    return out
