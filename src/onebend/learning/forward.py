"""From parameters to predicted tags, with exact derivatives: the model of the marker-space fit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.continuation import follow, refine
from onebend.beam.grid import apply
from onebend.beam.loads import Loads, push, weight
from onebend.beam.model import Beam
from onebend.beam.modes import Modes
from onebend.beam.problem import Problem, Resolution, pose
from onebend.beam.sensitivity import (
    Change,
    Changes,
    of_clamp_angle,
    of_force,
    of_moment,
    of_rest_curvature,
    of_stiffness,
    respond,
)
from onebend.beam.statics import Equilibrium
from onebend.beam.stiffness import Uniform
from onebend.errors import LearningError
from onebend.learning.force_error import ForceError, force_error
from onebend.learning.frames import known_loads, mass_profile, push_places, typical, whitening
from onebend.learning.held_poses import RESOLUTION as HELD_RESOLUTION
from onebend.learning.held_poses import HeldEnds, held_ends, is_held, moved, put_ends, solve, with_ends_held
from onebend.learning.own_weight import POWERS, OwnWeight, own_weight
from onebend.learning.parameters import Layout
from onebend.learning.spline import Spline
from onebend.recording.signals import low_pass
from onebend.records import Array, BoolArray, Observations

RESOLUTION = Resolution(order=12, widest=0.5)
REST_MODES = Modes(3)
MASS_MODES = Modes(4)
_SLOW = 0.5  # of the cut-off, which is twice the bandwidth of the tags' motion


@dataclass(frozen=True)
class Film:
    """One recording as the fit sees it: F frames, the last being the beam at rest where it was seen."""

    observations: Observations
    number: int
    frames: BoolArray  # (T,) which frames of the recording are used
    measured: Array  # (F, m, 3) x, y, angle; NaN where missing
    whiten: Array  # (F, m, 3, 3) inverse Cholesky factors of the covariances; zero where missing
    force: Array  # (F, 2) N as logged
    rate: Array  # (F, 2) N/s, derivative of the logged force
    error: ForceError
    error_weights: Array  # (F, K)
    push_s: Array  # (F,)
    problem: Problem  # grid and what does not change
    beyond: Array  # (F, Q) 1 where the push lies beyond the node
    farther: Array  # (F, Q) 1/m: what is added to it where the push lies farther out; see `_farther`
    weight: Array  # (F, Q, 2) N beyond the node: weight, the mass as written down, and the loads known besides
    ends: HeldEnds | None  # of frames whose end an unknown wrench holds
    mass: OwnWeight | None  # what the mass has besides; None where nothing weighs
    on_nodes: Array  # (Q, p) or (F, Q, p): the spline's functions at the nodes
    rest_on_nodes: Array  # (Q, 3) or (F, Q, 3)


@dataclass(frozen=True)
class Prediction:
    """Tags where the parameters put them."""

    solved: Equilibrium
    pose: Array  # (F, m, 3)
    force: Array  # (F, 2) N, the corrected force, `own` with it
    own: Array  # (F, 2) N, what of the force is each frame's own: less the log's error that is faster than the knots


def film(observations: Observations, number: int, frames: BoolArray, spline: Spline) -> Film:
    """Prepare a recording: everything that does not depend on the parameters."""
    o = observations
    time = o.time[frames]
    error = force_error(o, time)
    measured = np.concatenate([o.xy[frames], o.angle[frames][..., None]], axis=-1)
    covariance, force = o.covariance[frames], o.force[frames]
    rate = _rate(o)[frames]
    push_s, gravity, weights = push_places(o)[frames], o.gravity[frames], error.weights
    other = known_loads(o, frames)
    if np.any(np.isfinite(o.rest_xy)):  # the beam at rest is one more frame, of no force and no force error
        rest = np.concatenate([o.rest_xy, o.rest_angle[:, None]], axis=1)
        measured = np.concatenate([measured, rest[None]])
        covariance = np.concatenate([covariance, np.maximum(typical(o.covariance), 0.0)[None] * np.eye(3)])
        force, rate = np.vstack([force, np.zeros(2)]), np.vstack([rate, np.zeros(2)])
        push_s, gravity = np.append(push_s, push_s[-1]), np.vstack([gravity, np.zeros(2)])
        weights = np.vstack([weights, np.zeros(weights.shape[1])])
        other = _rested(other)
    weighs = bool(np.any(gravity != 0.0))
    if weighs and not np.isfinite(o.mass):
        raise LearningError(f"{o.name}: gravity acts in the plane, so beam.mass_kg must be given")
    line = mass_profile(o)
    written = line if weighs and o.mass_along not in POWERS else Uniform(0.0)
    carrier = Beam(o.length, Uniform(1.0), mass_per_length=written)
    fine = HELD_RESOLUTION if is_held(o) else RESOLUTION
    problem = pose(carrier, _loads(np.zeros_like(force), push_s, gravity) + other, fine)
    ends = held_ends(o, frames, problem)
    nodes = problem.grid.nodes
    return Film(
        observations=o,
        number=number,
        frames=frames,
        measured=measured,
        whiten=whitening(measured, covariance),
        force=force,
        rate=rate,
        error=error,
        error_weights=weights,
        push_s=push_s,
        problem=problem,
        beyond=np.asarray(nodes < push_s[:, None], dtype=float),
        farther=_farther(problem, push_s),
        weight=problem.dead_force,
        ends=ends,
        mass=own_weight(o, problem, gravity, MASS_MODES.curvature(nodes), line) if weighs else None,
        on_nodes=spline.basis(nodes),
        rest_on_nodes=REST_MODES.curvature(nodes),
    )


def predict(seen: Film, at: Layout, x: Array, start: Array | None, own: Array | None = None) -> Prediction:
    """Equilibria and tags for parameters x and each frame's `own` force (F, 2) [N], none where it is not given;
    warm-started from shapes `start` (F, Q) where given."""
    r = seen.number
    own = np.zeros_like(seen.force) if own is None else own
    errors = at.get(x, "force", r).reshape(-1, 2)
    force = (seen.force - seen.error_weights @ errors + seen.rate * at.get(x, "clock", r)) @ _axes(at, x, r).T + own
    k = np.exp(seen.on_nodes @ at.get(x, "stiffness"))
    weight_beyond = seen.weight
    if seen.mass is not None:
        weight_beyond = weight_beyond + seen.mass.force(seen.problem, k, at.get(x, "mass"))
    problem = replace(
        seen.problem,
        k=k,
        q0=seen.rest_on_nodes @ at.get(x, "curvature"),
        alpha0=np.asarray(at.get(x, "clamp", r)[0]),
        dead_force=_pushed(seen, at, x)[..., None] * force[:, None, :] + weight_beyond,
    )
    if seen.ends is not None:
        solved = solve(problem, seen.ends, moved(seen.ends, at, x, r), start)
    else:
        solved = follow(problem) if start is None else refine(problem, start)
    s, over = tag_places(seen, at, x)
    angle = solved.angle(s)
    across = at.get(x, "across")
    cos, sin = np.cos(angle), np.sin(angle)
    ride = np.stack([cos * over - sin * across, sin * over + cos * across], axis=-1)
    xy = (1.0 + at.get(x, "scale", r)) * (solved.xy(s) + ride) + at.get(x, "origin", r)
    return Prediction(solved, np.concatenate([xy, (angle + at.get(x, "turn"))[..., None]], axis=-1), force, own)


def jacobian(seen: Film, at: Layout, x: Array, now: Prediction) -> tuple[Array, Array]:
    """Derivatives of the tags' poses: (F, m, 3, C) with the parameters `at.known_to`, (F, m, 3, 2) with the force."""
    r, solved = seen.number, now.solved
    s, over = tag_places(seen, at, x)
    change = _changes(seen, at, x, now)
    if seen.ends is None:
        response = respond(solved, change).poses(s)
    else:
        change = change + of_force(solved.problem, np.ones(1)) + of_moment(solved.problem, np.ones(1))
        response, by_end = with_ends_held(respond(solved, change).poses(np.append(s, 1.0)), seen.ends)
    angle, across = solved.angle(s), at.get(x, "across")
    cos, sin = np.cos(angle), np.sin(angle)
    turned = np.stack([-sin * over - cos * across, cos * over - sin * across], axis=-1)
    scale = 1.0 + at.get(x, "scale", r)[0]
    mechanics = _ridden(response, turned, scale)  # (F, m, 3, p + 3 + 1 + 2 + 1 (+ 4))
    out = np.zeros((*now.pose.shape, len(at.known_to(r))))
    p = seen.on_nodes.shape[-1]
    by_force = mechanics[..., p + 4 : p + 6]
    _put(out, at.columns("stiffness"), mechanics[..., :p])
    _put(out, at.columns("curvature"), mechanics[..., p : p + 3])
    _put(out, at.columns("clamp", r), mechanics[..., p + 3 : p + 4])
    if seen.mass is not None:
        _put(out, at.columns("mass"), mechanics[..., p + 7 :])
    _put(out, at.columns("place", r), mechanics[..., p + 6 : p + 7])
    if seen.ends is not None:
        put_ends(out, seen.ends, at, r, _ridden(by_end, turned[seen.ends.frames], scale))
    across_force = np.stack([-now.force[:, 1], now.force[:, 0]], axis=-1)
    _put(out, at.columns("direction", r), np.einsum("tmad,td->tma", by_force, across_force)[..., None])
    by_log = by_force @ _axes(at, x, r)
    _put(out, at.columns("clock", r), np.einsum("tmad,td->tma", by_log, seen.rate)[..., None])
    knots = -np.einsum("tmad,tk->tmakd", by_log, seen.error_weights)
    _put(out, at.columns("force", r), knots.reshape(*now.pose.shape, -1))
    bend = np.where(over > 0.0, 0.0, apply(solved.problem.grid.value_at(s), solved.q)) / seen.observations.length
    _put_tags(out, at, (cos, sin), (1.0 - across * bend) * scale, scale, bend)
    columns = at.columns("origin", r)
    if columns is not None:
        out[:, :, 0, columns.start], out[:, :, 1, columns.start + 1] = 1.0, 1.0
    columns = at.columns("scale", r)
    if columns is not None:
        out[:, :, :2, columns.start] = (now.pose[..., :2] - at.get(x, "origin", r)) / scale
    return out, by_force


