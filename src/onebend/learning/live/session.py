"""What stays the same while one beam is filmed live: its parameters, the settings, and grids for the places of the
push."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from onebend.beam.grid import Grid, make_grid
from onebend.learning.model.fit_data import MASS_MODES, REST_MODES
from onebend.learning.model.parameters import Block, Layout, Priors
from onebend.learning.model.spline import Spline
from onebend.learning.model.tag_jacobian import free_columns
from onebend.records import CLAMP_SD, CURVATURE_SD, DIRECTION_SD, PLACE_SD, SCALE_SD, TURN_SD, Array

ORDER, WIDEST = 12, 0.5
_GRIDS = 50  # over the length; a push between two places acts along the tangent from the nearer one


@dataclass(frozen=True)
class LiveSession:
    """The beam, its tags and its parameters."""

    length: float  # m
    marker_s: Array  # (m,)
    mass: float  # kg
    layout: Layout

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Columns of all parameters that are not frozen."""
        return free_columns(self.layout)

    @property
    def weighs(self) -> bool:
        """Whether the mass is among the parameters."""
        return self.mass > 0.0 and self.layout.index["mass", -1].start >= 0


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
    on_nodes: Array  # (Q, p)
    rest_on_nodes: Array  # (Q, 3)
    steps: Array  # (m, Q) m: integrals up to the markers, times the length
    reach: Array  # (2 m, Q): integrals up to the markers; 1/m, turn of the beam there per metre along it


def session_layout(
    spline: Spline, tags: int, priors: Priors, *, placement_sd: float, rest_unknown: bool, calibrated: bool, mass: float
) -> Layout:
    """The parameters of one beam under one camera; the force's error is a process and not among them."""
    placement = placement_sd if priors.placement is None else priors.placement
    origin = placement_sd if priors.origin is None else priors.origin
    mounted = TURN_SD if priors.mounting is None else priors.mounting
    pushed = PLACE_SD if priors.place is None else priors.place
    turned = DIRECTION_SD if priors.direction is None else priors.direction
    clamped = CLAMP_SD if priors.clamp is None else priors.clamp
    bent = CURVATURE_SD if priors.curvature is None else priors.curvature
    scaled = SCALE_SD if priors.scale is None else priors.scale
    numbers = range(1, tags + 1)
    wanted: list[tuple[str, str, float, tuple[str, ...]]] = [
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
    ]
    blocks, start = [], 0
    for name, unit, sd, labels in wanted:
        sds = np.full(len(labels), sd)
        if name == "mass":
            sds[1:] = priors.mass_spread
        blocks.append(Block(name, -1, unit, sds, labels, start if sd > 0.0 else -1))
        start += len(labels) if sd > 0.0 else 0
    return Layout(spline, tuple(blocks), start, {(b.name, -1): b for b in blocks})


def nearest_grid_place(push_s: float) -> float:
    """The place nearest to a push at which there is a grid."""
    return max(round(push_s * _GRIDS), 1) / _GRIDS


def grid_places() -> list[float]:
    """All places at which there is a grid."""
    return [i / _GRIDS for i in range(1, _GRIDS + 1)]


def push_grid_at(session: LiveSession, push_s: float) -> PushGrid:
    """The grid for a push at `push_s`."""
    grid = make_grid((0.5 * push_s, push_s), order=ORDER, widest=WIDEST)
    nodes, to_nodes, weights = grid.nodes, grid.integral_to_nodes, grid.weights
    parts, rows = MASS_MODES.curvature(nodes), grid.integral_to(session.marker_s)
    beyond = nodes < push_s
    last = np.arange(len(nodes)) == int(np.sum(beyond)) - 1
    return PushGrid(
        push_s=push_s,
        grid=grid,
        to_nodes=to_nodes,
        squares=(to_nodes[:, :, None] * to_nodes[:, None, :]).reshape(len(nodes), -1),
        weights=weights,
        beyond=np.asarray(beyond, dtype=float),
        farther=np.asarray(last / (session.length * weights)),
        mass_beyond=session.mass * (weights @ parts - to_nodes @ parts),
        on_nodes=session.layout.spline.basis(nodes),
        rest_on_nodes=REST_MODES.curvature(nodes),
        steps=session.length * rows,
        reach=np.concatenate([rows, grid.value_at(session.marker_s) / session.length]),
    )
