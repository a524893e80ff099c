"""What stays the same while one beam is filmed live: its parameters, the settings, and grids for the places of the
push."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache, partial

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotrs

from onebend.beam.continuation import follow
from onebend.beam.grid import Grid, make_grid, paired
from onebend.beam.problem import Problem
from onebend.beam.sensitivity import Perturbation, adjoint_times, minus_gradient, moved_by_strain
from onebend.beam.statics import Equilibrium, nodal_forces, tangent
from onebend.beam.stiffness import RectangularSection
from onebend.learning import allowances as effects, prediction
from onebend.learning.fit_data import MASS_MODES, REST_MODES
from onebend.learning.parameters import STATED_ERRORS, Layout, Priors, Spline, layout_of, log_axes
from onebend.learning.prediction import BentBeam, ResponseColumns, TagRide
from onebend.live.key_frames import FrameTerms, KeyFrames, course_of_frame, course_scale
from onebend.records import Array, BoolArray

ORDER, WIDEST = 12, 0.5
MOST_PANELS = 4  # two before the push, and two behind one that is near the clamp
_GRIDS = 50  # over the length; a push between two places acts along the tangent from the nearer one


@dataclass(frozen=True, eq=False)
class LiveSession:
    """The beam, its tags and its parameters. Sessions are equal only to themselves."""

    length: float  # m
    marker_s: Array  # (m,)
    mass: float  # kg
    layout: Layout
    course: effects.PushCourse  # of one frame
    allowances: tuple[effects.Allowance, ...] = ()  # with their bases in one frame, where they have some
    thickness: float = math.nan  # m, of the section in the plane of bending; NaN: not known

    @cached_property
    def terms(self) -> FrameTerms:
        """The allowances that go with the frames."""
        enter = ("force", "place", "clamp", "poses")
        return FrameTerms(tuple(a for a in self.allowances if a.enters in enter and a.name in self.carried))

    @cached_property
    def carried(self) -> frozenset[str]:
        """Names of all blocks of parameters that are not frozen."""
        return frozenset(self.columns)

    def section(self, x: Array) -> tuple[RectangularSection | None, float]:
        """By which the beam stretches and shears at parameters x, None where it does neither; and how the log of its
        thickness goes with its parameter."""
        if "section" not in self.carried:
            return None, 1.0
        return effects.section_at(float(self.layout.get(x, "section")[0]), self.thickness, self.length)

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Columns of all parameters that are not frozen."""
        return prediction.free_columns(self.layout)

    def prior_scale(self, largest: float, bend: float) -> Array:
        """(n - p,) factors on the prior sds of all parameters but log k's coefficients; see `course_scale`."""
        p = self.layout.spline.count
        out = np.ones(self.layout.size - p)
        for one in self.allowances:
            where = self.columns.get(one.name)
            if where is not None:
                out[where.start - p : where.stop - p] = course_scale(one, largest, bend)
        return out

    @cached_property
    def patches_on_finer(self) -> Array:
        """(f, n) coefficients, of the finer spline, of the functions of log k under the tags; n = 0 without them."""
        fine = self.layout.spline.finer
        if "patches" not in self.carried:
            return np.zeros((fine.count, 0))
        return fine.nearest(lambda s: effects.patch_functions(self.marker_s, self.length, self.course.tag_size, s))


@dataclass(frozen=True)
class PushGrid:
    """The grid for a push at one place, and everything that depends only on it."""

    push_s: float
    grid: Grid
    to_nodes: Array  # (Q, Q)
    squares: Array  # (Q, Q Q) products of the entries of each of its rows
    weights: Array  # (Q,)
    beyond: Array  # (Q,) 1 where the push lies beyond the node
    farther: Array  # (Q,) 1/m: what is added to it per metre that the push lies farther out
    mass_beyond: Array  # (Q, 4) kg, of an even mass and of its uneven parts
    log_k: Array  # (Q, p + 1): the functions of log k, the last under the tags
    rest_on_nodes: Array  # (Q, 3)

    def places(self, s: Array) -> tuple[Array, Array]:
        """(m, Q) each, for places `s` (m,): integrals up to them, and values there."""
        return _rows_at(self.push_s, s.tobytes())


