"""The truth beside a filmed recording: `truth.npz` and `truth.json`."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from onebend.lab.effects.real_bench import rest_curvature
from onebend.lab.effects.rod_march import RodMotion
from onebend.lab.filming.film_setup import Filming
from onebend.lab.filming.moments import Moments
from onebend.lab.filming.movement import PLACES
from onebend.lab.virtual import true_stiffness
from onebend.records import Array, ForceLog, View
from onebend.strict_json import plain

S = np.linspace(0.0, 1.0, 401)
MEANING = (
    "k: EI/L as a static model finds it at best = k_instant x secant_modulus; k_instant: before anything relaxes, with "
    "the tags' patches; k_bare: without patches. F: on the beam, in the clamp's frame, s_a its place; tag_xya, "
    "tag_xyaz: in the room (clamp's frame turned by base), z towards the camera; tag_tilts: rad, of the face about the "
    "beam's direction and upwards along it; camera_px: shift of the picture. All these as the first row of a frame is "
    "exposed. log_F: without error, in the log's axes and with its sign"
)


@dataclass(frozen=True)
class FilmTruth:
    """What was filmed, as it truly was."""

    filming: Filming
    shown: Moments  # at the frames, as their first rows are exposed
    motion: RodMotion | None
    moved: Array  # (T, 2) px, of the camera's picture
    view: View
    log: ForceLog  # as written
    clean: ForceLog  # the same without any error of the sensor
    seed: int


def write_truth(folder: Path, made: FilmTruth) -> None:
    """Write both files into `folder`, which is made; they are to compare with, nothing that learns reads them."""
    folder.mkdir(parents=True, exist_ok=True)
    filming, shapes = made.filming, made.shown.shapes
    beam = filming.bench.beam
    truth = true_stiffness(filming.bench, made.motion, S)
    np.savez_compressed(
        folder / "truth.npz",
        s=S,
        k=truth.k,
        k_instant=truth.k_instant,
        k_bare=truth.k_bare,
        EI=truth.k * beam.length,
        width=np.asarray(filming.width(S)),
        rhoA=np.asarray(beam.mass_per_length(S)),
        kappa0=rest_curvature(beam, filming.bench.effects, S) / beam.length,
        t_frame=shapes.time,
        s_shape=PLACES,
        x=shapes.xy[..., 0],
        y=shapes.xy[..., 1],
        alpha=shapes.angle,
        F=shapes.force,
        s_a=made.shown.contact,
        z=made.shown.beam[..., 3],
        camera_px=made.moved,
        base=np.full(len(shapes.time), filming.base_angle),
        tag_id=np.array([0, *(tag.id for tag in filming.bench.tags)], dtype=np.int64),
        tag_xya=made.shown.tags[..., :3],
        tag_xyaz=made.shown.tags[..., :4],
        tag_tilts=made.shown.tags[..., 4:],
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
        "tip_angle_max_deg": float(np.degrees(np.max(np.abs(made.shown.shapes.angle[:, -1])))),
        "force_max_N": float(np.max(np.linalg.norm(made.shown.shapes.force, axis=1))),
        "effects": asdict(bench.effects),
        "secant_modulus": 1.0 if made.motion is None else made.motion.secant,
        "meaning": MEANING,
    }
