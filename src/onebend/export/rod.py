"""A slender beam as a PyElastica rod. Needs NumPy and PyElastica, no other package.

    rod = make_rod(n_elements=50)
    simulator.append(rod)
    simulator.constrain(rod).using(elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))

The rod begins straight, at the clamp and along its direction, and bends in the x-y plane; where the beam is curved at
rest it moves there. It is round and much stiffer against stretch and shear than against bending.
"""

import math

import numpy as np
from elastica import CosseratRod

# --- the beam -------------------------------------------------------------------------------------------------------
LENGTH_M = 1.0
CLAMP_ANGLE_RAD = 0.0
S: tuple[float, ...] = (0.0, 1.0)  # places along the beam
EI_N_M2: tuple[float, ...] = (1.0, 1.0)  # bending stiffness; linear between the places in 1 / EI
CURVATURE_1_M: tuple[float, ...] = (0.0, 0.0)  # at rest
MU_KG_M: tuple[float, ...] = (1.0, 1.0)  # mass per metre
# --------------------------------------------------------------------------------------------------------------------


def make_rod(n_elements: int = 50, radius: float | None = None) -> CosseratRod:
    """The rod, not yet clamped.

    `radius` [m] (default: a hundredth of the length) sets how stiff it is against stretch, EA = 4 EI / radius^2: a
    smaller one is nearer to a beam that does not stretch, and needs smaller time steps (see `time_step`).
    """
    r = LENGTH_M / 100 if radius is None else radius
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
    compliance = _cells(1.0 / np.asarray(EI_N_M2), n_elements)
    rod.bend_matrix[0, 0, :] = rod.bend_matrix[1, 1, :] = 1.0 / compliance
    rod.rest_kappa[0, :] = _cells(np.asarray(CURVATURE_1_M), n_elements)
    share = np.r_[0.5, np.ones(n_elements - 1), 0.5] * LENGTH_M / n_elements
    rod.mass[:] = share * np.interp(np.linspace(0, 1, n_elements + 1), S, MU_KG_M)
    return rod


def _cells(values: np.ndarray, n_elements: int) -> np.ndarray:
    """What each of the n - 1 joints between elements stands for: the integral over its cell, over an element's length.

    A cell reaches half an element to either side. The first goes on to the clamp and the last to the tip, because a
    clamped element cannot bend: without it the beam would be too stiff by half an element, just where it bends most.
    """
    s = np.asarray(S)
    sums = np.r_[0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(s))]
    edges = np.r_[0.0, np.arange(1.5, n_elements - 1) / n_elements, 1.0]
    return n_elements * np.diff(np.interp(edges, s, sums))


def time_step(n_elements: int = 50, radius: float | None = None) -> float:
    """s, a third of the time in which a stretch wave passes one element; PositionVerlet is stable with it."""
    r = LENGTH_M / 100 if radius is None else radius
    speed = math.sqrt(4 * float(np.max(EI_N_M2)) / (r**2 * float(np.min(MU_KG_M))))
    return LENGTH_M / n_elements / speed / 3