@dataclass(frozen=True)
class PointBeam:
    """The beam at parameters x, on the grid of a push: all that no frame changes."""

    x: Array
    push_grid: PushGrid
    problem: Problem  # under no load
    stiff: Array  # (Q,) k times the nodes' weights
    axes: Array  # (2, 2) by which the logged force is turned
    columns: dict[str, slice]  # where the groups of `material_changes` stand in the functions
    elastic: Array  # (Q, P) N m, see `joined_functions`
    compliant: Array  # (Q, P)


# Parts of the curvature that those which lag behind it (`TIMES`) are taken to reach: on the way k is the secant
# stiffness of such a push.
REACHED = np.array([0.8, 0.5, 0.25])


@dataclass(frozen=True)
class Memory:
    """What a beam that relaxes remembers in B frames: the curvatures that lag behind are `before + now q`, q being the
    curvature over that at rest; for each of the r `TIMES`."""

    before: Array  # (B, Q, r) rad
    now: Array  # (B, r)
    reached: Array  # (r,)

    def lags(self, bending: Array) -> Array:
        """(B, Q, r) rad, of shapes bent by (B, Q)."""
        return self.before + self.now[:, None, :] * bending[..., None]


@dataclass(frozen=True)
class FrameInputs:
    """What acts on the beam in B frames."""

    force: Array  # (B, 2) N, corrected
    rate: Array  # (B, 2) N/s
    gravity: Array  # (B, 2) m/s^2
    farther: Array  # (B,) m that the push lies beyond its grid's place
    terms: Array  # (B, terms) of the allowances that go with the frames
    memory: Memory


def session_of(
    spline: Spline,
    marker_s: Array,
    priors: Priors,
    *,
    length: float,
    mass: float,
    allowances: frozenset[str] = frozenset(),
    thickness: float = math.nan,
    tag_size: float = math.nan,
) -> LiveSession:
    """One beam under one camera; the force's error is a process and not among the parameters.

    A prior that is None takes the usual tolerance; without `scale` the camera is calibrated, and without `clock` camera
    and force log share one clock. Allowances that are not wanted are frozen.
    """
    course = course_of_frame(marker_s, length, tag_size, thick=bool(np.isfinite(thickness)))
    wanted: list[effects.Allowance] = []
    for one in STATED_ERRORS:
        stated = getattr(priors, one.prior)
        sd = one.usual if stated is None else stated
        if one.name == "mass":
            sd = np.append(sd if mass > 0.0 else 0.0, np.full(3, priors.mass_spread))
        wanted.append(one.with_sd(sd, course.tags))
    every = effects.allowances_of(course, effects.LIVE_ALLOWANCES)
    wanted += [replace(a, prior_sd=a.prior_sd * (a.name in allowances)) for a in every]
    layout = layout_of(spline, [(-1, a) for a in wanted])
    return LiveSession(length, marker_s, mass, layout, course, every, thickness)


@lru_cache(maxsize=_GRIDS)
def _grid_at(push_s: float) -> Grid:
    return make_grid((0.5 * push_s, push_s), order=ORDER, widest=WIDEST)


@lru_cache(maxsize=_GRIDS)
def _squares_at(push_s: float) -> Array:
    """See `PushGrid.squares`."""
    to_nodes = _grid_at(push_s).integral_to_nodes
    return np.asarray((to_nodes[:, :, None] * to_nodes[:, None, :]).reshape(len(to_nodes), -1))


@lru_cache(maxsize=4 * _GRIDS)
def _rows_at(push_s: float, places: bytes) -> tuple[Array, Array]:
    """See `PushGrid.places`."""
    grid, s = _grid_at(push_s), np.frombuffer(places)
    return grid.integral_to(s), grid.value_at(s)


def nearest_grid_place(push_s: float) -> float:
    """The place nearest to a push at which there is a grid."""
    return max(round(push_s * _GRIDS), 1) / _GRIDS


