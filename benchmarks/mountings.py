"""Two recordings of one beam, mounted anew between them: does the band hold the beam's own k(s)?

Each mounting has its own level, slope and bow of log k around the beam's. Their sizes are drawn from the fit's own
prior (half-Cauchy, cut off at 0.2 of the level), or are what is named.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.grid import Modes
from onebend.beam.stiffness import Table
from onebend.lab.random_bench import PLACES, BenchRanges, random_bench, random_push
from onebend.lab.virtual import virtual_recording
from onebend.learning.allowances import BETWEEN_SD
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import fit
from onebend.progress import available_cores, leave_interrupts_to_parent, one_blas_thread
from onebend.records import Array, BoolArray
from tests.lab.from_truth import observe_from_truth

_SHAPES: Array = Modes(len(BETWEEN_SD)).curvature(PLACES)
S = np.linspace(0.02, 0.98, 49)
LARGEST = 4.0  # factor on the prior's sizes: 0.2 of the level
NAMED = {"drawn": np.nan, "0": 0.0, "0.05": 1.0, "0.11": 2.2}  # one sd of the level, as a factor on the prior's


@dataclass(frozen=True)
class Pair:
    """One made pair, or as many recordings as are asked for."""

    inside: BoolArray  # (S,)
    known: BoolArray  # (S,) where k is identified
    error: float  # of log k, root mean square where identified
    width: float  # half the 95 % band, median of the same
    found: float  # one sd between recordings
    true: float


@one_blas_thread
def pair(size: str, seed: int, count: int) -> Pair:
    """Made and learned."""
    rng = np.random.default_rng([seed, 77])
    factor = NAMED[size]
    while np.isnan(factor) or factor > LARGEST:
        factor = abs(float(rng.standard_cauchy()))
    bench = random_bench(rng, BenchRanges(pushed_at=(1.0,))).bench
    own, seen = np.log(bench.beam.stiffness(PLACES)), []
    for number in range(count):
        of_mounting = _SHAPES @ (factor * BETWEEN_SD * rng.standard_normal(3))
        stiffness = Table(tuple(PLACES.tolist()), tuple(np.exp(own + of_mounting).tolist()))
        beam = replace(bench.beam, stiffness=stiffness)
        mounted = replace(bench, beam=beam, push=random_push(rng, bench.beam, BenchRanges()), name=str(number))
        seen.append(observe_from_truth(virtual_recording(mounted, seed=seed), clock_sd=0.003))
    found = fit(seen, settings=FitSettings(first_frames=40, most_frames=60), gain_sd=bench.declared.gain_sd)
    band, k = found.band(S), np.asarray(bench.beam.stiffness(S))
    known = band.identified
    some = known if known.any() else np.ones_like(known)
    return Pair(
        (k >= band.low) & (k <= band.high),
        known,
        float(np.sqrt(np.mean(np.log(band.k / k)[some] ** 2))),
        float(np.median(0.5 * np.log(band.high / band.low)[some])),
        found.mountings[0],
        factor * float(np.sqrt(np.sum(BETWEEN_SD**2 / (2.0 * np.arange(3) + 1.0)))),
    )


def row(size: str, count: int, pairs: list[Pair]) -> str:
    """Of the table."""
    inside = np.array([np.sum(one.inside & one.known) for one in pairs], dtype=float)
    places = np.array([np.sum(one.known) for one in pairs], dtype=float)
    share = float(inside.sum() / places.sum())
    error = float(np.sqrt(np.sum((inside - share * places) ** 2)) / places.sum())
    median = [float(np.median([getattr(one, what) for one in pairs])) for what in ("error", "width", "true", "found")]
    numbers = " | ".join(f"{100 * value:.1f}" for value in median)
    return f"| {size} | {count} | {len(pairs)} | {100 * share:.0f} ± {100 * error:.0f} | {numbers} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200, help="of each row")
    parser.add_argument("--rows", nargs="*", default=["drawn:2", "0:2", "0.05:2", "0.11:2", "0.11:5"])
    arguments = parser.parse_args()
    print(
        "| one sd of the level between mountings | recordings | runs | in the 95 % band [%] | k off [%] "
        "| band +- [%] | true sd of log k between [%] | found [%] |\n" + "| --- " * 8 + "|"
    )
    with ProcessPoolExecutor(available_cores(), initializer=leave_interrupts_to_parent) as pool:
        for one in arguments.rows:
            size, count = one.split(":")
            every = range(arguments.runs)
            pairs = list(pool.map(pair, [size] * arguments.runs, every, [int(count)] * arguments.runs))
            print(row(size, int(count), pairs), flush=True)


if __name__ == "__main__":
    main()
