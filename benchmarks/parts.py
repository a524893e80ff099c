"""Parts to print: cavities against their designs, sheets of tags measured in their PDF."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pypdfium2
import trimesh
from manifold3d import Manifold, Mesh64
from pyapriltags import Detector

from onebend.lab.designs import DESIGNS, Design
from onebend.lab.fabrication import MouldSettings, carriers, clamp, mould, write_mesh
from onebend.lab.sheet import PAGES, Fill, Sheet, files_of, tag_pages
from onebend.records import Array

DPI = 600
PLACES = np.linspace(0.005, 0.995, 41)
HEIGHTS = (0.0213, 0.2537, 0.5039, 0.7471, 0.9787)  # of the depth, off the corners of triangles
SMOOTH = MouldSettings(tag_places=())


def read_back(mesh: trimesh.Trimesh, path: Path) -> trimesh.Trimesh:
    """The part as its file gives it: single precision, corners joined."""
    write_mesh(path, mesh)
    again = trimesh.load_mesh(path)
    again.merge_vertices()
    return again


def cavity(walls: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """What fills the space between the parts up to their upper face, from x = 0 on."""
    solid = Manifold()
    for one in walls:
        vertices = np.array(one.vertices, dtype=float, order="C")
        solid += Manifold(Mesh64(vert_properties=vertices, tri_verts=np.array(one.faces, np.uint64, order="C")))
    x0, y0, z0, x1, y1, z1 = solid.bounding_box()
    hollow = Manifold.cube((x1 - x0 - 1.0, y1 - y0 - 1.0, z1 - z0 - 1.0)).translate((x0 + 0.5, y0 + 0.5, z0 + 1.0))
    inside = max((hollow - solid).decompose(), key=lambda body: float(body.volume()))
    found = inside.trim_by_plane((1.0, 0.0, 0.0), 0.0).to_mesh64()
    return trimesh.Trimesh(np.asarray(found.vert_properties)[:, :3], np.asarray(found.tri_verts, dtype=np.int64))


def widths(mesh: trimesh.Trimesh, x: float, z: float) -> Array:
    """mm between the surfaces that a line along y at (x, z) meets."""
    section: Any = trimesh.intersections.mesh_plane  # trimesh declares no types for it
    lines = section(mesh, plane_normal=[1.0, 0.0, 0.0], plane_origin=[x, 0.0, 0.0])
    (y0, z0), (y1, z1) = lines[:, 0, 1:].T, lines[:, 1, 1:].T
    hit = (z0 <= z) != (z1 <= z)
    y = np.sort(y0[hit] + (z - z0[hit]) / (z1[hit] - z0[hit]) * (y1[hit] - y0[hit]))
    return np.asarray(np.diff(y))


def mould_row(design: Design, kind: str, folder: Path) -> str:
    """One design, one kind of mould, from its files."""
    made = mould(design, MouldSettings(kind=kind, tag_places=()))  # type: ignore[arg-type]
    parts = [read_back(part.mesh, folder / f"{part.name}.stl") for part in made.parts]
    others = [read_back(part.mesh, folder / f"{part.name}.stl") for part in clamp(design, SMOOTH)]
    others += [read_back(carriers(design).mesh, folder / "carriers.stl")]
    whole = all(part.is_watertight and part.is_winding_consistent for part in (*parts, *others))
    free = cavity(parts)
    off = 0.0
    for s in PLACES:
        for part in HEIGHTS:
            (width,) = widths(free, 1e3 * design.length * s, 1e3 * design.depth * part)
            off = max(off, abs(width - 1e3 * float(design.width(s))))
    wanted = 1e9 * design.mass / design.density
    length = abs(free.extents[0] - 1e3 * design.length)
    return (
        f"| {design.name} | {kind} | {off:.4f} | {length:.4f} | {100 * abs(free.volume / wanted - 1):.4f} "
        f"| {'yes' if whole else 'NO'} |"
    )


def sheet_row(page: str, size: float, family: str, folder: Path) -> str:
    """One sheet: corners found in the rendered PDF, outlines of its paths, against where they should be."""
    ids = tuple(range(12))
    (made,) = tag_pages(Sheet(ids, size, family, page=page))
    (content,) = files_of(folder / "t.pdf", [made], "t").values()
    document = pypdfium2.PdfDocument(content)
    image = np.ascontiguousarray(document[0].render(scale=DPI / 72, grayscale=True).to_numpy())
    boxes = [obj.get_bounds() for obj in document[0].get_objects()]
    document.close()
    detector = Detector(families=family, nthreads=1, quad_decimate=1.0)
    found = {one.tag_id: np.asarray(one.corners) * 25.4 / DPI for one in detector.detect(image)}
    corner_off, path_off = 0.0, 0.0
    fills = [mark for mark in made.marks if isinstance(mark, Fill)]
    for tag, fill in zip(ids, fills, strict=True):
        low, high = fill.polygons.reshape(-1, 2).min(axis=0), fill.polygons.reshape(-1, 2).max(axis=0)
        wanted = [[low[0], high[1]], [high[0], high[1]], [high[0], low[1]], [low[0], low[1]]]
        corner_off = max(corner_off, float(np.max(np.abs(found[tag] - wanted))))
        bounds = np.array([low[0], made.height - high[1], high[0], made.height - low[1]])
        path_off = max(path_off, min(float(np.max(np.abs(np.array(box) * 25.4 / 72 - bounds))) for box in boxes))
    return f"| {page} | {family} | {1e3 * size:g} | {len(found)} of {len(ids)} | {path_off:.4f} | {corner_off:.4f} |"


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print("Moulds, read back from their STL files; asked: <= 0.1 mm, all parts watertight.\n")
        print("| design | mould | width off [mm] | length off [mm] | volume off [%] | all parts watertight |")
        print("| --- | --- | --- | --- | --- | --- |")
        for design in DESIGNS.values():
            for kind in ("open", "halves"):
                print(mould_row(design, kind, folder))
        print(f"\nSheets, from their PDF; asked: <= 0.05 mm. Corners are the detector's, in the page at {DPI} dpi.\n")
        print("| page | family | size [mm] | found, upright | outlines off [mm] | detected corners off [mm] |")
        print("| --- | --- | --- | --- | --- | --- |")
        for page in PAGES:
            for family, size in (("tag36h11", 0.012), ("tag36h11", 0.03), ("tag25h9", 0.012), ("tag16h5", 0.02)):
                print(sheet_row(page, size, family, folder))


if __name__ == "__main__":
    main()
