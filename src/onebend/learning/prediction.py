"""From parameters to predicted tags, with exact derivatives: the model of the marker-space fit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate

import numpy as np

from onebend.beam import continuation, grid, sensitivity, statics
from onebend.beam.problem import Problem
from onebend.beam.stiffness import RectangularSection, UncertainStiffness
from onebend.learning import allowances as effects
from onebend.learning.fit_data import FitData
from onebend.learning.frames import evenly_spread, push_places, ruler_places, steepness, whitened, zeroed_coordinates
from onebend.learning.normal import in_own_pages
from onebend.learning.parameters import Layout, log_axes
from onebend.learning.static_poses import free_ends, moved, put_ends, solve, with_ends_held
from onebend.records import Array, BoolArray, IntArray, Observations, left_of, paired, rotated, unit

# Derivatives of the tags' poses: `response_columns` gives each group of parameters that bends the beam, in the order of
# the columns; `TagRide` maps the motion of the beam to the tags; `put_blocks` and `put_tags` write the columns of a
# layout.


@dataclass(frozen=True)
class BentBeam:
    """Equilibria of F frames on Q nodes, and what the parameters change in their balance."""

    solved: statics.Equilibrium
    on_nodes: Array  # (Q, p) or (F, Q, p): the functions of log k
    rest_on_nodes: Array  # (Q, 3) or (F, Q, 3): the functions of the rest curvature
    push: Array  # (F, 2) N, or (F, 3) with a moment [N m]
    beyond: Array  # (F, Q): share of the push that acts beyond the node
    farther: Array  # (Q,) or (F, Q) 1/m: what that share gains for each metre that the push lies farther out
    by_mass: sensitivity.Perturbation | None = None  # the parts of the mass; None where nothing weighs
    weight_by_k: Array | None = None  # (F, Q, 2, p) N: weight beyond the nodes, where the mass follows k(s)
    log_k: Mapping[str, Array] = field(default_factory=dict)  # (Q, n) or (F, Q, n): further functions of log k, by name
    rest_shift: Array | None = None  # (F, Q, n): of the curvature at rest, with the parameters of relaxation
    lengthens: bool = False  # the length is a parameter
    thickens: float = 1.0  # half of how the log of stretch and shear goes with its parameter


def load_changes(beam: BentBeam) -> dict[str, sensitivity.Perturbation]:
    """Groups of the loads, the clamp and the beam at rest.

    "curvature" (3) rad; "clamp" (1) rad; "push" (2) N, or (3) with N m, the load of each frame; "place" (1) m, of the
    push along the beam; "mass" (4), relative, where weight acts; "relaxation", the relaxing shares.
    """
    problem = beam.solved.problem
    changes = {
        "curvature": sensitivity.of_rest_curvature(problem, beam.rest_on_nodes),
        "clamp": sensitivity.of_clamp_angle(problem),
        "push": pushed_by(beam.beyond, np.eye(beam.push.shape[1])[None]),
        "place": placed_by(beam.farther, beam.push, np.ones((1, 1))),
    }
    if beam.by_mass is not None:
        changes["mass"] = beam.by_mass
    if beam.rest_shift is not None:
        changes["relaxation"] = sensitivity.of_rest_curvature(problem, beam.rest_shift)
    return changes


def material_changes(beam: BentBeam) -> tuple[sensitivity.Perturbation, dict[str, int]]:
    """Groups of the beam itself, side by side, and their sizes. They enter by `k (q - q0)` and by 1/EA and 1/kGA.

    "stiffness" (p) coefficients of log k; further functions of log k, by name; "length" (1) its log, at fixed k [N m]
    and loads: it acts as a smaller k, as all levers grow, and 1/EA and 1/kGA go with 1 / (k L); "section" (1) its
    thickness.
    """
    problem, by_name = beam.solved.problem, {"stiffness": beam.on_nodes, **beam.log_k}
    logs = np.concatenate(list(by_name.values()), axis=-1)
    counts = {name: one.shape[-1] for name, one in by_name.items()}
    elastic, compliance, more = [problem.k[..., None] * logs], None, []
    nodes = np.ones_like(elastic[0][..., :1])
    if beam.lengthens:
        counts["length"] = 1
        elastic, more = [*elastic, -problem.k[..., None] * nodes], [-nodes]
    if problem.section is not None and problem.compliance is not None:
        counts["section"] = 1
        with_k = problem.section.log_by_stiffness(problem.k, problem.weights, elastic[0])
        elastic, more = [*elastic, 0.0 * nodes], [*more, 2.0 * beam.thickens * nodes]
        compliance = problem.compliance, np.concatenate([with_k, *more], axis=-1)
    functions, force = np.concatenate(elastic, axis=-1), beam.weight_by_k
    if force is not None:
        force = np.pad(force, ((0, 0), (0, 0), (0, 0), (0, functions.shape[-1] - force.shape[-1])))
    bending, still = beam.solved.q - problem.q0, np.zeros(functions.shape[-1])
    return sensitivity.Perturbation(force, None, (bending, functions), still, compliance), counts


@dataclass(frozen=True)
class ResponseColumns:
    """Where each group of parameters stands among the P columns of a mechanical response."""

    changes: sensitivity.Perturbations  # of all groups, one after the other
    slices: dict[str, slice]

    def split(self, response: Array) -> dict[str, Array]:
        """The groups' own parts (..., n) of a response (..., P)."""
        return {name: response[..., columns] for name, columns in self.slices.items()}


