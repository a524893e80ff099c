"""Arrays of a batch of beams under loads, on a grid with an edge at every load and every jump.

Dead loads enter the statics only by the sums N(s) of forces and m(s) of moments beyond s.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, TypeVar, cast

import numpy as np

from onebend.beam.grid import Grid, apply, make_grid, transposed
from onebend.beam.loads import Loads
from onebend.beam.stiffness import Profile, RectangularSection, common_section, knots_of
from onebend.errors import MechanicsError
from onebend.records import Array, BoolArray, IntArray, PointMass

_Made = TypeVar("_Made")
_REMEMBERED, _MADE = 8, 24  # cached grids per beam; cached arrays of other modules
RESOLVED = 3e-10  # relative error of the turns due to curvature; positions are more accurate
NARROW = 1.0 / 32.0  # narrowest panel to halve
AS_ROUGH = 3.0  # factor on the error of the beam's own curvatures, for those that loads cause
_MOST_KNOTS = 60  # most knots that get an edge
_BETWEEN_KNOTS = ((4, 1.0), (6, 1.0), (8, 1.0), (10, 1.0), (12, 1.0), (16, 1.0), (16, 0.5))  # nodes, share of widest
_MOMENT_ORDER, _ROUGH_ORDER = 16, 8  # orders of a moment's polynomials
_FEWEST_NODES = 2.0  # nodes per unknown from which on the basis is worthwhile
_SAME_TIP = 1e-11  # relative motion of the tip under refinement
_MOMENTS = np.arange(3)[:, None]  # turn and motion of the tip, and one more: two might agree by chance


@dataclass(frozen=True)
class NodalBeam:
    """One beam at the Q nodes of one grid, without loads."""

    grid: Grid
    nodes: Array  # (Q,)
    weights: Array  # (Q,)
    to_nodes: Array  # (Q, Q): B
    k: Array  # (Q,) N m
    q0: Array  # (Q,) rad
    mass_beyond: Array  # (Q,) kg, with point masses
    places: tuple[float, ...]  # of all loads

    @cached_property
    def basis(self) -> MomentBasis | None:
        """For loads at `places`; None where it saves few unknowns."""
        if len(self.nodes) < _FEWEST_NODES * len(make_grid(self.places, order=_MOMENT_ORDER).nodes):
            return None
        return self._moments(_MOMENT_ORDER)

    @cached_property
    def rough(self) -> MomentBasis:
        """Fewer unknowns, to start `moment_basis.settle`."""
        return self._moments(_ROUGH_ORDER)

    def _moments(self, order: int) -> MomentBasis:
        coarse = make_grid(self.places, order=order)
        columns = coarse.value_at(self.nodes) / self.k[:, None]
        if np.any(self.q0 != 0.0):
            columns = np.column_stack([columns, self.q0])
        root = np.sqrt(self.weights * self.k)
        modes = np.linalg.qr(root[:, None] * columns)[0] / root[:, None]
        return MomentBasis(modes, self.to_nodes @ modes, (root**2 * self.q0) @ modes)


@dataclass(frozen=True)
class MomentBasis:
    """n curvatures, orthonormal in the bending energy, of moments that are polynomials between loads."""

    modes: Array  # (Q, n): R
    turned: Array  # (Q, n): B R, the angles
    rest: Array  # (n,): q0 in the basis (exact)


@dataclass
class GridMemory:
    """Arrays cached with a beam, for the grids used last."""

    beams: dict[Hashable, NodalBeam] = field(default_factory=dict)
    made: dict[Hashable, Any] = field(default_factory=dict)  # of other modules

    def nodal(self, key: Hashable, make: Callable[[], NodalBeam]) -> NodalBeam:
        return _kept(self.beams, key, make, _REMEMBERED)

    def once(self, key: Hashable, make: Callable[[], _Made]) -> _Made:
        return cast(_Made, _kept(self.made, key, make, _MADE))


def _kept(where: dict[Hashable, _Made], key: Hashable, make: Callable[[], _Made], most: int) -> _Made:
    found = where.get(key)
    if found is None:
        found = make()
        for oldest in list(where)[: 1 - most]:
            where.pop(oldest, None)
        where[key] = found
    return found


def riding_beyond(nodes: Array, masses: tuple[PointMass, ...]) -> Array:
    """(..., Q) kg of point masses beyond each node."""
    out = np.zeros(nodes.shape)
    for one in masses:
        out += one.mass * (nodes < one.s)
    return out


def _mass_beyond(beam: Rod, grid: Grid) -> Array:
    """(..., Q) kg beyond each node, with point masses."""
    line = beam.length * np.asarray(beam.mass_per_length(grid.nodes), dtype=float)
    own = np.sum(grid.weights * line, axis=-1)[..., None] - apply(grid.integral_to_nodes, line)
    return np.asarray(own + riding_beyond(grid.nodes, beam.masses))


def share_farther(problem: Problem, push_s: Array) -> Array:
    """(F, Q) 1/m: a force d metres beyond `push_s` along the tangent adds d times this to its share beyond each node.

    It lengthens the lever `L sum w u` by d u at the last node before it, which also holds beyond the tip.
    """
    nodes, weights = np.broadcast_arrays(problem.grid.nodes, problem.weights)
    last = np.broadcast_to(nodes < push_s[:, None], (len(push_s), nodes.shape[-1])).sum(axis=1) - 1
    nodes_of = np.arange(nodes.shape[-1]) == last[:, None]
    return np.asarray(nodes_of / (problem.length * weights))


def first_resolution(beam: Rod, loads: Loads) -> tuple[Resolution, float]:
    """The coarsest grid that resolves q0 and (1 - s) / k, the curvature under a small tip force, and its relative error
    of the angles.

    It has an edge at the knots where that suffices. Where halving panels does not resolve both, it is the first grid
    whose tip agrees with the one before. Cached with the beam.
    """
    places = loads.places
    common = tuple(float(place) for place in places[0]) if are_common(places) else ()
    return beam.memory.once((first_resolution, common), lambda: _first_resolution(beam, common))


def _first_resolution(beam: Rod, common: tuple[float, ...]) -> tuple[Resolution, float]:
    edges, knots, order = (*common, *_jumps([beam])), _knots([beam]), Resolution().order
    if 0 < len(knots) <= _MOST_KNOTS and _own(beam, make_grid(edges, order=order))[0] > RESOLVED:
        between = _widest((*edges, *knots))
        for fewer, share in _BETWEEN_KNOTS:
            missed, _ = _own(beam, make_grid((*edges, *knots), order=fewer, widest=share * between))
            if AS_ROUGH * missed < RESOLVED:
                return Resolution(fewer, share * between, True), missed
    tips, widest = np.full((2, 3), np.nan), 2.0 * _widest(edges)
    while widest > NARROW:
        before, widest = tips, 0.5 * widest
        missed, tips = _own(beam, make_grid(edges, order=order, widest=widest))
        same = np.all(np.abs(tips - before) <= _SAME_TIP * np.array([[tips[0, 0]], [1.0]]))
        if missed < RESOLVED or same:
            break
    return Resolution(order, widest), missed


def _widest(edges: tuple[float, ...]) -> float:
    return float(np.max(np.diff(make_grid(edges).edges)))


def missed_by_angles(grid: Grid, q: Array) -> Array:
    """(...) relative error of the angles at the nodes for curvatures q (..., Q).

    The last Legendre coefficient of a panel of width h turns the beam by up to h / (2 order + 1) times itself.
    """
    return grid.legendre_tail(q) * float(np.max(np.diff(grid.edges))) / (2 * grid.order + 1)


def _own(beam: Rod, grid: Grid) -> tuple[float, Array]:
    """For (1 - s) / k and q0: relative error of angles; (2, 3) turn and motion of the tip."""
    arm = 1.0 - grid.nodes
    k = np.asarray(beam.stiffness(grid.nodes), dtype=float)
    check_positive(k, grid.nodes)
    bent = np.stack([arm / k, np.asarray(beam.rest_curvature(grid.nodes), dtype=float)])
    return float(np.max(missed_by_angles(grid, bent))), bent @ (grid.weights * arm**_MOMENTS).T


def check_positive(k: Array, nodes: Array) -> None:
    """Raises `MechanicsError` unless k (..., Q) is positive."""
    if not np.all(k > 0.0):
        bad = np.flatnonzero(~(k > 0.0))[0]
        where = np.broadcast_to(nodes, k.shape).flat[bad]
        raise MechanicsError(
            f"k(s) is not positive: {k.flat[bad]:.3g} N m at s = {where:.3f}; such a beam has no stable equilibrium"
        )


def loads_at_nodes(nodes: Array, loads: Loads, mass_beyond: Array) -> dict[str, Array]:
    """Entries of a `Problem` for the loads of T frames; `mass_beyond` (Q,) or (T, Q) kg."""
    dead = transposed(_beyond(nodes, loads.force_s)) @ loads.force
    if np.any(loads.gravity != 0.0):
        dead = dead + mass_beyond[..., None] * loads.gravity[:, None, :]
    return {"dead_force": dead, "moment": np.einsum("tb,tbq->tq", loads.moment, _beyond(nodes, loads.moment_s))}


def _beyond(nodes: Array, places: Array) -> Array:
    """(T, a, Q) 1 where a place lies beyond a node."""
    return np.asarray(nodes[..., None, :] < places[..., :, None], dtype=float)


def are_common(places: Array) -> bool:
    """Whether loads have the same places in all frames."""
    return len(places) == 1 or places.shape[1] == 0 or bool(np.all(places == places[:1]))


def grid_for(places: Array, jumps: tuple[float, ...], order: int, widest: float) -> Grid:
    """One grid if all frames have the same places, else one per frame."""
    if are_common(places):
        fixed = tuple(float(p) for p in places[0])
        return make_grid((*fixed, *jumps), order=order, widest=widest)
    common = make_grid(jumps, order=order, widest=widest).edges
    inside = np.clip(places, 1e-6, 1.0 - 1e-6)
    edges = np.sort(np.concatenate([np.broadcast_to(common, (places.shape[0], len(common))), inside], axis=1), axis=1)
    # Equal edges are separated minimally, so that every frame has the same number of panels.
    step = 1e-7 * np.arange(edges.shape[1])
    edges = np.maximum.accumulate(edges - step, axis=1) + step
    edges = (edges - edges[:, :1]) / (edges[:, -1:] - edges[:, :1])
    edges[:, -1] = 1.0
    return Grid(edges, order)


class Rod(Protocol):
    """The interface of a beam for mechanics; `model.Beam` is one."""

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
    def memory(self) -> GridMemory: ...
    @property
    def masses(self) -> tuple[PointMass, ...]: ...


def has_mass(rod: Rod) -> bool:
    """Without a mass of its own gravity does nothing and nothing swings."""
    return bool(np.any(np.asarray(rod.mass_per_length(np.linspace(0.0, 1.0, 11))) > 0.0))


def refuse_section(rod: Rod, who: str) -> None:
    """Raises `MechanicsError` for a beam with a thickness, which `who` does not support."""
    if rod.section is not None:
        raise MechanicsError(f"{who} takes beams that neither stretch nor shear: give the beam without its thickness")


@dataclass(frozen=True)
class Resolution:
    """`order` Gauss nodes per panel, no panel wider than `widest`."""

    order: int = 16
    widest: float = 1.0
    at_knots: bool = False  # also an edge where a derivative of k(s) or q0(s) jumps

    def finer(self) -> Resolution:
        return replace(self, widest=0.5 * self.widest)


@dataclass(frozen=True)
class Problem:
    """One batch of equilibria: T frames, Q nodes. Arrays that differ between beams lead with T.

    Stretch and shear come from `section` (1/EA and 1/kGA follow k) or from the arrays `stretch` and `shear`; without
    them, or with zeros, there is none.
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
    section: RectangularSection | None = None
    stretch: Array | None = None  # (Q,) or (T, Q) 1/N: 1/EA without a section
    shear: Array | None = None  # (Q,) or (T, Q) 1/N: 1/kGA without a section
    modes: Array | None = None  # (Q, n): if given, unknowns, q0 and columns of B are of these curvatures

    @property
    def size(self) -> int:
        """T."""
        return int(self.dead_force.shape[0])

    @cached_property
    def dead_pull(self) -> tuple[Array, Array]:
        """(T, Q) N m each: x and y of L w times the dead force beyond the nodes."""
        lw = self.length * self.weights
        return lw * self.dead_force[..., 0], lw * self.dead_force[..., 1]

    @cached_property
    def stiff(self) -> Array:
        """(Q,) or (T, Q) N m: w k; (n,) 1 for modes."""
        return self.weights * self.k if self.modes is None else np.ones(self.modes.shape[-1])

    @property
    def unbend(self) -> Array:
        """(Q,) or (T, Q) 1 / sqrt(w k): scales curvatures to a bending energy of half their sum of squares."""
        return np.asarray(1.0 / np.sqrt(self.weights * self.k))

    @cached_property
    def couple(self) -> Array:
        """(T, Q) or (T, n) N m: w times the point moments beyond the nodes."""
        out = self.weights * self.moment
        return out if self.modes is None else out @ self.modes

    @cached_property
    def compliance(self) -> tuple[Array, Array] | None:
        """(Q,) or (T, Q) 1/N each: 1/EA and 1/kGA; None without stretch and shear."""
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
        """(Q,) or (T, Q) 1/(N m): delta / (L w); None where `compliance` is."""
        if self.compliance is None:
            return None
        stretch, shear = self.compliance
        return np.asarray((stretch - shear) / (self.length * self.weights))

    def strained(self, share: Array) -> Problem:
        """With 1/EA and 1/kGA times `share` (T,)."""
        if self.compliance is None:
            return self
        stretch, shear = (share[:, None] * compliance for compliance in self.compliance)
        return replace(self, section=None, stretch=stretch, shear=shear)

    def loaded(self, factor: Array) -> Problem:
        """With all loads times `factor` (T,)."""
        f = factor[:, None]
        return replace(self, dead_force=f[..., None] * self.dead_force, moment=f * self.moment)

    def take(self, chosen: IntArray | BoolArray) -> Problem:
        """Some of the frames."""
        values = ((name, plain, getattr(self, name)) for name, plain in _PLAIN.items())
        picked: dict[str, Any] = {name: x[chosen] for name, plain, x in values if x is not None and x.ndim > plain}
        if self.grid.edges.ndim > 1:
            picked["grid"] = Grid(self.grid.edges[chosen], self.grid.order)
        return replace(self, section=None if self.section is None else self.section.take(chosen), **picked)


