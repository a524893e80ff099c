"""The closed loop on beams and goals drawn at random: steps in k(s), weight, pushes inside the beam, late cameras.

    python -m benchmarks.loop_fresh [--cases 40] [--seed 0]

Nothing of the controller was chosen on these. The true k(s) differs from the model's by up to 30 %: all alike, in
halves, or along a line. The true delay is drawn from 0 to 100 ms, the controller is told 50. A case counts if the true
beam too can be held on the goal, from rest, with a stable shape. `steady`: the largest distance from the goal in the
last second of twelve; asked: 0.5 mm.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.continuation import equilibrium
from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.stiffness import LogSpline, Powers, Profile, Steps, Table, Uniform
from onebend.control.loop import Controller, ControllerSettings, controller
from onebend.control.loop_simulation import Actuator, LoopCamera, LoopSimulation, TrueSystem, simulate_loop
from onebend.control.reach import Reach, ReachSettings, reach
from onebend.errors import ControlError, MechanicsError
from onebend.records import Array

ASKED = 5e-4  # m
WITHIN = 1e-3  # m
WRONG = 0.3
DURATION = 12.0  # s
G = 9.81
S = np.linspace(0.0, 1.0, 401)


@dataclass(frozen=True)
class Case:
    """A model and a goal, and the beam, camera and hand that are really there."""

    beam: Beam
    profile: str
    goal: Array
    push_s: float
    point_s: float
    gravity: tuple[float, float]
    error: str
    truth: TrueSystem
    held: Reach  # what the true beam needs


def model(rng: np.random.Generator) -> tuple[str, Beam]:
    """A beam of 0.1 to 0.3 m, k(s) uniform, tapered, uneven or in steps."""
    level = 0.03 * np.exp(0.3 * rng.standard_normal())
    knots = (0.0, 0.0, 0.0, *np.linspace(0.0, 1.0, 5).tolist(), 1.0, 1.0, 1.0)
    profiles: dict[str, Profile] = {
        "uniform": Uniform(level),
        "taper": Powers((level, -0.75 * level)),
        "uneven": LogSpline(knots, tuple((np.log(level) + rng.uniform(-0.6, 0.6, 7)).tolist())),
        "steps": Steps((0.0, 0.35, 0.7, 1.0), tuple((level * rng.uniform(0.5, 1.6, 3)).tolist())),
    }
    name = str(rng.choice(list(profiles)))
    return name, Beam(rng.uniform(0.1, 0.3), profiles[name], mass_per_length=Uniform(rng.uniform(0.05, 0.2)))


def wrong(k: Profile, rng: np.random.Generator) -> tuple[str, Profile]:
    """k(s) with an error of 30 %."""
    half, line = np.where(S < 0.5, 1.0, -1.0), 1.0 - 2.0 * S
    shapes = {"softer": -np.ones(401), "stiffer": np.ones(401), "halves": half, "halves, turned": -half}
    shapes |= {"line": line, "line, turned": -line}
    name = str(rng.choice(list(shapes)))
    return name, Table(tuple(S.tolist()), tuple((k(S) * (1.0 + WRONG * shapes[name])).tolist()))


def drawn(rng: np.random.Generator) -> Case | None:
    """One case; None where it does not count."""
    name, beam = model(rng)
    push_s = float(rng.choice([1.0, 1.0, 0.8, 0.6]))
    point_s = float(rng.choice([1.0, push_s, 0.7]))
    turn = rng.uniform(-np.pi, np.pi)
    gravity = (G * float(np.cos(turn)), G * float(np.sin(turn))) if rng.random() < 0.5 else (0.0, 0.0)
    size, way = rng.uniform(0.7, 3.0), rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.85) * np.pi
    force = size * float(np.mean(beam.stiffness(S))) / (beam.length * push_s**2) * np.array([np.cos(way), np.sin(way)])
    error, k = wrong(beam.stiffness, rng)
    eye = LoopCamera(delay=float(rng.uniform(0.0, 0.1)), jitter=0.005, noise=1e-4, dropped=0.1)
    hand = Actuator(gain=float(rng.uniform(0.9, 1.1)))
    truth = TrueSystem(replace(beam, stiffness=k), 0.05, push_s, point_s, gravity, eye, hand)
    try:
        solved = equilibrium(beam, push(force[None], push_s) + weight(gravity))
        if not (solved.converged[0] and solved.stable[0]):
            return None
        goal = solved.xy(np.array([point_s]))[0, 0]
        held = reach(truth.beam, goal, push_s=push_s, point_s=point_s, settings=ReachSettings(gravity=gravity))
    except (ControlError, MechanicsError):
        return None
    return Case(beam, name, goal, push_s, point_s, gravity, error, truth, held) if held.converged else None


def cases(count: int, seed: int) -> Iterator[Case]:
    """`count` cases that count."""
    number = 0
    while count:
        case = drawn(np.random.default_rng([seed, number]))
        number += 1
        if case is not None:
            count -= 1
            yield case


def made(case: Case, settings: ControllerSettings = ControllerSettings()) -> Controller:
    """The loop that the model gives for the goal."""
    return controller(
        case.beam, case.goal, push_s=case.push_s, point_s=case.point_s, gravity=case.gravity, settings=settings
    )


def row_of(number: int, case: Case, found: LoopSimulation | None) -> str:
    """One line of the table."""
    heavy = "yes" if any(case.gravity) else "no"
    end = "lost | never" if found is None else f"{1e3 * found.steady():.2f} | {found.settled(WITHIN):.1f}"
    return (
        f"| {number} | {1e3 * case.beam.length:.0f} mm, {case.profile} | {case.push_s:g}, {case.point_s:g} | {heavy} | "
        f"{case.error} | {1e3 * case.truth.eye.delay:.0f} | {end.replace('inf', 'never')} |"
    )


def main() -> None:
    """Print the table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    print("| | model | push, point | weight | true k(s) | delay [ms] | steady [mm] | settled to 1 mm [s] |")
    print(f"|{' --- |' * 8}")
    steady, refused, began = [], 0, time.process_time()
    for number, case in enumerate(cases(asked.cases, asked.seed), 1):
        found: LoopSimulation | None
        try:
            found = simulate_loop(made(case), case.truth, DURATION, seed=number)
        except ControlError:
            refused += 1
            continue
        except MechanicsError:
            found = None
        steady.append(np.inf if found is None else found.steady())
        print(row_of(number, case, found), flush=True)
    good = int(np.sum(np.array(steady) <= ASKED))
    print(
        f"\n{good} of {len(steady)} within 0.5 mm; median {1e3 * np.median(steady):.2f} mm, largest "
        f"{1e3 * max(steady):.2f} mm; {refused} goals refused by the model. "
        f"{(time.process_time() - began) / asked.cases:.1f} s of a processor each."
    )


if __name__ == "__main__":
    main()
