"""What a rehearsal predicts against what simulated recordings give, and whether its first advice lowers the error.

Recordings are observed quickly: clock and contact are taken from the truth where the clock's sd is given. Runs are kept
in out/rehearse: the next call goes on from there (empty it when the fit has changed). The last column but one is the
band's: obtained over predicted sd of log k, root mean squares over the beam.
"""

from __future__ import annotations

import argparse
import hashlib
import pickle
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import isnan, nan
from pathlib import Path

import numpy as np

from benchmarks.simulated_runs import Obtained, SimulatedRun, obtained_of, simulate
from onebend.lab.forecast import PredictedBand, Setup, Tolerances, advise, known_beam, predict, setup_of
from onebend.lab.random_bench import CameraName, FilmRequest, SensorName
from onebend.records import Array

KEPT = Path(__file__).parents[1] / "out" / "rehearse"


@dataclass(frozen=True)
class Case:
    """A design and what it is pushed and seen with."""

    design: str
    sensor: SensorName
    clock_sd: float = 0.01  # s; NaN: found from the data
    at: tuple[float, ...] = (1.0,)  # of one push or more
    tags: tuple[float, ...] = ()
    camera: CameraName = "hd"
    bend_deg: float = 65.0
    placement_sd: float = 5e-4  # m
    seconds: float = 6.0

    @property
    def setup(self) -> Setup:
        request = FilmRequest(
            sensor=self.sensor, seconds=self.seconds, camera=self.camera, bend=float(np.deg2rad(self.bend_deg))
        )
        return setup_of(
            known_beam(self.design),
            [replace(request, at_s=s) for s in self.at],
            tags=self.tags,
            known_to=Tolerances(placement_sd=self.placement_sd, clock_sd=self.clock_sd),
        )

    @property
    def name(self) -> str:
        """What is not as in every case."""
        parts = [f"{self.design}, {self.sensor}"]
        parts += [f"pushed at {' and '.join(f'{s:g}' for s in self.at)}"] if self.at != (1.0,) else []
        parts += [f"{len(self.tags)} tags"] if self.tags else []
        parts += [self.camera] if self.camera != "hd" else []
        parts += [f"{self.bend_deg:g} deg"] if self.bend_deg != 65.0 else []
        parts += [f"tags to {1e3 * self.placement_sd:g} mm"] if self.placement_sd != 5e-4 else []
        parts += ["clock from the data"] if isnan(self.clock_sd) else []
        return ", ".join(parts)


CASES = (
    Case("linear", "wrist"),
    Case("cubic", "wrist"),
    Case("quadratic", "ideal"),
    Case("uniform", "franka"),
    Case("linear", "franka"),
    Case("cubic", "wrist", tags=(0.2, 0.4, 0.6, 0.8, 1.0)),
    Case("quadratic", "wrist", at=(0.8,)),
    Case("linear", "wrist", at=(1.0, 0.667)),
    Case("quadratic", "wrist", camera="webcam", bend_deg=40.0),
    Case("cubic", "ideal", clock_sd=nan),
    Case("linear", "wrist", clock_sd=nan),
    Case("cubic", "wrist", tags=(0.25, 0.5, 0.75, 1.0), placement_sd=2e-4),
)


def row(name: str, predicted: PredictedBand, obtained: Obtained) -> str:
    """Sizes of log k over the thirds of the beam."""
    band = float(np.sqrt(np.mean(obtained.sd**2) / np.mean(predicted.sd**2)))
    return (
        f"| {name} | {obtained.runs} ({obtained.failed}) | {_thirds(predicted.error)} "
        f"| {_thirds(obtained.rms)} | {_thirds(predicted.sd)} | {_thirds(obtained.sd)} "
        f"| {band:.2f} | {100.0 * obtained.covered:.0f} ± {100.0 * obtained.covered_error:.0f} |"
    )


def _thirds(values: Array) -> str:
    """Root mean squares of (101,) over the thirds of the beam."""
    return " / ".join(f"{np.sqrt(np.mean(part**2)):.3f}" for part in np.array_split(np.asarray(values), 3))


def study(case: Case, runs: int, jobs: int, advice: bool) -> Iterator[str]:
    """The case as it is and, if asked for, with its first advice followed."""
    KEPT.mkdir(parents=True, exist_ok=True)
    now = predict(case.setup)
    asked = [(case.name, case.setup, now)]
    first = advise(case.setup, now, count=1) if advice else ()
    asked += [(f"- {one.text}", one.setup, predict(one.setup)) for one in first]
    for name, one, predicted in asked:
        obtained = obtained_of(kept(one, runs, jobs))
        yield f"| {name} | no fit came out |" if obtained is None else row(name, predicted, obtained)


def kept(setup: Setup, runs: int, jobs: int) -> tuple[SimulatedRun, ...]:
    """The runs of this setup, made once."""
    file = KEPT / f"{hashlib.sha256(repr((setup, runs)).encode()).hexdigest()[:16]}.pickle"
    if not file.exists():
        file.write_bytes(pickle.dumps(simulate(setup, range(runs), jobs=jobs)))
    found: tuple[SimulatedRun, ...] = pickle.loads(file.read_bytes())
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--cases", nargs="*", type=int, default=range(len(CASES)))
    parser.add_argument("--advice", action="store_true", help="simulate each case's first advice as well")
    asked = parser.parse_args()
    print("Sizes of log k, root mean squares over runs (of the band: the median) and over each third of the beam.\n")
    print("| setup | runs (failed) | error predicted | obtained | sd of the band predicted | obtained ", end="")
    print("| obtained over predicted | in the 95 % band [%] |\n| " + "--- | " * 8)
    for i in asked.cases:
        for line in study(CASES[i], asked.runs, asked.jobs, asked.advice):
            print(line, flush=True)


if __name__ == "__main__":
    main()
