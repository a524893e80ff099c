"""k(s) from pushes of real benches: virtual recordings with effects drawn at random, learned by the fit.

Beams, tags, pushes and clocks are those of `onebend.lab.random_bench`, effects those of `onebend.lab.random_bench`
that poses and force show; the rod that is pushed is `onebend.lab.rod`, which shares nothing with the
fit's statics. Shares are of places s from 0.05 to 0.9 of the push's place; k is the truth of `true_stiffness`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from onebend.errors import LearningError, MechanicsError, ObservationError
from onebend.lab.bench import TagNoise
from onebend.lab.random_bench import (
    EFFECTS,
    LABORATORY,
    OF_THE_PICTURE,
    BenchRanges,
    Chance,
    EffectRanges,
    random_bench,
)
from onebend.lab.virtual import VirtualBench, VirtualRecording, observe_virtual, true_stiffness, virtual_recording
from onebend.learning.attribution import FORCE_SCALE
from onebend.learning.posterior import Posterior, fit, stiffness_of
from onebend.records import Array, Observations
from tests.lab.effects.chosen import only

IN_POSES = tuple(name for name in EFFECTS if name not in OF_THE_PICTURE)
CELLS = ("all", "small", *(f"only {name}" for name in IN_POSES), "none")
SENSORS = ("wrist", "ideal")  # as large as a robot's own errors are, they hide the effects
CAMERA = TagNoise(white_xy=1e-5, white_angle=4e-4, slow_xy=1e-5, slow_angle=4e-4, slow_time=0.2)
LEVELS = (0.5, 0.8, 0.95)
# As LABORATORY, and what goes beyond the sds of the fit's priors there is within them.
SMALL = replace(
    LABORATORY,
    patches=Chance(0.5, 1.1, 1.8),
    clamp=Chance(0.4, 0.05, 0.4),
    tags=Chance(0.6, 1e-4, 5e-4),
    gain=Chance(0.6, 0.0, 0.03),
    posture=Chance(0.5, 0.002, 0.02),
)
CAUSES = {  # of a bench's only effect, as the verdict names them
    "stretch": ("stretch and shear",),
    "relaxation": ("relaxation",),
    "patches": ("stiff tags",),
    "rest": ("rest shape",),
    "inertia": ("inertia", "mass"),
    "clamp": ("clamp that gives",),
    "slide": ("sliding contact",),
    "push_off": ("place of the push",),
    "length": ("length",),
    "tags": ("places of the tags",),
    "gain": (FORCE_SCALE,),
    "posture": ("posture-dependent bias",),
    "none": (),
}
PLACES = 60
LOST = 0.85  # a run of which less is inside the 95 % band and that is trusted is counted
WIDTHS = (0.0, 0.02, 0.03, 0.05, np.inf)  # of the sd of log k, that runs are sorted by
ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Outcome:
    """One fit against its truth."""

    cell: str
    seed: int
    failure: str = ""
    smooth: bool = True  # neither steps nor a joint
    inside: tuple[float, ...] = ()  # share of places inside the bands of LEVELS
    identified: float = float("nan")  # share of places
    error: float = float("nan")  # RMS of k / truth - 1
    width: float = float("nan")  # mean sd of log k
    converged: bool = False
    trusted: bool = False
    seconds: float = float("nan")  # of the fit
    frames: int = 0
    named: tuple[str, ...] = ()  # what the verdict names, the most important first
    sure: tuple[str, ...] = ()  # of these, what the data show clearly
    level: float = float("nan")  # mean of log k / truth
    gain: float = float("nan")  # log of the sensor's true gain, which shifts this


def ranges_of(cell: str) -> EffectRanges:
    """The effects of a cell; of those of the picture none."""
    if cell in ("all", "small"):
        every = LABORATORY if cell == "all" else SMALL
        chance = {name: replace(getattr(every, name), probability=0.0) for name in OF_THE_PICTURE}
        return replace(every, **chance)
    return only(*(cell.split()[1:] if cell != "none" else ()))


def bench_of(cell: str, seed: int) -> tuple[VirtualBench, bool]:
    """A bench that stands its push, and whether its beam is smooth; those of one seed differ in their effects alone."""
    rng = np.random.default_rng([seed, 31])
    kind = ("smooth", "smooth", "smooth", "stepped", "joint")[seed % 5]
    chance = BenchRanges(kinds=(kind,), sensors=SENSORS, effects=ranges_of(cell))  # type: ignore[arg-type]
    bench = random_bench(rng, chance, name=f"{cell} {seed}").bench
    return replace(bench, camera=CAMERA), kind == "smooth"


def with_tags(bench: VirtualBench, seed: int) -> tuple[Observations, VirtualRecording]:
    """One push."""
    made = virtual_recording(bench, seed=seed)
    return observe_virtual(made), made


Observing = Callable[[VirtualBench, int], tuple[Observations, VirtualRecording]]


def run(cell: str, seed: int, observed: Observing = with_tags) -> Outcome:
    """Make, observe, fit, compare; a cell may begin with words of its own and ": "."""
    smooth = True
    try:
        bench, smooth = bench_of(cell.split(": ")[-1], seed)
        seen, made = observed(bench, seed)
        began = time.perf_counter()
        found = fit([seen], gain_sd=bench.declared.gain_sd)
        seconds = time.perf_counter() - began
    except (LearningError, MechanicsError, ObservationError) as wrong:
        return Outcome(cell, seed, failure=f"{type(wrong).__name__}: {wrong}", smooth=smooth)
    s = np.linspace(0.05, 0.9 * bench.push.at_s, PLACES)
    truth = true_stiffness(made.bench, made.motion, s).k
    gain = float(np.log(bench.sensor.gain))
    outcome = compared(found, s, truth, Outcome(cell, seed, smooth=smooth, gain=gain))
    return replace(outcome, seconds=seconds, frames=len(seen.time))


def compared(found: Posterior, s: Array, truth: Array, outcome: Outcome) -> Outcome:
    """`outcome` with a fit against k (S,) at `s`: its band as it is, whatever the verdict."""
    stiffness = stiffness_of(found.problem, found.optimum, found.gain_sd)
    bands = [stiffness.band(s, level) for level in LEVELS]
    told = found.band(s)
    return replace(
        outcome,
        inside=tuple(float(np.mean((truth > b.low) & (truth < b.high))) for b in bands),
        identified=float(np.mean(told.identified)),
        error=float(np.sqrt(np.mean((told.k / truth - 1.0) ** 2))),
        width=float(np.mean(np.log(bands[-1].high / bands[-1].low)) / (2.0 * 1.96)),
        converged=found.optimum.converged,
        trusted=not found.doubts,
        named=tuple(one.name for one in found.attributions if one.matters),
        sure=tuple(one.name for one in found.attributions if one.matters and one.sure),
        level=float(np.mean(np.log(told.k / truth))),
    )


def kept(name: str = "real-bench") -> Path:
    """The file that runs of this very code are added to."""
    digest = hashlib.sha256()
    for source in sorted([*(ROOT / "src").rglob("*.py"), Path(__file__)]):
        digest.update(source.read_bytes())
    return ROOT / "out" / "benchmarks" / f"{name}-{digest.hexdigest()[:12]}.jsonl"


def study(
    wanted: Sequence[tuple[str, int]], jobs: int, path: Path, run: Callable[[str, int], Outcome] = run
) -> dict[tuple[str, int], Outcome]:
    """Do what `path` does not hold yet, and add it there."""
    done: dict[tuple[str, int], Outcome] = {}
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            data = json.loads(line)
            lists = {name: tuple(value) for name, value in data.items() if isinstance(value, list)}
            one = Outcome(**(data | lists))
            done[one.cell, one.seed] = one
    path.parent.mkdir(parents=True, exist_ok=True)
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    with path.open("a", encoding="utf-8") as lines, ProcessPoolExecutor(jobs) as pool:
        waiting = [pool.submit(run, *one) for one in wanted if one not in done]
        for count, job in enumerate(as_completed(waiting), 1):
            one = job.result()
            done[one.cell, one.seed] = one
            lines.write(json.dumps(asdict(one)) + "\n")
            lines.flush()
            print(f"\r{count}/{len(waiting)} {one.cell} ", end="", file=sys.stderr, flush=True)
    return {one: done[one] for one in wanted}


def row(name: str, runs: Sequence[Outcome]) -> str:
    """The table's row of one cell."""
    good = [r for r in runs if not r.failure]
    if not good:
        return f"| {name} | {len(runs)} ({len(runs)}) |" + " - |" * 8
    inside = 100.0 * np.mean([r.inside for r in good], axis=0)
    known = 100.0 * float(np.mean([r.identified for r in good]))
    error = 100.0 * float(np.median([r.error for r in good]))
    smooth = [r.error for r in good if r.smooth]
    even = f"{100.0 * float(np.median(smooth)):.1f}" if smooth else "-"
    width = 100.0 * float(np.median([r.width for r in good]))
    wrong = sum(r.trusted and r.inside[-1] < LOST for r in good)
    seconds = float(np.median([r.seconds for r in good]))
    return (
        f"| {name} | {len(runs)} ({len(runs) - len(good)}) | {' / '.join(f'{share:.0f}' for share in inside)} "
        f"| {known:.0f} | {error:.1f} | {even} | {width:.1f} | {sum(r.converged for r in good)} "
        f"| {sum(r.trusted for r in good)} ({wrong}) | {seconds:.1f} |"
    )


