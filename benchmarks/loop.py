"""The closed loop: steady error and settling where k(s) is wrong by 30 %, delays, and the stated onset of ringing.

    python -m benchmarks.loop            # about two minutes of one core

Full motion of the true beam; the camera has 30 frames a second, 0.1 mm of noise, 10 ms of jitter in its delay, and
loses every tenth frame. `steady`: the largest distance from the goal in the last second of nine.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Profile, Scaled, Table, Uniform
from onebend.control.loop import Controller, SampledLoop, controller, margins, plant_at
from onebend.control.loop_simulation import LoopCamera, LoopSimulation, TrueSystem, simulate_loop
from onebend.records import Array

BEAMS = {
    "taper, 150 mm": Beam(0.15, Powers((0.03, -0.02)), mass_per_length=Uniform(0.1)),
    "bulge, 200 mm": Beam(0.2, Powers((0.02, 0.06, -0.06)), mass_per_length=Uniform(0.15)),
}
LOADS = ((-0.5, 1.5), (0.0, 2.5))  # of the goals' forces, F L / k in the middle
S = np.linspace(0.0, 1.0, 201)
SHARES = {
    "30 % softer": np.full(201, -1.0),
    "30 % stiffer": np.full(201, 1.0),
    "tip softer, base stiffer": 1.0 - 2.0 * S,
    "base softer, tip stiffer": 2.0 * S - 1.0,
}
EYE = LoopCamera(delay=0.06, jitter=0.01, noise=1e-4, dropped=0.1)
VARIANTS = {"open loop": (True, False), "feedback alone": (False, True), "both": (True, True)}
DURATION = 20.0  # s: a direction that hardly yields is corrected slowly, steady is what is left then
DELAYS = (0.0, 0.03, 0.06, 0.1, 0.15)  # s, the controller being told 0.05
WITHIN = 1e-3  # m, where the point counts as settled


@dataclass(frozen=True)
class Case:
    """A goal of a model, and a beam that is not the model."""

    name: str
    goal: int
    error: str
    control: Controller
    beam: Beam

    def run(self, variant: str, eye: LoopCamera = EYE) -> LoopSimulation:
        feedforward, feedback = VARIANTS[variant]
        settings = replace(self.control.settings, feedforward=feedforward, feedback=feedback)
        return simulate_loop(replace(self.control, settings=settings), TrueSystem(self.beam, eye=eye), DURATION, seed=1)


def wrong(k: Profile, error: str) -> Profile:
    """k(s) with 30 % of an error."""
    if np.ptp(SHARES[error]) == 0.0:
        return Scaled(1.0 + 0.3 * float(SHARES[error][0]), k)
    return Table(tuple(S.tolist()), tuple((k(S) * (1.0 + 0.3 * SHARES[error])).tolist()))


def cases() -> Iterator[Case]:
    """Every beam, goal and error."""
    for name, beam in BEAMS.items():
        for number, load in enumerate(LOADS, 1):
            force = np.array(load) * float(beam.stiffness(0.5)) / beam.length
            control = controller(beam, beam.equilibrium(force).xy(1.0))
            for error in SHARES:
                yield Case(name, number, error, control, replace(beam, stiffness=wrong(beam.stiffness, error)))


def print_errors(every: list[Case]) -> None:
    """Steady error and settling time of the three variants."""
    heads = " | ".join(f"{v}: steady [mm] | settled to 1 mm [s]" for v in VARIANTS)
    print(f"| beam | goal | true k(s) | {heads} |\n|{' --- |' * 9}")
    worst: dict[str, list[float]] = {variant: [] for variant in VARIANTS}
    for case in every:
        row = []
        for variant in VARIANTS:
            found = case.run(variant)
            worst[variant].append(1e3 * found.steady())
            row += [f"{1e3 * found.steady():.2f}", f"{found.settled(WITHIN):.1f}".replace("inf", "never")]
        print(f"| {case.name} | {case.goal} | {case.error} | {' | '.join(row)} |", flush=True)
    said = "; ".join(f"{variant} {max(values):.2f}" for variant, values in worst.items())
    print(f"\nWorst steady error [mm]: {said}. Asked of both: <= 0.5.\n")


def print_delays(case: Case) -> None:
    """One case at several true delays; the gains were made for up to 100 ms."""
    print(f"{case.name}, goal {case.goal}, {case.error}; the controller is told a delay of 50 ms:\n")
    print("| true delay [ms] | steady [mm] | settled to 1 mm [s] |\n| --- | --- | --- |")
    for delay in DELAYS:
        found = case.run("both", replace(EYE, delay=delay))
        print(f"| {1e3 * delay:.0f} | {1e3 * found.steady():.2f} | {found.settled(WITHIN):.1f} |", flush=True)


def print_onset(every: list[Case]) -> None:
    """The rate of the integral at which the simulated beam begins to ring, against what the margins say."""
    print("\n| beam | goal | true k(s) | gain margin said | simulated between | phase [deg] | delay [ms] | softest k |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for case in every:
        truth = TrueSystem(case.beam, eye=LoopCamera(delay=0.05, noise=0.0))
        held = simulate_loop(case.control, truth, DURATION).asked[-1]
        inverse = case.control.inverse_at(held, 99.0)
        said = margins(
            SampledLoop(plant_at(case.beam, held), inverse, case.control.gains, case.control.settings.timing)
        )
        rings = [ringing(case, truth, held, share * said.gain) for share in (0.9, 1.1)]
        between = " and ".join(
            f"{share * said.gain:.2f} ({'rings' if ring else 'calm'})"
            for share, ring in zip((0.9, 1.1), rings, strict=True)
        )
        rest = f"{np.rad2deg(said.phase):.0f} | {1e3 * said.delay:.0f} | {said.softest:.2f}"
        print(f"| {case.name} | {case.goal} | {case.error} | {said.gain:.2f} | {between} | {rest} |", flush=True)


def ringing(case: Case, truth: TrueSystem, held: Array, factor: float) -> bool:
    """Whether the point's distance from the goal grows after the force was led to where it holds the goal."""
    control = replace(
        case.control,
        gains=replace(case.control.gains, rate=factor * case.control.gains.rate),
        reference=replace(case.control.reference, ends=held, rise=3.0),
    )
    found = simulate_loop(control, truth, 7.0)
    early, late = (found.time > 3.5) & (found.time < 4.5), found.time > 6.0
    return bool(np.max(found.error[late]) > np.max(found.error[early]))


def main() -> None:
    """Print the tables as Markdown."""
    every = list(cases())
    print_errors(every)
    print_delays(every[0])
    print_onset([every[i] for i in (0, 2, 9, 13)])


if __name__ == "__main__":
    main()
