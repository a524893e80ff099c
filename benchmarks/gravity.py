"""Gravity said wrongly, of a heavy beam that bends in its plane: seen, or in the band?

Films of one beam under a gravity that makes its weight twice the largest force, hanging, lying and rising by
30 degrees, learned as they are, with `base_angle_deg` off by so much, and with the force log in kilograms. `outside`:
share of the identified places where k(s) is out of the 95 % band.
"""

from __future__ import annotations

import argparse
import csv
import re
import shutil
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from onebend.errors import OnebendError
from onebend.lab.designs import DESIGNS
from onebend.lab.filming import film
from onebend.lab.random_bench import FilmRequest, filming_of
from onebend.learning.posterior import stiffness_of
from onebend.pipeline import learn

S = np.linspace(0.02, 0.98, 49)
BASES = (-90.0, 0.0, 30.0)  # deg, the beam's x axis in the room
WRONG = (0.0, 5.0, 10.0, 30.0, 90.0)  # deg, added to what is written of it
HEAVY = 25.0  # m/s^2
G = 9.80665


@dataclass(frozen=True)
class Outcome:
    """One film learned, against its truth."""

    refused: str = ""
    doubts: tuple[str, ...] = ()
    outside: float = np.nan
    off: float = np.nan  # median of k over the true k, less one, identified places
    half: float = np.nan  # median of the band's upper end over k, less one, there


def said(folder: Path, off: float) -> None:
    """Write another angle of the base."""
    path = folder / "recording.toml"
    text = path.read_text(encoding="utf-8")
    turned = re.sub(r"base_angle_deg = (\S+)", lambda one: f"base_angle_deg = {float(one[1]) + off:g}", text)
    path.write_text(turned, encoding="utf-8")


def in_kilograms(folder: Path) -> None:
    """Write the force log in kg."""
    path = folder / "force.csv"
    with path.open(encoding="utf-8", newline="") as lines:
        head, *rows = csv.reader(lines)
    text = [",".join(head), *(",".join([row[0], *(f"{float(x) / G:.6f}" for x in row[1:])]) for row in rows)]
    path.write_text("\n".join(text) + "\n", encoding="utf-8")


def run(folder: Path, truth: np.ndarray) -> Outcome:
    """Learn, compare."""
    try:
        posterior = learn(folder).posterior
    except OnebendError as wrong:
        return Outcome(refused=str(wrong))
    assert posterior is not None
    band = stiffness_of(posterior.problem, posterior.optimum, posterior.gain_sd).band(S)
    known, out = band.identified, (truth < band.low) | (truth > band.high)
    if not np.any(known):
        return Outcome(doubts=posterior.doubts)
    return Outcome(
        doubts=posterior.doubts,
        outside=float(np.mean(out[known])),
        off=float(np.median((band.k / truth)[known])) - 1.0,
        half=float(np.median((band.high / band.k)[known])) - 1.0,
    )


def row(base: float, what: str, one: Outcome) -> str:
    """Of the table."""
    verdict = f"refused: {one.refused[:60]}" if one.refused else "; ".join(one.doubts) or "trusted"
    numbers = [f"{100 * value:.0f}" if np.isfinite(value) else "-" for value in (one.outside, one.off, one.half)]
    return f"| {base:g} | {what} | {verdict} | {' | '.join(numbers)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--design", default="linear", choices=sorted(DESIGNS))
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    print("| the beam's x axis [deg] | written | verdict | outside [%] | k(s) off, median [%] | half-width [%] |")
    print("| --- | --- | --- | --- | --- | --- |")
    for base in BASES:
        request = replace(FilmRequest(sensor="wrist"), gravity=HEAVY, base_angle=float(np.radians(base)))
        with tempfile.TemporaryDirectory() as name:
            right = film(filming_of(DESIGNS[asked.design], request, "heavy"), Path(name) / "right", seed=asked.seed)
            made = np.load(right / "truth" / "truth.npz")
            for off in (*WRONG, np.nan):
                folder = Path(shutil.copytree(right, Path(name) / f"off {off:g}"))
                if np.isnan(off):
                    in_kilograms(folder)
                else:
                    said(folder, off)
                what = "force in kg" if np.isnan(off) else "rightly" if off == 0.0 else f"{off:g} deg off"
                print(row(base, what, run(folder, np.interp(S, made["s"], made["k"]))), flush=True)
                print(f"{base:g} {what}", file=sys.stderr)


if __name__ == "__main__":
    main()
