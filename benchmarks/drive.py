"""Driven in real time: where the true point comes to rest, what 200 faults do, and how long a turn of the loop takes.

    python -m benchmarks.drive            # forty minutes of two cores

The virtual robot is a process of its own: 30 pictures a second of 800 x 450, 60 ms late, 1.5 of 255 of noise; axes that
lie 7 mrad off; a wrench with 5 mN of noise that wanders. Each beam is learned from a push that its own robot made. Then
it is driven to the paper's six tasks and to 20 random goals, once as it is and once with its true k(s) 30 % softer or
stiffer. The faults are put into drives on a played clock. `--only busy` drives to some of the goals beside two
processes that are always busy, with the right to real-time scheduling that the user has. Linux takes it from root by

    setpriv --bounding-set=-sys_nice --inh-caps=-sys_nice python -m benchmarks.drive --only busy

Runs are kept in out/drive: the next call goes on from there
(empty it when the drive has changed).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.paper.study import TASKS
from onebend.beam.stiffness import Scaled
from onebend.drive.machine import DriveState
from onebend.drive.placing import from_recording
from onebend.drive.plan import DriveLimits, DrivePlan, DriveSettings, make_plan
from onebend.drive.run import drive
from onebend.drive.virtual import VirtualRobot
from onebend.errors import ControlError, OnebendError
from onebend.lab.designs import find_design
from onebend.lab.random_bench import FilmRequest, filming_of
from onebend.learning.instruments import instruments_of
from onebend.pipeline import learn
from onebend.recording.folder import read_recording
from onebend.recording.observe import observe
from onebend.records import Array
from onebend.results.model import StoredModel, read_model, save_model
from tests.drive.cells import described, recorded_push, setup_for
from tests.drive.faults import DEAD, SAYS, Injected, suffer

KEPT = Path(__file__).parents[1] / "out" / "drive"
BEAMS = ("linear", "quadratic", "cubic")
RANDOM, FAULTS, BUSY = 20, 200, 6
WRONG = 0.3
ASKED = 5e-4  # m
LATE = 0.1  # s, within which it is to hold
TRUTH_AFTER = 0.7  # s of staying, when the truth is asked for
HANDS = (("push", "pose"), ("hold", "pose"), ("push", "force"))


@dataclass(frozen=True)
class Goal:
    """One drive."""

    name: str
    beam: str
    at_s: float
    goal: tuple[float, float]  # m
    factor: float  # the true k over that of the design

    @property
    def key(self) -> str:
        return f"{self.name} {self.factor:g}"


@cache
def model_of(beam: str) -> StoredModel:
    """Learned from a push that the beam's own robot made; kept."""
    folder = KEPT / beam
    if not (folder / "model.json").is_file():
        rec = described(folder)
        recorded_push(rec, setup_for(read_recording(rec, filmed=False), beam, seed=11))
        run = learn(rec)
        assert run.posterior is not None
        save_model(
            folder / "model.json", run.beam, written_by="benchmarks.drive",
            uncertain=run.posterior.stiffness, bench=instruments_of(run.posterior),
        )  # fmt: skip
    return read_model(folder)


def goals() -> Iterator[Goal]:
    """The six tasks and the random goals, each on the beam as it is and on one of another k."""
    for beam in BEAMS:
        true = filming_of(find_design(beam), FilmRequest(), beam).bench.beam
        for number, task in enumerate(TASKS):
            x, y = task.goal(true)
            for factor in (1.0, 1.0 + WRONG * (-1.0) ** number):
                yield Goal(f"{beam}, {task.name}", beam, task.s, (float(x), float(y)), factor)
    for number in range(RANDOM):
        rng = np.random.default_rng([number, 42])
        beam, at_s = str(rng.choice(BEAMS)), float(rng.choice([1.0, 1.0, 0.8, 0.6]))
        model = model_of(beam).beam
        turn, size = math.radians(rng.uniform(60.0, 120.0)) * rng.choice([-1.0, 1.0]), rng.uniform(0.4, 1.3)
        force = size * float(model.stiffness(0.5)) / (model.length * at_s) * np.array([math.cos(turn), math.sin(turn)])
        x, y = np.asarray(model.equilibrium(force, at_s).xy(at_s)).reshape(2)
        for factor in (1.0, 1.0 + WRONG * (-1.0) ** number):
            yield Goal(f"random {number + 1}", beam, at_s, (float(x), float(y)), factor)


def planned(goal: Goal, folder: Path) -> DrivePlan:
    rec = read_recording(described(folder, at_s=goal.at_s), filmed=False)
    stored = model_of(goal.beam)
    assert stored.bench is not None
    most = max(one.largest for one in stored.bench.pushes) / goal.at_s**2
    limits = DriveLimits(force=2.0 * most, curvature=80.0)
    settings = DriveSettings(rest=1.5, limits=limits)
    place = from_recording(read_recording(KEPT / goal.beam))
    return make_plan(
        stored, rec, [(math.nan, np.array(goal.goal))], place, settings, push_s=goal.at_s, point_s=goal.at_s
    )


