"""What users end up with, on six virtual benches of fixed seeds: learned from one push and bent in the same set-up.

The benches are those of `benchmarks.setup`: an ideal one, two with small effects and three with all.
`tests/whole/outcomes.toml` holds the table, and `tests/whole/test_outcomes.py` fails where a number has become worse by
more than its margin. `python -m benchmarks.outcomes --renew` writes the table anew.
"""

from __future__ import annotations

import argparse
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.real_bench import PLACES, Outcome, compared
from benchmarks.setup import learn, led
from onebend.lab.virtual import true_stiffness

BENCHES = (("none", 1), ("small", 0), ("small", 2), ("all", 1), ("all", 5), ("all", 10))
TABLE = Path(__file__).parents[1] / "tests" / "whole" / "outcomes.toml"
# By how much a mean over the benches may become worse: shares, but for the tip's error in mm.
MARGINS = {
    "k_error": 0.005,
    "inside_50": 0.06,
    "inside_95": 0.03,
    "identified": 0.03,
    "tip_off_mm": 0.08,
    "inside_ellipse": 0.1,
}
LEVELS = {"inside_50": 0.5, "inside_95": 0.95, "inside_ellipse": 0.95}  # for which a share in a band is best
LESS_IS_BETTER = ("k_error", "tip_off_mm")


@dataclass(frozen=True)
class Row:
    """One bench."""

    effects: str
    seed: int
    k_error: float  # RMS of k / truth - 1, from s = 0.05 to 0.9 of the push's place
    inside_50: float  # share of these places inside the 50 % band
    inside_95: float
    identified: float  # share of these places
    tip_off_mm: float  # mean distance of the true tip from its goal, in the same set-up
    inside_ellipse: float  # share of the goals
    times: float  # processor time of the fit over that of `reference`


def reference() -> float:
    """s, processor time of a computation that takes as long whatever the package does."""
    began, rng = time.process_time(), np.random.default_rng(0)
    matrix = rng.standard_normal((400, 400))
    for _ in range(40):
        matrix = np.linalg.qr(matrix)[0] + 1e-3 * rng.standard_normal((400, 400))
    return time.process_time() - began


def row(effects: str, seed: int) -> Row:
    """Learn and bend one bench."""
    began = time.process_time()
    one = learn(effects, seed)
    seconds = time.process_time() - began
    s = np.linspace(0.05, 0.9 * one.bench.push.at_s, PLACES)
    band = compared(one.posterior, s, true_stiffness(one.bench, one.made.motion, s).k, Outcome(effects, seed))
    goals = led(one, with_new=False)
    return Row(
        effects,
        seed,
        band.error,
        band.inside[0],
        band.inside[-1],
        band.identified,
        1e3 * float(np.mean([goal.off for goal in goals])),
        float(np.mean([goal.squared <= -2.0 * np.log(0.05) for goal in goals])),
        seconds / reference(),
    )


def means(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Of the numbers that have margins."""
    return {name: float(np.mean([one[name] for one in rows])) for name in MARGINS}


def worse(now: Mapping[str, float], before: Mapping[str, float]) -> list[str]:
    """What has become worse by more than its margin, in words."""
    out = []
    for name, margin in MARGINS.items():
        level = LEVELS.get(name)
        fault, was = (now[name], before[name]) if level is None else (abs(now[name] - level), abs(before[name] - level))
        sign = 1.0 if level is not None or name in LESS_IS_BETTER else -1.0
        if sign * (fault - was) > margin:
            out.append(f"{name}: {now[name]:.4g}, and it was {before[name]:.4g} (margin {margin:g})")
    return out


def stored(benches: Sequence[tuple[str, int]] = BENCHES) -> dict[str, float]:
    """The means over these benches in the table."""
    rows = tomllib.loads(TABLE.read_text(encoding="utf-8"))["bench"]
    return means([one for one in rows if (one["effects"], one["seed"]) in benches])


def table(rows: Sequence[Row]) -> str:
    """As TOML."""
    lines = ["# What users end up with on virtual benches; written by `python -m benchmarks.outcomes --renew`."]
    for one in rows:
        lines += ["", "[[bench]]"]
        values = asdict(one)
        lines += [f'{n} = "{v}"' if isinstance(v, str) else f"{n} = {v:.4g}" for n, v in values.items()]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--renew", action="store_true", help="write the table")
    renew = parser.parse_args().renew
    rows = [row(*bench) for bench in BENCHES]
    text = table(rows)
    print(text)
    now = means([asdict(one) for one in rows])
    print(", ".join(f"{name} {value:.4g}" for name, value in now.items()))
    if TABLE.is_file():
        print("\n".join(worse(now, stored())) or "Nothing is worse by more than its margin.")
    if renew:
        TABLE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
