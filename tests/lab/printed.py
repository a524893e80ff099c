"""Measuring what was made: tags in a rendered page, widths in a mesh."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pypdfium2
import trimesh
from pyapriltags import Detector

from onebend.records import Array

DPI = 600
PX = 25.4 / DPI  # mm


@cache
def detector(family: str) -> Detector:
    return Detector(families=family, nthreads=1, quad_decimate=1.0, refine_edges=1)


def page_image(pdf: bytes, page: int = 0) -> np.ndarray:
    """(H, W) grey levels of a page at `DPI`."""
    document = pypdfium2.PdfDocument(pdf)
    try:
        return np.ascontiguousarray(document[page].render(scale=DPI / 72.0, grayscale=True).to_numpy())
    finally:
        document.close()


def tags_in(image: np.ndarray, family: str = "tag36h11") -> dict[int, Array]:
    """Corners (4, 2) mm from the page's upper left, by id."""
    found = detector(family).detect(image)
    assert len({one.tag_id for one in found}) == len(found)
    return {one.tag_id: np.asarray(one.corners) * PX for one in found}


def black_run(image: np.ndarray, row: float, start: float, end: float) -> tuple[float, float]:
    """mm, where the dark first begins and last ends in a row of the page between `start` and `end` mm."""
    level = image[round(row / PX), round(start / PX) : round(end / PX)] < 128
    dark = np.flatnonzero(level)
    return start + float(dark[0]) * PX, start + float(dark[-1] + 1) * PX


def width_at(mesh: trimesh.Trimesh, x: float, z: float) -> Array:
    """Sorted y [mm] where a line along y at (x, z) goes through the surface."""
    section: Any = trimesh.intersections.mesh_plane  # trimesh declares no types for it
    lines = section(mesh, plane_normal=[1.0, 0.0, 0.0], plane_origin=[x, 0.0, 0.0])
    (y0, z0), (y1, z1) = lines[:, 0, 1:].T, lines[:, 1, 1:].T
    crossing = (z0 <= z) != (z1 <= z)
    share = (z - z0[crossing]) / (z1[crossing] - z0[crossing])
    found: Array = np.sort(y0[crossing] + share * (y1[crossing] - y0[crossing]))
    return found
