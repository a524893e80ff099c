"""A beam as a Python file: a module of this folder with the beam's numbers between its fences."""

from __future__ import annotations

from importlib.resources import files

import numpy as np

from onebend.errors import ExportError
from onebend.export.chain import chain_of
from onebend.export.sample import Request, RodSample
from onebend.records import Array

PLACES = 401
# EA and kGA over EI / L^2, in Newton where they are not known. SolverVBD counts in single precision, so that stiffer
# links keep forces that do not balance.
STRETCH = 1000.0
_FENCE = "# ---"  # around the lines that hold the beam


def function(rod: RodSample, asked: Request) -> str:
    """The module `alone`, which needs no package. Raises `ExportError` as `_tabulated`."""
    s, k = _tabulated(rod, "the Python function")
    stretch, shear = (1.0 / one for one in rod.axial(s))
    return _with_beam(
        "alone.py",
        rod,
        (*asked.notes, "Tables at equidistant places from the clamp to the tip:"),
        _table("K_N_M", k, "bending stiffness k = E I / L"),
        _table("Q0_RAD", np.asarray(rod.beam.rest_curvature(s)), "curvature at rest, per unit of s"),
        _table("MU_KG_M", np.asarray(rod.beam.mass_per_length(s)), "mass per metre"),
        _table("STRETCH_1_N", stretch, "1 / EA"),
        _table("SHEAR_1_N", shear, "1 / kGA"),
    )


def pyelastica(rod: RodSample, asked: Request) -> str:
    """The module `elastica_rod`. Raises `ExportError` as `_tabulated`, and where no mass is known."""
    s, k = _tabulated(rod, "the PyElastica rod")
    stretch, shear = (1.0 / one if rod.stretches else np.zeros(0) for one in rod.axial(s))
    return _with_beam(
        "elastica_rod.py",
        rod,
        asked.notes,
        _table("S", s, "places along the beam"),
        _table("EI_N_M2", rod.instantaneous * rod.beam.length * k, "bending stiffness, at once"),
        _table("CURVATURE_1_M", np.asarray(rod.beam.rest_curvature(s)) / rod.beam.length, "at rest"),
        _table("MU_KG_M", rod.mass(s), "mass per metre"),
        _table("STRETCH_1_N", stretch, "1 / EA; empty where it is not known"),
        _table("SHEAR_1_N", shear, "1 / kGA"),
        _relaxation(rod),
    )


def newton(rod: RodSample, asked: Request) -> str:
    """The module `newton_rod`. Raises `ExportError` as `chain_of`."""
    chain = chain_of(rod, asked.hinges)
    span = np.append(chain.link_length[:-2], chain.link_length[-2] + chain.link_length[-1])
    slack = STRETCH * float(np.mean(rod.stiffness(np.linspace(0.0, 1.0, PLACES)))) / rod.beam.length / span
    said = "" if rod.stretches else "; EA is not known: so stiff that it stretches little"
    return _with_beam(
        "newton_rod.py",
        rod,
        asked.notes,
        _table("LINK_LENGTH_M", chain.link_length, ""),
        _table("LINK_MASS_KG", chain.link_mass, ""),
        _table("LINK_CENTRE_M", chain.link_centre, "centre of mass from the link's beginning"),
        _table("LINK_INERTIA_KG_M2", chain.link_inertia, "about it"),
        _table("BEND_N_M", rod.instantaneous * chain.stiffness, "per radian: EI over the length of a cell, at once"),
        _table("REST_RAD", chain.rest, "turn of each hinge at rest"),
        _table("STRETCH_N_M", slack if chain.stretch is None else chain.stretch, f"EA over the length of a link{said}"),
        _table("SHEAR_N_M", slack if chain.shear is None else chain.shear, "kGA over the length of a link"),
        f"DAMPING_TIME_S = {rod.loss_time!r}  # damping over stiffness",
        _relaxation(rod),
    )


def sofa(rod: RodSample, asked: Request) -> str:
    """The module `sofa_scene`: every cell of the chain is a section. Raises `ExportError` as `chain_of`."""
    chain = chain_of(rod, asked.hinges)
    cell = rod.beam.length / asked.hinges
    return _with_beam(
        "sofa_scene.py",
        rod,
        asked.notes,
        _table("EI_N_M2", cell * chain.stiffness, "of each section"),
        _table("CURVATURE_1_M", chain.rest / cell, "at rest"),
        _table("FRAME_MASS_KG", chain.link_mass, "where sections meet, and at both ends"),
        _table("FRAME_INERTIA_KG_M2", chain.link_inertia, ""),
        f"DAMPING_TIME_S = {rod.loss_time!r}  # damping over stiffness",
    )


def _tabulated(rod: RodSample, what: str) -> tuple[Array, Array]:
    """Places, and k(s) there; `ExportError` where k is not positive, or something rides on the beam."""
    if rod.beam.masses:
        raise ExportError(
            f"{what} holds a mass per metre only, and {len(rod.beam.masses)} masses ride on this beam; "
            "export a chain, for example to mujoco"
        )
    s = np.linspace(0.0, 1.0, PLACES)
    return s, rod.stiffness(s)


def _with_beam(module: str, rod: RodSample, notes: tuple[str, ...], *lines: str) -> str:
    """The source of a module of this folder, with the beam in place of its own."""
    source = files("onebend.export").joinpath(module).read_text(encoding="utf-8").splitlines()
    first, last = (i for i, line in enumerate(source) if line.startswith(_FENCE))
    sizes = (f"LENGTH_M = {rod.beam.length!r}", f"CLAMP_ANGLE_RAD = {rod.beam.clamp_angle!r}")
    head = tuple(f"# {note}" for note in notes)
    return "\n".join([*source[: first + 1], *head, *sizes, *lines, *source[last:]]) + "\n"


def _table(name: str, values: Array, comment: str) -> str:
    """A tuple of numbers as Python source, eight a line."""
    rows = [", ".join(f"{value:.12g}" for value in values[i : i + 8]) for i in range(0, len(values), 8)]
    inside = "".join(f"    {row},\n" for row in rows)
    return f"{name} = ({f'  # {comment}' if comment else ''}\n{inside})"


def _relaxation(rod: RodSample) -> str:
    parts = "".join(f"({part.share!r}, {part.time!r}), " for part in rod.relaxation)
    return f"RELAXATION = ({parts.rstrip()})  # shares that relax, and their times in s"
