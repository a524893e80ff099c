"""One recording learned, others used to check it: the paper's sections IV and V in order."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from onebend.learning.learn import learn
from onebend.learning.outcome import Comparison, Learned
from onebend.learning.selection import Settings
from onebend.learning.validation import validate
from onebend.progress import Progress, Silent
from onebend.records import Detections, Observations
from onebend.recording.observe import ObserveSettings, observe


@dataclass(frozen=True)
class Run:
    """Everything that came out of learning one recording and validating on others."""

    learned: Learned
    observations: Observations
    validations: tuple[Comparison, ...]
    validation_observations: tuple[Observations, ...]
    stage_seconds: dict[str, float]
    video_seconds: float  # length of the learned video, to compare the stages with


def learn_recording(
    folder: Path | str,
    *,
    settings: Settings = Settings(),
    observing: ObserveSettings = ObserveSettings(),
    validate_on: Sequence[Path | str] = (),
    detections: Detections | None = None,
    progress: Progress = Silent(),
) -> Run:
    """Learn k(s) from the recording in `folder`, then compare the learned beam with each of `validate_on`.

    `detections`: tags found earlier in the same video, so that they need not be searched again.

    Raises:
        RecordingError, ObservationError, LearningError: what is wrong with the input, where, and what to do.
    """
    watch = _Watch()
    with watch.stage("observe"):
        observations = observe(folder, settings=observing, detections=detections, progress=progress)
    with watch.stage("learn"):
        learned = learn(observations, settings, progress=progress)
    others: list[Observations] = []
    validations: list[Comparison] = []
    for other in validate_on:
        with watch.stage("validate"):
            others.append(observe(other, settings=observing, progress=progress))
            validations.append(validate(learned.beam, others[-1]))
    return Run(
        learned=learned,
        observations=observations,
        validations=tuple(validations),
        validation_observations=tuple(others),
        stage_seconds=watch.seconds,
        video_seconds=float(observations.time[-1] - observations.time[0]),
    )


@dataclass
class _Watch:
    """Seconds spent in each stage."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin
