"""The beam as one Python file that makes a PyElastica rod, with the bending stiffness of every element."""

from __future__ import annotations

import numpy as np

from onebend.beam.model import Beam
from onebend.export.checks import checked_mass, checked_stiffness, refuse_masses
from onebend.export.function import PLACES, table, with_beam


def pyelastica(beam: Beam, *, mass: float | None = None) -> str:
    """Python source: the module `onebend.export.rod` with this beam in it.

    Args:
        mass: kg, spread evenly along the beam; None takes the beam's own.

    Raises:
        ExportError: k(s) is not positive somewhere, no mass is known, or masses ride on the beam.
    """
    refuse_masses(beam, "the PyElastica rod")
    s = np.linspace(0.0, 1.0, PLACES)
    k = checked_stiffness(beam, s)
    return with_beam(
        "rod.py",
        [
            f"LENGTH_M = {beam.length!r}",
            f"CLAMP_ANGLE_RAD = {beam.clamp_angle!r}",
            table("S", s, ""),
            table("EI_N_M2", beam.length * k, "  # bending stiffness"),
            table("CURVATURE_1_M", np.asarray(beam.rest_curvature(s)) / beam.length, "  # at rest"),
            table("MU_KG_M", checked_mass(beam, mass, s), "  # mass per metre"),
        ],
    )
