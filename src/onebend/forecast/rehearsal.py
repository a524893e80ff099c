"""A rehearsal: the predicted band, what simulated recordings give, the uncertainty budget, what to change."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from onebend.beam.profiles.uncertain import half_width
from onebend.blas import one_blas_thread
from onebend.errors import LearningError
from onebend.forecast.advice import SetupChange, advise
from onebend.forecast.prediction import BudgetEntry, PredictedBand, predict, ranges, uncertainty_budget
from onebend.forecast.runs import SimulatedRun, errors_of, simulate
from onebend.forecast.setup import Setup, check_bending
from onebend.learning.design.proposals import PLACES, direction_words
from onebend.progress import Progress, Silent
from onebend.records import Array

MEDIAN, NINETY = 0.674490, 1.644854  # of |z|, z normal


@dataclass(frozen=True)
class Obtained:
    """What the fits gave, along the 101 places of `PLACES`; R fits succeeded."""

    runs: int
    failed: int
    why_failed: tuple[str, ...]  # the reasons, each once
    rms: Array  # of the error of log k
    median: Array  # of its size
    ninety: Array  # nine in ten are no larger
    sd: Array  # median, of the bands
    identified: Array  # share of the runs that call k identified here
    coverage: Array  # share of the 95 % bands that hold the truth here
    covered: float  # the same over the places that the fits call identified; NaN where there are none
    covered_error: float  # its standard error, from run to run; NaN with fewer than two runs


@dataclass(frozen=True)
class Rehearsal:
    """How well k(s) of a setup would come out."""

    setup: Setup
    seed: int
    predicted: PredictedBand
    budget: tuple[BudgetEntry, ...]  # the most costly nuisance first
    advice: tuple[SetupChange, ...]  # the most helpful change first
    runs: tuple[SimulatedRun, ...]

    @property
    def obtained(self) -> Obtained | None:
        """None where nothing was simulated, or no fit came out."""
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
            "predicted": {
                **said,
                "identified": ranges(p.identified),
                "band": vars(p.quality),
            },
            "obtained": None
            if o is None
            else {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(o).items()},
            "uncertainty_budget": [vars(entry) for entry in self.budget],
            "advice": [change.as_dict() for change in self.advice],
        }


@one_blas_thread
def rehearse(
    setup: Setup,
    *,
    runs: int = 24,
    seed: int = 0,
    jobs: int = 1,
    keep: Path | None = None,
    count: int = 8,
    progress: Progress = Silent(),
) -> Rehearsal:
    """How well k(s) would be known from a setup: by its Fisher information, and from `runs` simulated recordings.

    Run i has the seed `seed` + i. With `jobs` > 1 the runs are shared between processes. With a folder `keep` each
    run is kept there as it ends, and work that was interrupted goes on from it.

    Raises:
        LearningError: a number of runs or processes that cannot be.
        MechanicsError: the beam buckles or snaps through under a push, hardly bends, or bends too far.
    """
    if runs < 0 or jobs < 1 or seed < 0:
        raise LearningError(f"a rehearsal needs runs >= 0, jobs >= 1 and seed >= 0, got {runs}, {jobs} and {seed}")
    check_bending(setup)
    predicted = predict(setup)
    budget = uncertainty_budget(setup, predicted)
    changes = advise(setup, predicted, count=count, progress=progress)
    done = simulate(setup, range(seed, seed + runs), jobs=jobs, keep=keep, progress=progress) if runs else ()
    return Rehearsal(setup, seed, predicted, budget, changes, done)


def obtained_of(runs: tuple[SimulatedRun, ...]) -> Obtained | None:
    """What the fits gave; None where all failed."""
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
    """Sum of hits (R,) over sum of counts (R,), and its standard error: linearised, runs are independent."""
    total = float(np.sum(counts))
    if total == 0.0:
        return nan, nan
    value, n = float(np.sum(hits)) / total, len(hits)
    spread = np.sqrt(np.sum((hits - value * counts) ** 2) * n / (n - 1)) / total if n > 1 else nan
    return value, float(spread)


def setup_words(setup: Setup) -> str:
    """The setup in one line."""
    pushes = "; ".join(f"s = {p.at_s:.2f}, {direction_words(p.direction)}, to {p.peak:.3g} N" for p in setup.pushes)
    return f"{setup.name}: tags at s = {', '.join(f'{s:.3g}' for s in setup.tags)}; pushed at {pushes}"
