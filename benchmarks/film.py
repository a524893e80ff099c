"""From pixels to k(s) and back to the truth: films of random benches learned from, and their tags against the truth.

Each run draws a beam, its tags and mounting, a camera, a scene, a sensor and a clock, films a slow push, learns from
the folder as a user would, and compares. `inside` counts the places s = 0.05 to 0.9 that the fit calls identified and
whose 95 % band holds the true k, with the standard error over whole runs; `without a warning` are runs in which nothing
was said against the result. Runs are kept in out/film: the next call goes on from there (take another file when the
fit has changed).
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
import time
import warnings
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.film_tags import twins_table
from benchmarks.markers import errors
from benchmarks.truth import Truth, parser_of, read_truth
from onebend.beam.stiffness import Band, half_width
from onebend.errors import OnebendError
from onebend.lab.filming import Filming, film
from onebend.lab.random_bench import LABORATORY, BenchRanges, random_bench
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import Posterior
from onebend.pipeline import learn
from onebend.progress import Progress, Silent
from onebend.recording.camera import measure_markers
from onebend.recording.entries import TagsEntry, VideoEntry
from onebend.recording.folder import read_recording
from onebend.recording.observe import ObserveSettings
from onebend.recording.tags import detect_tags
from onebend.records import Array, BoolArray, Detections

SMOOTH = 12.0  # of the slope of log k over s: steeper are steps and joints, which a smooth prior rounds off
VAGUE = 0.1  # of the peak: a force no better known than this
S = np.linspace(0.05, 0.9, 35)
KEPT = Path(__file__).parents[1] / "out" / "film"
STREAM = 77  # of the random numbers of benches
# Shorter and coarser films than a laboratory's best, so that 50 of them are affordable: contact of 4 to 7 s, some
# cameras of 640 x 480, some at 10 frames/s.
DRAWN = BenchRanges(
    seconds=(4.0, 7.0),
    sides=((640, 480), (1280, 720), (1280, 720), (1920, 1080)),
    fps=(10.0, 15.0, 24.0, 30.0),
)


@dataclass(frozen=True)
class Run:
    """One film, learned from."""

    seed: int
    sensor: str
    camera: str = ""  # its picture, px
    steepest: float = 0.0  # of log k over s, its size
    peak: float = 0.0  # N, of the push
    slack: float = 0.0  # sd of the force's error that comes and goes with the load, over the peak
    failure: str = ""
    frames: int = 0
    film_seconds: float = 0.0  # of one core
    learn_seconds: float = 0.0  # of one core
    place: float = 0.0  # m RMS, tags against the truth
    angle: float = 0.0  # rad RMS
    claimed: float = 0.0
    seen: float = 0.0  # share of tags
    inside: float = 0.0  # share of the identified places
    inside_narrow: tuple[float, ...] = (np.nan, np.nan)  # that of the 50 and the 80 % band
    inside_all: float = 0.0  # share of all places, identified or not
    identified: float = 0.0  # share of the places
    error: float = 0.0  # RMS of log k over the identified places
    width: float = 0.0  # RMS of half the 95 % band of log k there, over that of a normal of sd 1
    warnings: tuple[str, ...] = ()


@dataclass
class Keeping:
    """Finds tags and keeps what was found."""

    found: Detections | None = None

    def __call__(
        self, video: VideoEntry, tags: TagsEntry, *, threads: int | None = None, progress: Progress = Silent()
    ) -> Detections:
        self.found = detect_tags(video, tags, threads=threads, progress=progress)
        return self.found


def run(seed: int, effects: bool = False) -> Run:
    """Film the bench of a seed, with the effects of real benches where asked for, learn, compare."""
    ranges = replace(DRAWN, effects=LABORATORY) if effects else DRAWN
    filming = random_bench(np.random.default_rng([STREAM, seed]), ranges, name=f"drawn-{seed}")
    with tempfile.TemporaryDirectory() as place, warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return learned(filming, Path(place) / "film", seed)


def learned(filming: Filming, folder: Path, seed: int) -> Run:
    """Film a bench into `folder`, learn, compare."""
    camera, began = filming.camera, time.process_time()
    bench = filming.bench
    slack = np.sqrt(2.0) * bench.sensor.reversal / bench.push.peak
    size = f"{camera.width} x {camera.height}"
    begun = Run(seed, filming.sensor_name, size, peak=bench.push.peak, slack=float(slack))
    try:
        film(filming, folder, seed=seed)
    except OnebendError as wrong:
        return replace(begun, failure=f"film: {wrong}")
    filmed, started = time.process_time() - began, time.process_time()
    detect, truth = Keeping(), read_truth(folder)
    begun = replace(begun, steepest=float(np.max(np.abs(np.gradient(np.log(truth.k), truth.s)))))
    try:
        found = learn(folder, fitting=FitSettings(), observing=ObserveSettings(threads=1), detect=detect)
    except OnebendError as wrong:
        return replace(begun, failure=f"learn: {wrong}", film_seconds=filmed)
    assert found.posterior is not None
    assert detect.found is not None
    place, angle, claimed = errors(measure_markers(detect.found, read_recording(folder)), truth)
    made = replace(
        begun,
        frames=len(truth.time),
        film_seconds=filmed,
        learn_seconds=time.process_time() - started,
        place=place,
        angle=angle,
        claimed=claimed,
        seen=float(np.isfinite(detect.found.corners).all(axis=(2, 3)).mean()),
        warnings=tuple(one.text for one in found.remarks if one.level == "warning"),
    )
    return against(made, found.posterior, truth)


def against(made: Run, posterior: Posterior, truth: Truth) -> Run:
    """A run with its band compared with the true k(s)."""
    band, k = posterior.band(S), np.interp(S, truth.s, truth.k)
    held, known = _held(band, k), band.identified
    sd = np.log(band.high / band.low) / (2.0 * half_width(1.0))
    some = bool(known.any())
    return replace(
        made,
        inside=float(held[known].mean()) if some else float("nan"),
        inside_narrow=tuple(
            float(_held(posterior.band(S, level), k)[known].mean()) if some else float("nan") for level in (0.5, 0.8)
        ),
        inside_all=float(held.mean()),
        identified=float(known.mean()),
        error=float(np.sqrt(np.mean(np.log(band.k[known] / k[known]) ** 2))) if some else float("nan"),
        width=float(np.sqrt(np.mean(sd[known] ** 2))) if some else float("nan"),
    )


def _held(band: Band, k: Array) -> BoolArray:
    return np.asarray((band.low <= k) & (k <= band.high))


def study(seeds: range, jobs: int, kept: Path, effects: bool = False) -> list[Run]:
    """Runs of these seeds; those in the file `kept` are not made again, each new one is added to it."""
    done = {one.seed: one for one in read(kept)}
    wanted = [seed for seed in seeds if seed not in done]
    if wanted:
        kept.parent.mkdir(parents=True, exist_ok=True)
        os.environ["OPENBLAS_NUM_THREADS"] = "1"  # of the processes that start now
        with ProcessPoolExecutor(jobs) as pool, kept.open("a", encoding="utf-8") as file:
            futures = {pool.submit(run, seed, effects): seed for seed in wanted}
            for future in as_completed(futures):
                try:
                    one = future.result()
                except Exception as wrong:  # a fault of the program: told as such, and tried again by the next call
                    done[futures[future]] = Run(futures[future], "", failure=f"crashed: {wrong!r}")
                    continue
                done[one.seed] = one
                file.write(json.dumps(asdict(one)) + "\n")
                file.flush()
    return [done[seed] for seed in sorted(done) if seed in seeds]


def read(kept: Path) -> list[Run]:
    """The runs of a file; a line that was cut off is left out."""
    found = []
    for line in kept.read_text(encoding="utf-8").splitlines() if kept.is_file() else []:
        with contextlib.suppress(json.JSONDecodeError):
            data: dict[str, Any] = json.loads(line)
            lists = {name: tuple(value) for name, value in data.items() if isinstance(value, list)}
            found.append(Run(**{**data, **lists}))
    return found


def study_table(runs: Sequence[Run]) -> str:
    """A row a sensor, and one for those without a warning."""
    lines = [
        "| films | runs | not learned | inside the 50, 80 % band | inside the 95 % band | identified "
        "| error of log k (median) | claimed sd (median) | place [mm] (median) | angle [deg] (median) | claimed chi^2 "
        "| learn [s] |",
        "| " + "--- | " * 12,
    ]
    groups = {"all": list(runs)}
    groups |= {"k(s) smooth": [one for one in runs if one.steepest < SMOOTH and not one.failure]}
    groups |= {"k(s) with steps or a joint": [one for one in runs if one.steepest >= SMOOTH]}
    groups |= {sensor: [one for one in runs if one.sensor == sensor] for sensor in sorted({r.sensor for r in runs})}
    groups |= {"force known to a tenth of its peak": [one for one in runs if one.slack < VAGUE]}
    groups |= {"force known no better": [one for one in runs if one.slack >= VAGUE]}
    groups["without a warning"] = [one for one in runs if not one.warnings and not one.failure]
    for name, group in groups.items():
        good = [one for one in group if not one.failure]
        share = np.array([one.inside for one in good if np.isfinite(one.inside)])
        if not len(share):
            continue
        identified = 100 * np.mean([one.identified for one in good])
        narrow = 100.0 * np.nanmean([one.inside_narrow for one in good], axis=0)
        spread = share.std(ddof=1) / np.sqrt(len(share)) if len(share) > 1 else float("nan")
        middle = {
            key: float(np.nanmedian([getattr(one, key) for one in good]))
            for key in ("error", "width", "place", "angle", "claimed", "learn_seconds")
        }
        lines.append(
            f"| {name} | {len(group)} | {len(group) - len(good)} | {narrow[0]:.0f}, {narrow[1]:.0f} % "
            f"| {100 * share.mean():.1f} ± {100 * spread:.1f} % "
            f"| {identified:.0f} % | {middle['error']:.3f} | {middle['width']:.3f} "
            f"| {1e3 * middle['place']:.4f} | {np.degrees(middle['angle']):.4f} | {middle['claimed']:.2f} "
            f"| {middle['learn_seconds']:.0f} |"
        )
    return "\n".join(lines)


def runs_table(runs: Iterable[Run]) -> str:
    """A row a run: the share of the identified places, and of all, that its band holds."""
    lines = [
        "| run | sensor | camera | frames | push [N] | steepest log k | inside, identified | inside, all | identified "
        "| error of log k | claimed sd | place [mm] | film, learn [s of one core] |",
        "| " + "--- | " * 13,
    ]
    for one in runs:
        name = f"| {one.seed} | {one.sensor} | {one.camera} "
        if one.failure:
            lines.append(name + "| " * 10 + "|")
            continue
        shares = " | ".join(f"{100.0 * v:.0f} %" for v in (one.inside, one.inside_all, one.identified))
        sizes = f"{one.error:.3f} | {one.width:.3f} | {1e3 * one.place:.4f}"
        times = f"{one.film_seconds:.0f}, {one.learn_seconds:.0f}"
        lines.append(f"{name}| {one.frames} | {one.peak:.2g} | {one.steepest:.0f} | {shares} | {sizes} | {times} |")
    return "\n".join(lines)


def odd_runs(runs: Iterable[Run]) -> str:
    """Every run that was not learned, or whose band holds less than nine tenths of the identified places, and why."""
    lines = ["| run | sensor | seen | inside | error of log k | claimed sd | what it said |", "| " + "--- | " * 7]
    for one in runs:
        if one.failure or not one.inside >= 0.9:
            said = (one.failure or "; ".join(one.warnings) or "nothing").replace("\n", " ").replace("|", "/")
            lines.append(
                f"| {one.seed} | {one.sensor} | {100 * one.seen:.0f} % | {100 * one.inside:.0f} % | {one.error:.3f} "
                f"| {one.width:.3f} | {said} |"
            )
    return "\n".join(lines)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="seed of the first run")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--effects", action="store_true", help="draw the effects of real benches too")
    parser.add_argument("--kept", type=Path, help=f"file that the runs are added to; default: one of {KEPT}")
    parser.add_argument("--no-twins", action="store_true", help="leave out the films of the named designs")
    asked = parser.parse_args()
    kept = asked.kept or KEPT / ("runs-effects.jsonl" if asked.effects else "runs.jsonl")
    runs = study(range(asked.first, asked.first + asked.runs), asked.jobs, kept, asked.effects)
    print(study_table(runs))
    print(f"\nEvery run:\n\n{runs_table(runs)}")
    print(f"\nRuns to look at:\n\n{odd_runs(runs)}")
    if not asked.no_twins:
        print(f"\nTags of films and of the development recordings:\n\n{twins_table(asked.recordings)}")


if __name__ == "__main__":
    main()
