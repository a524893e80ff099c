"""Poses of the tags in a few frames at given parameters, with derivatives: the model of the live learner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotrs

from onebend.beam.statics.continuation import follow
from onebend.beam.statics.equilibrium import Equilibrium, tangent
from onebend.beam.statics.perturbation import Perturbation, minus_gradient
from onebend.beam.statics.problem import Problem
from onebend.learning.live.session import LiveSession, PushGrid
from onebend.learning.model.parameters import Layout
from onebend.learning.model.tag_jacobian import (
    BentBeam,
    TagMotion,
    balance_changes,
    push_blocks,
    put_blocks,
    put_tags,
    response_columns,
)
from onebend.records import Array, BoolArray

_NEWTON_ITERATIONS = 8  # at most, before the shape is sought from rest
_TRUST = 0.7  # rad: shapes that turn by more may have left the branch
_TOLERANCE = 1e-3  # rad, of the last update: the error is about its square


@dataclass(frozen=True)
class FrameInputs:
    """What acts on the beam in B frames."""

    force: Array  # (B, 2) N, corrected
    rate: Array  # (B, 2) N/s
    gravity: Array  # (B, 2) m/s^2
    farther: Array  # (B,) m that the push lies beyond its grid's place


@dataclass(frozen=True)
class LinearisedTags:
    """Tags' poses and their derivatives in B frames."""

    converged: BoolArray  # (B,)
    q: Array  # (B, Q) rad
    by_force: Array  # (B, Q, 2) of q with the logged force: where to start from next time
    pose: Array  # (B, m, 3)
    j: Array  # (B, m, 3, n) with the parameters
    a: Array  # (B, m, 3, 2) with the logged force, per N


@dataclass(frozen=True)
class _LoadedBeam:
    """The beam and what acts on it in B frames, on the grid of a place."""

    length: float  # m
    stiff: Array  # (Q,) k times the nodes' weights
    q0: Array  # (Q,)
    alpha0: float
    force: Array  # (B, 2) N
    pushed: Array  # (B, Q) share of the push beyond each node
    gravity: Array  # (B, 2) m/s^2
    masses: Array  # (Q, 4) kg of each part of the mass beyond the nodes; (Q, 0) where none is among the parameters
    dead: Array  # (2, B, Q) N beyond the nodes
    pull: Array  # (2, B, Q) N m: that times the length and the nodes' weights


def linearise(
    session: LiveSession, push_grid: PushGrid, x: Array, inputs: FrameInputs, start: Array | None
) -> LinearisedTags:
    """Poses and derivatives at parameters x, from shapes `start` (B, Q) where there are any.

    The tags have fewer coordinates than there are parameters, so the tangent is solved for those (the adjoint way), and
    for the force.
    """
    layout, m = session.layout, len(session.marker_s)
    axes = _axes(layout, x)
    force = (inputs.force + inputs.rate * layout.get(x, "clock")) @ axes.T
    loaded = _loaded_beam(session, push_grid, x, force, inputs)
    q, converged, factors = _shapes(push_grid, loaded, start)
    bent = _bent(push_grid, loaded, q, converged)
    columns = response_columns(balance_changes(bent))
    right = minus_gradient(bent.solved, columns.changes)
    pose, by_shape, partials = _tags(session, push_grid, x, q)
    push = right[..., columns.slices["push"]].swapaxes(1, 2)
    both = np.empty((len(q), 3 * m + 2, q.shape[1]))
    both[:, : 3 * m], both[:, 3 * m :] = by_shape.reshape(len(q), 3 * m, -1), push
    for rows, factor in zip(both, factors, strict=True):
        rows[:] = dpotrs(factor, rows.T, lower=1, overwrite_b=1)[0].T
    response = (both[:, : 3 * m] @ right).reshape(len(q), m, 3, -1)
    response[..., columns.slices["clamp"].start] += partials.clamp
    blocks, j = columns.split(response), np.zeros((len(q), m, 3, layout.size))
    put_blocks(j, session.columns, blocks | push_blocks(blocks["push"], force, axes, inputs.rate))
    put_tags(j, session.columns, partials.motion)
    return LinearisedTags(converged, q, both[:, 3 * m :].swapaxes(1, 2) @ axes, pose, j, blocks["push"] @ axes)


