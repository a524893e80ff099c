"""What a beam of a design will do on the bench: forces, deflections, buckling, vibration, sag. Exact statics."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eigvals
from scipy.optimize import brentq

from onebend.beam.loads import follow_push, push, weight
from onebend.beam.model import Beam
from onebend.beam.motion.vibration import vibration
from onebend.beam.profiles.section import Material, Rectangle, SectionPart, along
from onebend.beam.profiles.stiffness import Uniform
from onebend.beam.statics.continuation import equilibrium
from onebend.beam.statics.equilibrium import tangent
from onebend.beam.statics.problem import Resolution, make_problem
from onebend.blas import one_blas_thread
from onebend.errors import MechanicsError
from onebend.lab.designs import Design
from onebend.records import Array

TURNS_DEG = (30.0, 60.0, 90.0)
GRAVITY = 9.81  # m/s^2
FINE = Resolution(order=16, widest=0.25)
DENSE = np.linspace(0.0, 1.0, 1001)
MOST_FORCE, GROWTH = 8.0, 1.15  # times the small-angle one, and from try to try


@dataclass(frozen=True)
class TipBend:
    """The tip turned by a tool that presses squarely on the beam at its tip."""

    turn: float  # rad, of the tip
    force: float  # N, perpendicular to the beam where it acts
    tip: Array  # (2,) m
    strain: float  # largest strain at the surface

    def as_dict(self) -> dict[str, float]:
        """For JSON."""
        return {
            "turn_deg": math.degrees(self.turn),
            "force_N": self.force,
            "tip_x_m": float(self.tip[0]),
            "tip_y_m": float(self.tip[1]),
            "surface_strain": self.strain,
        }


@dataclass(frozen=True)
class Expected:
    """Figures of one design. All forces and the stiffness scale with the modulus; shapes do not depend on it."""

    design: Design
    bends: tuple[TipBend, ...]
    compliance: float  # m/N, of the tip to a small force across
    buckling: float  # N, on the tip along the beam
    frequency: tuple[float, ...]  # Hz, the two slowest vibrations in the plane of bending
    sag: float  # m, how far the weight lowers the tip where the plane of bending lies flat
    droop: float  # m, the same where that plane is upright and the beam level

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        design, bending = self.design, self.design.bending(DENSE)
        return {
            "name": design.name,
            "length_m": design.length,
            "depth_m": design.depth,
            "modulus_Pa": design.modulus,
            "modulus_log_sd": design.modulus_log_sd,
            "modulus_source": design.source,
            "mass_kg": design.mass,
            "bending_stiffness_N_m2": [float(bending.min()), float(bending.max())],
            "softest_s": float(DENSE[bending.argmin()]),
            "bends": [bend.as_dict() for bend in self.bends],
            "tip_compliance_m_N": self.compliance,
            "buckling_force_N": self.buckling,
            "frequencies_Hz": list(self.frequency),
            "sag_flat_m": self.sag,
            "droop_upright_m": self.droop,
        }


@one_blas_thread
def expect(design: Design, turns_deg: tuple[float, ...] = TURNS_DEG) -> Expected:
    """What to expect of a design on the bench.

    Raises:
        MechanicsError: an equilibrium was not found.
    """
    beam = design.beam()
    still = equilibrium(beam, push((0.0, 0.0)), resolution=FINE)
    slowest = vibration(beam, still, rotary_inertia=design.along.rotary_inertia, count=2).frequency
    return Expected(
        design=design,
        bends=tuple(bend(design, math.radians(turn)) for turn in turns_deg),
        compliance=tip_compliance(beam),
        buckling=buckling_force(beam),
        frequency=tuple(float(f) for f in slowest),
        sag=-_lowered(across_depth(design)),
        droop=-_lowered(beam),
    )


def bend(design: Design, turn: float) -> TipBend:
    """The force at the tip, square to the beam there, that turns the tip by `turn` [rad].

    Raises:
        MechanicsError: no such force.
    """
    beam = design.beam()

    def turned(force: float) -> float:
        solved = equilibrium(beam, follow_push((0.0, force)), resolution=FINE)
        return float(solved.angle(np.array([1.0]))[0, 0]) if solved.converged[0] else math.nan

    first = turn / _turn_compliance(beam)
    largest = first
    while turned(largest) < turn and largest < MOST_FORCE * first:
        largest *= GROWTH
    if not turned(largest) >= turn:
        raise MechanicsError(f"no force on the tip of {design.name!r} turns it by {math.degrees(turn):.0f} degrees")
    force = float(brentq(lambda f: turned(f) - turn, 0.0, largest, xtol=1e-10 * first, rtol=1e-10))
    solved = equilibrium(beam, follow_push((0.0, force)), resolution=FINE)
    nodes = solved.problem.grid.nodes
    strain = 0.5 * np.asarray(design.width(nodes)) * np.abs(solved.q[0]) / design.length
    return TipBend(turn, force, np.asarray(solved.xy(np.array([1.0]))[0, 0]), float(np.max(strain)))


def tip_compliance(beam: Beam) -> float:
    """m/N: how far a small force across moves the tip, `L^2 int (1 - s)^2 / k ds`."""
    grid = make_problem(beam, push((0.0, 0.0)), FINE).grid
    return float(beam.length**2 * np.sum(grid.weights * (1.0 - grid.nodes) ** 2 / beam.stiffness(grid.nodes)))


def _turn_compliance(beam: Beam) -> float:
    """rad/N: how far a small force across turns the tip, `L int (1 - s) / k ds`."""
    grid = make_problem(beam, push((0.0, 0.0)), FINE).grid
    return float(beam.length * np.sum(grid.weights * (1.0 - grid.nodes) / beam.stiffness(grid.nodes)))


def buckling_force(beam: Beam) -> float:
    """N: the least axial push on the tip under which the straight beam is no longer stable.

    The tangent of the straight shape is affine in that force: its root is an eigenvalue.
    """
    problem = make_problem(beam, push((-1.0, 0.0)), FINE)
    free, pushed = (tangent(problem, np.zeros((1, problem.k.shape[-1])), factor)[0] for factor in (0.0, 1.0))
    softened = eigvals(np.linalg.solve(free, free - pushed)).real
    return float(1.0 / np.max(softened))


def across_depth(design: Design) -> Beam:
    """The same bar, bending across its depth: out of the plane that it is made to bend in."""
    material = Material(design.modulus, design.density)
    turned = along((SectionPart(Rectangle(design.width, Uniform(design.depth)), material),), design.length)
    return Beam(design.length, turned.stiffness, mass_per_length=turned.mass_per_length)


def _lowered(beam: Beam) -> float:
    """m, the tip's y under the weight of a level beam."""
    solved = equilibrium(beam, weight((0.0, -GRAVITY)), resolution=FINE)
    return float(solved.xy(np.array([1.0]))[0, 0, 1]) if solved.converged[0] else math.nan
