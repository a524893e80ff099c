"""A learned beam against a recording (Fig. 5): simulate it under the measured forces, compare the markers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.continuation import follow, refine
from onebend.beam.loads import Loads, push
from onebend.beam.model import Beam
from onebend.beam.problem import has_mass, make_problem
from onebend.beam.sensitivity import of_force, respond
from onebend.beam.setup import Bent, SetUp
from onebend.beam.statics import Equilibrium
from onebend.beam.stiffness import UncertainStiffness
from onebend.errors import LearningError
from onebend.learning import allowances, fit_data, frames as framing, frequencies, parameters, prediction, static_poses
from onebend.learning.outcome import Comparison, Notice
from onebend.progress import one_blas_thread
from onebend.recording.signals import nan_median
from onebend.records import Array, BoolArray, Observations, Remark, rotated

_DRAWS, _LIKELY_FRAMES = 60, 12  # which tell how far tags are likely to be off
_ONE_SD = 0.683  # of a normal density
_SAME_PLACE = 1e-3  # of s, between places of one push
_CHUNK = 500  # frames solved together: their tangents stay in the cache


def simulate(beam: Beam, loads: Loads) -> Iterator[Equilibrium]:
    """Equilibria of the beam, chunk by chunk of the frames: those of very many frames would fill the memory."""
    for i in range(0, loads.size, _CHUNK):
        yield follow(make_problem(beam, loads.take(slice(i, i + _CHUNK)), static_poses.RESOLUTION))


@one_blas_thread
def validate(
    beam: Beam,
    observations: Observations,
    *,
    rest: fit_data.AtRest | None = None,
    stiffness: UncertainStiffness | None = None,
    setup: SetUp | None = None,
) -> Comparison:
    """Measured markers against the beam's under the measured forces, in every usable frame. The tags' mounting errors
    come from `rest`, or else from the beam's own shape at rest. `stiffness`: its k(s) with a band, if it was learned
    from other recordings; it gives the likely RMS. `setup`: that in which the beam was learned, with what is new in
    these recordings (`SetUp.renewed`); the push is a new contact in any case. A film of one push then has the beam in
    this set-up. Raises `LearningError` without a usable frame, or without a mass where weight acts; `MechanicsError`
    if k(s) is not positive."""
    observations, here = framing.read_alone(observations), None
    frames = framing.usable_frames(observations)
    if not np.any(frames):
        why = framing.nothing_moves(observations) or "no frame has a load, a force and a tag"
        raise LearningError(f"{observations.source.name}: {why}; nothing to compare")
    if setup is not None and stiffness is not None and _one_push(observations):
        here = _Pushed(beam, stiffness, _as_pushed(setup, observations, frames), observations)
        origin = here.setup.origin
        observations = replace(observations, xy=observations.xy - origin, rest_xy=observations.rest_xy - origin)
    if parameters.weighs(observations) and not has_mass(beam):
        raise LearningError(f"{observations.source.name}: {parameters.NEEDS_MASS}")
    still = _at_rest(beam) if here is None else here.bent(np.zeros((1, 2))).solved
    offset = mounting(still, observations) if rest is None else rest.offset
    parts, every = [], np.flatnonzero(frames)
    used = every
    for solved in solved_frames(beam, observations, frames) if here is None else here.frames(frames):
        chunk = np.zeros_like(frames)
        chunk[used[: len(solved.q)]], used = True, used[len(solved.q) :]
        tags = _predicted(solved, observations, chunk, offset)
        parts.append((tags, solved.stable, solved.converged, _by_sensor(solved, observations, chunk)))
    predicted, stable, converged, by_sensor = (np.concatenate(values) for values in zip(*parts, strict=True))
    measured = framing.from_the_clamp(observations, frames, predicted)
    sensor_rms = np.sqrt(np.mean(by_sensor, axis=0))
    notices: tuple[Notice | Remark, ...] = _notices(stable, converged)
    if static_poses.seen_poses(observations, frames) is not None:
        notices += _pose_notices(observations, frames, predicted)
    return Comparison(
        name=observations.source.name,
        frame=observations.frame[frames],
        time=observations.time[frames],
        tag_id=observations.tag_id,
        marker_s=observations.marker_s,
        measured=measured,
        predicted=predicted,
        force=observations.force[frames],
        push_s=framing.push_places(observations)[frames],
        stable=stable,
        # no clamp by itself
        rms=np.where(np.any(observations.marker_s), framing.marker_rms(measured - predicted), np.nan),
        sensor_rms=sensor_rms,
        likely_rms=_likely_rms(beam, observations, frames, stiffness, sensor_rms)
        if here is None
        else np.hypot(
            np.nan_to_num(sensor_rms), here.spread(framing.evenly_spread(every, _LIKELY_FRAMES, len(frames)))
        ),
        remarks=notices + (frequencies.validated_frequencies(beam, observations) if has_mass(beam) else ()),
        static=observations.static,
    )


def marker_misfit(
    beam: Beam, observations: Observations, frames: BoolArray, rest: fit_data.AtRest, near: Equilibrium | None = None
) -> tuple[Array, Equilibrium]:
    """RMS (m,) [m] of each tag in a few frames as in `validate`, NaN if the beam snaps through, and the equilibria.
    `near`: those of a similar beam. Raises `MechanicsError` if k(s) is not positive."""
    if parameters.weighs(observations) and not has_mass(beam):
        raise LearningError(f"{observations.source.name}: {parameters.NEEDS_MASS}")
    problem = make_problem(beam, framing.loads_of(observations, frames), static_poses.resolution_of(observations))
    if observations.static:
        solved = static_poses.shapes_of(observations, frames, problem)
    elif near is not None and np.array_equal(near.problem.grid.nodes, problem.grid.nodes):
        solved = refine(problem, near.q)
    else:
        solved = follow(problem)
    predicted = _predicted(solved, observations, frames, rest.offset)
    if not np.all(solved.converged):
        return np.full(len(observations.marker_s), np.nan), solved
    return framing.marker_rms(framing.from_the_clamp(observations, frames, predicted) - predicted), solved


def solved_frames(
    beam: Beam, observations: Observations, frames: BoolArray, near: Array | None = None
) -> Iterator[Equilibrium]:
    """Equilibria under the measured loads, in chunks; for static poses those that their points show; for a film near
    shapes (F, Q), if known."""
    loads = framing.loads_of(observations, frames)
    if not observations.static and near is not None:
        yield refine(make_problem(beam, loads, static_poses.RESOLUTION), near)
    elif not observations.static:
        yield from simulate(beam, loads)
    else:
        yield static_poses.shapes_of(
            observations, frames, make_problem(beam, loads, static_poses.resolution_of(observations))
        )


def _at_rest(beam: Beam) -> Equilibrium:
    """One frame with nothing on the beam."""
    [solved] = simulate(beam, push(np.zeros((1, 2))))
    return solved


def mounting(solved: Equilibrium, observations: Observations) -> Array:
    """(m, 2) m, of each tag from its place on the beam at rest, in the tangent's frame; 0 where it was not seen.
    `solved`: one frame with nothing on the beam."""
    s = observations.marker_s
    offset = rotated(observations.rest_xy - solved.xy(s)[0], -solved.angle(s)[0])
    return np.where(np.isfinite(offset).all(axis=1, keepdims=True), offset, 0.0)


def _predicted(solved: Equilibrium, observations: Observations, frames: BoolArray, offset: Array) -> Array:
    """(F, m, 2) where the tags of the simulated beam are in those frames (T,), or what of it is under rulers."""
    if observations.readings.at == "mark":
        return _tags(solved, observations.marker_s, offset)
    return np.where(solved.converged[:, None, None], framing.points_of(observations, frames, solved), np.nan)


def _tags(solved: Equilibrium, s: Array, offset: Array) -> Array:
    """(T, m, 2) where the tags of the simulated beam are. NaN where the branch of equilibria ended before the load."""
    out = solved.xy(s) + rotated(offset, solved.angle(s))
    return np.asarray(np.where(solved.converged[:, None, None], out, np.nan))


def _by_sensor(solved: Equilibrium, observations: Observations, frames: BoolArray) -> Array:
    """(F, m) m^2 that errors of `force_sd` in the force alone would give in those frames (T,), to first order."""
    if not np.all(np.isfinite(observations.force_sd)):
        return np.full((len(solved.q), len(observations.marker_s)), np.nan)
    at = framing.push_places(observations)[frames]
    response = respond(solved, of_force(solved.problem, at)).xy(observations.marker_s)  # (F, m, 2, 2)
    return np.asarray(np.einsum("tmcd,d->tm", response**2, observations.force_sd**2))


def _likely_rms(
    beam: Beam, observations: Observations, frames: BoolArray, stiffness: UncertainStiffness | None, sensor_rms: Array
) -> Array:
    """(m,) RMS expected from the band of k(s), the push's tolerances and the force's noise; NaN without a band or with
    held ends."""
    if stiffness is None or static_poses.is_held(observations):
        return np.full(len(observations.marker_s), np.nan)
    few = prediction.few_frames(frames)
    [solved] = solved_frames(beam, observations, few)
    parts = prediction.variances(solved, observations, few, stiffness)
    return np.asarray(np.sqrt(np.nan_to_num(sensor_rms) ** 2 + sum(parts.values())))


@dataclass(frozen=True)
class _Pushed:
    """A beam in its set-up, and a film of one push."""

    beam: Beam
    known: UncertainStiffness
    setup: SetUp
    observations: Observations

    def bent(self, force: Array, at: tuple[Array, Array] | None = None, near: Array | None = None) -> Bent:
        """Under logged forces (T, 2) [N]."""
        x, y = self.observations.gravity[0].tolist()
        return self.setup.bent(self.beam, self.known, force, at, near=near, gravity=(x, y))

    def frames(self, frames: BoolArray) -> Iterator[Equilibrium]:
        """The equilibria of these frames (T,), chunk by chunk."""
        force = self.observations.force[frames]
        for i in range(0, len(force), _CHUNK):
            yield self.bent(force[i : i + _CHUNK]).solved

    def spread(self, few: BoolArray) -> Array:
        """(m,) m, RMS by which tags are likely to be off in a few frames (T,), beside the sensor's noise: by k(s) and
        set-up, what no part of them explains, and the tags' own noise."""
        force, s = self.observations.force[few], self.observations.marker_s
        count, (logs, numbers) = len(force), self.setup.draw(self.known, _DRAWS, seed=0)
        at = np.repeat(logs, count, axis=0), np.repeat(numbers, count, axis=0)
        middle = self.bent(force)
        drawn = self.bent(np.tile(force, (_DRAWS, 1)), at, np.tile(middle.solved.q, (_DRAWS, 1)))
        moved = middle.xy(s) - self.bent(np.zeros((1, 2))).xy(s)
        rest = self.bent(np.zeros((_DRAWS, 2)), (logs, numbers)).xy(s)  # the tags' mounting is that of frames at rest
        away = drawn.xy(s).reshape(_DRAWS, count, *rest.shape[1:]) - rest[:, None] - moved
        stands = drawn.stands.reshape(_DRAWS, count, 1)
        squares = np.mean(np.sum(away**2, axis=-1), axis=1, where=stands)  # (draws, m)
        variance = np.nanquantile(squares, _ONE_SD, axis=0)  # not their mean, which one draw may decide
        left = 2.0 * self.setup.discrepancy**2 * np.mean(np.sum(moved**2, axis=-1), axis=0)
        seen = np.nan_to_num(nan_median(np.trace(self.observations.covariance[few, :, :2, :2], axis1=2, axis2=3)))
        return np.asarray(np.sqrt(variance + left + seen))


