"""Initial k(s) and mass for the marker-space fit, which searches locally."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.stiffness import Profile, Scaled, Uniform
from onebend.errors import LearningError
from onebend.learning import frames as framing, frequencies, outcome, parameters, static_poses
from onebend.progress import one_blas_thread
from onebend.records import BoolArray, Observations

_FRAMES = 40  # of each recording
_FEW = 12  # of each recording, to guess a mass
_MASSES = np.geomspace(0.02, 20.0, 10)  # masses to try, in units of (largest load) / g
_TRIED_HELD = np.geomspace(1e-4, 20.0, 16)  # the same with both ends held: it may hang like a rope
_ROUGH = Resolution(order=6, widest=0.25)  # poses whose equilibria are sought
_SOFTER, _HALF = 8, 0.5  # cables: so many times softer by this than the softest of those, while they come nearer
_ELSEWHERE = 0.1  # of the length
_FAR = 4.0  # times as far off as the best: in a film, beams softer than one that is so far off are not tried
_TRIED = np.geomspace(0.05, 200.0, 25)  # k in units of (largest load) x L


@one_blas_thread
def start_of(recordings: Sequence[Observations], learned: outcome.Learned | None) -> Profile:
    """The regression's k(s), or the best uniform beam's where that is nearer to the tags of all recordings.

    Where the shape of k(s) is stated, the beams tried have that.

    Raises:
        LearningError: a recording has no usable frame, or weight acts and no mass is given.
    """
    recordings = [framing.read_alone(o) for o in recordings]
    frames = [_some(o) for o in recordings]
    if parameters.mass_is_open(recordings):
        names = ", ".join(o.source.name for o in recordings if parameters.needs_mass(o))
        raise LearningError(f"{names}: {parameters.NEEDS_MASS}, or guess it first, with `with_mass`")
    if static_poses.sets_no_scale(recordings):
        return Uniform(1.0)  # as good as any
    swung = [Uniform(frequencies.stiffness_level(recordings))] if any(o.frequencies for o in recordings) else []
    if swung and not any(parameters.forced(o) or parameters.weighs(o) for o in recordings):
        return swung[0]  # the tags say nothing of the size
    tried = _TRIED_HELD if any(static_poses.is_held(o) for o in recordings) else _TRIED
    unit = max(_largest_load(o, some) for o, some in zip(recordings, frames, strict=True)) * recordings[0].length
    shape, mass = _shape(recordings), _mass(recordings)
    beams = [Beam(recordings[0].length, Scaled(float(unit * k), shape), mass_per_length=mass) for k in tried]
    beams += [replace(beams[0], stiffness=k) for k in swung]
    beams += [] if learned is None else [learned.beam]
    away = _distances(beams, recordings, frames)
    while all(o.static for o in recordings) and away[0] == min(away) and len(away) < len(tried) + _SOFTER:
        softer = replace(beams[0], stiffness=Scaled(_HALF, beams[0].stiffness))
        beams, away = [softer, *beams], [_distance(softer, recordings, frames), *away]
    return beams[int(np.argmin(away))].stiffness  # the stiffest hardly bends: one at least is finite


@one_blas_thread
def with_mass(recordings: Sequence[Observations]) -> tuple[Observations, ...]:
    """The recordings with the mass that one of them has, or with a first guess where weight acts and none says it.

    Raises:
        LearningError: an unknown weight is all that bends the beam, so that only k/mu could be learned.
    """
    parameters.check_mass_can_be_learned(recordings)
    if not parameters.mass_is_open(recordings):
        return parameters.shared_mass(recordings)
    frames = [_some(o, _FEW) for o in recordings]
    if not any(parameters.weighs(o) for o in recordings):
        return parameters.shared_mass(recordings, _mass_of_swing(recordings, frames))
    pull = max(float(np.max(np.linalg.norm(o.gravity, axis=1))) for o in recordings)
    load = max(_largest_load(o, some) for o, some in zip(recordings, frames, strict=True))
    length, best, least, shape = recordings[0].length, np.nan, np.inf, _shape(recordings)
    for mass in (load / pull * _MASSES).tolist():
        for k in (load * length * _TRIED[::2]).tolist():
            beam = Beam(length, Scaled(k, shape), mass_per_length=Uniform(mass / length))
            distance = _distance(beam, recordings, frames)
            best, least = (mass, distance) if distance < least else (best, least)
    return parameters.shared_mass(recordings, best)


def _mass_of_swing(recordings: Sequence[Observations], frames: list[BoolArray]) -> float:
    """kg, of the beam that follows the tags and swings as it was seen to; a tip mass, where that alone has a size."""
    if not any(parameters.forced(o) for o in recordings):
        return max(one.tip_mass for o in recordings for one in o.frequencies)
    length, load = recordings[0].length, max(_largest_load(o, some) for o, some in zip(recordings, frames, strict=True))
    levels = (load * length * _TRIED).tolist()
    away = [_distance(Beam(length, Uniform(k)), recordings, frames) for k in levels]
    return frequencies.swinging_mass(recordings, levels[int(np.argmin(away))])


def _some(o: Observations, most: int = _FRAMES) -> BoolArray:
    """A few of the usable frames, evenly spread."""
    usable, still = np.flatnonzero(framing.usable_frames(o)).astype(np.int64), framing.nothing_moves(o)
    if len(usable) == 0 or still:
        raise LearningError(
            f"{o.source.name}: {still or 'no frame has a load, a force and a tag'}, so nothing can be learned from it. "
            "Film a push (or a beam that its weight bends), with the tags in view, and let the force log cover it"
        )
    return framing.evenly_spread(usable, most, len(o.time))


def _distances(beams: Sequence[Beam], recordings: Sequence[Observations], frames: list[BoolArray]) -> list[float]:
    """`_distance` of each beam, infinite without equilibrium. Films of a free end are tried from the stiffest beam on;
    softer ones, which take longest, are left out once the distance grows."""
    away = [np.inf] * len(beams)
    films, best = not any(o.static or static_poses.is_held(o) for o in recordings), np.inf
    for i in reversed(range(len(beams))):
        away[i] = _distance(beams[i], recordings, frames)
        best = min(best, away[i])
        if films and i + 1 < len(_TRIED) and away[i] > max(_FAR * best, away[i + 1]):
            break
    return away


def _distance(beam: Beam, recordings: Sequence[Observations], frames: list[BoolArray]) -> float:
    """Root mean square distance of the beam's places under the tags from the tags; infinite without equilibrium.

    A static pose whose equilibrium this beam may not have counts as little more than `_ELSEWHERE`, however far off.
    """
    total, count = 0.0, 0
    for o, some in zip(recordings, frames, strict=True):
        laden = replace(beam, masses=o.stated.masses)
        resolution = _ROUGH if o.static and not static_poses.is_held(o) else static_poses.resolution_of(o)
        solved = static_poses.shapes_of(o, some, make_problem(laden, framing.loads_of(o, some), resolution))
        if not np.all(solved.converged):
            return float("inf")
        predicted = framing.points_of(o, some, solved)
        squared = framing.distances(framing.from_the_clamp(o, some, predicted) - predicted) ** 2
        if o.static:
            squared = squared / (1.0 + squared / (_ELSEWHERE * o.length) ** 2)
        total, count = total + float(np.nansum(squared)), count + int(np.sum(np.isfinite(squared)))
    return float(np.sqrt(total / count))


def _largest_load(o: Observations, some: BoolArray) -> float:
    """N, force and weight of the frames."""
    loads = np.linalg.norm(o.force[some], axis=1)
    if o.known_loads is not None:
        moment = np.sum(np.abs(o.known_loads.moment[some]), axis=1) / o.length
        loads = loads + np.sum(np.linalg.norm(o.known_loads.force[some], axis=-1), axis=1) + moment
    if parameters.weighs(o):
        mass = np.nan_to_num(o.stated.mass) + sum(one.mass for one in o.stated.masses)
        loads = loads + mass * np.linalg.norm(o.gravity[some], axis=1)
    return max(float(np.max(loads)), 1e-6)


def _shape(recordings: Sequence[Observations]) -> Profile:
    """k over its mean, as stated; even where nothing is."""
    known = parameters.known_shape(recordings)
    return Uniform(1.0) if known is None else known.profile


def _mass(recordings: Sequence[Observations]) -> Profile:
    known = [o for o in recordings if np.isfinite(o.stated.mass)]
    return framing.mass_profile(known[0]) if known else Uniform(0.0)
