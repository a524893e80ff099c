"""From parameters to predicted tags, with exact derivatives: the model of the marker-space fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.statics.continuation import follow, refine
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.perturbation import Perturbation, Perturbations
from onebend.beam.statics.sensitivity import (
    of_clamp_angle,
    of_force,
    of_moment,
    of_rest_curvature,
    of_stiffness,
    respond,
)
from onebend.learning.model.fit_data import Film
from onebend.learning.model.held_ends import moved, put_ends, solve, with_ends_held
from onebend.learning.model.parameters import Layout
from onebend.records import Array


@dataclass(frozen=True)
class Slopes:
    """Derivatives of R numbers a frame with the parameters of a film (`at.known_to`) and with each frame's force.

    The slow error of the force log comes last of the parameters. It enters by its value in the frame alone, so its K
    knots are not written out: they have `-a axes` times the frame's weights.
    """

    j: Array  # (F, ..., C - 2 K) with all parameters but that error
    a: Array  # (F, ..., 2) with the frame's force
    axes: Array  # (2, 2) by which the logged force is turned
    weights: Array  # (F, K): that error is `weights @ values`

    @property
    def written(self) -> Array:
        """(F, ..., C) with all parameters."""
        knots = -np.einsum("t...d,tk->t...kd", self.a @ self.axes, self.weights)
        return np.concatenate([self.j, knots.reshape(*self.a.shape[:-1], 2 * self.weights.shape[1])], axis=-1)

    def times(self, step: Array) -> Array:
        """(F, ...): what a step (C,) of the parameters does."""
        count = self.j.shape[-1]
        error = self.weights @ step[count:].reshape(-1, 2) @ self.axes.T
        return np.asarray(self.j @ step[:count] - np.einsum("t...d,td->t...", self.a, error))


@dataclass(frozen=True)
class Prediction:
    """Tags where the parameters put them."""

    seen: Film
    at: Layout
    x: Array  # (P,) the parameters
    solved: Equilibrium
    pose: Array  # (F, m, 3)
    force: Array  # (F, 2) N, the corrected force, `own` with it
    own: Array  # (F, 2) N, what of the force is each frame's own: less the log's error that is faster than the knots

    @cached_property
    def slopes(self) -> Slopes:
        """Derivatives of the tags' poses (F, m, 3), exact."""
        return _slopes(self)


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
    pose = np.concatenate([xy, (angle + at.get(x, "turn"))[..., None]], axis=-1)
    return Prediction(seen, at, x, solved, pose, force, own)


def _slopes(now: Prediction) -> Slopes:
    seen, at, x, r, solved = now.seen, now.at, now.x, now.seen.number, now.solved
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
    knots = at.columns("force", r)
    out = np.zeros((*now.pose.shape, len(at.known_to(r)) if knots is None else knots.start))
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
    axes = _axes(at, x, r)
    _put(out, at.columns("clock", r), np.einsum("tmad,td->tma", by_force, seen.rate @ axes.T)[..., None])
    bend = np.where(over > 0.0, 0.0, apply(solved.problem.grid.value_at(s), solved.q)) / seen.observations.length
    _put_tags(out, at, (cos, sin), (1.0 - across * bend) * scale, scale, bend)
    columns = at.columns("origin", r)
    if columns is not None:
        out[:, :, 0, columns.start], out[:, :, 1, columns.start + 1] = 1.0, 1.0
    columns = at.columns("scale", r)
    if columns is not None:
        out[:, :, :2, columns.start] = (now.pose[..., :2] - at.get(x, "origin", r)) / scale
    return Slopes(out, by_force, axes, seen.error_weights)


def _changes(seen: Film, at: Layout, x: Array, now: Prediction) -> Perturbations:
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
        + Perturbation(_pushed(seen, at, x)[..., None, None] * np.eye(2), None, None, np.zeros(2))
        + Perturbation((seen.farther[..., None] * now.force[:, None, :])[..., None], None, None, np.zeros(1))
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
