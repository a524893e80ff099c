"""Every kind of export by its name."""

from __future__ import annotations

import io
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Literal, get_args
from xml.etree import ElementTree as Xml

import numpy as np
import pyarrow as pa
from numpy.polynomial.legendre import leggauss

from onebend.beam.model import Beam
from onebend.beam.stiffness import UncertainStiffness
from onebend.errors import ExportError
from onebend.files.single_file import as_parquet
from onebend.progress import one_blas_thread
from onebend.records import Array

MASSES = (1e-9, 1e6)  # kg, that a beam may have
TIMES = (1e-9, 1e6)  # s, of damping over stiffness


def text_of(value: object) -> str:
    """A number with enough digits to read it back, several in turn with spaces between, or text as it is."""
    if isinstance(value, tuple):
        return " ".join(map(text_of, value))
    return value if isinstance(value, str) else repr(float(value))  # type: ignore[arg-type]


def add(parent: Xml.Element, tag: str, text: object = None, **attributes: object) -> Xml.Element:
    """A new element of XML."""
    out = Xml.SubElement(parent, tag, {name: text_of(value) for name, value in attributes.items()})
    out.text = None if text is None else text_of(text)
    return out


def fill(parent: Xml.Element, children: dict[str, Any]) -> None:
    """New elements by their tags, each with text or with children of its own."""
    for tag, inside in children.items():
        if isinstance(inside, dict):
            fill(add(parent, tag), inside)
        else:
            add(parent, tag, inside)


def checked_damping(damping_time: float) -> float:
    """The damping time, or an `ExportError` where it is none."""
    if not TIMES[0] <= damping_time <= TIMES[1]:
        raise ExportError(
            f"the damping time must be a positive number of seconds ({TIMES[0]:g} to {TIMES[1]:g}), got "
            f"{damping_time}; without damping a chain of light links and stiff hinges rings for ever"
        )
    return damping_time


def checked_stiffness(beam: Beam, s: Array) -> Array:
    """k at `s` [N m], or an `ExportError` where it is not positive."""
    k = np.asarray(beam.stiffness(s))
    if not np.all(k > 0.0):
        raise ExportError(f"k(s) is not positive at s = {s[~(k > 0.0)][0]:.3f}; no simulator can bend such a beam")
    return k


def checked_mass(beam: Beam, mass: float | None, s: Array) -> Array:
    """Mass per metre at `s` [kg/m], `mass` [kg] spread evenly where given; or an `ExportError` where none is known."""
    if mass is not None:
        if not MASSES[0] <= mass <= MASSES[1]:
            raise ExportError(f"the mass must be a positive number of kg ({MASSES[0]:g} to {MASSES[1]:g}), got {mass}")
        return np.full(np.shape(s), mass / beam.length)
    out = np.asarray(beam.mass_per_length(s))
    if not np.all(out > 0.0):
        raise ExportError(
            "the beam's mass is not known, and a simulator in time needs it: weigh the beam and give --mass-kg "
            "(mass in Python), or write mass_kg under [beam] into recording.toml and learn again"
        )
    return out


# A beam as a chain of rigid links with springs at the hinges, the common tongue of rigid-body simulators.
#
# The beam is cut into `hinges` cells of equal length. The bending of a cell is gathered in one hinge at its middle
# (springs in series: `1 / stiffness = int ds / k`), so that the chain's shape is off by the square of a cell's
# length.

_NODES, _WEIGHTS = leggauss(8)  # of each half of a cell


@dataclass(frozen=True)
class Chain:
    """Links 0 to n: link 0 is fixed to the clamp, link i hangs on hinge i - 1. All straight."""

    hinge_s: Array  # (n,) place of each hinge along the beam
    stiffness: Array  # (n,) N m / rad
    rest: Array  # (n,) rad, turn of each hinge where the beam carries nothing
    link_length: Array  # (n + 1,) m
    link_mass: Array  # (n + 1,) kg
    link_centre: Array  # (n + 1,) m, centre of mass from the link's beginning
    link_inertia: Array  # (n + 1,) kg m^2 about that centre, of a thin rod
    clamp_angle: float  # rad, of link 0 against the clamp's x axis

    def link_of(self, s: float) -> tuple[int, float]:
        """The link that holds the place `s`, and how far along it [m]."""
        link = int(np.searchsorted(self.hinge_s, s, side="left"))
        begins = 0.0 if link == 0 else float(self.hinge_s[link - 1])
        return link, (s - begins) * float(self.link_length.sum())


