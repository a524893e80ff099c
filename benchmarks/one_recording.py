"""One recording, learned: processor time and memory of the whole process, with the report and without.

The film is searched for its tags every time; the modules' bytecode and Matplotlib's list of fonts are kept from a run
before, as they are where onebend is installed. Processor time is that of all threads, system time included; its floor
is `goal`. Stages are seconds of the wall, so they depend on what else the machine does.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.truth import RECORDINGS

NAME = "linear_train"  # 18 s at 30 frames a second
GOALS = {(): 6.0, ("--no-report",): 3.5}  # s of processor time, by the command's options


def learned(folder: Path, options: tuple[str, ...], installed: str) -> tuple[float, float, dict[str, float]]:
    """s of processor time, MB at the peak, and s of the wall by stage, of one run that finds no tags kept; in
    `installed` it finds what belongs to the programs."""
    with tempfile.TemporaryDirectory() as place:
        said = Path(place) / "said.json"
        words = ["onebend", "learn", str(folder), "-o", f"{place}/out", "--json", "--quiet", *options]
        command = [sys.executable, "-m", *words]
        own = {"PYTHONPYCACHEPREFIX": f"{installed}/bytecode", "MPLCONFIGDIR": f"{installed}/fonts"}
        environment = {**os.environ, **own, "XDG_CACHE_HOME": f"{place}/cache"}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        output = os.open(said, os.O_WRONLY | os.O_CREAT)
        actions = [(os.POSIX_SPAWN_DUP2, output, 1)]
        process = os.posix_spawn(sys.executable, command, environment, file_actions=actions)
        _, status, used = os.wait4(process, 0)
        os.close(output)
        if status:
            raise RuntimeError(f"{' '.join(words)} ended with {os.waitstatus_to_exitcode(status)}")
        stages = json.loads(said.read_text(encoding="utf-8"))["stage_seconds"]
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0, stages


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recording", type=Path, default=RECORDINGS / NAME)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    began, load = time.process_time(), os.getloadavg()[0]
    for i in range(3_000_000):  # how quick the machine is just now
        began += 0.0 * i
    loop = time.process_time() - began
    print(f"{arguments.recording.name}; load of the machine {load:.1f}, three million additions take {loop:.2f} s.\n")
    print("| command | processor time [s], median | least | goal | MB at the peak |\n" + "| --- " * 5 + "|")
    stages: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as installed:
        learned(arguments.recording, (), installed)
        for options, goal in GOALS.items():
            runs = [learned(arguments.recording, options, installed) for _ in range(arguments.repeats)]
            spent = [seconds for seconds, _, _ in runs]
            stages = stages or runs[0][2]
            print(
                f"| `{' '.join(('learn', *options))}` | {statistics.median(spent):.1f} | {min(spent):.1f} | {goal:g} "
                f"| {max(mb for _, mb, _ in runs):.0f} |",
                flush=True,
            )
    print("\n| stage | s of the wall |\n| --- | --- |")
    for name, seconds in stages.items():
        print(f"| {name} | {seconds:.2f} |")


if __name__ == "__main__":
    main()
