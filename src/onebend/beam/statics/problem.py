"""What is solved: the arrays of a batch of beams under loads, on a grid with an edge at every load and every jump.

With the sum N(s) of all forces and the sum m(s) of all point moments beyond s known at the nodes, nothing else of the
loads enters the statics of dead loads; see `nodal_forces.py` and `equilibrium.py` for what is made of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from onebend.beam.grid import Grid, apply, make_grid
from onebend.beam.loads import Loads
from onebend.beam.profiles.rectangular import RectangularSection
from onebend.beam.profiles.stiffness import Profile
from onebend.errors import MechanicsError
from onebend.records import Array, BoolArray, IntArray, PointMass


class Rod(Protocol):
    """What mechanics needs to know of a beam; `model.Beam` is one."""

    @property
    def length(self) -> float: ...
    @property
    def stiffness(self) -> Profile: ...
    @property
    def rest_curvature(self) -> Profile: ...
    @property
    def clamp_angle(self) -> float: ...
    @property
    def mass_per_length(self) -> Profile: ...
    @property
    def section(self) -> RectangularSection | None: ...
    @property
    def masses(self) -> tuple[PointMass, ...]: ...


def has_mass(rod: Rod) -> bool:
    """Whether it has a mass of its own: without, gravity does nothing and nothing swings."""
    return bool(np.any(np.asarray(rod.mass_per_length(np.linspace(0.0, 1.0, 11))) > 0.0))


def refuse_section(rod: Rod, who: str) -> None:
    """Raises `MechanicsError` where a beam has a thickness and `who` does not know stretch and shear."""
    if rod.section is not None:
        raise MechanicsError(f"{who} takes beams that neither stretch nor shear: give the beam without its thickness")


@dataclass(frozen=True)
class Resolution:
    """How finely a beam is resolved: `order` Gauss nodes a panel, no panel wider than `widest`."""

    order: int = 16
    widest: float = 1.0

    def finer(self) -> Resolution:
        """Panels half as wide."""
        return replace(self, widest=0.5 * self.widest)


@dataclass(frozen=True)
class Problem:
    """Arrays of one batch of equilibria: T frames, Q nodes. What differs from beam to beam leads with T.

    A beam stretches and shears by its `section`, whose 1/EA and 1/kGA follow k, or by given arrays `stretch` and
    `shear`. Without any of them, or with zeros, it does neither.
    """

    grid: Grid
    weights: Array  # (Q,) or (T, Q)
    to_nodes: Array  # (Q, Q) or (T, Q, Q): B
    length: Array  # () or (T, 1) m
    k: Array  # (Q,) or (T, Q) N m
    q0: Array  # (Q,) or (T, Q) rad
    alpha0: Array  # () or (T, 1) rad
    dead_force: Array  # (T, Q, 2) N: all dead forces beyond the node
    moment: Array  # (T, Q) N m: all point moments beyond the node
    follower: Array  # (T, c, 2) N, in the tangent's frame
    follower_beyond: Array  # (T, c, Q): 1 where the follower acts beyond the node
    follower_rows: Array  # (T, c, Q): angle at the follower's place
    section: RectangularSection | None = None
    stretch: Array | None = None  # (Q,) or (T, Q) 1/N: 1/EA, where there is no section
    shear: Array | None = None  # (Q,) or (T, Q) 1/N: 1/kGA, where there is no section

    @property
    def size(self) -> int:
        """T."""
        return int(self.dead_force.shape[0])

    @cached_property
    def dead_pull(self) -> tuple[Array, Array]:
        """(T, Q) N m each: the dead force beyond the nodes times L w, its components x and y."""
        lw = self.length * self.weights
        return lw * self.dead_force[..., 0], lw * self.dead_force[..., 1]

    @cached_property
    def compliance(self) -> tuple[Array, Array] | None:
        """(Q,) or (T, Q) 1/N each: 1/EA and 1/kGA; None for a beam that neither stretches nor shears."""
        if self.section is not None:
            if self.stretch is not None or self.shear is not None:
                raise MechanicsError("1/EA and 1/kGA follow from the section: give it or them, not both")
            return self.section.compliance(self.k, self.weights, self.length)
        given = [np.zeros(1) if x is None else x for x in (self.stretch, self.shear)]
        if not all(np.all(x >= 0.0) for x in given):
            raise MechanicsError("1/EA and 1/kGA must be 0 or more")
        return (given[0], given[1]) if any(np.any(x) for x in given) else None

    @cached_property
    def strain_lever(self) -> Array | None:
        """(Q,) or (T, Q) 1/(N m): delta / (L w) of `nodal_forces.py`, or None where `compliance` is."""
        if self.compliance is None:
            return None
        stretch, shear = self.compliance
        return np.asarray((stretch - shear) / (self.length * self.weights))

    def under(self, dead_force: Array, q0: Array, alpha0: Array) -> Problem:
        """The same beams under these dead forces (T, Q, 2) N alone, with this rest curvature and clamp angle; what
        follows from the beams by themselves is not worked out again."""
        size, nodes = dead_force.shape[:2]
        none = np.zeros((size, 0, nodes))
        out = replace(
            self,
            q0=q0,
            alpha0=alpha0,
            dead_force=dead_force,
            moment=np.zeros((size, nodes)),
            follower=none[..., :2],
            follower_beyond=none,
            follower_rows=none,
        )
        of_beam = (self.compliance, self.strain_lever)
        out.__dict__.update(zip(("compliance", "strain_lever"), of_beam, strict=True))
        return out

    def strained(self, share: Array) -> Problem:
        """With 1/EA and 1/kGA times `share` (T,): 0 is the beam that neither stretches nor shears."""
        if self.compliance is None:
            return self
        stretch, shear = (share[:, None] * compliance for compliance in self.compliance)
        return replace(self, section=None, stretch=stretch, shear=shear)

    def loaded(self, factor: Array) -> Problem:
        """With all loads times `factor` (T,)."""
        f = factor[:, None]
        return replace(
            self,
            dead_force=f[..., None] * self.dead_force,
            moment=f * self.moment,
            follower=f[..., None] * self.follower,
        )

    def take(self, chosen: IntArray | BoolArray) -> Problem:
        """Some frames of the batch."""

        def pick(x: Array, plain: int) -> Array:
            return x[chosen] if x.ndim > plain else x

        return Problem(
            grid=self.grid if self.grid.edges.ndim == 1 else Grid(self.grid.edges[chosen], self.grid.order),
            weights=pick(self.weights, 1),
            to_nodes=pick(self.to_nodes, 2),
            length=pick(self.length, 0),
            k=pick(self.k, 1),
            q0=pick(self.q0, 1),
            alpha0=pick(self.alpha0, 0),
            dead_force=self.dead_force[chosen],
            moment=self.moment[chosen],
            follower=self.follower[chosen],
            follower_beyond=self.follower_beyond[chosen],
            follower_rows=self.follower_rows[chosen],
            section=self.section if self.section is None else _picked_section(self.section, chosen),
            stretch=self.stretch if self.stretch is None else pick(self.stretch, 1),
            shear=self.shear if self.shear is None else pick(self.shear, 1),
        )


def make_problem(beam: Rod, loads: Loads, resolution: Resolution = Resolution()) -> Problem:
    """The arrays of a beam under loads. Raises `MechanicsError` where k(s) is not positive at every node."""
    return make_problems([beam], loads, resolution)


def make_problems(beams: Sequence[Rod], loads: Loads, resolution: Resolution = Resolution()) -> Problem:
    """The arrays of several beams, one a frame (or one for all frames), on one grid.

    Raises:
        MechanicsError: k(s) is not positive at a node; as many beams as frames are needed, or one.
    """
    size = max(loads.size, len(beams))
    if len(beams) not in (1, size):
        raise MechanicsError(f"{len(beams)} beams do not fit loads for {size} frames")
    loads = loads.spread(size)
    jumps = tuple(j for b in beams for p in (b.stiffness, b.rest_curvature, b.mass_per_length) for j in p.jumps)
    jumps += tuple(one.s for b in beams for one in b.masses)
    grid = _grid_for(loads.places, tuple(sorted(set(jumps))), resolution)
    nodes, weights, to_nodes = grid.nodes, grid.weights, grid.integral_to_nodes
    shared = len(beams) == 1
    k = _stack([np.asarray(b.stiffness(nodes), dtype=float) for b in beams])
    _check_positive(k, nodes)
    length = np.asarray(beams[0].length) if shared else np.array([[b.length] for b in beams])
    alpha0 = np.asarray(beams[0].clamp_angle) if shared else np.array([[b.clamp_angle] for b in beams])
    dead = np.einsum("tac,taq->tqc", loads.force, _beyond(nodes, loads.force_s))
    if np.any(loads.gravity != 0.0):
        line = length * _stack([np.asarray(b.mass_per_length(nodes)) for b in beams])
        mass_beyond = np.sum(weights * line, axis=-1)[..., None] - apply(to_nodes, line)
        mass_beyond = mass_beyond + _stack([_riding_beyond(nodes, b) for b in beams])
        dead = dead + mass_beyond[..., None] * loads.gravity[:, None, :]
    rows = grid.integral_to(loads.follower_s if loads.follower_s.size else np.zeros((size, 0)))
    return Problem(
        grid=grid,
        weights=weights,
        to_nodes=to_nodes,
        length=length,
        k=k,
        q0=_stack([np.asarray(b.rest_curvature(nodes), dtype=float) for b in beams]),
        alpha0=alpha0,
        dead_force=dead,
        moment=np.einsum("tb,tbq->tq", loads.moment, _beyond(nodes, loads.moment_s)),
        follower=loads.follower,
        follower_beyond=_beyond(nodes, loads.follower_s),
        follower_rows=rows,
        section=_common_section(beams),
    )


def _picked_section(section: RectangularSection, chosen: IntArray | BoolArray) -> RectangularSection:
    """That of some frames of the batch."""
    h = section.thickness
    return section if np.ndim(h) == 0 else replace(section, thickness=np.asarray(h)[chosen])


def _common_section(beams: Sequence[Rod]) -> RectangularSection | None:
    """One section for the batch, of thickness (T, 1) where several beams differ in it."""
    first, *others = (beam.section for beam in beams)
    if first is None or not others or all(other == first for other in others):
        if any(other is not None for other in others) and first is None:
            raise MechanicsError("some beams of the batch have a thickness, others none: solve them apart")
        return first
    if any(o is None or (o.poisson, o.varies) != (first.poisson, first.varies) for o in others):
        raise MechanicsError("beams of one batch share Poisson's ratio and what varies; solve the others apart")
    return replace(first, thickness=np.array([[o.thickness] for o in (first, *others) if o is not None]))


def _beyond(nodes: Array, places: Array) -> Array:
    """(T, a, Q) 1 where a place lies beyond a node."""
    return np.asarray(nodes[..., None, :] < places[..., :, None], dtype=float)


def _riding_beyond(nodes: Array, rod: Rod) -> Array:
    """(..., Q) kg, of the masses that ride on a beam beyond each node."""
    out = np.zeros(nodes.shape)
    for one in rod.masses:
        out += one.mass * (nodes < one.s)
    return out


def _stack(values: list[Array]) -> Array:
    """One beam's values as they are, several with a leading axis."""
    return values[0] if len(values) == 1 else np.stack(values)