@lru_cache(maxsize=4 * _GRIDS)
def push_grid_at(session: LiveSession, push_s: float) -> PushGrid:
    """The grid for a push at `push_s`."""
    grid = _grid_at(push_s)
    nodes, to_nodes, weights = grid.nodes, grid.integral_to_nodes, grid.weights
    parts = MASS_MODES.curvature(nodes)
    beyond = nodes < push_s
    last = np.arange(len(nodes)) == int(np.sum(beyond)) - 1
    under_tags = effects.patch_means(session.marker_s, session.length, session.course.tag_size, grid)
    return PushGrid(
        push_s=push_s,
        grid=grid,
        to_nodes=to_nodes,
        squares=_squares_at(push_s),
        weights=weights,
        beyond=np.asarray(beyond, dtype=float),
        farther=np.asarray(last / (session.length * weights)),
        mass_beyond=session.mass * (weights @ parts - to_nodes @ parts),
        log_k=np.column_stack([session.layout.spline.basis(nodes), under_tags]),
        rest_on_nodes=REST_MODES.curvature(nodes),
    )


# Poses of the tags in a few frames at given parameters, with derivatives: the model of the live learner.

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
        return LinearisedTags(*(getattr(self, each.name)[chosen] for each in fields(self)))


def linearise(session: LiveSession, beam: PointBeam, inputs: FrameInputs, start: Array | None) -> LinearisedTags:
    """Poses and derivatives of the tags on a beam, from shapes `start` (B, Q) where there are any.

    The tangent is solved for the tags' coordinates (adjoint) and the force. The memory of a beam that relaxes is taken
    as given: it has derivatives with the shares alone.
    """
    layout, m, x, push_grid = session.layout, len(session.marker_s), beam.x, beam.push_grid
    own, straight = session.terms.with_terms(inputs.terms), beam.problem.q0

    def allowed(enters: effects.Entry) -> Array | float:
        return prediction.allowed(own, enters, partial(layout.get, x))

    logged = (inputs.force + inputs.rate * layout.get(x, "clock")) @ beam.axes.T
    q0, by_shares = _rest_shift(session, x, inputs.memory, start, straight)
    force = logged + allowed("force")
    place = layout.get(x, "place") + inputs.farther + allowed("place")
    alpha0 = (layout.get(x, "clamp") + allowed("clamp")) * np.ones(len(force))
    problem, pushed, by_mass = _loaded(session, beam, force, inputs, (place, q0, alpha0[:, None]))
    q, converged, factors = _shapes(beam, problem, start)
    solved = _solved(problem, q, converged)
    bent = BentBeam(
        solved,
        push_grid.log_k,
        push_grid.rest_on_nodes,
        force,
        pushed,
        push_grid.farther,
        by_mass,
        rest_shift=by_shares,
    )
    loads, tags = prediction.response_columns(prediction.load_changes(bent)), _Tags(session, push_grid, x, solved)
    right = minus_gradient(solved, loads.changes)
    both = np.concatenate([tags.by_shape, right[..., loads.slices["push"]].swapaxes(1, 2)], axis=1)
    for rows, factor in zip(both, factors, strict=True):
        rows[:] = dpotrs(factor, rows.T, lower=1, overwrite_b=1)[0].T
    adjoint, (columns, material) = both[:, : 3 * m], _with_material(loads, solved, beam)
    response = np.concatenate([adjoint @ right, adjoint_times(adjoint, solved, material)], axis=2)
    response = response.reshape(len(q), m, 3, -1)
    tags.add_direct(response, columns)
    blocks, j = columns.split(tags.ride.carry(response)), np.zeros((len(q), m, 3, layout.size))
    further = prediction.push_blocks(blocks["push"], logged, beam.axes, inputs.rate) | prediction.allowed_blocks(
        own, blocks
    )
    prediction.put_blocks(j, session.columns, blocks | further)
    prediction.put_tags(j, session.columns, tags.motion)
    pose, a = tags.pose + allowed("poses"), blocks["push"] @ beam.axes
    by_force, lags = both[:, 3 * m :].swapaxes(1, 2) @ beam.axes, inputs.memory.lags(q - straight)
    return LinearisedTags(converged, q, by_force, lags, pose, j, a)


