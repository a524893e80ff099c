"""The beam as one Python file with a function `shape`, which needs neither onebend nor any other package."""

from __future__ import annotations

from importlib.resources import files

import numpy as np

from onebend.beam.model import Beam
from onebend.export.checks import checked_stiffness, refuse_masses
from onebend.records import Array

PLACES = 401
_FENCE = "# ---"  # around the lines of `alone.py` that hold the beam


def function(beam: Beam) -> str:
    """Python source: the module `onebend.export.alone` with this beam in it.

    Raises:
        ExportError: k(s) is not positive somewhere, or masses ride on the beam.
    """
    refuse_masses(beam, "the Python function")
    s = np.linspace(0.0, 1.0, PLACES)
    k = checked_stiffness(beam, s)
    return with_beam(
        "alone.py",
        [
            f"LENGTH_M = {beam.length!r}",
            f"CLAMP_ANGLE_RAD = {beam.clamp_angle!r}",
            "# Tables at equidistant places from the clamp to the tip:",
            table("K_N_M", k, "  # bending stiffness k = E I / L"),
            table("Q0_RAD", np.asarray(beam.rest_curvature(s)), "  # curvature at rest, per unit of s"),
            table("MU_KG_M", np.asarray(beam.mass_per_length(s)), "  # mass per metre"),
        ],
    )


def with_beam(module: str, lines: list[str]) -> str:
    """The source of a module of this folder, with `lines` in place of those that hold its own beam."""
    source = files("onebend.export").joinpath(module).read_text(encoding="utf-8").splitlines()
    first, last = (i for i, line in enumerate(source) if line.startswith(_FENCE))
    return "\n".join([*source[: first + 1], *lines, *source[last:]]) + "\n"


def table(name: str, values: Array, comment: str) -> str:
    """A tuple of numbers as Python source, eight a line."""
    rows = [", ".join(f"{value:.12g}" for value in values[i : i + 8]) for i in range(0, len(values), 8)]
    inside = "".join(f"    {row},\n" for row in rows)
    return f"{name} = ({comment}\n{inside})"