def chain_of(beam: Beam, hinges: int = 40, *, mass: float | None = None) -> Chain:
    """The chain that bends as `beam` does; more `hinges` bend more finely and simulate more slowly.

    `mass`: kg, spread evenly along the beam; None takes the beam's own. Masses that ride on the beam come on top.

    Raises `ExportError`: fewer than 2 hinges, k(s) not positive, or no mass (a simulator in time cannot do without).
    """
    if hinges < 2:
        raise ExportError(f"a chain needs 2 hinges or more, got {hinges}")
    edges = np.linspace(0.0, 1.0, 2 * hinges + 1)  # halves of the cells: links begin and end in their middles
    places = 0.5 * (edges[:-1] + edges[1:])[:, None] + 0.5 * np.diff(edges)[:, None] * _NODES
    weights = 0.5 * np.diff(edges)[:, None] * _WEIGHTS
    k = checked_stiffness(beam, places)
    compliance = np.sum(weights / k, axis=1).reshape(-1, 2).sum(axis=1)
    rest = np.sum(weights * beam.rest_curvature(places), axis=1).reshape(-1, 2).sum(axis=1)
    starts = np.concatenate([[0], np.arange(1, 2 * hinges, 2)])  # first half-cell of every link
    begins = np.concatenate([edges[starts], [1.0]])
    per_metre = checked_mass(beam, mass, places)
    halves = beam.length * weights * per_metre  # kg at every node
    away = beam.length * (places - np.repeat(begins[:-1], np.diff([*starts, 2 * hinges]))[:, None])
    link_mass, first, second = (np.add.reduceat((halves * away**i).sum(axis=1), starts) for i in range(3))
    for one in beam.masses:
        link = int(np.searchsorted(edges[1::2], one.s, side="left"))
        lever = beam.length * (one.s - begins[link])
        link_mass[link] += one.mass
        first[link] += one.mass * lever
        second[link] += one.mass * lever**2
    centre = first / link_mass
    return Chain(
        hinge_s=edges[1::2],
        stiffness=1.0 / compliance,
        rest=rest,
        link_length=beam.length * np.diff(begins),
        link_mass=link_mass,
        link_centre=centre,
        link_inertia=second - link_mass * centre**2,
        clamp_angle=beam.clamp_angle,
    )


COLOUR = "0.85 0.45 0.25 1"


def mjcf(
    chain: Chain, *, damping_time: float = 0.02, sites: tuple[float, ...] = (), radius: float | None = None
) -> str:
    """An MJCF document; the beam is the body `link_0` and lies along x, bending in the x-y plane.

    `damping_time`: s, `d / k` of Kelvin-Voigt damping. `sites`: places along the beam that get a site, named `s_0.333`;
    the tip has one, `tip`. `radius`: m, of the drawn capsules alone.

    Raises `ExportError`: the damping time is not positive (the integrator needs it: the links are light).
    """
    checked_damping(damping_time)
    places = [chain.link_of(s) for s in sites]
    root = Xml.Element("mujoco", model="onebend")
    root.append(Xml.Comment(" x along the clamp, y to its left; the spring of a hinge rests at its springref "))
    add(root, "compiler", angle="radian", inertiafromgeom="false", balanceinertia="true")
    add(root, "option", timestep=min(0.002, damping_time / 2), integrator="implicitfast")
    parent = add(root, "worldbody")
    for i in range(len(chain.link_length)):
        parent = _link(parent, chain, i, damping_time, _radius(chain, radius))
        for s, (link, along) in zip(sites, places, strict=True):
            if link == i:
                add(parent, "site", name=f"s_{s:.3f}", pos=(along, "0 0"))
    add(parent, "site", name="tip", pos=(chain.link_length[-1], "0 0"))
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode") + "\n"


def _link(parent: Xml.Element, chain: Chain, i: int, damping_time: float, radius: float) -> Xml.Element:
    """Link `i`, with the hinge that carries it."""
    body = add(parent, "body", name=f"link_{i}", pos="0 0 0" if i == 0 else (chain.link_length[i - 1], "0 0"))
    if i == 0:
        half = chain.clamp_angle / 2
        body.set("quat", text_of((np.cos(half), "0 0", np.sin(half))))
    else:
        spring = {"stiffness": chain.stiffness[i - 1], "springref": chain.rest[i - 1]}
        damping = damping_time * float(chain.stiffness[i - 1])
        add(body, "joint", name=f"hinge_{i - 1}", type="hinge", axis="0 0 1", **spring, damping=damping)
    inertia = chain.link_inertia[i]
    about = (1e-3 * inertia, inertia, inertia)
    add(body, "inertial", pos=(chain.link_centre[i], "0 0"), mass=chain.link_mass[i], diaginertia=about)
    untouched = {"rgba": COLOUR, "contype": "0", "conaffinity": "0"}
    add(body, "geom", type="capsule", fromto=("0 0 0", chain.link_length[i], "0 0"), size=radius, **untouched)
    return body


