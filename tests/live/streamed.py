"""A short push of a known beam, filmed picture by picture, with its force log: what the tests of the stream play."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform
from onebend.recording.entries import ForceEntry, PushEntry, Recording, VideoEntry
from onebend.recording.video import FilmFrame
from onebend.records import Array, ForceLog
from tests.recording.filmed import HEIGHT, LENGTH, SIZE, WIDTH, film, recording, view

FPS, RATE = 15.0, 100.0
OFFSET = 7.3  # s, what the log's clock is ahead of the film's
DURATION, REST = 6.0, 1.2  # s, of the film, and of the rests at its begin and its end
BEAM = Beam(LENGTH, Uniform(0.02))
BIAS = np.array([0.03, -0.05])  # N, of the sensor
_NOISE = 0.001  # N


def force_at(time: Array) -> Array:
    """(N, 2) N on the beam at times (N,) s of the film."""
    part = np.clip((time - REST) / (DURATION - 2 * REST), 0.0, 1.0)
    return np.asarray(np.sin(np.pi * part)[:, None] ** 2 * np.array([0.03, 0.2]))


@cache
def frames() -> tuple[FilmFrame, ...]:
    """The film."""
    time = np.arange(0.0, DURATION, 1 / FPS)
    s = np.array([0.0, 1 / 3, 2 / 3, 1.0])
    shape = BEAM.equilibrium(force_at(time))
    poses = np.concatenate([shape.xy(s), shape.angle(s)[..., None]], axis=-1)
    shown = film(poses, range(4), view())
    return tuple(replace(one, time=float(t)) for one, t in zip(shown, time, strict=True))


@cache
def log() -> ForceLog:
    """The force log: it begins before the film and ends after it."""
    time = np.arange(-0.5, DURATION + 0.5, 1 / RATE)
    noise = _NOISE * np.random.default_rng(3).standard_normal((len(time), 2))
    return ForceLog(time + OFFSET, force_at(time) + BIAS + noise)


def described(start: float = OFFSET, uncertainty: float = 0.3) -> Recording:
    """What recording.toml would say."""
    return replace(
        recording(calibrated=view()),
        video=VideoEntry(Path("video.mp4"), start=start, start_uncertainty=uncertainty),
        force=ForceEntry(Path("force.csv")),
        push=PushEntry(at=1.0),
    )


def toml() -> str:
    """A recording.toml of the made-up push."""
    seen = view()
    numbers = {"fx": seen.matrix[0, 0], "fy": seen.matrix[1, 1], "cx": seen.matrix[0, 2], "cy": seen.matrix[1, 2]}
    camera = "\n".join(f"{name} = {float(value)}" for name, value in numbers.items())
    beam = ", ".join(f"{{ id = {i}, s = {i / 3:.6f} }}" for i in (1, 2, 3))
    return f"""format = 1
[beam]
length_m = {LENGTH}
[tags]
size_m = {SIZE}
on_base = [{{ id = 0, s = 0.0 }}]
on_beam = [{beam}]
[camera]
width = {WIDTH}
height = {HEIGHT}
{camera}
dist = {seen.dist.tolist()}
[video]
file = "video.mp4"
start_s = {OFFSET}
start_uncertainty_s = 0.3
[force]
file = "force.csv"
[push]
at_s = 1.0
"""
