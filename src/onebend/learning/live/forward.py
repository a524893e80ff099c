"""Tags of a few frames at given parameters, with derivatives: the model of the live learner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotrs

from onebend.beam.statics.continuation import follow
from onebend.beam.statics.equilibrium import tangent
from onebend.beam.statics.problem import Problem
from onebend.learning.live.session import Place, Setting
from onebend.learning.model.parameters import Layout
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
    at, p, m = setting.at, setting.at.spline.count, len(setting.marker_s)
    axes = _axes(at, x)
    force = (given.force + given.rate * at.get(x, "clock")) @ axes.T
    load = _load(setting, place, x, force, given)
    q, converged, factors = _shapes(place, load, start)
    right, cos, sin = _turning(place, load, q)
    pose, by_shape, of_tags = _tags(setting, place, x, (q, cos, sin))
    both = np.empty((len(q), 3 * m + 2, q.shape[1]))
    both[:, : 3 * m] = by_shape.reshape(len(q), 3 * m, -1)
    both[:, 3 * m :] = right[..., p + 4 : p + 6].swapaxes(1, 2)
    for one, factor in zip(both, factors, strict=True):
        one[:] = dpotrs(factor, one.T, lower=1, overwrite_b=1)[0].T
    mechanics = (both[:, : 3 * m] @ right).reshape(len(q), m, 3, -1)
    mechanics[..., p + 3] += of_tags.clamp
    j, a = _by_parameters(at, mechanics, given.rate, force, axes)
    _put_tags(j, at, of_tags)
    return Linear(converged, q, both[:, 3 * m :].swapaxes(1, 2) @ axes, pose, j, a)


@dataclass(frozen=True)
class _OfTags:
    """How tags move with what holds them, the shape staying as it is."""

    clamp: Array  # (B, m, 3) with the clamp's angle
    along: Array  # (2, B, m) per metre along the beam
    across: Array  # (2, B, m) to its left
    bend: Array  # (B, m) 1/m: turn per metre along
    xy: Array  # (2, B, m) m: with the camera's scale


def _tags(setting: Setting, place: Place, x: Array, shape: tuple[Array, Array, Array]) -> tuple[Array, Array, _OfTags]:
    """Poses (B, m, 3) of the tags on shapes (curvature, cosine and sine of the angle: (B, Q) each), and their
    derivatives (B, m, 3, Q) with the curvature."""
    at, m, (q, cos, sin) = setting.at, len(setting.marker_s), shape
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
    stride = u + half * np.array([-u[1], u[0]]) - (across * curved) * np.array([v[1], -v[0]])
    return pose, by_shape, _OfTags(clamp, scale * stride, scale * v, curved, xy)


def _by_parameters(at: Layout, mechanics: Array, rate: Array, force: Array, axes: Array) -> tuple[Array, Array]:
    """Derivatives (B, m, 3, n) with the parameters, from those in `_turning`'s order; (B, m, 3, 2) with the log."""
    p = at.spline.count
    j = np.zeros((*mechanics.shape[:-1], at.size))
    by_force = mechanics[..., p + 4 : p + 6]
    a = by_force @ axes
    j[..., :p] = mechanics[..., :p]
    _put(j, at, "curvature", mechanics[..., p : p + 3])
    _put(j, at, "clamp", mechanics[..., p + 3 : p + 4])
    _put(j, at, "place", mechanics[..., p + 6 : p + 7])
    _put(j, at, "mass", mechanics[..., p + 7 :])
    _put(j, at, "clock", a @ rate[:, None, :, None])
    across = np.stack([-force[:, 1], force[:, 0]], axis=-1)
    _put(j, at, "direction", by_force @ across[:, None, :, None])
    return j, a


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
    alpha = load.alpha0 + q @ place.to_nodes.T
    cos, sin = np.cos(alpha), np.sin(alpha)
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
    """The problem of B frames, for the search from rest."""
    size, nodes = load.pushed.shape
    return Problem(
        grid=place.grid,
        weights=place.weights,
        to_nodes=place.to_nodes,
        length=np.asarray(load.length),
        k=load.stiff / place.weights,
        q0=load.q0,
        alpha0=np.asarray(load.alpha0),
        dead_force=np.stack(tuple(load.dead), axis=-1),
        moment=np.zeros((size, nodes)),
        follower=np.zeros((size, 0, 2)),
        follower_beyond=np.zeros((size, 0, nodes)),
        follower_rows=np.zeros((size, 0, nodes)),
    )


def _turning(place: Place, load: _Load, q: Array) -> tuple[Array, Array, Array]:
    """(B, Q, P) what the parameters put out of balance: the tangent's inverse times it is the curvature's response; and
    cosine and sine of the beam's angle (B, Q).

    Parameters in this order: log k's coefficients, q0's, the clamp's angle, the force, its place, the mass's parts.
    """
    p, b, masses = place.on_nodes.shape[1], place.to_nodes, load.masses
    alpha = load.alpha0 + q @ b.T
    cos, sin = np.cos(alpha), np.sin(alpha)
    force, arm = load.force, load.length * place.weights * load.pushed
    right = np.empty((*q.shape, p + 7 + masses.shape[1]))
    np.multiply((load.stiff * (load.q0 - q))[..., None], place.on_nodes, out=right[..., :p])
    right[..., p : p + 3] = load.stiff[:, None] * place.rest_on_nodes
    lever = np.empty((*q.shape, 4 + masses.shape[1]))  # what turns the nodes, to be summed up
    x, y = load.pull
    lever[..., 0] = -x * cos - y * sin
    lever[..., 1], lever[..., 2] = -arm * sin, arm * cos
    across = force[:, 1:] * cos - force[:, :1] * sin
    lever[..., 3] = (load.length * place.weights * place.farther) * across
    if masses.shape[1]:
        falling = load.gravity[:, 1:] * cos - load.gravity[:, :1] * sin
        lever[..., 4:] = (load.length * place.weights * falling)[..., None] * masses
    np.matmul(b.T, lever, out=right[..., p + 3 :])
    return right, cos, sin


def _axes(at: Layout, x: Array) -> Array:
    """(2, 2) by which the logged force is turned."""
    turn = float(at.get(x, "direction")[0])
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([[cos, -sin], [sin, cos]])


def _put(j: Array, at: Layout, name: str, values: Array) -> None:
    columns = at.columns(name)
    if columns is not None:
        j[..., columns] = values


def _put_tags(j: Array, at: Layout, of_tags: _OfTags) -> None:
    """Derivatives with each tag's place and turn, the origin and the camera's scale."""
    tags = np.arange(j.shape[1])
    along, across, turn = at.columns("along"), at.columns("across"), at.columns("turn")
    origin, size = at.columns("origin"), at.columns("scale")
    for i in range(2):
        if along is not None:
            j[:, tags, i, along.start + tags] = of_tags.along[i]
        if across is not None:
            j[:, tags, i, across.start + tags] = of_tags.across[i]
        if origin is not None:
            j[:, :, i, origin.start + i] = 1.0
        if size is not None:
            j[:, :, i, size.start] = of_tags.xy[i]
    if along is not None:
        j[:, tags, 2, along.start + tags] = of_tags.bend
    if turn is not None:
        j[:, tags, 2, turn.start + tags] = 1.0
