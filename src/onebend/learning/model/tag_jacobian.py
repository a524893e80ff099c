"""Derivatives of the tags' poses with the parameters: one order of columns, used by all who need them.

The way from a parameter to a tag has three parts, and each stands here once.

1. Parameters that bend the beam come in groups. `balance_changes` says how each group enters the balance of moments;
   the order of its entries is the order of the columns (`ResponseColumns`). A further group is one more entry there.
2. A tag rides on the beam: `TagRide` takes the motion of the beam's places to the tags in the picture, and `TagMotion`
   says how tags move with their own places, the origin and the camera's scale while the shape stays as it is.
3. `put_blocks` and `put_tags` write all of it to the columns that a layout gives to each block of parameters. A group
   and a block of the layout that have one name belong together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from onebend.beam.grid import paired
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.perturbation import Perturbation, Perturbations
from onebend.beam.statics.problem import Problem
from onebend.beam.statics.sensitivity import (
    of_clamp_angle,
    of_moment,
    of_rest_curvature,
    of_section_thickness,
    of_stiffness,
    respond,
)
from onebend.learning.model.parameters import Layout
from onebend.learning.model.readings import steepness
from onebend.records import Array


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
