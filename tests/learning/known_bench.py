"""A round rod whose section was measured, on a bench: weights hung on its tip, and poses as a ruler reads them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.section import relative_moment, second_moment
from onebend.beam.stiffness import Polyline
from onebend.learning.posterior import Posterior, fit
from onebend.recording.folder import read_recording
from onebend.recording.poses import pose_observations
from onebend.records import Array, Observations, StatedSection
from tests.learning.bench import IDEAL

LENGTH, MODULUS = 0.5, 3e9  # m, Pa
S = np.array([0.0, 0.25, 0.3, 0.6, 0.6, 1.0])  # a cone, a steep one, a cylinder, a step, a cone
DIAMETER = np.array([0.006, 0.0055, 0.004, 0.004, 0.005, 0.003])
WEIGHTS = np.array([0.0, 0.2, 0.5, 0.8, 1.1])  # N
PLACES = np.array([0.2, 0.4, 0.55, 0.7, 0.85, 1.0])
READING = 3e-4  # m, one sd


def one_everywhere(s: Array) -> Array:
    return np.ones(np.shape(s))


def rod(diameter: Array = DIAMETER, varies: Callable[[Array], Array] = one_everywhere) -> Beam:
    """Of this section, its modulus `MODULUS` times `varies`."""
    made = StatedSection("circle", S, diameter, diameter)
    shape = relative_moment(made)
    s = np.array(shape.s)
    k = MODULUS / LENGTH * second_moment(made, s)[0] * varies(s)
    before = np.flatnonzero(np.diff(s) == 0.0)  # the first of two values of a step
    k[before] = k[before + 1] * np.exp(np.array(shape.values)[before] - np.array(shape.values)[before + 1])
    return Beam(LENGTH, Polyline(shape.s, tuple(k.tolist()), shape.jumps))


def read(folder: Path, beam: Beam, entries: str, *, diameter: Array = DIAMETER, seed: int = 0) -> Observations:
    """What a bench says of a beam; [beam] has these `entries`, section.csv this diameter."""
    folder.mkdir()
    down = np.stack([np.zeros(len(WEIGHTS)), -WEIGHTS], axis=1)
    y = beam.equilibrium(down).xy(PLACES)[..., 1]
    y = y + READING * np.random.default_rng(seed).normal(size=y.shape)
    points = [f"{p},{i + 1},{y[p, i]}" for p in range(len(WEIGHTS)) for i in range(len(PLACES))]
    tables = {
        "poses.csv": ["pose,id,y_m", *points],
        "loads.csv": ["pose,s,weight_N", *(f"{p},1,{w}" for p, w in enumerate(WEIGHTS))],
        "section.csv": ["s,diameter_m", *(f"{s},{d}" for s, d in zip(S, diameter, strict=True))],
    }
    for name, rows in tables.items():
        (folder / name).write_text("\n".join(rows) + "\n", encoding="utf-8")
    tags = "".join(f"[[tags.on_beam]]\nid = {i + 1}\ns = {s}\n" for i, s in enumerate(PLACES))
    (folder / "recording.toml").write_text(
        f'format = 1\n[beam]\nlength_m = {LENGTH}\nrest = "straight"\n{entries}\n[tags]\nplacement_sd_m = 0\n{tags}'
        f'[poses]\nfile = "poses.csv"\nloads = "loads.csv"\nsd_m = {READING}\n'
        "[gravity]\ndirection_deg = -90\nbase_angle_deg = 0\nmagnitude_m_s2 = 0\n",
        encoding="utf-8",
    )
    return pose_observations(read_recording(folder))


def learned(o: Observations) -> Posterior:
    return fit([o], settings=IDEAL)
