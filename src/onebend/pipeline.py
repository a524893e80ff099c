"""Recordings learned, others used to check the beam: the paper's sections IV and V in order, then the fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.setup import SetUp
from onebend.beam.stiffness import UncertainStiffness
from onebend.errors import LearningError, ResultsError
from onebend.learning import attribution, frequencies, instruments, start, static_poses, validation
from onebend.learning.design import Plan, PlanSettings, plan
from onebend.learning.frames import with_seen_tags
from onebend.learning.optimizer import FitSettings
from onebend.learning.outcome import Comparison, Learned, Notice, modulus_notices
from onebend.learning.paper import MOST_FRAMES, RegressionSettings, pairs as trials, regress
from onebend.learning.posterior import Posterior, fit
from onebend.learning.run import Run as Run
from onebend.learning.verdict import fit_notices, mass_notices
from onebend.progress import Progress, Silent, one_blas_thread
from onebend.recording.entries import Recording
from onebend.recording.folder import check_same_beam, check_same_length, read_recording
from onebend.recording.observe import Detect, ObserveSettings, observe
from onebend.recording.tags import detect_tags
from onebend.recording.video import KeptFrames
from onebend.records import FEW, Observations, Remark
from onebend.report.sentences import worded
from onebend.results.model import read_model

TO_BEGIN = 120  # frames that the regression learns from where the fit, which begins there, is the result


@one_blas_thread
def learn(
    folder: Recording | Path | str,
    *more: Recording | Path | str,
    settings: RegressionSettings = RegressionSettings(),
    fitting: FitSettings | None = FitSettings(),
    observing: ObserveSettings = ObserveSettings(),
    validate_on: Sequence[Path | str] = (),
    detect: Detect = detect_tags,
    frames: KeptFrames | None = None,
    progress: Progress = Silent(),
) -> Run:
    """Learn k(s) from the recording in `folder` (and `more` of the same beam), then compare it with `validate_on`.

    What is a `Recording` already is learned from as it was read.

    The paper's regression learns from the first recording; the fit begins there and uses all. `fitting` None: only the
    regression. `detect` finds the tags; one that keeps what it found spares a second search of the same video, and
    `frames` that it kept spare a second decoding. Raises `RecordingError`, `ObservationError`, `LearningError`: what is
    wrong with the input, where, and what to do.
    """
    folders, others = (folder, *more), tuple(validate_on)
    wanted = [one if isinstance(one, Recording) else read_recording(one) for one in folders]
    for one in others:
        read_recording(one)
    check_same_beam(wanted, jointly=fitting is not None)
    trials(settings, len(wanted[0].tags.on_beam) or FEW)  # mistakes in files and settings come out before the work
    every = [observe(one, settings=observing, detect=detect, frames=frames, progress=progress) for one in wanted]

    def compared(beam: Beam, found: Posterior | None) -> list[tuple[Comparison, Observations]]:
        if not others:
            return []
        return compare(
            beam,
            others,
            stiffness=None if found is None else found.stiffness,
            setup=None if found is None else instruments.setup_of(found),
            observing=observing,
            detect=detect,
            frames=frames,
            progress=progress,
        )

    return _learned(every, settings, fitting, compared, progress)


@one_blas_thread
def learn_observed(
    *observed: Observations,
    settings: RegressionSettings = RegressionSettings(),
    fitting: FitSettings | None = FitSettings(),
    progress: Progress = Silent(),
) -> Run:
    """`learn` from what was observed already: one or several recordings of one beam, none to validate on. Raises
    `LearningError`: what is wrong with the observations, and what to do."""
    return _learned(observed, settings, fitting, lambda _beam, _known: [], progress)


def _learned(
    every: Sequence[Observations],
    settings: RegressionSettings,
    fitting: FitSettings | None,
    validated: Callable[[Beam, Posterior | None], list[tuple[Comparison, Observations]]],
    progress: Progress,
) -> Run:
    """Regression, fit and validation, in order; `validated` compares the beam with other recordings."""
    seen = start.with_mass(with_seen_tags(every))
    learned, remarks = _regression(seen[0], settings, needed=fitting is None, progress=progress)
    posterior = None
    if fitting is not None:
        posterior, said = _fit(seen, learned, fitting, progress)
        remarks += said
    beam, trainings = _result(seen, learned, posterior)
    sized = posterior is not None and not any(one.about == attribution.NO_MATERIAL for one in posterior.contradictions)
    remarks += modulus_notices(beam, posterior.stiffness if posterior is not None and sized else None, seen)
    pairs, said = _not_learned_from(validated(beam, posterior), seen)
    remarks += said
    failed = tuple(one.name for one, _ in pairs if one.failed)
    if posterior is not None and failed:  # else what was computed of it is kept
        posterior = replace(posterior, contradicted_by=failed)
    return Run(
        beam=beam,
        learned=learned,
        posterior=posterior,
        recordings=seen,
        trainings=trainings,
        validations=tuple(one for one, _ in pairs),
        validation_observations=tuple(where for _, where in pairs),
        remarks=worded(remarks),
    )


def _not_learned_from(
    pairs: list[tuple[Comparison, Observations]], seen: Sequence[Observations]
) -> tuple[list[tuple[Comparison, Observations]], tuple[Notice, ...]]:
    """The comparisons that validate; a warning on each with data that the beam was learned from, copied or not."""
    known = [any(_same_data(other, one) for one in seen) for _, other in pairs]
    notices = tuple(
        Notice("no validation: left out", {"recording": comparison.name})
        for (comparison, _), learned in zip(pairs, known, strict=True)
        if learned
    )
    return [pair for pair, learned in zip(pairs, known, strict=True) if not learned], notices


def _same_data(one: Observations, other: Observations) -> bool:
    (one,), (other,) = with_seen_tags([one]), with_seen_tags([other])
    same = np.array_equal(one.xy, other.xy, equal_nan=True) and np.array_equal(one.force, other.force, equal_nan=True)
    return same and one.frequencies == other.frequencies


def _regression(
    seen: Observations, settings: RegressionSettings, *, needed: bool, progress: Progress
) -> tuple[Learned | None, tuple[Notice | Remark, ...]]:
    """The paper's result; None, and a warning with the reason, where it finds no beam but is not needed."""
    if seen.static and not needed:
        return None, (Notice("no regression of poses"),)
    try:
        learned = regress(seen, settings, most_frames=MOST_FRAMES if needed else TO_BEGIN, progress=progress)
    except LearningError as error:
        if needed:
            raise
        return None, (Notice("no regression", {"why": error}),)
    except np.linalg.LinAlgError as error:
        why = f"{seen.source.name}: the regression's equations cannot be solved ({error})"
        if not np.isfinite(seen.force_sd).all():
            why = (
                f"{seen.source.name}: the force log shows no rest, so neither its zero nor its noise is known. Film "
                "and log some still seconds before and after the push"
            )
        if needed:
            raise LearningError(why) from error
        return None, (Notice("no regression", {"why": why}),)
    return learned, learned.remarks


