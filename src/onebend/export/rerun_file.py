"""A recording and its beam as a Rerun file (.rrd): video, tags, simulated beam, forces, residuals, on the log's clock.

Needs the Rerun SDK, the optional part `rerun`.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from onebend.beam.model import Beam
from onebend.beam.stiffness import UncertainStiffness
from onebend.extras import package
from onebend.learning.outcome import Comparison
from onebend.learning.validation import solved_frames
from onebend.recording.camera import project
from onebend.recording.video import FilmFrame
from onebend.records import Array, Observations

CLOCK = "log"  # the timeline: the force log's seconds
QUALITY = 75  # of the pictures, JPEG
_ROWS = 5000  # of the force log, at most
_UPWARDS_MM = np.array([1e3, -1e3])  # Rerun draws y downwards
_LINE = np.linspace(0.0, 1.0, 61)


def write_rerun(
    path: Path,
    beam: Beam,
    comparison: Comparison,
    observations: Observations,
    frames: Iterable[FilmFrame] = (),
    *,
    uncertain: UncertainStiffness | None = None,
    every: int = 1,
) -> None:
    """Write `path` from a validation and its observations. Lengths in the picture are pixels, in the plane millimetres.

    `frames`: the recording's video, or nothing; one picture in `every` is kept.

    Raises `MissingPackageError`: the Rerun SDK is not installed.
    """
    rr = package("rerun", "rerun")
    with rr.RecordingStream("onebend", recording_id=observations.source.name) as stream:
        stream.save(str(path))
        _log_force(rr, stream, observations)
        _log_stiffness(rr, stream, beam, uncertain)
        _log_markers(rr, stream, beam, comparison, observations)
        times = dict(zip(observations.frame.tolist(), observations.time.tolist(), strict=True))
        for frame in frames:
            if frame.index % every == 0 and frame.index in times:
                stream.set_time(CLOCK, duration=times[frame.index])
                stream.log("camera/picture", rr.EncodedImage(contents=_jpeg(frame.luma), media_type="image/jpeg"))
        stream.flush()


def _log_force(rr: Any, stream: Any, observations: Observations) -> None:
    """The whole log behind the filter where there is one, else the force of every frame."""
    log = observations.source.clean_force
    time, force = (observations.time, observations.force) if log is None else (log.time, log.force)
    thin = slice(None, None, max(1, len(time) // _ROWS))
    known = np.isfinite(force[thin]).all(axis=1)
    index = [rr.TimeColumn(CLOCK, duration=time[thin][known])]
    for axis, name in enumerate(("x", "y")):
        stream.send_columns(f"force/{name}_N", index, rr.Scalars.columns(scalars=force[thin][known, axis]))


def _log_stiffness(rr: Any, stream: Any, beam: Beam, uncertain: UncertainStiffness | None) -> None:
    """k(s) as lines over s in per cent; k in mN m, drawn upwards."""

    def line(k: Array) -> Array:
        return np.stack([100.0 * _LINE, -1e3 * k], axis=1)

    lines, labels = [line(np.asarray(beam.stiffness(_LINE)))], ["k(s) [mN m]"]
    if uncertain is not None:
        band = uncertain.band(_LINE)
        lines, labels = [*lines, line(band.low), line(band.high)], [*labels, "2.5 %", "97.5 %"]
    stream.log("stiffness", rr.LineStrips2D(lines, labels=labels), static=True)


def _log_markers(rr: Any, stream: Any, beam: Beam, comparison: Comparison, observations: Observations) -> None:
    """In every compared frame: tags as seen and as simulated, the beam, and how far they are apart."""
    compared = np.isin(observations.frame, comparison.frame)
    lines = np.concatenate([solved.xy(_LINE) for solved in solved_frames(beam, observations, compared)])
    apart = np.linalg.norm(comparison.measured - comparison.predicted, axis=-1)
    index = [rr.TimeColumn(CLOCK, duration=comparison.time)]
    for i, tag in enumerate(comparison.tag_id):
        stream.send_columns(f"residual/tag_{tag}_mm", index, rr.Scalars.columns(scalars=1e3 * apart[:, i]))
    for t, time in enumerate(comparison.time):
        stream.set_time(CLOCK, duration=float(time))
        places = lines[t], comparison.measured[t], comparison.predicted[t]
        _log_shape(rr, stream, "plane", *(_UPWARDS_MM * xy for xy in places))
        if observations.source.view is not None:
            _log_shape(rr, stream, "camera", *(project(observations.source.view, xy) for xy in places))


def _log_shape(rr: Any, stream: Any, where: str, line: Array, measured: Array, predicted: Array) -> None:
    if np.isfinite(line).all():
        stream.log(f"{where}/beam", rr.LineStrips2D([line], colors=[[230, 120, 40]]))
    for name, xy, colour in (("tags", measured, [40, 160, 90]), ("simulated", predicted, [230, 120, 40])):
        known = np.isfinite(xy).all(axis=1)
        stream.log(f"{where}/{name}", rr.Points2D(xy[known], colors=[colour]))


def _jpeg(luma: Any) -> bytes:
    memory = io.BytesIO()
    Image.fromarray(np.asarray(luma, dtype=np.uint8)).save(memory, format="JPEG", quality=QUALITY)
    return memory.getvalue()
