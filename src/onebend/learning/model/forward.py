"""From parameters to predicted tags, with exact derivatives: the model of the marker-space fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.statics.continuation import follow, refine
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.sensitivity import of_force, of_moment, respond
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.held_ends import moved, put_ends, solve, with_ends_held
from onebend.learning.model.parameters import Layout
from onebend.learning.model.tag_jacobian import (
    BentBeam,
    TagRide,
    balance_changes,
    free_columns,
    push_blocks,
    put_blocks,
    put_tags,
    response_columns,
)
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

    seen: FitData
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


def predict(seen: FitData, at: Layout, x: Array, start: Array | None, own: Array | None = None) -> Prediction:
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
    s, _ = tag_places(seen, at, x)
    ride = tag_ride(seen, at, x, solved)
    xy = ride.scale * (solved.xy(s) + ride.offset) + at.get(x, "origin", r)
    pose = np.concatenate([xy, (ride.angle + at.get(x, "turn"))[..., None]], axis=-1)
    return Prediction(seen, at, x, solved, pose, force, own)


def _slopes(now: Prediction) -> Slopes:
    seen, at, x, r, solved = now.seen, now.at, now.x, now.seen.number, now.solved
    s, _ = tag_places(seen, at, x)
    changes = balance_changes(_bent(now))
    columns, ride = response_columns(changes), tag_ride(seen, at, x, solved)
    free, error = free_columns(at, r), at.columns("force", r)
    out = np.zeros((*now.pose.shape, len(at.known_to(r)) if error is None else error.start))
    if seen.ends is None:
        response = respond(solved, columns.changes).poses(s)
    else:
        wrench = of_force(solved.problem, np.ones(1)) + of_moment(solved.problem, np.ones(1))
        poses = respond(solved, columns.changes + wrench).poses(np.append(s, 1.0))
        response, by_end = with_ends_held(poses, seen.ends)
        held = replace(ride, angle=ride.angle[seen.ends.frames])
        put_ends(out, seen.ends, at, r, held.carry(by_end))
    blocks, axes = columns.split(ride.carry(response)), _axes(at, x, r)
    put_blocks(out, free, blocks | push_blocks(blocks["push"], now.force, axes, seen.rate))
    bend = apply(solved.problem.grid.value_at(s), solved.q) / seen.observations.length
    xy = (now.pose[..., :2] - at.get(x, "origin", r)) / ride.scale
    put_tags(out, free, ride.motion(xy, np.where(ride.over > 0.0, 0.0, bend)))
    return Slopes(out, blocks["push"], axes, seen.error_weights)


def _bent(now: Prediction) -> BentBeam:
    """What the parameters change in the balance of the fitted shapes."""
    seen, at, x, solved = now.seen, now.at, now.x, now.solved
    on_nodes, by_mass, weight_by_k = seen.on_nodes, None, None
    if seen.mass is not None:
        k = solved.problem.k
        by_mass = seen.mass.by_mass(seen.problem, k)
        weight_by_k = seen.mass.by_stiffness(seen.problem, k, on_nodes, at.get(x, "mass"))
    return BentBeam(
        solved,
        on_nodes,
        seen.rest_on_nodes,
        now.force,
        _pushed(seen, at, x),
        seen.farther,
        by_mass,
        weight_by_k,
    )


def tag_places(seen: FitData, at: Layout, x: Array) -> tuple[Array, Array]:
    """Where the tags sit: (m,) s on the beam, and (m,) m beyond its tip, where one sits there."""
    length = seen.observations.length
    s = seen.observations.marker_s + at.get(x, "along") / length
    return np.clip(s, 0.0, 1.0), length * (s - np.clip(s, 0.0, 1.0))


def tag_ride(seen: FitData, at: Layout, x: Array, solved: Equilibrium) -> TagRide:
    """The tags on fitted shapes."""
    s, over = tag_places(seen, at, x)
    return TagRide(solved.angle(s), over, at.get(x, "across"), 1.0 + float(at.get(x, "scale", seen.number)[0]))


def _pushed(seen: FitData, at: Layout, x: Array) -> Array:
    """(F, Q) share of the push that acts beyond the node."""
    return np.asarray(seen.beyond + at.get(x, "place", seen.number)[0] * seen.farther)


def _axes(at: Layout, x: Array, r: int) -> Array:
    """(2, 2) by which the logged force is turned."""
    turn = float(at.get(x, "direction", r)[0])
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([[cos, -sin], [sin, cos]])
