"""Solids of the parts to print, in mm: prisms, cylinders, bodies between two outlines; their check and their files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from onebend.errors import MechanicsError
from onebend.extras import package
from onebend.records import Array

if TYPE_CHECKING:  # an optional package
    from manifold3d import Manifold

FACETS = 48  # of a cylinder
MESH_SUFFIXES = (".stl", ".3mf")


def nothing() -> Manifold:
    """The empty solid, to add others to."""
    return _manifold3d().Manifold()


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Manifold:
    """The box between two opposite corners."""
    size = tuple(b - a for a, b in zip(low, high, strict=True))
    return _manifold3d().Manifold.cube(size).translate(low)


def upright(x: float, y: float, low: float, high: float, diameter: float) -> Manifold:
    """A cylinder along z."""
    return _cylinder(high - low, diameter).translate((x, y, low))


def across(x: float, z: float, low: float, high: float, diameter: float) -> Manifold:
    """A cylinder along y."""
    return _cylinder(high - low, diameter).rotate((-90.0, 0.0, 0.0)).translate((x, low, z))


def strip(lower: Array, upper: Array, bottom: float, top: float) -> Manifold:
    """A body that is symmetric about y = 0: stations (n, 2) of x and half width at its bottom and at its top.

    Raises:
        MechanicsError: stations whose x does not rise, or a width that is not positive.
    """
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
    """The surface of a solid as a `trimesh.Trimesh`, checked.

    Raises:
        MechanicsError: the solid is empty or its surface is not watertight.
    """
    found = solid.to_mesh64()
    mesh = package("trimesh", "make").Trimesh(
        np.asarray(found.vert_properties)[:, :3], np.asarray(found.tri_verts, dtype=np.int64), process=False
    )
    if not (mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0):
        raise MechanicsError("a part's surface is not watertight: take a thicker wall or less draft")
    return mesh


def write_mesh(path: Path, mesh: Any) -> None:
    """Write a `trimesh.Trimesh` as STL or 3MF, in mm.

    Raises:
        MechanicsError: a file name that ends in neither.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise MechanicsError(f"{path}: parts are written as {' or '.join(MESH_SUFFIXES)}. Name the file so.")
    mesh.units = "mm"
    data = mesh.export(file_type=path.suffix.lower()[1:])
    path.write_bytes(data if isinstance(data, bytes) else str(data).encode())


def _cylinder(height: float, diameter: float) -> Manifold:
    return _manifold3d().Manifold.cylinder(height, 0.5 * diameter, circular_segments=FACETS)


def _manifold3d() -> Any:
    return package("manifold3d", "make")
