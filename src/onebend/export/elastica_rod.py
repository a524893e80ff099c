"""A slender beam as a PyElastica rod. Needs NumPy and PyElastica, no other package.

    rod = make_rod(n_elements=50)
    simulator.append(rod)
    simulator.constrain(rod).using(elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    simulator.add_forcing_to(rod).using(RodRelaxation, rod=rod, time_step=dt)  # where RELAXATION is not empty

The rod begins straight, at the clamp and along its direction, and bends in the x-y plane; where the beam is curved at
rest it moves there. Where EA is not known, it is round and much stiffer against stretch and shear than against bending.
"""

import math
from typing import Any

import numpy as np
from elastica import CosseratRod, NoForces

# --- the beam -------------------------------------------------------------------------------------------------------
LENGTH_M = 1.0
CLAMP_ANGLE_RAD = 0.0
S: tuple[float, ...] = (0.0, 1.0)  # places along the beam
EI_N_M2: tuple[float, ...] = (1.0, 1.0)  # bending stiffness; linear between the places in 1 / EI
CURVATURE_1_M: tuple[float, ...] = (0.0, 0.0)  # at rest
MU_KG_M: tuple[float, ...] = (1.0, 1.0)  # mass per metre
STRETCH_1_N: tuple[float, ...] = ()  # 1 / EA; empty where it is not known
SHEAR_1_N: tuple[float, ...] = ()  # 1 / kGA
RELAXATION: tuple[tuple[float, float], ...] = ()  # shares of EI that relax, and their times in s
# --------------------------------------------------------------------------------------------------------------------


def make_rod(n_elements: int = 50, radius: float | None = None) -> CosseratRod:
    """The rod, not yet clamped.

    `radius` [m] (default: a hundredth of the length) sets how stiff it is against stretch where EA is not known,
    EA = 4 EI / radius^2: a smaller one is nearer to a beam that does not stretch, and needs smaller time steps.
    """
    r = _radius(radius)
    modulus = 4 * float(np.mean(EI_N_M2)) / (math.pi * r**4)
    rod = CosseratRod.straight_rod(
        n_elements,
        start=np.zeros(3),
        direction=np.array([math.cos(CLAMP_ANGLE_RAD), math.sin(CLAMP_ANGLE_RAD), 0.0]),
        normal=np.array([0.0, 0.0, 1.0]),
        base_length=LENGTH_M,
        base_radius=r,
        density=float(np.mean(MU_KG_M)) / (math.pi * r**2),
        youngs_modulus=modulus,
        shear_modulus=modulus / 3,
    )
    rod.bend_matrix[0, 0, :] = rod.bend_matrix[1, 1, :] = 1.0 / _cells(1.0 / np.asarray(EI_N_M2), n_elements)
    rod.rest_kappa[0, :] = _cells(np.asarray(CURVATURE_1_M), n_elements)
    share = np.r_[0.5, np.ones(n_elements - 1), 0.5] * LENGTH_M / n_elements
    rod.mass[:] = share * np.interp(np.linspace(0, 1, n_elements + 1), S, MU_KG_M)
    if STRETCH_1_N:
        edges = np.linspace(0, 1, n_elements + 1)
        rod.shear_matrix[2, 2, :] = 1.0 / _means(np.asarray(STRETCH_1_N), edges)
        rod.shear_matrix[0, 0, :] = rod.shear_matrix[1, 1, :] = 1.0 / _means(np.asarray(SHEAR_1_N), edges)
    return rod


class RodRelaxation(NoForces):  # type: ignore[misc]
    """What relaxes of the curvature moves the curvature at rest: `M = EI (kappa - sum a v)`, `tau v' = kappa - v`."""

    def __init__(self, rod: CosseratRod, time_step: float) -> None:
        super().__init__()
        self.rest = rod.rest_kappa.copy()
        self.lagging = [np.zeros_like(self.rest) for _ in RELAXATION]
        self.parts = [-math.expm1(-time_step / tau) for _, tau in RELAXATION]

    def apply_forces(self, system: Any, time: float = 0.0) -> None:  # noqa: ARG002
        """Once a step."""
        for v, part in zip(self.lagging, self.parts, strict=True):
            v += part * (system.kappa - self.rest - v)
        system.rest_kappa[:] = self.rest + sum(a * v for (a, _), v in zip(RELAXATION, self.lagging, strict=True))


def _cells(values: np.ndarray, n_elements: int) -> np.ndarray:
    """What each of the n - 1 joints between elements stands for: the integral over its cell, over an element's length.

    A cell reaches half an element to either side. The first goes on to the clamp and the last to the tip, because a
    clamped element cannot bend: without it the beam would be too stiff by half an element, just where it bends most.
    """
    edges = np.r_[0.0, np.arange(1.5, n_elements - 1) / n_elements, 1.0]
    return np.asarray(n_elements * np.diff(edges) * _means(values, edges))


def _means(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Of a table's values between edges."""
    sums = np.r_[0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(S))]
    return np.asarray(np.diff(np.interp(edges, S, sums)) / np.diff(edges))


def _radius(radius: float | None) -> float:
    """Of a round section with this EI and EA: too small a one would turn too fast for the time step."""
    known = max((4 * ei * give for ei, give in zip(EI_N_M2, STRETCH_1_N, strict=False)), default=0.0)
    return math.sqrt(known) or radius or LENGTH_M / 100


def time_step(n_elements: int = 50, radius: float | None = None) -> float:
    """s, a third of the time in which a stretch wave passes one element; PositionVerlet is stable with it."""
    stretch = 1.0 / min(STRETCH_1_N) if STRETCH_1_N else 4 * max(EI_N_M2) / _radius(radius) ** 2
    return LENGTH_M / n_elements / math.sqrt(stretch / float(np.min(MU_KG_M))) / 3
