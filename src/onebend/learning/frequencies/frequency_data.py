"""The measured frequencies of one recording as the fit sees them: everything that does not depend on the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.beam.grid import Grid, make_grid
from onebend.beam.profiles.rectangular import RectangularSection
from onebend.beam.profiles.stiffness import Uniform
from onebend.errors import LearningError
from onebend.learning.allowances.patches import patch_functions
from onebend.learning.model.fit_data import MASS_MODES, REST_MODES
from onebend.learning.model.frames import mass_profile
from onebend.learning.model.mass import NEEDS_MASS
from onebend.learning.model.own_weight import POWERS, OwnWeight, own_weight
from onebend.learning.model.spline import Spline
from onebend.records import Array, IntArray, MeasuredFrequency, Observations, PointMass

_ORDER, _WIDEST = 6, 0.125  # as the statics of the fit: 1e-7 in the frequencies of the first modes
MOST_MODES = 8  # beyond, a beam is no slender one any more


@dataclass(frozen=True)
class Posture:
    """Frequencies that were measured with the base held alike and the same mass at the tip."""

    gravity: Array  # (2,) m/s^2 in the beam's frame
    points: tuple[PointMass, ...]
    rows: IntArray  # (n,) which of the recording's frequencies
    modes: IntArray  # (n,) of each, counted from 0


@dataclass(frozen=True)
class FrequencyData:
    """N frequencies; Q nodes of a grid."""

    name: str  # of the recording
    number: int  # of the same, among those that are fitted together
    measured: Array  # (N,) log of Hz
    sd: Array  # (N,) of the logs
    postures: tuple[Posture, ...]
    length: float  # m, as written
    grid: Grid
    on_nodes: Array  # (Q, p): the spline's functions
    patches: Array | None  # (Q, n): functions of log k under the tags
    rest_on_nodes: Array  # (Q, 3)
    mass: OwnWeight
    written: Array  # (Q,) kg/m that the parts of the mass come on top of
    section: RectangularSection | None  # from which shear and rotary inertia follow; None where it is not stated


def frequency_data(recordings: Sequence[Observations], spline: Spline) -> tuple[FrequencyData, ...]:
    """Prepare the frequencies of those recordings that have some; modes and mass are known or guessed.

    Raises:
        LearningError: no mass.
    """
    return tuple(_prepared(o, i, spline) for i, o in enumerate(recordings) if o.frequencies)


def _prepared(o: Observations, number: int, spline: Spline) -> FrequencyData:
    if not np.isfinite(o.stated.mass):
        raise LearningError(f"{o.source.name}: {NEEDS_MASS}")
    grid = make_grid(order=_ORDER, widest=_WIDEST)
    nodes, line = grid.nodes, mass_profile(o)
    written = line if o.stated.mass_along not in POWERS else Uniform(0.0)
    measured = np.array([one.frequency for one in o.frequencies])
    glued = not o.static and np.isfinite(o.stated.tag_size)
    return FrequencyData(
        name=o.source.name,
        number=number,
        measured=np.log(measured),
        sd=np.array([one.sd for one in o.frequencies]) / measured,
        postures=postures_of(o.frequencies, o.stated.masses),
        length=o.length,
        grid=grid,
        on_nodes=spline.basis(nodes),
        patches=patch_functions(o.marker_s, o.length, o.stated.tag_size, nodes) if glued else None,
        rest_on_nodes=REST_MODES.curvature(nodes),
        mass=own_weight(o, grid, np.zeros((1, 2)), MASS_MODES.curvature(nodes), line),
        written=np.asarray(written(nodes)),
        section=RectangularSection(o.stated.thickness) if np.isfinite(o.stated.thickness) else None,
    )


def postures_of(frequencies: tuple[MeasuredFrequency, ...], riding: tuple[PointMass, ...] = ()) -> tuple[Posture, ...]:
    """The frequencies by posture and mass at the tip; `riding` masses are on the beam in all of them."""
    found: dict[tuple[tuple[float, ...], float], list[int]] = {}
    for i, one in enumerate(frequencies):
        found.setdefault((one.gravity, one.tip_mass), []).append(i)
    return tuple(
        Posture(
            np.array(gravity),
            (*riding, PointMass(1.0, tip)) if tip > 0.0 else riding,
            np.array(rows, dtype=np.int64),
            np.array([frequencies[i].mode - 1 for i in rows], dtype=np.int64),
        )
        for (gravity, tip), rows in found.items()
    )
