"""Tags of films of the named designs beside those of the development recordings of the same designs.

Most of a tag's error of place is one draw a film: where the base tag falls on the pixels and on the printer's dots, it
stays, and turns or shifts all the others. So every design is filmed by several cameras, drawn as laboratories have
them, and both sides are root mean squares over films. `constant` is what all frames have in common, tag by tag,
`changing` what is left.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.markers import MEDIAN_CHI2, relative
from benchmarks.truth import read_truth
from onebend.lab.designs import DESIGNS
from onebend.lab.filming import Filming, film
from onebend.lab.random_bench import BenchRanges, FilmRequest, PushName, filming_of, random_camera
from onebend.recording.camera import measure_markers
from onebend.recording.folder import read_recording
from onebend.recording.tags import detect_tags
from onebend.records import Array

CAMERAS, FPS, SECONDS = 4, 10.0, 3.0  # a design; of its films, and of contact
DRAWN = BenchRanges(sides=((1280, 720),))  # as the development recordings
TWINS: tuple[tuple[str, PushName, bool], ...] = (  # calibrated as the recordings are
    ("linear", "slow", True),
    ("quadratic", "s08", True),
    ("cubic", "slow", False),
)
PUSHES = ("train", "s08", "s06", "fast")  # of the development recordings: without gravity, without a free swing


@dataclass(frozen=True)
class TagErrors:
    """Of one film, per coordinate; places in m, the angle in rad."""

    place: float
    constant: float
    changing: float
    angle: float
    claimed: float


def tag_errors(folder: Path) -> TagErrors:
    """Find the tags of a recording and compare them with its truth."""
    rec, truth = read_recording(folder), read_truth(folder)
    assert rec.video is not None
    markers = measure_markers(detect_tags(rec.video, rec.tags, threads=1), rec)
    error = np.concatenate([markers.xy, markers.angle[..., None]], axis=-1)
    error -= relative(truth, markers.tag_id.tolist())
    xy, known = error[..., :2], np.isfinite(error).all(axis=-1)
    mean = np.nanmean(xy, axis=0)
    flat, squares = error[known], np.linalg.inv(markers.covariance[known])
    return TagErrors(
        rms(xy),
        rms(mean),
        rms(xy - mean),
        rms(error[..., 2]),
        float(np.median(np.einsum("ki,kij,kj->k", flat, squares, flat)) / MEDIAN_CHI2),
    )


def rms(values: Array) -> float:
    """Of those that are known."""
    return float(np.sqrt(np.nanmean(values**2)))


def twin(design: str, push: PushName, calibrated: bool, seed: int) -> Filming:
    """A named design before a camera that is drawn."""
    request = FilmRequest(push=push, calibrated=calibrated, fps=FPS, seconds=SECONDS)
    filming = filming_of(DESIGNS[design], request, f"{design}-{push}")
    return replace(filming, camera=random_camera(np.random.default_rng([seed, 78]), DRAWN))


def row(name: str, films: Sequence[TagErrors], frames_a_second: float = float("nan")) -> str:
    """Root mean squares over films; the median of what is claimed."""
    sizes = [1e3 * rms(np.array([getattr(one, n) for one in films])) for n in ("place", "constant", "changing")]
    angle = np.degrees(rms(np.array([one.angle for one in films])))
    claimed = np.median([one.claimed for one in films])
    speed = f"{frames_a_second:.0f}" if np.isfinite(frames_a_second) else ""
    cells = " | ".join(f"{v:.4f}" for v in (*sizes, angle))
    return f"| {name} | {len(films)} | {cells} | {claimed:.2f} | {speed} |"


def twins_table(recordings: Path) -> str:
    """Rows for each design, for all of them, and what our errors are of theirs."""
    lines = [
        "| films | number | place [mm] | constant [mm] | changing [mm] | angle [deg] | claimed chi^2 "
        "| film [frames/s of one core] |",
        "| " + "--- | " * 8,
    ]
    ours: list[TagErrors] = []
    theirs: list[TagErrors] = []
    for design, push, calibrated in TWINS:
        mine, seconds, frames = [], 0.0, 0
        for seed in range(CAMERAS):
            with tempfile.TemporaryDirectory() as place:
                folder, began = Path(place) / "film", time.process_time()
                film(twin(design, push, calibrated, seed), folder, seed=seed)
                seconds += time.process_time() - began
                mine.append(tag_errors(folder))
                frames += len(read_truth(folder).time)
        found = [recordings / f"{design}_{kind}" for kind in PUSHES]
        other = [tag_errors(one) for one in found if (one / "truth").is_dir()]
        lines.append(row(f"{design}, ours", mine, frames / seconds))
        lines += [row(f"{design}, development recordings", other)] if other else []
        ours, theirs = ours + mine, theirs + other
    lines.append(row("all, ours", ours))
    if theirs:
        lines.append(row("all, development recordings", theirs))
        names = ("place", "constant", "changing", "angle")
        ratios = [
            rms(np.array([getattr(o, n) for o in ours])) / rms(np.array([getattr(t, n) for t in theirs])) for n in names
        ]
        lines.append("| ours over theirs | | " + " | ".join(f"{v:.2f}" for v in ratios) + " | | |")
    return "\n".join(lines)