@dataclass(frozen=True)
class _TagPartials:
    """Derivatives of the tags' poses at a fixed curvature."""

    clamp: Array  # (B, m, 3) with the clamp's angle
    motion: TagMotion


def _tags(session: LiveSession, push_grid: PushGrid, x: Array, q: Array) -> tuple[Array, Array, _TagPartials]:
    """Poses (B, m, 3) of the tags on shapes q (B, Q), and their derivatives (B, m, 3, Q) with the curvature."""
    layout, m = session.layout, len(session.marker_s)
    cos, sin = _directions(push_grid, float(layout.get(x, "clamp")[0]), q)
    ways = np.concatenate([cos[:, None] * push_grid.steps, sin[:, None] * push_grid.steps], axis=1)  # (B, 2 m, Q)
    xy = ways.sum(axis=2).reshape(-1, 2, m).swapaxes(0, 1)
    moves, out = ways @ push_grid.to_nodes, q @ push_grid.reach.T
    angle, curved = float(layout.get(x, "clamp")[0]) + out[:, :m], out[:, m:]
    along, across = layout.get(x, "along"), layout.get(x, "across")
    half = 0.5 * along * curved
    way, angle = angle + half, angle + 2.0 * half  # a circle to where the tag sits
    u, v = np.array([np.cos(way), np.sin(way)]), np.array([-np.sin(angle), np.cos(angle)])  # (2, B, m)
    scale = 1.0 + float(layout.get(x, "scale")[0])
    xy = xy + along * u + across * v
    turn = push_grid.reach[:m] + along[:, None] * push_grid.reach[m:]
    half_turn, ahead, aside = 0.5 * (push_grid.reach[:m] + turn), along * u, across * v
    by_shape = np.empty((len(q), m, 3, q.shape[1]))
    by_shape[:, :, 0] = -moves[:, m:] - ahead[1][..., None] * half_turn - aside[1][..., None] * turn
    by_shape[:, :, 1] = moves[:, :m] + ahead[0][..., None] * half_turn + aside[0][..., None] * turn
    by_shape[:, :, 2] = turn
    if scale != 1.0:
        by_shape[:, :, :2] *= scale
    clamp, pose = np.ones((len(q), m, 3)), np.empty((len(q), m, 3))
    clamp[..., 0], clamp[..., 1] = -scale * xy[1], scale * xy[0]
    origin = layout.get(x, "origin")
    pose[..., 0], pose[..., 1] = scale * xy[0] + origin[0], scale * xy[1] + origin[1]
    pose[..., 2] = angle + layout.get(x, "turn")
    stride = scale * (u + half * np.array([-u[1], u[0]]) - (across * curved) * np.array([v[1], -v[0]]))
    motion = TagMotion(stride.transpose(1, 2, 0), curved, (scale * v).transpose(1, 2, 0), xy.transpose(1, 2, 0))
    return pose, by_shape, _TagPartials(clamp, motion)


def _shapes(push_grid: PushGrid, loaded: _LoadedBeam, start: Array | None) -> tuple[Array, BoolArray, list[Array]]:
    """Equilibria (B, Q), which of them were found, and the Cholesky factors of their tangents.

    Newton from `start`, its last tangent being good enough for derivatives; where it strays from a stable shape nearby,
    or without a start, the shapes are sought from rest.
    """
    if start is not None:
        q, moved, b = start.copy(), 0.0, push_grid.to_nodes.T
        update, factors = np.empty_like(q), list[Array]([q]) * len(q)
        for _ in range(_NEWTON_ITERATIONS):
            unbalanced, matrices = _balance(loaded, push_grid, q)
            info = 0
            for i, matrix in enumerate(matrices):
                factors[i], update[i], wrong = dposv(matrix, unbalanced[i], lower=1)
                info |= wrong
            if info:
                break
            q -= update
            turn = float(np.abs(update @ b).max())
            moved += turn
            if turn < _TOLERANCE:
                return q, np.ones(len(q), dtype=bool), factors
            if not moved < _TRUST:
                break
    problem = _problem(push_grid, loaded)
    from_rest = follow(problem)
    good, factors = from_rest.converged & from_rest.stable, []
    for i, matrix in enumerate(tangent(problem, from_rest.q)):
        factor, wrong = dpotrf(matrix, lower=1)
        factors.append(factor if wrong == 0 else np.eye(len(matrix)))
        good[i] &= wrong == 0
    return from_rest.q, good, factors


