"""Every kind of export by its name: what it is, what it carries of a beam, and how exact it is."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import pyarrow as pa

from onebend.beam.model import Beam
from onebend.errors import ExportError
from onebend.export import documents, source
from onebend.export.chain import HINGES
from onebend.export.sample import PARTS, Request, RodSample, axial_bands, drawn_for_bands, left_out, rod_sample
from onebend.files.single_file import as_csv, as_parquet
from onebend.progress import one_blas_thread
from onebend.records import Array

TABLE_PLACES = 201


def columns(rod: RodSample, samples: tuple[RodSample, ...] = ()) -> dict[str, Array]:
    """Name, with unit, to (201,) values: s, k and its 95 % band, EI and its band, EA and kGA and their bands, curvature
    at rest, mass per metre, and k of each sample.

    The band is NaN where none was learned, EA and kGA where they are not known; `identified` is 0 where the data did
    not tell or the band is not to be trusted.
    """
    s = np.linspace(0.0, 1.0, TABLE_PLACES)
    beam, unknown = rod.beam, np.full(TABLE_PLACES, np.nan)
    k, low, high, identified = np.asarray(beam.stiffness(s)), unknown, unknown, np.zeros(TABLE_PLACES)
    if rod.uncertain is not None:
        band = rod.uncertain.band(s)
        low, high, identified = band.low, band.high, band.identified.astype(float)
    axial = dict(zip(("EA", "kGA"), rod.axial(s) if rod.stretches else (unknown, unknown), strict=True))
    bands = axial_bands(rod, drawn_for_bands(rod) if rod.stretches else (), s)
    digits = len(str(len(samples)))
    return {
        "s": s,
        "s_m": beam.length * s,
        "k_N_m": k,
        "k_lo_N_m": low,
        "k_hi_N_m": high,
        "EI_N_m2": beam.length * k,
        "EI_lo_N_m2": beam.length * low,
        "EI_hi_N_m2": beam.length * high,
        "identified": identified,
        **{f"{name}_N": value for name, value in axial.items()},
        **{f"{name}_{end}_N": one for name, band in bands.items() for end, one in zip(("lo", "hi"), band, strict=True)},
        "rest_curvature_1_m": np.asarray(beam.rest_curvature(s)) / beam.length,
        "mass_per_length_kg_m": np.asarray(beam.mass_per_length(s)),
    } | {f"k_{i:0{digits}d}_N_m": np.asarray(one.beam.stiffness(s)) for i, one in enumerate(samples, 1)}


def _npz(rod: RodSample, asked: Request) -> bytes:
    memory = io.BytesIO()
    np.savez(memory, **columns(rod, asked.samples))  # type: ignore[arg-type]
    return memory.getvalue()


def _table(as_bytes: Callable[[pa.Table], bytes]) -> Callable[[RodSample, Request], bytes]:
    return lambda rod, asked: as_bytes(pa.table(columns(rod, asked.samples)))


def _sheet(rod: RodSample, _: Request) -> bytes:
    from onebend.export.sheet import sheet  # here: other kinds draw nothing

    return sheet(rod)


Kind = Literal[
    "mujoco", "mujoco-flex", "newton", "pyelastica", "sofa", "usd", "urdf", "sdf",
    "python", "sheet", "csv", "numpy", "parquet",
]  # fmt: skip
TABLES: tuple[Kind, ...] = ("csv", "numpy", "parquet")


@dataclass(frozen=True)
class ExportKind:
    """One kind of export, described for people."""

    write: Callable[[RodSample, Request], str | bytes]
    suffix: str
    says: str
    use: str  # a line to try next; `{path}` is the file
    carries: frozenset[str]  # of `PARTS`, as the software reads them
    hinges: int = HINGES  # of a chain, where nobody says how many


_ALL = frozenset(PARTS)
_RIGID = _ALL - {"stretch and shear", "relaxation"}
_TABLE = _ALL - {"riding masses", "damping", "relaxation"}
_VIEW = "python -m mujoco.viewer --mjcf={path}"
# fmt: off
KINDS: dict[Kind, ExportKind] = {
    "mujoco": ExportKind(documents.mjcf, ".xml", "MJCF, a chain of hinges with springs", _VIEW, _ALL - {"relaxation"}),
    "mujoco-flex": ExportKind(documents.flex, ".xml", "MJCF, a flex of one dimension, which bends in all directions",
                              _VIEW, _RIGID - {"rest shape"}),
    # SolverVBD needs iterations with the square of the number of hinges, and more
    "newton": ExportKind(source.newton, ".py", "a Python file with `add_beam(builder)` for Newton's SolverVBD",
                         "from {path} take add_beam", _ALL, hinges=20),
    "pyelastica": ExportKind(source.pyelastica, ".py", "a Python file with `make_rod(n_elements)` for PyElastica",
                             "from {path} take make_rod", _ALL - {"riding masses", "damping"}),
    "sofa": ExportKind(source.sofa, ".py", "a SOFA scene for the plugin Cosserat", "runSofa {path}", _RIGID),
    "usd": ExportKind(documents.usda, ".usda", "USD, a chain of joints with drives (UsdPhysics)",
                      "usdview {path}", _ALL - {"relaxation"}),
    "urdf": ExportKind(documents.urdf, ".urdf", "URDF, the springs in `<gazebo>` elements",
                       "a reader of plain URDF sees no springs", _RIGID),
    "sdf": ExportKind(documents.sdf, ".sdf", "SDF 1.9, a chain of hinges with springs", "gz sim {path}", _RIGID),
    "python": ExportKind(source.function, ".py", "a Python file with `shape(force, at_s)`, which needs no package",
                         "python -i {path}", _TABLE),
    "sheet": ExportKind(_sheet, ".pdf", "a page for people, and the table beside it", "open {path}", _ALL),
    "csv": ExportKind(_table(as_csv), ".csv", "a table along s", "open {path}", _TABLE),
    "numpy": ExportKind(_npz, ".npz", "a table along s for numpy.load", "numpy.load('{path}')['k_N_m']", _TABLE),
    "parquet": ExportKind(_table(as_parquet), ".parquet", "a table along s", "pandas.read_parquet('{path}')", _TABLE),
}
# fmt: on
assert set(KINDS) == set(get_args(Kind))


def without(rod: RodSample, kind: Kind) -> tuple[str, ...]:
    """What this kind leaves out of the beam: sentences with the amount."""
    return left_out(rod, KINDS[kind].carries)


@one_blas_thread
def export(
    beam: RodSample | Beam, kind: Kind, *, hinges: int | None = None, samples: tuple[RodSample, ...] = ()
) -> str | bytes:
    """The content of a file of this kind.

    `beam`: from `rod_sample` or `results.model.sample_of_model`; a bare `Beam` has no damping, band or places of tags.
    `hinges`: of the chains; None takes the kind's own number. `samples`: draws of it, for the columns of a table.

    Raises `ExportError`: an unknown kind, k(s) not positive, no mass, or a setting without meaning.
    """
    if kind not in KINDS:
        raise ExportError(f"no export to {kind!r}; there are {', '.join(KINDS)}")
    rod, one = rod_sample(beam) if isinstance(beam, Beam) else beam, KINDS[kind]
    units = f"A beam of {rod.beam.length:g} m, from onebend. Lengths in m, masses in kg, times in s, angles in rad."
    notes = (units, *without(rod, kind))
    return one.write(rod, Request(one.hinges if hinges is None else hinges, notes, samples))
