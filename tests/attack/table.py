"""The attacks as a table: `python -m tests.attack.table` runs every case and counts how the program ended."""

from __future__ import annotations

import argparse
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from onebend.results.model import save_model
from tests.attack.conftest import EXAMPLE
from tests.attack.family import Case
from tests.attack.hostile_bags import BAG, CASES as BAGS
from tests.attack.hostile_films import CASES as HARD
from tests.attack.test_absurd_options import CASES as OPTIONS, REQUESTS, prepare as with_model_and_goals
from tests.attack.test_bench_poses import CASES as BENCHES, on_example
from tests.attack.test_check import CASES as FILMS, ELSEWHERE
from tests.attack.test_hostile_films import CASES as HOSTILE
from tests.attack.test_hostile_text import CSV_CASES, FILE_CASES, MODEL_CASES, TOML_CASES
from tests.attack.test_mistakes import CASES as MISTAKES
from tests.attack.victim import Outcome, Victim
from tests.made_up import BEAM
from tests.recording.tracked import track_folder
from tests.whole.test_sources import CASES as SOURCES, prepare as with_sources, recorded

LEARN = ["learn", "rec", "-q", "-o", "out"]
COLUMNS = ("cases", "clear error", "done, rightly", "traceback", "hang", "crash", "silent", "other words")
Prepare = Callable[[Path, Case], None]


@dataclass(frozen=True)
class Family:
    """Cases, what is attacked, and the command lines that must withstand."""

    name: str
    cases: Sequence[Case]
    prepare: Prepare  # makes what is attacked in an empty folder, and harms it
    arguments: Callable[[Case], Sequence[object]]
    seconds: float = 120.0


def on_tracks(folder: Path, case: Case) -> None:
    case.harm(track_folder(folder / "rec", angles=True))


def on_film(folder: Path, case: Case) -> None:
    case.harm(Path(shutil.copytree(EXAMPLE, folder / "rec")))


def on_model(folder: Path, case: Case) -> None:
    save_model(folder / "model.json", BEAM, written_by="a test")
    case.harm(folder / "model.json")


def on_model_and_tracks(folder: Path, case: Case) -> None:
    track_folder(folder / "rec", angles=True)
    on_model(folder, case)


def on_bag(folder: Path, case: Case) -> None:
    on_tracks(folder, case)
    bag = next(name for name in BAG.values() if (folder / "rec" / name).exists())
    file = folder / "rec" / "recording.toml"
    text = file.read_text(encoding="utf-8").replace('file = "force.csv"', f'file = "{bag}"\ntopic = "/wrench"')
    file.write_text(text.replace("[force]\n", '[force]\nfield = "x"\n') if "IDL" in case.name else text)


TEXT = (*TOML_CASES, *CSV_CASES, *FILE_CASES)
FAMILIES = (
    Family("text, check", TEXT, on_tracks, lambda _: ["check", "rec"]),
    Family("text, learn", TEXT, on_tracks, lambda _: LEARN, 400.0),
    Family("model.json, show", MODEL_CASES, on_model, lambda _: ["show", "model.json"]),
    Family("model.json, sense", MODEL_CASES, on_model_and_tracks, lambda _: ["sense", "model.json", "rec", "-q"]),
    Family("bags, check", BAGS, on_bag, lambda _: ["check", "rec"]),
    Family("bench poses and frequencies, check", BENCHES, on_example, lambda _: ["check", "rec"]),
    Family("films, check", [*HOSTILE, *HARD], on_film, lambda _: ["check", "rec"]),
    Family(
        "options",
        OPTIONS,
        lambda folder, _: with_model_and_goals(folder),
        lambda case: REQUESTS[case.name],
    ),
    Family("sources of record", SOURCES, lambda folder, _: with_sources(folder), lambda case: recorded(case.name)),
    Family("users' mistakes in tracks, check", MISTAKES, on_tracks, lambda _: ["check", "rec"]),
    Family("users' mistakes in a film, check", [*FILMS, ELSEWHERE], on_film, lambda _: ["check", "rec"]),
    Family("users' mistakes in a film, learn", [c for c in FILMS if not c.passes], on_film, lambda _: LEARN, 400.0),
)


def ended(outcome: Outcome, case: Case) -> str:
    """The column in which one case counts. A mistake that is warned of counts as a clear error."""
    words = " ".join((outcome.err + outcome.out).split())
    if outcome.verdict in ("traceback", "hang", "crash"):
        return outcome.verdict
    if case.passes:
        return "done, rightly" if outcome.verdict == "done" else "other words"
    if re.search(case.words, words) and (outcome.verdict == "refused" or case.words):
        return "clear error"
    return "silent" if outcome.verdict == "done" else "other words"


def row(victim: Victim, family: Family) -> str:
    """One row of the table."""
    counts: Counter[str] = Counter()
    for case in family.cases:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            family.prepare(folder, case)
            how = ended(victim.attack(family.arguments(case), folder, seconds=family.seconds), case)
        counts[how] += 1
        if how not in ("clear error", "done, rightly"):
            sys.stderr.write(f"{family.name}: {case.name}: {how}\n")
    return f"| {family.name} | " + " | ".join([str(len(family.cases)), *(str(counts[c]) for c in COLUMNS[1:])]) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", metavar="WORDS", help="families whose names hold these words")
    asked = parser.parse_args()
    sys.stdout.write("| family | " + " | ".join(COLUMNS) + " |\n" + "| --- " * (len(COLUMNS) + 1) + "|\n")
    with Victim() as victim:
        for family in FAMILIES:
            if asked.only in family.name:
                sys.stdout.write(row(victim, family) + "\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
