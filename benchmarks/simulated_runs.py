"""Simulated recordings of a rehearsed setup, and their fits: what its prediction is measured against."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from math import nan

import numpy as np

from benchmarks.processes import in_processes
from onebend.beam.stiffness import half_width
from onebend.errors import LearningError, MechanicsError, ObservationError
from onebend.lab import forecast
from onebend.lab.virtual import (
    DeclaredValues,
    VirtualBench,
    VirtualClock,
    VirtualTag,
    observe_virtual,
    virtual_recording,
)
from onebend.learning.design import PLACES
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import fit
from onebend.learning.start import start_of
from onebend.progress import one_blas_thread
from onebend.records import DIRECTION_SD, PLACE_SD, Array, BoolArray, Observations, rotated
from tests.lab.from_truth import observe_from_truth

BASE_TURN = np.deg2rad(1.0)  # sd of the base tag's turn on the clamp
OFFSET = 250.0  # s, log clock minus film clock
CLOCK_SAID = 1.5  # s, largest error of the stated start of the film, if the clock is found from the data


@dataclass(frozen=True)
class SimulatedRun:
    """One recording and its fit, at the 101 `PLACES`."""

    seed: int
    failure: str = ""
    error: tuple[float, ...] = ()  # of log k
    sd: tuple[float, ...] = ()  # of log k by the band, including the gain
    identified: tuple[bool, ...] = ()
    clock_error: float = 0.0  # s, worst recording
    seconds: float = 0.0


def benches(setup: forecast.Setup, seed: int) -> tuple[VirtualBench, ...]:
    """One virtual bench per push; they share tags and their errors, sensor and gain."""
    rng = np.random.default_rng([seed, 30])
    m = len(setup.tags)
    off = rng.standard_normal((m, 3)) * np.array([setup.placement_sd, setup.placement_sd, setup.turn_sd])
    tags = tuple(VirtualTag(i + 1, s, *map(float, off[i])) for i, s in enumerate(setup.tags))
    base = rng.standard_normal(3) * np.array([setup.placement_sd, setup.placement_sd, BASE_TURN])
    gain = setup.sensor.gain + setup.sensor.gain_sd * rng.standard_normal()
    sensor = replace(setup.sensor, gain=float(gain), gain_sd=0.0)
    missed = PLACE_SD / setup.beam.length * rng.standard_normal(len(setup.pushes))
    return tuple(
        VirtualBench(
            beam=setup.beam,
            push=replace(push, at_s=min(push.at_s + float(missed[i]), 1.0)),
            tags=tags,
            base=(float(base[0]), float(base[1]), float(base[2])),
            sensor=sensor,
            camera=setup.noise,
            fps=setup.fps,
            clock=VirtualClock(OFFSET, OFFSET + float(rng.uniform(-CLOCK_SAID, CLOCK_SAID)), 2.0),
            declared=DeclaredValues(
                placement_sd=setup.placement_sd, rest=setup.rest, gain_sd=setup.gain_sd, push_s=push.at_s
            ),
            name=f"push {i + 1}",
        )
        for i, push in enumerate(setup.pushes)
    )


@one_blas_thread
def simulate_run(setup: forecast.Setup, seed: int) -> SimulatedRun:
    """Film, log, observe and fit once. A failed fit is a run with its reason, not an error."""
    began = time.perf_counter()
    try:
        recordings = [_observed(setup, bench, seed * 100 + i) for i, bench in enumerate(benches(setup, seed))]
        settings = FitSettings(
            functions=forecast.FUNCTIONS, most_frames=forecast.MOST_FRAMES, allowances=frozenset()
        )  # ideal bench
        posterior = fit(recordings, start_of(recordings, None), settings=settings, gain_sd=setup.gain_sd)
    except (LearningError, MechanicsError, ObservationError) as wrong:
        return SimulatedRun(seed, failure=str(wrong), seconds=time.perf_counter() - began)
    band = posterior.band(PLACES)
    mean, own = posterior.stiffness.log_at(PLACES)
    clocks = [o.source.clock.offset - OFFSET for o in recordings if o.source.clock is not None]
    return SimulatedRun(
        seed,
        error=tuple((mean - np.log(np.asarray(setup.beam.stiffness(PLACES)))).tolist()),
        sd=tuple(np.hypot(own, setup.gain_sd).tolist()),
        identified=tuple(band.identified.tolist()),
        clock_error=float(max(clocks, key=abs, default=0.0)),
        seconds=time.perf_counter() - began,
    )


def _observed(setup: forecast.Setup, bench: VirtualBench, seed: int) -> Observations:
    virtual = virtual_recording(bench, seed=seed)
    turn = DIRECTION_SD * float(np.random.default_rng([seed, 32]).standard_normal())  # of the log's axes
    virtual = replace(virtual, log=replace(virtual.log, force=rotated(virtual.log.force, turn)))
    if math.isnan(setup.clock_sd):
        return observe_virtual(virtual)
    error = setup.clock_sd * float(np.random.default_rng([seed, 31]).standard_normal())
    return observe_from_truth(
        virtual, clock_error=error, clock_sd=0.5 * setup.clock_sd
    )  # the fit doubles the stated value


def simulate(setup: forecast.Setup, seeds: Iterable[int], *, jobs: int = 1) -> tuple[SimulatedRun, ...]:
    """One run per seed, in order, in `jobs` processes."""
    wanted = list(seeds)
    done = {run.seed: run for run in in_processes(partial(simulate_run, setup), wanted, jobs)}
    return tuple(done[seed] for seed in wanted)


def errors_of(runs: Iterable[SimulatedRun]) -> tuple[Array, Array, BoolArray]:
    """(R, 101) for the successful runs: error and sd of log k, and where k was identified."""
    good = [run for run in runs if not run.failure]
    shape = (len(good), len(PLACES))
    error, sd = (np.array([getattr(run, name) for run in good], dtype=float).reshape(shape) for name in ("error", "sd"))
    return error, sd, np.array([run.identified for run in good], dtype=bool).reshape(shape)


@dataclass(frozen=True)
class Obtained:
    """Statistics of the R successful fits at the 101 `PLACES`."""

    runs: int
    failed: int
    why_failed: tuple[str, ...]  # each once
    rms: Array  # error of log k
    median: Array  # of its size
    ninety: Array  # 90 % quantile of its size
    sd: Array  # median of the bands
    identified: Array  # share of runs that call k identified
    coverage: Array  # share of 95 % bands that hold the truth
    covered: float  # the same over identified places; NaN without any
    covered_error: float  # its standard error over runs; NaN with fewer than two


def obtained_of(runs: tuple[SimulatedRun, ...]) -> Obtained | None:
    """None if all failed."""
    error, sd, known = errors_of(runs)
    failures = [run.failure for run in runs if run.failure]
    if not len(error):
        return None
    inside = np.asarray(np.abs(error) <= half_width(sd))
    covered, doubt = _share(np.sum(inside & known, axis=1), np.sum(known, axis=1))
    return Obtained(
        runs=len(error),
        failed=len(failures),
        why_failed=tuple(dict.fromkeys(failures)),
        rms=np.sqrt(np.mean(error**2, axis=0)),
        median=np.median(np.abs(error), axis=0),
        ninety=np.quantile(np.abs(error), 0.9, axis=0),
        sd=np.median(sd, axis=0),
        identified=np.mean(known, axis=0),
        coverage=np.mean(inside, axis=0),
        covered=covered,
        covered_error=doubt,
    )


def _share(hits: Array, counts: Array) -> tuple[float, float]:
    """Sum of hits (R,) over sum of counts (R,), and its linearised standard error."""
    total = float(np.sum(counts))
    if total == 0.0:
        return nan, nan
    value, n = float(np.sum(hits)) / total, len(hits)
    spread = np.sqrt(np.sum((hits - value * counts) ** 2) * n / (n - 1)) / total if n > 1 else nan
    return value, float(spread)
