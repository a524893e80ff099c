"""Numbers as options that no one means: a limit that says itself, before memory goes."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from onebend.cli import Command
from onebend.results.model import save_model
from onebend.wings import commands_of
from tests.attack.family import Case, params, withstood
from tests.attack.victim import Victim
from tests.made_up import BEAM

HUGE = 10**400
REQUESTS: dict[str, list[object]] = {
    "hinges by the billion": ["export", "model.json", "--to", "urdf", "-o", "x.urdf", "--hinges", 10**9],
    "hinges of 400 digits": ["export", "model.json", "--to", "urdf", "-o", "x.urdf", "--hinges", HUGE],
    "a mass beyond all numbers": ["export", "model.json", "--to", "urdf", "-o", "x.urdf", "--mass-kg", 1e308],
    "a mass below all numbers": ["export", "model.json", "--to", "urdf", "-o", "x.urdf", "--mass-kg", 5e-324],
    "damping without end": [
        "export",
        "model.json",
        "--to",
        "urdf",
        "-o",
        "x",
        "--mass-kg",
        1,
        "--damping-time-s",
        1e308,
    ],
    "a force beyond all numbers": ["shape", "model.json", "--targets", "targets.csv", "--max-force-N", 1e300],
    "samples by the million": ["path", "model.json", "--goals", "goals.csv", "--rate-Hz", 1e6],
    "a swing backwards": ["frequencies", "backwards.csv", "-q"],
    "a swing beyond all numbers": ["frequencies", "endless.csv", "-q"],
    "a goal in a table beyond all numbers": ["path", "model.json", "--goals", "endless_goals.csv"],
    "a recording without end": ["record", "out", "--play", "film", "--longest-s", "inf"],
    "a film of 30 years": ["film", "linear", "-o", "f", "-q", "--seconds", 1e9],
    "an endless film": ["film", "linear", "-o", "f", "-q", "--seconds", "inf"],
    "a film of no number": ["film", "linear", "-o", "f", "-q", "--seconds", "nan"],
    "a rate of 1e9": ["film", "linear", "-o", "f", "-q", "--fps", 1e9],
    "a rehearsal of 30 years": ["rehearse", "linear", "-o", "r", "-q", "--seconds", 1e9],
    "processes by the billion": ["rehearse", "linear", "-o", "r", "-q", "--jobs", 10**9],
    "a push at the clamp": ["rehearse", "linear", "-o", "r", "-q", "--push-at", 1e-308],
    "tags by the billion": ["tags", "-o", "t.pdf", "--ids", "0-999999999"],
    "tags of a million kilometres": ["tags", "-o", "t.pdf", "--ids", "0-2", "--size-mm", 1e12],
    "a goal beyond all numbers": ["reach", "model.json", "--goal", 1e308, 1e308],
    "a goal that is no number": ["reach", "model.json", "--goal", "nan", 0.1],
    "a loop for that goal": ["loop", "model.json", "--goal", 1e308, 1e308],
}
WORDS = {
    "a swing backwards": "must be known and rise from row to row",
    "a swing beyond all numbers": r"line 202: x is infinite, or beyond 1e.30",
    "a force beyond all numbers": "max-force-N",
    "samples by the million": "2e.06 samples at 1e.06 Hz",
}
CASES = [Case(name, lambda _: None, WORDS.get(name, "")) for name in REQUESTS]
QUICK = {"hinges by the billion", "a mass beyond all numbers", "a film of 30 years", "a goal beyond all numbers"}


def prepare(folder: Path) -> None:
    """A model, and goals of two seconds for its tip."""
    save_model(folder / "model.json", BEAM, written_by="a test")
    goals = "time_s,x_m,y_m\n0,0.1473,0.0270\n2,0.1340,0.0635\n"
    (folder / "goals.csv").write_text(goals, encoding="utf-8")
    (folder / "endless_goals.csv").write_text(goals.replace("0.0635", "1e308"), encoding="utf-8")
    swing = [f"{0.01 * i:.2f},{math.sin(i):.4f}" for i in range(200)]
    (folder / "backwards.csv").write_text("\n".join(["time_s,x", *swing[::-1]]), encoding="utf-8")
    (folder / "endless.csv").write_text("\n".join(["time_s,x", *swing, "2.00,1e308"]), encoding="utf-8")


@pytest.mark.parametrize("case", params(CASES, QUICK))
def test_a_request(victim: Victim, tmp_path: Path, case: Case) -> None:
    prepare(tmp_path)
    withstood(victim.attack(REQUESTS[case.name], tmp_path), case)


def test_every_length_of_time_force_and_size_has_its_largest_value() -> None:
    """Options in numbers with a least value; those without one (angles, goals, times in a film) are checked in use."""
    open_ended = [
        f"{name} {option.opts[0]}"
        for name, place in commands_of("cli").items()
        for option in Command(name, place).loaded().params
        if getattr(option, "min", None) is not None
        and option.max is None
        and "float" in str(option.type_descriptor.annotation)
    ]
    assert open_ended == []