def _fit(
    seen: Sequence[Observations], learned: Learned | None, fitting: FitSettings, progress: Progress
) -> tuple[Posterior, tuple[Notice | Remark, ...]]:
    """The fit over all recordings, and what is to be said of it.

    All forces are taken to come from one sensor: its scale error is common, so more recordings do not average it out.
    Raises `LearningError` where several recordings have no beam in common.
    """
    gain_sd = max(one.stated.gain_sd for one in seen)
    posterior = fit(seen, start.start_of(seen, learned), settings=fitting, gain_sd=gain_sd, progress=progress)
    if len(seen) > 1 and posterior.misses:
        reasons = "; ".join(f"{one.name}: {one.words}" for one in posterior.misses)
        raise LearningError(
            f"the recordings do not agree on one beam. {reasons}. Learn from each alone, and keep together those whose "
            "k(s) agree"
        )
    notices: tuple[Notice | Remark, ...] = fit_notices(posterior) + frequencies.frequency_notices(posterior.frequencies)
    notices += mass_notices(posterior.mass)
    notices += static_poses.stated_notices(seen, posterior.stiffness)
    if len({one.stated.gain_sd for one in seen if one.source.clean_force is not None}) > 1:
        notices += (Notice("several gains", {"sd": gain_sd}),)
    return posterior, notices


def _result(
    seen: Sequence[Observations], learned: Learned | None, posterior: Posterior | None
) -> tuple[Beam, tuple[Comparison, ...]]:
    if posterior is not None:
        beam = posterior.beam
        return beam, tuple(validation.validate(beam, one) for one in seen)
    assert learned is not None  # where only the regression is asked for, it raises
    return learned.beam, (learned.training,)


@one_blas_thread
def compare(
    beam: Beam,
    folders: Sequence[Path | str],
    *,
    learned_from: Sequence[Observations] = (),
    stiffness: UncertainStiffness | None = None,
    setup: SetUp | None = None,
    observing: ObserveSettings = ObserveSettings(),
    detect: Detect = detect_tags,
    frames: KeptFrames | None = None,
    progress: Progress = Silent(),
) -> list[tuple[Comparison, Observations]]:
    """The beam against each of the recordings (Tables IV to VI); `stiffness` is its k(s) with a band, where it has one,
    `setup` that in which the recordings were made (`learning.validation.validate`). A warning stands on those that it
    was `learned_from`. Raises `ObservationError`: a recording of a beam of another length; and all that `learn`
    raises."""
    recordings = [read_recording(folder) for folder in folders]
    for recording in recordings:
        check_same_length(beam.length, recording)
    pairs = []
    for recording in recordings:
        seen = observe(recording, settings=observing, detect=detect, frames=frames, progress=progress)
        pairs.append((validation.validate(beam, seen, stiffness=stiffness, setup=setup), seen))
    return [(_warned(found, seen, learned_from), seen) for found, seen in pairs]


def _warned(found: Comparison, seen: Observations, learned_from: Sequence[Observations]) -> Comparison:
    pairs = ((one.xy, one.frequencies) for one in learned_from)
    if not any(np.array_equal(xy, seen.xy, equal_nan=True) and swings == seen.frequencies for xy, swings in pairs):
        return found
    return replace(found, remarks=(Notice("no validation", {"recording": found.name}), *found.remarks))


@one_blas_thread
def plan_next(model: Path | str, *, settings: PlanSettings = PlanSettings(), progress: Progress = Silent()) -> Plan:
    """Which push to make next on the beam in `model`, a `model.json` or the folder that holds one. Raises
    `ResultsError`: the file cannot be read, or holds no band on k(s). Raises `LearningError`: no push is possible
    within the limits."""
    stored = read_model(model)
    if stored.bench is None and stored.uncertain is not None:
        raise ResultsError(
            f"{model}: the beam was learned without a force log, so nothing says how well a push would be measured. "
            "Film one push with a log, and learn from it"
        )
    if stored.uncertain is None or stored.bench is None:
        raise ResultsError(
            f"{model}: the model has no band on k(s), so nothing says what is not known yet. A regression gives none; "
            'learn the beam with a band (docs/method.md, "The fit")'
        )
    return plan(stored.uncertain, stored.beam, stored.bench, settings, progress=progress)
