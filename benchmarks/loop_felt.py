"""The closed loop with a robot whose force is off by 0.2 N: what feels the force on the beam, and what is gained by it.

    python -m benchmarks.loop_felt           # random beams, each learned from one push; some minutes of one core

Each beam is random, and learned from one push on a random bench as in `benchmarks.sensing`: the model's k(s) is wrong
by what the learning left, its band is that of the learning. The robot's force is off by 0.2 N in a direction drawn for
each beam; the log, a sensor of its own, by 0.2 N in another. `shape`: the tags at 1/4, 1/2 and 3/4, put on anew to
0.5 mm, seen with 0.02 mm and 1 mrad of noise, sensed live with k's band. `error`: distance from the goal, RMS over the
last second of eight; then root mean square, median and largest over the beams.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.sensing import bench_of, is_learned, kept, learned
from onebend.beam.model import Beam
from onebend.control.loop import Controller, ForceSense, LoggedForce, controller
from onebend.control.loop_simulation import Actuator, LoopCamera, TrueSystem, simulate_loop
from onebend.errors import ControlError, MechanicsError
from onebend.lab.designs import force_that_bends
from onebend.lab.sensed_force import SensedForce, drawn_tags
from onebend.records import Array

OFF = 0.2  # N
LEAST = 0.5  # N: beams whose goal needs less are left out; 0.2 N would be most of it
TAGS = (0.25, 0.5, 0.75)
FELT = ("nothing", "the true force", "a log", "the shape")
DURATION = 8.0
EYE = LoopCamera(delay=0.06, jitter=0.01, noise=1e-4, dropped=0.1)
BLIND = replace(EYE, hidden=((0.0, 2.0 * DURATION),))


def case(beam: int) -> tuple[Controller, Beam, np.random.Generator] | None:
    """A controller on the learned beam, and the true beam; None: too soft, or no goal."""
    model, truth = learned(beam), bench_of(beam).beam
    assert model is not None
    rng = np.random.default_rng([beam, 25])
    direction = float(rng.choice([-1.0, 1.0])) * float(rng.uniform(1.3, 1.9))
    size = force_that_bends(model.beam, float(np.radians(rng.uniform(30.0, 60.0))), direction, 1.0)
    if size < LEAST:
        return None
    force = size * np.array([np.cos(direction), np.sin(direction)])
    thought = replace(model.beam, mass_per_length=truth.mass_per_length)
    return controller(thought, thought.equilibrium(force).xy(1.0)), truth, rng


def senses(
    beam: int, control: Controller, truth: Beam, rng: np.random.Generator
) -> dict[str, Callable[[], ForceSense]]:
    """What feels the force, made anew for each run."""
    model, wrong = learned(beam), OFF * drawn_direction(rng)
    assert model is not None
    tags, stiffness = drawn_tags(TAGS, rng), model.uncertain
    return {
        "the true force": lambda: LoggedForce(np.zeros(2), noise=0.01, sd=0.01, seed=beam),
        "a log": lambda: LoggedForce(wrong, noise=0.01, sd=OFF, seed=beam),
        "the shape": lambda: SensedForce(control.beam, truth, tags, push_s=1.0, stiffness=stiffness, seed=beam),
    }


def drawn_direction(rng: np.random.Generator) -> Array:
    angle = float(rng.uniform(0.0, 2.0 * np.pi))
    return np.array([np.cos(angle), np.sin(angle)])


def rows_of(beam: int) -> list[dict[str, object]]:
    """Every run of a beam: error [m]. Where the point is seen, nothing that is felt is used."""
    made = case(beam)
    if made is None:
        return []
    control, truth, rng = made
    hand = Actuator(bias=tuple((OFF * drawn_direction(rng)).tolist()))
    every, out = senses(beam, control, truth, rng), []
    for eye in (BLIND, EYE):
        system = TrueSystem(truth, eye=eye, hand=hand)
        for name in FELT if eye is BLIND else FELT[:1]:
            row: dict[str, object] = {"beam": beam, "felt": name, "seen": eye is EYE}
            try:
                run = simulate_loop(control, system, DURATION, seed=beam, feel=every[name]() if name in every else None)
            except MechanicsError as wrong:
                out.append(row | {"failure": str(wrong)})
                continue
            last = run.time > DURATION - 1.0
            out.append(row | {"error": float(np.sqrt(np.mean(run.error[last] ** 2)))})
    return out


def study(beams: int) -> list[dict[str, object]]:
    """Every run; what this very code did before is in a file."""
    file = kept() / "loop.jsonl"
    file.parent.mkdir(parents=True, exist_ok=True)
    done = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []
    known = {one["beam"] for one in done}
    for beam in range(beams):
        if beam in known or not is_learned(beam):
            continue
        try:
            rows = rows_of(beam)
        except ControlError as wrong:
            print(f"beam {beam}: {wrong}")
            continue
        done += rows
        with file.open("a", encoding="utf-8") as lines:
            lines.writelines(json.dumps(row) + "\n" for row in rows)
    return done


def table(rows: list[dict[str, object]]) -> str:
    """A row for each thing that feels the force."""
    lines = ["| point | felt | beams (lost) | error, RMS [mm] | median | largest |", "| --- " * 6 + "|"]
    for seen in (False, True):
        for name in FELT[:1] if seen else FELT:
            of = [row for row in rows if row["seen"] is seen and row["felt"] == name]
            good = [row for row in of if "error" in row]
            error = 1e3 * np.array([row["error"] for row in good], dtype=float)
            numbers = f"{np.sqrt(np.mean(error**2)):.2f} | {np.median(error):.2f} | {error.max():.2f}"
            where = "seen" if seen else "never seen"
            lines.append(f"| {where} | {name} | {len(good)} ({len(of) - len(good)}) | {numbers} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--beams", type=int, default=40, help="random beams, of which those that are stiff enough count"
    )
    print(table(study(parser.parse_args().beams)))


if __name__ == "__main__":
    main()
