"""Simulated recordings of a setup, each fitted like a real one: k(s) is the same in all, every error is drawn anew."""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from onebend.blas import one_blas_thread
from onebend.errors import LearningError, MechanicsError, ObservationError
from onebend.forecast.instruments import FUNCTIONS, MOST_FRAMES
from onebend.forecast.setup import Setup
from onebend.lab.direct_observation import observe_from_truth
from onebend.lab.virtual import (
    DeclaredValues,
    VirtualBench,
    VirtualClock,
    VirtualRecording,
    VirtualTag,
    observe_virtual,
    virtual_recording,
)
from onebend.learning.design.proposals import PLACES
from onebend.learning.inference.stages import FitSettings
from onebend.learning.posterior import fit
from onebend.learning.start import start_of
from onebend.progress import Progress, Silent, track
from onebend.records import DIRECTION_SD, PLACE_SD, Array, BoolArray, Observations
from onebend.workers import interrupts_held, leave_interrupts_to_parent

BASE_TURN = np.deg2rad(1.0)  # one sd of the base tag's turn on the clamp
OFFSET = 250.0  # s, of the log's clock against the film's
CLOCK_SAID = 1.5  # s, largest error of the film's start as written down, where the clock is found from the data


@dataclass(frozen=True)
class SimulatedRun:
    """One recording and its fit, at the 101 places of `PLACES`."""

    seed: int
    failure: str = ""
    error: tuple[float, ...] = ()  # of log k
    sd: tuple[float, ...] = ()  # of log k as the band has it, the gain included
    identified: tuple[bool, ...] = ()
    clock_error: float = 0.0  # s, of the worst recording
    seconds: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """For JSON, sizes to five digits."""
        numbers = {name: [float(f"{v:.5g}") for v in getattr(self, name)] for name in ("error", "sd")}
        return vars(self) | numbers | {"identified": "".join("01"[v] for v in self.identified)}

    @staticmethod
    def from_dict(data: dict[str, Any]) -> SimulatedRun:
        """From `as_dict`."""
        changed = {"error": tuple(data["error"]), "sd": tuple(data["sd"])}
        return SimulatedRun(**(data | changed | {"identified": tuple(v == "1" for v in data["identified"])}))


def benches(setup: Setup, seed: int) -> tuple[VirtualBench, ...]:
    """One virtual bench per push: all have the same tags with the same errors, and one sensor with one gain."""
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
def simulate_run(setup: Setup, seed: int) -> SimulatedRun:
    """Film, log, observe and fit once. A fit that fails is a run with its reason, not an error."""
    began = time.perf_counter()
    try:
        recordings = [_observed(setup, bench, seed * 100 + i) for i, bench in enumerate(benches(setup, seed))]
        settings = FitSettings(
            functions=FUNCTIONS, most_frames=MOST_FRAMES, allowances=frozenset()
        )  # the bench is ideal
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


def _observed(setup: Setup, bench: VirtualBench, seed: int) -> Observations:
    virtual = _axes_missed(virtual_recording(bench, seed=seed), seed)
    if math.isnan(setup.clock_sd):
        return observe_virtual(virtual)
    error = setup.clock_sd * float(np.random.default_rng([seed, 31]).standard_normal())
    return observe_from_truth(
        virtual, clock_error=error, clock_sd=0.5 * setup.clock_sd
    )  # the fit doubles what is stated


def _axes_missed(virtual: VirtualRecording, seed: int) -> VirtualRecording:
    """The same with the force log's axes turned by a drawn error."""
    turn = DIRECTION_SD * float(np.random.default_rng([seed, 32]).standard_normal())
    cos, sin = np.cos(turn), np.sin(turn)
    force = virtual.log.force @ np.array([[cos, sin], [-sin, cos]])
    return replace(virtual, log=replace(virtual.log, force=force))


def simulate(
    setup: Setup,
    seeds: Iterable[int],
    *,
    jobs: int = 1,
    keep: Path | None = None,
    progress: Progress = Silent(),
) -> tuple[SimulatedRun, ...]:
    """A run for every seed, in that order; `jobs` processes. Those in the folder `keep` are taken from there, and each
    new one is added as it ends, so that work that was interrupted goes on."""
    wanted = list(seeds)
    file = None if keep is None else keep / f"runs-{key_of(setup)}.jsonl"
    done = {} if file is None else read_runs(file)
    todo = [seed for seed in wanted if seed not in done]
    for run in track(progress, "pushing simulated beams", _each(setup, todo, jobs), len(todo)):
        done[run.seed] = run
        if file is not None:
            with file.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps(run.as_dict()) + "\n")
    return tuple(done[seed] for seed in wanted)


def read_runs(file: Path) -> dict[int, SimulatedRun]:
    """Runs done before. A line that was cut off is left out, and done again."""
    found: dict[int, SimulatedRun] = {}
    if file.is_file():
        for line in file.read_text(encoding="utf-8").splitlines():
            try:
                run = SimulatedRun.from_dict(json.loads(line))
            except (json.JSONDecodeError, KeyError, TypeError):
                continue
            found[run.seed] = run
    return found


def key_of(setup: Setup) -> str:
    """A name for all that a run depends on, but for its seed."""
    return hashlib.sha256(repr(setup).encode()).hexdigest()[:16]


def _each(setup: Setup, seeds: list[int], jobs: int) -> Iterator[SimulatedRun]:
    """Runs as they end. Workers do not answer to an interrupt: the parent does, and ends them."""
    if jobs <= 1 or len(seeds) <= 1:
        yield from (simulate_run(setup, seed) for seed in seeds)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(jobs, len(seeds)), mp_context=context, initializer=leave_interrupts_to_parent)
    waiting: set[Future[SimulatedRun]] = set()
    try:
        with interrupts_held():
            waiting = {pool.submit(simulate_run, setup, seed) for seed in seeds}
        for future in as_completed(tuple(waiting)):
            waiting.discard(future)
            yield future.result()
    finally:
        for process in list((getattr(pool, "_processes", None) or {}).values()) if waiting else ():
            process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


def errors_of(runs: Iterable[SimulatedRun]) -> tuple[Array, Array, BoolArray]:
    """(R, 101) of the runs that came out: error and sd of log k, and where k was identified."""
    good = [run for run in runs if not run.failure]
    shape = (len(good), len(PLACES))
    error, sd = (np.array([getattr(run, name) for run in good], dtype=float).reshape(shape) for name in ("error", "sd"))
    return error, sd, np.array([run.identified for run in good], dtype=bool).reshape(shape)
