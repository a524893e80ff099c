"""k(s) with a band, in marker space: error and coverage on the development recordings, one push and three together."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.truth import RECORDINGS, read_truth, recordings_asked, stiffness_error
from onebend.learning.paper import regress
from onebend.learning.posterior import Posterior, fit
from onebend.recording.observe import observe
from onebend.records import Observations

BEAMS = ("linear", "quadratic", "cubic")
GROUPS = (("train",), ("fast",), ("s08",), ("s06",), ("train", "s08", "s06"))


@dataclass(frozen=True)
class Row:
    """One fit."""

    beam: str
    recordings: str
    k_error: float  # relative RMS over s in [0.05, 0.9]
    inside: float  # share of that range with the truth inside the 95 % band
    sd_middle: float  # of log k, median over that range
    sd_tip: float
    seconds: float
    stopped: str


def row(beam: str, kinds: tuple[str, ...], seen: dict[str, Observations], recordings: Path) -> Row:
    """Fit, and compare with the truth."""
    truth = read_truth(recordings / f"{beam}_train")
    start = regress(seen["train"]).beam.stiffness
    begin = time.perf_counter()
    found: Posterior = fit([seen[kind] for kind in kinds], start)
    seconds = time.perf_counter() - begin
    band = found.band(truth.s)
    middle = (truth.s >= 0.05) & (truth.s <= 0.9)
    inside = (truth.k > band.low) & (truth.k < band.high)
    sd = found.stiffness.log_at(truth.s)[1]
    return Row(
        beam=beam,
        recordings=" + ".join(kinds),
        k_error=stiffness_error(band.k, truth),
        inside=float(np.mean(inside[middle])),
        sd_middle=float(np.median(sd[middle])),
        sd_tip=float(sd[-1]),
        seconds=seconds,
        stopped=found.optimum.stopped,
    )


def rows(recordings: Path = RECORDINGS) -> list[Row]:
    """Every beam and group of recordings."""
    out = []
    for beam in BEAMS:
        seen = {kind: observe(recordings / f"{beam}_{kind}") for kind in ("train", "fast", "s08", "s06")}
        out += [row(beam, kinds, seen, recordings) for kinds in GROUPS]
    return out


def main() -> None:
    found = rows(recordings_asked(__doc__))
    print("| beam | recordings | error of k | truth inside 95 % band | sd of log k, middle / tip | s | stopped |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for r in found:
        print(
            f"| {r.beam} | {r.recordings} | {r.k_error:.3f} | {100 * r.inside:.0f} % "
            f"| {r.sd_middle:.3f} / {r.sd_tip:.2f} | {r.seconds:.1f} | {r.stopped} |"
        )


if __name__ == "__main__":
    main()
