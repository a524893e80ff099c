"""What takes longer than a frame, in a process of its own: the map of the reachable set, the hand's edge, the ellipse.

The functions here run there. A beam goes over as plain data, and is kept until another one comes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.beam.statics.problem import Resolution
from onebend.control.reach.drag import HeldEnd
from onebend.control.reach.loaded_beam import LoadedState, PushedBeam
from onebend.control.reach.reach import Reach, ReachSettings
from onebend.control.reach.reach_map import ReachMap, reach_map
from onebend.control.reach.uncertainty import predicted_error
from onebend.errors import ControlError
from onebend.records import Array

DRAWS = 200  # beams from the band, for the ellipse of a point that rests
BEGIN_TURN = 0.35  # rad, about, by which the tip is turned to begin with
LARGEST_TIMES = 2.0  # times `bending_force`: what a force is bounded by where nobody says it


def bending_force(beam: Beam) -> float:
    """N, across the tip: would turn it by about a radian if the turn grew in proportion."""
    s = np.linspace(0.0, 1.0, 201)
    return 1.0 / (float(np.mean((1.0 - s) ** 2 / np.asarray(beam.stiffness(s)))) * beam.length)


@lru_cache(maxsize=4)
def pushed_beam(beam: str, push_s: float, point_s: float) -> PushedBeam:
    """The beam that this JSON describes, pushed."""
    return PushedBeam(Beam.from_dict(json.loads(beam)), push_s, point_s, resolution=Resolution())


def make_map(beam: str, push_s: float, point_s: float, max_force: float) -> ReachMap:
    """The map of the reachable set."""
    return reach_map(pushed_beam(beam, push_s, point_s), max_force)


def hand_edge(beam: str, q: Array, load: Array, max_force: float) -> list[tuple[list[float], str]]:
    """How far a hand gets from a state without turning, all around."""
    held = HeldEnd(pushed_beam(beam, 1.0, 1.0), LoadedState(q, load), max_force)
    return [(end.tolist(), limit) for end, limit in held.edge()]


def full_ellipse(
    beam: str, uncertain: Mapping[str, Any], push_s: float, point_s: float, q: Array, load: Array
) -> dict[str, Any] | None:
    """The 95 % ellipse by drawn beams; None where too few of them stand."""
    pushed = pushed_beam(beam, push_s, point_s)
    known = UncertainStiffness.from_dict(dict(uncertain))
    return ellipse_of(pushed, known, LoadedState(q, load), DRAWS)


def ellipse_of(
    pushed: PushedBeam, known: UncertainStiffness, state: LoadedState, draws: int = 0
) -> dict[str, Any] | None:
    """Where the point lies with 95 % probability, for the page; to first order without draws."""
    pose = pushed.pose(state.q)
    found = Reach(
        pushed=pushed,
        goal=pose[:2],
        settings=ReachSettings(),
        states=(pushed.start, state),
        reached=pose,
        converged=True,
        reason="reached",
        iterations=0,
        nearest=None,
    )
    try:
        error = predicted_error(pushed.beam, known, found, draws=draws)
    except ControlError:
        return None
    ellipse = error.ellipse()
    if not np.all(np.isfinite(ellipse.semi_axes)):
        return None
    return {
        "outline_m": (error.mean + ellipse.outline(49)).tolist(),
        "semi_axes_m": ellipse.semi_axes.tolist(),
        "draws": draws,
        "lost": error.lost,
    }
