"""What is solved: the arrays of a batch of beams under loads, on a grid with an edge at every load and every jump.

With the sum N(s) of all forces and the sum m(s) of all point moments beyond s known at the nodes, nothing else of the
loads enters the statics of dead loads; see `nodal_forces.py` and `equilibrium.py` for what is made of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from onebend.beam.grid import Grid, apply
from onebend.beam.loads import Loads
from onebend.beam.profiles.rectangular import RectangularSection, common_section
from onebend.beam.profiles.stiffness import knots_of
from onebend.beam.statics.nodal_beam import (
    FirstGrid,
    NodalBeam,
    are_common,
    check_positive,
    first_grid,
    grid_for,
    loads_at_nodes,
    nodal_beam,
    riding_beyond,
)
from onebend.beam.statics.rod import Rod
from onebend.errors import MechanicsError
from onebend.records import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Resolution:
    """How finely a beam is resolved: `order` Gauss nodes a panel, no panel wider than `widest`."""

    order: int = 16
    widest: float = 1.0
    at_knots: bool = False  # an edge also where a derivative of k(s) or q0(s) jumps

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
    modes: Array | None = None  # (Q, n): then unknowns, q0 and columns of B are of these curvatures, not of the nodes

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
    def stiff(self) -> Array:
        """(Q,) or (T, Q) N m: w k; (n,) 1 for modes, which are orthonormal in it."""
        return self.weights * self.k if self.modes is None else np.ones(self.modes.shape[-1])

    @cached_property
    def couple(self) -> Array:
        """(T, Q) or (T, n) N m: w times the point moments beyond the nodes, their work for each unknown."""
        out = self.weights * self.moment
        return out if self.modes is None else out @ self.modes

    @cached_property
    def compliance(self) -> tuple[Array, Array] | None:
        """(Q,) or (T, Q) 1/N each: 1/EA and 1/kGA; None for a beam that neither stretches nor shears."""
        if self.section is not None:
            if self.stretch is not None or self.shear is not None:
                raise MechanicsError("1/EA and 1/kGA follow from the section: give it or them, not both")
            return self.section.compliance(self.k, self.weights, self.length)
        if self.stretch is None and self.shear is None:
            return None
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
            section=None if self.section is None else self.section.take(chosen),
            modes=self.modes,
            stretch=self.stretch if self.stretch is None else pick(self.stretch, 1),
            shear=self.shear if self.shear is None else pick(self.shear, 1),
        )


def remembered(beam: Rod, loads: Loads, resolution: Resolution) -> NodalBeam | None:
    """The beam at the nodes for loads at these places, made once; None where places differ from frame to frame."""
    if not are_common(loads.places):
        return None
    places = tuple(float(place) for place in loads.places[0])
    nodal = beam.memory.beams.get((*places, resolution))
    if nodal is None:
        grid = grid_for(loads.places, _edges([beam], resolution), resolution.order, resolution.widest)
        line = (beam.stiffness, beam.rest_curvature, beam.mass_per_length)
        nodal = nodal_beam(beam.length, *line, beam.masses, grid, places)
        beam.memory.keep((*places, resolution), nodal)
    return nodal


def make_problem(beam: Rod, loads: Loads, resolution: Resolution = Resolution()) -> Problem:
    """The arrays of a beam under loads; the beam remembers those that do not depend on the loads.

    Raises:
        MechanicsError: k(s) is not positive at every node.
    """
    loads = loads.spread(loads.size)
    nodal = remembered(beam, loads, resolution)
    if nodal is None:
        return make_problems([beam], loads, resolution)
    return Problem(
        grid=nodal.grid,
        weights=nodal.weights,
        to_nodes=nodal.to_nodes,
        length=np.asarray(beam.length),
        k=nodal.k,
        q0=nodal.q0,
        alpha0=np.asarray(beam.clamp_angle),
        section=beam.section,
        **loads_at_nodes(nodal.grid, nodal.nodes, loads, nodal.mass_beyond),
    )


def make_problems(beams: Sequence[Rod], loads: Loads, resolution: Resolution = Resolution()) -> Problem:
    """The arrays of several beams, one a frame (or one for all frames), on one grid.

    Raises:
        MechanicsError: k(s) is not positive at a node; as many beams as frames are needed, or one.
    """
    size = max(loads.size, len(beams))
    if len(beams) not in (1, size):
        raise MechanicsError(f"{len(beams)} beams do not fit loads for {size} frames")
    loads = loads.spread(size)
    grid = grid_for(loads.places, _edges(beams, resolution), resolution.order, resolution.widest)
    nodes, weights, to_nodes = grid.nodes, grid.weights, grid.integral_to_nodes
    shared = len(beams) == 1
    k = _stack([np.asarray(b.stiffness(nodes), dtype=float) for b in beams])
    check_positive(k, nodes)
    length = np.asarray(beams[0].length) if shared else np.array([[b.length] for b in beams])
    alpha0 = np.asarray(beams[0].clamp_angle) if shared else np.array([[b.clamp_angle] for b in beams])
    mass_beyond = np.zeros(nodes.shape)
    if np.any(loads.gravity != 0.0):
        line = length * _stack([np.asarray(b.mass_per_length(nodes)) for b in beams])
        mass_beyond = np.sum(weights * line, axis=-1)[..., None] - apply(to_nodes, line)
        mass_beyond = mass_beyond + _stack([riding_beyond(nodes, b.masses) for b in beams])
    return Problem(
        grid=grid,
        weights=weights,
        to_nodes=to_nodes,
        length=length,
        k=k,
        q0=_stack([np.asarray(b.rest_curvature(nodes), dtype=float) for b in beams]),
        alpha0=alpha0,
        section=common_section([beam.section for beam in beams]),
        **loads_at_nodes(grid, nodes, loads, mass_beyond),
    )


def first_resolution(beam: Rod, loads: Loads) -> tuple[Resolution, float]:
    """The coarsest that carries the beam's own curvatures, and the share of them by which its angles are off."""
    places = loads.places
    common = tuple(float(place) for place in places[0]) if are_common(places) else ()

    def make() -> FirstGrid:
        edges, knots = (*common, *_jumps([beam])), _knots([beam])
        return first_grid(beam.stiffness, beam.rest_curvature, edges, knots, Resolution().order)

    first = beam.memory.once((FirstGrid, common), make)
    return Resolution(first.order, first.widest, first.at_knots), first.missed


def _knots(beams: Sequence[Rod]) -> tuple[float, ...]:
    """Where a derivative of a profile of any of the beams jumps."""
    return tuple(sorted({j for b in beams for p in (b.stiffness, b.rest_curvature) for j in knots_of(p)}))


def _edges(beams: Sequence[Rod], resolution: Resolution) -> tuple[float, ...]:
    return (*_jumps(beams), *_knots(beams)) if resolution.at_knots else _jumps(beams)


def _jumps(beams: Sequence[Rod]) -> tuple[float, ...]:
    """Where a profile of any of the beams jumps, and where a mass rides."""
    jumps = {j for b in beams for p in (b.stiffness, b.rest_curvature, b.mass_per_length) for j in p.jumps}
    return tuple(sorted(jumps.union(one.s for b in beams for one in b.masses)))


def _stack(values: list[Array]) -> Array:
    return values[0] if len(values) == 1 else np.stack(values)
