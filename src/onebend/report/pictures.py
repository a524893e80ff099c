"""Draws pictures independently: a failure costs only that picture."""

from __future__ import annotations

import base64
import io
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from onebend.beam.model import Beam
from onebend.beam.stiffness import UncertainStiffness, half_width
from onebend.errors import MechanicsError, OnebendError
from onebend.learning.outcome import Explained
from onebend.learning.validation import solved_frames
from onebend.progress import Progress, Silent, track
from onebend.recording.entries import VideoEntry
from onebend.recording.plane import project
from onebend.recording.video import KeptFrames, roundest
from onebend.records import Array, IntArray, Observations, View
from onebend.text_files import one_line

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Small frames of the film for the page.

MOST_FRAMES = 24  # fewer than are kept of most films
WIDEST = 560  # px
LARGEST = 1_500_000  # bytes in all: the page stays below 5 MB
QUALITIES = (70, 55, 40, 25, 12)  # of the JPEGs, best first
_STEP = 4  # of the centre line's places


def film_of(video: Path, observations: Observations) -> VideoEntry:
    return VideoEntry(file=video, topic=observations.source.video_topic)


def spread_frames(frame: IntArray) -> IntArray:
    """(n,) evenly spread places in `frame` (T,), of frames likely to be kept."""
    ends = np.linspace(0, len(frame), min(MOST_FRAMES, len(frame)) + 1).round().astype(int)
    return np.array([a + roundest(frame[a:b]) for a, b in pairwise(ends.tolist())], dtype=np.int64)


def film_strip(
    observations: Observations,
    fitted: Explained,
    beam: Beam,
    uncertain: UncertainStiffness,
    kept: KeptFrames | None = None,
) -> dict[str, Any] | None:
    """Evenly spread frames of the fit, for the page's script; those not in `kept` are read. None without film or
    camera.

    Lengths are in pixels of the small pictures: the fitted beam, the edges of its 95 % band due to k(s), the tags that
    are seen, and the arrow to the place of the fitted force [N]. Times count from the first frame shown.
    """
    source, shown = observations.source, fitted.comparison
    if source.view is None or source.video is None:
        return None
    chosen = spread_frames(shown.frame)
    arrows = _arrows(source.view, observations.length, fitted, chosen)
    beams, tags = project(source.view, fitted.line[chosen, ::_STEP]), project(source.view, shown.measured[chosen])
    points = np.concatenate([part.reshape(-1, 2) for part in (beams, tags, arrows)])
    try:
        pictures = (kept or KeptFrames()).pictures(
            film_of(source.video, observations), shown.frame[chosen].tolist(), colour=True
        )
        images = {index: _part(picture, points) for index, picture in pictures}
    except OnebendError:
        return None
    if not images:
        return None
    aside = shape_band(beam, uncertain, observations, fitted, chosen)
    low, scale = next(iter(images.values()))[1:]
    jpegs = dict(zip(images, _jpegs([image for image, _, _ in images.values()]), strict=True))

    def small(px: Array) -> list[Any]:
        return list((scale * (px - low)).round(1).tolist())

    frames = [
        {
            "picture": f"data:image/jpeg;base64,{jpegs[index]}",
            "frame": index,
            "time_s": round(float(shown.time[t] - shown.time[chosen[0]]), 3),
            "beam_px": small(beams[i]),
            "band_px": small(project(source.view, np.concatenate([aside[i, 0], aside[i, 1, ::-1]]))),
            "tags_px": small(tags[i][np.isfinite(tags[i]).all(axis=1)]),
            "arrow_px": small(arrows[i]),
            "force_N": six_digits(shown.force[t]),
        }
        for i, (t, index) in enumerate(zip(chosen, shown.frame[chosen].tolist(), strict=True))
        if index in jpegs
    ]
    width, height = next(iter(images.values()))[0].size
    return {"width": width, "height": height, "frames": frames}


def six_digits(values: Array) -> list[float]:
    """For a smaller page."""
    return [float(f"{value:.6g}") for value in values]