def reliability(runs: Sequence[Outcome]) -> str:
    """Shares inside the bands, by the width of the band."""
    bands = " / ".join(f"{100 * level:.0f}" for level in LEVELS)
    lines = [
        f"| sd of log k [%] | runs | truth inside {bands} % band [%] | k off, RMS, median [%] |",
        "| --- " * 4 + "|",
    ]
    for low, high in pairwise(WIDTHS):
        here = [r for r in runs if low <= r.width < high]
        if here:
            inside = " / ".join(f"{100 * share:.0f}" for share in np.mean([r.inside for r in here], axis=0))
            name = f"{100 * low:.0f} to {100 * high:.0f}" if np.isfinite(high) else f"{100 * low:.0f} and more"
            lines.append(f"| {name} | {len(here)} | {inside} | {100 * np.median([r.error for r in here]):.1f} |")
    return "\n".join(lines)


def judged(names: Sequence[str], causes: Sequence[str]) -> str:
    """Whether the first of the `names` is one of the `causes`."""
    return "none" if not names else "right" if names[0] in causes else "wrong"


def named_first(runs: Sequence[Outcome]) -> str:
    """What the verdict named first, by the effect that a bench had."""
    lines = [
        "| the only effect | runs | named first: right / none / wrong | of what the data show clearly | named first |",
        "| --- " * 5 + "|",
    ]
    for effect, causes in CAUSES.items():
        here = [r for r in runs if r.cell.split(": ")[-1].removeprefix("only ") == effect and not r.failure]
        if not here:
            continue
        traced = here[0].cell.startswith(("outline: ", "both: "))  # what is traced has errors on every bench
        causes = (*causes, "outline") if traced else causes
        each = [r.named for r in here], [r.sure for r in here]
        said = [Counter(judged(names, causes) for names in every) for every in each]
        shares = [" / ".join(str(count[word]) for word in ("right", "none", "wrong")) for count in said]
        first = Counter(r.named[0] if r.named else "nothing" for r in here).most_common()
        words = ", ".join(f"{name}: {count}" for name, count in first)
        lines.append(f"| {effect} | {len(here)} | {shares[0]} | {shares[1]} | {words} |")
    return "\n".join(lines)