def response_columns(changes: Mapping[str, sensitivity.Perturbation], beam: BentBeam | None = None) -> ResponseColumns:
    """The columns of these groups, in their order, and behind them those of the `beam` itself (`material_changes`)."""
    counts = {name: len(change.clamp) for name, change in changes.items()}
    joined = sensitivity.Perturbations(tuple(changes.values()))
    if beam is not None:
        material, own = material_changes(beam)
        counts, joined = counts | own, joined + material
    return ResponseColumns(joined, side_by_side(counts))


def side_by_side(counts: Mapping[str, int]) -> dict[str, slice]:
    """Slices of groups of so many columns, one after the other."""
    ends = list(accumulate(counts.values(), initial=0))
    return {name: slice(a, b) for name, a, b in zip(counts, ends[:-1], ends[1:], strict=True)}


def allowed(
    allowances: Iterable[effects.Allowance], enters: effects.Entry, value: Callable[[str], Array]
) -> Array | float:
    """The sum of those that enter here at the values of their parameters, by name; 0 where there are none."""
    return sum((a.basis @ value(a.name) for a in allowances if a.enters == enters), start=0.0)


def place_responses(solved: statics.Equilibrium, columns: ResponseColumns, s: Array) -> dict[str, Array]:
    """(F, S, 3, n) m, m, rad per unit of each group: of the beam's position and angle at places `s` (S,)."""
    return columns.split(sensitivity.respond(solved, columns.changes).poses(s))


def push_moment(problem: Problem, push_s: Array, force: Array) -> sensitivity.Perturbation:
    """One parameter: the moment [N m] of a force (F,) [N] across the beam that acts one metre from `push_s`."""
    lever = sensitivity.of_moment(problem, push_s)
    assert lever.moment is not None
    return replace(lever, moment=force[:, None, None] * lever.moment)


def along_and_across(force: Array, angle: Array) -> tuple[Array, Array]:
    """(F,) N each: components of forces (F, 2) along a beam of this `angle` (F,) [rad] and to its left."""
    cos, sin = np.cos(angle), np.sin(angle)
    return force[:, 0] * cos + force[:, 1] * sin, force[:, 1] * cos - force[:, 0] * sin


def push_forces(push: Array, log_axes: Array, rate: Array) -> dict[str, Array]:
    """(F, 2, 1) N per unit: the push with the "direction" of the log's axes [rad] and its "clock" [s]."""
    return {"direction": left_of(push)[..., None], "clock": (rate @ log_axes.T)[..., None]}


def pushed_by(beyond: Array, load: Array) -> sensitivity.Perturbation:
    """n parameters that add `load` (F, 2, n) N, or (F, 3, n) with N m, to the push, of which `beyond` (Q,) or (F, Q)
    acts beyond each node."""
    added = beyond[..., None, None] * load[:, None]
    moment = added[:, :, 2] if load.shape[1] > 2 else None
    return sensitivity.Perturbation(added[:, :, :2], moment, None, np.zeros(load.shape[-1]))


def placed_by(farther: Array, push: Array, basis: Array) -> sensitivity.Perturbation:
    """n parameters that move a push (F, 2) N, or (F, 3) with N m, to which each metre adds `farther` (Q,) or (F, Q)
    beyond each node: `basis` (F, n) m per unit in each frame."""
    return pushed_by(farther, push[..., None] * basis[:, None, :])


@dataclass(frozen=True)
class TagMotion:
    """How m tags move in F pictures with what holds them, the shape of the beam staying as it is."""

    along: Array  # (F, m, 2) m per m along the beam
    bend: Array  # (F, m) 1/m: turn per metre along
    across: Array  # (F, m, 2) m per m to the left of the beam
    xy: Array  # (F, m, 2) m: with the camera's scale
    origin: Array | None = None  # (F, m, 2, 2) m per m of x and y; None: as the origin does


