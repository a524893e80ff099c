"""A virtual recording as a folder of marker tracks: as a motion capture would leave it, with the truth beside it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from onebend.errors import RecordingError
from onebend.lab.filming.film_setup import Filming
from onebend.lab.filming.force_log_file import write_log
from onebend.lab.filming.recording_toml import recording_toml
from onebend.lab.virtual import VirtualBench, VirtualRecording, true_stiffness, virtual_recording
from onebend.recording.folder import FILE_NAME
from onebend.recording.toml.source_entries import MarkersEntry

TABLE = "markers.csv"
TRUTH_PLACES = np.linspace(0.0, 1.0, 201)  # s


def check_trackable(filming: Filming) -> None:
    """Raises `RecordingError` where what is to be filmed needs more than the markers of a beam in equilibrium."""
    for wrong, what in (
        (filming.swings, "a push that swings the beam"),
        (filming.gravity > 0.0, "gravity in the plane of bending"),
    ):
        if wrong:
            raise RecordingError(f"{what} is filmed, not given as markers. Leave out the markers, or take a slow push.")


def marker_recording(bench: VirtualBench, folder: Path | str, *, seed: int) -> Path:
    """Push the bench's beam and write `recording.toml`, `markers.csv`, `force.csv` and `truth/` into `folder`, which
    must not hold a recording; return the folder. The same `seed` makes the same files.

    Raises:
        MechanicsError: the beam snaps through under the push.
        RecordingError: the folder holds a recording.
    """
    folder = Path(folder)
    if (folder / FILE_NAME).exists():
        raise RecordingError(f"{folder} holds a recording. Name another folder.")
    made = virtual_recording(bench, seed=seed)
    folder.mkdir(parents=True, exist_ok=True)
    _write_tracks(folder / TABLE, made)
    write_log(folder / "force.csv", made.log)
    told = made.recording
    assert told.video is not None
    assert told.force is not None
    markers = MarkersEntry(
        file=folder / TABLE,
        start=told.video.start,
        start_uncertainty=told.video.start_uncertainty,
        sd=bench.camera.white_xy,
        clamp=(0.0, 0.0),
        x_axis=(1.0, 0.0),
    )
    entry = replace(
        told,
        folder=folder,
        tags=replace(told.tags, on_base=()),
        video=None,
        markers=markers,
        force=replace(told.force, file=folder / "force.csv"),
    )
    (folder / FILE_NAME).write_text(recording_toml(entry), encoding="utf-8")
    _write_truth(folder / "truth", made, seed)
    return folder


def _write_tracks(path: Path, made: VirtualRecording) -> None:
    """`time_s, id, x_m, y_m, angle_rad`, a row a marker that is seen."""
    seen = made.markers
    lines = ["time_s,id,x_m,y_m,angle_rad"]
    for t, time in enumerate(seen.time):
        for i, marker in enumerate(seen.tag_id):
            x, y = seen.xy[t, i]
            if np.isfinite(x):
                lines.append(f"{time:.6f},{marker},{x:.8f},{y:.8f},{seen.angle[t, i]:.6f}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write_truth(folder: Path, made: VirtualRecording, seed: int) -> None:
    """`truth.npz` with s and k [N m], and `truth.json`; to compare with, nothing that learns reads them."""
    folder.mkdir(exist_ok=True)
    truth = true_stiffness(made.bench, made.motion, TRUTH_PLACES)
    length = made.bench.beam.length
    np.savez_compressed(folder / "truth.npz", s=TRUTH_PLACES, k=truth.k, EI=truth.k * length)
    facts = {"length_m": length, "force_max_N": made.bench.push.peak, "seed": seed}
    (folder / "truth.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