def _changes(seen: Film, at: Layout, x: Array, now: Prediction) -> Changes:
    """How the coefficients of log k, rest curvature, clamp angle, force, its place, and the mass where something weighs
    enter the balance."""
    solved, k = now.solved, now.solved.problem.k
    by_k = of_stiffness(solved, k[..., None] * seen.on_nodes)
    if seen.mass is not None:
        by_k = replace(by_k, force=seen.mass.by_stiffness(seen.problem, k, seen.on_nodes, at.get(x, "mass")))
    change = (
        by_k
        + of_rest_curvature(solved.problem, seen.rest_on_nodes)
        + of_clamp_angle(solved.problem)
        + Change(_pushed(seen, at, x)[..., None, None] * np.eye(2), None, None, np.zeros(2))
        + Change((seen.farther[..., None] * now.force[:, None, :])[..., None], None, None, np.zeros(1))
    )
    return change if seen.mass is None else change + seen.mass.by_mass(seen.problem, k)


def tag_places(seen: Film, at: Layout, x: Array) -> tuple[Array, Array]:
    """Where the tags sit: (m,) s on the beam, and (m,) m beyond its tip, where one sits there."""
    length = seen.observations.length
    s = seen.observations.marker_s + at.get(x, "along") / length
    return np.clip(s, 0.0, 1.0), length * (s - np.clip(s, 0.0, 1.0))


