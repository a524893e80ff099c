"""What a rehearsal predicts against what simulated recordings give, and whether its first advice lowers the error."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from math import nan

import numpy as np

from onebend.lab.strategies import SensorName, Wish
from onebend.records import Array
from onebend.rehearse.advice import advise
from onebend.rehearse.prediction import Predicted, predict
from onebend.rehearse.rehearsal import Obtained, obtained_of, thirds
from onebend.rehearse.runs import simulate
from onebend.rehearse.setup import Setup, known_beam, setup_of


@dataclass(frozen=True)
class Case:
    """A design and what it is pushed and seen with."""

    design: str
    sensor: SensorName
    clock_sd: float = nan  # s; NaN: found from the data
    seconds: float = 6.0

    @property
    def setup(self) -> Setup:
        wish = Wish(sensor=self.sensor, seconds=self.seconds)
        return setup_of(known_beam(self.design), [wish], clock_sd=self.clock_sd)


CASES = (
    Case("linear", "wrist"),
    Case("cubic", "wrist", 0.01),
    Case("quadratic", "ideal", 0.01),
    Case("uniform", "franka", 0.01),
)


def row(name: str, predicted: Predicted, obtained: Obtained) -> str:
    """Root mean square errors of log k over the thirds of the beam, and the bands."""
    return (
        f"| {name} | {obtained.runs} ({obtained.failed}) | {_cells(thirds(predicted.error))} "
        f"| {_cells(thirds(obtained.rms))} | {_cells(thirds(obtained.rms) / thirds(predicted.error), 2)} "
        f"| {_cells(thirds(obtained.sd) / thirds(predicted.sd), 2)} "
        f"| {100.0 * obtained.covered:.0f} ± {100.0 * obtained.covered_error:.0f} |"
    )


def _cells(values: Array, digits: int = 3) -> str:
    return " / ".join(f"{v:.{digits}f}" for v in values)


def study(case: Case, runs: int, jobs: int) -> Iterator[str]:
    """The case as it is, and with its first advice followed."""
    setup = case.setup
    now = predict(setup)
    first = advise(setup, now, count=1)
    asked = [(f"{case.design}, {case.sensor}", setup, now)]
    asked += [(f"- {one.text}", one.setup, predict(one.setup)) for one in first]
    for name, one, predicted in asked:
        obtained = obtained_of(simulate(one, range(runs), jobs=jobs))
        yield f"| {name} | no fit came out |" if obtained is None else row(name, predicted, obtained)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--cases", nargs="*", type=int, default=range(len(CASES)))
    asked = parser.parse_args()
    print("Errors of log k, root mean squares over runs and over each third of the beam.\n")
    print(
        "| setup | runs (failed) | error predicted | error obtained | ratio | sd of the band: obtained / predicted ",
        end="",
    )
    print("| in the 95 % band [%] |\n| --- | --- | --- | --- | --- | --- | --- |")
    for i in np.asarray(list(asked.cases)):
        for line in study(CASES[int(i)], asked.runs, asked.jobs):
            print(line, flush=True)


if __name__ == "__main__":
    main()
