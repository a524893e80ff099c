"""From parameters to predicted tags, with exact derivatives: the model of the marker-space fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from onebend.beam.continuation import follow, refine
from onebend.beam.grid import apply, paired, solve_each
from onebend.beam.problem import Problem
from onebend.beam.sensitivity import (
    Perturbation,
    Perturbations,
    minus_gradient,
    of_clamp_angle,
    of_force,
    of_moment,
    of_rest_curvature,
    of_section_thickness,
    of_stiffness,
    respond,
)
from onebend.beam.statics import Equilibrium, gradient, tangent
from onebend.beam.stiffness import RectangularSection, UncertainStiffness
from onebend.learning.allowances import (
    SLIDE_SD,
    Allowance,
    Entry,
    memory,
    reached_part,
    remembered,
    rest_shift,
    secant_share,
    section_at,
    shift_derivatives,
)
from onebend.learning.fit_data import FitData
from onebend.learning.frames import push_places, ruler_places, steepness, whitened, zeroed_coordinates
from onebend.learning.normal import in_own_pages
from onebend.learning.parameters import Layout, log_axes, rest_curvature
from onebend.learning.static_poses import free_ends, moved, put_ends, solve, with_ends_held
from onebend.records import Array, BoolArray, IntArray, Observations

# Derivatives of the tags' poses with the parameters: one order of columns, used by all who need them.
#
# The way from a parameter to a tag has three parts, and each stands here once.
#
# 1. Parameters that bend the beam come in groups. `balance_changes` says how each group enters the balance of
# moments; the order of its entries is the order of the columns (`ResponseColumns`). A further group is one more entry
# there. 2. A tag rides on the beam: `TagRide` takes the motion of the beam's places to the tags in the picture, and
# `TagMotion` says how tags move with their own places, the origin and the camera's scale while the shape stays as it
# is. 3. `put_blocks` and `put_tags` write all of it to the columns that a layout gives to each block of parameters. A
# group and a block of the layout that have one name belong together.


@dataclass(frozen=True)
class BentBeam:
    """Equilibria of F frames on Q nodes, and what the parameters change in their balance."""

    solved: Equilibrium
    on_nodes: Array  # (Q, p) or (F, Q, p): the functions of log k
    rest_on_nodes: Array  # (Q, 3) or (F, Q, 3): the functions of the rest curvature
    push: Array  # (F, 2) N
    beyond: Array  # (F, Q): share of the push that acts beyond the node
    farther: Array  # (Q,) or (F, Q) 1/m: what that share gains for each metre that the push lies farther out
    by_mass: Perturbation | None = None  # the parts of the mass; None where nothing weighs
    weight_by_k: Array | None = None  # (F, Q, 2, p) N: weight beyond the nodes, where the mass follows k(s)
    log_k: Mapping[str, Array] = field(default_factory=dict)  # (Q, n) or (F, Q, n): further functions of log k, by name
    rest_shift: Array | None = None  # (F, Q, n): of the curvature at rest, with the parameters of relaxation
    lengthens: bool = False  # the length is a parameter
    thickens: float = 1.0  # half of how the log of stretch and shear goes with its parameter


def balance_changes(beam: BentBeam) -> dict[str, Perturbation]:
    """How each group of parameters enters the balance of moments; the groups are in the order of the columns."""
    return load_changes(beam) | material_changes(beam)


def load_changes(beam: BentBeam) -> dict[str, Perturbation]:
    """Those of the loads, the clamp and the beam at rest.

    "curvature" (3) rad; "clamp" (1) rad; "push" (2) N, the force of each frame; "place" (1) m, of the push along the
    beam; "mass" (4), its parts over all of it, where something weighs; "relaxation", the shares that relax.
    """
    problem = beam.solved.problem
    changes = {
        "curvature": of_rest_curvature(problem, beam.rest_on_nodes),
        "clamp": of_clamp_angle(problem),
        "push": pushed_by(beam.beyond, np.eye(2)[None]),
        "place": placed_by(beam, np.ones((1, 1))),
    }
    if beam.by_mass is not None:
        changes["mass"] = beam.by_mass
    if beam.rest_shift is not None:
        changes["relaxation"] = of_rest_curvature(problem, beam.rest_shift)
    return changes


def material_changes(beam: BentBeam) -> dict[str, Perturbation]:
    """Those of the beam itself, which enter by `k (q - q0)` and by 1/EA and 1/kGA.

    "stiffness" (p) coefficients of log k; what else enters log k, by name; "length" (1) its log; "section" (1) its
    thickness, where the beam stretches and shears.
    """
    problem = beam.solved.problem
    changes = {
        "stiffness": replace(of_stiffness(beam.solved, problem.k[..., None] * beam.on_nodes), force=beam.weight_by_k)
    }
    for name, functions in beam.log_k.items():
        changes[name] = of_stiffness(beam.solved, problem.k[..., None] * functions)
    if beam.lengthens:
        changes["length"] = _of_length(beam.solved)
    if problem.section is not None:
        changes["section"] = of_section_thickness(problem, beam.thickens)
    return changes


def joined_functions(changes: Mapping[str, Perturbation], nodes: int) -> tuple[Array, Array]:
    """(Q, P) each: the functions of k [N m] and of the logs of 1/EA and 1/kGA of `material_changes` that frames share,
    one group after the other; zero where a group has none."""
    elastic, compliant = (
        np.concatenate([np.zeros((nodes, len(c.clamp))) if f is None else f[1] for c, f in pairs], axis=1)
        for pairs in ([(c, c.elastic) for c in changes.values()], [(c, c.compliance) for c in changes.values()])
    )
    return elastic, compliant


def _of_length(solved: Equilibrium) -> Perturbation:
    """One parameter: the log of the length, k [N m] and the loads staying as they are; without point moments.

    The levers of all forces grow with the length. In equilibrium they balance k (q - q0), so that the balance changes
    as if k were smaller by as much; 1/EA and 1/kGA go with 1 / (k L).
    """
    problem = solved.problem
    elastic = solved.q - problem.q0, -problem.k[..., None]
    compliance = None
    if problem.section is not None and problem.compliance is not None:
        compliance = problem.compliance, np.full((problem.to_nodes.shape[-1], 1), -1.0)
    return Perturbation(None, None, elastic, np.zeros(1), compliance)


@dataclass(frozen=True)
class ResponseColumns:
    """Where each group of parameters stands among the P columns of a mechanical response."""

    changes: Perturbations  # of all groups, one after the other
    slices: dict[str, slice]

    def split(self, response: Array) -> dict[str, Array]:
        """The groups' own parts (..., n) of a response (..., P)."""
        return {name: response[..., columns] for name, columns in self.slices.items()}


