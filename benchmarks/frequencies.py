"""Natural frequencies as observations: against closed forms, and E of beams that hang, stand and lie

The closed forms are the characteristic equations of a cantilever with and without a mass at its tip, and Greenhill's
buckling load. The made measurements come from another theory and discretisation, a chain of rigid bars (Richardson's
limit of two chains), with errors drawn at random; so is the error of the written mass, 2 % (one sd).
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Profile, Scaled, Uniform
from onebend.beam.vibration import natural_frequencies
from onebend.learning.posterior import Posterior, fit
from onebend.learning.start import start_of, with_mass
from onebend.recording.observe import observe
from onebend.records import Array, BoolArray, PointMass
from tests.beam.slender import swinging_frequencies

G = 9.81
SEEDS = 20
LENGTH, WIDE, THICK = 0.3, 0.030, 0.001  # m, a steel ruler
STEEL, DENSE = 205e9, 7850.0  # Pa, kg/m^3
MASS = DENSE * LENGTH * WIDE * THICK
MASS_SD = 0.02
SD = 2e-3  # of a frequency
HANG, STAND, LIE = -90.0, 90.0, 0.0
MIDDLE = np.linspace(0.1, 0.9, 9)


@dataclass(frozen=True)
class Case:
    """What is measured of which beam, and what is written down."""

    name: str
    beam: Beam
    rows: tuple[tuple[int, float, float], ...]  # mode, base angle [deg], tip mass [kg]
    beam_keys: str
    poses: bool = False
    mass_written: bool = True


def ruler(shape: Profile = Uniform(1.0)) -> Beam:
    """A steel ruler, or one whose k(s) is that times a shape; its mass is even."""
    k = STEEL * WIDE * THICK**3 / 12.0 / LENGTH
    return Beam(LENGTH, Scaled(k, shape), mass_per_length=Uniform(MASS / LENGTH))


EVEN = 'mass_along = "even"\nstiffness_along = "even"\nrest = "straight"\n'
THREE = ((1, HANG, 0.0), (1, STAND, 0.0), (1, LIE, 0.0))
UNEVEN = ruler(Powers((1.4, -0.8)))
CASES = (
    Case("slowest, hangs, stands and lies", ruler(), THREE, EVEN),
    Case("three modes, lies", ruler(), tuple((mode, LIE, 0.0) for mode in (1, 2, 3)), EVEN),
    Case("poses under 50 g and three, mass unknown", ruler(), THREE, EVEN, poses=True, mass_written=False),
    Case("bare and with 5 g at the tip, mass unknown", ruler(), ((1, LIE, 0.0), (1, LIE, 0.005)), EVEN, False, False),
    Case(
        "k(s) falls by 57 %, five modes, hangs",
        UNEVEN,
        tuple((mode, HANG, 0.0) for mode in range(1, 6)),
        'mass_along = "even"\nrest = "straight"\n',
    ),
)


def frequency(beam: Beam, mode: int, base: float, tip: float, bars: int = 150) -> float:
    """Hz, Richardson's limit of two chains."""
    gravity = G * np.array([-np.sin(np.radians(base)), -np.cos(np.radians(base))])
    points = [(tip, 1.0)] if tip else []
    coarse, fine = (swinging_frequencies(beam, gravity, count, points, mode)[-1] for count in (bars, 2 * bars))
    return float(fine + (fine - coarse) / 3.0)


def recording(folder: Path, case: Case, frequencies: Sequence[float], rng: np.random.Generator) -> None:
    """Write what somebody measured of the case, whose true frequencies these are."""
    written = MASS / (1.0 + MASS_SD * rng.standard_normal())
    mass = f"mass_kg = {written:.9f}\nmass_sd_kg = {MASS_SD * written:.9f}\n" if case.mass_written else ""
    text = f"format = 1\n[beam]\nlength_m = {LENGTH}\nwidth_m = {THICK}\nthickness_m = {WIDE}\n{mass}{case.beam_keys}"
    for (mode, base, tip), exact in zip(case.rows, frequencies, strict=True):
        hz = exact * (1.0 + SD * rng.standard_normal())
        text += f"[[frequencies]]\nhz = {hz:.9f}\nsd_hz = {SD * exact:.9f}\nmode = {mode}\n"
        text += f"base_angle_deg = {base}\ntip_mass_kg = {tip}\n"
    folder.mkdir()
    if case.poses:
        text += _poses(folder, case, rng)
    (folder / "recording.toml").write_text(text)


def _poses(folder: Path, case: Case, rng: np.random.Generator) -> str:
    """Weights hung on the tip of the ruler that lies on its edge's side: its own weight acts across."""
    s, sd = np.array([0.5, 1.0]), 5e-4
    rows, loads = ["pose,id,x_m,y_m"], ["pose,s,fy_N"]
    for i, grams in enumerate((20.0, 50.0)):
        force = -1e-3 * G * grams
        loads.append(f"p{i},1.0,{force:.6f}")
        at = case.beam.equilibrium((0.0, force)).xy(s) + sd * rng.standard_normal((2, 2))
        rows += [f"p{i},{j + 1},{x:.6f},{y:.6f}" for j, (x, y) in enumerate(at)]
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")
    (folder / "loads.csv").write_text("\n".join(loads) + "\n")
    tags = "".join(f"[[tags.on_beam]]\nid = {j + 1}\ns = {place}\n" for j, place in enumerate(s))
    source = f'[poses]\nfile = "poses.csv"\nloads = "loads.csv"\nsd_m = {sd}\nclamp_sd_deg = 0.0\n'
    return f"[tags]\nplacement_sd_m = 0.0\n{tags}{source}"