@dataclass(frozen=True)
class TagRide:
    """m tags that ride on the beam in F frames, each beside a place of the beam that it turns with."""

    angle: Array  # (F, m) rad, of the beam at these places
    over: Array  # (m,) m from the place along the tangent: beyond the tip
    across: Array  # (m,) m from the place to the left
    scale: float = 1.0  # of lengths in the picture
    ruler: bool = False  # it stays at its x, and reads y of what passes there

    @cached_property
    def offset(self) -> Array:
        """(F, m, 2) m from the beam's place to the tag."""
        return rotated(paired(self.over, self.across), self.angle)

    def pose(self, xy: Array, origin: Array, turn: Array) -> Array:
        """(F, m, 3) of the tags in the picture, over places `xy` (F, m, 2) m of the beam; `turn` (m,) rad on it."""
        return np.concatenate([self.scale * (xy + self.offset) + origin, (self.angle + turn)[..., None]], axis=-1)

    def carry(self, response: Array) -> Array:
        """(F, m, 3, P) of the tags in the picture, from that of the beam's places under them."""
        offset, turn = self.offset, response[:, :, 2:]
        lever = left_of(offset)
        xy = response[:, :, :2] + lever[..., None] * turn
        if self.ruler:
            xy = np.stack([np.zeros_like(xy[:, :, 0]), xy[:, :, 1] - self.slope[..., None] * xy[:, :, 0]], axis=2)
        return np.concatenate([self.scale * xy, turn], axis=2)

    @cached_property
    def slope(self) -> Array:
        """(F, m) of the beam under a ruler: how y there goes with x."""
        return np.sin(self.angle) / steepness(self.angle)

    def motion(self, xy: Array, bend: Array, onward: Array | None = None) -> TagMotion:
        """Of tags at `xy` (F, m, 2) m in the beam's frame; `bend` (F, m) 1/m is the beam's curvature, zero beyond the
        tip. `onward` (F, m, 2): m per m along the beam; None: the tangent, without stretch."""
        if self.ruler:
            return self._ruler_motion(xy)
        tangent = unit(self.angle)
        turning = (self.across * bend)[..., None] * tangent
        along = self.scale * ((tangent if onward is None else onward) - turning)
        return TagMotion(along, bend, self.scale * left_of(tangent), xy)

    def _ruler_motion(self, xy: Array) -> TagMotion:
        """Of rulers, which read y at a fixed x."""
        nothing, one = np.zeros_like(self.slope), np.ones_like(self.slope)
        origin = np.stack([paired(nothing, nothing), paired(-self.slope, one)], axis=2)
        return TagMotion(paired(nothing, self.slope), nothing, paired(nothing, one), xy, origin)


def put_blocks(out: Array, columns: Mapping[str, slice], blocks: Mapping[str, Array]) -> None:
    """Write derivatives (F, m, 3, n) to the columns (F, m, 3, C) of the same names; frozen ones are left out."""
    for name, block in blocks.items():
        if name in columns:
            out[..., columns[name]] = block


def put_tags(out: Array, columns: Mapping[str, slice], motion: TagMotion, tags: IntArray | None = None) -> None:
    """Write derivatives with the tags' places and turns, the origin and the scale to `out` (F, m, 3, C); `tags` (k,)
    are those of the m markers that have places and turns of their own, None: all."""
    tags = np.arange(out.shape[1]) if tags is None else tags
    number = np.arange(len(tags))
    own = {name: columns[name].start + number for name in ("along", "across", "turn") if name in columns}
    for c in range(2):
        if "along" in own:
            out[:, tags, c, own["along"]] = motion.along[:, tags, c]
        if "across" in own:
            out[:, tags, c, own["across"]] = motion.across[:, tags, c]
        if "origin" in columns and motion.origin is not None:
            out[:, :, c, columns["origin"]] = motion.origin[:, :, c]
        elif "origin" in columns:
            out[:, :, c, columns["origin"].start + c] = 1.0
        if "scale" in columns:
            out[:, :, c, columns["scale"].start] = motion.xy[..., c]
    if "along" in own:
        out[:, tags, 2, own["along"]] = motion.bend[:, tags]
    if "turn" in own:
        out[:, tags, 2, own["turn"]] = 1.0


def tag_blocks(motion: TagMotion) -> dict[str, Array]:
    """(F, m, 3, n) of each block that `put_tags` writes, for those who have no layout."""
    m = motion.bend.shape[1]
    columns = side_by_side({"along": m, "across": m, "turn": m, "origin": 2, "scale": 1})
    out = np.zeros((*motion.bend.shape, 3, 3 * m + 3))
    put_tags(out, columns, motion)
    return {name: out[..., where] for name, where in columns.items()}


_SETTLED = 1e-7  # rad, of the last change of a shape that relaxes
_FALLING = 0.5  # of the change before: one that is larger takes a new tangent
_FARTHEST = 5.0  # rad, of the curvature in one update of Newton's method
_MOST_PASSES = 16  # a guard: each at least halves the change (`_FALLING`), or takes a new tangent
_KEY_FRAMES = 24  # at most, through which derivatives follow the memory of the material
_PASSES = 2  # each leaves about the relaxing share of the error of the one before