def _with_material(
    loads: ResponseColumns, solved: Equilibrium, beam: PointBeam
) -> tuple[ResponseColumns, Perturbation]:
    """The columns with the groups of `material_changes` behind them, one after the other; and these groups."""
    problem, nothing = solved.problem, np.zeros(beam.elastic.shape[1])
    compliance = None if problem.compliance is None else (problem.compliance, beam.compliant)
    material = Perturbation(None, None, (solved.q - problem.q0, beam.elastic), nothing, compliance)
    first = len(loads.changes.clamp)
    behind = {name: slice(first + c.start, first + c.stop) for name, c in beam.columns.items()}
    return ResponseColumns(loads.changes + material, loads.slices | behind), material


def _rest_shift(
    session: LiveSession, x: Array, memory: Memory, start: Array | None, straight: Array
) -> tuple[Array, Array | None]:
    """(Q,) or (B, Q) rad, the curvature at rest of a beam that remembers; (B, Q, r), how it goes with the shares that
    relax, None where nothing does."""
    if "relaxation" not in session.carried:
        return straight, None
    bending = np.zeros(memory.before.shape[:2]) if start is None else start - straight
    shares = session.layout.get(x, "relaxation")
    shift, by_shares = effects.shift_of_lags(shares, memory.lags(bending), bending, memory.reached)
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
        self.pose = self.ride.pose(self._xy, origin, layout.get(x, "turn"))
        on_beam = over <= 0.0
        onward = float(problem.length) / session.length * (value @ slope)
        if not np.all(on_beam):
            tangent_there = paired(np.cos(self.ride.angle), np.sin(self.ride.angle))
            onward = np.where(on_beam[:, None], onward, tangent_there)
        bend = (q @ value.T) * (on_beam / session.length)
        self.motion = self.ride.motion(self._xy + self.ride.offset, bend, onward)

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


def _shapes(beam: PointBeam, problem: Problem, start: Array | None) -> tuple[Array, BoolArray, list[Array]]:
    """Equilibria (B, Q), whether each was found, and the Cholesky factors of their tangents: Newton's method from
    `start` and, where that fails, continuation from rest."""
    if start is not None:
        q, moved, b = start.copy(), 0.0, problem.to_nodes.T
        update, factors = np.empty_like(q), list[Array]([q]) * len(q)
        for _ in range(_NEWTON_ITERATIONS):
            unbalanced, matrices = _balance(beam, problem, q)
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
    from_rest = follow(problem)
    good, factors = from_rest.converged & from_rest.stable, []
    for i, matrix in enumerate(tangent(problem, from_rest.q)):
        factor, wrong = dpotrf(matrix, lower=1)
        factors.append(factor if wrong == 0 else np.eye(len(matrix)))
        good[i] &= wrong == 0
    return from_rest.q, good, factors


def _balance(beam: PointBeam, problem: Problem, q: Array) -> tuple[Array, Array]:
    """(B, Q) gradient and (B, Q, Q) tangent, as `equilibrium.balance` without its look-ups."""
    forces = nodal_forces(problem, q)
    matrices = forces.along @ beam.push_grid.squares
    matrices[:, :: q.shape[1] + 1] += beam.stiff
    unbalanced = beam.stiff * (q - problem.q0) - forces.across @ problem.to_nodes
    return unbalanced, matrices.reshape(*q.shape, -1)


def _loaded(
    session: LiveSession, beam: PointBeam, force: Array, inputs: FrameInputs, moved: tuple[Array, Array, Array]
) -> tuple[Problem, Array, Perturbation | None]:
    """The beam under forces (B, 2) [N]; (B, Q) share of the push beyond each node; what the parts of the mass do, None
    where nothing weighs. `moved`: place of the push (B,) [m], curvature at rest, and angle of the clamp."""
    push_grid, (place, q0, alpha0) = beam.push_grid, moved
    pushed, by_mass = push_grid.beyond + place[:, None] * push_grid.farther, None
    dead = pushed[..., None] * force[:, None]
    if session.mass > 0.0 and np.any(inputs.gravity):
        mass = push_grid.mass_beyond[:, 0] + push_grid.mass_beyond @ session.layout.get(beam.x, "mass")
        dead += mass[:, None] * inputs.gravity[:, None]
        pull = inputs.gravity[:, None, :, None] * push_grid.mass_beyond[:, None, :]
        by_mass = Perturbation(pull, None, None, np.zeros(4)) if "mass" in session.carried else None
    return beam.problem.under(dead, q0, alpha0), pushed, by_mass


