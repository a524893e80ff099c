"""AprilTag detectors beside each other: how far their corners are from the truth, and what a 720p picture costs.

Each runs in a process of its own on the same pictures, one thread, and is left out where it is not installed. Errors
are those of the corners in pixels, after each detector's own convention (the half-pixel, the corners' order) is taken
off: RMS over all corners, RMS of the tags' centres, and the median size of the tags' turn. `missed` counts tags that a
person sees. The last row is what onebend makes of the same pictures: it follows the tags through every frame, and
reads tags that stand still from their whole pattern.
"""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.truth import RECORDINGS, Truth, parser_of, read_truth
from onebend.recording.entries import TagsEntry, VideoEntry
from onebend.recording.folder import read_recording
from onebend.recording.plane import project, square
from onebend.recording.tags import detect_tags
from onebend.recording.video import FilmFrame, Picture, read_frames
from onebend.records import Array, View

NAMES = ("linear_train", "cubic_fast", "quadratic_grav")
EVERY, FRAMES = 9, 25  # of each recording
Look = Callable[[Picture], dict[int, Array]]  # id -> corners (4, 2), bottom-left first, counter-clockwise, whole pixels


@dataclass(frozen=True)
class Row:
    """One detector with one set of settings."""

    detector: str
    corner: float  # px RMS
    centre: float  # px RMS
    turn: float  # rad, median
    missed: int
    cost: float  # s a picture; NaN where it is not comparable


def apriltag(module: str, **settings: float) -> Look:
    """pyapriltags or pupil-apriltags: corners of pixels at halves."""
    detector = importlib.import_module(module).Detector(families="tag36h11", **settings)
    return lambda picture: {tag.tag_id: tag.corners - 0.5 for tag in detector.detect(picture)}


def wpilib(**settings: float) -> Look:
    """robotpy-apriltag: corners of pixels at halves."""
    made = importlib.import_module("robotpy_apriltag").AprilTagDetector()
    made.addFamily("tag36h11")
    config = made.Config()
    config.quadDecimate, config.quadSigma, config.refineEdges = settings["quad_decimate"], settings["quad_sigma"], True
    made.setConfig(config)

    def look(picture: Picture) -> dict[int, Array]:
        seen = made.detect(picture)
        return {t.getId(): np.array([[t.getCorner(i).x, t.getCorner(i).y] for i in range(4)]) - 0.5 for t in seen}

    return look


def aruco(refinement: str) -> Look:
    """OpenCV: its printed tags are the official ones turned by half a turn, and run clockwise. The refinement
    "APRILTAG" puts pixel centres at halves, the others at whole numbers."""
    cv2 = importlib.import_module("cv2")
    cv2.setNumThreads(1)
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = getattr(cv2.aruco, f"CORNER_REFINE_{refinement}")
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), settings)
    half = 0.5 if refinement == "APRILTAG" else 0.0

    def look(picture: Picture) -> dict[int, Array]:
        corners, ids, _ = detector.detectMarkers(picture)
        found = [] if ids is None else zip(ids.ravel(), corners, strict=True)
        return {int(tag): np.roll(quad[0][::-1].astype(float), 2, axis=0) - half for tag, quad in found}

    return look


def detectors() -> dict[str, Callable[[], Look]]:
    """What is compared, by name."""
    made: dict[str, Callable[[], Look]] = {}
    for label, module in (("pyapriltags", "pyapriltags"), ("pupil-apriltags", "pupil_apriltags")):
        for decimate, sigma in ((1.0, 0.8), (1.0, 0.0), (2.0, 0.0)):
            name = f"{label}, decimate {decimate:g}, blur {sigma:g}"
            made[name] = lambda m=module, d=decimate, b=sigma: apriltag(m, quad_decimate=d, quad_sigma=b)  # type: ignore[misc]
    made["pyapriltags, edges not refined"] = lambda: apriltag("pyapriltags", quad_decimate=1.0, refine_edges=0)
    made["robotpy-apriltag, decimate 1, blur 0.8"] = lambda: wpilib(quad_decimate=1.0, quad_sigma=0.8)
    for refinement in ("SUBPIX", "CONTOUR", "APRILTAG"):
        made[f"OpenCV ArUco, {refinement.lower()}"] = lambda r=refinement: aruco(r)  # type: ignore[misc]
    return made


