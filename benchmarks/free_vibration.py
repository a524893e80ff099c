"""One second of free vibration at equal error: the cheapest runs of ours beside the cheapest of MuJoCo's hinge chain.

A uniform beam (150 mm, fundamental 4.3 Hz) is let go from a tip force. The error of a run is the largest distance of
its tip from that of a converged run (20 modes, order 8, 10,000 steps) at 1000 times of the second, in space and time
together; ours is interpolated between its steps. Of each ladder of settings the cheapest run within the error is taken;
the ratio is the median of runs in pairs, one of ours and one of MuJoCo's after the other. Ours is the whole public
call, tables and start included (`body`, `settle`, `simulate`); MuJoCo's is stepping alone. Seconds are of the
processor.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.dynamics import BEAM, chain_model
from onebend.beam.dynamics import Actions, AppliedForce, body
from onebend.beam.grid import Modes
from onebend.beam.integration import IntegrationSettings, Method, simulate
from onebend.beam.problem import Resolution
from onebend.beam.stiffness import Uniform
from onebend.beam.vibration import settle
from onebend.records import Array

FRAMES = 1000  # a second, at which MuJoCo's tip is read
TARGETS = (1e-3, 1e-4)  # of L
PAIRS = 5
OURS = (  # modes, stages, steps
    (2, 3, 25),
    (3, 3, 25),
    (3, 3, 40),
    (3, 3, 50),
    (3, 3, 80),
    (4, 3, 80),
    (4, 3, 125),
    (5, 3, 200),
    (6, 4, 250),
    (8, 4, 500),
    (10, 4, 500),
    (14, 4, 1000),
    (16, 4, 1000),
)


@dataclass(frozen=True)
class Release:
    """A beam let go from a tip force, and the ladder of MuJoCo's runs for it."""

    name: str
    load: float  # P L^2 / EI
    loss_time: float  # s, of Kelvin-Voigt damping
    chains: tuple[tuple[int, int, str], ...]  # links, steps, integrator; the cheapest first

    @property
    def force(self) -> tuple[float, float]:
        return (0.0, self.load * float(BEAM.stiffness(0.5)) / BEAM.length)


FAST = tuple(
    (links, steps, "implicitfast") for links, steps in ((10, 1000), (20, 2000), (20, 3000), (25, 2000), (60, 48000))
)
RELEASES = (
    Release("gently, damped", 0.3, 0.006, FAST),
    Release("gently, undamped", 0.3, 0.0, ((20, 8000, "RK4"), (48, 48000, "RK4"))),
    Release("strongly, undamped", 3.0, 0.0, ((20, 20000, "RK4"), (40, 50000, "RK4"))),
)


def ours(release: Release, modes: int, stages: int, steps: int, tolerance: float = 1e-6) -> Array:
    """(FRAMES + 1, 2) m of the tip."""
    loss = float(BEAM.stiffness(0.5)) * release.loss_time
    of = body(BEAM, Modes(modes), damping=Uniform(loss), resolution=Resolution(max(12, modes + 6)))
    start = settle(of, Actions(forces=(AppliedForce(release.force),)))
    options = IntegrationSettings(Method(stages), tolerance=tolerance)
    motion = simulate(of, start, 1.0, 1.0 / steps, settings=options)
    states = motion.states_at(np.linspace(0.0, motion.time[-1], FRAMES + 1))
    return of.xy(np.ones(1), states)[:, 0]


def chain(release: Release, links: int, steps: int, integrator: str) -> tuple[Callable[[], Array], Array]:
    """A run of MuJoCo's chain, which gives (FRAMES + 1, 2) m of the tip, and the angles it starts from."""
    text = chain_model(links, 1.0 / steps).replace('"RK4"', f'"{integrator}"')
    damped = re.sub(
        r'stiffness="([^"]+)"',
        lambda found: f'{found.group(0)} damping="{float(found.group(1)) * release.loss_time}"',
        text,
    )
    model = mujoco.MjModel.from_xml_string(damped)
    bent = BEAM.equilibrium(release.force).angle((np.arange(links) + 0.5) / links)
    start = np.diff(bent, prepend=0.0)

    def run() -> Array:
        data = mujoco.MjData(model)
        data.qpos[:] = start
        mujoco.mj_forward(model, data)
        path = [data.site_xpos[0, :2].copy()]
        for _ in range(FRAMES):
            mujoco.mj_step(model, data, steps // FRAMES)
            path.append(data.site_xpos[0, :2].copy())
        return np.array(path)

    return run, start


def seconds(work: Callable[[], object]) -> float:
    """Of the processor."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


def off(path: Array, exact: Array) -> float:
    """L, the largest distance."""
    return float(np.max(np.linalg.norm(path - exact, axis=-1))) / BEAM.length


def race(release: Release) -> list[str]:
    """Rows of the table, one an error."""
    exact = ours(release, 20, 4, 10000, 1e-10)
    mine = [(setting, off(ours(release, *setting), exact)) for setting in OURS]
    chains = [(setting, chain(release, *setting)[0]) for setting in release.chains]
    theirs = [(setting, run, off(run(), exact)) for setting, run in chains]
    return [row(release, target, mine, theirs) for target in TARGETS]


def row(
    release: Release,
    target: float,
    mine: list[tuple[tuple[int, int, int], float]],
    theirs: list[tuple[tuple[int, int, str], Callable[[], Array], float]],
) -> str:
    """The cheapest of both within an error, and their ratio; where no chain comes so near, the nearest beside ours."""
    (modes, stages, steps), error = next(one for one in mine if one[1] <= target)
    (links, count, integrator), run, away = next(
        (one for one in theirs if one[2] <= target), min(theirs, key=lambda one: one[2])
    )
    pairs = np.array([(seconds(lambda: ours(release, modes, stages, steps)), seconds(run)) for _ in range(PAIRS)])
    here, there = np.min(pairs, axis=0)
    ratio = f"{np.median(pairs[:, 1] / pairs[:, 0]):.3g}"
    return (
        f"| {release.name} | {target:.0e} L | {modes} modes, order {2 * stages}, {steps} steps | {error:.1e} L | "
        f"{here:.4f} s | {links} links, {count} steps, {integrator} | {away:.1e} L | {there:.4f} s | {ratio} |"
    )


def main() -> None:
    print("| let go | within | ours | error | CPU | MuJoCo | error | CPU | ours is faster by |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for release in RELEASES:
        for line in race(release):
            print(line, flush=True)


if __name__ == "__main__":
    main()
