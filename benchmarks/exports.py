"""How far each export hangs from the exact beam in its own simulator, and how that falls with the segments."""

from __future__ import annotations

import argparse

import numpy as np

from onebend.export.export import KINDS, Kind
from tests.export.simulators import SIMULATORS
from tests.export.test_round_trip import BEAMS, PUSHES, as_carried, error

COUNTS = (5, 10, 20)
ELEMENTS = 50  # of PyElastica's rod


def row(kind: Kind, name: str) -> str:
    """Errors in % of the length under each load, and the exponent of the number of segments where that is quick."""
    count = ELEMENTS if kind == "pyelastica" else KINDS[kind].hinges
    found = [100.0 * error(kind, as_carried(kind, name), count, push) for push in PUSHES]
    slope = "-"
    if kind not in ("python", "newton", "pyelastica"):
        errors = [error(kind, as_carried(kind, name), n, PUSHES[2]) for n in COUNTS]
        slope = f"{np.polyfit(np.log(COUNTS), np.log(errors), 1)[0]:.2f}"
    return f"| {kind} | {name} | {count} | {' | '.join(f'{one:.2g}' for one in found)} | {slope} |"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", nargs="+", choices=list(SIMULATORS), default=list(SIMULATORS))
    loads = (f"({force[0]:g}, {force[1]:g}) N at s = {s:g}" for force, s in PUSHES)
    print(f"| `--to` | beam | segments | {' | '.join(f'{one} [% L]' for one in loads)} | exponent |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for kind in parser.parse_args().only:
        for name in BEAMS:
            if name != "thick" or "stretch and shear" in KINDS[kind].carries:
                print(row(kind, name), flush=True)


if __name__ == "__main__":
    main()
