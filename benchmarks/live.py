"""Live, from pixels to the band: what a frame costs, how late k(s) is, and the band after the last frame"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.truth import parser_of, read_truth
from onebend.pipeline import learn
from onebend.recording.pairing import read_log
from onebend.recording.signals import step
from onebend.recording.video import read_frames
from onebend.records import Array
from onebend.streaming.live import Live
from onebend.streaming.played import Disturbances, Followed, follow, play

BEAMS, KINDS = ("linear", "quadratic", "cubic"), ("train", "fast", "s08", "s06")
S = np.linspace(0.05, 0.9, 60)
ON_THE_WAY = Disturbances(frames_lost=0.01, frames_late=0.01, frame_delay=0.01, samples_lost=0.01, samples_late=0.02)
FLOOR = 0.05  # s, of the latency
PACKET = 0.01  # s of samples that come together


@dataclass(frozen=True)
class Row:
    """One recording."""

    name: str
    seconds: float  # s, of the film
    cost: Array  # (T,) s, processor time of a frame and of the samples that came with it, the least over the repeats
    latency: Array  # (T,) s, until k(s) has a frame in it: of stamps and processor time, likewise
    reviews: float  # s, processor time of the reviews
    paced: Followed  # at the recording's own pace
    ratios: tuple[float, float]  # sd of log k over that of `learn`, median over S: after the last frame, after `finish`
    apart: float  # k after `finish` less that of `learn`, in its sd, RMS over S
    inside: float  # share of S where the band after `finish` holds the truth
    finish: float  # s, of the clock


def row(folder: Path, repeats: int) -> Row:
    """One recording: its cost, its latency, its bands."""
    live = Live(folder)
    video, log = live.recording.video, read_log(live.recording)
    assert video is not None
    assert log is not None
    run = learn(folder)
    whole, clock = run.posterior, run.recordings[0].source.clock
    assert whole is not None
    assert clock is not None
    frames = list(read_frames(video))
    together = max(1, round(PACKET / step(log.time)))
    arrivals = list(play(frames, log, clock.offset, replace(ON_THE_WAY, samples_each=together), seed=1))
    paced = follow(live, arrivals, at_pace=True)
    last = live.state().stiffness
    begun = time.perf_counter()
    ended = live.finish().posterior
    finish = time.perf_counter() - begun
    runs, reviews = [], []
    for _ in range(repeats):
        here = Live(folder, beside=False)
        runs.append(follow(here, arrivals))
        reviews.append(here.review_seconds)
    assert ended is not None
    (k_here, sd), (k_there, batch_sd) = ended.stiffness.log_at(S), whole.stiffness.log_at(S)
    truth = read_truth(folder)
    band, k = ended.band(S), np.interp(S, truth.s, truth.k)
    return Row(
        name=folder.name.replace("_", " "),
        seconds=frames[-1].time,
        cost=np.min([run.frame + run.force for run in runs], axis=0),
        latency=np.min([run.latency for run in runs], axis=0),
        reviews=min(reviews),
        paced=paced,
        ratios=(
            np.nan if last is None else float(np.median(last.log_at(S)[1] / batch_sd)),
            float(np.median(sd / batch_sd)),
        ),
        apart=float(np.sqrt(np.mean(((k_here - k_there) / batch_sd) ** 2))),
        inside=float(np.mean((k > band.low) & (k < band.high))),
        finish=finish,
    )


def percentiles(seconds: Array, digits: int = 1) -> str:
    """Median, 99 % and largest, ms."""
    known = 1e3 * seconds[np.isfinite(seconds)]
    return " / ".join(f"{q:.{digits}f}" for q in np.percentile(known, (50, 99, 100))) if len(known) else "-"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--repeats", type=int, default=2, help="of each recording, for the time a frame takes")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="of the recordings")
    asked = parser.parse_args()
    names = asked.only or [f"{beam}_{kind}" for beam in BEAMS for kind in KINDS]
    rows = []
    for name in names:
        rows.append(row(asked.recordings / name, asked.repeats))
        print(f"{name}: {rows[-1].ratios}", file=sys.stderr, flush=True)
    print(
        "| recording | a frame [ms] | frames of more than 10 ms | k(s), latency [ms] | later than 50 ms "
        "| tags at pace, latency [ms] | k(s) at pace, latency [ms] | reviews [s], of film [s] |"
    )
    print("| --- " * 8 + "|")
    for r in rows:
        latency = r.latency[np.isfinite(r.latency)]
        print(
            f"| {r.name} | {percentiles(r.cost[1:])} | {100 * np.mean(r.cost[1:] > 0.01):.1f} % "
            f"| {percentiles(latency, 0)} | {100 * np.mean(latency > FLOOR):.1f} % "
            f"| {percentiles(r.paced.tags_latency[1:], 0)} | {percentiles(r.paced.latency, 0)} "
            f"| {r.reviews:.1f}, {r.seconds:.1f} |"
        )
    print()
    print(
        "| recording | band over that of `learn`: after the last frame | after `finish` | k of `finish` less that of "
        "`learn` [sd] | truth in the band | `finish` [s] |"
    )
    print("| --- " * 6 + "|")
    for r in rows:
        print(
            f"| {r.name} | {r.ratios[0]:.2f} | {r.ratios[1]:.2f} | {r.apart:.2f} | {100 * r.inside:.0f} % "
            f"| {r.finish:.1f} |"
        )


if __name__ == "__main__":
    main()
