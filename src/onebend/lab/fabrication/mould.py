"""The mould of a design, to print: its cavity is the beam, with a neck and a foot for the clamp behind s = 0.

Lengths inside are mm, as meshes have them. x runs along the beam from the clamp line (s = 0), y across it in the plane
of bending, z along its depth. The cavity's floor makes the face that carries the tags; it is poured from above.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from onebend.errors import MechanicsError
from onebend.lab.designs import Design
from onebend.lab.fabrication.solids import across, box, mesh_of, nothing, strip
from onebend.records import Array

if TYPE_CHECKING:  # an optional package
    from manifold3d import Manifold

MM = 1e3  # of a metre
STATIONS = 301  # along the beam
PEG, PEG_LENGTH, PEG_PLAY = 4.0, 4.0, 0.3  # mm, diameter and length of the halves' pegs; holes are wider by the play
SCREW = 4.3  # mm, a hole for M4
END = 13.0  # mm of solid beyond the cavity where pegs and screws sit
ROOM = 4.0  # times the lean: how far from an end stations are moved along with it
OVER = 1.0  # mm, by which the cavity is cut through the tray's upper face
GROOVE_WIDE, GROOVE_DEEP = 0.4, 0.2  # mm, in the cast, at the tags' places


@dataclass(frozen=True)
class MouldSettings:
    """How a mould is made. Sizes in m, as everywhere outside the meshes."""

    kind: Literal["open", "halves"] = "open"  # one tray, or two halves that part along the beam's middle plane
    wall: float = 0.004  # m, thinnest, also of the floor
    draft: float = 0.0  # rad, by which walls open towards the top; the width is the design's at half the depth
    foot: float = 0.020  # m, length of the foot that the clamp holds
    shoulder: float = 0.004  # m, by which the foot is wider than the beam's base, on either side
    neck: float = 0.003  # m, of the beam's base width, inside the clamp's front wall
    shrinkage: float = 0.0  # part by which the silicone is smaller when cured (0.001 = 0.1 %)
    tag_places: tuple[float, ...] = (1.0 / 3.0, 2.0 / 3.0, 1.0)  # s where fine grooves mark the tags; none: ()

    def __post_init__(self) -> None:
        for name in ("wall", "foot", "shoulder", "neck"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise MechanicsError(f"a mould's {name} must be positive, got {getattr(self, name)} m")
        if not 0.0 <= self.draft <= math.radians(10.0):
            raise MechanicsError(f"a draft is 0 to 10 degrees, got {math.degrees(self.draft):g}")
        if not 0.0 <= self.shrinkage < 0.1:
            raise MechanicsError(f"a shrinkage is a part from 0 to 0.1, got {self.shrinkage}")
        if not all(0.0 < s <= 1.0 for s in self.tag_places):
            raise MechanicsError(f"tags sit at s in (0, 1], got {list(self.tag_places)}")


@dataclass(frozen=True)
class PrintedPart:
    """One solid of a set."""

    name: str
    mesh: Any  # trimesh.Trimesh in mm, watertight


@dataclass(frozen=True)
class Mould:
    """A mould and what comes out of it."""

    design: Design
    settings: MouldSettings
    parts: tuple[PrintedPart, ...]
    cast: Any  # trimesh.Trimesh in mm, the cured beam with its foot, its neck and the grooves

    @property
    def volume(self) -> float:
        """m^3 of silicone that fill it."""
        return float(self.cast.volume) * 1e-9 / (1.0 - self.settings.shrinkage) ** 3

    @property
    def pour(self) -> float:
        """kg of silicone that fill it."""
        return self.volume * self.design.density


def mould(design: Design, settings: MouldSettings = MouldSettings()) -> Mould:
    """The mould of a design.

    Raises:
        MechanicsError: a draft that closes the cavity, or walls too thin to be a solid.
    """
    body, grow = cast_body(design, settings), (1.0 / (1.0 - settings.shrinkage),) * 3
    grown = body.scale(grow)
    tray = _block(grown, settings) - cast_body(design, settings, over=OVER).scale(grow)
    solids = {"mould": tray}
    if settings.kind == "halves":
        left, right = tray.split_by_plane((0.0, 1.0, 0.0), 0.0)
        solids = dict(zip(("mould-left", "mould-right"), _fastened(left, right, grown), strict=True))
    parts = tuple(PrintedPart(name, mesh_of(solid)) for name, solid in solids.items())
    return Mould(design, settings, parts, mesh_of(body))


def cast_body(design: Design, settings: MouldSettings = MouldSettings(), over: float = 0.0) -> Manifold:
    """What is cast and cured: the beam from x = 0 to L, behind it the neck and the foot.

    `over`: mm by which it goes on above its upper face, to cut a mould open there.
    """
    depth = MM * design.depth
    low, high = (height * math.tan(settings.draft) for height in (-0.5 * depth, 0.5 * depth + over))
    solid = nothing()
    for stations in (beam_stations(design, settings), foot_stations(design, settings)):
        solid += strip(_leaning(stations, low), _leaning(stations, high), 0.0, depth + over)
    for s in settings.tag_places:
        if s < 1.0:
            x, half = MM * design.length * s, MM * float(design.width(s))
            solid -= box((x - 0.5 * GROOVE_WIDE, -half, -1.0), (x + 0.5 * GROOVE_WIDE, half, GROOVE_DEEP))
    return solid


def beam_stations(design: Design, settings: MouldSettings) -> Array:
    """(n, 2) mm: x and half width of neck and beam; the neck's end lies inside the foot."""
    s = np.unique(np.concatenate([np.linspace(0.0, 1.0, STATIONS), np.asarray(design.along.stiffness.edges)]))
    half = 0.5 * MM * np.asarray(design.width(s), dtype=float)
    into_foot = -MM * (settings.neck + 0.5 * settings.foot)
    return np.concatenate([[[into_foot, half[0]]], np.column_stack([MM * design.length * s, half])])


