"""Shapes and paths: wanted shapes that hands can hold are found again, from rest and without a hint; time of a path.

Wanted are ten points of a shape. Independent shapes come from an initial-value integration with a random wrench at the
clamp; random shapes of a gripper from `hold` at random poses, of pushes from random forces, stable ones alone.
"""

from __future__ import annotations

import time
from collections import Counter

import numpy as np

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import Loads, push
from onebend.beam.model import Beam
from onebend.beam.stiffness import Gaussians, equidistant
from onebend.control.goals import Goals, curve
from onebend.control.path import PathSettings, RateLimits, follow_goals
from onebend.control.shape import Grip, Pusher, ShapeResult, shape
from onebend.records import Array
from tests.beam.boundary import integrate
from tests.beam.held import hold
from tests.control.path.moving_point import point_goals

BEAM = Beam(0.15, Gaussians(equidistant(3), 0.5, (0.02, 0.03, 0.015)))
S = np.linspace(0.1, 1.0, 10)
INDEPENDENT, GRIPPED, ONE_PUSH, TWO_PUSHES = 30, 400, 300, 300
STRONGEST = 4.0  # largest force, in units of mean k over L
FOUND = 1e-6  # of L, rms over the targets: the shape was found again

Hands = tuple[tuple[Pusher, ...], Grip | None]
Row = tuple[str, str]


def independent(seed: int = 0) -> list[Array]:
    """(10, 3) each: shapes by integration from the clamp."""
    rng, out = np.random.default_rng(seed), []
    unit = 0.035 * np.array([1.0 / BEAM.length, 1.0 / BEAM.length, 1.0])
    for _ in range(INDEPENDENT):
        wrench = unit * rng.uniform(-1.0, 1.0, 3) * [2.0, 2.0, 1.0]
        out.append(integrate(BEAM, np.append([0.0, 0.0, 0.0], wrench), places=S)[:3].T)
    return out


def gripped(seed: int = 1) -> Array:
    """(T, 10, 2) m, of the beam held at the end poses of random smooth curves."""
    rng = np.random.default_rng(seed)
    s = (np.arange(400) + 0.5) / 400
    bend = rng.normal(0.0, [[1.2], [1.2], [1.2]], (3, GRIPPED))
    turn = bend[0] * s[:, None] + bend[1] * s[:, None] ** 2 + bend[2] * np.sin(np.pi * s[:, None])
    end = BEAM.length * np.stack([np.mean(np.cos(turn), axis=0), np.mean(np.sin(turn), axis=0)], axis=1)
    held = hold(BEAM, np.column_stack([end, bend[0] + bend[1]]))
    return held.solved.xy(S)[held.solved.stable]


def pushed(places: tuple[float, ...], count: int, seed: int) -> Array:
    """(T, 10, 2) m, under random forces at the places."""
    rng = np.random.default_rng(seed)
    most = STRONGEST * float(np.mean(BEAM.stiffness(np.linspace(0, 1, 101)))) / BEAM.length
    turn, size = rng.uniform(-np.pi, np.pi, (2, count)), most * np.sqrt(rng.uniform(0.0, 1.0, (2, count)))
    force = size[..., None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    solved = equilibrium(BEAM, sum((push(force[i], s) for i, s in enumerate(places)), Loads()))
    return solved.xy(S)[solved.stable]


def why_not(found: ShapeResult) -> str:
    """Why a shape was not found again."""
    if found.limits:
        return f"ended at the edge of {found.limits[0]}"
    return "another local optimum" if found.converged else "the search ended early"


def recovered(name: str, wanted: Array, actuators: Hands) -> Row:
    """How many shapes were found again, and why not the others."""
    reasons: Counter[str] = Counter()
    first, seconds = 0, time.process_time()
    for xy in wanted:
        found = shape(BEAM, curve(S, xy), pushes=actuators[0], grip=actuators[1])
        if found.rms < FOUND * BEAM.length:
            first += found.starts == 1
            reasons["found"] += 1
        else:
            reasons[why_not(found)] += 1
    each = 1e3 * (time.process_time() - seconds) / len(wanted)
    others = "".join(f"; {count} {reason}" for reason, count in reasons.items() if reason != "found")
    return name, f"{reasons['found']} of {len(wanted)} ({first} from rest at once{others}); {each:.0f} ms each"


def exactness() -> list[Row]:
    """Errors of gripped shapes against the independent integration."""
    far, off, count = [], [], 0
    for wanted in independent():
        found = shape(BEAM, curve(S, wanted[:, :2]), grip=Grip())
        if found.rms < FOUND * BEAM.length:
            count += 1
            far.append(np.max(np.linalg.norm(found.xy_error, axis=1)) / BEAM.length)
            off.append(abs(found.pose[2] - wanted[-1, 2]))
    return [
        ("independent shapes: found again", f"{count} of {INDEPENDENT}"),
        ("independent shapes: worst point (asked: 1e-8 L)", f"{max(far):.1e} L"),
        ("independent shapes: worst angle of the gripper", f"{max(off):.1e} rad"),
    ]


def paths() -> list[Row]:
    """Processor's time a sample at 1 kHz."""
    moment = np.linspace(0.0, 3.0, 31)
    turn = 2.0 * np.pi * moment / 3.0
    force = np.stack([0.05 * np.cos(turn), 0.3 + 0.1 * np.sin(turn)], axis=1)
    tip = point_goals(moment, BEAM.equilibrium(force).xy(1.0))
    blank = np.full((7, len(S)), np.nan)
    poses = np.linspace([0.11, 0.06, 1.2], [0.12, 0.03, 0.2], 7)
    held = hold(BEAM, poses).solved.xy(S)
    shapes = Goals(np.linspace(0.0, 3.0, 7), curve(S, held[0]), held, blank)
    out = []
    for name, goals, pushes, grip, limits in (
        ("force for a point", tip, (Pusher(),), None, RateLimits()),
        ("the same, stretched to 0.1 N/s", tip, (Pusher(),), None, RateLimits(force=0.1)),
        ("the same, bound to 0.35 N", tip, (Pusher(1.0, 0.35),), None, RateLimits()),
        ("gripper for a shape of ten points", shapes, (), Grip(), RateLimits()),
    ):
        began = time.process_time()
        way = follow_goals(BEAM, goals, pushes=pushes, grip=grip, settings=PathSettings(limits=limits))
        each = 1e3 * (time.process_time() - began) / len(way.time)
        out.append((f"path at 1 kHz, {name}", f"{each:.2f} ms a sample ({len(way.time)} samples)"))
    return out


def rows() -> list[Row]:
    """All figures."""
    one, two = (Pusher(1.0),), (Pusher(0.5), Pusher(1.0))
    return [
        *exactness(),
        recovered("gripper", gripped(), ((), Grip())),
        recovered("one push, at the tip", pushed((1.0,), ONE_PUSH, 2), (one, None)),
        recovered("two pushes, s = 0.5 and 1", pushed((0.5, 1.0), TWO_PUSHES, 3), (two, None)),
        *paths(),
    ]


def main() -> None:
    print(f"Found again: the ten points to {FOUND:g} L, rms.\n\n| what | measured |\n| --- | --- |")
    for name, value in rows():
        print(f"| {name} | {value} |")


if __name__ == "__main__":
    main()
