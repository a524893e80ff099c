"""What stays the same while one beam is filmed live: its parameters, the settings, and grids for the places of the
push."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from onebend.beam.grid import Grid, make_grid
from onebend.beam.profiles.rectangular import RectangularSection
from onebend.beam.statics.problem import Problem
from onebend.learning.allowances.causal import OF_COURSE, causal_allowances, course_scale
from onebend.learning.allowances.chosen import AllowanceName
from onebend.learning.allowances.patches import patch_functions, patch_means
from onebend.learning.allowances.section import section_at
from onebend.learning.model.fit_data import MASS_MODES, REST_MODES
from onebend.learning.model.parameters import Block, Layout, Priors
from onebend.learning.model.spline import Spline
from onebend.learning.model.tag_jacobian import free_columns
from onebend.records import CLAMP_SD, CURVATURE_SD, DIRECTION_SD, PLACE_SD, SCALE_SD, TURN_SD, Array

ORDER, WIDEST = 12, 0.5
MOST_PANELS = 4  # two before the push, and two behind one that is near the clamp
_GRIDS = 50  # over the length; a push between two places acts along the tangent from the nearer one


@dataclass(frozen=True)
class LiveSession:
    """The beam, its tags and its parameters."""

    length: float  # m
    marker_s: Array  # (m,)
    mass: float  # kg
    layout: Layout
    thickness: float = math.nan  # m, of the section in the plane of bending; NaN: not known
    tag_size: float = math.nan  # m, side of a tag's black square; NaN: not known

    @cached_property
    def carried(self) -> frozenset[str]:
        """Names of all blocks of parameters that are not frozen."""
        return frozenset(self.columns)

    def carries(self, name: str) -> bool:
        """Whether an allowance is among the parameters."""
        return name in self.carried

    def section(self, x: Array) -> tuple[RectangularSection | None, float]:
        """By which the beam stretches and shears at parameters x, None where it does neither; and how the log of its
        thickness goes with its parameter."""
        if not self.carries("section"):
            return None, 1.0
        return section_at(float(self.layout.get(x, "section")[0]), self.thickness, self.length)

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Columns of all parameters that are not frozen."""
        return free_columns(self.layout)

    @property
    def weighs(self) -> bool:
        """Whether the mass is among the parameters."""
        return self.mass > 0.0 and self.layout.index["mass", -1].start >= 0

    def prior_scale(self, largest: float, bend: float) -> Array:
        """(n - p,) factors on the prior sds of all parameters but log k's coefficients; see `course_scale`."""
        p = self.layout.spline.count
        out = np.ones(self.layout.size - p)
        for name in OF_COURSE:
            where = self.columns.get(name)
            if where is not None:
                count = where.stop - where.start
                out[where.start - p : where.stop - p] = course_scale(name, count, largest, bend)
        return out

    @cached_property
    def patches_on_finer(self) -> Array:
        """(f, n) coefficients, of the finer spline, of the functions of log k under the tags; n = 0 without them."""
        fine = self.layout.spline.finer
        if not self.carries("patches"):
            return np.zeros((fine.count, 0))
        return fine.nearest(lambda s: patch_functions(self.marker_s, self.length, self.tag_size, s))


@dataclass(frozen=True)
class SmootherSettings:
    """Settings of the smoother; see `OnlineSettings`."""

    key_frames: int
    renewed: int  # key frames linearised anew with every frame
    zero: float  # N, sd of the log's zero
    least_zero: float  # N
    load: float | None  # N, error expected to come with the load; None: a share of the largest force
    roughness: float  # of log k, first value
    steps: float  # of log k, first value
    memory_doubt: float  # of the log of the force error's memory
    adapt: bool
    bulk: float  # sd: tags that fit worse get less weight
    gate: float  # sd: tags farther from where they are expected are left out
    patience: int  # frames
    step: float  # of log k: the most that one update changes it


@dataclass(frozen=True)
class PointBeam:
    """The beam at parameters x, on the grid of a push: all that no frame changes."""

    x: Array
    problem: Problem  # under no load
    stiff: Array  # (Q,) k times the nodes' weights
    axes: Array  # (2, 2) by which the logged force is turned
    columns: dict[str, slice]  # where the groups of `material_changes` stand in the functions
    elastic: Array  # (Q, P) N m, see `joined_functions`
    compliant: Array  # (Q, P)


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
    kept: list[PointBeam] = field(default_factory=list)  # the last one

    def places(self, s: Array) -> tuple[Array, Array]:
        """(m, Q) each, for places `s` (m,): integrals up to them, and values there."""
        return _rows_at(self.push_s, s.tobytes())


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
    terms: Array  # (B, TERMS) of the allowances, see `CourseSoFar`
    memory: Memory