# The beam as a chain in the two robot descriptions: URDF and SDF. Both lie along x and bend in the x-y plane.


def sdf(chain: Chain, *, damping_time: float = 0.02, radius: float | None = None) -> str:
    """An SDF 1.9 document; the hinges' springs stand in the joints' axes. Arguments and errors as for `mjcf`."""
    checked_damping(damping_time)
    root = Xml.Element("sdf", version="1.9")
    model = add(root, "model", name="onebend")
    begins = 0.0
    for i, length in enumerate(chain.link_length):
        link = add(model, "link", name=f"link_{i}")
        if i == 0:
            add(link, "pose", ("0 0 0 0 0", chain.clamp_angle))
        else:
            add(link, "pose", (begins, "0 0 0 0 0"), relative_to="link_0")
        centre = (chain.link_centre[i], "0 0 0 0 0")
        fill(link, {"inertial": {"pose": centre, "mass": chain.link_mass[i], "inertia": _inertia(chain, i)}})
        cylinder = {"radius": _radius(chain, radius), "length": length}
        along = (length / 2, "0 0 0 1.5707963267948966 0")
        fill(add(link, "visual", name="visual"), {"pose": along, "geometry": {"cylinder": cylinder}})
        begins += float(length)
    fill(add(model, "joint", name="clamp", type="fixed"), {"parent": "world", "child": "link_0"})
    for i, stiffness in enumerate(chain.stiffness):
        dynamics = {
            "damping": damping_time * stiffness,
            "spring_reference": chain.rest[i],
            "spring_stiffness": stiffness,
        }
        joint = {"parent": f"link_{i}", "child": f"link_{i + 1}", "axis": {"xyz": "0 0 1", "dynamics": dynamics}}
        fill(add(model, "joint", name=f"hinge_{i}", type="revolute"), joint)
    return _document(root)


def urdf(chain: Chain, *, damping_time: float = 0.02, radius: float | None = None) -> str:
    """A URDF document. URDF itself knows no springs: they stand in `<gazebo>` elements, one a joint.

    A program that reads plain URDF must take `springStiffness` and `springReference` from there, or the chain is limp.
    Arguments and errors as for `sdf`.
    """
    checked_damping(damping_time)
    robot = Xml.Element("robot", name="onebend")
    robot.append(Xml.Comment(" N m / rad and rad of every hinge's spring: springStiffness, springReference below "))
    add(robot, "link", name="clamp")
    for i, length in enumerate(chain.link_length):
        link = add(robot, "link", name=f"link_{i}")
        inertial = add(link, "inertial")
        add(inertial, "origin", xyz=(chain.link_centre[i], "0 0"))
        add(inertial, "mass", value=chain.link_mass[i])
        add(inertial, "inertia", **_inertia(chain, i))
        visual = add(link, "visual")
        add(visual, "origin", xyz=(length / 2, "0 0"), rpy="0 1.5707963267948966 0")
        add(add(visual, "geometry"), "cylinder", radius=_radius(chain, radius), length=length)
    held = add(robot, "joint", name="clamp_joint", type="fixed")
    add(held, "parent", link="clamp")
    add(held, "child", link="link_0")
    add(held, "origin", xyz="0 0 0", rpy=("0 0", chain.clamp_angle))
    for i, stiffness in enumerate(chain.stiffness):
        joint = add(robot, "joint", name=f"hinge_{i}", type="revolute")
        add(joint, "parent", link=f"link_{i}")
        add(joint, "child", link=f"link_{i + 1}")
        add(joint, "origin", xyz=(chain.link_length[i], "0 0"))
        add(joint, "axis", xyz="0 0 1")
        add(joint, "limit", lower="-3.14159", upper="3.14159", effort="1000", velocity="1000")
        add(joint, "dynamics", damping=damping_time * stiffness, friction="0")
    for i, stiffness in enumerate(chain.stiffness):
        spring = {"springStiffness": stiffness, "springReference": chain.rest[i]}
        fill(add(robot, "gazebo", reference=f"hinge_{i}"), spring)
    return _document(robot)


def _inertia(chain: Chain, i: int) -> dict[str, object]:
    """Of a slim link: about its own axis a thousandth of that about the others."""
    across, along = chain.link_inertia[i], 1e-3 * chain.link_inertia[i]
    return {"ixx": along, "ixy": "0", "ixz": "0", "iyy": across, "iyz": "0", "izz": across}


