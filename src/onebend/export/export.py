"""Every kind of export by its name."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import pyarrow as pa

from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.blas import one_blas_thread
from onebend.errors import ExportError
from onebend.export.chain import chain_of
from onebend.export.function import function
from onebend.export.mujoco import mjcf
from onebend.export.pyelastica import pyelastica
from onebend.export.robot import sdf, urdf
from onebend.export.table import columns
from onebend.files.arrow import as_parquet

DAMPING_TIME = 0.02  # s, where no swing was filmed

Kind = Literal["mujoco", "pyelastica", "urdf", "sdf", "numpy", "parquet", "python"]


@dataclass(frozen=True)
class ExportKind:
    """One kind of export, described for people."""

    suffix: str
    says: str
    use: str  # a line to try next; `{path}` is the file


KINDS: dict[Kind, ExportKind] = {
    "mujoco": ExportKind(".xml", "MJCF, a chain of hinges with springs", "python -m mujoco.viewer --mjcf={path}"),
    "pyelastica": ExportKind(".py", "a Python file with make_rod() for PyElastica", "from {path} take make_rod"),
    "urdf": ExportKind(".urdf", "URDF, the springs in <gazebo> elements", "a reader of plain URDF sees no springs"),
    "sdf": ExportKind(".sdf", "SDF 1.9, a chain of hinges with springs", "gz sim {path}"),
    "numpy": ExportKind(".npz", "a table along s for numpy.load", "numpy.load('{path}')['k_N_m']"),
    "parquet": ExportKind(".parquet", "a table along s", "pandas.read_parquet('{path}')"),
    "python": ExportKind(".py", "a Python file with shape(force, at_s), which needs no package", "python -i {path}"),
}
assert set(KINDS) == set(get_args(Kind))


def suffix_of(kind: Kind) -> str:
    """The usual ending of such a file's name."""
    return KINDS[kind].suffix


@one_blas_thread
def export(
    beam: Beam,
    kind: Kind,
    *,
    uncertain: UncertainStiffness | None = None,
    hinges: int = 40,
    mass: float | None = None,
    damping_time: float = DAMPING_TIME,
    sites: tuple[float, ...] = (),
) -> str | bytes:
    """The content of a file of this kind.

    Args:
        uncertain: the band on k, for the tables.
        hinges: of the chains (MuJoCo, URDF, SDF).
        mass: kg, spread evenly, where the beam's own is not known; the simulators in time need one.
        damping_time: s, the chains' damping over stiffness.
        sites: places that get a site in MuJoCo.

    Raises:
        ExportError: an unknown kind, k(s) not positive, no mass, or a setting without meaning.
    """
    if kind not in KINDS:
        raise ExportError(f"no export to {kind!r}; there are {', '.join(KINDS)}")
    if kind == "python":
        return function(beam)
    if kind == "pyelastica":
        return pyelastica(beam, mass=mass)
    if kind in ("numpy", "parquet"):
        return _table(beam, uncertain, parquet_file=kind == "parquet")
    chain = chain_of(beam, hinges, mass=mass)
    if kind == "mujoco":
        return mjcf(chain, damping_time=damping_time, sites=sites)
    return (urdf if kind == "urdf" else sdf)(chain, damping_time=damping_time)


def _table(beam: Beam, uncertain: UncertainStiffness | None, *, parquet_file: bool) -> bytes:
    table = columns(beam, uncertain)
    if parquet_file:
        return as_parquet(pa.table(table))
    memory = io.BytesIO()
    np.savez(memory, **table)  # type: ignore[arg-type]
    return memory.getvalue()
