"""The fit's two stages: a few frames of some recordings, for the way to near the optimum, and then all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from onebend.beam.profiles.stiffness import Profile
from onebend.errors import LearningError
from onebend.learning.allowances.chosen import EVERY_ALLOWANCE, AllowanceName
from onebend.learning.allowances.mounting import BETWEEN, between_recordings
from onebend.learning.frequencies.frequency_data import frequency_data
from onebend.learning.inference.descent import MapEstimate, release, with_own_forces
from onebend.learning.inference.fit_problem import FitProblem, Hyperparameters, RecordingNoise
from onebend.learning.inference.hyperparameters import expected_recording_noise
from onebend.learning.inference.optimizer import OptimizerSettings, estimate_at
from onebend.learning.known_shape import known_shape
from onebend.learning.model.fit_data import FitData, fit_data
from onebend.learning.model.frames import chosen_frames
from onebend.learning.model.parameters import Layout, Priors, make_layout
from onebend.learning.model.spline import Spline
from onebend.records import Array, BoolArray, Observations
from onebend.workers import each

_FEWEST_FRAMES = 20  # of each of very many recordings


@dataclass(frozen=True)
class FitSettings:
    """How the marker-space fit runs."""

    functions: int = 45  # of the spline of log k
    most_frames: int = 500  # of each recording, after neighbours are averaged (`condensed`)
    most_frames_together: int = 5000  # of all recordings
    first_frames: int = 24  # of each recording, for the way from the start to near the optimum
    first_recordings: int = 10  # evenly chosen, for the same
    priors: Priors = field(default_factory=Priors)
    optimizer: OptimizerSettings = field(default_factory=OptimizerSettings)
    first_rounds: int = 4  # at most, with the first frames
    last_rounds: int = 6  # at most, with all frames
    allowances: frozenset[AllowanceName] = EVERY_ALLOWANCE  # what a real beam and bench may also do


def shared_among(settings: FitSettings, recordings: int) -> FitSettings:
    """The settings for so many recordings: each gives fewer frames, the more there are."""
    each_one = max(settings.most_frames_together // recordings, _FEWEST_FRAMES)
    return replace(settings, most_frames=min(settings.most_frames, each_one))


def first_recordings(recordings: Sequence[Observations], settings: FitSettings) -> list[int]:
    """Which recordings the fit begins with."""
    evenly = np.linspace(0, len(recordings) - 1, settings.first_recordings)
    return sorted({int(i) for i in evenly.round()})


def first_problem(
    recordings: Sequence[Observations], start: Profile | float, settings: FitSettings
) -> tuple[FitProblem, Array]:
    """The problem with a few frames of some recordings, and the parameters (P,) to begin with."""
    spline = Spline(settings.functions)
    data = _data(recordings, min(settings.first_frames, settings.most_frames), spline, settings.allowances)
    layout = _layout(recordings, data, spline, settings)
    noise = tuple(expected_recording_noise(d) for d in data)
    x, level = starting(layout, start)
    expected = Hyperparameters(layout.first_variances, 1.0, 1.0, 1.0, 1.0, noise)
    return FitProblem(data, layout, level, expected, frequency_data(recordings, spline)), x


def whole_problem(recordings: Sequence[Observations], problem: FitProblem, settings: FitSettings) -> FitProblem:
    """The problem with all frames of all recordings."""
    spline = problem.layout.spline
    data = _data(recordings, settings.most_frames, spline, settings.allowances)
    noise = tuple(expected_recording_noise(d) for d in data)
    layout, expected = _layout(recordings, data, spline, settings), replace(problem.expected, noise=noise)
    return FitProblem(data, layout, problem.level, expected, frequency_data(recordings, spline))


def rewritten_problem(recordings: Sequence[Observations], problem: FitProblem, settings: FitSettings) -> FitProblem:
    """The problem with the same frames of the same recordings, of which something else is written."""
    frames = [one.frames for one in problem.recordings]
    data = _data_of(recordings, frames, problem.layout.spline, settings.allowances)
    layout = _layout(recordings, data, problem.layout.spline, settings)
    return replace(problem, recordings=data, layout=layout)


def _layout(
    recordings: Sequence[Observations], data: Sequence[FitData], spline: Spline, settings: FitSettings
) -> Layout:
    knots, allowances = [len(d.error.knots) for d in data], [d.allowances for d in data]
    return make_layout(spline, list(recordings), knots, settings.priors, allowances)


def _data(
    recordings: Sequence[Observations], most: int, spline: Spline, allowances: frozenset[AllowanceName]
) -> tuple[FitData, ...]:
    frames = each(lambda one: chosen_frames(one, most), recordings)
    return _data_of(recordings, frames, spline, allowances)


def _data_of(
    recordings: Sequence[Observations],
    frames: Sequence[BoolArray],
    spline: Spline,
    allowances: frozenset[AllowanceName],
) -> tuple[FitData, ...]:
    known = known_shape(recordings)

    def of(number: int, one: Observations, mask: BoolArray) -> FitData:
        return fit_data(one, number, mask, spline, allowances, known)

    data = each(of, range(len(recordings)), recordings, frames)
    if len(data) == 1 or BETWEEN not in allowances:
        return data
    return tuple(replace(one, allowances=(*one.allowances, between_recordings(one.problem.grid.nodes))) for one in data)


def starting(layout: Layout, start: Profile | float) -> tuple[Array, float]:
    """Parameters (P,) and the level of log k to begin with."""
    s = np.linspace(0.0, 1.0, 8 * layout.spline.count)
    k = np.full(len(s), float(start)) if isinstance(start, float | int) else np.asarray(start(s))
    if not np.all(k > 0.0):
        raise LearningError("the start stiffness must be positive everywhere")
    x, level = np.zeros(layout.size), float(np.mean(np.log(k)))
    # Where the shape of k is stated, its level alone is taken over.
    own = np.log(k) if layout.known is None else np.full(len(s), level)
    x[: layout.spline.count] = np.linalg.lstsq(layout.spline.basis(s), own, rcond=None)[0]
    return x, level


def with_mass_found(
    recordings: Sequence[Observations], problem: FitProblem, near: MapEstimate
) -> tuple[Sequence[Observations], MapEstimate]:
    """Recordings and estimate with a guessed mass replaced by what came out: the prior of its unevenness is relative to
    the mass."""
    if not any(np.isfinite(o.stated.mass_sd) for o in recordings):
        return recordings, near
    mass, even = problem.layout.index["mass", -1].where, np.array([1.0, 0.0, 0.0, 0.0])
    factor, x = 1.0 + max(float(near.x[mass.start]), -0.9), near.x.copy()
    x[mass] = (x[mass] + even) / factor - even
    heavier = [replace(o, stated=replace(o.stated, mass=factor * o.stated.mass)) for o in recordings]
    return heavier, replace(near, x=x)


def carried_over(problem: FitProblem, near: MapEstimate, whole: FitProblem, some: list[int]) -> MapEstimate:
    """An estimate for all frames of all recordings, from that for a few frames of some. What the others have of their
    own begins where nothing is known of it, their noise in the middle of what was found."""
    x, found = np.zeros(whole.layout.size), near.hyperparameters
    for (name, recording), block in whole.layout.index.items():
        if block.start >= 0 and (recording < 0 or recording in some):
            x[block.where] = problem.layout.get(near.x, name, recording if recording < 0 else some.index(recording))
        elif block.start >= 0 and name == "force":
            x[block.where] = whole.recordings[recording].error.mean.ravel()
    pairs = list(zip(found.noise, problem.expected.noise, strict=True))
    marker, force = (
        float(np.median(one)) for one in zip(*((f.marker, f.force / e.force) for f, e in pairs), strict=True)
    )
    noise = tuple(
        found.noise[some.index(i)] if i in some else RecordingNoise(marker, force * before.force)
        for i, before in enumerate(whole.expected.noise)
    )
    shapes: list[Array | None] = [None] * len(whole.recordings)
    for i, few, prediction in zip(some, problem.recordings, near.predictions, strict=True):
        same = np.array_equal(few.frames, whole.recordings[i].frames)
        if same and np.array_equal(few.problem.grid.nodes, whole.recordings[i].problem.grid.nodes):
            shapes[i] = prediction.solved.q
    release(near)
    begin = estimate_at(whole, x, shapes)
    return with_own_forces(replace(begin, hyperparameters=replace(found, noise=noise), steps=near.steps))
