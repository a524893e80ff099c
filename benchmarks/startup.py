"""Start-up: processor time of light commands, beside a Python that does nothing and one that loads NumPy."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.stiffness import UncertainStiffness
from onebend.results.model import save_model

REPEATS = 5
EXAMPLE = Path(__file__).parents[1] / "examples" / "linear-beam" / "train"
FLOORS = {  # s; the command's words after `python`
    ("-c", "pass"): None,
    ("-c", "import numpy"): None,
    ("-c", "import onebend"): 0.3,
    ("-m", "onebend", "--version"): 0.25,
    ("-m", "onebend", "--help"): 0.5,
    ("-m", "onebend", "learn", "--help"): 0.7,
    ("-m", "onebend", "batch", "--help"): 0.7,
    ("-m", "onebend", "population", "--help"): 0.7,
    ("-m", "onebend", "show", "MODEL"): 1.0,
    ("-m", "onebend", "check", "REC"): 1.0,
    ("-m", "onebend", "reach", "MODEL", "--goal", "0.12", "0.08"): 1.0,
}


def seconds(command: list[str]) -> float:
    """s, least processor time of the repeats."""
    spent = []
    for _ in range(REPEATS):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *command], check=True, stdout=subprocess.DEVNULL, env=bare())
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(spent)


def bare() -> dict[str, str]:
    """The environment without settings of BLAS threads."""
    return {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}


def model(folder: Path) -> Path:
    """A learned beam with a band."""
    knots = np.array([0.0] * 4 + [1.0] * 4)
    band = UncertainStiffness(knots, np.full(4, np.log(0.02)), 1e-3 * np.eye(4))
    path = folder / "model.json"
    save_model(path, Beam(0.15, band.profile), written_by="a benchmark", uncertain=band)
    return path


def main() -> None:
    print("| command | processor time [s] | floor [s] | over `python -c pass` | over `import numpy` |")
    print("| --- " * 5 + "|")
    with tempfile.TemporaryDirectory() as place:
        given = {"MODEL": str(model(Path(place))), "REC": str(EXAMPLE)}
        found = {words: seconds([given.get(word, word) for word in words]) for words in FLOORS}
    nothing, numpy = list(found.values())[:2]
    for words, spent in found.items():
        floor = FLOORS[words]
        said = "" if floor is None else f"{floor:g}" + ("" if spent <= floor else ", missed")
        print(f"| `python {' '.join(words)}` | {spent:.3f} | {said} | {spent / nothing:.1f} | {spent / numpy:.1f} |")


if __name__ == "__main__":
    main()
