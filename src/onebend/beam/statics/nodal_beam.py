"""What a beam is at the nodes of a grid: all of a problem that its loads do not change, remembered by the beam."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np

from onebend.beam.grid import Grid, make_grid, transposed
from onebend.beam.loads import Loads
from onebend.beam.profiles.stiffness import Profile
from onebend.errors import MechanicsError
from onebend.records import Array, PointMass

_Made = TypeVar("_Made")
_REMEMBERED, _MADE = 8, 24  # grids a beam, and what others made
RESOLVED = 3e-10  # share of a curvature that angles may miss; positions miss less
NARROW = 1.0 / 32.0  # panels that are not halved again
AS_ROUGH = 3.0  # times what angles miss of the beam's own curvatures: what a load may make of it
_MOST_KNOTS = 60  # that get an edge each
_BETWEEN_KNOTS = ((4, 1.0), (6, 1.0), (8, 1.0), (10, 1.0), (12, 1.0), (16, 1.0), (16, 0.5))  # nodes, share of widest
_MOMENT_ORDER, _ROUGH_ORDER = 16, 8  # of a moment's polynomials
_FEWEST_NODES = 2.0  # for each node of a moment, for which the basis is worth its while
_SAME_TIP = 1e-11  # share of its way by which a finer grid moves the tip
_MOMENTS = np.arange(3)[:, None]  # turn of the tip, its way, and one more: two might agree by chance


@dataclass(frozen=True)
class NodalBeam:
    """One beam at the Q nodes of one grid."""

    grid: Grid
    nodes: Array  # (Q,)
    weights: Array  # (Q,)
    to_nodes: Array  # (Q, Q): B
    k: Array  # (Q,) N m
    q0: Array  # (Q,) rad
    mass_beyond: Array  # (Q,) kg, with what rides on the beam
    places: tuple[float, ...]  # of all loads

    @cached_property
    def basis(self) -> MomentBasis | None:
        """For loads at `places`; None where it has not much fewer unknowns than there are nodes."""
        if len(self.nodes) < _FEWEST_NODES * len(make_grid(self.places, order=_MOMENT_ORDER).nodes):
            return None
        return self._moments(_MOMENT_ORDER)

    @cached_property
    def rough(self) -> MomentBasis:
        """The same in few unknowns, for shapes from which `moment_basis.settle` goes on."""
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
    """n curvatures that are orthonormal in the bending energy, of moments that are polynomials between loads."""

    modes: Array  # (Q, n): R
    turned: Array  # (Q, n): B R, the angles
    rest: Array  # (n,): q0 in the basis, which holds it exactly


@dataclass(frozen=True)
class FirstGrid:
    """The coarsest grid that carries the beam's own curvatures: at rest, and under the least of forces at its tip."""

    order: int
    widest: float
    at_knots: bool  # an edge also where a derivative of k(s) or q0(s) jumps
    missed: float  # share of those curvatures by which angles are off


@dataclass
class GridMemory:
    """What a beam remembers from one call to the next: its arrays on the last few grids, and what calls begin with."""

    beams: dict[Hashable, NodalBeam] = field(default_factory=dict)
    made: dict[Hashable, Any] = field(default_factory=dict)  # whatever else calls want again

    def keep(self, key: Hashable, beam: NodalBeam) -> None:
        """Remember one more, and forget the oldest where there are many."""
        for oldest in list(self.beams)[: 1 - _REMEMBERED]:
            self.beams.pop(oldest, None)
        self.beams[key] = beam

    def once(self, key: Hashable, make: Callable[[], _Made]) -> _Made:
        """What `make` gives for the key, made once; the oldest is forgotten where there are many."""
        found = self.made.get(key)
        if found is None:
            for oldest in list(self.made)[: 1 - _MADE]:
                self.made.pop(oldest, None)
            found = self.made[key] = make()
        return cast(_Made, found)


def nodal_beam(
    length: float,
    stiffness: Profile,
    rest_curvature: Profile,
    mass: Profile,
    riding: tuple[PointMass, ...],
    grid: Grid,
    places: tuple[float, ...],
) -> NodalBeam:
    """Arrays for loads at `places`. Raises `MechanicsError` where k(s) is not positive at every node."""
    nodes, weights, to_nodes = grid.nodes, grid.weights, grid.integral_to_nodes
    k = np.asarray(stiffness(nodes), dtype=float)
    check_positive(k, nodes)
    line = length * np.asarray(mass(nodes), dtype=float)
    q0 = np.asarray(rest_curvature(nodes), dtype=float)
    mass_beyond = np.sum(weights * line) - to_nodes @ line + riding_beyond(nodes, riding)
    loaded = (*places, *(one.s for one in riding))
    return NodalBeam(grid, nodes, weights, to_nodes, k, q0, mass_beyond, loaded)


def riding_beyond(nodes: Array, masses: tuple[PointMass, ...]) -> Array:
    """(..., Q) kg, of the masses that ride on a beam beyond each node."""
    out = np.zeros(nodes.shape)
    for one in masses:
        out += one.mass * (nodes < one.s)
    return out