def driven(goal: Goal) -> dict[str, Any]:
    """One drive in real time, and where the true point was while it stayed."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        try:
            plan = planned(goal, folder)
        except ControlError as wrong:
            return {"refused": str(wrong)}
        setup = setup_for(plan_rec(folder), goal.beam, holds=False, at_s=goal.at_s, seed=hash_of(goal.key))
        beam = setup.bench.beam
        beam = replace(beam, stiffness=Scaled(goal.factor, beam.stiffness))
        robot = VirtualRobot(replace(setup, bench=replace(setup.bench, beam=beam)))
        begun, true = math.inf, list[Array]()

        def watch(state: DriveState) -> None:
            nonlocal begun
            begun = min(begun, time.monotonic()) if state.stage == "staying" else math.inf
            if not true and time.monotonic() > begun + TRUTH_AFTER:
                edges, poses = robot.ask("edges"), robot.ask("poses")
                true.append(poses[int(np.argmin(np.abs(edges - goal.at_s))), :2])

        outcome = drive(folder, plan, robot.camera(), robot, watch=watch, setup=0.3)
        made = outcome.drive
        found: dict[str, Any] = {
            "happened": [one.text for one in made.events],
            "delay": made.cell.meter.delay,
            "latency": made.latency,
            "turns": made.turns,
            "pauses": made.pauses,
            "reached": outcome.data["reached"],
        }
        if made.outcomes:
            found |= {
                "seconds": made.outcomes[0].seconds,
                "said": made.outcomes[0].said,
                "noise": made.cell.eye.rest_noise,
            }
        if true:
            found["off"] = float(np.linalg.norm(true[0] - np.array(goal.goal)))
        return found


def plan_rec(folder: Path) -> Any:
    return read_recording(folder, filmed=False)


def hash_of(text: str) -> int:
    return sum((i + 1) * ord(letter) for i, letter in enumerate(text)) % 10_000


def faults() -> Iterator[Injected]:
    """Every kind in turn, at random moments, with every hand."""
    kinds = list(SAYS)
    for number in range(FAULTS):
        hand, by = HANDS[number // len(kinds) % len(HANDS)]
        after = float(np.random.default_rng([number, 43]).uniform(0.15, 1.5))
        yield Injected(kinds[number % len(kinds)], after, seed=number, hand=hand, by=by)  # type: ignore[arg-type]


def suffered(fault: Injected) -> dict[str, Any]:
    """How one fault was taken, and whether its recording can be read."""
    with tempfile.TemporaryDirectory() as place:
        one = suffer(Path(place), fault)
        try:
            whole = f"{len(observe(read_recording(Path(place))).time)} pictures"
        except OnebendError as wrong:
            whole = f"refused: {wrong}"
        return {
            "kind": fault.kind,
            "hold": one.hold_after,
            "force": one.cell.largest / one.limit,
            "message": one.message,
            "ended": one.ended,
            "whole": whole,
            "last": one.outcome.drive.events[-1].text,
        }


def kept(name: str) -> dict[str, Any]:
    file = KEPT / f"{name}.jsonl"
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    return dict(json.loads(line) for line in lines)


def keep(name: str, key: str, found: dict[str, Any]) -> None:
    KEPT.mkdir(parents=True, exist_ok=True)
    with (KEPT / f"{name}.jsonl").open("a", encoding="utf-8") as stream:
        stream.write(json.dumps([key, found]) + "\n")


def goal_rows(found: dict[str, Any]) -> Iterable[str]:
    yield "| goal | true k | reached after [s] | point off at rest [mm] | said (95 %) [mm] | noise of a picture [mm] |"
    yield f"|{' --- |' * 6}"
    for goal in goals():
        one = found[goal.key]
        if "off" not in one:
            why = one.get("refused") or one["happened"][-1]
            yield f"| {goal.name} | {goal.factor:g} | {why} | | | |"
            continue
        numbers = f"{one['seconds']:.1f} | {1e3 * one['off']:.2f} | {1e3 * one['said']:.2f} | {1e3 * one['noise']:.3f}"
        yield f"| {goal.name} | {goal.factor:g} | {numbers} |"


def goal_summary(found: dict[str, Any]) -> Iterable[str]:
    for label, wrong in (("k as it is", False), ("k wrong by 30 %", True)):
        asked = [goal for goal in goals() if (goal.factor != 1.0) == wrong]
        runs = [found[goal.key] for goal in asked]
        led = [one for one in runs if "off" in one]
        off = np.array([one["off"] for one in led])
        near = sum(one["off"] <= max(ASKED, 3.0 * one["noise"]) for one in led)
        inside = sum(one["off"] <= one["said"] for one in led)
        yield (
            f"- {label}: {len(led)} of {len(runs)} came to rest; {near} within 0.5 mm; {inside} inside the band that "
            f"was said. Median {1e3 * np.median(off):.2f} mm, largest {1e3 * off.max():.2f} mm."
        )
    led = [one for one in found.values() if "turns" in one]
    latency, turns = (1e3 * np.concatenate([one[key] for one in led]) for key in ("latency", "turns"))
    delay = 1e3 * np.array([one["delay"] for one in led])
    for label, values in (("picture to command", latency), ("one turn of the loop", turns)):
        yield f"- {label}: median {np.median(values):.1f} ms, 99 % {np.quantile(values, 0.99):.1f} ms ({len(values)})."
    pauses = [pause for one in led for pause in one.get("pauses", [])]
    yield f"- {len(pauses)} pauses, {sum(pauses):.1f} s in all."
    yield f"- delay as measured, from exposure to the robot's motion: {delay.mean():.0f} ms, sd {delay.std():.0f} ms."


def may_be_real_time() -> bool:
    """Whether this user is granted real-time scheduling."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


