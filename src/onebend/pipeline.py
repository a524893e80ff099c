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
    watch = Stopwatch(progress)
    with watch.whole("observe"):
        observations = observe(folder, settings=observing, detections=detections, progress=watch)
    with watch.whole("learn"):
        learned = learn(observations, settings, progress=watch)
    others: list[Observations] = []
    validations: list[Comparison] = []
    for other in validate_on:
        with watch.whole("validate"):
            others.append(observe(other, settings=observing, progress=watch))
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
class Stopwatch:
    """A `Progress` that passes everything on and keeps the seconds of each stage."""

    inner: Progress
    seconds: dict[str, float] = field(default_factory=dict)
    _open: list[tuple[str, float]] = field(default_factory=list)

    def start(self, stage: str, total: int | None) -> None:
        self._open.append((stage, time.perf_counter()))
        self.inner.start(stage, total)

    def advance(self, count: int = 1) -> None:
        self.inner.advance(count)

    def done(self) -> None:
        stage, begin = self._open.pop()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin
        self.inner.done()

    @contextmanager
    def whole(self, stage: str) -> Iterator[None]:
        """Time a stage that has no steps to count; stages inside it are listed on their own as well."""
        begin = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin
