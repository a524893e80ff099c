"""Learning while pushing: k(s) frame by frame against the fit of the whole recording, and the time an update takes."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.truth import RECORDINGS, Truth, read_truth, stiffness_error
from onebend.beam.uncertain import UncertainStiffness
from onebend.blas import one_blas_thread
from onebend.learning.learn import learn
from onebend.learning.online import OnlineLearner
from onebend.learning.posterior import fit
from onebend.learning.replay import live_frames, settings_for
from onebend.recording.observe import observe
from onebend.records import Array, Observations

BEAMS, KINDS = ("linear", "quadratic", "cubic"), ("train", "fast", "s08", "s06")
START = 0.03  # N m, the live learner's first guess for every beam


@dataclass(frozen=True)
class Row:
    """One recording, live and as a whole."""

    name: str
    error: tuple[float, float]  # relative RMS of k over s in [0.05, 0.9]: live, batch
    inside: tuple[float, float]  # share of that range with the truth inside the 95 % band
    spread: tuple[float, float]  # sd of log k, median over that range
    apart: float  # live less batch in the batch's sd, RMS over that range
    wall: Array  # (T,) s, of every update
    processor: Array  # (T,) s, the same without waiting for the processor


@one_blas_thread
def replayed(o: Observations) -> tuple[OnlineLearner, Array, Array]:
    """The learner at the end of a recording, and wall and processor time of every update."""
    mass = o.mass if np.isfinite(o.mass) else 0.0
    learner = OnlineLearner(o.length, o.marker_s, START, mass=mass, settings=settings_for(o))
    wall, processor = [], []
    for frame in live_frames(o):
        given = vars(frame)
        began = time.perf_counter(), time.thread_time()
        learner.update(**given)
        wall.append(time.perf_counter() - began[0])
        processor.append(time.thread_time() - began[1])
    return learner, np.array(wall), np.array(processor)


def judged(one: UncertainStiffness, truth: Truth) -> tuple[float, float, float]:
    """Error, share inside the band, sd."""
    band, middle = one.band(truth.s), (truth.s >= 0.05) & (truth.s <= 0.9)
    inside = (truth.k > band.low) & (truth.k < band.high)
    return (
        stiffness_error(band.k, truth),
        float(np.mean(inside[middle])),
        float(np.median(one.log_at(truth.s)[1][middle])),
    )


def row(name: str, o: Observations, batch: UncertainStiffness, truth: Truth) -> Row:
    """One recording."""
    learner, wall, processor = replayed(o)
    live, s = learner.stiffness, truth.s[(truth.s >= 0.05) & (truth.s <= 0.9)]
    both = list(zip(judged(live, truth), judged(batch, truth), strict=True))
    apart = (live.log_at(s)[0] - batch.log_at(s)[0]) / batch.log_at(s)[1]
    return Row(name, both[0], both[1], both[2], float(np.sqrt(np.mean(apart**2))), wall, processor)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=Path, default=RECORDINGS)
    folder = parser.parse_args().recordings
    found = []
    for beam in BEAMS:
        seen = {kind: observe(folder / f"{beam}_{kind}") for kind in KINDS}
        start, truth = learn(seen["train"]).beam.stiffness, read_truth(folder / f"{beam}_train")
        found += [row(f"{beam} {kind}", o, fit([o], start).stiffness, truth) for kind, o in seen.items()]
    print(
        "| recording | error of k, live / batch | truth inside 95 % band | sd of log k | live - batch [sd] "
        "| update, median / 99 % / slowest [ms] | the same, processor time |"
    )
    print("| --- " * 7 + "|")
    for r in found:
        times = [
            f"{np.median(t):.2f} / {np.percentile(t, 99):.2f} / {np.max(t):.2f}"
            for t in (1e3 * r.wall, 1e3 * r.processor)
        ]
        print(
            f"| {r.name} | {r.error[0]:.3f} / {r.error[1]:.3f} | {100 * r.inside[0]:.0f} % / {100 * r.inside[1]:.0f} % "
            f"| {r.spread[0]:.3f} / {r.spread[1]:.3f} | {r.apart:.2f} | {times[0]} | {times[1]} |"
        )


if __name__ == "__main__":
    main()
