"""The six manipulation tasks (Section V-C, Fig. 8), and what their forces do to the true beam."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.integrate import solve_bvp

from onebend.beam.model import Beam
from onebend.control.reach.reach import Reach, ReachSettings, reach
from onebend.errors import MechanicsError
from onebend.lab.random_beams import force_that_bends
from onebend.records import Array

Way = Literal["fit", "fit-paper", "paper"]
SHARES = np.linspace(0.1, 1.0, 10)  # of the force, so that the true beam takes the branch from rest


@dataclass(frozen=True)
class Task:
    """A point to be led to a goal by a force at the same place.

    The paper prints no goals. Ours are places that the true beam can take: those of its point when a force at
    `DIRECTION` turns it by `turn`, to the nearest hundredth of a millimetre.
    """

    name: str
    s: float
    turn: float  # rad

    def goal(self, true: Beam) -> Array:
        """(2,) m."""
        force = force_that_bends(true, self.turn, DIRECTION, self.s) * np.array([np.cos(DIRECTION), np.sin(DIRECTION)])
        place = true.equilibrium(force, self.s).xy(self.s)
        return np.round(np.asarray(place, dtype=float).reshape(2), 5)


DIRECTION = 1.9  # rad
TASKS = (Task("tip", 1.0, np.deg2rad(50.0)), Task("middle", 0.5, np.deg2rad(35.0)))
WAYS: dict[Way, str] = {
    "fit": "exact, on the fit",
    "fit-paper": "Algorithm 1, on the fit",
    "paper": "Algorithm 1, on the paper's regression",
}


@dataclass(frozen=True)
class TaskResult:
    """One task solved on a learned beam, and its force put on the true beam."""

    beam: str
    task: Task
    way: Way
    goal: Array  # (2,) m
    found: Reach
    landed: Array  # (2,) m, of the true beam; NaN where no force was found

    @property
    def off(self) -> float:
        """m, of the true beam's point from its goal."""
        return float(np.linalg.norm(self.landed - self.goal))


def manipulate(name: str, fit: Beam, paper: Beam | None, true: Beam) -> list[TaskResult]:
    """All tasks of one beam, every way. `true`: the beam as the force's scale shows it."""
    out = []
    for task in TASKS:
        goal = task.goal(true)
        for way in WAYS:
            beam = paper if way == "paper" else fit
            if beam is None:
                continue
            settings = ReachSettings(method="newton" if way == "fit" else "paper")
            result = reach(beam, goal, push_s=task.s, point_s=task.s, settings=settings)
            landed = true_place(true, result.force, task.s) if result.converged else np.full(2, np.nan)
            out.append(TaskResult(name, task, way, goal, result, landed))
    return out


def true_place(beam: Beam, force: Array, s: float) -> Array:
    """(2,) m: where `force` at `s` puts the point `s` of a beam that is straight at rest, by a solver of its own.

    SciPy's collocation for the boundary-value problem `alpha' = M / k`, `M' = L (sin(alpha) Fx - cos(alpha) Fy)`,
    from no force to the whole of it; it shares nothing with the statics that the force was found by.

    Raises:
        MechanicsError: the solver finds no shape.
    """
    length = beam.length
    t, guess = np.linspace(0.0, 1.0, 101), np.zeros((4, 101))
    guess[2] = length * s * t
    for share in SHARES:
        now = share * force

        def slopes(t: Array, state: Array, now: Array = now) -> Array:
            alpha, moment = state[:2]
            pull = length * (np.sin(alpha) * now[0] - np.cos(alpha) * now[1])
            bend = moment / np.asarray(beam.stiffness(s * t))
            return np.asarray(s * np.stack([bend, pull, length * np.cos(alpha), length * np.sin(alpha)]))

        solved = solve_bvp(slopes, _ends, t, guess, tol=1e-8, max_nodes=20000)
        if solved.status != 0:
            raise MechanicsError(f"the true beam has no shape under {np.hypot(*now):.3g} N: {solved.message}")
        t, guess = solved.x, solved.y
    return np.asarray(guess[2:, -1])


def _ends(clamp: Array, free: Array) -> Array:
    return np.array([clamp[0], free[1], clamp[2], clamp[3]])
