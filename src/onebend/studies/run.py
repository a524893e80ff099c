"""The whole study in order: recordings, learning, comparison. What an earlier run finished is used again."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from onebend.errors import ResultsError
from onebend.progress import Progress, Silent, track
from onebend.studies.films import film_jobs, make_recording
from onebend.studies.learned import LearnJob, learn_beam
from onebend.studies.outcome import StudyOutcome, gather
from onebend.studies.settings import BEAMS, STRATEGIES, StudySettings
from onebend.workers import available_cores, interrupts_held, leave_interrupts_to_parent

SETTING_FILE, LEARNED = "setting.json", "learned"
Job = TypeVar("Job")


def reproduce(
    work: Path,
    setting: StudySettings = StudySettings(),
    *,
    written_by: str,
    processes: int = 0,
    progress: Progress = Silent(),
) -> StudyOutcome:
    """Film, learn and compare in `work`, going on from what an earlier run with the same setting left there.

    Args:
        processes: that work at once; 0: one a core.

    Raises:
        ResultsError: `work` holds the work of another setting.
    """
    claim(work, setting)
    count = processes or available_cores()
    films = film_jobs(work, setting)
    run_jobs(make_recording, films, count, "filming and finding tags" if setting.video else "pushing", progress)
    training = STRATEGIES[0].name
    wanted = {
        job.beam: LearnJob(work / LEARNED / job.beam, job.observed, written_by)
        for job in films
        if job.strategy.name == training
    }
    run_jobs(learn_beam, [wanted[name] for name in BEAMS], count, "learning from the training push", progress)
    return gather(work, setting, films, wanted, progress=progress)


def claim(work: Path, setting: StudySettings) -> None:
    """Write the settings into the working folder, or check that they are the same as those there."""
    file = work / SETTING_FILE
    text = json.dumps(setting.as_dict(), sort_keys=True)
    if file.exists():
        if file.read_text(encoding="utf-8") != text:
            raise ResultsError(
                f"{work}: holds the unfinished work of a run with other settings. Remove it, or choose another -o"
            )
        return
    work.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")


def run_jobs(do: Callable[[Job], Job], jobs: Sequence[Job], processes: int, stage: str, progress: Progress) -> None:
    """Do all jobs, in processes of their own where there are several; one that fails or an interrupt ends them all."""
    count = min(processes, len(jobs))
    if count <= 1:
        for job in track(progress, stage, jobs, len(jobs)):
            do(job)
        return
    with interrupts_held():
        workers = multiprocessing.get_context("spawn").Pool(count, initializer=leave_interrupts_to_parent)
    with workers as pool:
        for _ in track(progress, stage, pool.imap_unordered(do, jobs), len(jobs)):
            pass