def response_columns(changes: Mapping[str, Perturbation]) -> ResponseColumns:
    """The columns of these groups, in their order."""
    slices, start = {}, 0
    for name, change in changes.items():
        slices[name] = slice(start, start + len(change.clamp))
        start += len(change.clamp)
    return ResponseColumns(Perturbations(tuple(changes.values())), slices)


def place_responses(solved: Equilibrium, changes: Mapping[str, Perturbation], s: Array) -> dict[str, Array]:
    """(F, S, 3, n) m, m, rad per unit of each group: of the beam's position and angle at places `s` (S,)."""
    columns = response_columns(changes)
    return columns.split(respond(solved, columns.changes).poses(s))


def push_moment(problem: Problem, push_s: Array, force: Array) -> Perturbation:
    """One parameter: the moment [N m] of a force (F,) [N] across the beam that acts one metre from `push_s`."""
    lever = of_moment(problem, push_s)
    assert lever.moment is not None
    return replace(lever, moment=force[:, None, None] * lever.moment)


def along_and_across(force: Array, angle: Array) -> tuple[Array, Array]:
    """(F,) N each: components of forces (F, 2) along a beam of this `angle` (F,) [rad] and to its left."""
    cos, sin = np.cos(angle), np.sin(angle)
    return force[:, 0] * cos + force[:, 1] * sin, force[:, 1] * cos - force[:, 0] * sin


def push_forces(push: Array, log_axes: Array, rate: Array) -> dict[str, Array]:
    """(F, 2, 1) N per unit of the push, with the "direction" of the force log's axes [rad] and its "clock" [s]; see
    `push_blocks`."""
    turned = paired(-push[:, 1], push[:, 0])
    return {"direction": turned[..., None], "clock": (rate @ log_axes.T)[..., None]}


def push_blocks(by_push: Array, push: Array, log_axes: Array, rate: Array) -> dict[str, Array]:
    """(F, m, 3, 1) with the "direction" of the force log's axes [rad] and its "clock" [s].

    `by_push` (F, m, 3, 2) per N, `push` (F, 2) N, `log_axes` (2, 2) by which the logged force is turned, `rate` (F, 2)
    N/s of the logged force.
    """
    forces = push_forces(push, log_axes, rate)
    return {name: np.einsum("fmad,fdn->fman", by_push, force) for name, force in forces.items()}


def pushed_by(beyond: Array, force: Array) -> Perturbation:
    """n parameters that add to the push, of which the share `beyond` (F, Q) acts beyond each node: `force` (F, 2, n) N
    per unit in each frame."""
    added = beyond[..., None, None] * force[:, None]
    return Perturbation(added, None, None, np.zeros(force.shape[-1]))


