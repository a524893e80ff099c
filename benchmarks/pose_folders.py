"""Folders of bench poses from tables that others published, written as a user would write them."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from onebend.learning.posterior import Posterior
from onebend.pipeline import learn

DATA = Path(__file__).resolve().parents[2] / "shared" / "realdata"


def rows_of(name: str) -> list[dict[str, str]]:
    with (DATA / name).open(encoding="utf-8-sig", newline="") as stream:
        return list(csv.DictReader(stream))


def write_table(path: Path, header: str, rows: Iterable[Sequence[object]]) -> None:
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")


def write_toml(
    folder: Path,
    beam: str,
    places: Sequence[float],
    *,
    placement: float,
    poses: str = "",
    clamp_deg: float = 0.0,
    clamp_sd_deg: float = 1.0,
) -> Path:
    points = "".join(f"[[tags.on_beam]]\nid = {i}\ns = {s}\n" for i, s in enumerate(places, start=1))
    (folder / "recording.toml").write_text(
        f"format = 1\n[beam]\n{beam}[tags]\nplacement_sd_m = {placement}\n{points}"
        f'[poses]\nfile = "poses.csv"\nloads = "loads.csv"\naxes = "room"\nclamp_sd_deg = {clamp_sd_deg}\n{poses}'
        f"[gravity]\ndirection_deg = -90\nbase_angle_deg = {clamp_deg}\n"
    )
    return folder


def learned(folders: Sequence[Path]) -> Posterior:
    posterior = learn(*folders).posterior
    assert posterior is not None
    return posterior
