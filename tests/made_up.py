"""Findings of a beam that does not exist, with exact shapes and known errors: what tables, figures and pages are
tested on, without a video."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.stiffness import Gaussians, equidistant
from onebend.learning.optimizer import FitSettings
from onebend.learning.outcome import Comparison, Learned, Trial
from onebend.learning.posterior import Posterior, fit
from onebend.learning.run import Run
from onebend.records import Array, CleanForce, ClockOffset, Observations, Remark, Source, Stated, View
from onebend.report.sentences import worded

LENGTH = 0.15  # m
MARKER_S = np.array([1 / 3, 2 / 3, 1.0])
TAGS = np.array([1, 2, 3])
FRAMES = 90
GAUSSIANS = Gaussians(equidistant(3), 0.4, (0.03, 0.02, 0.05))
BEAM = Beam(LENGTH, GAUSSIANS)


def forces(frames: int = FRAMES, largest: float = 0.3) -> Array:
    """A slow push and a quick release, after a rest."""
    t = np.linspace(0.0, 1.0, frames)
    size = largest * np.clip((t - 0.2) / 0.6, 0.0, 1.0) * (t < 0.9)
    return np.stack([0.2 * size, size], axis=1)


def comparison(
    name: str = "made-up", *, error_m: float = 0.001, largest: float = 0.3, frames: int = FRAMES
) -> Comparison:
    """Predicted markers are the beam's; measured ones are `error_m` off in x, and one is missing now and then."""
    force = forces(frames, largest)
    predicted = BEAM.equilibrium(force, np.ones(frames)).xy(MARKER_S)
    measured = predicted + np.array([error_m, 0.0]) * (np.linalg.norm(force, axis=1) > 0)[:, None, None]
    measured[10:12, 2] = np.nan
    distance = np.linalg.norm(measured - predicted, axis=-1)
    return Comparison(
        name=name,
        frame=np.arange(frames),
        time=250.0 + np.arange(frames) / 30,
        tag_id=TAGS,
        marker_s=MARKER_S,
        measured=measured,
        predicted=predicted,
        force=force,
        push_s=np.ones(frames),
        stable=np.ones(frames, dtype=bool),
        rms=np.sqrt(np.nanmean(distance**2, axis=0)),
        sensor_rms=np.array([0.0001, 0.0004, np.nan]),
        likely_rms=np.array([0.0002, 0.0008, np.nan]),
    )


def observations(name: str = "made-up", one: Comparison | None = None) -> Observations:
    """What would have led to `one`."""
    one = one or comparison(name)
    frames = len(one.frame)
    steps = np.arange(frames * 10)
    log_time = one.time[0] - 0.5 + steps / 300
    log_force = np.stack([np.interp(log_time, one.time, one.force[:, i]) for i in (0, 1)], axis=1)
    return Observations(
        source=Source(
            name=name,
            view=overhead_view(),
            clock=ClockOffset(offset=254.31, sd=0.004, stated=255.64, found=True),
            clean_force=CleanForce(
                time=log_time,
                force=log_force,
                push_s=None,
                noise_sd=np.array([0.004, 0.005]),
                tare=np.array([-0.11, -0.26]),
                drift=np.array([0.001, float("nan")]),
                cutoff=6.0,
                outliers=3,
            ),
            remarks=(Remark("note", "the mass is not known"), Remark("warning", "tag 3 was hidden for 2 frames")),
        ),
        stated=Stated(
            rest="straight",
            mass=float("nan"),
            placement_sd=0.0005,
        ),
        length=LENGTH,
        time=one.time,
        frame=one.frame,
        tag_id=TAGS,
        marker_s=MARKER_S,
        xy=one.measured,
        angle=np.zeros((frames, 3)),
        covariance=np.broadcast_to(np.diag([1e-9, 1e-9, 1e-6]), (frames, 3, 3, 3)).copy(),
        force=one.force,
        force_sd=np.array([0.004, 0.005]),
        push_s=one.push_s,
        loaded=np.linalg.norm(one.force, axis=1) > 0.0,
        rest_xy=np.stack([LENGTH * MARKER_S, np.zeros(3)], axis=1),
        rest_angle=np.zeros(3),
        rest_covariance=np.broadcast_to(np.diag([1e-10, 1e-10, 1e-7]), (3, 3, 3)).copy(),
        gravity=np.zeros((frames, 2)),
    )


def with_stated(observations: Observations, **changes: Any) -> Observations:
    """The same, but for what is stated."""
    return replace(observations, stated=replace(observations.stated, **changes))


def with_source(observations: Observations, **changes: Any) -> Observations:
    """The same, but for where it comes from."""
    return replace(observations, source=replace(observations.source, **changes))


def same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray):
        return bool(a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f"))
    if isinstance(a, float):
        return bool(a == b or (np.isnan(a) and np.isnan(b)))
    return bool(a == b)


def overhead_view() -> View:
    """A camera 0.4 m above the base, its x along the beam and its y against the beam's."""
    return View(
        matrix=np.array([[900.0, 0.0, 200.0], [0.0, 900.0, 300.0], [0.0, 0.0, 1.0]]),
        dist=np.array([-0.05, 0.01, 0.0, 0.0, 0.0]),
        rotation=np.diag([1.0, -1.0, -1.0]),
        translation=np.array([0.0, 0.0, 0.4]),
        calibrated=True,
        corner_sd=0.08,
    )


def learned(training: Comparison | None = None) -> Learned:
    """Three trials: one chosen, one worse, one out of the running."""
    training = training or comparison()
    worse = Trial(2, 2, np.array([0.03, 0.04]), training.rms * 2, -4800.0, 0.011, 45.0)
    best = Trial(
        4,
        3,
        np.array(GAUSSIANS.coefficients),
        training.rms,
        -5200.0,
        float(BEAM.stiffness(np.linspace(0, 1)).min()),
        120.0,
    )
    out = Trial(
        5, 5, np.array([0.1, -0.2, 0.1, 0.2, 0.1]), np.full(3, np.nan), float("inf"), -0.02, 9e3, "k(s) is not positive"
    )
    return Learned(
        BEAM, "regression", "gaussians", (worse, best, out), 1, training, (Remark("note", "3 of 10 trials are out"),)
    )


@cache
def posterior() -> Posterior:
    """A real fit to the made-up markers with the angles that belong to them, and white errors as their covariance."""
    seen = observations(one=comparison(error_m=0.0))
    angle = BEAM.equilibrium(seen.force, seen.push_s).angle(MARKER_S)
    rng = np.random.default_rng(7)
    xy_sd, angle_sd = np.sqrt(seen.covariance[0, 0, [0, 2], [0, 2]])
    xy = seen.xy + xy_sd * rng.normal(size=seen.xy.shape)
    seen = replace(seen, xy=xy, angle=angle + angle_sd * rng.normal(size=angle.shape))
    return fit([seen], 0.03, settings=FitSettings(functions=8, most_frames=30))


def findings(validations: int = 2, *, fitted: bool = True) -> Run:
    """A whole run, with as many validation recordings as asked."""
    training = comparison()
    others = [comparison(f"other-{i + 1}", error_m=0.002 * (i + 1), largest=0.2) for i in range(validations)]
    return Run(
        beam=posterior().beam if fitted else BEAM,
        learned=learned(training),
        posterior=posterior() if fitted else None,
        recordings=(observations(one=training),),
        trainings=(training,),
        remarks=worded(learned(training).remarks),
        validations=tuple(others),
        validation_observations=tuple(observations(one.name, one) for one in others),
    )