def placed_by(beam: BentBeam, basis: Array) -> Perturbation:
    """n parameters that move the push: `basis` (F, n) m per unit in each frame."""
    added = (beam.farther[..., None] * beam.push[:, None, :])[..., None] * basis[:, None, None, :]
    return Perturbation(added, None, None, np.zeros(basis.shape[-1]))


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
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        return paired(cos * self.over - sin * self.across, sin * self.over + cos * self.across)

    def carry(self, response: Array) -> Array:
        """(F, m, 3, P) of the tags in the picture, from that of the beam's places under them."""
        offset, turn = self.offset, response[:, :, 2:]
        lever = paired(-offset[..., 1], offset[..., 0])
        xy = response[:, :, :2] + lever[..., None] * turn
        if self.ruler:
            xy = np.stack([np.zeros_like(xy[:, :, 0]), xy[:, :, 1] - self.slope[..., None] * xy[:, :, 0]], axis=2)
        return np.concatenate([self.scale * xy, turn], axis=2)

    @cached_property
    def slope(self) -> Array:
        """(F, m) of the beam under a ruler: how y there goes with x."""
        return np.sin(self.angle) / steepness(self.angle)

    def motion(self, xy: Array, bend: Array, onward: Array | None = None) -> TagMotion:
        """Of tags at `xy` (F, m, 2) m in the beam's frame, where the beam's curvature is `bend` (F, m) 1/m; zero beyond
        the tip. `onward` (F, m, 2): m per m along the beam of its places; None: along the tangent, as it does not
        stretch."""
        if self.ruler:
            return self._ruler_motion(xy)
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        tangent = paired(cos, sin)
        turning = (self.across * bend)[..., None] * tangent
        along = self.scale * ((tangent if onward is None else onward) - turning)
        return TagMotion(along, bend, self.scale * paired(-sin, cos), xy)

    def _ruler_motion(self, xy: Array) -> TagMotion:
        """Of rulers: one that stands a metre farther out reads what passes there, and a beam that is moved along passes
        under it with another part."""
        nothing, one = np.zeros_like(self.slope), np.ones_like(self.slope)
        origin = np.stack([paired(nothing, nothing), paired(-self.slope, one)], axis=2)
        return TagMotion(paired(nothing, self.slope), nothing, paired(nothing, one), xy, origin)


def free_columns(layout: Layout, recording: int = -1) -> dict[str, slice]:
    """Columns of all blocks that one recording depends on and that are not frozen, by the blocks' names."""
    blocks = [b for b in layout.blocks if b.recording in (-1, recording) and b.start >= 0]
    columns = {b.name: layout.columns(b.name, b.recording) for b in blocks}
    return {name: where for name, where in columns.items() if where is not None}


def put_blocks(out: Array, columns: Mapping[str, slice], blocks: Mapping[str, Array]) -> None:
    """Write derivatives (F, m, 3, n) to the columns (F, m, 3, C) of the same names; frozen ones are left out."""
    for name, block in blocks.items():
        if name in columns:
            out[..., columns[name]] = block


def put_tags(out: Array, columns: Mapping[str, slice], motion: TagMotion) -> None:
    """Write derivatives with the tags' own places and turns, the origin and the camera's scale to `out` (F, m, 3, C),
    in which columns of blocks that are not written stay as they are: zero."""
    tags = np.arange(out.shape[1])
    own = {name: columns[name].start + tags for name in ("along", "across", "turn") if name in columns}
    for c in range(2):
        if "along" in own:
            out[:, tags, c, own["along"]] = motion.along[..., c]
        if "across" in own:
            out[:, tags, c, own["across"]] = motion.across[..., c]
        if "origin" in columns and motion.origin is not None:
            out[:, :, c, columns["origin"]] = motion.origin[:, :, c]
        elif "origin" in columns:
            out[:, :, c, columns["origin"].start + c] = 1.0
        if "scale" in columns:
            out[:, :, c, columns["scale"].start] = motion.xy[..., c]
    if "along" in own:
        out[:, tags, 2, own["along"]] = motion.bend
    if "turn" in own:
        out[:, tags, 2, own["turn"]] = 1.0


def tag_blocks(motion: TagMotion) -> dict[str, Array]:
    """(F, m, 3, n) of each block that `put_tags` writes, for those who have no layout."""
    m = motion.bend.shape[1]
    sizes = {"along": m, "across": m, "turn": m, "origin": 2, "scale": 1}
    ends = np.cumsum([0, *sizes.values()]).tolist()
    columns = {name: slice(a, b) for name, a, b in zip(sizes, ends[:-1], ends[1:], strict=True)}
    out = np.zeros((*motion.bend.shape, 3, ends[-1]))
    put_tags(out, columns, motion)
    return {name: out[..., where] for name, where in columns.items()}


# What a recording's allowances do to the fit's model at given parameters, and its derivatives with them.

_SETTLED = 1e-7  # rad, of the last change of a shape that relaxes
_FALLING = 0.2  # of the change before: one that is larger takes a new tangent
_FARTHEST = 5.0  # rad, of the curvature in one update of Newton's method
_MOST_PASSES = 16


def allowed(recording: FitData, layout: Layout, x: Array, enters: Entry) -> Array | float:
    """The sum of the allowances that enter here, at parameters x (P,); 0 where there are none. Shapes: see `Entry`."""
    here = [a for a in recording.allowances if a.enters == enters]
    return sum((a.basis @ _values(recording, layout, x, a) for a in here), start=0.0)


