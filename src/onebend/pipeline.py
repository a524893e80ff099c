"""One recording learned, others used to check it: the paper's sections IV and V in order."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from onebend.beam.model import Beam
from onebend.errors import ObservationError, ResultsError
from onebend.learning.learn import learn
from onebend.learning.outcome import Comparison, Learned
from onebend.learning.planning import PlanSettings, plan
from onebend.learning.proposals import Plan
from onebend.learning.selection import Settings
from onebend.learning.selection import pairs as trials
from onebend.learning.validation import validate
from onebend.progress import Progress, Silent
from onebend.recording.folder import read_recording
from onebend.recording.observe import Detect, ObserveSettings, observe
from onebend.recording.tags import detect_tags
from onebend.records import Observations
from onebend.results.model import read_model

SAME_LENGTH = 0.01  # of the length: a larger difference is another beam, or a wrong length_m


@dataclass(frozen=True)
class Run:
    """Everything that came out of learning one recording and validating on others."""

    learned: Learned
    observations: Observations
    validations: tuple[Comparison, ...]
    validation_observations: tuple[Observations, ...]
    stage_seconds: dict[str, float]
    video_seconds: float  # length of all videos together, to compare the stages with


def learn_recording(
    folder: Path | str,
    *,
    settings: Settings = Settings(),
    observing: ObserveSettings = ObserveSettings(),
    validate_on: Sequence[Path | str] = (),
    detect: Detect = detect_tags,
    progress: Progress = Silent(),
) -> Run:
    """Learn k(s) from the recording in `folder`, then compare the learned beam with each of `validate_on`.

    `detect` finds the tags; one that keeps what it found spares a second search of the same video.

    Raises:
        RecordingError, ObservationError, LearningError: what is wrong with the input, where, and what to do.
    """
    recording, *others = [read_recording(one) for one in (folder, *validate_on)]
    trials(settings, len(recording.tags.on_beam))  # mistakes in files and settings come out before the work
    watch = Stopwatch(progress)
    with watch.whole("observe"):
        observations = observe(recording, settings=observing, detect=detect, progress=watch)
    with watch.whole("learn"):
        learned = learn(observations, settings, progress=watch)
    with watch.whole("validate"):
        pairs = compare(
            learned.beam, [one.folder for one in others], observing=observing, detect=detect, progress=watch
        )
    seen = (observations, *(where for _, where in pairs))
    return Run(
        learned=learned,
        observations=observations,
        validations=tuple(one for one, _ in pairs),
        validation_observations=seen[1:],
        stage_seconds=watch.seconds,
        video_seconds=sum(float(one.time[-1] - one.time[0]) for one in seen),
    )


def compare(
    beam: Beam,
    folders: Sequence[Path | str],
    *,
    observing: ObserveSettings = ObserveSettings(),
    detect: Detect = detect_tags,
    progress: Progress = Silent(),
) -> list[tuple[Comparison, Observations]]:
    """The beam against each of the recordings (Tables IV to VI).

    Raises:
        ObservationError: a recording of a beam of another length; and all that `learn_recording` raises.
    """
    recordings = [read_recording(folder) for folder in folders]
    for recording in recordings:
        if abs(recording.beam.length - beam.length) > SAME_LENGTH * beam.length:
            raise ObservationError(
                f"{recording.folder}: its beam is {1000 * recording.beam.length:.4g} mm long, the learned one "
                f"{1000 * beam.length:.4g} mm. Validate on recordings of the same beam, or correct length_m"
            )
    pairs = []
    for recording in recordings:
        seen = observe(recording, settings=observing, detect=detect, progress=progress)
        pairs.append((validate(beam, seen), seen))
    return pairs


def plan_next(model: Path | str, *, settings: PlanSettings = PlanSettings(), progress: Progress = Silent()) -> Plan:
    """Which push to make next on the beam in `model`, a `model.json` or the folder that holds one.

    Raises:
        ResultsError: the file cannot be read, or holds no band on k(s).
        LearningError: no push is possible within the limits.
    """
    stored = read_model(model)
    if stored.uncertain is None or stored.bench is None:
        raise ResultsError(
            f"{model}: the model has no band on k(s), so nothing says what is not known yet. A regression gives none; "
            'learn the beam with a band (docs/method.md, "k(s) with a band")'
        )
    return plan(stored.uncertain, stored.beam, stored.bench, settings, progress=progress)


@dataclass
class Stopwatch:
    """A `Progress` that passes everything on and keeps the seconds of each stage, without those of stages inside it."""

    inner: Progress
    seconds: dict[str, float] = field(default_factory=dict)
    _open: list[list[float]] = field(default_factory=list)  # begin, and seconds of the stages inside
    _names: list[str] = field(default_factory=list)

    def start(self, stage: str, total: int | None) -> None:
        self._begin(stage)
        self.inner.start(stage, total)

    def advance(self, count: int = 1) -> None:
        self.inner.advance(count)

    def done(self) -> None:
        self._end()
        self.inner.done()

    @contextmanager
    def whole(self, stage: str) -> Iterator[None]:
        """Time a stage that has no steps to count."""
        self._begin(stage)
        yield
        self._end()

    def _begin(self, stage: str) -> None:
        self._names.append(stage)
        self.seconds.setdefault(": ".join(self._names).lower(), 0.0)
        self._open.append([time.perf_counter(), 0.0])

    def _end(self) -> None:
        name = ": ".join(self._names).lower()
        begin, inside = self._open.pop()
        self._names.pop()
        spent = time.perf_counter() - begin
        self.seconds[name] += spent - inside
        if self._open:
            self._open[-1][1] += spent
