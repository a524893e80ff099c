"""Each beam learned from its training push alone, by the paper's method and by the fit; kept in files."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.blas import one_blas_thread
from onebend.errors import LearningError, ResultsError
from onebend.learning.design.instruments import instruments_of
from onebend.learning.model.rest import at_rest
from onebend.learning.outcome import Trial
from onebend.learning.paper.learn import regress
from onebend.learning.paper.selection import RegressionSettings, choose, table
from onebend.learning.posterior import Posterior, fit
from onebend.learning.start import start_of
from onebend.learning.validation import validate
from onebend.learning.verdict import fit_remarks, fitted_rms
from onebend.progress import Silent
from onebend.records import Array, Observations
from onebend.results.model import read_model, save_model
from onebend.results.observations_file import load_observations
from onebend.results.origin import origin_of
from onebend.studies.printed import MOST_MODES

PAPER = RegressionSettings(method="paper", bic="paper", most_n=MOST_MODES)
FIT_FILE, PAPER_FILE, FACTS_FILE = "model.json", "paper-model.json", "facts.json"


@dataclass(frozen=True)
class LearnedBeam:
    """What was learned from one training push."""

    trials: tuple[Trial, ...]  # Tables I to III
    chosen: int | None  # index in `trials`; None where no (n, m) gave a beam
    paper: Beam | None  # by the paper's method
    fit: Beam  # by the fit, onebend's default
    uncertain: UncertainStiffness  # its k(s) with the band
    fitted_rms: Array  # (m,) m, tags to the fit, the force's slow error and the rest taken off
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class LearnJob:
    """One beam to be learned."""

    folder: Path
    training: Path  # observations of the slow push
    written_by: str

    def load(self) -> LearnedBeam:
        """What was learned. Raises `ResultsError` where its files are damaged."""
        return _load(self.folder)


def learn_beam(job: LearnJob) -> LearnJob:
    """Learn, unless that was done.

    Raises:
        LearningError: the push does not determine a beam.
    """
    if not (job.folder / FACTS_FILE).exists():
        observations = load_observations(job.training)
        job.folder.mkdir(parents=True, exist_ok=True)
        trials, chosen, paper = by_paper(observations)
        _save(job, observations, trials, chosen, paper, by_fit(observations))
    return job


@one_blas_thread
def by_paper(observations: Observations) -> tuple[tuple[Trial, ...], int | None, Beam | None]:
    """The literal regression (17), (18) with tags' positions, over n = 2..5, m = 2..n (20): table, choice, beam."""
    candidates = table(observations, at_rest(observations), PAPER, Silent())
    trials = tuple(candidate.trial for candidate in candidates)
    try:
        chosen = choose(candidates)
    except LearningError:
        return trials, None, None
    return trials, chosen, candidates[chosen].beam


def by_fit(observations: Observations) -> Posterior:
    """What `onebend learn` does: the regression with the tags' angles, and the fit from there."""
    try:
        start = regress(observations)
    except LearningError:
        start = None
    return fit([observations], start_of([observations], start), gain_sd=observations.stated.gain_sd)


def _save(
    job: LearnJob,
    observations: Observations,
    trials: tuple[Trial, ...],
    chosen: int | None,
    paper: Beam | None,
    posterior: Posterior,
) -> None:
    """Write all files of a beam, the facts last: where that file exists, all do."""
    if paper is not None:
        save_model(job.folder / PAPER_FILE, paper, written_by=job.written_by)
    save_model(
        job.folder / FIT_FILE,
        posterior.beam,
        written_by=job.written_by,
        origin=origin_of(None, posterior, (validate(posterior.beam, observations),)),
        uncertain=posterior.stiffness,
        bench=instruments_of(posterior),
    )
    facts = {
        "trials": [
            asdict(trial) | {"coefficients": trial.coefficients.tolist(), "rms": trial.rms.tolist()} for trial in trials
        ],
        "chosen": chosen,
        "fitted_rms_m": fitted_rms(posterior)[0].tolist(),
        "remarks": [f"{remark.level}: {remark.text}" for remark in fit_remarks(posterior)],
    }
    unfinished = job.folder / "facts.tmp"
    unfinished.write_text(json.dumps(facts, indent=1), encoding="utf-8")  # NaN and infinity as Python writes them
    unfinished.replace(job.folder / FACTS_FILE)


def _load(folder: Path) -> LearnedBeam:
    try:
        facts = json.loads((folder / FACTS_FILE).read_text(encoding="utf-8"))
        trials = tuple(_trial(trial) for trial in facts["trials"])
        stored = read_model(folder / FIT_FILE)
        if stored.uncertain is None:
            raise ResultsError(f"{folder / FIT_FILE}: holds no band. Remove the folder and run again")
        return LearnedBeam(
            trials=trials,
            chosen=facts["chosen"],
            paper=None if facts["chosen"] is None else read_model(folder / PAPER_FILE).beam,
            fit=stored.beam,
            uncertain=stored.uncertain,
            fitted_rms=np.asarray(facts["fitted_rms_m"], dtype=float),
            remarks=tuple(facts["remarks"]),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ResultsError(f"{folder}: its files are damaged ({error}). Remove the folder and run again") from error


def _trial(data: dict[str, Any]) -> Trial:
    arrays = {name: np.asarray(data[name], dtype=float) for name in ("coefficients", "rms")}
    return Trial(**{**data, **arrays})