def allowed_length(recording: FitData, layout: Layout, x: Array) -> Array:
    """() m, the beam's length."""
    change = [_values(recording, layout, x, a)[0] for a in recording.allowances if a.enters == "length"]
    return np.asarray(recording.observations.length * np.exp(sum(change)))


def allowed_clamp(recording: FitData, layout: Layout, x: Array) -> Array:
    """() or (F, 1) rad, the clamp's angle."""
    angle, gives = layout.get(x, "clamp", recording.number)[0], allowed(recording, layout, x, "clamp")
    return np.asarray(angle if isinstance(gives, float) else angle + gives[:, None])


def allowed_section(recording: FitData, layout: Layout, x: Array) -> tuple[RectangularSection | None, float]:
    """By which the beam stretches and shears, None where it does neither, and how it goes with the parameter: see
    `section_at`."""
    for a in recording.allowances:
        if a.enters == "section":
            o = recording.observations
            return section_at(float(_values(recording, layout, x, a)[0]), o.stated.thickness, o.length)
    return None, 0.0


def equilibria(recording: FitData, layout: Layout, x: Array, problem: Problem, start: Array | None) -> Equilibrium:
    """Of a free end; where the material relaxes, each shape hangs on those before it, and all are found together.

    `problem` has the curvature at rest of a beam that has not relaxed; `start` (F, Q), where shapes are known about.
    Newton's method on each shape and the shift of its rest take turns. The shift settles slowly and Newton's method
    fast: the tangent's inverse of one pass does for the next ones, as long as they settle.
    """
    values = relaxation_values(recording, layout, x)
    if values is None or not remembers(recording, layout, x):
        return free_ends(problem, recording.poses, start)
    q = follow(problem).q if start is None else start
    remembering, rest = memory(values, relaxation_time(recording)), problem.q0
    nodes, inverse, before = q.shape[1], None, np.inf
    for _ in range(_MOST_PASSES):
        shifted = replace(problem, q0=rest + rest_shift(remembering, q - rest, problem.weights))
        if inverse is None:
            inverse = solve_each(tangent(shifted, q), np.broadcast_to(np.eye(nodes), (*q.shape, nodes)))
        update = (inverse @ gradient(shifted, q)[..., None])[..., 0]
        size = float(np.max(np.abs(update)))
        if not size < _FARTHEST:  # from here Newton's method alone cannot be trusted
            q, inverse = refine(shifted, q).q, None
            continue
        q = q - update
        if size < _SETTLED:
            break
        inverse, before = (inverse if size < _FALLING * before else None), size
    return refine(replace(problem, q0=rest + rest_shift(remembering, q - rest, problem.weights)), q)


def relaxation_values(recording: FitData, layout: Layout, x: Array) -> Array | None:
    """(n,) shares of the material that relax; None where nothing is allowed to."""
    every = [_values(recording, layout, x, a) for a in recording.allowances if a.enters == "relaxation"]
    return every[0] if every else None


def remembers(recording: FitData, layout: Layout, x: Array) -> bool:
    """Whether a shape hangs on those before it."""
    values = relaxation_values(recording, layout, x)
    return values is not None and bool(np.any(values != 0.0)) and recording.ends is None


def relaxation_time(recording: FitData) -> Array:
    """(T,) s of the frames whose shapes relaxation remembers."""
    return next(a.basis for a in recording.allowances if a.enters == "relaxation")


def relaxation_derivatives(recording: FitData, layout: Layout, x: Array, solved: Equilibrium) -> Array | None:
    """(F, Q, n) of the curvature at rest, shapes held; None where the material does not relax."""
    values = relaxation_values(recording, layout, x)
    if values is None:
        return None
    return shift_derivatives(
        values, relaxation_time(recording), bending(recording, layout, x, solved), solved.problem.weights
    )


def secant_of(recording: FitData, layout: Layout, x: Array, solved: Equilibrium) -> float:
    """The secant stiffness over the instantaneous one; 1 where the material does not relax."""
    values = relaxation_values(recording, layout, x)
    if values is None:
        return 1.0
    remembering = memory(values, relaxation_time(recording))
    return secant_share(remembering, bending(recording, layout, x, solved), solved.problem.weights)


def log_k_functions(recording: FitData) -> dict[str, Array]:
    """Functions of log k at the nodes, by the allowance's name."""
    return {a.name: a.basis for a in recording.allowances if a.enters == "log k"}


def allowance_changes(recording: FitData, beam: BentBeam) -> dict[str, Perturbation]:
    """How the allowances of the push and of the clamp enter the balance, by name."""
    changes: dict[str, Perturbation] = {}
    for a in recording.allowances:
        if a.enters == "force":
            changes[a.name] = pushed_by(beam.beyond, a.basis)
        elif a.enters == "place":
            changes[a.name] = placed_by(beam, a.basis)
        elif a.enters == "load":
            changes[a.name] = Perturbation(a.basis, None, None, np.zeros(a.count))
    return changes