def learned(folder: Path) -> Posterior:
    """The fit to one recording."""
    ready = with_mass([observe(folder)])
    return fit(ready, start_of(ready, None))


def trials(case: Case, seeds: int = SEEDS) -> list[tuple[Array, Array, BoolArray, float]]:
    """Of each seed: error of log k at nine places, its sd there, whether the 95 % band holds the truth; and the mass
    less the true one, over its sd."""
    exact, out = [frequency(case.beam, *row) for row in case.rows], []
    true = case.beam.stiffness(MIDDLE)
    with tempfile.TemporaryDirectory() as place:
        for seed in range(seeds):
            folder = Path(place) / f"seed-{seed}"
            recording(folder, case, exact, np.random.default_rng(seed))
            posterior = learned(folder)
            band, mass = posterior.band(MIDDLE), posterior.mass
            assert mass is not None
            half = 0.5 * np.log(band.high / band.low) / 1.96
            z = (mass.value - MASS) / mass.sd
            out.append((np.log(band.k / true), half, (band.low <= true) & (true <= band.high), z))
    return out


def roots(ratio: float, count: int) -> list[float]:
    """Of cos b + 1 / cosh b + ratio b (cos b tanh b - sin b) = 0: a cantilever with `ratio` of its mass at its tip."""

    def equation(b: float) -> float:
        return float(np.cos(b) + 1.0 / np.cosh(b) + ratio * b * (np.cos(b) * np.tanh(b) - np.sin(b)))

    grid = np.linspace(1e-3, np.pi * (count + 1), 4001).tolist()
    return [brentq(equation, a, b, xtol=1e-14) for a, b in pairwise(grid) if equation(a) * equation(b) < 0.0][:count]


def closed_forms() -> list[tuple[str, str, str]]:
    """What, its exact value, and the largest relative error."""
    unit = Beam(1.0, Uniform(1.0), mass_per_length=Uniform(1.0))
    rows = []
    for ratio in (0.0, 0.1, 1.0, 10.0):
        exact = np.square(roots(ratio, 5)) / (2.0 * np.pi)
        found = natural_frequencies(unit, points=[PointMass(1.0, ratio)], count=5)
        name = f"tip mass of {ratio:g} times its own" if ratio else "uniform cantilever"
        rows.append(
            (name, f"five modes, {exact[0]:.6f} to {exact[-1]:.4f} Hz", f"{np.max(abs(found / exact - 1)):.0e}")
        )
    for name, base in (("ruler hangs", HANG), ("ruler stands", STAND), ("ruler lies", LIE)):
        gravity = G * np.array([-np.sin(np.radians(base)), -np.cos(np.radians(base))])
        own = natural_frequencies(ruler(), gravity=gravity, count=1)[0]
        exact_one = frequency(ruler(), 1, base, 0.0)
        rows.append((f"{name} (chain of bars)", f"{exact_one:.6f} Hz", f"{abs(own / exact_one - 1):.0e}"))
    loads = np.array([7.80, 7.83])
    squared = [natural_frequencies(unit, gravity=(-load, 0.0), count=1)[0] ** 2 for load in loads]
    zero = loads[1] - squared[1] * (loads[1] - loads[0]) / (squared[1] - squared[0])
    rows.append(("stands, own weight that makes it buckle", "7.83735", f"{abs(zero / 7.83735 - 1):.0e}"))
    return rows


def main() -> None:
    print("| beam | exact | largest relative error |\n| --- | --- | --- |")
    for row in closed_forms():
        print("| " + " | ".join(row) + " |")
    print(f"\nA steel ruler, {1e3 * LENGTH:g} mm, {1e3 * THICK:g} mm thick; {SEEDS} draws of the errors: frequencies")
    print(f"{100 * SD:g} %, the written mass {100 * MASS_SD:g} %, points of poses 0.5 mm (one sd each).\n")
    print("| measured | RMS error of log k [%] | claimed sd [%] | truth in the 95 % band [%] | mass, RMS z |")
    print("| --- | --- | --- | --- | --- |")
    for case in CASES:
        found = trials(case)
        error, sd = (np.sqrt(np.mean([one[i] ** 2 for one in found])) for i in (0, 1))
        inside, z = np.mean([one[2] for one in found]), np.sqrt(np.mean([one[3] ** 2 for one in found]))
        print(f"| {case.name} | {100 * error:.2f} | {100 * sd:.2f} | {100 * inside:.0f} | {z:.2f} |", flush=True)


if __name__ == "__main__":
    main()
