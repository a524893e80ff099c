"""Learning while pushing: k(s) frame by frame against the fit of the whole recording, and the time an update takes."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass

import numpy as np

from benchmarks.studies import LEVELS, S, bench_of, fit_from_nothing
from benchmarks.truth import Truth, parser_of, read_truth, stiffness_error
from onebend.beam.stiffness import UncertainStiffness
from onebend.errors import LearningError, ObservationError
from onebend.lab.virtual import observe_virtual, virtual_recording
from onebend.learning.paper import regress
from onebend.learning.posterior import fit
from onebend.live.learner import OnlineLearner
from onebend.live.replayed import live_frames, replay, settings_for
from onebend.recording.observe import observe
from onebend.records import Array, Observations

BEAMS, KINDS = ("linear", "quadratic", "cubic"), ("train", "fast", "s08", "s06")
START = 0.03  # N m, the live learner's first guess for every beam
CELLS = ("smooth correlated", "smooth everything", "stepped correlated")  # kinds of beams and of errors, see `studies`


@dataclass(frozen=True)
class Row:
    """One recording, live and as a whole."""

    name: str
    error: tuple[float, float]  # relative RMS of k over s in [0.05, 0.9]: live, batch
    inside: tuple[float, float]  # share of that range with the truth inside the 95 % band
    spread: tuple[float, float]  # sd of log k, median over that range
    apart: float  # live less batch in the batch's sd, RMS over that range
    ratio: float  # sd of log k over the batch fit's, median over that range
    wall: Array  # (T,) s, of every update, the least over the repeats: the same is done in all of them
    processor: Array  # (T,) s, the same without waiting for the processor


def replayed(o: Observations) -> tuple[OnlineLearner, Array, Array]:
    """The learner at the end of a recording, and wall and processor time of every update."""
    mass = o.stated.mass if np.isfinite(o.stated.mass) else 0.0
    learner = OnlineLearner(o.length, o.marker_s, START, traced=o.traced, mass=mass, settings=settings_for(o))
    wall, processor = [], []
    for frame in live_frames(o):
        given = vars(frame)
        began = time.perf_counter(), time.thread_time()
        learner.update(**given)
        wall.append(time.perf_counter() - began[0])
        processor.append(time.thread_time() - began[1])
    return learner, np.array(wall), np.array(processor)


def judged(posterior: UncertainStiffness, truth: Truth) -> tuple[float, float, float]:
    """Error, share inside the band, sd."""
    band, middle = posterior.band(truth.s), (truth.s >= 0.05) & (truth.s <= 0.9)
    inside = (truth.k > band.low) & (truth.k < band.high)
    return (
        stiffness_error(band.k, truth),
        float(np.mean(inside[middle])),
        float(np.median(posterior.log_at(truth.s)[1][middle])),
    )


def row(name: str, o: Observations, batch: UncertainStiffness, truth: Truth, repeats: int) -> Row:
    """One recording."""
    runs = [replayed(o) for _ in range(repeats)]
    wall, processor = np.min([run[1] for run in runs], axis=0), np.min([run[2] for run in runs], axis=0)
    live, s = runs[0][0].stiffness, truth.s[(truth.s >= 0.05) & (truth.s <= 0.9)]
    both = list(zip(judged(live, truth), judged(batch, truth), strict=True))
    apart = (live.log_at(s)[0] - batch.log_at(s)[0]) / batch.log_at(s)[1]
    ratio = float(np.median(live.log_at(s)[1] / batch.log_at(s)[1]))
    return Row(name, both[0], both[1], both[2], float(np.sqrt(np.mean(apart**2))), ratio, wall, processor)


@dataclass(frozen=True)
class Case:
    """One virtual recording with its truth, over s in [0.05, 0.9]; live at the end, live when settled, batch."""

    inside: Array  # (3, levels) share of the range with the truth inside the band
    ratio: Array  # (3,) sd of log k over the batch fit's, median over s
    apart: Array  # (3,) away from the batch fit in its sd, RMS over s
    error: Array  # (3,) RMS of log k


def case(cell: str, seed: int) -> Case:
    """A drawn beam, pushed and filmed with errors (`studies.bench_of`)."""
    kind, errors = cell.split()
    bench = bench_of(kind, errors, seed)  # type: ignore[arg-type]
    seen = observe_virtual(virtual_recording(bench, seed=seed))
    batch = fit_from_nothing(seen, gain_sd=bench.declared.gain_sd).stiffness
    truth = np.asarray(bench.beam.stiffness(S))
    learner = replay(seen, START, gain_sd=bench.declared.gain_sd)
    end = learner.stiffness
    learner.settle()
    posteriors = (end, learner.stiffness, batch)
    bands = [[posterior.band(S, level) for level in LEVELS] for posterior in posteriors]
    inside = [[np.mean((truth > band.low) & (truth < band.high)) for band in row] for row in bands]
    log, sd = (np.array([posterior.log_at(S)[i] for posterior in posteriors]) for i in range(2))
    return Case(
        np.array(inside),
        np.median(sd / sd[2], axis=1),
        np.sqrt(np.mean(((log - log[2]) / sd[2]) ** 2, axis=1)),
        np.sqrt(np.mean((log - np.log(truth)) ** 2, axis=1)),
    )


def virtual(runs: int, cells: list[str]) -> None:
    """Coverage of the live band beside the batch fit's."""
    titles = ("cell", "runs", "", "truth inside 50 / 80 / 95 % band", "band over the fit's: 10 % / median / 90 %")
    print("| " + " | ".join((*titles, "from the fit [sd], RMS", "RMS error of log k")) + " |")
    print("| --- " * 7 + "|")
    for cell in cells:
        cases = []
        for seed in range(runs):
            try:
                cases.append(case(cell, seed))
                print(f"\r{seed + 1} of {runs}", end="", file=sys.stderr, flush=True)
            except (LearningError, ObservationError) as wrong:
                print(f"seed {seed}: {wrong}")
        for i, name in enumerate(("live, at the end", "live, settled", "fit")):
            inside = " / ".join(f"{100.0 * v:.0f}" for v in np.mean([one.inside[i] for one in cases], axis=0))
            ratio = " / ".join(f"{q:.2f}" for q in np.percentile([one.ratio[i] for one in cases], (10, 50, 90)))
            apart = np.sqrt(np.mean([one.apart[i] ** 2 for one in cases]))
            error = np.sqrt(np.mean([one.error[i] ** 2 for one in cases]))
            print(f"| {cell} | {len(cases)} | {name} | {inside} % | {ratio} | {apart:.2f} | {error:.3f} |")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--virtual", type=int, metavar="RUNS", help="virtual recordings with truth instead")
    parser.add_argument("--cells", nargs="+", default=list(CELLS), help="of the virtual recordings")
    parser.add_argument("--repeats", type=int, default=3, help="of each recording, for the time an update takes")
    asked = parser.parse_args()
    if asked.virtual is not None:
        virtual(asked.virtual, asked.cells)
        return
    folder = asked.recordings
    rows = []
    for beam in BEAMS:
        seen = {kind: observe(folder / f"{beam}_{kind}") for kind in KINDS}
        start, truth = regress(seen["train"]).beam.stiffness, read_truth(folder / f"{beam}_train")
        rows += [row(f"{beam} {kind}", o, fit([o], start).stiffness, truth, asked.repeats) for kind, o in seen.items()]
    print(
        "| recording | error of k, live / batch | truth inside 95 % band | sd of log k | their ratio "
        "| live - batch [sd] "
        "| update, median / 99 % / slowest [ms] | the same, processor time |"
    )
    print("| --- " * 8 + "|")
    for r in rows:
        times = [
            f"{np.median(t):.2f} / {np.percentile(t, 99):.2f} / {np.max(t):.2f}"
            for t in (1e3 * r.wall, 1e3 * r.processor)
        ]
        print(
            f"| {r.name} | {r.error[0]:.3f} / {r.error[1]:.3f} | {100 * r.inside[0]:.0f} % / {100 * r.inside[1]:.0f} % "
            f"| {r.spread[0]:.3f} / {r.spread[1]:.3f} | {r.ratio:.2f} | {r.apart:.2f} | {times[0]} | {times[1]} |"
        )


if __name__ == "__main__":
    main()
