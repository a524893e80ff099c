"""Wires like those that others photographed, made with errors of a known kind: how often the band holds the truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import cholesky

from benchmarks.wires import ERROR_LENGTH, LENGTH, LINES, PUBLISHED, SD, bending, learned
from onebend.beam.clamped_ends import hold_near
from onebend.beam.loads import weight
from onebend.beam.model import Beam
from onebend.beam.problem import make_problem
from onebend.beam.stiffness import Uniform
from onebend.errors import OnebendError
from onebend.learning.posterior import Posterior
from onebend.learning.static_poses import HELD_RESOLUTION
from onebend.records import Array

NODES = 50
SPREAD = 0.25  # one sd of the log of EI about the published one
TURN = np.radians(5.0)  # one sd of both clamps about those of the photo
HALF = 1.678346990016661  # where `(1 + a) exp(-a)` is a half
KINDS: dict[str, tuple[int, Callable[[Array], Array]]] = {  # how many of each wire; correlation at d / error length
    "as stated": (16, lambda d: (1.0 + HALF * d) * np.exp(-HALF * d)),
    "smoother (normal curve)": (8, lambda d: np.exp(-np.log(2.0) * d**2)),
    "rougher (exponential)": (8, lambda d: np.exp(-np.log(2.0) * d)),
}


def made_curve(posterior: Posterior, wire: str, rng: np.random.Generator) -> tuple[float, Array]:
    """EI [N m^2] and (51, 2) m of a wire that hangs as the photographed one does, from other clamps."""
    seen = posterior.optimum.predictions[0]
    assert seen.data.ends is not None
    ei = PUBLISHED[wire] * float(np.exp(SPREAD * rng.normal()))
    turn, clamp = TURN * rng.normal(), float(np.mean(seen.solved.problem.alpha0))
    beam = Beam(LENGTH, Uniform(ei / LENGTH), clamp_angle=clamp + turn, mass_per_length=Uniform(LINES[wire]))
    problem = make_problem(beam, weight(np.array([[0.0, -9.81]])), HELD_RESOLUTION)
    end = seen.data.ends.end + np.array([0.0, 0.0, TURN * rng.normal()])
    solved, _ = hold_near(problem, seen.solved.q, end, fall=True)
    return (
        (ei, solved.xy(np.linspace(0.0, 1.0, NODES + 1))[0])
        if solved.converged[0]
        else made_curve(posterior, wire, rng)
    )


def made_wires(posteriors: dict[str, Posterior]) -> None:
    """One row a kind of error: how many bands hold the EI that the wires were made with."""
    s = LENGTH * np.arange(1, NODES + 1) / NODES
    print(f"\nWires made in their likeness, with errors of {1000 * SD:.0f} mm whose correlation falls to a half")
    print(f"over {ERROR_LENGTH} m, EI drawn about the published one (sd {100 * SPREAD:.0f} %), clamps by 5 deg:\n")
    print("| errors | wires | inside 95 % band | inside 80 % | z, RMS | band +- [%] |")
    print("| --- | --- | --- | --- | --- | --- |")
    for kind, (count, alike) in KINDS.items():
        root = cholesky(alike(np.abs(s[:, None] - s) / ERROR_LENGTH) + 1e-9 * np.eye(NODES), lower=True)
        z, widths, failed = [], [], 0
        for number, wire in enumerate(PUBLISHED):
            rng = np.random.default_rng([number, len(kind)])
            for _ in range(count):
                ei, curve = made_curve(posteriors[wire], wire, rng)
                curve[1:] += SD * root @ rng.normal(size=(NODES, 2))
                try:
                    middle, low, high = bending(learned({"made": curve}, LINES[wire]))
                except OnebendError:
                    failed += 1
                    continue
                z.append(np.log(ei / middle) / (np.log(high / low) / (2 * 1.96)))
                widths.append(50 * (high / low - 1) / np.sqrt(high / low))
        inside = [100 * np.mean(np.abs(z) < width) for width in (1.96, 1.2816)]
        print(
            f"| {kind} | {len(z)}{f' ({failed} failed)' if failed else ''} | {inside[0]:.0f} | {inside[1]:.0f} | "
            f"{np.sqrt(np.mean(np.square(z))):.2f} | {np.median(widths):.0f} |",
            flush=True,
        )
