"""Moulds, clamps and tag carriers as parts to print."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from onebend.beam.stiffness import half_width
from onebend.errors import MechanicsError
from onebend.extras import package
from onebend.lab.designs import Design
from onebend.options import option
from onebend.records import Array
from onebend.report.style import BLUE, INK, blank, styled
from onebend.results.tables import PLACES, csv_rows
from onebend.text_files import figure_text

if TYPE_CHECKING:
    from manifold3d import Manifold


FACETS = 48  # of a cylinder
MESH_SUFFIXES = (".stl", ".3mf")


def nothing() -> Manifold:
    return _manifold3d().Manifold()


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Manifold:
    size = tuple(b - a for a, b in zip(low, high, strict=True))
    return _manifold3d().Manifold.cube(size).translate(low)


def upright(x: float, y: float, low: float, high: float, diameter: float) -> Manifold:
    """A cylinder along z."""
    return _cylinder(high - low, diameter).translate((x, y, low))


def across(x: float, z: float, low: float, high: float, diameter: float) -> Manifold:
    """A cylinder along y."""
    return _cylinder(high - low, diameter).rotate((-90.0, 0.0, 0.0)).translate((x, low, z))


def strip(lower: Array, upper: Array, bottom: float, top: float) -> Manifold:
    """A body symmetric about y = 0, from stations (n, 2) of x and half width at its bottom and top. Raises
    `MechanicsError`: x does not rise, or a width is not positive."""
    for stations in (lower, upper):
        if np.any(np.diff(stations[:, 0]) <= 0.0) or np.any(stations[:, 1] <= 0.0):
            raise MechanicsError("the part has no thickness somewhere: take less draft, or a wider beam")
    n = len(lower)
    rings = []
    for stations, z in ((lower, bottom), (upper, top)):
        forth = np.column_stack([stations[:, 0], -stations[:, 1], np.full(n, z)])
        back = np.column_stack([stations[::-1, 0], stations[::-1, 1], np.full(n, z)])
        rings += [forth, back]
    i = np.arange(n - 1)
    cap = np.concatenate(
        [np.column_stack([i, i + 1, 2 * n - 2 - i]), np.column_stack([i, 2 * n - 2 - i, 2 * n - 1 - i])]
    )
    j = np.arange(2 * n)
    following = (j + 1) % (2 * n)
    sides = np.concatenate(
        [np.column_stack([j, following, following + 2 * n]), np.column_stack([j, following + 2 * n, j + 2 * n])]
    )
    faces = np.concatenate([cap[:, ::-1], cap + 2 * n, sides])
    library = _manifold3d()
    surface = library.Mesh64(vert_properties=np.concatenate(rings), tri_verts=faces.astype(np.uint64))
    made = library.Manifold(surface)
    if made.status() != library.Error.NoError:
        raise MechanicsError(f"the part's surface does not close ({made.status()})")
    return made


def mesh_of(solid: Manifold) -> Any:
    """A checked `trimesh.Trimesh`. Raises `MechanicsError`: empty solid, or surface not watertight."""
    found = solid.to_mesh64()
    mesh = package("trimesh", "make").Trimesh(
        np.asarray(found.vert_properties)[:, :3], np.asarray(found.tri_verts, dtype=np.int64), process=False
    )
    if not (mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0):
        raise MechanicsError("a part's surface is not watertight: take a thicker wall or less draft")
    return mesh


def write_mesh(path: Path, mesh: Any) -> None:
    """Write STL or 3MF in mm. Raises `MechanicsError`: another file ending."""
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise MechanicsError(f"{path}: parts are written as {' or '.join(MESH_SUFFIXES)}. Name the file so.")
    mesh.units = "mm"
    data = mesh.export(file_type=path.suffix.lower()[1:])
    path.write_bytes(data if isinstance(data, bytes) else str(data).encode())


def _cylinder(height: float, diameter: float) -> Manifold:
    return _manifold3d().Manifold.cylinder(height, 0.5 * diameter, circular_segments=FACETS)


def _manifold3d() -> Any:
    return package("manifold3d", "make")


# The mould: its cavity is the beam, with a neck and a foot for the clamp behind s = 0. Lengths in mm. x runs along the
# beam from the clamp line (s = 0), y across it in the plane of bending, z along its depth. The cavity's floor forms the
# face that carries the tags; it is poured from above.

MM = 1e3  # of a metre
STATIONS = 301  # along the beam
PEG, PEG_LENGTH, PEG_PLAY = 4.0, 4.0, 0.3  # mm; holes are wider by the play
SCREW = 4.3  # mm, a hole for M4
END = 13.0  # mm of solid beyond the cavity for pegs and screws
ROOM = 4.0  # in units of the lean: stations nearer than this to an end move with it
OVER = 1.0  # mm the cavity is cut through the tray's upper face
GROOVE_WIDE, GROOVE_DEEP = 0.4, 0.2  # mm, marks in the cast at the tags' places


@dataclass(frozen=True)
class MouldSettings:
    """Sizes in m."""

    kind: Literal["open", "halves"] = option("--kind", "open", "One open tray, or two halves.")
    wall: float = option("--wall-mm", 0.004, "Thickness of walls and floor.", metavar="MM", within=(0.4, 1e9))
    draft: float = option(  # the stated width is that at half depth
        "--draft-deg", 0.0, "Draft angle of the walls.", metavar="DEG", within=(0.0, 10.0)
    )
    foot: float = 0.020  # m the clamp holds
    shoulder: float = 0.004  # m the foot is wider than the beam's base, per side
    neck: float = 0.003  # m of base width inside the clamp's front wall
    shrinkage: float = option("--shrinkage-percent", 0.0, "Shrinkage of the silicone.", metavar="P", within=(0.0, 9.9))
    tag_places: tuple[float, ...] = option(  # marked by fine grooves; (): none
        "--tag-at",
        (1.0 / 3.0, 2.0 / 3.0, 1.0),
        "Place of a tag on the beam; may be repeated.",
        metavar="S",
        within=(0.0, 1.0),
    )

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
    name: str
    mesh: Any  # trimesh.Trimesh in mm, watertight


@dataclass(frozen=True)
class Mould:
    design: Design
    settings: MouldSettings
    parts: tuple[PrintedPart, ...]
    cast: Any  # trimesh.Trimesh in mm: cured beam with foot, neck and grooves

    @property
    def volume(self) -> float:
        """m^3 of silicone to fill it."""
        return float(self.cast.volume) * 1e-9 / (1.0 - self.settings.shrinkage) ** 3

    @property
    def pour(self) -> float:
        """kg of silicone to fill it."""
        return self.volume * self.design.density


def mould(design: Design, settings: MouldSettings = MouldSettings()) -> Mould:
    """Raises `MechanicsError`: a draft closes the cavity, or walls are too thin."""
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
    """The cured body: the beam from x = 0 to L, with neck and foot behind.

    `over`: mm it continues above its upper face, to cut a mould open there.
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
    """(n, 2) mm: x and half width of neck and beam; the neck ends inside the foot."""
    s = np.unique(np.concatenate([np.linspace(0.0, 1.0, STATIONS), np.asarray(design.along.stiffness.edges)]))
    half = 0.5 * MM * np.asarray(design.width(s), dtype=float)
    into_foot = -MM * (settings.neck + 0.5 * settings.foot)
    return np.concatenate([[[into_foot, half[0]]], np.column_stack([MM * design.length * s, half])])


