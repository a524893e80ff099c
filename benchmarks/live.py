"""Live, from pixels to the band: what a frame costs, how late k(s) is, and the band after the last frame"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.truth import parser_of, read_truth
from onebend.live.live import Live, LiveSettings
from onebend.pipeline import Run, learn
from onebend.recording.folder import read_recording
from onebend.recording.force import read_log
from onebend.recording.signals import step
from onebend.recording.video import read_frames
from onebend.records import Array
from tests.live.disturbed import Arrival, Disturbances, play
from tests.live.followed import Followed, follow

BEAMS, KINDS = ("linear", "quadratic", "cubic"), ("train", "fast", "s08", "s06")
S = np.linspace(0.05, 0.9, 60)
ON_THE_WAY = Disturbances(frames_lost=0.01, frames_late=0.01, frame_delay=0.01, samples_lost=0.01, samples_late=0.02)
FLOOR = 0.05  # s, of the latency
PACKET = 0.01  # s of samples that come together


@dataclass(frozen=True)
class Cost:
    """What following one recording costs."""

    name: str
    seconds: float  # s, of the film
    cost: Array  # (T,) s, processor time of a frame and of the samples that came with it, the least over the repeats
    latency: Array  # (T,) s, until k(s) has a frame in it: of stamps and processor time, likewise
    reviews: float  # s, processor time of the reviews
    last: float  # sd of log k after the last frame over that of `learn`, median over S
    paced: Followed | None  # at the recording's own pace, with a process beside


@dataclass(frozen=True)
class Ended:
    """What `finish` makes of one recording, against `learn`."""

    name: str
    ratio: float  # sd of log k over that of `learn`, median over S
    widest: float  # the same, where it is farthest from 1
    apart: float  # k less that of `learn`, in its sd, RMS over S
    inside: float  # share of S where the band holds the truth
    seconds: float  # s, processor time


def arrivals_of(folder: Path, learned: Run) -> list[Arrival]:
    """The recording as it would come in. What of it comes when, the clock that `learn` found says."""
    rec = read_recording(folder)
    log, clock = read_log(rec), learned.recordings[0].source.clock
    assert rec.video is not None
    assert log is not None
    assert clock is not None
    how = replace(ON_THE_WAY, samples_each=max(1, round(PACKET / step(log.time))))
    return list(play(read_frames(rec.video), log, clock.offset, how, seed=1))


def sd_of(run: Run) -> tuple[Array, Array]:
    """log k over S, and its sd."""
    assert run.posterior is not None
    return run.posterior.stiffness.log_at(S)


def cost_of(folder: Path, repeats: int, at_pace: bool) -> Cost:
    """One recording, followed."""
    learned = learn(folder)
    arrivals, paced = arrivals_of(folder, learned), None
    if at_pace:
        with Live(folder) as beside:
            paced = follow(beside, arrivals, at_pace=True)
    runs = []
    for _ in range(repeats):
        live = Live(folder, beside=False)
        runs.append(follow(live, arrivals))
    last = live.state().stiffness
    return Cost(
        name=folder.name.replace("_", " "),
        seconds=float(arrivals[-1].at),
        cost=np.min([run.frame + run.force for run in runs], axis=0),
        latency=np.min([run.latency for run in runs], axis=0),
        reviews=min(run.reviews for run in runs),
        last=np.nan if last is None else float(np.median(last.log_at(S)[1] / sd_of(learned)[1])),
        paced=paced,
    )


def ended(folder: Path) -> Ended:
    """One recording, learned from after its last frame."""
    learned = learn(folder)
    live = Live(folder, settings=LiveSettings(first_review=np.inf), beside=False)
    follow(live, arrivals_of(folder, learned))
    begun = time.process_time()
    run = live.finish()
    seconds = time.process_time() - begun
    (k_here, sd), (k_there, batch_sd) = sd_of(run), sd_of(learned)
    assert run.posterior is not None
    truth, band, ratio = read_truth(folder), run.posterior.band(S), sd / batch_sd
    k = np.interp(S, truth.s, truth.k)
    return Ended(
        name=folder.name.replace("_", " "),
        ratio=float(np.median(ratio)),
        widest=float(ratio[np.argmax(np.abs(np.log(ratio)))]),
        apart=float(np.sqrt(np.mean(((k_here - k_there) / batch_sd) ** 2))),
        inside=float(np.mean((k > band.low) & (k < band.high))),
        seconds=seconds,
    )


def percentiles(seconds: Array, digits: int = 1) -> str:
    """Median, 99 % and largest, ms."""
    known = 1e3 * seconds[np.isfinite(seconds)]
    return " / ".join(f"{q:.{digits}f}" for q in np.percentile(known, (50, 99, 100))) if len(known) else "-"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--repeats", type=int, default=2, help="of each recording, for the time a frame takes")
    parser.add_argument("--pace", action="store_true", help="also with a process beside, in the recording's own time")
    parser.add_argument("--only", nargs="*", metavar="NAME", help="of the recordings")
    parser.add_argument("--cost", nargs="*", metavar="NAME", help="of the recordings, those whose cost is measured")
    asked = parser.parse_args()
    names = [f"{beam}_{kind}" for beam in BEAMS for kind in KINDS] if asked.only is None else asked.only
    costly = names if asked.cost is None else asked.cost
    print(
        "| recording | band over that of `learn`, median | where it differs most | k less that of `learn` [sd] ", end=""
    )
    print("| truth in the band | `finish`, processor time [s] |")
    print("| --- " * 6 + "|", flush=True)
    for name in names:
        r = ended(asked.recordings / name)
        print(f"| {r.name} | {r.ratio:.2f} | {r.widest:.2f} | {r.apart:.2f} | {100 * r.inside:.0f} % ", end="")
        print(f"| {r.seconds:.1f} |", flush=True)
    print()
    print("| recording | a frame [ms] | frames of more than 10 ms | k(s), latency [ms] | later than 50 ms ", end="")
    print("| at pace: tags, latency [ms] | k(s), latency [ms] | reviews [s], of film [s] | band after the last frame |")
    print("| --- " * 9 + "|", flush=True)
    for name in costly:
        c = cost_of(asked.recordings / name, asked.repeats, asked.pace)
        latency = c.latency[np.isfinite(c.latency)]
        paced = "- | -"
        if c.paced is not None:
            paced = f"{percentiles(c.paced.tags_latency[1:], 0)} | {percentiles(c.paced.latency, 0)}"
        print(
            f"| {c.name} | {percentiles(c.cost[1:])} | {100 * np.mean(c.cost[1:] > 0.01):.1f} % "
            f"| {percentiles(latency, 0)} | {100 * np.mean(latency > FLOOR):.1f} % "
            f"| {paced} | {c.reviews:.1f}, {c.seconds:.1f} | {c.last:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