def _balance(loaded: _LoadedBeam, push_grid: PushGrid, q: Array) -> tuple[Array, Array]:
    """(B, Q) gradient and (B, Q, Q) tangent of dead loads, as `statics.balance`: on few nodes its ways cost more."""
    cos, sin = _directions(push_grid, loaded.alpha0, q)
    x, y = loaded.pull
    matrices = (x * cos + y * sin) @ push_grid.squares
    matrices[:, :: q.shape[1] + 1] += loaded.stiff
    return loaded.stiff * (q - loaded.q0) - (y * cos - x * sin) @ push_grid.to_nodes, matrices.reshape(*q.shape, -1)


def _loaded_beam(session: LiveSession, push_grid: PushGrid, x: Array, force: Array, inputs: FrameInputs) -> _LoadedBeam:
    layout = session.layout
    pushed = push_grid.beyond + (float(layout.get(x, "place")[0]) + inputs.farther)[:, None] * push_grid.farther
    dead = pushed * force.T[..., None]
    if session.mass > 0.0:
        mass = push_grid.mass_beyond[:, 0] + push_grid.mass_beyond @ layout.get(x, "mass")
        dead += mass * inputs.gravity.T[..., None]
    return _LoadedBeam(
        session.length,
        push_grid.weights * np.exp(push_grid.on_nodes @ layout.get(x, "stiffness")),
        push_grid.rest_on_nodes @ layout.get(x, "curvature"),
        float(layout.get(x, "clamp")[0]),
        force,
        pushed,
        inputs.gravity,
        push_grid.mass_beyond if session.weighs else push_grid.mass_beyond[:, :0],
        dead,
        session.length * push_grid.weights * dead,
    )


def _problem(push_grid: PushGrid, loaded: _LoadedBeam) -> Problem:
    """The problem of B frames."""
    size, nodes = loaded.pushed.shape
    return Problem(
        grid=push_grid.grid,
        weights=push_grid.weights,
        to_nodes=push_grid.to_nodes,
        length=np.asarray(loaded.length),
        k=loaded.stiff / push_grid.weights,
        q0=loaded.q0,
        alpha0=np.asarray(loaded.alpha0),
        dead_force=loaded.dead.transpose(1, 2, 0),
        moment=np.zeros((size, nodes)),
        follower=np.zeros((size, 0, 2)),
        follower_beyond=np.zeros((size, 0, nodes)),
        follower_rows=np.zeros((size, 0, nodes)),
    )


def _bent(push_grid: PushGrid, loaded: _LoadedBeam, q: Array, converged: BoolArray) -> BentBeam:
    """What the parameters change in the balance of shapes q (B, Q)."""
    reached, by_mass = converged.astype(float), None
    solved = Equilibrium(_problem(push_grid, loaded), q, converged, converged, reached, reached, ~converged, 0)
    if loaded.masses.shape[1]:
        pull = loaded.gravity[:, None, :, None] * loaded.masses[:, None, :]
        by_mass = Perturbation(pull, None, None, np.zeros(loaded.masses.shape[1]))
    return BentBeam(
        solved, push_grid.on_nodes, push_grid.rest_on_nodes, loaded.force, loaded.pushed, push_grid.farther, by_mass
    )


def _directions(push_grid: PushGrid, clamp: float, q: Array) -> tuple[Array, Array]:
    """(B, Q) cosine and sine of the beam's angle at the nodes."""
    alpha = clamp + q @ push_grid.to_nodes.T
    return np.cos(alpha), np.sin(alpha)


def _axes(layout: Layout, x: Array) -> Array:
    """(2, 2) by which the logged force is turned."""
    turn = float(layout.get(x, "direction")[0])
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([[cos, -sin], [sin, cos]])