def _one_push(o: Observations) -> bool:
    """Whether it is a film of a push at one place, with nothing else on the beam that changes."""
    places = framing.push_places(o)
    one = o.known_loads is None and o.held is None and not o.static and np.any(o.force != 0.0)
    still = not np.any(o.gravity != o.gravity[0]) and float(np.nanmax(places) - np.nanmin(places)) < _SAME_PLACE
    return bool(one and still and o.readings.at == "mark")


def _as_pushed(setup: SetUp, o: Observations, frames: BoolArray) -> SetUp:
    """The set-up under the push of this film, which is a new contact: its place as it is stated here, the error with
    the posture a share of the force here. Over all of a push the material has relaxed as k(s) says."""
    sd = setup.prior_sd.copy()
    sd[setup.columns.get("place", slice(0))] = max(o.stated.place_sd, _SAME_PLACE * o.length)
    sd[setup.columns.get("force error", slice(0))] = allowances.posture_sd(allowances.course_of(o, frames))
    at = float(np.nanmedian(framing.push_places(o)))
    return replace(setup, push_s=at, prior_sd=sd, reached_at_largest=()).renewed(["contact"], length=o.length)


def _notices(stable: BoolArray, converged: BoolArray) -> tuple[Notice, ...]:
    lost, buckled = int(np.sum(~converged)), int(np.sum(converged & ~stable))
    snaps = (Notice("snaps", {"lost": lost, "frames": len(converged)}),) if lost else ()
    return (*snaps, *((Notice("buckled", {"frames": buckled}),) if buckled else ()))


def _pose_notices(o: Observations, frames: BoolArray, predicted: Array) -> tuple[Notice, ...]:
    names = static_poses.pose_names(o, frames)
    free = np.ones(int(np.sum(frames)), dtype=bool) if o.held is None else ~o.held[frames]
    rms = static_poses.pose_rms(static_poses.across_curve(o, frames, o.xy[frames] - predicted))
    unlike = static_poses.unexplained(rms, o.length, o.stated.clamp_sd) & free
    return (Notice("pose", {"poses": _farthest(names, rms, unlike)}),) if unlike.any() else ()


def _farthest(names: tuple[str, ...], rms: Array, which: BoolArray) -> tuple[tuple[str, float], ...]:
    """Names of poses with their distances [m], the farthest first."""
    return tuple((names[i], float(rms[i])) for i in np.argsort(-rms).tolist() if which[i])