def foot_stations(design: Design, settings: MouldSettings) -> Array:
    half = MM * (0.5 * float(design.width(0.0)) + settings.shoulder)
    return np.array([[-MM * (settings.neck + settings.foot), half], [-MM * settings.neck, half]])


def _leaning(stations: Array, out: float) -> Array:
    """The stations with all walls `out` mm further out; those near an end make room."""
    x, half = stations.T
    near = np.maximum(0.0, 1.0 - np.stack([x - x[0], x[-1] - x]) / (ROOM * max(abs(out), 1e-9)))
    return np.column_stack([x + out * (near[1] - near[0]), half + out])


def _block(cavity: Manifold, settings: MouldSettings) -> Manifold:
    """The tray before the cavity is cut; thicker at the ends of a split mould, for pegs and screws."""
    low_x, low_y, _, high_x, high_y, top = cavity.bounding_box()
    wall = MM * settings.wall
    end = max(wall, END) if settings.kind == "halves" else wall
    return box((low_x - end, low_y - wall, -wall), (high_x + end, high_y + wall, top))


def _fastened(left: Manifold, right: Manifold, cavity: Manifold) -> tuple[Manifold, Manifold]:
    low_x, _, _, high_x, _, top = cavity.bounding_box()
    reach = 2.0 * left.bounding_box()[4]
    for x in (low_x - 0.5 * END, high_x + 0.5 * END):
        peg, screw = 0.25 * top, 0.75 * top
        left += across(x, peg, -PEG_LENGTH, 0.5, PEG)
        right -= across(x, peg, -PEG_LENGTH - PEG_PLAY, 1.0, PEG + PEG_PLAY)
        hole = across(x, screw, -reach, reach, SCREW)
        left, right = left - hole, right - hole
    return left, right


