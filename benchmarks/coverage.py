"""The band of k(s) in the marker-space fit: how often the truth is inside, by kind of beam and of errors."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.studies import ERRORS, KINDS, LEVELS, OWN, Run, run
from onebend.records import Array

EVERY = tuple(f"{kind} {errors}" for kind in KINDS for errors in ERRORS) + OWN
# Bias, gain and clock alone add little to what "correlated" shows; they are in "everything".
CELLS = (
    *(f"smooth {errors}" for errors in ("white", "correlated", "tags", "everything")),
    *(f"{kind} {errors}" for kind in ("stepped", "joint") for errors in ("correlated", "everything")),
    *OWN,
)
MADE_BY = ("studies.py", "in_family.py")  # beside src, what runs depend on
ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Share:
    """A share of places, and its standard error when whole runs are drawn."""

    value: float
    error: float

    def __str__(self) -> str:
        return f"{100 * self.value:.0f} ± {100 * self.error:.0f}"


@dataclass(frozen=True)
class Cell:
    """All runs of one kind."""

    name: str
    runs: int
    failed: int
    coverage: tuple[Share, ...]  # of the bands of LEVELS, over identified places
    everywhere: tuple[Share, ...]  # the same over all places
    identified: float  # share of places
    rms_error: float  # of log k, identified places
    rms_sd: float
    z_variance: float  # mean of (error / sd)^2
    clock_z: float  # root mean square of clock error / sd; NaN where the clock is right as written
    seconds: float  # median


def share(hits: Array, counts: Array) -> Share:
    """Sum of `hits` (R,) over sum of `counts` (R,); error of the ratio by linearisation, runs being independent."""
    total = float(np.sum(counts))
    if total == 0.0:
        return Share(np.nan, np.nan)
    value = float(np.sum(hits)) / total
    runs = len(hits)
    spread = np.sqrt(np.sum((hits - value * counts) ** 2) * runs / max(runs - 1, 1)) / total
    return Share(value, float(spread))


def summary(name: str, runs: Sequence[Run]) -> Cell:
    """The table's row of a cell."""
    good = [r for r in runs if not r.failure]
    if not good:
        none = (Share(np.nan, np.nan),) * len(LEVELS)
        return Cell(name, len(runs), len(runs), none, none, *[np.nan] * 6)
    inside, known = np.array([r.inside for r in good]), np.array([r.identified for r in good])
    error, sd = np.array([r.error for r in good]), np.array([r.sd for r in good])
    clock = [r.clock_error / r.clock_sd for r in good if r.clock_sd > 0.0]
    return Cell(
        name=name,
        runs=len(runs),
        failed=len(runs) - len(good),
        coverage=tuple(share(np.sum(inside[:, i] & known, axis=1), np.sum(known, axis=1)) for i in range(len(LEVELS))),
        everywhere=tuple(
            share(np.sum(inside[:, i], axis=1), np.full(len(good), inside.shape[2])) for i in range(len(LEVELS))
        ),
        identified=float(np.mean(known)),
        rms_error=float(np.sqrt(np.mean(error[known] ** 2))),
        rms_sd=float(np.sqrt(np.mean(sd[known] ** 2))),
        z_variance=float(np.mean((error[known] / sd[known]) ** 2)),
        clock_z=float(np.sqrt(np.mean(np.square(clock)))) if any(clock) else np.nan,
        seconds=float(np.median([r.seconds for r in good])),
    )


def efficiency(name: str, runs: Sequence[Run]) -> str:
    """A row of the table of squared errors over the least possible ones, for the thirds of the beam: means over runs,
    each in units of its own, so that a draw of which little can be known does not outweigh all others."""
    good = [r for r in runs if r.thirds_variance]
    error, least = (np.array([getattr(r, what) for r in good]) for what in ("thirds_error", "thirds_variance"))
    squares, off = error**2, "-"
    if name.startswith("fixed"):
        bias = error.mean(axis=0)
        squares = (error - bias) ** 2 * len(good) / max(len(good) - 1, 1)
        off = " / ".join(f"{b:+.2f}" for b in bias / np.sqrt(least.mean(axis=0)))
    ratio = squares / least
    errors = ratio.std(axis=0, ddof=1) / np.sqrt(len(good))
    ratios = " / ".join(f"{one:.2f} ± {by:.2f}" for one, by in zip(ratio.mean(axis=0), errors, strict=True))
    return f"| {name} | {len(good)} | {ratios} | {off} |"


