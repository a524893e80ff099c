"""The clamp that holds a cast beam at s = 0, and carriers for its tags; all tags come to lie in one plane.

In use the tags' face is up: z = 0 is the beam's lower face here, z = depth the one that carries the tags. The base tag
sits right over s = 0 on a ledge of the clamp that reaches out over the beam without touching it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from onebend.errors import MechanicsError
from onebend.lab.designs import Design
from onebend.lab.fabrication.mould import MM, SCREW, MouldSettings, PrintedPart, beam_stations, foot_stations
from onebend.lab.fabrication.solids import box, mesh_of, nothing, strip, upright

if TYPE_CHECKING:  # an optional package
    from manifold3d import Manifold

CAP, FREE = 3.0, 0.6  # mm, the cap's thickness and the gap between its ledge and the beam
RECESS, PLAY, LIP = 0.3, 0.2, 0.8  # mm, a tag's recess: depth, wider than the tag by, and the plate around it
TAG_PLANE = CAP - RECESS  # mm above the beam's face
STEM = 1.2  # mm, height of a carrier's foot
STEM_LONG, STEM_WIDE = 3.0, 0.8  # mm along the beam, and part of the beam's width
BESIDE = 10.0  # mm beside the foot, for the screws
FLOOR = 6.0  # mm under the foot
SQUEEZE, LOOSE = 0.4, 0.3  # mm by which the cap presses into the foot's pocket, and its clearance there
BETWEEN = 4.0  # mm between carriers on the print bed


@dataclass(frozen=True)
class TagSeat:
    """The tags as they are cut out."""

    size: float = 0.012  # m, side of the black square
    cells: float = 10.0 / 8.0  # side of what is cut out, as a multiple of it (with one cell of white: 10/8)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.size) and self.size > 0.0 and self.cells >= 1.0):
            raise MechanicsError(f"a tag's seat needs a positive size, got {self.size} m times {self.cells}")

    @property
    def recess(self) -> float:
        """mm, side of the recess."""
        return MM * self.size * self.cells + PLAY


def clamp(
    design: Design, settings: MouldSettings = MouldSettings(), seat: TagSeat = TagSeat()
) -> tuple[PrintedPart, ...]:
    """The clamp's lower part with the foot's pocket, and its cap with the base tag's seat."""
    depth, wall = MM * design.depth, MM * settings.wall
    foot, neck = foot_stations(design, settings), beam_stations(design, settings)[:2]
    reach = 0.5 * seat.recess
    back, half = foot[0, 0] - wall, max(foot[0, 1], reach + LIP) + BESIDE
    pocket = strip(foot, foot, 0.0, depth + 1.0)
    opening = np.vstack([neck[0], [1.0, neck[1, 1]]])
    pocket += strip(opening, opening, 0.0, depth + 1.0)
    lower = box((back, -half, -FLOOR), (0.0, half, depth)) - pocket
    cap = box((back, -half, depth), (0.0, half, depth + CAP))
    cap += box((-reach - LIP, -reach - LIP, depth + FREE), (reach + LIP, reach + LIP, depth + CAP))
    pressed = foot + np.array([[LOOSE, -LOOSE], [-LOOSE, -LOOSE]])
    cap += strip(pressed, pressed, depth - SQUEEZE, depth + 0.5 * CAP)
    cap -= box((-reach, -reach, depth + TAG_PLANE), (reach, reach, depth + CAP + 1.0))
    for hole in _screws(back, half, depth):
        lower, cap = lower - hole, cap - hole
    return PrintedPart("clamp-lower", mesh_of(lower)), PrintedPart("clamp-cap", mesh_of(cap))


def carriers(design: Design, settings: MouldSettings = MouldSettings(), seat: TagSeat = TagSeat()) -> PrintedPart:
    """A plate for every tag on the beam, in a row as they are printed: on their faces' backs, stems up.

    A stem is glued across the beam at the tag's place; the plate above touches nothing, so that a tag does not stiffen
    the beam over its own length.

    Raises:
        MechanicsError: tags so near to each other that their plates meet, or no tag at all.
    """
    if not settings.tag_places:
        raise MechanicsError("there are no tags to carry: give their places along the beam")
    side = seat.recess + 2.0 * LIP
    places = np.sort(np.array(settings.tag_places))
    nearest = MM * design.length * float(np.min(np.diff(np.concatenate([[0.0], places]))))
    if nearest < side:
        raise MechanicsError(
            f"tags {nearest:.1f} mm apart do not fit side by side: their plates are {side:.1f} mm wide. "
            "Take smaller tags, or fewer"
        )
    row = nothing()
    for i, s in enumerate(places):
        row += _carrier(design, float(s), seat).translate((i * (side + BETWEEN), 0.0, 0.0))
    return PrintedPart("carriers", mesh_of(row))


def _carrier(design: Design, s: float, seat: TagSeat) -> Manifold:
    """One plate with its stem; z = 0 is the beam's face, the origin the tag's centre."""
    reach = 0.5 * seat.recess
    plate = box((-reach - LIP, -reach - LIP, STEM), (reach + LIP, reach + LIP, CAP))
    plate -= box((-reach, -reach, TAG_PLANE), (reach, reach, CAP + 1.0))
    beyond = MM * design.length * (1.0 - s)
    end = min(0.5 * STEM_LONG, beyond)
    half = min(0.5 * STEM_WIDE * MM * float(design.width(s)), reach)
    return plate + box((end - STEM_LONG, -half, 0.0), (end, half, STEM + 0.1))


def _screws(back: float, half: float, depth: float) -> list[Manifold]:
    """Holes for four M4 screws through cap and lower part, and into what the clamp stands on."""
    aside, fore, aft = half - 0.5 * BESIDE, -0.5 * BESIDE, back + 0.5 * BESIDE
    return [upright(x, y, -FLOOR - 1.0, depth + CAP + 1.0, SCREW) for x in (aft, fore) for y in (-aside, aside)]
