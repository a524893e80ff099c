"""Motion: frequencies, energy, accuracy and speed, and a release against a hinge chain simulated by MuJoCo.

    python -m benchmarks.dynamics            # about two minutes

CPU times are `time.process_time`, the best of several runs; run with one BLAS thread.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from onebend.beam.continuation import equilibrium
from onebend.beam.dynamics import Actions, AppliedForce, Body, body, mass_matrix
from onebend.beam.grid import Modes
from onebend.beam.integration import IntegrationSettings, Method, Motion, simulate
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.beam.section import rectangular_bar
from onebend.beam.stiffness import Powers, Uniform
from onebend.beam.vibration import settle, vibration, vibration_of
from onebend.records import Array

Row = tuple[str, float, str, str]  # name, value, unit, target

BEAM = Beam(0.15, Uniform(0.02), mass_per_length=Uniform(0.1))  # 150 mm; fundamental 4.3 Hz
TIP_FORCE = (0.0, 3.0 * 0.02 / 0.15)  # P L^2 / EI = 3
PULL = Actions(forces=(AppliedForce(TIP_FORCE),))
MARKERS = (1.0 / 3.0, 2.0 / 3.0, 1.0)
LINKS = ((20, 5e-5), (40, 2e-5), (80, 6e-6))  # links of the chain, step [s] within the stability of RK4
PUBLISHED = {  # VirtualBow project, Hz; a bar of 1 m whose square side runs from 10 mm to the given one
    0.010: (8.3552, 52.361, 146.61, 287.30),
    0.005: (10.988, 46.438, 115.40, 218.11),
}


@dataclass(frozen=True)
class Timed:
    """A run and its CPU time, the best of several."""

    motion: Motion
    seconds: float


def frequency_rows() -> Iterator[Row]:
    """Steel bars: Euler-Bernoulli, and what rotary inertia takes off."""
    for last, published in PUBLISHED.items():
        side = Powers((0.01, last - 0.01))
        profiles = rectangular_bar(side, side, length=1.0, modulus=210e9, density=7850.0)
        beam = Beam(1.0, profiles.stiffness, mass_per_length=profiles.mass_per_length)
        solved = equilibrium(beam, push((0.0, 0.0)))
        thin = vibration(beam, solved).frequency[:4]
        thick = vibration(beam, solved, rotary_inertia=profiles.rotary_inertia).frequency[:4]
        for name, found in (("", thin), (", with rotary inertia", thick)):
            worst = float(np.max(np.abs(found / np.array(published) - 1.0)))
            yield f"bar 10 to {1e3 * last:.0f} mm{name}: first four frequencies off by", 100.0 * worst, "%", "<= 0.1"


def energy_rows(periods: int = 100) -> Iterator[Row]:
    """A release, undamped: the energy oscillates, and has no trend."""
    of = _modal(6)
    period = 1.0 / float(vibration_of(of, settle(of)).frequency[0])
    motion = simulate(of, settle(of, PULL), periods * period, period / 200.0, settings=IntegrationSettings(Method(4)))
    kinetic = np.einsum("ti,tij,tj->t", motion.rate, mass_matrix(of, motion.theta), motion.rate)
    energy = kinetic + np.einsum("ti,ij,tj->t", motion.theta, of.stiffness, motion.theta)
    energy = energy / energy[0] - 1.0
    trend = abs(float(np.polyfit(motion.time / period, energy, 1)[0])) * 1000.0
    name = f"energy over {periods} periods, order 8, 200 steps a period"
    yield f"{name}: whole oscillation", float(np.ptp(energy)), "1", "< 1e-6"
    yield f"{name}: fitted trend over 1000 periods", trend, "1", "< 1e-6"


def speed_rows() -> Iterator[Row]:
    """One second of six-mode motion after the release, at several steps, against a converged run."""
    of = _modal(6)
    exact, check = (_markers(_release(of, Method(4), steps))[:: steps // 4000] for steps in (16000, 8000))
    yield "converged run (order 8, 16000 steps): change from 8000 steps", 1e3 * _apart(exact, check), "mm", ""
    for stages, steps, tolerance in ((1, 4000, 1e-8), (2, 1000, 1e-8), (3, 500, 1e-8), (4, 400, 1e-8), (4, 500, 1e-10)):
        run = _timed(of, Method(stages), steps, tolerance)
        name = f"1 s, 6 modes, order {2 * stages}, {steps} steps, Newton to {tolerance:.0e}"
        fits = "<= 0.1" if stages > 3 else ""
        yield f"{name}: error of markers", 1e3 * _apart(exact[:: 4000 // steps], _markers(run.motion)), "mm", fits
        yield f"{name}: CPU", run.seconds, "s", fits.replace("0.1", "0.15")
        yield f"{name}: CPU a step", 1e6 * run.seconds / steps, "us", ""
        yield f"{name}: Newton iterations a step", run.motion.iterations / steps, "1", ""


def chain_rows() -> Iterator[Row]:
    """The tip after the release against a chain of rigid links with hinge springs, refined until it converges."""
    ours = {n: _release(_modal(n, order=24), Method(3), 4000).xy(1.0)[::4, 0] for n in (6, 12, 16)}
    length = BEAM.length
    yield "release, tip: 12 against 16 modes", 100.0 * _apart(ours[12], ours[16]) / length, "% L", ""
    chain: dict[int, Array] = {}
    for links, step in LINKS:
        chain[links], seconds = _chain_tip(links, step)
        off = 100.0 * _apart(chain[links], ours[16]) / length
        yield f"release, tip: 16 modes against MuJoCo, {links} links", off, "% L", "<= 0.5" if links == 80 else ""
        yield f"MuJoCo, {links} links, RK4 step {step:.0e} s: CPU for 1 s", seconds, "s", ""
    limit = (4.0 * chain[80] - chain[40]) / 3.0  # the chain converges at second order
    yield "release, tip: 16 modes against the chain's limit", 100.0 * _apart(limit, ours[16]) / length, "% L", "<= 0.5"
    yield "release, tip: 6 modes against the chain's limit", 100.0 * _apart(limit, ours[6]) / length, "% L", "<= 0.5"


def rows() -> list[Row]:
    """All figures; those of MuJoCo only where it is installed."""
    return [*frequency_rows(), *energy_rows(), *speed_rows(), *chain_rows()]


def main() -> None:
    """Print the figures as a Markdown table."""
    print("| figure | value | unit | target |\n| --- | --- | --- | --- |")
    for name, value, unit, target in rows():
        print(f"| {name} | {value:.3g} | {unit} | {target} |", flush=True)


def _modal(n: int, order: int = 16) -> Body:
    return body(BEAM, Modes(n), resolution=Resolution(order))


def _release(of: Body, method: Method, steps: int) -> Motion:
    return simulate(of, settle(of, PULL), 1.0, 1.0 / steps, settings=IntegrationSettings(method))


def _timed(of: Body, method: Method, steps: int, tolerance: float, times: int = 7) -> Timed:
    start, options = settle(of, PULL), IntegrationSettings(method, tolerance=tolerance)
    best = np.inf
    for _ in range(times):
        begin = time.process_time()
        motion = simulate(of, start, 1.0, 1.0 / steps, settings=options)
        best = min(best, time.process_time() - begin)
    return Timed(motion, best)


def _markers(motion: Motion) -> Array:
    return motion.xy(MARKERS)


def _apart(a: Array, b: Array) -> float:
    """Largest distance of points (..., 2) [m]."""
    return float(np.max(np.linalg.norm(a - b, axis=-1)))


def _chain_tip(links: int, step: float, frames: int = 1000) -> tuple[Array, float]:
    """(frames + 1, 2) m path of the tip in 1 s after the release, and the CPU time of stepping."""
    inner = round(1.0 / (frames * step))
    model = mujoco.MjModel.from_xml_string(chain_model(links, 1.0 / (frames * inner)))
    data = mujoco.MjData(model)
    angles = BEAM.equilibrium(TIP_FORCE).angle((np.arange(links) + 0.5) / links)
    data.qpos[:] = np.diff(angles, prepend=0.0)
    mujoco.mj_forward(model, data)
    path = [data.site_xpos[0, :2].copy()]
    begin = time.process_time()
    for _ in range(frames):
        mujoco.mj_step(model, data, inner)
        path.append(data.site_xpos[0, :2].copy())
    return np.array(path), time.process_time() - begin


def chain_model(links: int, step: float) -> str:
    """A chain of rods in MuJoCo's language: a spring E I / h at every hinge, twice that at the clamp (half a cell)."""
    h = BEAM.length / links
    spring = float(BEAM.stiffness(0.5)) * BEAM.length / h
    mass = float(BEAM.mass_per_length(0.5)) * h
    inertia = mass * h**2 / 12.0
    opened = "".join(
        f'<body pos="{h if i else 0.0} 0 0">'
        f'<joint type="hinge" axis="0 0 1" stiffness="{spring if i else 2.0 * spring}"/>'
        f'<inertial pos="{0.5 * h} 0 0" mass="{mass}" diaginertia="{1e-3 * inertia} {inertia} {inertia}"/>'
        for i in range(links)
    )
    return (
        f'<mujoco><option gravity="0 0 0" timestep="{step}" integrator="RK4">'
        '<flag contact="disable" constraint="disable"/></option><worldbody>'
        f'{opened}<site name="tip" pos="{h} 0 0"/>{"</body>" * links}</worldbody></mujoco>'
    )


if __name__ == "__main__":
    main()