def markdown(cells: Iterable[Cell]) -> str:
    """The table."""
    levels = " / ".join(f"{100 * level:.0f}" for level in LEVELS)
    lines = [
        f"| beams, errors | runs (failed) | inside {levels} % band, identified s [%] | the same, all s [%] "
        "| identified [%] | RMS error of log k | RMS sd | variance of z | clock z | s |",
        "| --- " * 10 + "|",
    ]
    lines += [
        f"| {c.name} | {c.runs} ({c.failed}) | {' / '.join(map(str, c.coverage))} "
        f"| {' / '.join(map(str, c.everywhere))} | {100 * c.identified:.0f} | {c.rms_error:.3f} | {c.rms_sd:.3f} "
        f"| {c.z_variance:.2f} | {'-' if np.isnan(c.clock_z) else f'{c.clock_z:.2f}'} | {c.seconds:.1f} |"
        for c in cells
    ]
    return "\n".join(lines)


def kept() -> Path:
    """The file that runs of this very code are added to: its name holds a digest of the sources."""
    digest = hashlib.sha256()
    for source in sorted([*(ROOT / "src").rglob("*.py"), *(ROOT / "benchmarks" / n for n in MADE_BY)]):
        digest.update(source.read_bytes())
    return ROOT / "out" / "benchmarks" / f"coverage-{digest.hexdigest()[:12]}.jsonl"


def read(path: Path) -> dict[tuple[str, int], Run]:
    """Runs done before. The last line may have been cut off; it is done again."""
    found: dict[tuple[str, int], Run] = {}
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                one = Run.from_dict(json.loads(line))
            except (json.JSONDecodeError, KeyError, TypeError):
                continue
            found[one.cell, one.seed] = one
    return found


def study(cells: Sequence[str], runs: int, jobs: int, path: Path) -> dict[tuple[str, int], Run]:
    """Do what `path` does not hold yet, seed by seed over all cells, and add it there."""
    done = read(path)
    todo = [(cell, seed) for seed in range(runs) for cell in cells if (cell, seed) not in done]
    path.parent.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    with path.open("a", encoding="utf-8") as lines, ProcessPoolExecutor(jobs) as pool:
        waiting = [pool.submit(run, cell, seed) for cell, seed in todo]
        for count, one in enumerate(as_completed(waiting), 1):
            result = one.result()
            done[result.cell, result.seed] = result
            lines.write(json.dumps(result.as_dict()) + "\n")
            lines.flush()
            left = (time.monotonic() - began) / count * (len(todo) - count)
            print(f"\r{count}/{len(todo)} runs, {left / 60:.1f} min left ", end="", file=sys.stderr, flush=True)
    return done


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=40, help="of each cell")
    parser.add_argument("--cells", nargs="*", metavar="CELL", help=f"parts of their names; of {', '.join(EVERY)}")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--kept", type=Path, help="file that the runs are added to; default: one a version of the code")
    asked = parser.parse_args()
    cells = [c for c in EVERY if any(part in c for part in asked.cells)] if asked.cells else list(CELLS)
    done = study(cells, asked.runs, asked.jobs, asked.kept or kept())
    runs = {c: [r for (cell, seed), r in done.items() if cell == c and seed < asked.runs] for c in cells}
    print(markdown(summary(cell, of) for cell, of in runs.items()))
    own = [cell for cell in cells if any(r.thirds_variance for r in runs[cell])]
    if own:
        print(
            "\n| from the fit's own model | runs | variance over the least possible, thirds of the beam | bias / sd |"
        )
        print("| --- " * 4 + "|")
    for cell in own:
        print(efficiency(cell, runs[cell]))


if __name__ == "__main__":
    main()