def head() -> str:
    """Of the table of `row`."""
    bands = " / ".join(f"{100 * level:.0f}" for level in LEVELS)
    return (
        f"| effects | runs (failed) | truth inside {bands} % band [%] | identified [%] | k off, RMS, median [%] "
        "| smooth beams [%] | sd of log k, median [%] | converged "
        f"| trusted (with < {100 * LOST:.0f} % inside) | fit [s] |\n" + "| --- " * 10 + "|"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=40, help="with all effects, large and small")
    parser.add_argument("--each", type=int, default=8, help="with one effect at a time, and with none")
    parser.add_argument("--first", type=int, default=0, help="seed of the first run")
    parser.add_argument("--cells", nargs="*", metavar="CELL", help=f"parts of their names; of {', '.join(CELLS)}")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--kept", type=Path, help="file that the runs are added to; default: one a version of the code")
    asked = parser.parse_args()
    cells = [cell for cell in CELLS if not asked.cells or any(part in cell for part in asked.cells)]
    count = {cell: asked.runs if cell in ("all", "small") else asked.each for cell in cells}
    wanted = [(cell, asked.first + i) for cell in cells for i in range(count[cell])]
    done = study(wanted, asked.jobs, asked.kept or kept())
    print(head())
    for cell in cells:
        print(row(cell, [one for (name, _), one in done.items() if name == cell]))
    every = [one for one in done.values() if not one.failure]
    print(row("all of these", every), "", reliability(every), "", named_first(every), sep="\n")


if __name__ == "__main__":
    main()
