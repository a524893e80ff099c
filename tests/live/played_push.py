"""A short push as a camera and a sensor, for the tests of the recorder."""

from __future__ import annotations

from pathlib import Path

from onebend.live.guidance import CaptureOutcome, CaptureSettings, CaptureState
from onebend.live.session import record
from onebend.live.sources import PlayedClock
from tests.live.disturbed import Disturbances, DisturbedCamera, DisturbedForce, OwnClock
from tests.live.streamed import OFFSET, frames, log, toml

SETTINGS = CaptureSettings(follow=False, setup=0.3, tare=0.3, rest=0.8, least_rest=0.4, live_beside=False)
CAMERA_CLOCK, FORCE_CLOCK = OwnClock(1e4, 6e-5, 0.003), OwnClock(-50.0, -8e-5, 0.002)
ROUGH = Disturbances(
    frames_lost=0.04,
    frames_late=0.03,
    frame_delay=0.002,  # as that of the samples: what is longer is not to be seen in stamps
    frame_jitter=3e-4,
    samples_lost=0.02,
    samples_late=0.05,
    samples_nan=0.01,
    sample_jitter=2e-4,
)


def folder(path: Path) -> Path:
    """With a recording.toml alone."""
    path.mkdir(exist_ok=True)
    (path / "recording.toml").write_text(toml(), encoding="utf-8")
    return path


def camera(how: Disturbances = Disturbances(), seed: int = 0) -> DisturbedCamera:
    return DisturbedCamera(frames(), how, CAMERA_CLOCK, seed)


def force(how: Disturbances = Disturbances(), seed: int = 0) -> DisturbedForce:
    return DisturbedForce(log(), OFFSET, how, FORCE_CLOCK, seed)


def recorded(
    path: Path,
    settings: CaptureSettings = SETTINGS,
    how: Disturbances = Disturbances(),
    seed: int = 0,
) -> tuple[CaptureOutcome, list[CaptureState]]:
    """The push recorded into `path`, as fast as it can be read, and what was told meanwhile."""
    states: list[CaptureState] = []
    outcome = record(
        folder(path), camera(how, seed), force(how, seed), settings, states.append, clock=PlayedClock(500.0)
    )
    return outcome, states