def clamp_blocks(recording: FitData, by_clamp: Array) -> dict[str, Array]:
    """(F, m, 3, n) of the allowances that turn the clamp or move the tags, by name; `by_clamp` (F, m, 3, 1) per rad."""
    out = {a.name: by_clamp * a.basis[:, None, None, :] for a in recording.allowances if a.enters == "clamp"}
    return out | {a.name: a.basis for a in recording.allowances if a.enters == "poses"}


def bending(recording: FitData, layout: Layout, x: Array, solved: Equilibrium) -> Array:
    """(F, Q) rad of the curvature over that at rest of a beam that has not relaxed."""
    return np.asarray(solved.q - recording.rest_on_nodes @ rest_curvature(layout, x, recording.number))


def _values(recording: FitData, layout: Layout, x: Array, allowance: Allowance) -> Array:
    return layout.get(x, allowance.name, -1 if allowance.shared else recording.number)


# Derivatives of a beam whose material remembers: what a parameter changes in one frame goes on in all later ones.
#
# A change of the bending shifts the curvature at rest of all later frames, which changes their bending, and so on. It
# is followed through some frames only, for the memory is smooth in time; what it shifts in the others lies between.

_KEY_FRAMES = 24  # at most, through which the memory is followed
_PASSES = 2  # each leaves about the relaxing share of what the one before left


@dataclass(frozen=True)
class Remembered:
    """What the memory adds to the derivatives of poses at S places of the beam, in F frames.

    A part of the push that is `weights @ values` in each frame, as the force log's error is, adds `by_push` with its
    value in the frame itself and `by_pushes` with its values in the key frames.
    """

    by_parameters: Array  # (F, S, 3, P) m, m, rad per unit
    by_push: Array  # (F, S, 3, 2) per N
    by_pushes: Array  # (F, S, 3, 2 n) per N, x and y in turn
    keys: IntArray  # (n,)


@dataclass(frozen=True)
class _KeyFrames:
    """n of the F frames."""

    keys: IntArray  # (n,)
    between: Array  # (T, n) weights by which values of the key frames stand for all T that remember
    remembering: Array  # (n, n) see `memory`
    bending: Array  # (n, Q) rad
    weights: Array  # (Q,) or (n, Q)


def remembered_poses(
    recording: FitData, layout: Layout, x: Array, solved: Equilibrium, columns: ResponseColumns, by_node: Array
) -> Remembered:
    """With the P parameters of `columns` and with the push; `by_node` (F, S, 3, Q) of the poses with the curvature at
    rest at each node, without memory."""
    values, time = relaxation_values(recording, layout, x), relaxation_time(recording)
    assert values is not None
    keys = np.unique(np.linspace(0, len(time) - 1, min(len(time), _KEY_FRAMES)).round().astype(np.int64))
    some, bent = solved.take(keys), bending(recording, layout, x, solved)[keys]
    between = np.stack([np.interp(time, time[keys], one) for one in np.eye(len(keys))], axis=1)
    frames = _KeyFrames(keys, between, memory(values, time[keys]), bent, some.problem.weights)
    first, by_shift = _responses_with_memory(some, columns.changes.take(keys))
    change = first.copy()
    change[..., columns.slices["curvature"]] -= recording.rest_on_nodes  # the rest that bending counts from
    shift = np.tensordot(between, _shift(frames, change, by_shift), 1)
    by_parameters = _at_places(by_node[: len(time)], shift)
    by_push, by_pushes = _by_push(frames, first[..., columns.slices["push"]], by_node[keys])
    rests = len(by_node) - len(time)
    return Remembered(
        _with_rests(by_parameters, rests), _with_rests(by_push, rests), _with_rests(by_pushes, rests), keys
    )


def _responses_with_memory(some: Equilibrium, changes: Perturbations) -> tuple[Array, Array]:
    """(n, Q, P) of the curvature to changes, and (n, Q, Q) to the curvature at rest at each node, without memory."""
    problem, nodes = some.problem, some.q.shape[1]
    inverse = solve_each(tangent(problem, some.q), np.broadcast_to(np.eye(nodes), (len(some.q), nodes, nodes)))
    return inverse @ minus_gradient(some, changes), inverse * problem.stiff[..., None, :]


def _shift(frames: _KeyFrames, change: Array, by_shift: Array) -> Array:
    """(n, Q, P) of the curvature at rest, from changes (n, Q, P) of the bending without memory."""
    moved = change
    for _ in range(_PASSES):
        moved = change + by_shift @ remembered(frames.remembering, frames.bending, frames.weights, moved)
    return remembered(frames.remembering, frames.bending, frames.weights, moved)


def _by_push(frames: _KeyFrames, by_push: Array, by_node: Array) -> tuple[Array, Array]:
    """(T, S, 3, 2) with the push of the frame itself, and (T, S, 3, 2 n) with that of the key frames.

    `by_push` (n, Q, 2) of the curvature without memory, `by_node` (n, S, 3, Q) of the poses with the curvature at rest.
    To first order in what relaxes; that the part c of the curvature that is reached changes too is left out.
    """
    every = np.arange(len(by_push))
    reached = reached_part(frames.remembering @ frames.bending, frames.bending, frames.weights)
    pairs = np.tensordot(by_node, by_push, ((3,), (1,)))  # (n, S, 3, n, 2): frame, and where it was pushed
    at_once = np.tensordot(frames.between, pairs[every, :, :, every], 1)
    pairs *= frames.remembering[:, None, None, :, None]
    later = np.tensordot(frames.between, pairs.reshape(*pairs.shape[:3], -1), 1)
    return -reached / (1.0 - reached) * at_once, later / (1.0 - reached)


