"""The twelve recordings, filmed and observed. Those that exist already are used again."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from onebend.lab.filming.film import film
from onebend.lab.virtual import observe_virtual, virtual_recording
from onebend.recording.folder import read_recording
from onebend.recording.observe import ObserveSettings, observe
from onebend.records import Observations
from onebend.results.observations_file import load_observations, save_observations
from onebend.studies.settings import BEAMS, STRATEGIES, Strategy, StudySettings, filmed_push, name_of, seed_of

RECORDINGS, OBSERVED = "recordings", "observed"


@dataclass(frozen=True)
class FilmJob:
    """One recording to be made."""

    work: Path
    setting: StudySettings
    beam: str
    strategy: Strategy

    @property
    def name(self) -> str:
        """Of the recording."""
        return name_of(self.beam, self.strategy)

    @property
    def folder(self) -> Path:
        """Where the recording goes."""
        return self.work / RECORDINGS / self.name

    @property
    def observed(self) -> Path:
        """Where its observations go."""
        return self.work / OBSERVED / f"{self.name}.parquet"

    def load(self) -> Observations:
        """Its observations."""
        return load_observations(self.observed)


def film_jobs(work: Path, setting: StudySettings) -> list[FilmJob]:
    """All twelve, each beam's training push first."""
    return [FilmJob(work, setting, beam, strategy) for beam in BEAMS for strategy in STRATEGIES]


def make_recording(job: FilmJob) -> FilmJob:
    """Film and find the tags, unless that was done; a file is either complete or absent.

    Raises:
        RecordingError, ObservationError: as for a real recording.
    """
    if job.observed.exists():
        return job
    observations = _filmed(job) if job.setting.video else _without_video(job)
    job.observed.parent.mkdir(parents=True, exist_ok=True)
    unfinished = job.observed.with_suffix(".tmp")
    save_observations(unfinished, observations)
    unfinished.replace(job.observed)
    return job


def _filmed(job: FilmJob) -> Observations:
    if not job.folder.exists():
        unfinished = job.folder.with_name(job.name + ".unfinished")
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.parent.mkdir(parents=True, exist_ok=True)
        seed = seed_of(job.setting, job.beam, job.strategy)
        film(filmed_push(job.setting, job.beam, job.strategy), unfinished, seed=seed)
        unfinished.rename(job.folder)
    return observe(read_recording(job.folder), settings=ObserveSettings(threads=1))


def _without_video(job: FilmJob) -> Observations:
    bench = filmed_push(job.setting, job.beam, job.strategy).bench
    return observe_virtual(virtual_recording(bench, seed=seed_of(job.setting, job.beam, job.strategy)))