# The clamp at s = 0 and carriers that bring all tags into one plane. In use the tags' face is up: z = 0 is the beam's
# lower face, z = depth the tags' face. The base tag sits over s = 0 on a ledge of the clamp that does not touch the
# beam.

CAP, FREE = 3.0, 0.6  # mm, the cap's thickness; gap between its ledge and the beam
RECESS, PLAY, LIP = 0.3, 0.2, 0.8  # mm, a tag's recess: depth, clearance, and plate around it
TAG_PLANE = CAP - RECESS  # mm above the beam's face
STEM = 1.2  # mm, height of a carrier's foot
STEM_LONG, STEM_WIDE = 3.0, 0.8  # mm along the beam; share of the beam's width
BESIDE = 10.0  # mm beside the foot, for the screws
FLOOR = 6.0  # mm under the foot
SQUEEZE, LOOSE = 0.4, 0.3  # mm the cap presses into the foot's pocket; its clearance
BETWEEN = 4.0  # mm between carriers when printed


@dataclass(frozen=True)
class TagSeat:
    """The cut-out tags."""

    size: float = option("--size-mm", 0.012, "Side of a tag's black square.", metavar="MM", within=(0.5, 1e9))
    cells: float = 10.0 / 8.0  # cut-out side over the tag's side (10/8: one cell of white)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.size) and self.size > 0.0 and self.cells >= 1.0):
            raise MechanicsError(f"a tag's seat needs a positive size, got {self.size} m times {self.cells}")

    @property
    def recess(self) -> float:
        return MM * self.size * self.cells + PLAY