def _at_places(by_node: Array, shift: Array) -> Array:
    """(F, S, 3, P) of poses, from `by_node` (F, S, 3, Q) and shifts (F, Q, P) of the curvature at rest."""
    rows = by_node.reshape(len(by_node), -1, by_node.shape[-1])
    return np.asarray((rows @ shift).reshape(*by_node.shape[:3], -1))


def _with_rests(part: Array, rests: int) -> Array:
    """(F, ...) of (T, ...): nothing in the frames at rest, which come last."""
    return np.concatenate([part, np.zeros((rests, *part.shape[1:]))])


@dataclass(frozen=True)
class Slopes:
    """Derivatives of R numbers a frame with the parameters of a film (`at.known_to`) and with each frame's force.

    The slow error of the force log comes last of the parameters. It enters by its value in the frame and, where the
    material remembers, by those in n key frames before it, so its K knots are not written out.
    """

    j: Array  # (F, ..., C - 2 K + 2 n) with all parameters but that error, and with the push in the key frames
    a: Array  # (F, ..., 2) with the frame's force
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
class Prediction:
    """Tags where the parameters put them."""

    recording: FitData
    layout: Layout
    x: Array  # (P,) the parameters
    solved: Equilibrium
    pose: Array  # (F, m, 3)
    force: Array  # (F, 2) N, the corrected force, `own` with it
    own: Array  # (F, 2) N, what of the force is each frame's own: less the log's error that is faster than the knots
    nearby: Slopes | None = None  # whitened ones of shapes so near that they do for these as well

    @property
    def slopes(self) -> Slopes:
        """Derivatives of the tags' poses (F, m, 3), exact."""
        return _slopes(self)

    @cached_property
    def whitened_slopes(self) -> Slopes:
        """The same of the whitened poses, R = 3 m numbers a frame; zero where a tag was not seen."""
        if self.nearby is not None:
            return self.nearby
        whiten, shapes = self.recording.whiten, replace(self.solved, problem=replace(self.solved.problem))
        slopes = replace(self, solved=shapes).slopes  # what is worked out of the shapes on the way is not kept
        added = None if slopes.added is None else whitened(whiten, slopes.added)
        return replace(slopes, j=in_own_pages(whitened(whiten, slopes.j)), a=whitened(whiten, slopes.a), added=added)

    @property
    def whitened_by_force(self) -> Slopes:
        """`whitened_slopes` with each frame's force, and with no parameter: a small part of the work."""
        recording, frames = self.recording, len(self.pose)
        by_force = pushed_by(_pushed(recording, self.layout, self.x), np.eye(2)[None])
        ride = tag_ride(recording, self.layout, self.x, self.solved)
        a = whitened(recording.whiten, ride.carry(_responses_at_once(self, Perturbations((by_force,)))[0]))
        return Slopes(a[..., :0], a, np.eye(2), np.zeros((frames, 0)))

    def release(self) -> None:
        """Forget the derivatives, most of what a fit holds in memory; they are worked out again where asked for, and
        then its own ones."""
        self.__dict__.pop("whitened_slopes", None)
        self.__dict__["nearby"] = None


def predict(recording: FitData, layout: Layout, x: Array, start: Array | None, own: Array | None = None) -> Prediction:
    """Equilibria and tags for parameters x and each frame's `own` force (F, 2) [N], none where it is not given;
    warm-started from shapes `start` (F, Q) where given."""
    r = recording.number
    own = np.zeros_like(recording.force) if own is None else own
    slow = recording.error_weights @ layout.get(x, "force", r).reshape(-1, 2)
    force = (recording.force - slow + recording.rate * layout.get(x, "clock", r)) @ log_axes(layout, x, r).T + own
    force = force + allowed(recording, layout, x, "force")
    k = np.exp(
        recording.offset + recording.on_nodes @ layout.get(x, "stiffness") + allowed(recording, layout, x, "log k")
    )
    weight_beyond = recording.weight + allowed(recording, layout, x, "load")
    if recording.mass is not None:
        weight_beyond = weight_beyond + recording.mass.force(recording.problem, k, layout.get(x, "mass"))
    problem = replace(
        recording.problem,
        k=k,
        length=allowed_length(recording, layout, x),
        section=allowed_section(recording, layout, x)[0],
        q0=recording.rest_on_nodes @ rest_curvature(layout, x, r),
        alpha0=allowed_clamp(recording, layout, x),
        dead_force=_pushed(recording, layout, x)[..., None] * force[:, None, :] + weight_beyond,
    )
    if recording.ends is not None:
        solved = solve(problem, recording.ends, moved(recording.ends, layout, x, r), start, recording.poses)
    else:
        solved = equilibria(recording, layout, x, problem, start)
    s, _ = tag_places(recording, layout, x, solved)
    ride = tag_ride(recording, layout, x, solved)
    xy = ride.scale * (solved.xy(s) + ride.offset) + layout.get(x, "origin", r)
    if recording.rulers is not None:
        xy = paired(recording.rulers, xy[..., 1] + layout.get(x, "across"))
    pose = np.concatenate([xy, (ride.angle + layout.get(x, "turn"))[..., None]], axis=-1)
    for (i, c), zero in zip(zeroed_coordinates(recording.observations), layout.get(x, "zero", r), strict=True):
        pose[:, i, c] -= zero
    return Prediction(recording, layout, x, solved, pose + allowed(recording, layout, x, "poses"), force, own)


