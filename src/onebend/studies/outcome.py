"""All results of a study, gathered from its files; tables, figures and page are made from them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from onebend.beam.model import Beam
from onebend.blas import one_blas_thread
from onebend.lab.designs import DESIGNS, Design
from onebend.learning.outcome import Comparison
from onebend.learning.validation import validate
from onebend.progress import Progress, Silent, track
from onebend.records import Array, Observations
from onebend.studies.films import FilmJob
from onebend.studies.learned import LearnedBeam, LearnJob
from onebend.studies.manipulation import TaskResult, manipulate
from onebend.studies.settings import BEAMS, Strategy, StudySettings, gain_of, seen_through

S = np.linspace(0.0, 1.0, 401)
INNER = 0.95  # beyond this s a push at the tip bends nothing that could be seen


@dataclass(frozen=True)
class ValidatedFilm:
    """One recording against the beams: learned, and true."""

    strategy: Strategy
    observations: Observations
    paper: Comparison | None
    fit: Comparison
    true: Comparison  # the true beam under the logged force: no learner can do better, except by chance


@dataclass(frozen=True)
class BeamOutcome:
    """One beam."""

    name: str
    design: Design
    gain: float
    true: Beam  # as the force's scale shows it: k is `gain` times the design's
    learned: LearnedBeam
    films: tuple[ValidatedFilm, ...]  # the training push first
    tasks: tuple[TaskResult, ...]

    def error(self, beam: Beam) -> float:
        """RMS over s of log k against the true k as seen through the force's scale, up to `INNER`."""
        s = S[S <= INNER]
        ratio = np.log(np.asarray(beam.stiffness(s)) / np.asarray(self.true.stiffness(s)))
        return float(np.sqrt(np.mean(ratio**2)))

    @property
    def inside(self) -> float:
        """Share of s, up to `INNER`, at which the 95 % band holds the true k as seen through the force's scale."""
        s = S[S <= INNER]
        band, k = self.learned.uncertain.band(s), np.asarray(self.true.stiffness(s))
        return float(np.mean((band.low <= k) & (k <= band.high)))


@dataclass(frozen=True)
class StudyOutcome:
    """The whole run."""

    work: Path  # where its recordings are
    setting: StudySettings
    gain: float
    beams: tuple[BeamOutcome, ...]


@one_blas_thread
def gather(
    work: Path,
    setting: StudySettings,
    films: list[FilmJob],
    learned: dict[str, LearnJob],
    *,
    progress: Progress = Silent(),
) -> StudyOutcome:
    """Compare the beams with all recordings, solve the tasks, and collect the results."""
    gain = gain_of(setting)
    beams = track(progress, "comparing and manipulating", BEAMS, len(BEAMS))
    return StudyOutcome(
        work, setting, gain, tuple(beam_outcome(name, gain, films, learned[name].load()) for name in beams)
    )


def beam_outcome(name: str, gain: float, films: list[FilmJob], learned: LearnedBeam) -> BeamOutcome:
    """One beam: its films compared, its tasks done."""
    design = DESIGNS[name]
    true = seen_through(design, gain).beam()
    compared = tuple(_validated(job, learned, true) for job in films if job.beam == name)
    tasks = tuple(manipulate(name, learned.fit, learned.paper, true))
    return BeamOutcome(name, design, gain, true, learned, compared, tasks)


def _validated(job: FilmJob, learned: LearnedBeam, true: Beam) -> ValidatedFilm:
    observations = job.load()
    return ValidatedFilm(
        strategy=job.strategy,
        observations=observations,
        paper=None if learned.paper is None else validate(learned.paper, observations),
        fit=validate(learned.fit, observations),
        true=validate(true, observations),
    )


def rms_or_nan(comparison: Comparison | None, count: int = 3) -> Array:
    """(m,) m; NaN where there was no beam to compare."""
    return np.full(count, np.nan) if comparison is None else comparison.rms