def beam_at(session: LiveSession, push_s: float, x: Array) -> PointBeam:
    """The beam at parameters x (n,), on the grid for a push at `push_s`."""
    return _beam_of(session, push_s, x.tobytes())


@lru_cache(maxsize=_GRIDS)  # all key frames are linearised at one point
def _beam_of(session: LiveSession, push_s: float, parameters: bytes) -> PointBeam:
    layout, x, push_grid = session.layout, np.frombuffer(parameters), push_grid_at(session, push_s)
    size, p = push_grid.log_k.shape
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
        section=section,
    )
    at_rest = _solved(problem, np.broadcast_to(problem.q0, (1, size)), np.ones(1, dtype=bool))
    lengthens = "length" in session.carried
    bent = BentBeam(
        at_rest, push_grid.log_k, none, np.zeros((1, 2)), none, none, lengthens=lengthens, thickens=thickens
    )
    changes = prediction.material_changes(bent)
    columns = prediction.response_columns(changes).slices
    last = session.layout.spline.count
    columns |= {"stiffness": slice(0, last), "patches": slice(last, p)}
    elastic, compliant = prediction.joined_functions(changes, size)
    stiff, axes = push_grid.weights * problem.k, log_axes(layout.get(x, "direction", -1))
    return PointBeam(x, push_grid, problem, stiff, axes, columns, elastic, compliant)


def _solved(problem: Problem, q: Array, converged: BoolArray) -> Equilibrium:
    reached = converged.astype(float)
    return Equilibrium(problem, q, converged, converged, reached, reached, ~converged, 0)


# Linearises key frames through the equilibrium, those that share a grid together.


