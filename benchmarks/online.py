"""Learning while pushing: k(s) frame by frame against the fit of the whole recording, and the time an update takes."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

import numpy as np

from benchmarks.studies import ERRORS, S, bench_of, fit_from_nothing
from benchmarks.studies import KINDS as BEAM_KINDS
from benchmarks.truth import Truth, parser_of, read_truth, stiffness_error
from onebend.beam.uncertain import UncertainStiffness
from onebend.blas import one_blas_thread
from onebend.errors import LearningError, ObservationError
from onebend.lab.virtual import observe_virtual, virtual_recording
from onebend.learning.learn import learn
from onebend.learning.online import OnlineLearner
from onebend.learning.posterior import fit
from onebend.learning.replay import live_frames, replay, settings_for
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


@dataclass(frozen=True)
class Case:
    """One virtual recording with its truth, over s in [0.05, 0.9]; live at the end, live when settled, batch."""

    inside: Array  # (3, S) whether the 95 % band holds the truth
    ratio: tuple[float, float]  # sd of log k over the batch fit's, median over s
    error: tuple[float, float, float]  # RMS of log k


def case(seed: int, errors: str) -> Case:
    """A drawn beam, pushed and filmed with errors of all kinds (`studies.bench_of`)."""
    bench = bench_of(BEAM_KINDS[seed % len(BEAM_KINDS)], errors, seed)
    seen = observe_virtual(virtual_recording(bench, seed=seed))
    batch = fit_from_nothing(seen, gain_sd=bench.said.gain_sd).stiffness
    truth = np.asarray(bench.beam.stiffness(S))
    learner = replay(seen, START, gain_sd=bench.said.gain_sd)
    end = learner.stiffness
    learner.settle()
    found = (end, learner.stiffness, batch)
    inside = [(truth > band.low) & (truth < band.high) for band in (one.band(S) for one in found)]
    sd = [one.log_at(S)[1] for one in found]
    error = [float(np.sqrt(np.mean((one.log_at(S)[0] - np.log(truth)) ** 2))) for one in found]
    ratio = float(np.median(sd[0] / sd[2])), float(np.median(sd[1] / sd[2]))
    return Case(np.array(inside), ratio, (error[0], error[1], error[2]))


def virtual(runs: int, errors: str) -> None:
    """Coverage of the live band beside the batch fit's."""
    found = []
    for seed in range(runs):
        try:
            found.append(case(seed, errors))
            print(f"\r{seed + 1} of {runs}", end="", file=sys.stderr, flush=True)
        except (LearningError, ObservationError) as wrong:
            print(f"seed {seed}: {wrong}")
    print(
        "| errors | runs | | truth inside 95 % band | band over the fit's: 10 % / median / 90 % | RMS error of log k |"
    )
    print("| --- " * 6 + "|")
    for i, name in enumerate(("live, at the end", "live, settled", "fit")):
        inside = 100.0 * np.mean([one.inside[i] for one in found])
        ratio = (
            "1"
            if i == 2
            else " / ".join(f"{q:.2f}" for q in np.percentile([one.ratio[i] for one in found], (10, 50, 90)))
        )
        error = np.sqrt(np.mean([one.error[i] ** 2 for one in found]))
        print(f"| {errors} | {len(found)} | {name} | {inside:.0f} % | {ratio} | {error:.3f} |")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--virtual", type=int, metavar="RUNS", help="virtual recordings with truth instead")
    parser.add_argument("--errors", default="everything", choices=ERRORS, help="of the virtual recordings")
    asked = parser.parse_args()
    if asked.virtual is not None:
        virtual(asked.virtual, asked.errors)
        return
    folder = asked.recordings
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