# Axes of the arrays of a `Problem` that are the same in all frames.
_PLAIN = {
    **dict.fromkeys(("length", "alpha0", "dead_force", "moment"), 0),
    **dict.fromkeys(("weights", "k", "q0", "stretch", "shear"), 1),
    "to_nodes": 2,
}


def remembered(beam: Rod, loads: Loads, resolution: Resolution) -> NodalBeam | None:
    """The beam at the nodes, cached; None where places differ between frames.

    Raises `MechanicsError`: k(s) is not positive at every node.
    """
    if not are_common(loads.places):
        return None
    places = tuple(float(place) for place in loads.places[0])

    def make() -> NodalBeam:
        grid = grid_for(loads.places, _edges([beam], resolution), resolution.order, resolution.widest)
        nodes, weights, to_nodes = grid.nodes, grid.weights, grid.integral_to_nodes
        k = np.asarray(beam.stiffness(nodes), dtype=float)
        check_positive(k, nodes)
        q0 = np.asarray(beam.rest_curvature(nodes), dtype=float)
        loaded = (*places, *(one.s for one in beam.masses))
        return NodalBeam(grid, nodes, weights, to_nodes, k, q0, _mass_beyond(beam, grid), loaded)

    return beam.memory.nodal((*places, resolution), make)


