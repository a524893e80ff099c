"""Folders of a cable on a turned base, as somebody would leave them who read points off a chain that hangs there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from onebend.records import Array
from tests.beam.turned_chain import Cable, Chain

S = np.linspace(0.1, 1.0, 10)  # of the points
POSES = 'axes = "room"\n'


def ways(cable: Cable, degrees: Sequence[float], links: int = 800) -> tuple[Array, Array]:
    """(N, m, 2) m, the points on the way up through these angles and on the way back."""
    chain = Chain(cable, links)
    up = chain.turned(degrees)
    back = chain.turned(degrees[::-1], up[-1])[::-1]
    return chain.points(up, S), chain.points(back, S)


def turned_folder(
    folder: Path,
    cable: Cable,
    names: Sequence[str],
    degrees: Sequence[float],
    shown: Array,
    *,
    sd: float,
    more: dict[str, Sequence[object]] | None = None,
) -> Path:
    """Points `shown` (P, m, 2) [m] in the room; `more` are further columns of the table of loads, one cell a pose."""
    folder.mkdir(parents=True, exist_ok=True)
    more = more or {}
    loads = [",".join(["pose", "s", "mass_kg", "clamp_deg", *more])]
    rows = ["pose,id,x_m,y_m"]
    for i, (name, angle) in enumerate(zip(names, degrees, strict=True)):
        hung = ["1", str(cable.tip)] if cable.tip else ["", ""]
        loads.append(",".join([name, *hung, str(angle), *(str(column[i]) for column in more.values())]))
        rows += [f"{name},{tag},{x:.6f},{y:.6f}" for tag, (x, y) in enumerate(shown[i], start=1) if np.isfinite(x)]
    (folder / "loads.csv").write_text("\n".join(loads) + "\n")
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    tags = "".join(f"[[tags.on_beam]]\nid = {i}\ns = {s:.6f}\n" for i, s in enumerate(S, start=1))
    (folder / "recording.toml").write_text(
        f"format = 1\n[beam]\nlength_m = {cable.length}\nmass_kg = {cable.line * cable.length}\n"
        f'mass_along = "even"\nrest = "straight"\n[tags]\nplacement_sd_m = 0.0005\n{tags}'
        f'[poses]\nfile = "poses.csv"\nloads = "loads.csv"\n{POSES}sd_m = {sd}\n[gravity]\ndirection_deg = -90\n'
    )
    return folder
