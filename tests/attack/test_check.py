"""What ends `learn` is said by `check` in seconds, in the same words; and a sound recording is not accused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.attack.family import Case, Harm, edit, rewrite, withstood
from tests.attack.victim import Victim

TOML, FORCE = "recording.toml", "force.csv"
SECOND = "id = 2\ns = 0.666667\nturn_deg = 0"


def forces_times(factor: float) -> Harm:
    """The log in another unit."""

    def change(text: str) -> str:
        head, *rows = text.splitlines()
        table = np.array([[float(cell) for cell in row.split(",")] for row in rows])
        table[:, 1:] *= factor
        return "\n".join([head, *(",".join(f"{value:.9g}" for value in row) for row in table)]) + "\n"

    return rewrite(FORCE, change)


def mirrored(folder: Path) -> None:
    """The log with its first force of the other sign."""
    lines = (folder / FORCE).read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines[1:]]
    turned = [f"{time},{-float(x):.9g},{y}" for time, x, y in rows]
    (folder / FORCE).write_text("\n".join([lines[0], *turned]) + "\n", encoding="utf-8")


def exchanged(text: str) -> str:
    """Two tags in each other's place."""
    return text.replace("id = 1\n", "id = 9\n").replace("id = 2\n", "id = 1\n").replace("id = 9\n", "id = 2\n")


CASES = [
    Case("the force on the robot", edit(TOML, 'acts_on = "beam"', 'acts_on = "robot"'), "opposite sign"),
    Case("axes turned by 90 deg", edit(TOML, "rotation_deg = 0.0", "rotation_deg = 90.0"), "about 0 would fit"),
    Case("axes turned by 180 deg", edit(TOML, "rotation_deg = 0.0", "rotation_deg = 180.0"), "opposite sign"),
    Case("x of opposite sign", mirrored, "far better with x of opposite sign"),
    Case("sound", lambda _: None, passes=True),
    Case("two tags exchanged", rewrite(TOML, exchanged), "stand in the order 1, 2, 3, by their s in the order 2, 1, 3"),
    Case("a tag too many", edit(TOML, "[camera]", "[[tags.on_beam]]\nid = 8\ns = 0.5\n[camera]"), passes=True),
    Case("a tag of another size", edit(TOML, "size_m = 0.012", "size_m = 0.018"), "about 12 mm would fit"),
    Case("a turned tag", edit(TOML, SECOND, SECOND[:-1] + "90"), "tag 2"),
    Case("another picture size", edit(TOML, "width = 1280", "width = 1920"), "is calibrated for pictures of 1920"),
    Case("a start of another day", edit(TOML, "start_s = 255.64", "start_s = 1255.64"), "do not overlap"),
    Case("millinewtons", forces_times(1000.0), r"is [0-9]+ N, [0-9]+ times the beam.s weight"),
    Case("kilonewtons", forces_times(0.001), "Is the log in kilonewtons"),
    Case("milliseconds", edit(TOML, '[force]\nfile', '[force]\ntime_unit = "ms"\nfile'), "do not overlap"),
]  # fmt: skip
# It ends nothing, and is warned of: the film shows where the tool is.
ELSEWHERE = Case("the push said elsewhere", edit(TOML, "at_s = 1.0", "at_s = 0.8"), "shows the tool at s = (0.9|1.0)")


@pytest.mark.slow  # the sound one is checked in tests/test_cli.py, what is said is tested with the parts that say it
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_check_says_what_would_end_learning(victim: Victim, film: Path, case: Case) -> None:
    case.harm(film)
    withstood(victim.attack(["check", "rec"], film.parent), case, seconds=40.0)
    picture = film.parent / "check.png"
    assert np.ptp(np.asarray(Image.open(picture).convert("L"))) > 200


@pytest.mark.slow
@pytest.mark.parametrize("case", [case for case in CASES if not case.passes], ids=lambda case: case.name)
def test_learn_ends_with_the_same(victim: Victim, film: Path, case: Case) -> None:
    case.harm(film)
    outcome = victim.attack(["learn", "rec", "-q", "-o", "out"], film.parent, seconds=400.0)
    withstood(outcome, case, seconds=400.0)


@pytest.mark.slow
def test_a_tool_that_is_elsewhere_is_warned_of(victim: Victim, film: Path) -> None:
    ELSEWHERE.harm(film)
    outcome = victim.attack(["check", "rec"], film.parent)
    assert outcome.verdict == "done", outcome.err[-2000:]
    said = " ".join((outcome.out + outcome.err).split())
    assert re.search(ELSEWHERE.words, said), said
    assert "troubleshooting.md#the-film-shows-the-tool-elsewhere" in said
