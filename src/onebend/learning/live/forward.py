"""Tags of a few frames at given parameters, with derivatives: the model of the live learner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotrs

from onebend.beam.statics.continuation import follow
from onebend.beam.statics.equilibrium import Equilibrium, tangent
from onebend.beam.statics.perturbation import Perturbation, minus_gradient
from onebend.beam.statics.problem import Problem
from onebend.learning.live.session import Place, Setting
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

_MOST = 8  # Newton iterations before the search from rest
_TRUST = 0.7  # rad: shapes that turn by more may have left the branch
_TOLERANCE = 1e-3  # rad, of the last update: the error is about its square


@dataclass(frozen=True)
class Inputs:
    """What acts on the beam in B frames."""

    force: Array  # (B, 2) N, corrected
    rate: Array  # (B, 2) N/s
    gravity: Array  # (B, 2) m/s^2
    farther: Array  # (B,) m that the push lies beyond its grid's place


@dataclass(frozen=True)
class Linear:
    """Tags' poses and their derivatives in B frames."""

    converged: BoolArray  # (B,)
    q: Array  # (B, Q) rad
    by_force: Array  # (B, Q, 2) of q with the logged force: where to start from next time
    pose: Array  # (B, m, 3)
    j: Array  # (B, m, 3, n) with the parameters
    a: Array  # (B, m, 3, 2) with the logged force, per N


@dataclass(frozen=True)
class _Load:
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


def linearise(setting: Setting, place: Place, x: Array, given: Inputs, start: Array | None) -> Linear:
    """Poses and derivatives at parameters x, from shapes `start` (B, Q) where there are any.

    Tags are fewer than parameters: the tangent is solved for the former (adjoint), and for the force.
    """
    at, m = setting.at, len(setting.marker_s)
    axes = _axes(at, x)
    force = (given.force + given.rate * at.get(x, "clock")) @ axes.T
    load = _load(setting, place, x, force, given)
    q, converged, factors = _shapes(place, load, start)
    bent = _bent(place, load, q, converged)
    columns = response_columns(balance_changes(bent))
    right = minus_gradient(bent.solved, columns.changes)
    pose, by_shape, of_tags = _tags(setting, place, x, q)
    push = right[..., columns.slices["push"]].swapaxes(1, 2)
    both = np.empty((len(q), 3 * m + 2, q.shape[1]))
    both[:, : 3 * m], both[:, 3 * m :] = by_shape.reshape(len(q), 3 * m, -1), push
    for one, factor in zip(both, factors, strict=True):
        one[:] = dpotrs(factor, one.T, lower=1, overwrite_b=1)[0].T
    response = (both[:, : 3 * m] @ right).reshape(len(q), m, 3, -1)
    response[..., columns.slices["clamp"].start] += of_tags.clamp
    blocks, j = columns.split(response), np.zeros((len(q), m, 3, at.size))
    put_blocks(j, setting.columns, blocks | push_blocks(blocks["push"], force, axes, given.rate))
    put_tags(j, setting.columns, of_tags.motion)
    return Linear(converged, q, both[:, 3 * m :].swapaxes(1, 2) @ axes, pose, j, blocks["push"] @ axes)


@dataclass(frozen=True)
class _OfTags:
    """How tags move with what holds them, the shape staying as it is."""

    clamp: Array  # (B, m, 3) with the clamp's angle
    motion: TagMotion


def _tags(setting: Setting, place: Place, x: Array, q: Array) -> tuple[Array, Array, _OfTags]:
    """Poses (B, m, 3) of the tags on shapes q (B, Q), and their derivatives (B, m, 3, Q) with the curvature."""
    at, m = setting.at, len(setting.marker_s)
    cos, sin = _directions(place, float(at.get(x, "clamp")[0]), q)
    ways = np.concatenate([cos[:, None] * place.steps, sin[:, None] * place.steps], axis=1)  # (B, 2 m, Q)
    xy = ways.sum(axis=2).reshape(-1, 2, m).swapaxes(0, 1)
    moves, out = ways @ place.to_nodes, q @ place.reach.T
    angle, curved = float(at.get(x, "clamp")[0]) + out[:, :m], out[:, m:]
    along, across = at.get(x, "along"), at.get(x, "across")
    half = 0.5 * along * curved
    way, angle = angle + half, angle + 2.0 * half  # a circle to where the tag sits
    u, v = np.array([np.cos(way), np.sin(way)]), np.array([-np.sin(angle), np.cos(angle)])  # (2, B, m)
    scale = 1.0 + float(at.get(x, "scale")[0])
    xy = xy + along * u + across * v
    turn = place.reach[:m] + along[:, None] * place.reach[m:]
    half_turn, ahead, aside = 0.5 * (place.reach[:m] + turn), along * u, across * v
    by_shape = np.empty((len(q), m, 3, q.shape[1]))
    by_shape[:, :, 0] = -moves[:, m:] - ahead[1][..., None] * half_turn - aside[1][..., None] * turn
    by_shape[:, :, 1] = moves[:, :m] + ahead[0][..., None] * half_turn + aside[0][..., None] * turn
    by_shape[:, :, 2] = turn
    if scale != 1.0:
        by_shape[:, :, :2] *= scale
    clamp, pose = np.ones((len(q), m, 3)), np.empty((len(q), m, 3))
    clamp[..., 0], clamp[..., 1] = -scale * xy[1], scale * xy[0]
    origin = at.get(x, "origin")
    pose[..., 0], pose[..., 1] = scale * xy[0] + origin[0], scale * xy[1] + origin[1]
    pose[..., 2] = angle + at.get(x, "turn")
    stride = scale * (u + half * np.array([-u[1], u[0]]) - (across * curved) * np.array([v[1], -v[0]]))
    motion = TagMotion(stride.transpose(1, 2, 0), curved, (scale * v).transpose(1, 2, 0), xy.transpose(1, 2, 0))
    return pose, by_shape, _OfTags(clamp, motion)


