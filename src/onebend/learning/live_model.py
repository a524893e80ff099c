"""Tags of a few frames at given parameters, with derivatives: the model of the live learner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.continuation import follow
from onebend.beam.grid import Grid, make_grid
from onebend.beam.modes import Modes
from onebend.beam.newton import solve_batch
from onebend.beam.problem import Problem
from onebend.beam.statics import gradient, positive_definite, tangent
from onebend.learning.parameters import Block, Layout, Priors
from onebend.learning.spline import Spline
from onebend.records import Array, BoolArray

ORDER, WIDEST = 12, 0.5
REST_MODES = Modes(3)
_MOST = 8  # Newton iterations before the search from rest
_TRUST = 0.7  # rad: shapes that turn by more may have left the branch
_TOLERANCE = 3e-7  # rad, of the last update: the error is its square


@dataclass(frozen=True)
class Setting:
    """What does not change while one beam is filmed."""

    length: float  # m
    marker_s: Array  # (m,)
    mass: float  # kg
    at: Layout


@dataclass(frozen=True)
class Place:
    """Everything that depends only on where the force acts."""

    grid: Grid
    to_nodes: Array  # (Q, Q)
    weights: Array  # (Q,)
    beyond: Array  # (Q,) 1 where the push lies beyond the node
    mass_beyond: Array  # (Q,) kg
    on_nodes: Array  # (Q, p)
    rest_on_nodes: Array  # (Q, 3)
    rows: Array  # (m, Q): integrals up to the markers


@dataclass(frozen=True)
class Inputs:
    """What acts on the beam in B frames."""

    force: Array  # (B, 2) N, corrected
    rate: Array  # (B, 2) N/s
    gravity: Array  # (B, 2) m/s^2


@dataclass(frozen=True)
class Linear:
    """Tags' poses and their derivatives in B frames."""

    converged: BoolArray  # (B,)
    q: Array  # (B, Q) rad
    pose: Array  # (B, m, 3)
    j: Array  # (B, m, 3, n) with the parameters
    a: Array  # (B, m, 3, 2) with the force, per N


def live_layout(
    spline: Spline, tags: int, priors: Priors, *, placement_sd: float, rest_unknown: bool, calibrated: bool
) -> Layout:
    """The parameters of one beam under one camera; the force's error is a process and not among them."""
    placement = placement_sd if priors.placement is None else priors.placement
    origin = placement_sd if priors.origin is None else priors.origin
    numbers = range(1, tags + 1)
    wanted: list[tuple[str, str, float, tuple[str, ...]]] = [
        ("stiffness", "log(N m)", 1.0, tuple(f"c{i}" for i in range(spline.count))),
        ("curvature", "rad", priors.curvature if rest_unknown else 0.0, ("q0 mean", "q0 slope", "q0 bow")),
        ("along", "m", placement, tuple(f"tag {i} along" for i in numbers)),
        ("across", "m", placement, tuple(f"tag {i} across" for i in numbers)),
        ("turn", "rad", priors.mounting, tuple(f"tag {i} turn" for i in numbers)),
        ("clamp", "rad", priors.clamp, ("clamp angle",)),
        ("origin", "m", origin, ("origin x", "origin y")),
        ("scale", "1", 0.0 if calibrated else priors.scale, ("camera scale",)),
        ("clock", "s", priors.clock or 0.0, ("clock offset",)),
    ]
    blocks, start = [], 0
    for name, unit, sd, labels in wanted:
        blocks.append(Block(name, -1, unit, np.full(len(labels), sd), labels, start if sd > 0.0 else -1))
        start += len(labels) if sd > 0.0 else 0
    return Layout(spline, tuple(blocks), start, {(b.name, -1): b for b in blocks})


def place_at(setting: Setting, push_s: float) -> Place:
    """The grid and what stands on it for a push at `push_s`."""
    grid = make_grid((0.5 * push_s, push_s), order=ORDER, widest=WIDEST)
    nodes = grid.nodes
    return Place(
        grid=grid,
        to_nodes=grid.integral_to_nodes,
        weights=grid.weights,
        beyond=np.asarray(nodes < push_s, dtype=float),
        mass_beyond=setting.mass * (1.0 - nodes),
        on_nodes=setting.at.spline.basis(nodes),
        rest_on_nodes=REST_MODES.curvature(nodes),
        rows=grid.integral_to(setting.marker_s),
    )