def _slopes(now: Prediction) -> Slopes:
    recording, layout, x, r, solved = now.recording, now.layout, now.x, now.recording.number, now.solved
    bent, axes = _bent(now), log_axes(layout, x, r)
    logged = now.force - now.own - allowed(recording, layout, x, "force")
    pushes = {name: pushed_by(bent.beyond, f) for name, f in push_forces(logged, axes, recording.rate).items()}
    columns = response_columns(balance_changes(bent) | pushes | allowance_changes(recording, bent))
    nodes, has_memory = solved.q.shape[1], remembers(recording, layout, x)
    each_node = of_rest_curvature(solved.problem, np.eye(nodes) if has_memory else np.zeros((nodes, 0)))
    both, by_end = _responses_at_once(now, columns.changes + each_node)
    response, by_node = np.split(both, [len(columns.changes.clamp)], axis=-1)
    s, ride = tag_places(recording, layout, x, solved)[0], tag_ride(recording, layout, x, solved)
    if recording.ends is None and "length" in columns.slices:
        response[:, :, :2, columns.slices["length"]] += solved.xy(s)[..., None]
    carried = ride.carry(response)
    free, error = free_columns(layout, r), layout.columns("force", r)
    out = np.zeros((*now.pose.shape, len(layout.known_to(r)) if error is None else error.start))
    slopes = Slopes(out, columns.split(carried)["push"], axes, recording.error_weights)
    if has_memory:
        memory = remembered_poses(recording, layout, x, solved, columns, by_node)
        carried = carried + ride.carry(memory.by_parameters)
        if error is not None:
            out = np.concatenate([out, ride.carry(memory.by_pushes)], axis=-1)
            slopes = replace(slopes, j=out, added=ride.carry(memory.by_push), keys=memory.keys)
    blocks = columns.split(carried)
    blocks = blocks | {"rest change": blocks["curvature"]} | clamp_blocks(recording, blocks["clamp"])
    put_blocks(slopes.j, free, blocks)
    put_tags(slopes.j, free, _tag_motion(now, ride, s))
    if recording.ends is not None:
        held = replace(ride, angle=ride.angle[recording.ends.frames])
        put_ends(slopes.j, recording.ends, layout, r, held.carry(by_end))
    if "zero" in free:
        for n, (i, c) in enumerate(zeroed_coordinates(recording.observations)):
            slopes.j[:, i, c, free["zero"].start + n] = -1.0
    return slopes


def _responses_at_once(now: Prediction, changes: Perturbations) -> tuple[Array, Array]:
    """(F, m, 3, P) of the beam's places under the tags to changes, and (H, m, 3, 3) to the held ends."""
    recording, solved = now.recording, now.solved
    s, _ = tag_places(recording, now.layout, now.x, solved)
    if recording.ends is None:
        return respond(solved, changes).poses(s), np.zeros((0, s.shape[-1], 3, 3))
    wrench = of_force(solved.problem, np.ones(1)) + of_moment(solved.problem, np.ones(1))
    return with_ends_held(respond(solved, changes + wrench).poses(np.append(s, 1.0)), recording.ends)


def _tag_motion(now: Prediction, ride: TagRide, s: Array) -> TagMotion:
    """How the tags at places `s` (S,) move with what holds them; a metre along is one of the length as written."""
    recording, layout, x, solved = now.recording, now.layout, now.x, now.solved
    seen = now.pose - allowed(recording, layout, x, "poses")
    xy = (seen[..., :2] - layout.get(x, "origin", recording.number)) / ride.scale
    written, on_beam = recording.observations.length, ride.over <= 0.0
    if ride.ruler:
        return ride.motion(xy, ride.over)
    bend = np.where(on_beam, apply(solved.problem.grid.value_at(s), solved.q) / written, 0.0)
    if not recording.allowances:
        return ride.motion(xy, bend)
    tangent = np.stack([np.cos(ride.angle), np.sin(ride.angle)], axis=-1)
    return ride.motion(xy, bend, np.where(on_beam[:, None], solved.xy_by_s(s) / written, tangent))


