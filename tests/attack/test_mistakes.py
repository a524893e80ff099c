"""Mistakes of a new user, one by one: each ends in words that name it, and the key, line or file to change."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from onebend.records import Array
from tests.attack.family import Case, Harm, edit, params, rewrite
from tests.attack.victim import Victim
from tests.recording.tracked import track_folder

TOML, FORCE, MARKERS = "recording.toml", "force.csv", "markers.csv"
LENGTH, LOG = "length_m = 0.15", 'file = "force.csv"'


def numbers(file: str, change: Callable[[Array], Array], header: str = "") -> Harm:
    """A table of numbers, changed."""

    def changed(text: str) -> str:
        head, *rows = text.splitlines()
        table = change(np.array([[float(cell) for cell in row.split(",")] for row in rows]))
        return "\n".join([header or head, *(",".join(f"{value:.9g}" for value in row) for row in table)]) + "\n"

    return rewrite(file, changed)


def scaled(file: str, *factors: float, header: str = "") -> Harm:
    """The columns of a table times these factors; those after the last stay."""

    def change(table: Array) -> Array:
        table[:, : len(factors)] *= factors
        return table

    return numbers(file, change, header)


def all_of(*harms: Harm) -> Harm:
    def harm(folder: Path) -> None:
        for one in harms:
            one(folder)

    return harm


def exchanged(key: str, first: str, second: str) -> Harm:
    """Two values of a key in each other's place."""
    marks = [(f"{key} = {first}\n", "\0"), (f"{key} = {second}\n", f"{key} = {first}\n"), ("\0", f"{key} = {second}\n")]
    return all_of(*(edit(TOML, old, new) for old, new in marks))


def renamed(old: str, new: str) -> Harm:
    return lambda folder: (folder / old).rename(folder / new)


def unlike(table: Array) -> Array:
    """The log of another day."""
    table[:, 1:] = 0.2 * np.random.default_rng(0).standard_normal(table[:, 1:].shape)
    return table


def cut(table: Array) -> Array:
    """A sensor whose range ends at 0.2 N."""
    return np.column_stack([table[:, 0], np.clip(table[:, 1:], -0.2, 0.2)])


def slow(table: Array) -> Array:
    """A sensor with a first-order lag of 1 s."""
    out, part = table.copy(), 1.0 - np.exp(-np.median(np.diff(table[:, 0])) / 1.0)
    for before, row, now in zip(out[:-1], out[1:], table[1:], strict=True):
        row[1:] = before[1:] + part * (now[1:] - before[1:])
    return out


def since_1970(table: Array) -> Array:
    """Times as a computer's clock counts them."""
    return np.column_stack([1e9 * (table[:, 0] + 1.78e9), table[:, 1:]])