def linearise(setting: Setting, place: Place, x: Array, given: Inputs, start: Array | None) -> Linear:
    """Poses and derivatives at parameters x, from shapes `start` (B, Q) where there are any."""
    at = setting.at
    problem = _problem(setting, place, x, given)
    q, converged, matrices = _shapes(problem, start)
    alpha = problem.alpha0 + q @ place.to_nodes.T
    cos, sin = np.cos(alpha), np.sin(alpha)
    turned_nodes, turn = _response(place, problem, q, matrices, cos, sin)
    rows = setting.length * place.rows
    xy = np.stack([cos @ rows.T, sin @ rows.T], axis=-1)
    dxy = np.stack([rows @ (-sin[..., None] * turned_nodes), rows @ (cos[..., None] * turned_nodes)], axis=2)
    angle = problem.alpha0 + q @ place.rows.T
    along, across = at.get(x, "along"), at.get(x, "across")
    c, s = np.cos(angle), np.sin(angle)
    scale = 1.0 + float(at.get(x, "scale")[0])
    swing = np.stack([-s * along - c * across, c * along - s * across], axis=-1)
    beam_xy = xy + np.stack([swing[..., 1], -swing[..., 0]], axis=-1)
    mechanics = np.concatenate([scale * (dxy + swing[..., None] * turn[:, :, None, :]), turn[:, :, None, :]], axis=2)
    pose = np.concatenate([scale * beam_xy + at.get(x, "origin"), (angle + at.get(x, "turn"))[..., None]], axis=-1)
    j, p = np.zeros((*pose.shape, at.size)), at.spline.count
    a = mechanics[..., p + 4 :]
    j[..., :p] = mechanics[..., :p]
    _put(j, at, "curvature", mechanics[..., p : p + 3])
    _put(j, at, "clamp", mechanics[..., p + 3 : p + 4])
    _put(j, at, "clock", (a @ given.rate[:, None, :, None]))
    _put_tags(j, at, c, s, scale, beam_xy)
    return Linear(converged, q, pose, j, a)


def _shapes(problem: Problem, start: Array | None) -> tuple[Array, BoolArray, Array]:
    """Equilibria (B, Q), which of them were found, and their tangents (B, Q, Q).

    Newton from `start`, its last tangent being good enough for derivatives; where it strays from a stable shape nearby,
    or without a start, the shapes are sought from rest.
    """
    if start is not None:
        q, moved = start.copy(), 0.0
        for _ in range(_MOST):
            matrices = tangent(problem, q)
            update = solve_batch(matrices, gradient(problem, q))
            q -= update
            turn = float(np.max(np.abs(update @ problem.to_nodes.T)))
            moved += turn
            if not moved < _TRUST:
                break
            if turn < _TOLERANCE:
                if np.all(positive_definite(matrices)):
                    return q, np.ones(len(q), dtype=bool), matrices
                break
    solved = follow(problem)
    return solved.q, solved.converged & solved.stable, tangent(problem, solved.q)


def _problem(setting: Setting, place: Place, x: Array, given: Inputs) -> Problem:
    at, size, nodes = setting.at, len(given.force), len(place.weights)
    force = given.force + given.rate * at.get(x, "clock")
    dead = place.beyond[:, None] * force[:, None, :] + place.mass_beyond[:, None] * given.gravity[:, None, :]
    return Problem(
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


def _response(place: Place, problem: Problem, q: Array, matrices: Array, cos: Array, sin: Array) -> tuple[Array, Array]:
    """Turn of the nodes (B, Q, P) and of the beam under the markers (B, m, P) by the implicit function theorem.

    Parameters in this order: log k's coefficients, q0's, the clamp's angle, the force.
    """
    p, b = place.on_nodes.shape[1], place.to_nodes
    right = np.empty((*q.shape, p + 6))
    stiff, pull = place.weights * problem.k, problem.length * place.weights
    right[..., :p] = -(stiff * (q - problem.q0))[..., None] * place.on_nodes
    right[..., p : p + 3] = stiff[:, None] * place.rest_on_nodes
    right[..., p + 3] = -(pull * (problem.dead_force[..., 0] * cos + problem.dead_force[..., 1] * sin)) @ b
    right[..., p + 4] = -(pull * place.beyond * sin) @ b
    right[..., p + 5] = (pull * place.beyond * cos) @ b
    try:
        response = np.linalg.solve(matrices, right)
    except np.linalg.LinAlgError:  # of a frame that was not found either
        response = np.zeros_like(right)
    clamp = np.zeros(p + 6)
    clamp[p + 3] = 1.0
    return b @ response + clamp, place.rows @ response + clamp


def _put(j: Array, at: Layout, name: str, values: Array) -> None:
    columns = at.columns(name)
    if columns is not None:
        j[..., columns] = values


def _put_tags(j: Array, at: Layout, c: Array, s: Array, scale: float, beam_xy: Array) -> None:
    """Derivatives with each tag's place and turn, the origin and the camera's scale."""
    tags = np.arange(c.shape[1])
    along, across, turn = at.columns("along"), at.columns("across"), at.columns("turn")
    if along is not None:
        j[:, tags, 0, along.start + tags], j[:, tags, 1, along.start + tags] = scale * c, scale * s
    if across is not None:
        j[:, tags, 0, across.start + tags], j[:, tags, 1, across.start + tags] = -scale * s, scale * c
    if turn is not None:
        j[:, tags, 2, turn.start + tags] = 1.0
    origin, size = at.columns("origin"), at.columns("scale")
    if origin is not None:
        j[:, :, 0, origin.start] = j[:, :, 1, origin.start + 1] = 1.0
    if size is not None:
        j[:, :, :2, size.start] = beam_xy
