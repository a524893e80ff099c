"""Hanging wires that others photographed: both ends clamped, one of them by an unknown force and moment."""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from onebend.beam.profiles.uncertain import half_width
from onebend.learning.posterior import Posterior
from onebend.learning.verdict import fitted_rms
from onebend.pipeline import learn

LENGTH = 1.5  # m
LINES = {"black": 0.081 / 2.98, "red": 0.043 / 2.0, "white": 0.087 / 5.0}  # kg/m, weighed
PUBLISHED = {"black": 1.20e-3, "red": 9.3e-4, "white": 1.22e-4}  # N m^2
EVERY = 10  # nodes from one point to the next: what a hand draws wrong is alike over shorter ways
EVERYBODY = "01234"
CLAMP_SD = 15.0  # deg: nobody says how the clamps are turned; the pictures show them about level


def wire_folder(folder: Path, table: Path, wire: str, digitisations: Iterable[str]) -> Path:
    """One recording: the digitisations of the photo as its poses."""
    folder.mkdir()
    with table.open(encoding="utf-8-sig", newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["wire"] == wire]
    nodes = sorted({int(row["node"]) for row in rows})
    chosen = [n for n in nodes if n > 0 and (n % EVERY == 0 or n == nodes[-1])]
    wanted = sorted(digitisations)
    loads = ["pose,s,fx_N,fy_N,moment_N_m", *(f"{d},1,unknown,unknown,unknown" for d in wanted)]
    points = ["pose,id,x_m,y_m"] + [
        f"{r['digitisation']},{r['node']},{r['x_m']},{-float(r['y_m_down'])}"
        for r in rows
        if int(r["node"]) in chosen and r["digitisation"] in wanted
    ]
    (folder / "loads.csv").write_text("\n".join(loads) + "\n")
    (folder / "poses.csv").write_text("\n".join(points) + "\n")
    tags = "".join(f"[[tags.on_beam]]\nid = {n}\ns = {n / nodes[-1]}\n" for n in chosen)
    (folder / "recording.toml").write_text(
        f"format = 1\n[beam]\nlength_m = {LENGTH}\nmass_kg = {LENGTH * LINES[wire]}\n"
        'mass_along = "even"\nstiffness_along = "even"\n'
        f"[tags]\nplacement_sd_m = 0.002\n{tags}"
        f'[poses]\nfile = "poses.csv"\nloads = "loads.csv"\naxes = "room"\nclamp_sd_deg = {CLAMP_SD}\n'
        "[gravity]\ndirection_deg = -90\nbase_angle_deg = 0\n"
    )
    return folder


def bending(posterior: Posterior) -> tuple[float, float, float]:
    """N m^2: geometric mean of EI along the wire, and its 95 % band."""
    uncertain, s = posterior.stiffness, np.linspace(0.0, 1.0, 201)
    row = uncertain.basis(s).mean(axis=0)
    sd = float(np.sqrt(row @ uncertain.covariance @ row))
    middle = LENGTH * float(np.exp(row @ uncertain.mean))
    factor = float(np.exp(half_width(sd)))
    return middle, middle / factor, middle * factor


def learned(table: Path, wire: str, digitisations: Iterable[str]) -> Posterior:
    with tempfile.TemporaryDirectory() as place:
        posterior = learn(wire_folder(Path(place) / wire, table, wire, digitisations)).posterior
    assert posterior is not None
    return posterior


def wires(table: Path) -> None:
    """One row a wire: from the five digitisations together, and the spread of the five apart."""
    print("\n**Hanging wires** (qj25/adapteddlo_muj): 1.5 m between two clamps, photographed, each photo digitised")
    print("five times by hand; weight known, clamps level to within 15 deg (one sd), the far end's force and moment")
    print("unknown. One EI a wire is stated. What a hand draws wrong is alike over 0.2 m of wire: every tenth node")
    print("is a point.\n")
    print("| wire | published EI [N m^2] | learned | off [%] | 95 % band | five apart | fit's RMS [mm] |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for wire, known in PUBLISHED.items():
        together = learned(table, wire, EVERYBODY)
        ei, low, high = bending(together)
        apart = [bending(learned(table, wire, one))[0] for one in EVERYBODY]
        rms = 1000 * np.sqrt(np.nanmean(fitted_rms(together)[0] ** 2))
        print(
            f"| {wire} | {known:.3g} | {ei:.3g} | {100 * (ei / known - 1):+.0f} | {low:.3g} to {high:.3g} | "
            f"{min(apart):.3g} to {max(apart):.3g} | {rms:.1f} |"
        )