def session_layout(
    spline: Spline,
    marker_s: Array,
    priors: Priors,
    *,
    length: float,
    placement_sd: float,
    rest_unknown: bool,
    calibrated: bool,
    mass: float,
    allowances: frozenset[AllowanceName] = frozenset(),
    thickness: float = math.nan,
    tag_size: float = math.nan,
) -> Layout:
    """The parameters of one beam under one camera; the force's error is a process and not among them. Allowances that
    are not wanted are frozen."""
    placement = placement_sd if priors.placement is None else priors.placement
    origin = placement_sd if priors.origin is None else priors.origin
    mounted = TURN_SD if priors.mounting is None else priors.mounting
    pushed = PLACE_SD if priors.place is None else priors.place
    turned = DIRECTION_SD if priors.direction is None else priors.direction
    clamped = CLAMP_SD if priors.clamp is None else priors.clamp
    bent = CURVATURE_SD if priors.curvature is None else priors.curvature
    scaled = SCALE_SD if priors.scale is None else priors.scale
    numbers = range(1, len(marker_s) + 1)
    every = causal_allowances(marker_s, length, tag_size, thick=bool(np.isfinite(thickness)))
    wanted: list[tuple[str, str, float | Array, tuple[str, ...]]] = [
        ("stiffness", "log(N m)", 1.0, tuple(f"c{i}" for i in range(spline.count))),
        ("curvature", "rad", bent if rest_unknown else 0.0, ("q0 mean", "q0 slope", "q0 bow")),
        ("mass", "1", priors.mass if mass > 0.0 else 0.0, ("mass", "mass slope", "mass bow", "mass third")),
        ("along", "m", placement, tuple(f"tag {i} along" for i in numbers)),
        ("across", "m", placement, tuple(f"tag {i} across" for i in numbers)),
        ("turn", "rad", mounted, tuple(f"tag {i} turn" for i in numbers)),
        ("clamp", "rad", clamped, ("clamp angle",)),
        ("origin", "m", origin, ("origin x", "origin y")),
        ("scale", "1", 0.0 if calibrated else scaled, ("camera scale",)),
        ("clock", "s", priors.clock or 0.0, ("clock offset",)),
        ("place", "m", pushed, ("push place",)),
        ("direction", "rad", turned, ("force axes",)),
        *((a.name, a.unit, a.prior_sd * (a.name in allowances), a.labels) for a in every),
    ]
    blocks, start = [], 0
    for name, unit, sd, labels in wanted:
        sds = np.full(len(labels), sd)
        free = bool(np.all(sds > 0.0))
        if name == "mass":
            sds[1:] = priors.mass_spread
        blocks.append(Block(name, -1, unit, sds, labels, start if free else -1))
        start += len(labels) if free else 0
    return Layout(spline, tuple(blocks), start, {(b.name, -1): b for b in blocks})


@lru_cache(maxsize=_GRIDS)
def _grid_at(push_s: float) -> Grid:
    return make_grid((0.5 * push_s, push_s), order=ORDER, widest=WIDEST)


@lru_cache(maxsize=4 * _GRIDS)
def _rows_at(push_s: float, places: bytes) -> tuple[Array, Array]:
    """See `PushGrid.places`."""
    grid, s = _grid_at(push_s), np.frombuffer(places)
    return grid.integral_to(s), grid.value_at(s)


def nearest_grid_place(push_s: float) -> float:
    """The place nearest to a push at which there is a grid."""
    return max(round(push_s * _GRIDS), 1) / _GRIDS


def grid_places() -> list[float]:
    """All places at which there is a grid."""
    return [i / _GRIDS for i in range(1, _GRIDS + 1)]


def push_grid_at(session: LiveSession, push_s: float) -> PushGrid:
    """The grid for a push at `push_s`."""
    grid = _grid_at(push_s)
    nodes, to_nodes, weights = grid.nodes, grid.integral_to_nodes, grid.weights
    parts = MASS_MODES.curvature(nodes)
    beyond = nodes < push_s
    last = np.arange(len(nodes)) == int(np.sum(beyond)) - 1
    under_tags = patch_means(session.marker_s, session.length, session.tag_size, grid)
    return PushGrid(
        push_s=push_s,
        grid=grid,
        to_nodes=to_nodes,
        squares=(to_nodes[:, :, None] * to_nodes[:, None, :]).reshape(len(nodes), -1),
        weights=weights,
        beyond=np.asarray(beyond, dtype=float),
        farther=np.asarray(last / (session.length * weights)),
        mass_beyond=session.mass * (weights @ parts - to_nodes @ parts),
        log_k=np.column_stack([session.layout.spline.basis(nodes), under_tags]),
        rest_on_nodes=REST_MODES.curvature(nodes),
    )