def drive_busy() -> None:
    """Some of the goals, beside two busy processes."""
    granted, done = may_be_real_time(), kept("busy")
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        for goal in islice(goals(), BUSY):
            key = f"{'with' if granted else 'without'} real time, {goal.key}"
            if key not in done:
                keep("busy", key, driven(goal))
    finally:
        for other in others:
            other.kill()


def busy_rows(found: dict[str, Any]) -> Iterable[str]:
    yield "| two busy processes beside it | drives | on the goal, farthest [mm] | median and 99 % [ms] | pauses |"
    yield f"|{' --- |' * 5}"
    for label in ("with real time", "without real time"):  # from picture to command
        runs = [one for key, one in found.items() if key.startswith(f"{label},")]
        led = [one for one in runs if "off" in one and one["reached"]]
        late = 1e3 * np.concatenate([one["latency"] for one in runs if "latency" in one])
        pauses = [pause for one in runs for pause in one.get("pauses", [])]
        far = 1e3 * max(one["off"] for one in led)
        yield (
            f"| {label} | {len(runs)} | {len(led)}, {far:.2f} | {np.median(late):.1f}, {np.quantile(late, 0.99):.1f} | "
            f"{len(pauses)}, {sum(pauses):.1f} s |"
        )


def right(one: dict[str, Any]) -> bool:
    """Whether the message names the fault."""
    return bool(re.search(SAYS[one["kind"]], one["message"]))


def fault_rows(found: dict[str, Any]) -> Iterable[str]:
    kinds = defaultdict(list)
    for one in found.values():
        kinds[one["kind"]].append(one)
    yield "| fault | runs | to hold [ms], largest | force over its limit, largest | message right | can be observed |"
    yield f"|{' --- |' * 6}"
    for kind in SAYS:
        runs = kinds[kind]
        holds, force = [1e3 * one["hold"] for one in runs], max(one["force"] for one in runs)
        told, whole = (sum(map(bool, some)) for some in (
            [right(one) for one in runs], [not one["whole"].startswith("refused") for one in runs]))  # fmt: skip
        late = f"{max(holds):.0f}" + (" (the robot stops by itself)" if kind in DEAD else "")
        yield f"| {kind} | {len(runs)} | {late} | {force:.2f} | {told} | {whole} |"
    every = list(found.values())
    yield ""
    yield (
        f"{len(every)} faults: {sum(one['hold'] <= LATE + 1e-9 for one in every)} held within 100 ms, "
        f"{sum(one['force'] <= 1.05 for one in every)} kept the force within 105 % of its limit (largest "
        f"{max(one['force'] for one in every):.2f}), {sum(one['ended'] for one in every)} ended as a fault and let go, "
        "or went on after a slow turn, "
        f"{sum(map(right, every))} said the right thing, "
        f"{sum(not one['whole'].startswith('refused') for one in every)} left a recording that can be observed."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("goals", "faults", "busy"))
    parser.add_argument("--jobs", type=int, default=2, help="processes for the faults")
    asked = parser.parse_args()
    if asked.only in (None, "busy"):
        drive_busy()
    if asked.only in (None, "goals"):
        done = kept("goals")
        for goal in goals():
            if goal.key not in done:
                keep("goals", goal.key, driven(goal))
    if asked.only in (None, "faults"):
        done = kept("faults")
        left = [one for one in faults() if f"{one.seed}" not in done]
        with get_context("spawn").Pool(asked.jobs, maxtasksperchild=20) as pool:
            for fault, found in zip(left, pool.imap(suffered, left), strict=True):
                keep("faults", f"{fault.seed}", found)
    if asked.only is None:
        made = (goal_rows(kept("goals")), busy_rows(kept("busy")), fault_rows(kept("faults")))
        print("\n".join([*goal_summary(kept("goals")), *(line for rows in made for line in ("", *rows))]))


if __name__ == "__main__":
    main()