def true_corners(truth: Truth) -> Array:
    """(T, m + 1, 4, 2) px corners by the true camera and the true tags."""
    facts = truth.facts
    camera, size = facts["camera"], facts["spec"]["tag_size"] if "spec" in facts else facts["tags"]["size"]
    rotation = np.array(camera["R"])
    view = View(
        matrix=np.array(camera["K"]),
        dist=np.array([*camera["dist"], 0.0][:5]),
        rotation=rotation,
        translation=-rotation @ np.array(camera["C"]),
        calibrated=True,
        corner_sd=0.0,
    )
    return project(view, square(truth.tags[..., :2], truth.tags[..., 2], size))


def some(video: VideoEntry) -> list[FilmFrame]:
    """The frames that are looked at."""
    return [frame for frame in read_frames(video) if frame.index % EVERY == 0 and frame.index < EVERY * FRAMES]


def recording(folder: Path) -> tuple[VideoEntry, TagsEntry, Truth]:
    """What a detector needs of a recording, and its truth."""
    rec = read_recording(folder)
    assert rec.video is not None
    return rec.video, rec.tags, read_truth(folder)


def measure(name: str, folder: Path) -> Row:
    """One detector on all pictures."""
    look = detectors()[name]()
    errors, seconds, pictures = [], 0.0, 0
    for recorded in NAMES:
        video, _, truth = recording(folder / recorded)
        true = true_corners(truth)
        for frame in some(video):
            began = time.perf_counter()
            seen = look(frame.luma)
            seconds += time.perf_counter() - began
            pictures += 1
            nothing = np.full((4, 2), np.nan)
            corners = np.stack([seen.get(tag, nothing) for tag in truth.tag_id.tolist()])
            errors.append((corners - true[frame.index], true[frame.index]))
    return summary(name, errors, seconds / pictures)


def followed(folder: Path) -> Row:
    """onebend's own chain on the same pictures."""
    errors = []
    for recorded in NAMES:
        video, tags, truth = recording(folder / recorded)
        found, true = detect_tags(video, tags), true_corners(truth)
        for index in range(0, EVERY * FRAMES, EVERY):
            errors.append((found.corners[index] - true[index], true[index]))
    return summary("onebend", errors, float("nan"))


def summary(name: str, errors: list[tuple[Array, Array]], cost: float) -> Row:
    """Errors (m, 4, 2) and true corners of every picture as a row."""
    error, true = (np.concatenate(part) for part in zip(*errors, strict=True))
    arm = true - true.mean(axis=1, keepdims=True)
    turn = (arm[..., 0] * error[..., 1] - arm[..., 1] * error[..., 0]).sum(axis=1) / (arm**2).sum(axis=(1, 2))
    return Row(
        detector=name,
        corner=float(np.sqrt(np.nanmean(error**2))),
        centre=float(np.sqrt(np.nanmean(error.mean(axis=1) ** 2))),
        turn=float(np.nanmedian(np.abs(turn))),
        missed=int(np.isnan(error).any(axis=(1, 2)).sum()),
        cost=cost,
    )


def rows(recordings: Path = RECORDINGS) -> list[Row]:
    """A row for every detector that is installed, each from a process of its own, and onebend's."""
    found = []
    for name in detectors():
        command = [sys.executable, "-m", "benchmarks.detectors", "--only", name, "--recordings", str(recordings)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.stdout.startswith("{"):
            found.append(Row(**json.loads(done.stdout.splitlines()[0])))
    return [*found, followed(recordings)]


def markdown(found: list[Row]) -> str:
    """The rows as a table, and what was not installed."""
    lines = [
        "| detector | corner [px] | centre [px] | turn [deg] | missed | cost [ms] |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for r in found:
        cost = "" if np.isnan(r.cost) else f"{1000 * r.cost:.0f}"
        turn = f"{np.degrees(r.turn):.4f}"
        lines.append(f"| {r.detector} | {r.corner:.4f} | {r.centre:.4f} | {turn} | {r.missed} | {cost} |")
    absent = sorted(set(detectors()) - {r.detector for r in found})
    return "\n".join([*lines, *(["", f"Not installed here: {'; '.join(absent)}."] if absent else [])])


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--only", help="one detector, printed as JSON")
    asked = parser.parse_args()
    if not asked.only:
        print(markdown(rows(asked.recordings)))
        return
    try:
        result: dict[str, Any] = asdict(measure(asked.only, asked.recordings))
    except ImportError as missing:
        sys.exit(f"{asked.only}: {missing}")
    print(json.dumps(result))


if __name__ == "__main__":
    main()
