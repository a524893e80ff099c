"""The six tasks of the paper's Fig. 8, with beams learned from the development recordings and the true beams."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.integrate import solve_bvp
from scipy.interpolate import PchipInterpolator

from benchmarks.truth import RECORDINGS
from onebend.beam.continuation import follow
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problems
from onebend.beam.stiffness import UncertainStiffness
from onebend.control.reach import PredictedError, Reach, predicted_error, reach
from onebend.lab.designs import force_that_bends
from onebend.pipeline import learn
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


TASKS = (Task("tip", 1.0, 1.0, (0.115, 0.0905)), Task("middle", 0.6, 0.6, (0.0822, 0.0345)))


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


@dataclass(frozen=True)
class Known:
    """A beam as learned, and where its truth lies."""

    name: str
    folder: Path
    beam: Beam
    stiffness: UncertainStiffness


def learned(recordings: Path = RECORDINGS) -> list[Known]:
    """The three beams, each from its training push alone."""
    out = []
    for name in BEAMS:
        folder = recordings / f"{name}_train"
        run = learn(folder)
        assert run.posterior is not None
        out.append(Known(name, folder, run.beam, run.posterior.stiffness))
    return out


def attempt(known: Known, task: Task) -> Outcome:
    """Solve a task on the learned beam, and put its force on the true one."""
    began = time.perf_counter()
    found = reach(known.beam, task.goal, push_s=task.push_s, point_s=task.point_s)
    seconds = time.perf_counter() - began
    if not found.converged:
        raise RuntimeError(f"{known.name}, {task.name}: {found.reason}")
    error = predicted_error(known.beam, known.stiffness, found)
    landed = true_place(known.folder, found.force, task.push_s, task.point_s)
    return Outcome(known.name, task, found, error, landed, seconds)


def many(known: Known, count: int, *, seed: int) -> list[Outcome]:
    """Tasks with random goals that the learned beam can reach, tips turned by 0.3 to 1.2 rad."""
    rng = np.random.default_rng(seed)
    out: list[Outcome] = []
    while len(out) < count:
        push_s = float(rng.choice([1.0, 0.8, 0.6]))
        turn = float(rng.choice([-1.0, 1.0]) * rng.uniform(np.pi / 4, 3 * np.pi / 4))
        size = force_that_bends(known.beam, float(rng.uniform(0.3, 1.2)), turn, push_s)
        force = size * np.array([np.cos(turn), np.sin(turn)])
        point_s = push_s * float(rng.choice([1.0, 0.6]))
        x, y = known.beam.equilibrium(force, push_s).xy(point_s)
        out.append(attempt(known, Task("random", push_s, point_s, (float(x), float(y)))))
    return out


def drawn_inside(one: Outcome, known: Known, count: int, *, seed: int) -> int:
    """How many beams drawn from the band have the point in the ellipse under the same force."""
    profiles = known.stiffness.draw(count, seed=seed)
    beams = [replace(known.beam, stiffness=profile) for profile in profiles]
    loads = push(np.tile(one.found.force, (count, 1)), one.task.push_s)
    solved = follow(make_problems(beams, loads, Resolution(16, 0.5)))
    place = solved.xy(np.array([one.task.point_s]))[:, 0]
    return int(np.sum([one.error.holds(xy, LEVEL) for xy in place]))


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
