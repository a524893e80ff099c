"""Tags of a few frames at given parameters, with derivatives: the model of the live learner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv, dpotrs

from onebend.beam.continuation import follow
from onebend.beam.problem import Problem
from onebend.beam.statics import tangent
from onebend.learning.live_setting import Place, Setting
from onebend.learning.parameters import Layout
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


def linearise(setting: Setting, place: Place, x: Array, given: Inputs, start: Array | None) -> Linear:
    """Poses and derivatives at parameters x, from shapes `start` (B, Q) where there are any."""
    at = setting.at
    axes = _axes(at, x)
    force = (given.force + given.rate * at.get(x, "clock")) @ axes.T
    problem, pushed = _problem(setting, place, x, force, given)
    weights = place.mass_beyond if setting.weighs else place.mass_beyond[:, :0]
    q, converged, bent = _shapes(place, problem, start, (force, pushed, given.gravity, weights))
    alpha = problem.alpha0 + q @ place.to_nodes.T
    cos, sin = np.cos(alpha), np.sin(alpha)
    clamp, p = np.zeros(bent.shape[-1]), at.spline.count
    clamp[p + 3] = 1.0
    turned_nodes, turn = place.to_nodes @ bent + clamp, place.rows @ bent + clamp
    rows = setting.length * place.rows
    xy = np.stack([cos @ rows.T, sin @ rows.T], axis=-1)
    dxy = np.stack([rows @ (-sin[..., None] * turned_nodes), rows @ (cos[..., None] * turned_nodes)], axis=2)
    angle, curved = problem.alpha0 + q @ place.rows.T, q @ place.bend.T
    along, across = at.get(x, "along"), at.get(x, "across")
    way, angle = angle + 0.5 * curved * along, angle + curved * along  # a circle to where the tag sits
    u, v = _directions(way), _directions(angle)
    scale = 1.0 + float(at.get(x, "scale")[0])
    beam_xy = xy + along[:, None] * u[0] + across[:, None] * v[1]
    more = along[:, None] * (place.bend @ bent)
    dxy += (along[:, None] * u[1])[..., None] * (turn + 0.5 * more)[:, :, None, :]
    turn = turn + more
    dxy -= (across[:, None] * v[0])[..., None] * turn[:, :, None, :]
    mechanics = np.concatenate([scale * dxy, turn[:, :, None, :]], axis=2)
    pose = np.concatenate([scale * beam_xy + at.get(x, "origin"), (angle + at.get(x, "turn"))[..., None]], axis=-1)
    j, a = _by_parameters(at, mechanics, given.rate, force, axes)
    stride = u[0] + (0.5 * curved * along)[..., None] * u[1] - (curved * across)[..., None] * v[0]
    _put_tags(j, at, scale * stride, curved, scale * v[1], beam_xy)
    return Linear(converged, q, bent[..., p + 4 : p + 6] @ axes, pose, j, a)


def _by_parameters(at: Layout, mechanics: Array, rate: Array, force: Array, axes: Array) -> tuple[Array, Array]:
    """Derivatives (B, m, 3, n) with the parameters, from those of `_response`; (B, m, 3, 2) with the log."""
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


def _shapes(
    place: Place, problem: Problem, start: Array | None, load: tuple[Array, Array, Array, Array]
) -> tuple[Array, BoolArray, Array]:
    """Equilibria (B, Q), which of them were found, and how they respond to the parameters (`_turning`): (B, Q, P).

    Newton from `start`, its last tangent being good enough for derivatives; where it strays from a stable shape nearby,
    or without a start, the shapes are sought from rest.
    """
    if start is not None:
        q, moved = start.copy(), 0.0
        for _ in range(_MOST):
            unbalanced, matrices = _balance(problem, place, q)
            solved = [dposv(one, right, lower=1) for one, right in zip(matrices, unbalanced, strict=True)]
            if any(info for _, _, info in solved):
                break
            update = np.stack([one for _, one, _ in solved])
            q -= update
            turn = float(np.abs(update @ problem.to_nodes.T).max())
            moved += turn
            if turn < _TOLERANCE:
                right = _turning(place, problem, q, load)
                each = [dpotrs(factor, one, lower=1)[0] for (factor, _, _), one in zip(solved, right, strict=True)]
                return q, np.ones(len(q), dtype=bool), np.stack(each)
            if not moved < _TRUST:
                break
    found = follow(problem)
    q, good = found.q, found.converged & found.stable
    bent = _turning(place, problem, q, load)
    for i, one in enumerate(tangent(problem, q)):
        _, bent[i], info = dposv(one, bent[i], lower=1)
        good[i] &= info == 0
    return q, good, bent


def _balance(problem: Problem, place: Place, q: Array) -> tuple[Array, Array]:
    """(B, Q) gradient and (B, Q, Q) tangent of dead loads, as `statics.balance`: on few nodes its ways cost more."""
    alpha = problem.alpha0 + q @ place.to_nodes.T
    cos, sin = np.cos(alpha), np.sin(alpha)
    x, y = problem.dead_pull
    stiff = place.weights * problem.k
    matrices = ((x * cos + y * sin) @ place.squares).reshape(*q.shape, -1)
    matrices.reshape(len(q), -1)[:, :: q.shape[1] + 1] += stiff
    return stiff * (q - problem.q0) - (y * cos - x * sin) @ place.to_nodes, matrices


def _problem(setting: Setting, place: Place, x: Array, force: Array, given: Inputs) -> tuple[Problem, Array]:
    """The problem of B frames, and (B, Q) the share of the push beyond each node."""
    at, size, nodes = setting.at, len(force), len(place.weights)
    pushed = place.beyond + (float(at.get(x, "place")[0]) + given.farther)[:, None] * place.farther
    mass = place.mass_beyond[:, 0] + place.mass_beyond @ at.get(x, "mass")
    dead = pushed[..., None] * force[:, None, :] + mass[:, None] * given.gravity[:, None, :]
    problem = Problem(
        grid=place.grid,
        weights=place.weights,
        to_nodes=place.to_nodes,
        length=np.asarray(setting.length),
        k=np.exp(place.on_nodes @ at.get(x, "stiffness")),
        q0=place.rest_on_nodes @ at.get(x, "curvature"),
        alpha0=np.asarray(at.get(x, "clamp")[0]),
        dead_force=dead,
        moment=np.zeros((size, nodes)),
        follower=np.zeros((size, 0, 2)),
        follower_beyond=np.zeros((size, 0, nodes)),
        follower_rows=np.zeros((size, 0, nodes)),
    )
    return problem, pushed


def _turning(place: Place, problem: Problem, q: Array, load: tuple[Array, Array, Array, Array]) -> Array:
    """(B, Q, P) what the parameters put out of balance; the tangent's inverse times it is the curvature's response.

    Parameters in this order: log k's coefficients, q0's, the clamp's angle, the force, its place, the mass's parts
    (`load`: forces, share of the push beyond the nodes, gravity, kg of each part beyond the nodes).
    """
    force, pushed, gravity, weights = load
    p, b = place.on_nodes.shape[1], place.to_nodes
    alpha = problem.alpha0 + q @ b.T
    cos, sin = np.cos(alpha), np.sin(alpha)
    right = np.empty((*q.shape, p + 7 + weights.shape[1]))
    stiff, pull = place.weights * problem.k, problem.length * place.weights
    right[..., :p] = -(stiff * (q - problem.q0))[..., None] * place.on_nodes
    right[..., p : p + 3] = stiff[:, None] * place.rest_on_nodes
    lever = np.empty((*q.shape, 4 + weights.shape[1]))  # what turns the nodes, to be summed up
    lever[..., 0] = -pull * (problem.dead_force[..., 0] * cos + problem.dead_force[..., 1] * sin)
    lever[..., 1], lever[..., 2] = -pull * pushed * sin, pull * pushed * cos
    lever[..., 3] = pull * place.farther * (force[:, 1:] * cos - force[:, :1] * sin)
    if weights.shape[1]:
        lever[..., 4:] = (pull * (gravity[:, 1:] * cos - gravity[:, :1] * sin))[..., None] * weights
    right[..., p + 3 :] = b.T @ lever
    return right


def _axes(at: Layout, x: Array) -> Array:
    """(2, 2) by which the logged force is turned."""
    turn = float(at.get(x, "direction")[0])
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([[cos, -sin], [sin, cos]])


def _put(j: Array, at: Layout, name: str, values: Array) -> None:
    columns = at.columns(name)
    if columns is not None:
        j[..., columns] = values


def _put_tags(j: Array, at: Layout, stride: Array, bend: Array, aside: Array, beam_xy: Array) -> None:
    """Derivatives with each tag's place and turn, the origin and the camera's scale.

    `stride` and `aside` (B, m, 2): how a tag moves per metre along and across; `bend` (B, m): how it turns per metre.
    """
    tags = np.arange(bend.shape[1])
    along, across, turn = at.columns("along"), at.columns("across"), at.columns("turn")
    origin, size = at.columns("origin"), at.columns("scale")
    for i in range(2):
        if along is not None:
            j[:, tags, i, along.start + tags] = stride[..., i]
        if across is not None:
            j[:, tags, i, across.start + tags] = aside[..., i]
        if origin is not None:
            j[:, :, i, origin.start + i] = 1.0
    if along is not None:
        j[:, tags, 2, along.start + tags] = bend
    if turn is not None:
        j[:, tags, 2, turn.start + tags] = 1.0
    if size is not None:
        j[:, :, :2, size.start] = beam_xy


def _directions(angle: Array) -> tuple[Array, Array]:
    """Units (..., 2) along an angle and to its left."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)
