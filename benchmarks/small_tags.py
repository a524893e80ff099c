"""Small tags: the share that is found and the error of their corners, by size, with each of the ways to search.

Films of random benches with tags of 10 to 50 px, lens blur, motion blur, noise and H.264, rendered by onebend. The
first columns search, in every third frame, the part of the picture where each tag truly is; hidden tags count as
missed. The last is `detect_tags` on the whole films. Below: tags found in photos, and things in pictures without such
tags that were taken for one.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from benchmarks.detectors import true_corners
from benchmarks.truth import RECORDINGS, read_truth
from onebend.errors import ObservationError
from onebend.lab.filming import Filming, film
from onebend.lab.random_bench import BenchRanges, random_bench
from onebend.recording.entries import FAMILIES
from onebend.recording.folder import read_recording
from onebend.recording.tag_finder import ENLARGED, SHARP, USUAL, Finder, Search, margin_of, side_of
from onebend.recording.tags import detect_tags
from onebend.recording.video import Picture, read_frames
from onebend.records import Array

FILMS, EVERY = 32, 3
RANGES = BenchRanges(seconds=(2.0, 3.0), sides=((1280, 720),), fps=(12.0,))
EDGES = (10, 12, 14, 16, 18, 20, 22, 25, 28, 32, 36, 40, 50)  # px
WAYS: dict[str, Search] = {"blur 0.8 px": USUAL, "without blur": SHARP, "enlarged": ENLARGED}
STILLS = RECORDINGS.parent / "realdata" / "tag_photos"
CLUTTER = 60  # pictures


@dataclass(frozen=True)
class Errors:
    """Of all tags of a film: true sides (N,) px, and errors (N, 4, 2) px, NaN where not found."""

    side: Array
    error: Array


def bench(seed: int) -> Filming:
    """A random bench whose tags are drawn small."""
    rng = np.random.default_rng([seed, 5])
    filming = random_bench(rng, RANGES)
    size = round(float(np.exp(rng.uniform(np.log(0.012), np.log(0.06)))) * filming.bench.beam.length, 5)
    scene = replace(
        filming.scene,
        noise=float(rng.choice([1, 2, 3, 5, 8])),
        crf=int(rng.choice([16, 20, 24, 28])),
        exposure=float(rng.uniform(0.004, 0.03)),
        blur=float(rng.uniform(0.5, 1.1)),
    )
    declared = replace(filming.bench.declared, tag_size=size)
    return replace(filming, tag_size=size, scene=scene, bench=replace(filming.bench, declared=declared))


def measure(folder: Path) -> dict[str, Errors]:
    """One film, searched in every way."""
    rec, truth = read_recording(folder), read_truth(folder)
    assert rec.video is not None
    true, ids, finder = true_corners(truth), truth.tag_id.tolist(), Finder(rec.tags.family)
    sides: list[float] = []
    errors: dict[str, list[Array]] = {name: [] for name in WAYS}
    for frame in read_frames(rec.video):
        for tag, corners in zip(ids, true[frame.index], strict=True):
            if frame.index % EVERY:
                continue
            sides.append(side_of(corners))
            for name, how in WAYS.items():
                errors[name].append(searched(finder, frame.luma, tag, corners, how))
    found = {name: Errors(np.array(sides), np.array(one)) for name, one in errors.items()}
    try:
        away = detect_tags(rec.video, rec.tags, threads=1).corners - true
    except ObservationError:  # no tag is found in any frame
        away = np.full(true.shape, np.nan)
    every = np.array([side_of(corners) for corners in true.reshape(-1, 4, 2)])
    return {**found, "onebend": Errors(every, away.reshape(-1, 4, 2))}


def searched(finder: Finder, picture: Picture, tag: int, corners: Array, how: Search) -> Array:
    """Errors (4, 2) of one tag, searched where it is."""
    margin = margin_of(corners, 0.4)
    left, top = np.maximum(np.floor(corners.min(axis=0) - margin), 0).astype(int)
    right, bottom = np.ceil(corners.max(axis=0) + margin).astype(int) + 1
    for one in finder.search(picture[top:bottom, left:right], how):
        if one.tag_id == tag:
            return np.asarray(one.corners + np.array([left, top]) - corners)
    return np.full((4, 2), np.nan)


def films_table() -> str:
    """A row for each range of sizes."""
    films: list[dict[str, Errors]] = []
    for seed in range(FILMS):
        with tempfile.TemporaryDirectory() as place:
            films.append(measure(film(bench(seed), Path(place) / "film", seed=seed)))
    names = [*WAYS, "onebend"]
    side = {name: np.concatenate([one[name].side for one in films]) for name in names}
    error = {name: np.concatenate([one[name].error for one in films]) for name in names}
    heads = [f"{name}: found [%] | corner [px]" for name in names]
    lines = [f"| side [px] | tags | {' | '.join(heads)} |", "| --- " * (2 + 2 * len(names)) + "|"]
    for low, high in pairwise(EDGES):
        cells = []
        for name in names:
            inside = error[name][(side[name] >= low) & (side[name] < high)]
            seen = np.isfinite(inside).all(axis=(1, 2))
            rms = f"{np.sqrt(np.mean(inside[seen] ** 2)):.3f}" if seen.any() else ""
            cells.append(f"{100 * seen.mean():.0f} | {rms}" if len(seen) else " | ")
        count = int(np.sum((side["onebend"] >= low) & (side["onebend"] < high)))
        lines.append(f"| {low} to {high} | {count} | {' | '.join(cells)} |")
    return "\n".join(lines)


def stills_table(folder: Path) -> str:
    """Tags found in photos of real ones: by one search of the whole picture, and as onebend looks."""
    finder, every = Finder(FAMILIES[0]), range(30)
    rows = ["| photos | number | blur 0.8 px | without blur | enlarged | onebend |", "| --- " * 6 + "|"]
    for group in ("clipboard", "hallway", "mapping"):
        files = sorted((folder / group).iterdir())
        pictures = [np.asarray(ImageOps.exif_transpose(Image.open(one)).convert("L")) for one in files]
        counts = [sum(len(finder.search(one, how)) for one in pictures) for how in WAYS.values()]
        counts.append(sum(len(finder.look(one, every)) for one in pictures))
        rows.append(f"| {group} | {len(files)} | {' | '.join(map(str, counts))} |")
    return "\n".join(rows)


def clutter(seed: int) -> Picture:
    """Black and white squares as large as small tags' cells, and noise."""
    rng = np.random.default_rng(seed)
    cell = int(rng.integers(2, 9))
    squares = rng.integers(0, 2, (1 + 480 // cell, 1 + 640 // cell)).repeat(cell, axis=0).repeat(cell, axis=1)
    noisy = 30.0 + 190.0 * squares[:480, :640] + float(rng.choice([2.0, 10.0, 30.0])) * rng.standard_normal((480, 640))
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def clutter_table() -> str:
    """What is taken for a tag where there is none: in whole pictures, and where a tag of 20 px is expected."""
    rows = [
        "| family | whole picture: blur 0.8 px | onebend | 20 px expected: blur 0.8 px | onebend |",
        "| --- " * 5 + "|",
    ]
    expected = 310.0 + 20.0 * np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    part = (slice(302, 339), slice(302, 339))
    for family in FAMILIES:
        finder, counts = Finder(family), np.zeros(4, dtype=int)
        for seed in range(CLUTTER):
            picture = clutter(seed)
            counts += [
                len(finder.search(picture, USUAL)),
                len(finder.look(picture, range(30))),
                len(finder.search(picture[part], USUAL)),
                len(finder.look_around(picture, expected, 8.0)),
            ]
        rows.append(f"| {family} | {' | '.join(map(str, counts))} |")
    return "\n".join(rows)


def main() -> None:
    print(films_table())
    if STILLS.is_dir():
        print(f"\nTags found in photos:\n\n{stills_table(STILLS)}")
    print(f"\nTaken for a tag, in {CLUTTER} pictures of 640 x 480 px without any:\n\n{clutter_table()}")


if __name__ == "__main__":
    main()