@dataclass(frozen=True)
class State:
    """One recording's model at parameters x."""

    data: FitData
    layout: Layout
    x: Array  # (P,)

    def value(self, name: str) -> Array:
        """(n,) values of a block; zeros where it is frozen."""
        return self.layout.get(self.x, name, self.data.number)

    def allowed(self, enters: effects.Entry) -> Array | float:
        """The sum of the allowances that enter here; 0 where there are none. Shapes: see `Entry`."""
        return allowed(self.data.allowances, enters, self.value)

    @cached_property
    def length(self) -> Array:
        """() m, the beam's length."""
        change = [self.value(a.name)[0] for a in self.data.entering("length")]
        return np.asarray(self.data.observations.length * np.exp(sum(change)))

    @cached_property
    def clamp(self) -> Array:
        """() or (F, 1) rad, the clamp's angle."""
        angle, gives = self.data.problem.alpha0 + self.value("clamp")[0], self.allowed("clamp")
        return np.asarray(angle if isinstance(gives, float) else angle + gives[:, None])

    @cached_property
    def section(self) -> tuple[RectangularSection | None, float]:
        """The section by which the beam stretches and shears, or None, and its derivative: see `section_at`."""
        o = self.data.observations
        for a in self.data.entering("section"):
            return effects.section_at(float(self.value(a.name)[0]), o.stated.thickness, o.length)
        return self.data.problem.section, 0.0

    @cached_property
    def log_axes(self) -> Array:
        """(2, 2) rotation of the logged force."""
        return log_axes(self.value("direction"))

    @cached_property
    def push_beyond(self) -> Array:
        """(F, Q) share of the push that acts beyond the node."""
        place = self.value("place") + self.allowed("place")  # (1,) or (F,) m
        return np.asarray(self.data.beyond + place[:, None] * self.data.farther)

    @cached_property
    def rest(self) -> Array:
        """(Q,) or (F, Q) rad, curvature at rest of a beam that has not relaxed."""
        states = self.value("curvature") + self.value("rest change")
        return np.asarray(self.data.problem.q0 + self.data.rest_on_nodes @ states)

    @cached_property
    def relaxation(self) -> tuple[Array, Array] | None:
        """(n,) shares of the material that relax, and (T,) s of the frames; None where nothing is allowed to relax."""
        return next(((self.value(a.name), a.basis) for a in self.data.entering("relaxation")), None)

    @property
    def memory(self) -> Array | None:
        """(T, T) see `allowances.memory`; None where equilibria do not depend on earlier ones."""
        if self.relaxation is None or self.data.ends is not None or not np.any(self.relaxation[0]):
            return None
        return effects.memory(*self.relaxation)

    def ride(self, solved: statics.Equilibrium) -> tuple[Array, TagRide]:
        """(m,) s of the tags on these equilibria, (F, m) of readings under rulers, and the tags there."""
        data, scale = self.data, 1.0 + float(self.value("scale")[0])
        if data.rulers is not None:
            there = np.nan_to_num(data.rulers) + self.value("along") - self.value("origin")[0]
            s, over = ruler_places(solved, there)
            return s, TagRide(solved.angle(s), over, np.zeros(over.shape[1]), scale, ruler=True)
        length = data.observations.length
        wanted = data.observations.marker_s + data.of_tags(self.value("along")) / length
        s = np.clip(wanted, 0.0, 1.0)
        return s, TagRide(solved.angle(s), length * (wanted - s), data.of_tags(self.value("across")), scale)


def _relaxed(problem: Problem, remembering: Array, start: Array | None) -> statics.Equilibrium:
    """Equilibria where the material relaxes: each depends on the earlier ones, and all are found together.

    `problem` has the curvature at rest of a beam that has not relaxed; `start` (F, Q) are known shapes. Newton's method
    and the shift of the rest take turns. The inverse tangent is kept as long as the updates fall fast.
    """
    q, rest = continuation.follow(problem).q if start is None else start, problem.q0

    def shifted(q: Array) -> Problem:
        return replace(problem, q0=rest + effects.rest_shift(remembering, q - rest, problem.weights))

    inverse, before = None, np.inf
    for _ in range(_MOST_PASSES):
        here = shifted(q)
        inverse = _inverse_tangent(here, q) if inverse is None else inverse
        update = (inverse @ statics.gradient(here, q)[..., None])[..., 0]
        size = float(np.max(np.abs(update)))
        if not size < _FARTHEST:  # far from equilibrium: Newton's method with a line search
            q, inverse = continuation.refine(here, q).q, None
            continue
        q = q - update
        if size < _SETTLED:
            break
        inverse, before = (inverse if size < _FALLING * before else None), size
    return continuation.refine(shifted(q), q)


def _inverse_tangent(problem: Problem, q: Array) -> Array:
    """(F, Q, Q)."""
    return grid.solve_each(statics.tangent(problem, q), np.broadcast_to(np.eye(q.shape[1]), (*q.shape, q.shape[1])))


def secant_of(prediction: Prediction) -> float:
    """Secant stiffness over instantaneous stiffness; 1 where the material does not relax."""
    if prediction.relaxation is None:
        return 1.0
    return effects.secant_share(
        effects.memory(*prediction.relaxation), prediction.bending, prediction.solved.problem.weights
    )


