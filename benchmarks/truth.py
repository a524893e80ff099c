"""What is true in a development recording. Read by benchmarks only; no program under test may."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from onebend.records import Array, IntArray, Observations

RECORDINGS = Path(__file__).parents[2] / "shared" / "recordings"


def parser_of(about: str | None) -> argparse.ArgumentParser:
    """A benchmark's options, with the folder of the recordings; `about`: the benchmark's docstring."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    says = "folder of recordings, each with its truth beside it"
    parser.add_argument("--recordings", type=Path, default=RECORDINGS, metavar="DIR", help=says)
    return parser


def recordings_asked(about: str | None) -> Path:
    """The folder of the recordings, for a benchmark that takes nothing else."""
    return Path(parser_of(about).parse_args().recordings)


@dataclass(frozen=True)
class Truth:
    """The contents of `truth/`; lengths T (video frames), N (log rows), m + 1 tags with the base tag first."""

    s: Array  # (401,)
    k: Array  # (401,) N m
    time: Array  # (T,) s, video clock
    force: Array  # (T, 2) N on the beam, clamp's frame
    base: Array  # (T,) rad
    tag_id: IntArray
    tags: Array  # (T, m + 1, 3) x, y, angle in the room
    log_time: Array  # (N,) s; empty without a force log
    log_force: Array  # (N, 2) N
    facts: dict[str, Any]  # truth.json


def read_truth(folder: Path) -> Truth:
    """The truth beside a recording."""
    data = np.load(folder / "truth" / "truth.npz")
    facts = json.loads((folder / "truth" / "truth.json").read_text(encoding="utf-8"))
    return Truth(
        s=data["s"],
        k=data["k"],
        time=data["t_frame"],
        force=data["F"],
        base=data["base"],
        tag_id=data["tag_id"].astype(np.int64),
        tags=data["tag_xya"],
        log_time=data["log_t"] if "log_t" in data else np.zeros(0),
        log_force=data["log_F"] if "log_F" in data else np.zeros((0, 2)),
        facts=facts,
    )


def stiffness_error(k: Array, truth: Truth) -> float:
    """Relative RMS error of `k` (401,) over s in [0.05, 0.9]."""
    inside = (truth.s >= 0.05) & (truth.s <= 0.9)
    return float(np.sqrt(np.mean((k[inside] / truth.k[inside] - 1.0) ** 2)))


def perfect(observations: Observations, truth: Truth) -> Observations:
    """The same frames with the true tags and the true force: what is left is the estimator's own error."""
    frame = observations.frame
    order = [int(np.flatnonzero(truth.tag_id == i)[0]) for i in observations.tag_id]
    away = truth.tags[frame][:, order, :2] - truth.tags[frame][:, :1, :2]
    cos, sin = np.cos(truth.base[frame])[:, None], np.sin(truth.base[frame])[:, None]
    xy = np.stack([cos * away[..., 0] + sin * away[..., 1], -sin * away[..., 0] + cos * away[..., 1]], axis=-1)
    angle = truth.tags[frame][:, order, 2] - truth.base[frame][:, None]
    free = ~observations.loaded
    at_rest = free & (frame < np.flatnonzero(observations.loaded)[0]) if observations.loaded.any() else free
    return replace(
        observations,
        xy=xy,
        angle=angle,
        force=truth.force[frame],
        rest_xy=np.mean(xy[at_rest], axis=0),
        rest_angle=np.mean(angle[at_rest], axis=0),
    )