class Lineariser:
    """Linearises key frames at parameters."""

    def __init__(self, session: LiveSession) -> None:
        self._session = session
        self._pushed = 1.0  # place of the last push
        for i in range(1, _GRIDS + 1):  # beforehand, so that a new place costs no time
            push_grid_at(session, i / _GRIDS)

    def pushed_at(self, push_s: float) -> None:
        """Take note of the place of the push."""
        self._pushed = nearest_grid_place(push_s)

    def near(self, keys: KeyFrames, chosen: list[int], i: int) -> list[int]:
        """The chosen key frames on the same grid as key frame i; where there are none, the first chosen one."""
        return [k for k in chosen if self._grid_of(keys, k) == self._grid_of(keys, i)] or chosen[:1]

    def renew(self, keys: KeyFrames, chosen: list[int], point: Array) -> set[int]:
        """Linearise key frames at parameters `point` (n,); returns those with an equilibrium there. The others stay."""
        solved: set[int] = set()
        grids = [self._grid_of(keys, i) for i in chosen]
        for push_s in dict.fromkeys(grids):
            part = [i for i, grid in zip(chosen, grids, strict=True) if grid == push_s]
            solved |= self._renew(keys, beam_at(self._session, push_s, point), part)
        return solved

    def _renew(self, keys: KeyFrames, beam: PointBeam, chosen: list[int]) -> set[int]:
        push_grid, point = beam.push_grid, beam.x
        nodes, loaded, here = len(push_grid.weights), ~keys.rest[chosen], self._on_grid(keys, push_grid, chosen)
        force = (keys.force[chosen] - keys.error[chosen]) * loaded[:, None]
        beyond = self._session.length * (keys.push_s[chosen] - push_grid.push_s) * loaded
        inputs = FrameInputs(
            force,
            keys.rate[chosen] * loaded[:, None],
            keys.gravity[chosen],
            beyond,
            keys.terms[chosen],
            self._memory(keys, push_grid, (chosen, here), point),
        )
        there = linearise(self._session, beam, inputs, here[..., 0])
        solved, good = np.asarray(chosen), there.converged
        if not good.all():
            solved, there = solved[good], there.take(good)
        if len(solved) == 0:
            return set()
        keys.shape[solved, :nodes] = np.concatenate([there.q[..., None], there.by_force, there.lags], axis=2)
        keys.grid[solved] = push_grid.push_s
        keys.set_linear(solved, point, there.pose, there.j, there.a)
        return set(solved.tolist())

    def _memory(self, keys: KeyFrames, push_grid: PushGrid, frames: tuple[list[int], Array], point: Array) -> Memory:
        """Memory of the beam in the chosen frames, from the key frame before each; `frames`: these, and their shapes.
        The first key frame and proposed averages keep theirs."""
        chosen, here = frames
        before, now = here[..., 3:], np.zeros((len(chosen), len(effects.TIMES)))
        if "relaxation" not in self._session.carried:
            return Memory(np.zeros_like(before), now, REACHED)
        bending = here[..., :1] - (push_grid.rest_on_nodes @ self._session.layout.get(point, "curvature"))[:, None]
        centre = 0.5 * (keys.begin + keys.end)
        kept, entered, last = (w.T for w in effects.lag_weights(np.diff(centre)))
        place = {k: b for b, k in enumerate(chosen)}
        for k in sorted(chosen):
            if not 0 < k < keys.used:
                continue
            b, b0 = place[k], place.get(k - 1)
            if b0 is None:
                same = keys.grid[k - 1] == push_grid.push_s
                other = keys.shape[k - 1] if same else self._on_grid(keys, push_grid, [k - 1])[0]
                other = other[: len(push_grid.weights)]
                lags, bent = other[:, 3:], other[:, :1] - (here[b, :, :1] - bending[b])
            else:
                lags, bent = before[b0] + now[b0] * bending[b0], bending[b0]
            now[b] = last[k - 1]
            before[b] = kept[k - 1] * lags + entered[k - 1] * bent
        return Memory(before, now, REACHED)

    def secant(self, keys: KeyFrames, point: Array, x: Array, covariance: Array) -> tuple[Array, Array]:
        """Mean (n,) and covariance (n, n) of the parameters, log k being made that of the secant stiffness of the push
        so far, `k_i (1 - c)`."""
        if "relaxation" not in self._session.carried:
            return x, covariance
        layout, reached = self._session.layout, self._reached(keys, point)
        where, p, shares = layout.index["relaxation", -1].where, layout.spline.count, layout.get(x, "relaxation")
        left, usual = (1.0 - min(float(shares @ part), effects.LARGEST) for part in (reached, REACHED))
        out, onto = x.copy(), np.eye(len(x))
        out[:p] += np.log(left / usual)
        onto[:p, where] = REACHED / usual - reached / left
        return out, onto @ covariance @ onto.T

    def _reached(self, keys: KeyFrames, point: Array) -> Array:
        """(r,) parts of the curvature that those which lag behind it have reached over the frames in use."""
        curvature, lagged, square = self._session.layout.get(point, "curvature"), np.zeros(len(effects.TIMES)), 0.0
        for i in range(keys.used):
            if keys.grid[i] != 0.0 and not keys.rest[i]:
                grid = push_grid_at(self._session, float(keys.grid[i]))
                q = keys.q[i, : len(grid.weights)] - grid.rest_on_nodes @ curvature
                here = grid.weights * keys.frames[i] * q
                lagged, square = lagged + here @ keys.lags[i, : len(q)], square + float(here @ q)
        return lagged / square if square > 0.0 else REACHED

    def _on_grid(self, keys: KeyFrames, push_grid: PushGrid, chosen: list[int]) -> Array:
        """(B, Q, 3 + r) shapes of key frames, interpolated where they are on another grid."""
        out, grids = keys.shape[chosen, : len(push_grid.weights)], keys.grid[chosen].tolist()
        for row, i, grid in zip(out, chosen, grids, strict=True):
            if grid not in (push_grid.push_s, 0.0):
                nodes, before = push_grid.grid.nodes, push_grid_at(self._session, float(keys.grid[i])).grid.nodes
                for c in (0, *range(3, out.shape[-1])):
                    row[:, c] = np.interp(nodes, before, keys.shape[i, : len(before), c])
        return out

    def _grid_of(self, keys: KeyFrames, i: int) -> float:
        """Place of the push on the grid of key frame i; at rest any grid will do, and the last one is taken."""
        return self._pushed if keys.rest[i] else nearest_grid_place(float(keys.push_s[i]))
