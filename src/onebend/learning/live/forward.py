"""Poses of the tags in a few frames at given parameters, with derivatives: the model of the live learner."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotrs

from onebend.beam.grid import paired
from onebend.beam.statics.continuation import follow
from onebend.beam.statics.equilibrium import Equilibrium, tangent
from onebend.beam.statics.nodal_forces import nodal_forces
from onebend.beam.statics.perturbation import Perturbation, adjoint_times, minus_gradient, moved_by_strain
from onebend.beam.statics.problem import Problem
from onebend.learning.allowances.causal import CLAMP, SLIDE, CourseBases
from onebend.learning.allowances.relaxation import shift_of_lags
from onebend.learning.live.session import FrameInputs, LiveSession, Memory, PointBeam, PushGrid
from onebend.learning.model.parameters import Layout
from onebend.learning.model.tag_jacobian import (
    BentBeam,
    ResponseColumns,
    TagRide,
    joined_functions,
    load_changes,
    material_changes,
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
class LinearisedTags:
    """Tags' poses and their derivatives in B frames."""

    converged: BoolArray  # (B,)
    q: Array  # (B, Q) rad
    by_force: Array  # (B, Q, 2) of q with the logged force: where to start from next time
    lags: Array  # (B, Q, r) rad, curvatures that lag behind q
    pose: Array  # (B, m, 3)
    j: Array  # (B, m, 3, n) with the parameters
    a: Array  # (B, m, 3, 2) with the logged force, per N

    def take(self, chosen: BoolArray) -> LinearisedTags:
        """Some of the frames."""
        return LinearisedTags(*(getattr(self, each.name)[chosen] for each in fields(self)))


@dataclass(frozen=True)
class _LoadedBeam:
    """The beam and what acts on it in B frames, on the grid of a place."""

    problem: Problem
    stiff: Array  # (Q,) k times the nodes' weights
    force: Array  # (B, 2) N
    pushed: Array  # (B, Q) share of the push beyond each node
    by_mass: Perturbation | None  # the parts of the mass; None where nothing weighs


def linearise(
    session: LiveSession, push_grid: PushGrid, x: Array, inputs: FrameInputs, start: Array | None
) -> LinearisedTags:
    """Poses and derivatives at parameters x, from shapes `start` (B, Q) where there are any.

    The tags have fewer coordinates than there are parameters, so the tangent is solved for those (the adjoint way), and
    for the force. What a beam that relaxes remembers is taken at `start`, and as given: it has no derivatives but those
    with the shares.
    """
    layout, m, beam = session.layout, len(session.marker_s), _beam_at(session, push_grid, x)
    bases, straight = CourseBases(inputs.terms, m, session.carried), beam.problem.q0
    logged = (inputs.force + inputs.rate * layout.get(x, "clock")) @ beam.axes.T
    q0, by_shares = _rest_shift(session, x, inputs.memory, start, straight)
    loaded = _loaded_beam(session, push_grid, beam, logged + bases.force @ layout.get(x, "posture"), inputs, q0)
    q, converged, factors = _shapes(push_grid, loaded, start)
    bent = _bent(push_grid, loaded, by_shares, q, converged)
    loads, tags = response_columns(load_changes(bent)), _Tags(session, push_grid, x, bent.solved)
    right = minus_gradient(bent.solved, loads.changes)
    both = np.concatenate([tags.by_shape, right[..., loads.slices["push"]].swapaxes(1, 2)], axis=1)
    for rows, factor in zip(both, factors, strict=True):
        rows[:] = dpotrs(factor, rows.T, lower=1, overwrite_b=1)[0].T
    adjoint, material = both[:, : 3 * m], _material(bent.solved, beam)
    response = np.concatenate([adjoint @ right, adjoint_times(adjoint, bent.solved, material)], axis=2)
    response = response.reshape(len(q), m, 3, -1)
    columns = _with_material(loads, material, beam)
    tags.add_direct(response, columns)
    blocks, j = columns.split(tags.ride.carry(response)), np.zeros((len(q), m, 3, layout.size))
    further = push_blocks(blocks["push"], logged, beam.axes, inputs.rate) | bases.blocks(blocks)
    put_blocks(j, session.columns, blocks | further)
    put_tags(j, session.columns, tags.motion)
    pose, a = tags.pose + bases.moved({name: layout.get(x, name) for name in bases.poses}), blocks["push"] @ beam.axes
    by_force, lags = both[:, 3 * m :].swapaxes(1, 2) @ beam.axes, inputs.memory.lags(q - straight)
    return LinearisedTags(converged, q, by_force, lags, pose, j, a)