def foot_stations(design: Design, settings: MouldSettings) -> Array:
    """(2, 2) mm: x and half width of the foot."""
    half = MM * (0.5 * float(design.width(0.0)) + settings.shoulder)
    return np.array([[-MM * (settings.neck + settings.foot), half], [-MM * settings.neck, half]])


def _leaning(stations: Array, out: float) -> Array:
    """The stations where all walls stand `out` mm further out; those near an end make room for it."""
    x, half = stations.T
    near = np.maximum(0.0, 1.0 - np.stack([x - x[0], x[-1] - x]) / (ROOM * max(abs(out), 1e-9)))
    return np.column_stack([x + out * (near[1] - near[0]), half + out])


def _block(cavity: Manifold, settings: MouldSettings) -> Manifold:
    """The tray before the cavity is taken out; thicker at the ends of two halves, for pegs and screws."""
    low_x, low_y, _, high_x, high_y, top = cavity.bounding_box()
    wall = MM * settings.wall
    end = max(wall, END) if settings.kind == "halves" else wall
    return box((low_x - end, low_y - wall, -wall), (high_x + end, high_y + wall, top))


def _fastened(left: Manifold, right: Manifold, cavity: Manifold) -> tuple[Manifold, Manifold]:
    """Pegs on the left half, their holes in the right one, and a screw through both at either end."""
    low_x, _, _, high_x, _, top = cavity.bounding_box()
    reach = 2.0 * left.bounding_box()[4]
    for x in (low_x - 0.5 * END, high_x + 0.5 * END):
        peg, screw = 0.25 * top, 0.75 * top
        left += across(x, peg, -PEG_LENGTH, 0.5, PEG)
        right -= across(x, peg, -PEG_LENGTH - PEG_PLAY, 1.0, PEG + PEG_PLAY)
        hole = across(x, screw, -reach, reach, SCREW)
        left, right = left - hole, right - hole
    return left, right
