"""A second push of the same real bench: how far off the learned beam is, and how far off it said to be.

Virtual benches with effects drawn at random (`benchmarks.real_bench`) are pushed twice, at the tip and at 0.8 of the
length: the same beam, tags, clamp, gain and slide, another place of contact, another error of the arm's posture and
other noise. The fit learns from one push and k(s) is validated on the other. Of the worst marker: its error, over what
the force's noise alone explains and over what is likely.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from math import erf

import numpy as np

from benchmarks.setup import learn
from onebend.errors import LearningError, MechanicsError, ObservationError
from onebend.lab.designs import force_that_bends
from onebend.lab.virtual import VirtualBench, observe_virtual, virtual_recording
from onebend.learning.instruments import setup_of
from onebend.learning.validation import validate

TIP = 0.97  # beyond, a contact begins and slides inwards alone
LEVELS = (1.0, 1.3, 1.5, 2.0)


@dataclass(frozen=True)
class SecondPush:
    """The worst marker; m RMS."""

    seed: int
    at_s: tuple[float, float]  # learned from, validated on
    error: float
    noise: float
    likely: float


def pushed_again(bench: VirtualBench, seed: int) -> VirtualBench:
    """The same bench with its push elsewhere."""
    rng = np.random.default_rng([seed, 77])
    at_s = 0.8 if bench.push.at_s > 0.9 else 1.0
    turn = float(np.radians(rng.uniform(45.0, 75.0)))
    push = replace(bench.push, at_s=at_s, peak=force_that_bends(bench.beam, turn, bench.push.direction, at_s))
    inwards, size = at_s > TIP, float(rng.uniform(0.0, 0.003)) * float(rng.random() < 0.6)
    effects = replace(
        bench.effects,
        push_off=size * (-1.0 if inwards else float(rng.choice([-1.0, 1.0]))),
        slide=-abs(bench.effects.slide) * float(np.sign(push.direction)) if inwards else bench.effects.slide,
        posture_shape=tuple(rng.standard_normal(10).tolist()),
    )
    return replace(bench, push=push, effects=effects, name=f"{bench.name}, again")


def compared(seed: int) -> SecondPush:
    """Make both, learn from the first, validate on the second."""
    one = learn("all", seed)
    again, found = pushed_again(one.bench, seed), one.posterior
    second = observe_virtual(virtual_recording(again, seed=seed + 1000))
    there = validate(found.beam, second, stiffness=found.stiffness, setup=setup_of(found))
    worst = int(np.argmax(there.rms))
    of_worst = (float(one[worst]) for one in (there.rms, there.sensor_rms, there.likely_rms))
    return SecondPush(seed, (one.bench.push.at_s, again.push.at_s), *of_worst)


def summary(name: str, pairs: list[SecondPush]) -> str:
    """A row of the table."""
    over = np.array([[one.error / one.noise, one.error / one.likely] for one in pairs]).reshape(-1, 2)
    shares = [" / ".join(f"{100.0 * np.mean(column <= level):.0f}" for level in LEVELS) for column in over.T]
    middle = np.median(over, axis=0)
    error = 1e3 * float(np.median([one.error for one in pairs]))
    return f"| {name} | {len(pairs)} | {error:.1f} | {middle[0]:.1f} | {shares[0]} | {middle[1]:.2f} | {shares[1]} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--first", type=int, default=0, help="seed of the first pair")
    asked = parser.parse_args()
    pairs: list[SecondPush] = []
    failed = 0
    for seed in range(asked.first, asked.first + asked.runs):
        try:
            pairs.append(compared(seed))
        except (LearningError, MechanicsError, ObservationError) as wrong:
            failed += 1
            print(f"{seed}: {wrong}", file=sys.stderr, flush=True)
    levels = " / ".join(f"{level:g}" for level in LEVELS)
    heads = ("learned from, validated at", "pairs", "error, median [mm]", "over noise, median", f"up to {levels} [%]")
    print(f"| {' | '.join(heads)} | over likely, median | up to {levels} [%] |")
    print("| --- " * 7 + "|")
    for at_s in sorted({one.at_s for one in pairs}, reverse=True):
        print(summary(f"{at_s[0]:g}, {at_s[1]:g}", [one for one in pairs if one.at_s == at_s]))
    print(summary("all", pairs))
    normal = " / ".join(f"{100.0 * erf(level / np.sqrt(2.0)):.0f}" for level in LEVELS)
    print(f"\nOf a normal error whose sd is known, {normal} % are up to {levels} times as large as is likely.")
    print(f"The worst marker of each pair. {failed} of {asked.runs} pairs could not be made or learned from.")


if __name__ == "__main__":
    main()