@dataclass(frozen=True)
class Remembered:
    """Derivatives of poses at S places, in F frames, that come from the material's memory.

    A slow part of the push adds `by_push` times its value in the frame and `by_pushes` times those in the key frames.
    """

    by_parameters: Array  # (F, S, 3, P) m, m, rad per unit
    by_push: Array  # (F, S, 3, 2) per N
    by_pushes: Array  # (F, S, 3, 2 n) per N, x and y in turn
    keys: IntArray  # (n,)


def _remembered_poses(now: Prediction, columns: ResponseColumns, by_node: Array) -> Remembered:
    """With the P parameters of `columns` and with the push; `by_node` (F, S, 3, Q) of the poses with the curvature at
    rest at each node, without memory.

    A change of the bending shifts the curvature at rest of all later frames. It is followed through key frames, as the
    memory is smooth in time, and interpolated between them.
    """
    assert now.relaxation is not None
    (values, time), count = now.relaxation, len(by_node)
    keys = np.unique(np.linspace(0, len(time) - 1, min(len(time), _KEY_FRAMES)).round().astype(np.int64))
    some, bent, remembering = now.solved.take(keys), now.bending[keys], effects.memory(values, time[keys])
    between = np.stack([np.interp(time, time[keys], one) for one in np.eye(len(keys))], axis=1)
    inverse, weights = _inverse_tangent(some.problem, some.q), some.problem.weights
    first = inverse @ sensitivity.minus_gradient(some, columns.changes.take(keys))
    by_shift = inverse * some.problem.stiff[..., None, :]
    change = first.copy()
    change[..., columns.slices["curvature"]] -= now.data.rest_on_nodes  # bending is counted from the rest
    moved = change
    for _ in range(_PASSES):
        moved = change + by_shift @ effects.remembered(remembering, bent, weights, moved)
    shift = np.tensordot(between, effects.remembered(remembering, bent, weights, moved), 1)
    nodes = by_node[: len(time)]
    by_parameters = (nodes.reshape(len(nodes), -1, nodes.shape[-1]) @ shift).reshape(*nodes.shape[:3], -1)
    # To first order in the relaxing share; the change of the reached part of the curvature is left out.
    reached = effects.reached_part(remembering @ bent, bent, weights)
    every, by_push = np.arange(len(keys)), first[..., columns.slices["push"]]
    pairs = np.tensordot(by_node[keys], by_push, ((3,), (1,)))  # (n, S, 3, n, 2): of a frame, with the push in another
    at_once = np.tensordot(between, pairs[every, :, :, every], 1)
    pairs *= remembering[:, None, None, :, None]
    later = np.tensordot(between, pairs.reshape(*pairs.shape[:3], -1), 1)
    by_push, by_pushes = -reached / (1.0 - reached) * at_once, later / (1.0 - reached)
    return Remembered(
        effects.with_rest(by_parameters, count),
        effects.with_rest(by_push, count),
        effects.with_rest(by_pushes, count),
        keys,
    )


@dataclass(frozen=True)
class Slopes:
    """Derivatives of R numbers a frame with a film's parameters (`Layout.known_to`) and each frame's force.

    The slow error of the force log comes last. It enters by its value in the frame and, with memory, by those in n
    earlier key frames, so its K knots are not written out.
    """

    j: Array  # (F, ..., C - 2 K + 2 n) with all parameters but that error, and with the push in the key frames
    a: Array  # (F, ..., 2) with the frame's force; (F, ..., 3) with its moment too
    axes: Array  # (2, 2) by which the logged force is turned
    weights: Array  # (F, K): that error is `weights @ values`
    added: Array | None = None  # (F, ..., 2) what memory adds to `a` for a part of the push that lasts
    keys: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # (n,) the key frames

    @property
    def others(self) -> int:
        """How many parameters there are but that error's."""
        return int(self.j.shape[-1]) - 2 * len(self.keys)

    @property
    def lasting(self) -> Array:
        """(F, ..., 2) with a push that lasts, as that error does."""
        return self.a if self.added is None else self.a + self.added

    @property
    def written(self) -> Array:
        """(F, ..., C) with all parameters."""
        count, frames = self.others, (len(self.weights), *[1] * (self.a.ndim - 2))
        out = np.empty((*self.a.shape[:-1], count + 2 * self.weights.shape[1]))
        out[..., :count] = self.j[..., :count]
        by_knots = -(self.lasting @ self.axes)[..., None, :] * self.weights.reshape(*frames, -1, 1)
        out[..., count:] = by_knots.reshape(*self.a.shape[:-1], -1)
        if len(self.keys):
            out[..., count:] -= self.j[..., count:] @ np.kron(self.weights[self.keys], self.axes)
        return out

    def times(self, step: Array) -> Array:
        """(F, ...): what a step (C,) of the parameters does."""
        error = self.weights @ step[self.others :].reshape(-1, 2) @ self.axes.T
        with_keys = np.concatenate([step[: self.others], -error[self.keys].ravel()])
        return np.asarray(self.j @ with_keys - np.einsum("t...d,td->t...", self.lasting, error))

    def transposed_times(self, v: Array) -> Array:
        """(C, n): what n sets of R numbers a frame, v (F, R, n), have with each parameter."""
        dense = self.j.reshape(-1, self.j.shape[-1]).T @ v.reshape(-1, v.shape[-1])
        return self.with_knots(dense, np.swapaxes(self.lasting, 1, 2) @ v)

    def with_knots(self, dense: Array, by_push: Array) -> Array:
        """(C, n) from what is known with the columns of `j` (., n) and with each frame's lasting push (F, 2, n)."""
        count = self.others
        by_keys = dense[count:].reshape(len(self.keys), 2, dense.shape[1])  # x and y in turn
        return np.concatenate([dense[:count], self.onto_knots(by_push) + self.onto_knots(by_keys, self.keys)])

    def onto_knots(self, by_push: Array, frames: IntArray | slice = slice(None)) -> Array:
        """(2 K, n) with that error's knots, from what is known with the push in some frames (., 2, n)."""
        weights, count = self.weights[frames], by_push.shape[-1]
        by_error = -self.axes.T @ by_push  # the error is taken off the log
        return (weights.T @ by_error.reshape(len(weights), 2 * count)).reshape(2 * weights.shape[1], count)


