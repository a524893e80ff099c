"""A learned beam against a recording (Fig. 5): simulate it under the measured forces, compare the markers."""

from __future__ import annotations

import numpy as np

from onebend.beam.loads import Loads, push
from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.beam.statics.continuation import follow
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.problem import has_mass, make_problem
from onebend.beam.statics.sensitivity import of_force, respond
from onebend.blas import one_blas_thread
from onebend.errors import LearningError
from onebend.learning.frequencies.compared import validated_frequencies
from onebend.learning.model.frames import loads_of, marker_rms, nothing_moves, push_places, usable_frames
from onebend.learning.model.held_ends import RESOLUTION, is_held, resolution_of, shapes_of
from onebend.learning.model.mass import NEEDS_MASS, weighs
from onebend.learning.model.prediction_error import few_frames, variances
from onebend.learning.model.readings import from_the_clamp, points_of
from onebend.learning.model.rest import AtRest
from onebend.learning.outcome import Comparison
from onebend.learning.pose_equilibria import SeenPoses, elsewhere, pose_names, pose_rms, seen_poses, unexplained
from onebend.records import Array, BoolArray, Observations, Remark

_MOST_NAMED = 6  # poses
_CHUNK = 500  # frames solved together: their tangents stay in the cache


def simulate(beam: Beam, loads: Loads) -> list[Equilibrium]:
    """Equilibria of the beam, in chunks of frames."""
    count = loads.size
    return [follow(make_problem(beam, loads.take(slice(i, i + _CHUNK)), RESOLUTION)) for i in range(0, count, _CHUNK)]


@one_blas_thread
def validate(
    beam: Beam,
    observations: Observations,
    *,
    rest: AtRest | None = None,
    stiffness: UncertainStiffness | None = None,
) -> Comparison:
    """Measured markers against the beam's own under the measured forces, in every usable frame.

    The tags' mounting errors, as seen at rest, ride on the simulated beam too: what is compared is the bending. They
    are taken from `rest`, or else against the beam's own shape at rest. `stiffness` is the beam's k(s) with its
    band, where it has one and was learned from other recordings; then it is said how far off the tags are likely to be.

    Raises:
        LearningError: no usable frame, or weight acts and the beam has no mass.
        MechanicsError: k(s) is not positive somewhere.
    """
    frames = usable_frames(observations)
    if not np.any(frames):
        why = nothing_moves(observations) or "no frame has a load, a force and a tag"
        raise LearningError(f"{observations.source.name}: {why}; nothing to compare")
    if weighs(observations) and not has_mass(beam):
        raise LearningError(f"{observations.source.name}: {NEEDS_MASS}")
    solved = solved_frames(beam, observations, frames)
    offset = mounting(beam, observations) if rest is None else rest.offset
    predicted = _predicted(solved, observations, frames, offset)
    stable = np.concatenate([one.stable for one in solved])
    measured = from_the_clamp(observations, frames, predicted)
    sensor_rms = _sensor_rms(solved, observations, frames)
    remarks = _remarks(stable, np.concatenate([one.converged for one in solved]))
    seen = seen_poses(observations, frames)
    if seen is not None:
        remarks += _pose_remarks(observations, frames, seen, solved[0], predicted)
    return Comparison(
        name=observations.source.name,
        frame=observations.frame[frames],
        time=observations.time[frames],
        tag_id=observations.tag_id,
        marker_s=observations.marker_s,
        measured=measured,
        predicted=predicted,
        force=observations.force[frames],
        push_s=push_places(observations)[frames],
        stable=stable,
        rms=np.where(np.any(observations.marker_s), marker_rms(measured - predicted), np.nan),  # no clamp by itself
        sensor_rms=sensor_rms,
        likely_rms=_likely_rms(beam, observations, frames, stiffness, sensor_rms),
        remarks=remarks + (validated_frequencies(beam, observations) if has_mass(beam) else ()),
        static=observations.static,
    )


def solved_frames(beam: Beam, observations: Observations, frames: BoolArray) -> list[Equilibrium]:
    """Under the measured loads; static poses in the equilibria that their points show."""
    loads = loads_of(observations, frames)
    if observations.static:
        return [shapes_of(observations, frames, make_problem(beam, loads, resolution_of(observations)))]
    return simulate(beam, loads)


def mounting(beam: Beam, observations: Observations) -> Array:
    """(m, 2) m, of each tag from its place on the beam at rest, in the tangent's frame; 0 where it was not seen."""
    solved = simulate(beam, push(np.zeros((1, 2))))[0]
    alpha, away = solved.angle(observations.marker_s)[0], observations.rest_xy - solved.xy(observations.marker_s)[0]
    cos, sin = np.cos(alpha), np.sin(alpha)
    offset = np.stack([cos * away[:, 0] + sin * away[:, 1], -sin * away[:, 0] + cos * away[:, 1]], axis=1)
    return np.where(np.isfinite(offset).all(axis=1)[:, None], offset, 0.0)