def _material(solved: Equilibrium, beam: PointBeam) -> Perturbation:
    """The groups of `material_changes`, one after the other."""
    problem, nothing = solved.problem, np.zeros(beam.elastic.shape[1])
    compliance = None if problem.compliance is None else (problem.compliance, beam.compliant)
    return Perturbation(None, None, (solved.q - problem.q0, beam.elastic), nothing, compliance)


def _with_material(loads: ResponseColumns, material: Perturbation, beam: PointBeam) -> ResponseColumns:
    """The columns of the loads, and behind them those of the material."""
    first = len(loads.changes.clamp)
    behind = {name: slice(first + c.start, first + c.stop) for name, c in beam.columns.items()}
    return ResponseColumns(loads.changes + material, loads.slices | behind)


def _rest_shift(
    session: LiveSession, x: Array, memory: Memory, start: Array | None, straight: Array
) -> tuple[Array, Array | None]:
    """(Q,) or (B, Q) rad, the curvature at rest of a beam that remembers; (B, Q, r), how it goes with the shares that
    relax, None where nothing does."""
    if not session.carries("relaxation"):
        return straight, None
    bending = np.zeros(memory.before.shape[:2]) if start is None else start - straight
    shares = session.layout.get(x, "relaxation")
    shift, by_shares = shift_of_lags(shares, memory.lags(bending), bending, memory.reached)
    return straight + shift, by_shares


class _Tags:
    """The tags on shapes of B frames: their poses, and derivatives with the curvature (B, 3 m, Q) and else."""

    def __init__(self, session: LiveSession, push_grid: PushGrid, x: Array, solved: Equilibrium) -> None:
        layout, problem, q, m = session.layout, solved.problem, solved.q, len(session.marker_s)
        wanted = session.marker_s + layout.get(x, "along") / session.length
        s = np.clip(wanted, 0.0, 1.0)
        integral, value = push_grid.places(s)
        self._rows, self._solved, over = float(problem.length) * integral, solved, session.length * (wanted - s)
        slope, lever = paired(solved.forces.cos, solved.forces.sin), solved.forces.lever
        if problem.compliance is not None:
            slope += solved.strained
        self._xy = self._rows @ slope  # (B, m, 2)
        self.by_shape = np.empty((len(q), 3 * m, q.shape[1]))
        ways = lever.swapaxes(1, 2)[:, :, None] * self._rows  # (B, 2, m, Q)
        by_shape = self.by_shape.reshape(len(q), m, 3, -1)
        by_shape[:, :, :2] = (ways @ problem.to_nodes).swapaxes(1, 2)
        by_shape[:, :, 2] = integral
        self._turned = ways.sum(axis=-1).swapaxes(1, 2)  # (B, m, 2)
        scale, origin = 1.0 + float(layout.get(x, "scale")[0]), layout.get(x, "origin")
        self.ride = TagRide(problem.alpha0 + q @ integral.T, over, layout.get(x, "across"), scale)
        xy = self._xy + self.ride.offset
        self.pose = np.concatenate([scale * xy + origin, (self.ride.angle + layout.get(x, "turn"))[..., None]], axis=-1)
        on_beam = over <= 0.0
        onward = float(problem.length) / session.length * (value @ slope)
        if not np.all(on_beam):
            tangent_there = paired(np.cos(self.ride.angle), np.sin(self.ride.angle))
            onward = np.where(on_beam[:, None], onward, tangent_there)
        bend = (q @ value.T) * (on_beam / session.length)
        self.motion = self.ride.motion(xy, bend, onward)

    def add_direct(self, response: Array, columns: ResponseColumns) -> None:
        """Add what moves the beam's places (B, m, 3, P) at fixed curvature: a turn of the clamp, strain, length."""
        clamp = columns.slices["clamp"].start
        response[:, :, :2, clamp] += self._turned
        response[:, :, 2, clamp] += 1.0
        if "length" in columns.slices:
            response[:, :, :2, columns.slices["length"].start] += self._xy
        for where, part in columns.changes.columns:
            moved = moved_by_strain(self._solved, self._rows, part)
            if moved is not None:
                response[:, :, :2, where] += moved


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
    from_rest = follow(loaded.problem)
    good, factors = from_rest.converged & from_rest.stable, []
    for i, matrix in enumerate(tangent(loaded.problem, from_rest.q)):
        factor, wrong = dpotrf(matrix, lower=1)
        factors.append(factor if wrong == 0 else np.eye(len(matrix)))
        good[i] &= wrong == 0
    return from_rest.q, good, factors


