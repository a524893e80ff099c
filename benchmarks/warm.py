"""Warm equilibria for control loops: time of one solve on a walk of pushes, and its error.

The tip of a 150 mm beam is pushed about so that it moves 0.1 to 1 mm from one call to the next, as in a loop at 1 kHz.
Each solve is timed by itself, the collector of Python and the other programs of the machine running as they like;
`processor's time alone` leaves out the waits for other programs.
`floor`: the counted operations of the same iterations at 4 Gflop/s, one core without vector units; what lies between
are some forty calls of the array library at about 1 us each.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.stiffness import Gaussians, equidistant
from onebend.beam.warm import WarmBeam
from onebend.blas import one_blas_thread
from onebend.records import Array, BoolArray

STEPS = 5000
CHECKED = 50  # every so many steps against the search from rest
BEAM = Beam(0.15, Gaussians(equidistant(3), 0.5, (0.02, 0.03, 0.015)))
MARKERS = np.array([1.0 / 3.0, 2.0 / 3.0, 1.0])
HOME = np.array([0.03, 0.15])  # N, about which the push walks
REACH = 0.15  # N
FLOPS_PER_S = 4e9

Row = tuple[str, float, str, str]


@dataclass(frozen=True)
class Walk:
    """One run along a path of forces."""

    seconds: Array  # (N,) of each solve, by the clock
    busy: Array  # (N,) s of each solve, by the processor's time for this thread
    iterations: Array  # (N,)
    lost: BoolArray  # (N,) whether the shape had to be found from rest
    tip: Array  # (N, 2) m
    markers: Array  # (N, S, 2) m


def path(steps: int = STEPS) -> Array:
    """(N, 2) N: a walk whose steps, in random directions, move the tip by 0.1 to 1 mm; far out, steps lead home."""
    rng = np.random.default_rng(0)
    beam, force, out = WarmBeam(BEAM), HOME, np.empty((steps, 2))
    for i in range(steps):
        beam.solve(force)
        turn = rng.uniform(-np.pi, np.pi)
        direction = np.array([np.cos(turn), np.sin(turn)])
        away = force - HOME
        if np.linalg.norm(away) > REACH and direction @ away > 0.0:
            direction = -direction
        per_newton = np.linalg.norm(beam.response().xy[-1] @ direction)
        # A beam hardly yields along itself: such a step is kept short in force instead.
        force = force + direction * min(rng.uniform(1e-4, 1e-3) / per_newton, 0.1 * REACH)
        out[i] = force
    return out


def run(forces: Array, order: int) -> Walk:
    """Time every solve along the path."""
    beam = WarmBeam(BEAM, markers=MARKERS.tolist(), resolution=Resolution(order))
    beam.solve(HOME)
    seconds, busy, found = np.empty(len(forces)), np.empty(len(forces)), []
    for i, force in enumerate(forces):
        began, began_busy = time.perf_counter(), time.thread_time()
        shape = beam.solve(force)
        seconds[i], busy[i] = time.perf_counter() - began, time.thread_time() - began_busy
        found.append(shape)
    markers = np.array([shape.xy for shape in found])
    return Walk(
        seconds,
        busy,
        np.array([shape.iterations for shape in found]),
        np.array([shape.route == "rest" for shape in found]),
        markers[:, -1],
        markers,
    )


def response_seconds(calls: int = 1000) -> float:
    """Median time of all derivatives of three markers with respect to one force."""
    beam = WarmBeam(BEAM)
    beam.solve(HOME)
    seconds = np.empty(calls)
    for i in range(calls):
        began = time.perf_counter()
        beam.response()
        seconds[i] = time.perf_counter() - began
    return float(np.median(seconds))


def flops(order: int, iterations: float) -> float:
    """Operations of a warm solve: predictor and Newton iterations, a sine or cosine counted as 30."""
    products = order**3 + 7 * order**2  # B^T D B (half of it), B^T z, B dq, D B, two triangular solves
    iteration = products + order**3 / 3 + (2 * 30 + 13) * order  # and Cholesky, and what is done node by node
    return iterations * iteration + 6 * order**2 + 13 * order


@one_blas_thread
def rows() -> list[Row]:
    """(name, value, unit, target) of all figures."""
    forces = path()
    fine = equilibrium(BEAM, push(forces[::CHECKED]), resolution=Resolution(32)).xy(MARKERS)
    out: list[Row] = []
    for order in (12, 16):
        walk = run(forces, order)
        same = equilibrium(BEAM, push(forces[::CHECKED]), resolution=Resolution(order)).xy(MARKERS)
        median, late, last = 1e6 * np.percentile(walk.seconds, [50, 99, 100])
        label, some = f"{order} nodes: ", walk.markers[::CHECKED]
        mean = float(np.mean(walk.iterations))
        out += [
            (label + f"one solve, median of {len(forces)}", float(median), "us", "<= 60"),
            (label + "one solve, 99 %", float(late), "us", "<= 300"),
            (label + "one solve, slowest", float(last), "us", ""),
            (label + "one solve, 99 %, processor's time alone", 1e6 * float(np.percentile(walk.busy, 99)), "us", ""),
            (label + "Newton iterations, mean", mean, "", ""),
            (label + "Newton iterations, most", float(np.max(walk.iterations)), "", ""),
            (label + "solves that needed the search from rest", float(np.sum(walk.lost)), "", ""),
            (label + "from the search from rest, same nodes", error(some, same), "L", "<= 1e-9"),
            (label + "error, against 32 nodes", error(some, fine), "L", "<= 1e-7"),
            (label + "operations of an iteration", 1e-3 * (flops(order, 1) - flops(order, 0)), "kflop", ""),
            (label + "floor of one solve", 1e6 * flops(order, mean) / FLOPS_PER_S, "us", ""),
        ]
    moved = 1e3 * np.linalg.norm(np.diff(walk.tip, axis=0), axis=1)
    for share in (5, 50, 95):
        out.append((f"tip's move a step, {share} %", float(np.percentile(moved, share)), "mm", "0.1 to 1"))
    out.append(("all derivatives of three markers, 16 nodes", 1e6 * response_seconds(), "us", ""))
    return out


def error(found: Array, exact: Array) -> float:
    """Largest distance of a marker from where it should be, over L."""
    return float(np.max(np.linalg.norm(found - exact, axis=-1)) / BEAM.length)


def main() -> None:
    print("| what | measured | asked |\n| --- | --- | --- |")
    for name, value, unit, target in rows():
        print(f"| {name} | {value:.3g} {unit} | {target} |")


if __name__ == "__main__":
    main()