def _check_positive(k: Array, nodes: Array) -> None:
    if not np.all(k > 0.0):
        bad = np.flatnonzero(~(k > 0.0))[0]
        where = np.broadcast_to(nodes, k.shape).flat[bad]
        raise MechanicsError(
            f"k(s) is not positive: {k.flat[bad]:.3g} N m at s = {where:.3f}; such a beam has no stable equilibrium"
        )


def _grid_for(places: Array, jumps: tuple[float, ...], resolution: Resolution) -> Grid:
    """One grid for the batch where all frames have their loads at the same places, else one a frame."""
    if places.shape[1] == 0 or np.all(places == places[:1]):
        fixed = tuple(float(p) for p in places[0])
        return make_grid((*fixed, *jumps), order=resolution.order, widest=resolution.widest)
    common = make_grid(jumps, order=resolution.order, widest=resolution.widest).edges
    inside = np.clip(places, 1e-6, 1.0 - 1e-6)
    edges = np.sort(np.concatenate([np.broadcast_to(common, (places.shape[0], len(common))), inside], axis=1), axis=1)
    # Equal edges are pulled apart by an invisible amount so that every frame has the same number of panels.
    step = 1e-7 * np.arange(edges.shape[1])
    edges = np.maximum.accumulate(edges - step, axis=1) + step
    edges = (edges - edges[:, :1]) / (edges[:, -1:] - edges[:, :1])
    edges[:, -1] = 1.0
    return Grid(edges, resolution.order)
