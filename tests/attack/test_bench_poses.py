"""Weights hung on a beam, and its frequencies: numbers in other units, absurd histories, impossible masses."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.attack.family import Case, Harm, edit, params, rewrite, withstood
from tests.attack.victim import Victim

EXAMPLES = Path(__file__).parents[2] / "examples"
TOML, LOADS, SECTION = "recording.toml", "loads.csv", "section.csv"


def more(text: str) -> Harm:
    return rewrite(TOML, lambda old: old + text)


def column(names: str, value: Callable[[int], str]) -> Harm:
    """Further columns of the loads."""

    def changed(text: str) -> str:
        head, *rows = text.splitlines()
        return "\n".join([f"{head},{names}", *(f"{row},{value(i)}" for i, row in enumerate(rows))]) + "\n"

    return rewrite(LOADS, changed)


HZ, SD, MODE, MASS = "hz = 9.2427", "sd_hz = 0.005", "mode = 1", "mass_kg = 0.07065"
RIDER = "\n[[beam.masses]]\n"
RULER = [
    Case("no frequency", edit(TOML, HZ, "hz = 0"), ":18: .frequencies. .entry 1. hz must be"),
    Case("an endless frequency", edit(TOML, HZ, "hz = inf"), "hz must be"),
    Case("a frequency in millihertz", edit(TOML, HZ, "hz = 9242.7"), "mode 1 at 9243 Hz is no slower than mode 2 at"),
    Case("an exact frequency", edit(TOML, SD, "sd_hz = 0"), "sd_hz must be"),
    Case("mode by its name", edit(TOML, MODE, 'mode = "one"'), "mode must be"),
    Case("the thousand millionth mode", edit(TOML, MODE, "mode = 1000000000"), "modes 1 to 8 of a slender beam"),
    Case("damped to death", edit(TOML, "ratio = 0.0041", "ratio = 1.0"), "damping_ratio must be"),
    Case("mass in grams", edit(TOML, MASS, "mass_kg = 70.65"), "kg/m.3, as no material is. Check mass_kg"),
    Case("a rider without a place", more(f"{RIDER}mass_kg = 0.01\n"), "lacks s: its place"),
    Case("a rider beyond the tip", more(f"{RIDER}s = 2\nmass_kg = 0.01\n"), "s must be a number between 0 and 1"),
    Case("a rider of less than nothing", more(f"{RIDER}s = 1\nmass_kg = -1\n"), "mass_kg must be"),
]
HUNG = [
    Case("as it is", lambda _: None, passes=True),
    Case("one order for all", column("order", lambda _: "1"), "order is the same in two poses"),
    Case("order and turned from", column("order,turned_from_deg", lambda i: f"{i + 1},10"), "both turned_from_deg and"),
    Case("an endless load", rewrite(LOADS, lambda text: text.replace("0.02", "1e300")), "is none. Check its unit"),
    Case("a mass below nothing", rewrite(LOADS, lambda text: text.replace("0.02", "-0.02")), "mass_kg is negative"),
    Case("a load beyond the tip", rewrite(LOADS, lambda text: text.replace(",1.0,", ",3.0,")), "s between 0 at the"),
    Case("gravity in cm/s^2", edit(TOML, "= -90.0", "= -90.0\nmagnitude_m_s2 = 981"), "magnitude_m_s2 must be"),
    Case("a rider in grams", more(f"{RIDER}s = 1\nmass_kg = 5\n"), "rides on the beam weighs 5 kg"),
    Case("riders as one table", more("\n[beam.masses]\ns = 1\nmass_kg = 0.1\n"), "masses must be tables"),
    Case(
        "zeroed in no pose",
        edit(TOML, '"room"', '"room"\nrelative_to = "nobody"'),
        "relative_to names no pose of loads.csv",
    ),
    Case("zeroed by number", edit(TOML, '"room"', '"room"\nrelative_to = 5'), "relative_to must be"),
    Case("read at y", edit(TOML, '"room"', '"room"\nread_at = "y"'), "read_at must be"),
]
TUBE = [
    Case("a section of text", rewrite(SECTION, lambda _: "s,diameter_m\n0,thick\n1,thin\n"), "section.csv"),
    Case("sizes below nothing", rewrite(SECTION, lambda text: text.replace("0.0092", "-0.0092")), "section.csv"),
    Case("a tube inside out", rewrite(SECTION, lambda text: text.replace("0.0072", "0.0099")), "must be less than"),
    Case("sizes of 1e300", rewrite(SECTION, lambda _: "s,diameter_m\n0,1e300\n1,8\n"), "section.csv|no material"),
    Case("three sizes at one place", rewrite(SECTION, lambda t: t + "1.0,0.004,0.003\n1.0,0.003,0.002\n"), "section"),
]
QUICK = {
    "mass in grams",
    "gravity in cm/s^2",
    "a rider in grams",
}
OF = {
    case.name: name
    for name, cases in (("ruler", RULER), ("hung-weights", HUNG), ("tapered-tube", TUBE))
    for case in cases
}
CASES = [*RULER, *HUNG, *TUBE]


def on_example(folder: Path, case: Case) -> None:
    """A copy of the example that the case is of, harmed."""
    case.harm(Path(shutil.copytree(EXAMPLES / OF[case.name], folder / "rec")))


@pytest.mark.parametrize("case", params(CASES, QUICK))
def test_a_bench_pose(victim: Victim, tmp_path: Path, case: Case) -> None:
    on_example(tmp_path, case)
    outcome = victim.attack(["check", "rec"], tmp_path)
    said = " ".join((outcome.err + outcome.out).split())
    assert re.search(case.words, said), said
    if outcome.verdict != "done":  # a warning is as clear as a refusal
        withstood(outcome, case)