def _predicted(solved: list[Equilibrium], observations: Observations, frames: BoolArray, offset: Array) -> Array:
    """(T, m, 2) where the tags of the simulated beam are, or what of it is under rulers."""
    if observations.readings.at == "mark":
        return np.concatenate([_tags(one, observations.marker_s, offset) for one in solved])
    parts, used = [], np.flatnonzero(frames)
    for i, one in enumerate(solved):
        chunk = np.zeros_like(frames)
        chunk[used[i * _CHUNK : (i + 1) * _CHUNK]] = True
        parts.append(np.where(one.converged[:, None, None], points_of(observations, chunk, one), np.nan))
    return np.concatenate(parts)


def _tags(solved: Equilibrium, s: Array, offset: Array) -> Array:
    """(T, m, 2) where the tags of the simulated beam are. NaN where the branch of equilibria ended before the load."""
    angle = solved.angle(s)
    cos, sin = np.cos(angle), np.sin(angle)
    dx, dy = offset[:, 0], offset[:, 1]
    out = solved.xy(s) + np.stack([cos * dx - sin * dy, sin * dx + cos * dy], axis=-1)
    return np.asarray(np.where(solved.converged[:, None, None], out, np.nan))


def _sensor_rms(solved: list[Equilibrium], observations: Observations, frames: BoolArray) -> Array:
    """(m,) RMS that errors of `force_sd` in the force alone would give, to first order."""
    if not np.all(np.isfinite(observations.force_sd)):
        return np.full(len(observations.marker_s), np.nan)
    places = push_places(observations)[frames]
    squared = np.zeros((0, len(observations.marker_s)))
    for i, one in enumerate(solved):
        at = places[i * _CHUNK : (i + 1) * _CHUNK]
        response = respond(one, of_force(one.problem, at)).xy(observations.marker_s)  # (T, m, 2, 2)
        squared = np.concatenate([squared, np.einsum("tmcd,d->tm", response**2, observations.force_sd**2)])
    return np.asarray(np.sqrt(np.mean(squared, axis=0)))


def _likely_rms(
    beam: Beam, observations: Observations, frames: BoolArray, stiffness: UncertainStiffness | None, sensor_rms: Array
) -> Array:
    """(m,) RMS that the band of k(s) and the tolerances of this push give with the force's noise; NaN where no band is
    known, or where unknown wrenches hold the end."""
    if stiffness is None or is_held(observations):
        return np.full(len(observations.marker_s), np.nan)
    few = few_frames(frames)
    [solved] = solved_frames(beam, observations, few)
    parts = variances(solved, observations, few, stiffness)
    return np.asarray(np.sqrt(np.nan_to_num(sensor_rms) ** 2 + sum(parts.values())))


def _remarks(stable: BoolArray, converged: BoolArray) -> tuple[Remark, ...]:
    out = []
    if not np.all(converged):
        out.append(
            Remark(
                "warning",
                f"in {np.sum(~converged)} of {len(converged)} frames the simulated beam has no equilibrium on the "
                "branch that grows from rest (it would snap through); these frames are left out of the comparison: "
                "check the force and its place",
                about="no equilibrium",
            )
        )
    if not np.all(stable | ~converged):
        text = f"in {np.sum(converged & ~stable)} frames the simulated beam has buckled"
        text += ": check the force's sign, and that it is this beam"
        out.append(Remark("warning", text, about="no equilibrium"))
    return tuple(out)


def _pose_remarks(
    o: Observations, frames: BoolArray, seen: SeenPoses, solved: Equilibrium, predicted: Array
) -> tuple[Remark, ...]:
    """Warnings on single poses: that no stable equilibrium is near the points, or another one than the stated history
    leads to. Where most poses are far off, it is nothing of one pose."""
    names, held = pose_names(o, frames), np.zeros(int(np.sum(frames)), dtype=bool) if o.held is None else o.held[frames]
    rms = pose_rms(o.xy[frames] - predicted)
    unlike = unexplained(rms, o.length) & ~held
    out = []
    if unlike.any():
        text = (
            f"no stable equilibrium of the beam under its loads is near the points: {_poses_off(names, rms, unlike)} "
            "(RMS). Check the loads, clamp_deg, and the points there, and that nothing touched the beam"
        )
        out.append(Remark("warning", text, about="pose"))
    off, other = elsewhere(solved, seen)
    other &= ~unlike & ~held
    if other.any():
        text = (
            "the points show another equilibrium than the base's turning leads to, and were followed: it would be off "
            f"by {_poses_off(names, off, other)} (RMS). Check turned_from_deg and order, and that nobody touched the "
            "beam"
        )
        out.append(Remark("warning", text, about="pose history"))
    return tuple(out)


def _poses_off(names: tuple[str, ...], rms: Array, which: BoolArray) -> str:
    """Poses with their distances [m], the farthest first."""
    order = [i for i in np.argsort(-rms).tolist() if which[i]]
    said = ", ".join(f"pose {names[i]} by {1e3 * rms[i]:.3g} mm" for i in order[:_MOST_NAMED])
    return said + (f" and {len(order) - _MOST_NAMED} more" if len(order) > _MOST_NAMED else "")
