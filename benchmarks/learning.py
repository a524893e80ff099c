"""k(s) and validation on the development recordings: the paper's literal rows and the weighted ones.

Two sets of inputs: the files as they are, and perfect markers and forces (what the estimator itself costs).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.truth import RECORDINGS, Truth, perfect, read_truth, recordings_asked, stiffness_error
from onebend.errors import LearningError
from onebend.learning.paper import Method, RegressionSettings, regress
from onebend.learning.validation import validate
from onebend.recording.observe import observe
from onebend.records import Observations

BEAMS = ("linear", "quadratic", "cubic")
OTHERS = ("fast", "s08", "s06")


@dataclass(frozen=True)
class Row:
    """One method on one training recording."""

    beam: str
    inputs: str  # "files" or "perfect"
    method: Method
    n: int
    m: int
    k_error: float
    training_mm: tuple[float, ...]
    validation_mm: dict[str, tuple[float, ...]]  # M1, M2, M3 of each validation recording
    failure: str = ""


def row(beam: str, method: Method, inputs: str, seen: dict[str, Observations], truth: Truth) -> Row:
    """Learn the training push, validate on the others (with the same kind of inputs)."""
    try:
        learned = regress(seen[f"{beam}_train"], RegressionSettings(method=method))
    except LearningError as error:
        return Row(beam, inputs, method, 0, 0, np.nan, (), {}, str(error))
    best = learned.trials[learned.chosen]
    checks = {
        other: tuple(float(1e3 * r) for r in validate(learned.beam, seen[f"{beam}_{other}"]).rms) for other in OTHERS
    }
    k_error = stiffness_error(np.asarray(learned.beam.stiffness(truth.s)), truth)
    return Row(beam, inputs, method, best.n, best.m, k_error, tuple(float(1e3 * r) for r in best.rms), checks)


def rows(recordings: Path = RECORDINGS) -> list[Row]:
    """All beams, both methods, both kinds of inputs."""
    out: list[Row] = []
    for beam in BEAMS:
        names = [f"{beam}_{kind}" for kind in ("train", *OTHERS)]
        truths = {name: read_truth(recordings / name) for name in names}
        seen = {name: observe(recordings / name) for name in names}
        exact = {name: perfect(seen[name], truths[name]) for name in names}
        for inputs, given in (("files", seen), ("perfect", exact)):
            for method in ("paper", "regression"):
                out.append(row(beam, method, inputs, given, truths[f"{beam}_train"]))
    return out


def markdown(found: list[Row]) -> str:
    """The rows as a table."""
    head = "| beam | inputs | method | n, m | error of k | training M1, M2, M3 [mm] | " + " | ".join(
        f"{other} [mm]" for other in OTHERS
    )
    lines = [head + " |", "| --- " * (6 + len(OTHERS)) + "|"]
    for r in found:
        if r.failure:
            lines.append(f"| {r.beam} | {r.inputs} | {r.method} | - | {r.failure[:80]} |" + " |" * (1 + len(OTHERS)))
            continue
        checks = " | ".join(", ".join(f"{v:.2f}" for v in r.validation_mm[other]) for other in OTHERS)
        training = ", ".join(f"{v:.2f}" for v in r.training_mm)
        lines.append(f"| {r.beam} | {r.inputs} | {r.method} | {r.n}, {r.m} | {r.k_error:.3f} | {training} | {checks} |")
    return "\n".join(lines)


def main() -> None:
    print(markdown(rows(recordings_asked(__doc__))))


if __name__ == "__main__":
    main()
