"""Folders of marker tracks and bench poses, as a lab would leave them, of beams whose stiffness is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.stiffness import Table, Uniform
from onebend.records import Array, BoolArray
from tests.made_up import LENGTH
from tests.recording.pushed import Pushed

PUSHED = Pushed()
START = 249.4  # s, as written down; Pushed.offset is the truth


def turned_plane(seed: int = 1) -> Array:
    """(3, 3) right-handed axes somewhere in space, the third the plane's normal."""
    axes = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return np.asarray(axes * np.array([1.0, 1.0, np.linalg.det(axes)]))


def write_log(folder: Path, pushed: Pushed = PUSHED) -> None:
    log = pushed.log()
    rows = np.column_stack([log.time, log.force])
    np.savetxt(folder / "force.csv", rows, fmt="%.6f", delimiter=",", header="time_s,fx_N,fy_N", comments="")


def track_folder(
    folder: Path,
    *,
    base: bool = True,
    axes: Array | None = None,
    out_of_plane: float = 2e-4,
    angles: bool = False,
    markers: str = "",
    force: bool = True,
    unit: float = 1.0,
    keep: BoolArray | None = None,
    base_way: Array | None = None,
) -> Path:
    """The push of `PUSHED` as tracks, in a plane turned by 0.4 rad or (`axes`) in space; `keep` (T, m) hides points.

    `base_way` (T, 3): m, m, rad by which the whole bench is moved while it is tracked.
    """
    folder.mkdir(exist_ok=True)
    seen = PUSHED.markers()
    count = len(seen.time)
    points = np.concatenate([np.zeros((count, 1, 2)), np.tile([-0.03, 0.02], (count, 1, 1)), seen.xy], axis=1)
    way = np.zeros((count, 3)) if base_way is None else base_way
    turn = way[:, 2] + 0.4
    rotation = np.stack([np.cos(turn), -np.sin(turn), np.sin(turn), np.cos(turn)], axis=1).reshape(-1, 2, 2)
    xy = np.einsum("tab,tmb->tma", rotation, points) + np.array([0.3, 0.2]) + way[:, None, :2]
    columns = ["x_m", "y_m"]
    if axes is not None:
        xy = _in_space(xy, axes, out_of_plane)
        columns.append("z_m")
    lines = [",".join(["time_s", "id", *columns, *(["angle_rad"] if angles else [])])]
    for t in range(count):
        for i, marker in enumerate((0, 9, 1, 2, 3)):
            hidden = keep is not None and i > 1 and not keep[t, i - 2]
            if not hidden and (base or i > 1):
                cells = [f"{seen.time[t]:.6f}", str(marker), *(f"{unit * v:.8f}" for v in xy[t, i])]
                turns = [f"{(seen.angle[t, i - 2] if i > 1 else 0.0) + turn[t]:.6f}"] if angles else []
                lines.append(",".join([*cells, *turns]))
    (folder / "markers.csv").write_text("\n".join(lines) + "\n")
    if force:
        write_log(folder)
    _write_entries(folder, base=base, force=force, markers=markers)
    return folder


def _in_space(xy: Array, axes: Array, out_of_plane: float) -> Array:
    """(T, m, 3) the tracks off their plane by each marker's height and by noise."""
    height = np.array([0.0, 0.004, -0.003, 0.002, 0.004])
    height = out_of_plane * np.random.default_rng(2).normal(size=xy.shape[:2]) + height
    return np.asarray(np.concatenate([xy, height[..., None]], axis=-1) @ axes.T)


def _write_entries(folder: Path, *, base: bool, force: bool, markers: str) -> None:
    tags = "".join(f"[[tags.on_beam]]\nid = {i}\ns = {i / 3}\n" for i in (1, 2, 3))
    if base:
        tags = "[[tags.on_base]]\nid = 0\ns = 0.0\n[[tags.on_base]]\nid = 9\ns = 0.0\n" + tags
    log = '[force]\nfile = "force.csv"\n[push]\nat_s = 1.0\n' if force else ""
    (folder / "recording.toml").write_text(
        f"format = 1\n[beam]\nlength_m = {LENGTH}\n[tags]\nplacement_sd_m = 0.0005\n{tags}"
        f'[markers]\nfile = "markers.csv"\nstart_s = {START}\n{markers}{log}'
    )


ROD = Beam(0.5, Table((0.0, 0.5, 1.0), (0.4, 0.2, 0.08)), mass_per_length=Uniform(0.06))  # 30 g
ROD_S = np.array([0.2, 0.4, 0.6, 0.8, 1.0])


def pose_folder(
    folder: Path,
    *,
    loads: str,
    shown: Array,
    beam: str = "",
    poses: str = 'axes = "room"\n',
    gravity: str = "[gravity]\ndirection_deg = -90\nbase_angle_deg = 0\n",
    columns: tuple[str, ...] = ("x_m", "y_m"),
    more: str = "",
) -> Path:
    """Points `shown` (P, 5, len(columns)) of `ROD` under the rows of `loads`; poses are called 0, 1, 2..."""
    folder.mkdir(exist_ok=True)
    rows = [",".join(["pose", "id", *columns])]
    for p, pose in enumerate(shown):
        for i, point in enumerate(pose):
            if np.isfinite(point).any():
                cells = ["" if np.isnan(v) else f"{v:.9f}" for v in point]
                rows.append(",".join([str(p), str(i + 1), *cells]))
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    (folder / "loads.csv").write_text(loads)
    tags = "".join(f"[[tags.on_beam]]\nid = {i + 1}\ns = {s}\n" for i, s in enumerate(ROD_S))
    (folder / "recording.toml").write_text(
        f"format = 1\n[beam]\nlength_m = {ROD.length}\n{beam}[tags]\n{tags}"
        f'[poses]\nfile = "poses.csv"\nloads = "loads.csv"\n{poses}{gravity}{more}'
    )
    return folder