def _ridden(response: Array, turned: Array, scale: float) -> Array:
    """(F, m, 3, P) of tags in the picture, from that of the beam's places under them; `turned` (F, m, 2) m: their way
    by a turn."""
    moved = response[:, :, :2] + turned[..., None] * response[:, :, 2:]
    return np.concatenate([scale * moved, response[:, :, 2:]], axis=2)


def _put_tags(out: Array, at: Layout, turned: tuple[Array, Array], stride: Array, scale: float, bend: Array) -> None:
    """Derivatives with each tag's own place and turn; `stride` and `bend` (F, m): its way and turn per metre along."""
    along, across, turn = at.columns("along"), at.columns("across"), at.columns("turn")
    cos, sin = turned
    for i in range(cos.shape[1]):
        if along is not None:
            column = along.start + i
            out[:, i, 0, column], out[:, i, 1, column] = stride[:, i] * cos[:, i], stride[:, i] * sin[:, i]
            out[:, i, 2, column] = bend[:, i]
        if across is not None:
            out[:, i, 0, across.start + i], out[:, i, 1, across.start + i] = -scale * sin[:, i], scale * cos[:, i]
        if turn is not None:
            out[:, i, 2, turn.start + i] = 1.0


def _put(out: Array, columns: slice | None, values: Array) -> None:
    if columns is not None:
        out[..., columns] = values


