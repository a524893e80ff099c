"""What a plan promises against what the fit then gives: the band after one more push, predicted and obtained."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.truth import RECORDINGS
from onebend.beam.uncertain import UncertainStiffness
from onebend.learning.learn import learn
from onebend.learning.planning import after_push
from onebend.learning.posterior import fit
from onebend.learning.proposals import PLACES
from onebend.learning.workbench import bench_of, push_of
from onebend.recording.observe import observe
from onebend.records import Observations

BEAMS = ("linear", "quadratic", "cubic")
OTHERS = ("s08", "s06")


@dataclass(frozen=True)
class Row:
    """One more push on one beam; widths are means over s of the 95 % band of log k."""

    beam: str
    added: str
    before: float
    predicted: float
    obtained: float
    worst: tuple[float, float]  # widths at the worst place, predicted and obtained


def widths(known: UncertainStiffness) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """(101,) of the band of log k."""
    return np.asarray(2.0 * 1.959964 * known.log_at(PLACES)[1])


def rows(recordings: Path = RECORDINGS) -> list[Row]:
    """From the training push alone, what each of the others would add; then both fitted together."""
    out = []
    for beam in BEAMS:
        seen: dict[str, Observations] = {k: observe(recordings / f"{beam}_{k}") for k in ("train", *OTHERS)}
        start = learn(seen["train"]).beam.stiffness
        alone = fit([seen["train"]], start)
        bench = bench_of(alone)
        for other in OTHERS:
            promised = widths(after_push(alone.stiffness, alone.beam, bench, push_of(seen[other])))
            both = widths(fit([seen["train"], seen[other]], start).stiffness)
            before = float(np.mean(widths(alone.stiffness)))
            worst = (float(np.max(promised)), float(np.max(both)))
            out.append(Row(beam, other, before, float(np.mean(promised)), float(np.mean(both)), worst))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=Path, default=RECORDINGS)
    print("Mean width of the 95 % band of log k; of a push only place, mean direction and largest force are used.\n")
    print("| beam | added to train | before | predicted | obtained | ratio | at worst: predicted / obtained |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for r in rows(parser.parse_args().recordings):
        print(
            f"| {r.beam} | {r.added} | {r.before:.3f} | {r.predicted:.3f} | {r.obtained:.3f} "
            f"| {r.predicted / r.obtained:.2f} | {r.worst[0]:.2f} / {r.worst[1]:.2f} |"
        )


if __name__ == "__main__":
    main()
