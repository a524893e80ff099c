"""How hard the beam may be pushed: from nothing up to the first limit, at every place and in every direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.statics.continuation import follow
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.problem import make_problem
from onebend.learning.design.identifiability import RESOLUTION, loads_of
from onebend.learning.design.instruments import Instruments, PlannedPush
from onebend.records import Array, BoolArray

_COARSE = np.geomspace(0.02, 40.0, 40)  # forces, in units of what turns a linear beam's loaded place by one radian
_FINE = 12
BUCKLES = "the beam buckles or snaps through"
_MARGIN = 1.15  # of the force: so far beyond the largest the beam must still stand


@dataclass(frozen=True)
class Limits:
    """What the experimenter allows. Angles in radians."""

    force: float | None = None  # N; None: twice the largest so far, no limit before the first push
    tip_turn: float | None = None  # the tip's turn from rest; None: 90 deg, and the curvature limit counts too
    curvature: float = 1.25  # times the largest curvature reached so far
    slant: float = np.deg2rad(75.0)  # between the force and the beam's normal: beyond, the tool slips off


@dataclass(frozen=True)
class LargestPush:
    """The largest force at a place in a direction, or why there is none."""

    at_s: float
    direction: float  # rad
    largest: float  # N
    why_not: str = ""


def same_push(one: PlannedPush, other: PlannedPush) -> bool:
    """Whether two pushes are the same to within what a hand can tell."""
    turn = np.angle(np.exp(1j * (one.direction - other.direction)))
    force = abs(one.largest - other.largest) / max(one.largest, other.largest)
    return bool(abs(one.at_s - other.at_s) < 0.03 and abs(turn) < np.deg2rad(10.0) and force < 0.1)


def largest_pushes(
    beam: Beam, bench: Instruments, at_s: tuple[float, ...], directions: Array, limits: Limits
) -> list[LargestPush]:
    """Every place and direction [rad]."""
    return [reach for s in at_s for reach in _reach_at(beam, bench, s, directions, limits)]


def _reach_at(beam: Beam, bench: Instruments, at_s: float, directions: Array, limits: Limits) -> list[LargestPush]:
    """All directions at one place: a coarse ramp to find the limit, a finer one below it."""
    unit = _softness(beam, at_s)
    rough = [_first_break(beam, bench, at_s, d, unit * _COARSE, limits) for d in directions]
    out = []
    for direction, (safe, over, why) in zip(directions.tolist(), rough, strict=True):
        if why == BUCKLES or safe == 0.0:
            out.append(LargestPush(at_s, direction, 0.0, why))
            continue
        fine, _, _ = _first_break(beam, bench, at_s, direction, np.linspace(safe, over, _FINE), limits)
        largest = min(max(safe, fine), _most_force(bench, limits))
        if not _stands(beam, bench, at_s, direction, _MARGIN * largest):
            out.append(LargestPush(at_s, direction, 0.0, BUCKLES))
            continue
        out.append(LargestPush(at_s, direction, largest))
    return out


def _first_break(
    beam: Beam, bench: Instruments, at_s: float, direction: float, sizes: Array, limits: Limits
) -> tuple[float, float, str]:
    """Largest force within the limits, the next one, and what that one breaks ("" if none does)."""
    unit = np.array([np.cos(direction), np.sin(direction)])
    forces = np.vstack([sizes[:, None] * unit, np.zeros(2)])
    solved = follow(make_problem(beam, loads_of(bench, at_s, forces), RESOLUTION))
    broken = _broken(solved, bench, at_s, direction, limits)
    first = {why: int(np.argmax(rows[:-1])) for why, rows in broken.items() if np.any(rows[:-1])}
    if not first:
        return float(sizes[-1]), float(sizes[-1]), ""
    why = min(first, key=lambda one: first[one])
    at = first[why]
    return (float(sizes[at - 1]) if at else 0.0), float(sizes[at]), why


def _broken(
    solved: Equilibrium, bench: Instruments, at_s: float, direction: float, limits: Limits
) -> dict[str, BoolArray]:
    """Which frames break which limit; the last is the beam at rest."""
    here, tip = solved.angle(np.array([at_s, 1.0])).T
    turn = np.abs(tip - tip[-1])
    side = 1.0 if np.sin(direction - here[-1]) >= 0.0 else -1.0
    slant = np.abs(np.angle(np.exp(1j * (direction - here - side * 0.5 * np.pi))))
    bent = np.max(np.abs(solved.q - solved.problem.q0), axis=1)
    most_turn = 0.5 * np.pi if limits.tip_turn is None else limits.tip_turn
    curved = bent > limits.curvature * bench.curvature if limits.tip_turn is None else np.zeros(len(bent), dtype=bool)
    return {
        BUCKLES: ~solved.stable | ~np.isnan(solved.buckled_at),
        "the force does not press the beam there, the tool slips off": slant > limits.slant,
        "the smallest push bends the beam beyond the limits": (turn > most_turn) | curved,
    }


def _most_force(bench: Instruments, limits: Limits) -> float:
    if limits.force is not None:
        return limits.force
    return 2.0 * max((p.largest for p in bench.pushes), default=np.inf)


def _stands(beam: Beam, bench: Instruments, at_s: float, direction: float, force: float) -> bool:
    unit = np.array([[np.cos(direction), np.sin(direction)]])
    solved = follow(make_problem(beam, loads_of(bench, at_s, force * unit), RESOLUTION))
    return bool(solved.stable[0] and np.isnan(solved.buckled_at[0]))


def _softness(beam: Beam, at_s: float) -> float:
    """N that would turn the loaded place of a linear beam by one radian."""
    s = at_s * (np.arange(200) + 0.5) / 200
    return float(1.0 / (beam.length * np.mean((at_s - s) / beam.stiffness(s)) * at_s))