def make_problem(beam: Rod, loads: Loads, resolution: Resolution = Resolution()) -> Problem:
    """One beam under loads.

    Raises `MechanicsError`: k(s) is not positive at every node.
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
        **loads_at_nodes(nodal.nodes, loads, nodal.mass_beyond),
    )


def make_problems(beams: Sequence[Rod], loads: Loads, resolution: Resolution = Resolution()) -> Problem:
    """Several beams, one per frame (or one for all), on one grid.

    Raises `MechanicsError`: k(s) is not positive at a node, or the number of beams is neither 1 nor that of frames.
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
    heavy = bool(np.any(loads.gravity != 0.0))
    mass_beyond = _stack([_mass_beyond(b, grid) for b in beams]) if heavy else np.zeros(nodes.shape)
    return Problem(
        grid=grid,
        weights=weights,
        to_nodes=to_nodes,
        length=length,
        k=k,
        q0=_stack([np.asarray(b.rest_curvature(nodes), dtype=float) for b in beams]),
        alpha0=alpha0,
        section=common_section([beam.section for beam in beams]),
        **loads_at_nodes(nodes, loads, mass_beyond),
    )


def _knots(beams: Sequence[Rod]) -> tuple[float, ...]:
    """Where a derivative of any profile jumps."""
    return tuple(sorted({j for b in beams for p in (b.stiffness, b.rest_curvature) for j in knots_of(p)}))


def _edges(beams: Sequence[Rod], resolution: Resolution) -> tuple[float, ...]:
    return (*_jumps(beams), *_knots(beams)) if resolution.at_knots else _jumps(beams)


def _jumps(beams: Sequence[Rod]) -> tuple[float, ...]:
    """Where any profile jumps, and places of point masses."""
    jumps = {j for b in beams for p in (b.stiffness, b.rest_curvature, b.mass_per_length) for j in p.jumps}
    return tuple(sorted(jumps.union(one.s for b in beams for one in b.masses)))


def _stack(values: list[Array]) -> Array:
    return values[0] if len(values) == 1 else np.stack(values)
