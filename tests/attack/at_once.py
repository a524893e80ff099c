"""Processes that publish into one folder at once. Run as a script: it forks.

    python at_once.py FOLDER ROUNDS PROCESSES [force]

What was found goes to standard output as JSON: how the processes of a round ended that did not leave one whole result.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from pathlib import Path

from onebend.errors import ResultsError
from tests.attack.killing import run, state_of


def once(root: Path, processes: int, force: bool) -> tuple[list[str], str]:
    """One round: how each process ended, and the folder after."""
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    if force:
        run(root / "out", "old")
    start = time.monotonic() + 0.02
    pipes = [one(root / "out", f"p{i}", start, force) for i in range(processes)]
    ends = []
    for child, pipe in pipes:
        with os.fdopen(pipe, encoding="utf-8") as stream:
            ends.append(stream.read())
        os.waitpid(child, 0)
    try:
        state = state_of(root / "out")
    except AssertionError as error:
        return ends, str(error)
    left = sorted(path.name for path in root.iterdir())
    return ends, state if left == ["out"] else f"left behind: {left}"


def one(out: Path, mark: str, start: float, force: bool) -> tuple[int, int]:
    """A process that begins at `start`; its id, and where it says how it ended."""
    reading, writing = os.pipe()
    child = os.fork()
    if child:
        os.close(writing)
        return child, reading
    os.close(reading)
    time.sleep(max(start - time.monotonic(), 0.0))
    try:
        run(out, mark, overwrite=force)
        said = "done"
    except ResultsError as error:
        said = str(error)
    except BaseException as error:
        said = f"fault: {error!r}"
    os.write(writing, said.encode())
    os._exit(0)


def main(folder: str, rounds: str, processes: str, force: str = "") -> None:
    """Every round must have one winner (with --force perhaps several in turn); the others are refused, and the folder
    is that of a winner."""
    faults, busy = [], 0
    for _ in range(int(rounds)):
        ends, state = once(Path(folder), int(processes), bool(force))
        winners = [f"p{i}" for i, said in enumerate(ends) if said == "done"]
        refused = [said for said in ends if "is being written by process" in said or "already holds results" in said]
        busy += sum("is being written by process" in said for said in ends)
        one_won = state in winners and (force or len(winners) == 1)
        if not one_won or len(refused) + len(winners) != int(processes):
            faults.append([ends, state])
    sys.stdout.write(json.dumps({"rounds": int(rounds), "busy": busy, "faults": faults}))


if __name__ == "__main__":
    vars(os)["fsync"] = lambda _: None
    main(*sys.argv[1:])
