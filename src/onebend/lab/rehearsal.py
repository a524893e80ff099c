"""A rehearsal: predicted band, simulated recordings, uncertainty budget, advice."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from functools import partial
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from onebend.beam.stiffness import half_width
from onebend.errors import LearningError, MechanicsError, ObservationError
from onebend.lab import forecast
from onebend.lab.bench import turned
from onebend.lab.virtual import (
    DeclaredValues,
    VirtualBench,
    VirtualClock,
    VirtualTag,
    observe_from_truth,
    observe_virtual,
    virtual_recording,
)
from onebend.learning.design import PLACES
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import fit
from onebend.learning.start import start_of
from onebend.progress import Progress, Silent, in_processes, one_blas_thread, track
from onebend.records import DIRECTION_SD, PLACE_SD, Array, BoolArray, Observations
from onebend.report.sentences import direction_words
from onebend.report.style import BLUE, FAINT, INK, MUTED, ORANGE, blank, styled
from onebend.results.tables import write_csv
from onebend.text_files import figure_text

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

    def as_dict(self) -> dict[str, Any]:
        """For JSON, to five digits."""
        numbers = {name: [float(f"{v:.5g}") for v in getattr(self, name)] for name in ("error", "sd")}
        return asdict(self) | numbers | {"identified": "".join("01"[v] for v in self.identified)}


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
    virtual = replace(virtual, log=replace(virtual.log, force=turned(virtual.log.force, turn)))
    if math.isnan(setup.clock_sd):
        return observe_virtual(virtual)
    error = setup.clock_sd * float(np.random.default_rng([seed, 31]).standard_normal())
    return observe_from_truth(
        virtual, clock_error=error, clock_sd=0.5 * setup.clock_sd
    )  # the fit doubles the stated value


def simulate(
    setup: forecast.Setup,
    seeds: Iterable[int],
    *,
    jobs: int = 1,
    progress: Progress = Silent(),
) -> tuple[SimulatedRun, ...]:
    """One run per seed, in order, in `jobs` processes."""
    wanted = list(seeds)
    made = in_processes(partial(simulate_run, setup), wanted, jobs)
    done = {run.seed: run for run in track(progress, "pushing simulated beams", made, len(wanted))}
    return tuple(done[seed] for seed in wanted)


def errors_of(runs: Iterable[SimulatedRun]) -> tuple[Array, Array, BoolArray]:
    """(R, 101) for the successful runs: error and sd of log k, and where k was identified."""
    good = [run for run in runs if not run.failure]
    shape = (len(good), len(PLACES))
    error, sd = (np.array([getattr(run, name) for run in good], dtype=float).reshape(shape) for name in ("error", "sd"))
    return error, sd, np.array([run.identified for run in good], dtype=bool).reshape(shape)


MEDIAN, NINETY = 0.674490, 1.644854  # of |z| for a normal z


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


@dataclass(frozen=True)
class Rehearsal:
    setup: forecast.Setup
    seed: int
    predicted: forecast.PredictedBand
    budget: tuple[forecast.BudgetEntry, ...]  # most costly first
    advice: tuple[forecast.SetupChange, ...]  # best first
    runs: tuple[SimulatedRun, ...]

    @property
    def obtained(self) -> Obtained | None:
        """None without simulation or successful fits."""
        return obtained_of(self.runs)

    def as_dict(self) -> dict[str, Any]:
        """For JSON, in SI."""
        s, p, o = self.setup, self.predicted, self.obtained
        pushes = [{"at_s": x.at_s, "direction_rad": x.direction, "peak_N": x.peak} for x in s.pushes]
        asked = {"name": s.name, "length_m": s.beam.length, "tags_s": list(s.tags), "pushes": pushes}
        tolerances = {"gain_sd": s.gain_sd, "placement_sd_m": s.placement_sd, "turn_sd_rad": s.turn_sd}
        said = {name: getattr(p, name).tolist() for name in ("k", "sd", "own_sd", "scatter", "bias", "error")}
        return {
            "setup": {**asked, **tolerances, "clock_sd_s": s.clock_sd, "fps": s.fps},
            "seed": self.seed,
            "s": PLACES.tolist(),
            "predicted": {**said, "identified": forecast.ranges(p.identified), "band": asdict(p.quality)},
            "obtained": None if o is None else asdict(o),
            "uncertainty_budget": [asdict(entry) for entry in self.budget],
            "advice": [change.as_dict() for change in self.advice],
        }


@one_blas_thread
def rehearse(
    setup: forecast.Setup,
    *,
    runs: int = 24,
    seed: int = 0,
    jobs: int = 1,
    count: int = 8,
    progress: Progress = Silent(),
) -> Rehearsal:
    """Expected accuracy of k(s) for a setup: by Fisher information, and from `runs` simulated recordings.

    Run i has seed `seed` + i. `jobs` > 1 uses that many processes.

    Raises:
        LearningError: invalid number of runs or processes.
        MechanicsError: the beam buckles, snaps through, hardly bends, or bends too far.
    """
    if runs < 0 or jobs < 1 or seed < 0:
        raise LearningError(f"a rehearsal needs runs >= 0, jobs >= 1 and seed >= 0, got {runs}, {jobs} and {seed}")
    forecast.check_bending(setup)
    predicted = forecast.predict(setup)
    budget = forecast.uncertainty_budget(setup, predicted)
    changes = forecast.advise(setup, predicted, count=count, progress=progress)
    done = simulate(setup, range(seed, seed + runs), jobs=jobs, progress=progress) if runs else ()
    return Rehearsal(setup, seed, predicted, budget, changes, done)


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


def setup_words(setup: forecast.Setup) -> str:
    pushes = "; ".join(f"s = {p.at_s:.2f}, {direction_words(p.direction)}, to {p.peak:.3g} N" for p in setup.pushes)
    return f"{setup.name}: tags at s = {', '.join(f'{s:.3g}' for s in setup.tags)}; pushed at {pushes}"


SHOWN = 40  # fits drawn as lines


@styled
def rehearsal_figure(rehearsal: Rehearsal) -> Figure:
    """k(s) with the predicted and obtained bands, and the size of the error."""
    figure, (stiffness, error) = blank(6.4, rows=2, sharex=True)
    _bands(stiffness, rehearsal)
    _errors(error, rehearsal)
    for axes in (stiffness, error):
        _marks(axes, rehearsal)
        axes.set(xlim=(0.0, 1.0), ylim=(0.0, None))
    error.set_xlabel("place along the beam s  (squares: tags; triangles: pushes)")
    return figure


def _bands(axes: Axes, rehearsal: Rehearsal) -> None:
    p, o = rehearsal.predicted, rehearsal.obtained
    k, wide = p.k, np.exp(half_width(p.sd))
    fits, _, _ = errors_of(rehearsal.runs)
    for i, error in enumerate(fits[:SHOWN]):
        axes.plot(PLACES, k * np.exp(error), color=MUTED, linewidth=0.6, alpha=0.5, label=None if i else "fits")
    axes.fill_between(PLACES, k / wide, k * wide, color=BLUE, alpha=0.2, linewidth=0.0, label="95 % band, predicted")
    if o is not None:
        obtained = np.exp(half_width(o.sd))
        style = {"color": ORANGE, "linestyle": "--", "linewidth": 1.3}
        axes.plot(PLACES, k / obtained, **style, label="95 % band, typical of the fits")  # type: ignore[arg-type]
        axes.plot(PLACES, k * obtained, **style)  # type: ignore[arg-type]
    axes.plot(PLACES, k, color=INK, label="k(s), true")
    top = float(np.max((k * wide)[_best_known(p)]))
    axes.set(ylim=(0.0, 1.45 * max(top, min(float(np.max(k)), 1.3 * top))), ylabel="k [N m]")
    axes.set_title(f"{figure_text(rehearsal.setup.name)}: how well k(s) would come out")
    axes.legend(ncols=2, loc="upper left")


def _errors(axes: Axes, rehearsal: Rehearsal) -> None:
    p, o = rehearsal.predicted, rehearsal.obtained
    curves = [(MEDIAN * p.error, NINETY * p.error, BLUE, "median, predicted", "predicted")]
    if o is not None:
        curves.append((o.median, o.ninety, ORANGE, f"median of {o.runs} fits", "of the fits"))
    for median, ninety, colour, name, whose in curves:
        axes.plot(PLACES, _percent(median), color=colour, label=name)
        axes.plot(PLACES, _percent(ninety), color=colour, linestyle=":", label=f"9 in 10 below, {whose}")
    known = _best_known(p)
    highest = [float(np.max(_percent(ninety)[known])) for _, ninety, *_ in curves]
    axes.fill_between(
        PLACES, 0.0, 2.0 * max(highest), where=~p.identified, color=FAINT, alpha=0.6, linewidth=0.0, step="mid"
    )
    axes.set(ylim=(0.0, 1.35 * max(highest)), ylabel="error of k [%]")
    axes.set_title("error along the beam" + ("" if np.all(p.identified) else " (grey: not identified)"))
    axes.legend(ncols=2, loc="upper left")


def _best_known(predicted: forecast.PredictedBand) -> BoolArray:
    """(S,) the places that set the axes: where k is known, or else its best quarter."""
    known = predicted.identified
    return np.asarray(known if np.any(known) else predicted.sd <= np.quantile(predicted.sd, 0.25))


def _percent(log_error: Array) -> Array:
    return np.asarray(100.0 * np.expm1(log_error))


def _marks(axes: Axes, rehearsal: Rehearsal) -> None:
    across = axes.get_xaxis_transform()
    tags = list(rehearsal.setup.tags)
    axes.plot(tags, [0.0] * len(tags), "s", color=INK, markersize=6, clip_on=False, transform=across, zorder=5)
    for push in rehearsal.setup.pushes:
        axes.plot([push.at_s], [0.06], "^", color=ORANGE, markersize=7, clip_on=False, transform=across, zorder=5)


REHEARSE_FORMAT = "onebend-rehearse-1"
COLUMNS = (
    *("s", "k_N_m", "predicted_sd", "predicted_median", "predicted_90", "predicted_identified"),
    *("obtained_sd", "obtained_median", "obtained_90", "obtained_identified", "coverage"),
)


def summary_of(rehearsal: Rehearsal, *, written_by: str) -> dict[str, Any]:
    return {"format": REHEARSE_FORMAT, "written_by": written_by, **rehearsal.as_dict()}


def write_table(folder: Path, rehearsal: Rehearsal) -> None:
    """`rehearsal.csv`, one row per place; sizes of log k, empty without simulation."""
    p, o = rehearsal.predicted, rehearsal.obtained
    columns = [PLACES, p.k, p.sd, MEDIAN * p.error, NINETY * p.error, p.identified]
    unknown = np.full(len(PLACES), np.nan)
    columns += [unknown] * 5 if o is None else [o.sd, o.median, o.ninety, o.identified, o.coverage]
    write_csv(
        folder / "rehearsal.csv", COLUMNS, ([_cell(value) for value in row] for row in zip(*columns, strict=True))
    )


def _cell(value: Any) -> str:
    if isinstance(value, np.bool_):
        return str(bool(value)).lower()
    return f"{value:.6g}" if np.isfinite(value) else ""