def _bent(now: Prediction) -> BentBeam:
    """What the parameters change in the balance of the fitted shapes."""
    recording, layout, x, solved = now.recording, now.layout, now.x, now.solved
    on_nodes, by_mass, weight_by_k = recording.on_nodes, None, None
    if recording.mass is not None:
        k = solved.problem.k
        by_mass = recording.mass.by_mass(recording.problem, k)
        weight_by_k = recording.mass.by_stiffness(recording.problem, k, on_nodes, layout.get(x, "mass"))
    return BentBeam(
        solved,
        on_nodes,
        recording.rest_on_nodes,
        now.force,
        _pushed(recording, layout, x),
        recording.farther,
        by_mass,
        weight_by_k,
        log_k_functions(recording),
        relaxation_derivatives(recording, layout, x, solved),
        lengthens="length" in free_columns(layout, recording.number),
        thickens=allowed_section(recording, layout, x)[1],
    )


def tag_places(recording: FitData, layout: Layout, x: Array, solved: Equilibrium) -> tuple[Array, Array]:
    """Where the tags sit: (m,) s on the beam, and (m,) m beyond its tip, where one sits there; (F, m) each of what is
    under rulers."""
    if recording.rulers is not None:
        origin, along = layout.get(x, "origin", recording.number), layout.get(x, "along")
        return ruler_places(solved, np.nan_to_num(recording.rulers) + along - origin[0])
    length = recording.observations.length
    s = recording.observations.marker_s + layout.get(x, "along") / length
    return np.clip(s, 0.0, 1.0), length * (s - np.clip(s, 0.0, 1.0))


def tag_ride(recording: FitData, layout: Layout, x: Array, solved: Equilibrium) -> TagRide:
    """The tags on fitted shapes."""
    s, over = tag_places(recording, layout, x, solved)
    scale = 1.0 + float(layout.get(x, "scale", recording.number)[0])
    if recording.rulers is not None:
        return TagRide(solved.angle(s), over, np.zeros(over.shape[1]), scale, ruler=True)
    return TagRide(solved.angle(s), over, layout.get(x, "across"), scale)


def _pushed(recording: FitData, layout: Layout, x: Array) -> Array:
    """(F, Q) share of the push that acts beyond the node."""
    place = layout.get(x, "place", recording.number) + allowed(recording, layout, x, "place")  # (1,) or (F,) m
    return np.asarray(recording.beyond + place[:, None] * recording.farther)


# How far off a learned beam's prediction of another push is likely to be.
#
# The noise of the force is only a part of it. k(s) is known to its band. The other push acts where somebody says that
# it does, to a tolerance, slides from there as any tool may, and its log's axes stand as written, to another: the fit
# takes all of that as unknown in each push. To first order each moves the tags by its derivative. The scale of the
# force counts for nothing where one sensor logged both pushes: k(s) is off by as much as the force.

_FRAMES = 100  # that are looked at


def few_frames(frames: BoolArray) -> BoolArray:
    """(T,) of these frames at most as many as are looked at, evenly chosen."""
    used = np.flatnonzero(frames)
    chosen = np.zeros_like(frames)
    chosen[used[np.linspace(0, len(used) - 1, min(len(used), _FRAMES)).astype(int)]] = True
    return chosen


def variances(
    solved: Equilibrium, observations: Observations, frames: BoolArray, stiffness: UncertainStiffness
) -> dict[str, Array]:
    """(m,) m^2 each, mean over the frames of the squared distance by which the tags are likely to be off:
    by the band of log k(s), by the place of the push and by the direction of its force.

    `solved`: the beam in these `frames` (T,). Loads that hang on marks act where and as they are said to.
    """
    s, problem, stands = observations.marker_s, solved.problem, solved.converged[:, None]
    functions = problem.k[..., None] * stiffness.basis(problem.grid.nodes)
    by_k = respond(solved, of_stiffness(solved, functions)).xy(s)  # (T, m, 2, p)
    out = {"stiffness": np.sum((by_k @ stiffness.covariance) * by_k, axis=(2, 3))}
    if not observations.static:
        at, force, stated = push_places(observations)[frames], observations.force[frames], observations.stated
        angle = solved.angle(at[:, None])[:, 0]
        _, across = along_and_across(force, angle)
        turned = np.stack([-force[:, 1], force[:, 0]], axis=1)
        by_moment = respond(solved, of_moment(problem, at)).xy(s)[..., 0]
        by_force = respond(solved, of_force(problem, at)).xy(s)
        turn = apply(problem.grid.integral_to(at[:, None]), solved.q - problem.q0)[:, 0]  # of the beam, since rest
        away = stated.place_sd**2 + (SLIDE_SD * turn) ** 2  # (T,) m^2
        out["place"] = np.sum((by_moment * across[:, None, None]) ** 2, axis=-1) * away[:, None]
        out["direction"] = np.sum(np.einsum("tmcd,td->tmc", by_force, turned) ** 2, axis=-1) * stated.direction_sd**2
    return {name: np.mean(one, axis=0, where=stands) for name, one in out.items()}