MASS = edit(TOML, LENGTH, f"{LENGTH}\nmass_kg = 0.075")
SPACED = rewrite(FORCE, lambda text: text.replace(",", ";").replace(".", ","))
CASES = [
    Case("nothing", lambda _: None, passes=True),
    Case("an id that is not there", edit(TOML, "id = 2", "id = 7"), "marker 7 .* the table holds 0, 1, 2, 3, 9. Corr"),
    Case("a base that is not there", edit(TOML, "id = 0", "id = 6"), "marker 6 .* Correct the ids in recording.toml"),
    Case("base and tip exchanged", exchanged("id", "0", "3"), "the clamp and marker 1 are .* markers' ids and s"),
    Case("two ids exchanged", exchanged("id", "1", "2"), "stand in the order 1, 2, 3, by their s in the order 2, 1, 3"),
    Case("order reversed", exchanged("s", "0.3333333333333333", "1.0"), "order 1, 2, 3, by their s in the order 3"),
    Case("start of another day", edit(TOML, "start_s = 249.4", "start_s = 0.0"), "do not overlap. Check start_s"),
    Case("start 6 s off", edit(TOML, "start_s = 249.4", "start_s = 255.4"), r"from 250\.3. s on\. Correct start_s"),
    Case("grams, the mass known", all_of(MASS, scaled(FORCE, 1, 102, 102)), "times the beam.s weight: is the log in"),
    Case("millinewtons", scaled(FORCE, 1, 1000, 1000), "is the log in millinewtons"),
    Case("kilonewtons, the mass known", all_of(MASS, scaled(FORCE, 1, 0.001, 0.001)), "is the log in kilonewtons"),
    Case("columns in grams", rewrite(FORCE, lambda text: text.replace("_N", "_g")), "no column fx_N, fy_N; found"),
    Case("points in millimetres", scaled(MARKERS, 1, 1, 1000, 1000), "Are x_m and y_m in metres"),
    Case("length in millimetres", edit(TOML, LENGTH, "length_m = 150"), ":3: .beam. length_m must be .* not 150"),
    Case("length in centimetres", edit(TOML, LENGTH, "length_m = 15"), "5000 mm of beam between them.* Check length_m"),
    Case("places in millimetres", edit(TOML, "s = 0.66", "s = 100.66"), r":17: .tags.on_beam. \(entry 2\) s must be"),
    Case("a wrong extension", edit(TOML, "force.csv", "force.txt"), "no file .*force.txt. Did you mean force.csv"),
    Case("a log that is not there", lambda rec: (rec / FORCE).unlink(), "recording.toml:25: .force. file: there is no"),
    Case("a table that is not there", lambda rec: (rec / MARKERS).unlink(), ":22: .markers. file: there is no file"),
    Case("no description", renamed(TOML, "description.toml"), "holds no recording.toml. Write one with `onebend new"),
    Case("another column's name", edit(FORCE, "fx_N", "Fx"), "line 1: no column fx_N; found time_s, Fx, fy_N"),
    Case("times in milliseconds", scaled(FORCE, 1000), 'for milliseconds write time_unit = "ms" in .force.'),
    Case("forces of opposite sign", scaled(FORCE, 1, -1, -1), "opposite sign. In .force., give acts_on the other"),
    Case("the robot's force", edit(TOML, LOG, f'{LOG}\nacts_on = "robot"'), "opposite sign. In .force., give acts_on"),
    Case("forces exchanged", numbers(FORCE, lambda table: table[:, [0, 2, 1]]), "x and y swapped. In .force., exch"),
    Case("one force mirrored", scaled(FORCE, 1, 1, -1), "y of opposite sign. In .force., give the y force the oppo"),
    Case("axes a quarter round", edit(TOML, LOG, f"{LOG}\nrotation_deg = 90"), "turned by -90 deg. In .force., corr"),
    Case("the log of another push", numbers(FORCE, unlike), "Check that the log is of this push"),
    Case("an empty log", rewrite(FORCE, lambda _: ""), "force.csv is empty"),
    Case("a log of a header", rewrite(FORCE, lambda text: text.splitlines()[0]), "has no rows"),
    Case("semicolons and decimal commas", SPACED, "separated by commas, and decimals written with a point"),
    Case("decimal commas", rewrite(FORCE, lambda text: text.replace(".", ",")), "6 cells.* decimals with a point"),
    Case("times in nanoseconds since 1970", numbers(FORCE, since_1970), "not the second, state time_unit in"),
    Case("semicolons in the tracks", rewrite(MARKERS, lambda text: text.replace(",", ";")), "no semicolons"),
    Case("no place of the push", edit(TOML, "[push]\nat_s = 1.0", ""), "Add `.push.` with `at_s = 1.0`"),
    Case("place of the push in metres", edit(TOML, "at_s = 1.0", "at_s = 0.15"), "beyond the push.* Check at_s in"),
    Case("place of the push in millimetres", edit(TOML, "at_s = 1.0", "at_s = 150"), ":27: .push. at_s must be"),
    Case("mass in grams", edit(TOML, LENGTH, f"{LENGTH}\nmass_kg = 75"), "mass_kg .* is it in kilograms"),
    Case("a misspelt key", edit(TOML, "length_m", "lenght_m"), "does not know the key lenght_m. Did you mean length_m"),
    Case("a misspelt table", edit(TOML, "[push]", "[pushh]"), "does not know the key pushh. Did you mean push"),
    Case("a sensor at its end", numbers(FORCE, cut), "stands at exactly its smallest value, -0.2 N"),
    Case("a sensor with a slow filter", numbers(FORCE, slow), "The force sensor is slow"),
]  # fmt: skip
SLOW = {
    "nothing", "start 6 s off", "grams, the mass known", "millinewtons", "kilonewtons, the mass known",
    "forces of opposite sign", "the robot's force", "one force mirrored", "the log of another push",
    "mass in grams", "a sensor at its end", "axes a quarter round", "forces exchanged", "place of the push in metres",
    "a sensor with a slow filter",
}  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return track_folder(tmp_path_factory.mktemp("made") / "rec", angles=True)


@pytest.mark.parametrize("case", params(CASES, {case.name for case in CASES} - SLOW))
def test_a_mistake_is_named(victim: Victim, made: Path, tmp_path: Path, case: Case) -> None:
    rec = tmp_path / "rec"
    rec.mkdir()
    for file in made.iterdir():
        (rec / file.name).write_bytes(file.read_bytes())
    case.harm(rec)
    outcome = victim.attack(["check", "rec"], tmp_path)
    assert outcome.verdict in ("refused", "done"), outcome.err[-2000:]
    said = " ".join((outcome.err + outcome.out).split())
    if case.passes:
        assert outcome.verdict == "done"
        assert "warning" not in said.lower()
    else:
        assert re.search(case.words, said), said
