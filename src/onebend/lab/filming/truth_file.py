"""The truth beside a filmed recording: `truth.npz` and `truth.json`."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from onebend.lab.filming.film_setup import Filming
from onebend.lab.filming.movement import PLACES, BeamShapes
from onebend.records import Array, ForceLog, View
from onebend.strict_json import plain

S = np.linspace(0.0, 1.0, 401)


@dataclass(frozen=True)
class FilmTruth:
    """What was filmed, as it truly was."""

    filming: Filming
    shapes: BeamShapes  # at the frames, clamp's frame
    tags: Array  # (T, m + 1, 3) in the room, the base tag first
    view: View
    log: ForceLog  # as written
    clean: ForceLog  # the same without any error of the sensor
    seed: int


def write_truth(folder: Path, made: FilmTruth) -> None:
    """Write both files into `folder`, which is made; they are to compare with, nothing that learns reads them."""
    folder.mkdir(parents=True, exist_ok=True)
    filming, shapes = made.filming, made.shapes
    beam = filming.bench.beam
    k = np.asarray(beam.stiffness(S))
    np.savez_compressed(
        folder / "truth.npz",
        s=S,
        k=k,
        EI=k * beam.length,
        width=np.asarray(filming.width(S)),
        rhoA=np.asarray(beam.mass_per_length(S)),
        kappa0=np.asarray(beam.rest_curvature(S)) / beam.length,
        t_frame=shapes.time,
        s_shape=PLACES,
        x=shapes.xy[..., 0],
        y=shapes.xy[..., 1],
        alpha=shapes.angle,
        F=shapes.force,
        base=np.full(len(shapes.time), filming.base_angle),
        tag_id=np.array([0, *(tag.id for tag in filming.bench.tags)], dtype=np.int64),
        tag_xya=made.tags,
        log_t=made.log.time,
        log_F=made.clean.force,
    )
    text = json.dumps(plain(facts_of(made)), indent=1, allow_nan=False)
    (folder / "truth.json").write_text(text + "\n", encoding="utf-8")


def facts_of(made: FilmTruth) -> dict[str, Any]:
    """What stands in `truth.json`."""
    filming, view = made.filming, made.view
    bench = filming.bench
    clock = bench.clock
    return {
        "beam": bench.name,
        "L": bench.beam.length,
        "seed": made.seed,
        "physics": "equation of motion" if filming.swings else "statics",
        "eta": filming.damping,
        "s_a": bench.push.at_s,
        "clock": {
            "log_minus_video_true": clock.offset,
            "said": clock.declared,
            "error_said_minus_true": clock.declared - clock.offset,
        },
        "camera": {
            "K": view.matrix.tolist(),
            "dist": view.dist.tolist(),
            "R": view.rotation.tolist(),
            "t": view.translation.tolist(),
            "C": (-view.rotation.T @ view.translation).tolist(),
            "calibrated_for_user": filming.calibrated,
        },
        "scene": asdict(filming.scene),
        "push": {**asdict(bench.push), "contact": bench.push.contact},
        "tags": {
            "base": list(bench.base),
            "on_beam": [asdict(tag) for tag in bench.tags],
            "size": filming.tag_size,
        },
        "force": {
            **asdict(bench.sensor),
            "rotation": filming.log_rotation,
            "reaction": filming.log_of_robot,
        },
        "gravity": {"magnitude": filming.gravity, "base_angle": filming.base_angle},
        "tip_angle_max_deg": float(np.degrees(np.max(np.abs(made.shapes.angle[:, -1])))),
        "force_max_N": float(np.max(np.linalg.norm(made.shapes.force, axis=1))),
        "meaning": "F: on the beam, in the clamp's frame; tag_xya: in the room (clamp's frame turned by base); "
        "log_F: without error, in the log's axes and with its sign",
    }