@dataclass(frozen=True)
class Prediction(State):
    """The tags' poses at the parameters of a state."""

    solved: statics.Equilibrium
    s: Array  # (m,) or (F, m) places of the beam under the tags
    riding: TagRide  # the tags there
    on_beam: Array  # (F, m, 2) m, these places in the beam's frame
    pose: Array  # (F, m, 3)
    force: Array  # (F, 2) N, the corrected force, `own` included
    # (F, 2) N, each frame's own force: minus the log's error that is faster than the knots, or all there is; behind it
    # perhaps a moment [N m] at the same place
    own: Array
    nearby: Slopes | None = None  # whitened derivatives of shapes nearby, taken for these

    @property
    def bending(self) -> Array:
        """(F, Q) rad of the curvature over that at rest of a beam that has not relaxed."""
        return self.solved.q - self.rest

    def reached(self, frame: int | None = None) -> tuple[float, ...]:
        """The part of the bending that a relaxing share of one reaches over the push, or in one frame, for each time;
        () without any."""
        if self.relaxation is None:
            return ()
        _, time = self.relaxation
        bent, weights = self.bending[: len(time)], self.solved.problem.weights
        of = slice(None) if frame is None else slice(frame, frame + 1)
        return tuple(effects.reached_part((lag @ bent)[of], bent[of], weights) for lag in effects.lags(time))

    @property
    def load(self) -> Array:
        """(F, 2) N, or (F, 3) with N m, that acts where the push does."""
        return np.hstack([self.force, self.own[:, 2:]])

    @property
    def slopes(self) -> Slopes:
        """Derivatives of the tags' poses (F, m, 3), exact."""
        return _slopes(self)

    @cached_property
    def whitened_slopes(self) -> Slopes:
        """Derivatives of the whitened poses, R = 3 m numbers a frame; zero where a tag was not seen."""
        if self.nearby is not None:
            return self.nearby
        whiten, shapes = self.data.whiten, replace(self.solved, problem=replace(self.solved.problem))
        slopes = replace(self, solved=shapes).slopes  # a copy, so that cached properties of the shapes are freed
        added = None if slopes.added is None else whitened(whiten, slopes.added)
        return replace(slopes, j=in_own_pages(whitened(whiten, slopes.j)), a=whitened(whiten, slopes.a), added=added)

    @property
    def whitened_by_force(self) -> Slopes:
        """`whitened_slopes` with each frame's force alone: much faster."""
        a = whitened(self.data.whiten, self.by_own())
        return Slopes(a[..., :0], a, np.eye(2), np.zeros((len(a), 0)))

    def by_own(self, *, place: bool = False) -> Array:
        """(F, m, 3, n) derivatives of the tags' poses with each frame's own load; with its `place` [m] too, last."""
        load = self.load
        changes = [pushed_by(self.push_beyond, np.eye(load.shape[1])[None])]
        changes += [placed_by(self.data.farther, load, np.ones((1, 1)))] if place else []
        return self.riding.carry(_responses(self, sensitivity.Perturbations(tuple(changes)))[0])

    def clear_slopes(self) -> None:
        """Free the cached derivatives, most of the memory of a fit; they are computed again on demand."""
        self.__dict__.pop("whitened_slopes", None)