def clamp(
    design: Design, settings: MouldSettings = MouldSettings(), seat: TagSeat = TagSeat()
) -> tuple[PrintedPart, ...]:
    """The clamp's base with the foot's pocket, and its cap with the base tag's seat."""
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
    """One plate per tag on the beam, in a row for printing: face down, stem up.

    A stem is glued across the beam at the tag's place. The plate does not touch the beam, so a tag does not stiffen it
    over the tag's length. Raises `MechanicsError`: plates overlap, or there is no tag.
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
    """One plate and stem; z = 0 is the beam's face, the origin the tag's centre."""
    reach = 0.5 * seat.recess
    plate = box((-reach - LIP, -reach - LIP, STEM), (reach + LIP, reach + LIP, CAP))
    plate -= box((-reach, -reach, TAG_PLANE), (reach, reach, CAP + 1.0))
    beyond = MM * design.length * (1.0 - s)
    end = min(0.5 * STEM_LONG, beyond)
    half = min(0.5 * STEM_WIDE * MM * float(design.width(s)), reach)
    return plate + box((end - STEM_LONG, -half, 0.0), (end, half, STEM + 0.1))


def _screws(back: float, half: float, depth: float) -> list[Manifold]:
    aside, fore, aft = half - 0.5 * BESIDE, -0.5 * BESIDE, back + 0.5 * BESIDE
    return [upright(x, y, -FLOOR - 1.0, depth + CAP + 1.0, SCREW) for x in (aft, fore) for y in (-aside, aside)]


DESIGN_FORMAT = "onebend-design-1"
MOULD_FORMAT = "onebend-mould-1"
TAGS_FORMAT = "onebend-tags-1"
DESIGN_COLUMNS = ("s", "width_m", "EI_N_m2", "k_N_m", "mass_kg_m")


def design_csv(design: Design) -> str:
    """The design at 201 places."""
    s = np.linspace(0.0, 1.0, PLACES)
    columns = (s, design.width(s), design.bending(s), design.along.stiffness(s), design.along.mass_per_length(s))
    text = StringIO(newline="")
    csv_rows(text, DESIGN_COLUMNS, ([f"{value:.9g}" for value in row] for row in zip(*columns, strict=True)))
    return text.getvalue()


def parts_summary(made: Mould, parts: tuple[PrintedPart, ...], *, written_by: str) -> dict[str, Any]:
    """Contents of `onebend mould --json` and `summary.json` (which adds `files`)."""
    return {
        "format": MOULD_FORMAT,
        "written_by": written_by,
        "design": made.design.name,
        "kind": made.settings.kind,
        "pour_m3": made.volume,
        "pour_kg": made.pour,
        "parts": {part.name: {"size_mm": part.mesh.extents.tolist(), "volume_mm3": part.mesh.volume} for part in parts},
    }


def write_parts(folder: Path, parts: tuple[PrintedPart, ...], shape: str) -> None:
    """Write each part as a file with the ending `shape`."""
    for part in parts:
        write_mesh(folder / f"{part.name}.{shape}", part.mesh)


S = np.linspace(0.0, 1.0, 401)
SOLID = np.array([0.80, 0.87, 1.0])  # colour of a part
VIEW = np.array([-0.45, -0.62, 0.64])  # towards the eye
LIGHT = np.array([-0.2, -0.55, 0.81])


@styled
def design_figure(design: Design) -> Figure:
    """The cast outline to scale, and k(s) with the band of the modulus."""
    figure, (outline, stiffness) = blank(4.2, rows=2, height_ratios=(1.0, 2.2))
    x, half = MM * design.length * S, 0.5 * MM * np.asarray(design.width(S))
    outline.fill_between(x, -half, half, color=BLUE, alpha=0.25, linewidth=0.0)
    outline.plot(x, half, color=BLUE)
    outline.plot(x, -half, color=BLUE)
    sizes = f"{MM * design.length:g} mm long, {MM * design.depth:g} mm deep"
    outline.set(aspect="equal", xlabel="along the beam [mm]", ylabel="across [mm]")
    outline.set_title(f"{figure_text(design.name)}: {sizes}")
    k = np.asarray(design.along.stiffness(S))
    stiffness.plot(S, k, color=INK)
    if design.modulus_log_sd > 0.0:
        wide = np.exp(half_width(design.modulus_log_sd))
        stiffness.fill_between(S, k / wide, k * wide, color=INK, alpha=0.15, linewidth=0.0, label="95 %, modulus alone")
        stiffness.legend()
    stiffness.set(xlim=(0.0, 1.0), ylim=(0.0, None), xlabel="place along the beam s", ylabel="k [N m]")
    stiffness.set_title(f"E = {design.modulus / 1e6:.3g} MPa ({figure_text(design.source)})")
    return figure


@styled
def parts_figure(parts: Sequence[PrintedPart]) -> Figure:
    """Each part from above at an angle, each at its own scale."""
    rows = (len(parts) + 1) // 2
    figure, places = blank(2.6 * rows, rows, 2)
    for axes in places:
        axes.set_axis_off()
    for part, axes in zip(parts, places, strict=False):
        axes.add_collection(faces_of(part))
        axes.set_aspect("equal")
        axes.autoscale_view()
        size = " x ".join(f"{extent:.0f}" for extent in part.mesh.extents)
        axes.set_title(f"{part.name}, {size} mm")
    return figure


def faces_of(part: PrintedPart) -> PolyCollection:
    """The faces that are seen, the nearest last: parallel light and projection."""
    toward = VIEW / np.linalg.norm(VIEW)
    right = np.cross([0.0, 0.0, 1.0], toward)
    right /= np.linalg.norm(right)
    normals = np.asarray(part.mesh.face_normals)
    corners = np.asarray(part.mesh.triangles, dtype=float) @ np.stack([right, np.cross(toward, right), toward]).T
    seen = np.flatnonzero(normals @ toward > 1e-9)
    seen = seen[np.argsort(corners[seen, :, 2].mean(axis=1))]
    shade = 0.35 + 0.65 * np.clip(normals[seen] @ LIGHT, 0.0, 1.0)
    return PolyCollection(corners[seen, :, :2], color=shade[:, None] * SOLID, linewidth=0.3)