def _shapes(place: Place, load: _Load, start: Array | None) -> tuple[Array, BoolArray, list[Array]]:
    """Equilibria (B, Q), which of them were found, and the Cholesky factors of their tangents.

    Newton from `start`, its last tangent being good enough for derivatives; where it strays from a stable shape nearby,
    or without a start, the shapes are sought from rest.
    """
    if start is not None:
        q, moved, b = start.copy(), 0.0, place.to_nodes.T
        update, factors = np.empty_like(q), list[Array]([q]) * len(q)
        for _ in range(_MOST):
            unbalanced, matrices = _balance(load, place, q)
            info = 0
            for i, one in enumerate(matrices):
                factors[i], update[i], wrong = dposv(one, unbalanced[i], lower=1)
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
    problem = _problem(place, load)
    found = follow(problem)
    good, factors = found.converged & found.stable, []
    for i, one in enumerate(tangent(problem, found.q)):
        factor, wrong = dpotrf(one, lower=1)
        factors.append(factor if wrong == 0 else np.eye(len(one)))
        good[i] &= wrong == 0
    return found.q, good, factors


def _balance(load: _Load, place: Place, q: Array) -> tuple[Array, Array]:
    """(B, Q) gradient and (B, Q, Q) tangent of dead loads, as `statics.balance`: on few nodes its ways cost more."""
    cos, sin = _directions(place, load.alpha0, q)
    x, y = load.pull
    matrices = (x * cos + y * sin) @ place.squares
    matrices[:, :: q.shape[1] + 1] += load.stiff
    return load.stiff * (q - load.q0) - (y * cos - x * sin) @ place.to_nodes, matrices.reshape(*q.shape, -1)


def _load(setting: Setting, place: Place, x: Array, force: Array, given: Inputs) -> _Load:
    at = setting.at
    pushed = place.beyond + (float(at.get(x, "place")[0]) + given.farther)[:, None] * place.farther
    dead = pushed * force.T[..., None]
    if setting.mass > 0.0:
        mass = place.mass_beyond[:, 0] + place.mass_beyond @ at.get(x, "mass")
        dead += mass * given.gravity.T[..., None]
    return _Load(
        setting.length,
        place.weights * np.exp(place.on_nodes @ at.get(x, "stiffness")),
        place.rest_on_nodes @ at.get(x, "curvature"),
        float(at.get(x, "clamp")[0]),
        force,
        pushed,
        given.gravity,
        place.mass_beyond if setting.weighs else place.mass_beyond[:, :0],
        dead,
        setting.length * place.weights * dead,
    )


def _problem(place: Place, load: _Load) -> Problem:
    """The problem of B frames."""
    size, nodes = load.pushed.shape
    return Problem(
        grid=place.grid,
        weights=place.weights,
        to_nodes=place.to_nodes,
        length=np.asarray(load.length),
        k=load.stiff / place.weights,
        q0=load.q0,
        alpha0=np.asarray(load.alpha0),
        dead_force=load.dead.transpose(1, 2, 0),
        moment=np.zeros((size, nodes)),
        follower=np.zeros((size, 0, 2)),
        follower_beyond=np.zeros((size, 0, nodes)),
        follower_rows=np.zeros((size, 0, nodes)),
    )


def _bent(place: Place, load: _Load, q: Array, converged: BoolArray) -> BentBeam:
    """What the parameters change in the balance of shapes q (B, Q)."""
    reached, by_mass = converged.astype(float), None
    solved = Equilibrium(_problem(place, load), q, converged, converged, reached, reached, ~converged, 0)
    if load.masses.shape[1]:
        pull = load.gravity[:, None, :, None] * load.masses[:, None, :]
        by_mass = Perturbation(pull, None, None, np.zeros(load.masses.shape[1]))
    return BentBeam(solved, place.on_nodes, place.rest_on_nodes, load.force, load.pushed, place.farther, by_mass)


def _directions(place: Place, clamp: float, q: Array) -> tuple[Array, Array]:
    """(B, Q) cosine and sine of the beam's angle at the nodes."""
    alpha = clamp + q @ place.to_nodes.T
    return np.cos(alpha), np.sin(alpha)


def _axes(at: Layout, x: Array) -> Array:
    """(2, 2) by which the logged force is turned."""
    turn = float(at.get(x, "direction")[0])
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([[cos, -sin], [sin, cos]])