def _balance(loaded: _LoadedBeam, push_grid: PushGrid, q: Array) -> tuple[Array, Array]:
    """(B, Q) gradient and (B, Q, Q) tangent, as `equilibrium.balance` without its look-ups."""
    forces = nodal_forces(loaded.problem, q)
    matrices = forces.along @ push_grid.squares
    matrices[:, :: q.shape[1] + 1] += loaded.stiff
    unbalanced = loaded.stiff * (q - loaded.problem.q0) - forces.across @ push_grid.to_nodes
    return unbalanced, matrices.reshape(*q.shape, -1)


def _loaded_beam(
    session: LiveSession, push_grid: PushGrid, beam: PointBeam, force: Array, inputs: FrameInputs, q0: Array
) -> _LoadedBeam:
    layout, terms, x = session.layout, inputs.terms, beam.x
    place = layout.get(x, "place") + inputs.farther + terms[:, SLIDE.start] * layout.get(x, "slide")
    pushed, by_mass = push_grid.beyond + place[:, None] * push_grid.farther, None
    dead = pushed[..., None] * force[:, None]
    if session.mass > 0.0 and np.any(inputs.gravity):
        mass = push_grid.mass_beyond[:, 0] + push_grid.mass_beyond @ layout.get(x, "mass")
        dead += mass[:, None] * inputs.gravity[:, None]
        pull = inputs.gravity[:, None, :, None] * push_grid.mass_beyond[:, None, :]
        by_mass = Perturbation(pull, None, None, np.zeros(4)) if session.weighs else None
    alpha0 = layout.get(x, "clamp") + terms[:, CLAMP] * layout.get(x, "clamp gives")
    return _LoadedBeam(beam.problem.under(dead, q0, alpha0), beam.stiff, force, pushed, by_mass)


def _beam_at(session: LiveSession, push_grid: PushGrid, x: Array) -> PointBeam:
    """The beam at parameters x. It is kept, as all key frames are linearised at one point."""
    if push_grid.kept and push_grid.kept[0].x is x:
        return push_grid.kept[0]
    layout, (size, p) = session.layout, push_grid.log_k.shape
    none, (section, thickens) = np.zeros((1, 0, size)), session.section(x)
    problem = Problem(
        grid=push_grid.grid,
        weights=push_grid.weights,
        to_nodes=push_grid.to_nodes,
        length=np.asarray(session.length * np.exp(layout.get(x, "length")[0])),
        k=np.exp(push_grid.log_k @ np.concatenate([layout.get(x, "stiffness"), layout.get(x, "patches")])),
        q0=push_grid.rest_on_nodes @ layout.get(x, "curvature"),
        alpha0=np.zeros((1, 1)),
        dead_force=np.zeros((1, size, 2)),
        moment=np.zeros((1, size)),
        follower=none[..., :2],
        follower_beyond=none,
        follower_rows=none,
        section=section,
    )
    at_rest = _solved(problem, np.broadcast_to(problem.q0, (1, size)), np.ones(1, dtype=bool))
    lengthens = session.carries("length")
    bent = BentBeam(
        at_rest, push_grid.log_k, none, np.zeros((1, 2)), none, none, lengthens=lengthens, thickens=thickens
    )
    changes = material_changes(bent)
    columns = response_columns(changes).slices
    last = session.layout.spline.count
    columns |= {"stiffness": slice(0, last), "patches": slice(last, p)}
    elastic, compliant = joined_functions(changes, size)
    beam = PointBeam(x, problem, push_grid.weights * problem.k, _axes(layout, x), columns, elastic, compliant)
    push_grid.kept[:] = [beam]
    return beam


def _solved(problem: Problem, q: Array, converged: BoolArray) -> Equilibrium:
    reached = converged.astype(float)
    return Equilibrium(problem, q, converged, converged, reached, reached, ~converged, 0)


def _bent(
    push_grid: PushGrid, loaded: _LoadedBeam, by_shares: Array | None, q: Array, converged: BoolArray
) -> BentBeam:
    """What the parameters change in the balance of shapes q (B, Q)."""
    return BentBeam(
        _solved(loaded.problem, q, converged),
        push_grid.log_k,
        push_grid.rest_on_nodes,
        loaded.force,
        loaded.pushed,
        push_grid.farther,
        loaded.by_mass,
        rest_shift=by_shares,
    )


def _axes(layout: Layout, x: Array) -> Array:
    """(2, 2) by which the logged force is turned."""
    turn = float(layout.get(x, "direction")[0])
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([[cos, -sin], [sin, cos]])