def _radius(chain: Chain, radius: float | None) -> float:
    return radius or 0.02 * float(chain.link_length.sum())


def _document(root: Xml.Element) -> str:
    Xml.indent(root)
    return '<?xml version="1.0"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"


# The beam as one Python file with a function `shape`, which needs neither onebend nor any other package.

PLACES = 401
_FENCE = "# ---"  # around the lines of `alone.py` that hold the beam


def function(beam: Beam) -> str:
    """Python source: the module `onebend.export.alone` with this beam in it.

    Raises `ExportError`: k(s) is not positive somewhere, or masses ride on the beam.
    """
    s, k = _tabulated(beam, "the Python function")
    return with_beam(
        "alone.py",
        beam,
        "# Tables at equidistant places from the clamp to the tip:",
        table("K_N_M", k, "  # bending stiffness k = E I / L"),
        table("Q0_RAD", np.asarray(beam.rest_curvature(s)), "  # curvature at rest, per unit of s"),
        table("MU_KG_M", np.asarray(beam.mass_per_length(s)), "  # mass per metre"),
    )


def _tabulated(beam: Beam, what: str) -> tuple[Array, Array]:
    """Places, and k(s) there; `ExportError` where something rides on the beam, which `what` does not carry."""
    if beam.masses:
        raise ExportError(f"{what} holds a mass per metre only, and {len(beam.masses)} masses ride on this beam")
    s = np.linspace(0.0, 1.0, PLACES)
    return s, checked_stiffness(beam, s)


def with_beam(module: str, beam: Beam, *lines: str) -> str:
    """The source of a module of this folder, with the beam in place of its own."""
    source = files("onebend.export").joinpath(module).read_text(encoding="utf-8").splitlines()
    first, last = (i for i, line in enumerate(source) if line.startswith(_FENCE))
    sizes = (f"LENGTH_M = {beam.length!r}", f"CLAMP_ANGLE_RAD = {beam.clamp_angle!r}")
    return "\n".join([*source[: first + 1], *sizes, *lines, *source[last:]]) + "\n"


def table(name: str, values: Array, comment: str) -> str:
    """A tuple of numbers as Python source, eight a line."""
    rows = [", ".join(f"{value:.12g}" for value in values[i : i + 8]) for i in range(0, len(values), 8)]
    inside = "".join(f"    {row},\n" for row in rows)
    return f"{name} = ({comment}\n{inside})"


def pyelastica(beam: Beam, *, mass: float | None = None) -> str:
    """Python source: the module `onebend.export.rod` with this beam in it.

    Args:
        mass: kg, spread evenly along the beam; None takes the beam's own.

    Raises `ExportError`: k(s) is not positive somewhere, no mass is known, or masses ride on the beam.
    """
    s, k = _tabulated(beam, "the PyElastica rod")
    return with_beam(
        "rod.py",
        beam,
        table("S", s, ""),
        table("EI_N_M2", beam.length * k, "  # bending stiffness"),
        table("CURVATURE_1_M", np.asarray(beam.rest_curvature(s)) / beam.length, "  # at rest"),
        table("MU_KG_M", checked_mass(beam, mass, s), "  # mass per metre"),
    )


# The beam as a table along s: CSV-like columns for NumPy (.npz) and Parquet.

TABLE_PLACES = 201


def columns(beam: Beam, uncertain: UncertainStiffness | None = None) -> dict[str, Array]:
    """Name, with unit, to (201,) values: s, k and its 95 % band, EI and its band, curvature at rest, mass per metre.

    The band is NaN where none was learned; `identified` is then 0, as it is where the data did not tell or the band
    is not to be trusted.
    """
    s = np.linspace(0.0, 1.0, TABLE_PLACES)
    k = np.asarray(beam.stiffness(s))
    low = high = np.full(TABLE_PLACES, np.nan)
    identified = np.zeros(TABLE_PLACES)
    if uncertain is not None:
        band = uncertain.band(s)
        low, high, identified = band.low, band.high, band.identified.astype(float)
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
        "rest_curvature_1_m": np.asarray(beam.rest_curvature(s)) / beam.length,
        "mass_per_length_kg_m": np.asarray(beam.mass_per_length(s)),
    }


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

    `uncertain`: the band on k, for the tables. `hinges`: of the chains (MuJoCo, URDF, SDF). `mass`: kg, spread evenly,
    where the beam's own is not known; the simulators in time need one. `damping_time`: s, the chains' damping over
    stiffness. `sites`: places that get a site in MuJoCo.

    Raises `ExportError`: an unknown kind, k(s) not positive, no mass, or a setting without meaning.
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
