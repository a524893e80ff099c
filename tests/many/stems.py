"""Recordings of known beams as marker tracks, short enough to be learned from in a second."""

from __future__ import annotations

from pathlib import Path

from onebend.beam.model import Beam
from onebend.beam.stiffness import Table
from onebend.lab.bench import ForceSensor, PushProfile
from onebend.lab.filming import marker_recording
from onebend.lab.virtual import VirtualBench, VirtualClock

K = (0.12, 0.06)  # N m, at the clamp and at the tip
BEAM = Beam(0.15, Table((0.0, 1.0), K))


def bench(beam: Beam, *, scale: float = 1.0, name: str = "") -> VirtualBench:
    """A push of 3 s at 10 frames/s, `scale` times as strong as for a beam of K."""
    return VirtualBench(
        beam=beam,
        push=PushProfile(0.5 * scale, before=0.8, rise=1.0, hold=0.2, fall=1.0, after=0.8),
        sensor=ForceSensor(rate=100.0, white_sd=0.003),
        fps=10.0,
        clock=VirtualClock(0.0, 0.0, 0.0),
        name=name,
    )


def stem(folder: Path, *, scale: float = 1.0, seed: int = 0) -> Path:
    """A push of 3 s at 10 frames/s on a beam `scale` times as stiff as K."""
    beam = Beam(0.15, Table((0.0, 1.0), (scale * K[0], scale * K[1])))
    return marker_recording(bench(beam, scale=scale, name=folder.name), folder, seed=seed)
