"""Of the mistakes that `learn` suffers from, how many `check` speaks of: `python -m tests.attack.share`.

`learn` suffers where it refuses, or where what it finds is in doubt. `check` speaks where it refuses, warns, or says
the words that the case asks for.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from pathlib import Path

from tests.attack.family import Case
from tests.attack.table import LEARN, Prepare, on_film, on_tracks
from tests.attack.test_check import CASES as FILMS, ELSEWHERE
from tests.attack.test_mistakes import CASES as MISTAKES
from tests.attack.victim import Outcome, Victim

GROUPS: dict[str, tuple[list[Case], Prepare]] = {
    "users' mistakes in tracks": (MISTAKES, on_tracks),
    "users' mistakes in a film": ([*FILMS, ELSEWHERE], on_film),
}


def suffers(outcome: Outcome, results: Path) -> bool:
    """Whether nothing came of it, or nothing to be trusted."""
    if outcome.verdict != "done":
        return True
    return bool(json.loads((results / "model.json").read_text(encoding="utf-8"))["uncertain"]["doubts"])


def speaks(outcome: Outcome, case: Case) -> bool:
    said = " ".join((outcome.out + outcome.err).split())
    return outcome.verdict == "refused" or "warning" in said.lower() or bool(case.words and re.search(case.words, said))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", metavar="WORDS", help="groups whose names hold these words")
    asked = parser.parse_args()
    sys.stdout.write("| mistakes | cases | learn suffers | of these check speaks | check, s of work at most |\n")
    sys.stdout.write("| --- | --- | --- | --- | --- |\n")
    with Victim() as victim:
        for name, (cases, prepare) in GROUPS.items():
            if asked.only in name:
                sys.stdout.write(row(victim, name, cases, prepare) + "\n")
                sys.stdout.flush()


def row(victim: Victim, name: str, cases: list[Case], prepare: Prepare) -> str:
    suffered = spoken = 0
    longest = 0.0
    for case in cases:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            prepare(folder, case)
            checked = victim.attack(["check", "rec"], folder)
            learned = victim.attack(LEARN, folder, seconds=400.0)
            longest = max(longest, checked.work_s)
            if suffers(learned, folder / "out"):
                suffered += 1
                spoken += speaks(checked, case)
                if not speaks(checked, case):
                    sys.stderr.write(f"{name}: {case.name}: check says nothing\n")
    return f"| {name} | {len(cases)} | {suffered} | {spoken} | {longest:.1f} |"


if __name__ == "__main__":
    main()
