"""Markers of the development recordings against their truth, and the speed of finding the tags.

`place` and `angle` are RMS errors, per coordinate, over every marker that is given. `claimed` is the median of the
normalised squared errors over that of chi-squared: 1 where the covariances are right, more where they claim too much.
`seen` is the share of tags found over all frames, some of them hidden; `found` compares with a search of the whole
picture, on one thread, of every eighth frame: the share of the tags found there that tracking finds as well. Both
speeds are of the same run; that of tracking includes decoding the video, that of the search does not.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.truth import RECORDINGS, Truth, read_truth, recordings_asked
from onebend.recording.camera import measure_markers
from onebend.recording.entries import VideoEntry
from onebend.recording.folder import read_recording
from onebend.recording.tag_finder import Finder
from onebend.recording.tags import detect_tags
from onebend.recording.video import Picture, read_frames
from onebend.records import Array, Detections, Markers

EVERY = 8  # frames between those that are searched as a whole
MEDIAN_CHI2 = 2.36597  # median of chi-squared with 3 degrees of freedom


@dataclass(frozen=True)
class Row:
    """One recording."""

    name: str
    calibrated: bool
    frames: int
    place: float  # m RMS, per coordinate
    angle: float  # rad RMS
    claimed: float
    seen: float
    found: float
    tracking: float  # frames/s
    searching: float  # frames/s


def row(folder: Path) -> Row:
    """Measure one recording."""
    rec = read_recording(folder)
    assert rec.video is not None
    began = time.perf_counter()
    detections = detect_tags(rec.video, rec.tags)
    tracking = len(detections.time) / (time.perf_counter() - began)
    found, searching = compare(rec.video, rec.tags.family, detections)
    place, angle, claimed = errors(measure_markers(detections, rec), read_truth(folder))
    return Row(
        name=rec.name,
        calibrated=rec.camera is not None,
        frames=len(detections.time),
        place=place,
        angle=angle,
        claimed=claimed,
        seen=float(np.isfinite(detections.corners).all(axis=(2, 3)).mean()),
        found=found,
        tracking=tracking,
        searching=searching,
    )


def compare(video: VideoEntry, family: str, detections: Detections) -> tuple[float, float]:
    """Share of the tags that a search of whole pictures finds and tracking has too, and that search's frames/s."""
    some: list[tuple[int, Picture]] = [(f.index, f.luma) for f in read_frames(video) if f.index % EVERY == 0]
    finder = Finder(family)
    began = time.perf_counter()
    looks = [finder.look(picture) for _, picture in some]
    seconds = time.perf_counter() - began
    ids = detections.tag_id.tolist()
    both = [
        bool(np.isfinite(detections.corners[index, ids.index(tag.tag_id)]).all())
        for (index, _), seen in zip(some, looks, strict=True)
        for tag in seen
        if tag.tag_id in ids
    ]
    return float(np.mean(both)), len(some) / seconds


def errors(markers: Markers, truth: Truth) -> tuple[float, float, float]:
    """RMS error of place [m] and angle [rad] in the base tag's frame, and the normalised squared errors' median."""
    error = np.concatenate([markers.xy, markers.angle[..., None]], axis=-1) - relative(truth, markers.tag_id.tolist())
    known = np.isfinite(error).all(axis=-1)
    squares = np.einsum("ki,kij,kj->k", error[known], np.linalg.inv(markers.covariance[known]), error[known])
    place, angle = np.sqrt(np.mean(error[known][:, :2] ** 2)), np.sqrt(np.mean(error[known][:, 2] ** 2))
    return float(place), float(angle), float(np.median(squares) / MEDIAN_CHI2)


def relative(truth: Truth, tag_id: Sequence[int]) -> Array:
    """True poses (T, m, 3) in the frame of the base tag, the first in the truth."""
    order = [truth.tag_id.tolist().index(tag) for tag in tag_id]
    base, tags = truth.tags[:, :1], truth.tags[:, order]
    cos, sin = np.cos(base[..., 2]), np.sin(base[..., 2])
    x, y = tags[..., 0] - base[..., 0], tags[..., 1] - base[..., 1]
    return np.stack([cos * x + sin * y, cos * y - sin * x, tags[..., 2] - base[..., 2]], axis=-1)


def rows(recordings: Path = RECORDINGS) -> list[Row]:
    """A row for each recording that has its truth beside it."""
    return [row(path.parent) for path in sorted(recordings.glob("*/truth"))]


def markdown(table: Iterable[Row]) -> str:
    """The rows as a Markdown table."""
    lines = [
        "| recording | camera | frames | place [mm] | angle [deg] | claimed | seen | found | tracking [frames/s] "
        "| whole pictures [frames/s] | ratio |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for one in table:
        lines.append(
            f"| {one.name} | {'calibrated' if one.calibrated else 'not calibrated'} | {one.frames} "
            f"| {1000 * one.place:.4f} | {np.degrees(one.angle):.4f} | {one.claimed:.2f} | {100 * one.seen:.1f} % "
            f"| {100 * one.found:.2f} % | {one.tracking:.0f} | {one.searching:.0f} "
            f"| {one.tracking / one.searching:.1f} |"
        )
    return "\n".join(lines)


def main() -> None:
    print(markdown(rows(recordings_asked(__doc__))))


if __name__ == "__main__":
    main()
