"""One beam, many recordings: time and memory of learning them together, and what it gives.

Every number of recordings runs in a process of its own. Time is processor time and the wall's, memory the process's
largest; the base is the process before the fit. The fit shares its work among threads, one a core that it may use, and
begins no other process, so that this is all of its memory.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np

from onebend.lab.random_bench import BenchRanges, random_bench, random_push
from onebend.lab.virtual import virtual_recording
from onebend.learning.posterior import fit
from onebend.progress import available_cores
from tests.lab.from_truth import observe_from_truth

COUNTS = (1, 3, 10, 30, 100)
S = np.linspace(0.02, 0.98, 49)


def one(count: int) -> dict[str, float]:
    """Learned from so many recordings."""
    bench = random_bench(np.random.default_rng(5), BenchRanges(kinds=("smooth",))).bench
    seen = []
    for number in range(count):
        push = random_push(np.random.default_rng([5, number]), bench.beam, BenchRanges())
        made = virtual_recording(replace(bench, push=push, name=f"{number}"), seed=number)
        seen.append(observe_from_truth(made, clock_sd=0.003))
    before, wall, processor = peak_mb(), time.perf_counter(), time.process_time()
    found = fit(seen)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    band, k = found.band(S), np.asarray(bench.beam.stiffness(S))
    known = band.identified
    return {
        "recordings": count,
        "frames": int(sum(np.sum(r.frames) for r in found.recordings)),
        "processor_s": processor,
        "wall_s": wall,
        "MB": peak_mb(),
        "base_MB": before,
        "off": float(np.sqrt(np.mean(np.log(band.k / k)[known] ** 2))),
        "inside": float(np.mean(((k >= band.low) & (k <= band.high))[known])),
        "width": float(np.median(0.5 * np.log(band.high / band.low)[known])),
    }


def peak_mb() -> float:
    """Of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", type=int, nargs="*", default=list(COUNTS))
    parser.add_argument("--one", type=int, help="this number alone, as JSON")
    arguments = parser.parse_args()
    if arguments.one is not None:
        print(json.dumps(one(arguments.one)))
        return
    print(f"Cores: {available_cores()}\n")
    print(
        "| recordings | frames | processor [s] | wall [s] | MB (before) | k off [%] | in the 95 % band [%] "
        "| band +- [%] |"
    )
    print("| --- " * 8 + "|")
    times = []
    for count in arguments.counts:
        command = [sys.executable, "-m", "benchmarks.joint", "--one", str(count)]
        run = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        times.append(run["processor_s"])
        print(
            f"| {count} | {run['frames']} | {run['processor_s']:.1f} | {run['wall_s']:.1f} | {run['MB']:.0f} "
            f"({run['base_MB']:.0f}) | {100 * run['off']:.1f} | {100 * run['inside']:.0f} | {100 * run['width']:.1f} |",
            flush=True,
        )
    if len(times) > 2:
        slope = np.polyfit(np.log(arguments.counts), np.log(times), 1)[0]
        print(f"\nSlope of the logs of processor time and recordings: {slope:.2f}")


if __name__ == "__main__":
    main()
