"""Pictures of designs and of the parts to print."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from onebend.beam.profiles.uncertain import half_width
from onebend.escaping import figure_text
from onebend.lab.designs import Design
from onebend.lab.fabrication.mould import PrintedPart
from onebend.records import Array
from onebend.report.figures.style import BLUE, INK, blank, styled

MM = 1e3
S = np.linspace(0.0, 1.0, 401)
PIXELS = 420  # of a part's longer side
VIEW = np.array([-0.45, -0.62, 0.64])  # towards the eye
LIGHT = np.array([-0.2, -0.55, 0.81])


@styled
def design_figure(design: Design) -> Figure:
    """The outline that is cast, to scale, and k(s) with the band that the modulus leaves."""
    figure, (outline, stiffness) = blank(4.2, rows=2, height_ratios=(1.0, 2.2))
    x, half = MM * design.length * S, 0.5 * MM * np.asarray(design.width(S))
    outline.fill_between(x, -half, half, color=BLUE, alpha=0.25, linewidth=0.0)
    outline.plot(x, half, color=BLUE)
    outline.plot(x, -half, color=BLUE)
    outline.set_aspect("equal")
    outline.set_xlabel("along the beam [mm]")
    outline.set_ylabel("across [mm]")
    outline.set_title(f"{figure_text(design.name)}: {MM * design.length:g} mm long, {MM * design.depth:g} mm deep")
    k = np.asarray(design.along.stiffness(S))
    stiffness.plot(S, k, color=INK)
    if design.modulus_log_sd > 0.0:
        wide = np.exp(half_width(design.modulus_log_sd))
        stiffness.fill_between(S, k / wide, k * wide, color=INK, alpha=0.15, linewidth=0.0, label="95 %, modulus alone")
        stiffness.legend()
    stiffness.set_xlim(0.0, 1.0)
    stiffness.set_ylim(bottom=0.0)
    stiffness.set_xlabel("place along the beam s")
    stiffness.set_ylabel("k [N m]")
    stiffness.set_title(f"E = {design.modulus / 1e6:.3g} MPa ({figure_text(design.source)})")
    return figure


@styled
def parts_figure(parts: Sequence[PrintedPart]) -> Figure:
    """Every part of a set, seen from above at an angle, each on its own scale."""
    rows = (len(parts) + 1) // 2
    figure, places = blank(2.6 * rows, rows, 2)
    for axes in places:
        axes.set_axis_off()
    for part, axes in zip(parts, places, strict=False):
        axes.imshow(rendered(part), interpolation="antialiased")
        size = " x ".join(f"{extent:.0f}" for extent in part.mesh.extents)
        axes.set_title(f"{part.name}, {size} mm")
    return figure


def rendered(part: PrintedPart, pixels: int = PIXELS) -> NDArray[np.uint8]:
    """(H, W, 3) the part by parallel light and projection, the nearest surface in each pixel."""
    right = np.cross([0.0, 0.0, 1.0], VIEW)
    right /= np.linalg.norm(right)
    toward = VIEW / np.linalg.norm(VIEW)
    up = np.cross(toward, right)
    corners = np.asarray(part.mesh.triangles, dtype=float) @ np.stack([right, up, toward]).T
    low, high = corners.reshape(-1, 3).min(axis=0), corners.reshape(-1, 3).max(axis=0)
    scale = (pixels - 4) / float(np.max((high - low)[:2]))
    flat = (corners - low) * scale + 2.0
    size = np.ceil((high - low)[:2] * scale).astype(int) + 4
    shade = 0.35 + 0.65 * np.clip(np.asarray(part.mesh.face_normals) @ LIGHT, 0.0, 1.0)
    facing = np.asarray(part.mesh.face_normals) @ toward > 1e-9
    depth = np.full((size[1], size[0]), -np.inf)
    level = np.ones((size[1], size[0]))
    for triangle, grey in zip(flat[facing], shade[facing], strict=True):
        _fill(triangle, float(grey), depth, level)
    colours = level[::-1, :, None] * np.where(np.isfinite(depth[::-1, :, None]), [0.80, 0.87, 1.0], 1.0)
    return np.asarray(255.0 * colours, dtype=np.uint8)


def _fill(triangle: Array, grey: float, depth: Array, level: Array) -> None:
    """Draw one triangle (3, 3) where it is nearer than what is drawn."""
    (x0, y0), (x1, y1) = np.floor(triangle[:, :2].min(axis=0)), np.ceil(triangle[:, :2].max(axis=0))
    rows, columns = slice(int(y0), int(y1) + 1), slice(int(x0), int(x1) + 1)
    x, y = np.arange(columns.start, columns.stop), np.arange(rows.start, rows.stop)[:, None]
    edges = triangle[1:] - triangle[0]
    area = edges[0, 0] * edges[1, 1] - edges[0, 1] * edges[1, 0]
    if area == 0.0:
        return
    dx, dy = x - triangle[0, 0], y - triangle[0, 1]
    u = (dx * edges[1, 1] - dy * edges[1, 0]) / area
    v = (dy * edges[0, 0] - dx * edges[0, 1]) / area
    z = triangle[0, 2] + u * edges[0, 2] + v * edges[1, 2]
    inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9)
    shown = inside & (z > depth[rows, columns])
    depth[rows, columns] = np.where(shown, z, depth[rows, columns])
    level[rows, columns] = np.where(shown, grey, level[rows, columns])