def predict(
    data: FitData,
    layout: Layout,
    x: Array,
    start: Array | None,
    own: Array | None = None,
    settings: continuation.ContinuationSettings = continuation.ContinuationSettings(),
) -> Prediction:
    """Equilibria and tags for parameters x and each frame's `own` force (F, 2) [N], zero if None, or load (F, 3).

    `start`: shapes (F, Q) for a warm start; `settings` of the way from there, for free ends that do not relax.
    """
    state = State(data, layout, x)
    value, allowed = state.value, state.allowed
    own = np.zeros_like(data.force) if own is None else own
    slow = data.error_weights @ value("force").reshape(-1, 2)
    force = (data.force - slow + data.rate * value("clock")) @ state.log_axes.T + own[:, :2]
    force, beyond = force + allowed("force"), state.push_beyond
    k = np.exp(data.offset + data.on_nodes @ value("stiffness") + allowed("log k"))
    weight_beyond = data.weight + allowed("load")
    if data.mass is not None:
        weight_beyond = weight_beyond + data.mass.force(data.problem, k, value("mass"))
    problem = replace(
        data.problem,
        k=k,
        length=state.length,
        section=state.section[0],
        q0=state.rest if data.memory is None else _remembering(state, data.memory, start),
        alpha0=state.clamp,
        dead_force=beyond[..., None] * force[:, None, :] + weight_beyond,
        moment=data.problem.moment + beyond * own[:, 2:] if own.shape[1] > 2 else data.problem.moment,
    )
    remembering = state.memory
    if data.ends is not None:
        solved = solve(problem, data.ends, moved(data.ends, layout, x, data.number), start, data.poses)
    elif remembering is not None:
        solved = _relaxed(problem, remembering, start)
    else:
        solved = free_ends(problem, data.poses, start, settings)
    s, ride = state.ride(solved)
    xy = solved.xy(s)
    pose = ride.pose(xy, value("origin"), data.of_tags(value("turn")))
    if data.rulers is not None:
        pose[..., :2] = paired(data.rulers, pose[..., 1] + value("across"))
    for (i, c), zero in zip(zeroed_coordinates(data.observations), value("zero"), strict=True):
        pose[:, i, c] -= zero
    return Prediction(data, layout, x, solved, s, ride, xy, pose + allowed("poses"), force, own)


def _remembering(state: State, memory: effects.MaterialMemory, start: Array | None) -> Array:
    """(F, Q) rad, the curvature at rest of a beam with this memory that is bent as in `start`."""
    bent = np.zeros(memory.before.shape[:2]) if start is None else start - state.rest
    return np.asarray(state.rest + memory.shift(state.value("relaxation"), bent)[0])


def _slopes(now: Prediction) -> Slopes:
    data, layout, solved, axes = now.data, now.layout, now.solved, now.log_axes
    bent, has_memory, nodes = _bent(now), now.memory is not None, solved.q.shape[1]
    pushes = push_forces(now.force - now.own[:, :2] - now.allowed("force"), axes, data.rate)
    pushes |= {a.name: a.basis for a in data.entering("force")}
    moves = {a.name: a.basis for a in data.entering("place")}
    changes = load_changes(bent)
    changes |= {a.name: sensitivity.Perturbation(a.basis, None, None, np.zeros(a.count)) for a in data.entering("load")}
    if has_memory:  # what a force does in one frame depends on those before
        changes |= {name: pushed_by(bent.beyond, force) for name, force in pushes.items()}
        changes |= {name: placed_by(bent.farther, bent.push, basis) for name, basis in moves.items()}
    columns = response_columns(changes, bent)
    each_node = (sensitivity.of_rest_curvature(solved.problem, np.eye(nodes)),) if has_memory else ()
    both, by_end = _responses(now, sensitivity.Perturbations((*columns.changes.parts, *each_node)))
    response, by_node = np.split(both, [len(columns.changes.clamp)], axis=-1)
    ride = now.riding
    if data.ends is None and "length" in columns.slices:
        response[:, :, :2, columns.slices["length"]] += now.on_beam[..., None]
    carried = ride.carry(response)
    free, error = layout.free_columns(data.number), layout.columns("force", data.number)
    out = np.zeros((*now.pose.shape, len(layout.known_to(data.number)) if error is None else error.start))
    slopes = Slopes(out, columns.split(carried)["push"], axes, data.error_weights)
    if has_memory:
        memory = _remembered_poses(now, columns, by_node)
        carried = carried + ride.carry(memory.by_parameters)
        if error is not None:
            out = np.concatenate([out, ride.carry(memory.by_pushes)], axis=-1)
            slopes = replace(slopes, j=out, added=ride.carry(memory.by_push), keys=memory.keys)
    blocks = columns.split(carried)
    if not has_memory:
        blocks |= {name: blocks["push"][..., :2] @ force[:, None] for name, force in pushes.items()}
        blocks |= {name: blocks["place"] * basis[:, None, None, :] for name, basis in moves.items()}
    blocks |= {a.name: blocks["clamp"] * a.basis[:, None, None, :] for a in data.entering("clamp")}
    blocks |= {a.name: a.basis for a in data.entering("poses")} | {"rest change": blocks["curvature"]}
    put_blocks(slopes.j, free, blocks)
    put_tags(slopes.j, free, _tag_motion(now), data.tags)
    if data.ends is not None:
        held = replace(ride, angle=ride.angle[data.ends.frames])
        put_ends(slopes.j, data.ends, layout, data.number, held.carry(by_end))
    if "zero" in free:
        for n, (i, c) in enumerate(zeroed_coordinates(data.observations)):
            slopes.j[:, i, c, free["zero"].start + n] = -1.0
    return slopes