def first_grid(
    stiffness: Profile, rest_curvature: Profile, edges: tuple[float, ...], knots: tuple[float, ...], order: int
) -> FirstGrid:
    """A grid on which q0 and (1 - s) / k are resolved, with an edge at `edges`, and at the `knots` if need be.

    Where neither that nor halving the panels resolves them, the first that turns and moves the tip as the one before.
    The beam bends by (1 - s) / k under a small force across its tip: what k(s) asks of the grid, without a solve.
    """
    if 0 < len(knots) <= _MOST_KNOTS and _own(stiffness, rest_curvature, make_grid(edges, order=order))[0] > RESOLVED:
        between = _widest((*edges, *knots))
        for fewer, share in _BETWEEN_KNOTS:
            grid = make_grid((*edges, *knots), order=fewer, widest=share * between)
            missed, _ = _own(stiffness, rest_curvature, grid)
            if AS_ROUGH * missed < RESOLVED:
                return FirstGrid(fewer, share * between, True, missed)
    tips, widest = np.full((2, 3), np.nan), 2.0 * _widest(edges)
    while widest > NARROW:
        before, widest = tips, 0.5 * widest
        missed, tips = _own(stiffness, rest_curvature, make_grid(edges, order=order, widest=widest))
        same = np.all(np.abs(tips - before) <= _SAME_TIP * np.array([[tips[0, 0]], [1.0]]))
        if missed < RESOLVED or same:
            break
    return FirstGrid(order, widest, False, missed)


def _widest(edges: tuple[float, ...]) -> float:
    """Of the panels between edges."""
    return float(np.max(np.diff(make_grid(edges).edges)))


def missed_by_angles(grid: Grid, q: Array) -> Array:
    """(...) share of curvatures q (..., Q) by which their angles at the nodes may be off.

    The last Legendre coefficient of a panel of width h turns the beam by up to h / (2 order + 1) of it.
    """
    return grid.legendre_tail(q) * float(np.max(np.diff(grid.edges))) / (2 * grid.order + 1)


def _own(stiffness: Profile, rest_curvature: Profile, grid: Grid) -> tuple[float, Array]:
    """Of (1 - s) / k and q0: the share that angles miss; (2, 3) turn and way of the tip by them."""
    arm = 1.0 - grid.nodes
    k = np.asarray(stiffness(grid.nodes), dtype=float)
    check_positive(k, grid.nodes)
    bent = np.stack([arm / k, np.asarray(rest_curvature(grid.nodes), dtype=float)])
    return float(np.max(missed_by_angles(grid, bent))), bent @ (grid.weights * arm**_MOMENTS).T


def check_positive(k: Array, nodes: Array) -> None:
    """Raises `MechanicsError` where k (..., Q) is not positive."""
    if not np.all(k > 0.0):
        bad = np.flatnonzero(~(k > 0.0))[0]
        where = np.broadcast_to(nodes, k.shape).flat[bad]
        raise MechanicsError(
            f"k(s) is not positive: {k.flat[bad]:.3g} N m at s = {where:.3f}; such a beam has no stable equilibrium"
        )


def loads_at_nodes(grid: Grid, nodes: Array, loads: Loads, mass_beyond: Array) -> dict[str, Array]:
    """The entries of a `Problem` for the loads of T frames; `mass_beyond` (Q,) or (T, Q) kg weighs where gravity is."""
    size, frames = loads.size, nodes.shape[-1]
    dead = transposed(_beyond(nodes, loads.force_s)) @ loads.force
    if np.any(loads.gravity != 0.0):
        dead = dead + mass_beyond[..., None] * loads.gravity[:, None, :]
    moment = np.zeros((size, frames))
    if loads.moment.shape[1]:
        moment = np.einsum("tb,tbq->tq", loads.moment, _beyond(nodes, loads.moment_s))
    follows = loads.follower.shape[1] > 0
    return {
        "dead_force": dead,
        "moment": moment,
        "follower": loads.follower,
        "follower_beyond": _beyond(nodes, loads.follower_s) if follows else np.zeros((size, 0, frames)),
        "follower_rows": grid.integral_to(loads.follower_s) if follows else np.zeros((size, 0, frames)),
    }


def _beyond(nodes: Array, places: Array) -> Array:
    """(T, a, Q) 1 where a place lies beyond a node."""
    return np.asarray(nodes[..., None, :] < places[..., :, None], dtype=float)


def are_common(places: Array) -> bool:
    """Whether all frames have their loads at the same places."""
    return len(places) == 1 or places.shape[1] == 0 or bool(np.all(places == places[:1]))


def grid_for(places: Array, jumps: tuple[float, ...], order: int, widest: float) -> Grid:
    """One grid for the batch where all frames have their loads at the same places, else one a frame."""
    if are_common(places):
        fixed = tuple(float(p) for p in places[0])
        return make_grid((*fixed, *jumps), order=order, widest=widest)
    common = make_grid(jumps, order=order, widest=widest).edges
    inside = np.clip(places, 1e-6, 1.0 - 1e-6)
    edges = np.sort(np.concatenate([np.broadcast_to(common, (places.shape[0], len(common))), inside], axis=1), axis=1)
    # Equal edges are pulled apart by an invisible amount so that every frame has the same number of panels.
    step = 1e-7 * np.arange(edges.shape[1])
    edges = np.maximum.accumulate(edges - step, axis=1) + step
    edges = (edges - edges[:, :1]) / (edges[:, -1:] - edges[:, :1])
    edges[:, -1] = 1.0
    return Grid(edges, order)