def _pushed(seen: Film, at: Layout, x: Array) -> Array:
    """(F, Q) share of the push that acts beyond the node."""
    return np.asarray(seen.beyond + at.get(x, "place", seen.number)[0] * seen.farther)


def _axes(at: Layout, x: Array, r: int) -> Array:
    """(2, 2) by which the logged force is turned."""
    turn = float(at.get(x, "direction", r)[0])
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([[cos, -sin], [sin, cos]])


def _farther(problem: Problem, push_s: Array) -> Array:
    """(F, Q) 1/m: a dead force that acts d metres farther out along the tangent than `push_s` adds d times this to the
    share of it beyond each node.

    It lengthens the way to the force, `L sum w u`, by d u at the last node before it. So it also holds beyond the tip,
    where there is no beam, and the nodes stay where they are.
    """
    nodes, weights = np.broadcast_arrays(problem.grid.nodes, problem.weights)
    last = np.broadcast_to(nodes < push_s[:, None], (len(push_s), nodes.shape[-1])).sum(axis=1) - 1
    nodes_of = np.arange(nodes.shape[-1]) == last[:, None]
    return np.asarray(nodes_of / (float(problem.length) * weights))


def _rate(o: Observations) -> Array:
    """(T, 2) N/s: slope of the force at the frames, from its slow part: the slope of the log's noise would tell the
    clock that it is right as it is.
    """
    if o.clean_force is None:
        return np.gradient(o.force, o.time, axis=0) if len(o.time) > 1 else np.zeros_like(o.force)
    clean = o.clean_force
    known = np.all(np.isfinite(clean.force), axis=1)
    time = clean.time[known]
    slow = low_pass(time, clean.force[known], _SLOW * clean.cutoff, longest_gap=np.inf)
    slope = np.gradient(slow, time, axis=0)
    return np.stack([np.interp(o.time, time, slope[:, c]) for c in range(2)], axis=1)


def _rested(loads: Loads) -> Loads:
    """One frame more, in which nothing acts."""
    if loads.size == 1:
        return loads
    more = loads.take(np.append(np.arange(loads.size), loads.size - 1))
    here = (np.arange(more.size) < loads.size).astype(float)
    return replace(more, force=more.force * here[:, None, None], moment=more.moment * here[:, None])


def _loads(force: Array, push_s: Array, gravity: Array) -> Loads:
    loads = push(force, push_s)
    return loads + weight(gravity) if np.any(gravity != 0.0) else loads