def shape_band(
    beam: Beam, uncertain: UncertainStiffness, observations: Observations, fitted: Explained, chosen: NDArray[np.int_]
) -> Array:
    """(F, 2, places, 2) m, 95 % band of the centre line for k(s) from its posterior, under the loads of frames
    `chosen`, without force errors. Zero width if no drawn beam can be simulated."""
    lines = fitted.line[chosen, ::_STEP]
    s = np.linspace(0.0, 1.0, fitted.line.shape[1])[::_STEP]
    frames = np.isin(observations.frame, fitted.comparison.frame[chosen])
    bent: list[Array] = []
    near: Array | None = None
    for profile in uncertain.draw(16, seed=0):
        try:
            [solved] = solved_frames(replace(beam, stiffness=profile), observations, frames, near)
        except MechanicsError:
            continue
        near = solved.q if solved.converged.all() else near
        bent.append(np.where(solved.converged[:, None, None], solved.xy(s), np.nan))
    along = np.gradient(lines, axis=1)
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    if len(bent) < 2:
        return np.stack([lines, lines], axis=1)
    sideways = np.sum((np.array(bent) - np.mean(bent, axis=0)) * normal, axis=-1)
    wide = np.nan_to_num(half_width(np.std(sideways, axis=0, ddof=1)))[..., None]
    return np.stack([lines + wide * normal, lines - wide * normal], axis=1)


def _arrows(view: View, length: float, fitted: Explained, chosen: NDArray[np.int_]) -> Array:
    """(F, 2, 2) px, arrows to the place of the force, scaled by its size."""
    shown, lines = fitted.comparison, fitted.line[chosen]
    places = np.nan_to_num(shown.push_s[chosen], nan=1.0)
    at = lines[np.arange(len(chosen)), (places * (lines.shape[1] - 1)).round().astype(int)]
    largest = max(float(np.max(np.linalg.norm(shown.force, axis=1))), 1e-12)
    begin = at - 0.25 * length * shown.force[chosen] / largest
    return np.asarray(project(view, np.stack([begin, at], axis=1)))


def _window(points: Array, shape: tuple[int, ...]) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Corners (x, y) px of a window around all `points`."""
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    room = 0.12 * float(np.max(high - low)) + 20.0
    limits = np.array([shape[1], shape[0]])
    first = np.clip(np.floor(low - room).astype(int), 0, limits - 2)
    return first, np.clip(np.ceil(high + room).astype(int), first + 2, limits)


def _part(picture: NDArray[np.uint8], points: Array) -> tuple[Image.Image, NDArray[np.int_], float]:
    """The window around all `points`, scaled down; its corner [px] and scale."""
    low, high = _window(points, picture.shape)
    scale = min(WIDEST / float(high[0] - low[0]), 1.0)
    part = Image.fromarray(picture[low[1] : high[1], low[0] : high[0]])
    width, height = (round(scale * float(extent)) for extent in high - low)
    return part.resize((width, height), Image.Resampling.HAMMING), low, scale


def _jpegs(images: list[Image.Image]) -> list[str]:
    """JPEGs of the best quality below `LARGEST` in all, in base64."""
    streams: list[io.BytesIO] = []
    for quality in QUALITIES:
        streams = [io.BytesIO() for _ in images]
        for image, stream in zip(images, streams, strict=True):
            image.save(stream, format="JPEG", quality=quality, optimize=True)
        if sum(stream.tell() for stream in streams) <= LARGEST:
            break
    return [base64.b64encode(stream.getvalue()).decode("ascii") for stream in streams]


Draw: TypeAlias = "Callable[[], Figure | None]"
LONGEST = 200  # characters of a reason


@dataclass(frozen=True)
class Pictures:
    """Drawn and failed pictures."""

    drawn: dict[str, bytes] = field(default_factory=dict)  # PNGs by name
    failed: dict[str, str] = field(default_factory=dict)  # reasons by name
    film: dict[str, Any] | None = None  # of `film_strip`

    def write(self, folder: Path) -> None:
        """As `NAME.png`."""
        folder.mkdir(exist_ok=True)
        for name, png in self.drawn.items():
            (folder / f"{name}.png").write_bytes(png)


def draw(wanted: Mapping[str, Draw], progress: Progress = Silent()) -> Pictures:
    """Draws all that it can; a function that returns None has nothing to show."""
    from onebend.report.style import png_of

    pictures = Pictures()
    for name, make in track(progress, "drawing the figures", list(wanted.items()), len(wanted)):
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="Glyph .* missing")  # names in other scripts become boxes
                figure = make()
                if figure is not None:
                    pictures.drawn[name] = png_of(figure)
        except Exception as error:  # results do not depend on pictures
            pictures.failed[name] = reason_of(error)
    return pictures


def reason_of(error: Exception) -> str:
    """One line."""
    return one_line(f"{type(error).__name__}: {error}")[:LONGEST]