def _responses(now: Prediction, changes: sensitivity.Perturbations) -> tuple[Array, Array]:
    """(F, m, 3, P) of the beam's places under the tags to changes, and (H, m, 3, 3) to the held ends."""
    solved, s = now.solved, now.s
    if now.data.ends is None:
        return sensitivity.respond(solved, changes).poses(s), np.zeros((0, s.shape[-1], 3, 3))
    wrench = sensitivity.of_force(solved.problem, np.ones(1)) + sensitivity.of_moment(solved.problem, np.ones(1))
    return with_ends_held(sensitivity.respond(solved, changes + wrench).poses(np.append(s, 1.0)), now.data.ends)


def _tag_motion(now: Prediction) -> TagMotion:
    """How the tags move with their mounting; a metre along is one of the length as written."""
    seen, solved, s, ride = now.pose - now.allowed("poses"), now.solved, now.s, now.riding
    xy = (seen[..., :2] - now.value("origin")) / ride.scale
    written, on_beam = now.data.observations.length, ride.over <= 0.0
    if ride.ruler:
        return ride.motion(xy, ride.over)
    bend = np.where(on_beam, grid.apply(solved.problem.grid.value_at(s), solved.q) / written, 0.0)
    if not now.data.allowances:
        return ride.motion(xy, bend)
    onward = np.where(on_beam[:, None], solved.xy_by_s(s) / written, unit(ride.angle))
    return ride.motion(xy, bend, onward)


def _bent(now: Prediction) -> BentBeam:
    """Effects of the parameters on the balance of the fitted shapes."""
    data, k, by_mass, weight_by_k, shift = now.data, now.solved.problem.k, None, None, None
    if data.mass is not None:
        by_mass = data.mass.by_mass(data.problem, k)
        weight_by_k = data.mass.by_stiffness(data.problem, k, data.on_nodes, now.value("mass"))
    if now.relaxation is not None:
        shift = effects.shift_derivatives(*now.relaxation, now.bending, now.solved.problem.weights)
    elif data.memory is not None:
        shift = data.memory.shift(now.value("relaxation"), now.bending)[1]
    return BentBeam(
        now.solved,
        data.on_nodes,
        data.rest_on_nodes,
        now.load,
        now.push_beyond,
        data.farther,
        by_mass,
        weight_by_k,
        {a.name: a.basis for a in data.entering("log k")},
        shift,
        lengthens="length" in now.layout.free_columns(data.number),
        thickens=now.section[1],
    )


# Error of a learned beam's prediction of another push: band of k(s), place and direction of the force, to first order.
# The scale of the force cancels where one sensor logged both pushes.

_FRAMES = 100  # that are looked at


def few_frames(frames: BoolArray) -> BoolArray:
    """(T,) of these frames at most as many as are looked at, evenly chosen."""
    return evenly_spread(np.flatnonzero(frames).astype(np.int64), _FRAMES, len(frames))


def variances(
    solved: statics.Equilibrium, observations: Observations, frames: BoolArray, stiffness: UncertainStiffness
) -> dict[str, Array]:
    """(m,) m^2 each, variance of the tags' predicted places, mean over the frames: by the band of log k(s), the place
    of the push and the direction of its force.

    `solved`: the beam in these `frames` (T,). Loads that hang on marks are exact.
    """
    s, problem, stands = observations.marker_s, solved.problem, solved.converged[:, None]
    functions = problem.k[..., None] * stiffness.basis(problem.grid.nodes)
    by_k = sensitivity.respond(solved, sensitivity.of_stiffness(solved, functions)).xy(s)  # (T, m, 2, p)
    out = {"stiffness": np.sum((by_k @ stiffness.covariance) * by_k, axis=(2, 3))}
    if not observations.static:
        at, force, stated = push_places(observations)[frames], observations.force[frames], observations.stated
        angle = solved.angle(at[:, None])[:, 0]
        _, across = along_and_across(force, angle)
        turned = left_of(force)
        by_moment = sensitivity.respond(solved, sensitivity.of_moment(problem, at)).xy(s)[..., 0]
        by_force = sensitivity.respond(solved, sensitivity.of_force(problem, at)).xy(s)
        turn = grid.apply(problem.grid.integral_to(at[:, None]), solved.q - problem.q0)[:, 0]  # of the beam, since rest
        away = stated.place_sd**2 + (effects.SLIDE_SD * turn) ** 2  # (T,) m^2
        out["place"] = np.sum((by_moment * across[:, None, None]) ** 2, axis=-1) * away[:, None]
        out["direction"] = np.sum(np.einsum("tmcd,td->tmc", by_force, turned) ** 2, axis=-1) * stated.direction_sd**2
    return {name: np.mean(one, axis=0, where=stands) for name, one in out.items()}
