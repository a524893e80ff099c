"""The six tasks of the paper's Fig. 8, with beams learned from the development recordings and the true beams."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_bvp
from scipy.interpolate import PchipInterpolator

from benchmarks.truth import RECORDINGS, read_truth
from onebend.control.reach import Reach, reach
from onebend.control.uncertainty import PredictedError, predicted_error
from onebend.pipeline import learn_recording
from onebend.records import Array

BEAMS = ("linear", "quadratic", "cubic")
LEVEL = 0.95


@dataclass(frozen=True)
class Task:
    """A point to be led to a goal by a force."""

    name: str
    push_s: float
    point_s: float
    goal: tuple[float, float]  # m


TASKS = (Task("tip", 1.0, 1.0, (0.112, 0.088)), Task("middle", 0.6, 0.6, (0.076, 0.044)))


@dataclass(frozen=True)
class Outcome:
    """What came of a task."""

    beam: str
    task: Task
    found: Reach
    error: PredictedError
    landed: Array  # (2,) m, where the force puts the point of the true beam
    seconds: float  # of the reach

    @property
    def off(self) -> float:
        """m, of the true beam's point from the goal."""
        return float(np.linalg.norm(self.landed - np.asarray(self.task.goal)))

    @property
    def inside(self) -> bool:
        """Whether it lies in the ellipse that was foretold."""
        return self.error.holds(self.landed, LEVEL)


def true_place(folder: Path, force: Array, push_s: float, point_s: float) -> Array:
    """(2,) m: the point of the true beam under a force, by scipy's boundary-value solver."""
    data = np.load(folder / "truth" / "truth.npz")
    length = 0.15
    stiffness = PchipInterpolator(data["s"], data["k"])
    rest = PchipInterpolator(data["s"], data["kappa0"] * length)

    def slopes(t: Array, state: Array) -> Array:
        s = push_s * t
        alpha, moment, _, _ = state
        bend = rest(s) + moment / stiffness(s)
        pull = length * (np.sin(alpha) * force[0] - np.cos(alpha) * force[1])
        return np.asarray(push_s * np.stack([bend, pull, length * np.cos(alpha), length * np.sin(alpha)]))

    def ends(a: Array, b: Array) -> Array:
        return np.array([a[0], b[1], a[2], a[3]])

    t, guess = np.linspace(0.0, 1.0, 201), np.zeros((4, 201))
    guess[2] = length * push_s * t
    for share in np.linspace(0.1, 1.0, 10):  # from rest, so that it is the branch that a beam takes
        full, force = force, share * force
        solved = solve_bvp(slopes, ends, t, guess, tol=1e-8, max_nodes=20000)
        force = full
        if solved.status != 0:
            raise RuntimeError(solved.message)
        t, guess = solved.x, solved.y
    if point_s > push_s:
        raise ValueError("the true beam is solved up to the force")
    return np.asarray(solved.sol(point_s / push_s)[2:])


def outcomes(recordings: Path = RECORDINGS) -> list[Outcome]:
    """Every task on every beam."""
    out = []
    for beam in BEAMS:
        folder = recordings / f"{beam}_train"
        run = learn_recording(folder)
        assert run.posterior is not None
        for task in TASKS:
            began = time.perf_counter()
            found = reach(run.beam, task.goal, push_s=task.push_s, point_s=task.point_s)
            seconds = time.perf_counter() - began
            error = predicted_error(run.posterior.stiffness, found)
            landed = true_place(folder, found.force, task.push_s, task.point_s)
            out.append(Outcome(beam, task, found, error, landed, seconds))
    return out


def table(found: list[Outcome]) -> str:
    """One row a task, in Markdown."""
    lines = [
        "| beam | task | force [N] | in the model [m] | on the true beam [mm] | ellipse 95 % [mm] | inside | "
        "iterations | time [ms] |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for one in found:
        long, short = 1e3 * one.error.ellipse(LEVEL).semi_axes
        lines.append(
            f"| {one.beam} | {one.task.name} | {np.hypot(*one.found.force):.3f} | {one.found.error:.1e} | "
            f"{1e3 * one.off:.2f} | {long:.2f} x {short:.2f} | {'yes' if one.inside else 'no'} | "
            f"{one.found.iterations} | {1e3 * one.seconds:.1f} |"
        )
    return "\n".join(lines)
