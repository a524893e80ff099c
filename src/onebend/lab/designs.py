"""Designs of beams to cast: a width along the beam and a material.

A design is a flat bar, `depth` thick across the plane of bending and w(s) wide in it: `EI = E depth w^3 / 12`,
`k = EI / L`. The three named designs follow Section IV-B of the paper: widths of first, second and third order, weakest
at the base, in the middle and near the tip. The paper prints no sizes; these are ours.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline, make_lsq_spline
from scipy.linalg import eigvals
from scipy.optimize import brentq

from onebend.beam import continuation, loads, model, statics
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.section import SectionProfiles, rectangular_bar
from onebend.beam.stiffness import Polyline, Powers, Profile, Steps, Table, UncertainStiffness, Uniform
from onebend.beam.vibration import vibration
from onebend.errors import MechanicsError, ResultsError
from onebend.files.single_file import write_file
from onebend.learning.outcome import Notice
from onebend.progress import one_blas_thread
from onebend.recording.schema import Mistakes, key, keys_of, number, one_of, read_table, report_unknown, several
from onebend.records import Array
from onebend.text_files import read_toml

# Young's modulus of castable silicones from hardness. It carries an sd of log E: the relation's scatter against makers'
# figures, and the usual tolerance of a hardness.

HARDNESS_SD = 2.5  # points; makers allow +-5
GENT_FIT, BEYOND_GENT = 0.25, 0.5  # sd of log E of the relation, in its range and outside
GENT_RANGE, SHORE_RANGE = (20.0, 80.0), (5.0, 95.0)
TYPICAL_DENSITY = 1080.0  # kg/m^3, unfilled castable silicone


@dataclass(frozen=True)
class ModulusEstimate:
    modulus: float  # Pa, at small strain
    log_sd: float  # sd of log E
    source: str  # one line


def from_shore_a(shore: float) -> ModulusEstimate:
    """E from Shore A: A. N. Gent, Rubber Chem. Technol. 31 (1958) 896, a rigid flat punch on a half-space.

    Derived for 20 to 80; used from 5 to 95 with a wider band. Raises `MechanicsError`: a hardness outside 5 to 95.
    """
    if not SHORE_RANGE[0] <= shore <= SHORE_RANGE[1]:
        raise MechanicsError(
            f"Shore A {shore:g}: the relation to a modulus holds from {SHORE_RANGE[0]:g} to {SHORE_RANGE[1]:g}. "
            "Give the modulus"
        )
    modulus = 0.0981e6 * (56.0 + 7.62336 * shore) / (0.137505 * (254.0 - 2.54 * shore))
    per_point = 7.62336 / (56.0 + 7.62336 * shore) + 1.0 / (100.0 - shore)
    fit = GENT_FIT if GENT_RANGE[0] <= shore <= GENT_RANGE[1] else BEYOND_GENT
    return ModulusEstimate(modulus, math.hypot(fit, per_point * HARDNESS_SD), f"Shore A {shore:g} by Gent (1958)")


PLACES = 2001  # where the width is checked
INTERVALS = 48  # of the spline of log k
SLENDER = 5.0  # a bar shorter than this many widths shears noticeably


@dataclass(frozen=True)
class Design:
    name: str
    length: float  # L, m
    depth: float  # m, across the plane of bending
    width: Profile  # w(s), m, in the plane of bending
    modulus: float  # E, Pa
    modulus_log_sd: float  # sd of log E; 0: known
    density: float  # kg/m^3
    source: str = "given"  # source of E

    def __post_init__(self) -> None:
        sizes = {"length": self.length, "depth": self.depth, "modulus": self.modulus, "density": self.density}
        for what, size in sizes.items():
            if not (np.isfinite(size) and size > 0.0):
                raise MechanicsError(f"design {self.name!r}: its {what} must be a positive number, got {size}")
        if not (np.isfinite(self.modulus_log_sd) and self.modulus_log_sd >= 0.0):
            raise MechanicsError(f"design {self.name!r}: the sd of log E must be at least 0, got {self.modulus_log_sd}")
        s = np.linspace(0.0, 1.0, PLACES)
        width = np.asarray(self.width(s), dtype=float)
        if not np.all(np.isfinite(width) & (width > 0.0)):
            bad = int(np.flatnonzero(~(np.isfinite(width) & (width > 0.0)))[0])
            raise MechanicsError(
                f"design {self.name!r}: the width must be positive all along, but is {width[bad]:.4g} m at s = "
                f"{s[bad]:.3f}. Give a larger width there"
            )

    @cached_property
    def along(self) -> SectionProfiles:
        return rectangular_bar(
            Uniform(self.depth), self.width, length=self.length, modulus=self.modulus, density=self.density
        )

    @property
    def mass(self) -> float:
        """kg, clamp to tip."""
        x, w = np.polynomial.legendre.leggauss(16)
        edges = np.asarray(self.along.mass_per_length.edges)
        s = edges[:-1, None] + 0.5 * np.diff(edges)[:, None] * (x + 1.0)
        return float(self.length * np.sum(0.5 * np.diff(edges)[:, None] * w * self.along.mass_per_length(s)))

    @property
    def remarks(self) -> tuple[Notice, ...]:
        """Limits of slender-beam mechanics that the design exceeds."""
        widest = float(np.max(np.asarray(self.width(np.linspace(0.0, 1.0, PLACES)))))
        return (Notice("not slender", {"widths": self.length / widest}),) if self.length < SLENDER * widest else ()

    def bending(self, s: Array | float) -> Array:
        return np.asarray(self.modulus * self.depth * np.asarray(self.width(s)) ** 3 / 12.0)

    def beam(self) -> model.Beam:
        """The beam with its mass, straight at rest."""
        return model.Beam(self.length, self.along.stiffness, mass_per_length=self.along.mass_per_length)

    def uncertain(self) -> UncertainStiffness:
        """k(s) with the band of the modulus alone: one common scale."""
        kinks = np.asarray(self.along.stiffness.jumps)
        even = np.linspace(0.0, 1.0, INTERVALS + 1)[1:-1]
        inner = np.concatenate([even[~np.isin(even, kinks)], np.repeat(kinks, 3)])
        knots = np.concatenate([np.zeros(4), np.sort(inner), np.ones(4)])
        s = np.unique(np.concatenate([np.linspace(a, b, 12) for a, b in pairwise(np.unique(knots))]))
        spline = make_lsq_spline(s, np.log(self.along.stiffness(s)), knots, k=3)
        count = len(spline.c)
        return UncertainStiffness(knots, np.asarray(spline.c), np.zeros((count, count)), self.modulus_log_sd)


def _named(name: str, width: tuple[float, ...]) -> Design:
    by = from_shore_a(30.0)
    return Design(name, 0.15, 0.03, Powers(width), by.modulus, by.log_sd, TYPICAL_DENSITY, by.source)


DESIGNS = {
    design.name: design
    for design in (
        _named("uniform", (0.014,)),
        _named("linear", (0.010, 0.010)),
        _named("quadratic", (0.018, -0.032, 0.032)),  # 18, 10, 18 mm at s = 0, 0.5, 1
        _named("cubic", (0.014, 0.0405, -0.1035, 0.060)),  # widest (18.6 mm) at s = 0.25, narrowest (10.4 mm) at 0.9
    )
}


def design_named(name: str) -> Design:
    """Raises `MechanicsError`: not one of `DESIGNS`."""
    if name not in DESIGNS:
        near = difflib.get_close_matches(name, DESIGNS, n=1)
        hint = f"Did you mean {near[0]!r}? " if near else ""
        raise MechanicsError(
            f"no design is named {name!r}, and no such file exists. {hint}Named designs: {', '.join(DESIGNS)}. "
            "For your own: onebend design --new my-beam.toml"
        )
    return DESIGNS[name]


def width_table(s: tuple[float, ...], width: tuple[float, ...]) -> Table:
    """Widths at places from 0 to 1, monotone cubic between. Raises `MechanicsError`: places that do not rise from 0 to
    1, or a different number of widths."""
    if not s or s[0] != 0.0 or s[-1] != 1.0:
        raise MechanicsError(f"the places of a width must run from 0 to 1, got {list(s)}")
    return Table(s, width)


FORMAT = 1
TABLES = ("beam", "width", "material")


@dataclass(frozen=True)
class SizeEntry:
    """[beam]: outer sizes."""

    length: float = key("length_m", number(above=0))
    depth: float = key("depth_m", number(above=0))


@dataclass(frozen=True)
class WidthEntry:
    """[width]: the size in the plane of bending, a polynomial or a table."""

    polynomial: tuple[float, ...] = key("polynomial_m", several(number(), least=1), ())
    s: tuple[float, ...] = key("s", several(number(least=0, most=1), least=2), ())
    width: tuple[float, ...] = key("width_m", several(number(above=0), least=2), ())
    between: Literal["smooth", "straight"] = key("between", one_of("smooth", "straight"), "smooth")


@dataclass(frozen=True)
class MaterialEntry:
    """[material]: a hardness, or a modulus."""

    shore_a: float = key("shore_a", number(), math.nan)
    modulus: float = key("modulus_Pa", number(above=0), math.nan)
    modulus_log_sd: float = key("modulus_log_sd", number(least=0), math.nan)
    density: float = key("density_kg_m3", number(above=0), math.nan)


def read_design(path: Path | str) -> Design:
    """The design in a TOML file (keys: docs/lab.md). Raises `MechanicsError`: unreadable file, or all its errors, each
    with its line."""
    path = Path(path)
    content, data = _load(path)
    mistakes = Mistakes(str(path), content)
    report_unknown(data, ["format", "name", *TABLES], (), mistakes)
    if data.get("format") != FORMAT:
        mistakes.add(("format",), f"format must be {FORMAT}. Add `format = {FORMAT}` at the top.")
    name = data.get("name", path.stem)
    if not isinstance(name, str) or not name.strip():
        mistakes.add(("name",), 'name must be text in quotes, such as "my beam".')
    for table in TABLES:
        if table not in data:
            mistakes.add((), f"the file lacks the table [{table}]. `onebend design --new FILE` writes a whole one.")
    sizes = read_table(SizeEntry, data.get("beam", {}), ("beam",), mistakes) if "beam" in data else None
    width = _width(data["width"], mistakes) if "width" in data else None
    material = _material(data["material"], mistakes) if "material" in data else None
    if mistakes.found or sizes is None or width is None or material is None:
        raise MechanicsError(str(mistakes))
    stiffness, density = material
    try:
        return Design(
            name, sizes.length, sizes.depth, width, stiffness.modulus, stiffness.log_sd, density, stiffness.source
        )
    except MechanicsError as wrong:
        raise MechanicsError(f"{path}: {wrong}") from None


def find_design(name_or_path: str) -> Design:
    path = Path(name_or_path)
    return read_design(path) if path.suffix == ".toml" or path.is_file() else design_named(name_or_path)


def write_design_template(path: Path | str) -> Path:
    """Write a commented design to fill in; returns its path. Raises `MechanicsError`: the file exists, or cannot be
    written."""
    path = Path(path)
    if path.exists():
        raise MechanicsError(f"{path} exists already. Edit it, or name another file.")
    try:
        write_file(path, template())
    except ResultsError as wrong:
        raise MechanicsError(str(wrong)) from None
    return path


def template() -> str:
    rows = [
        "# A beam to cast, for onebend. Fill in your own values; lines that start with # are another way to say it.",
        "# It bends in the plane of its width; its depth is the size across that plane.",
        "",
        f"format = {FORMAT}",
        '# name = "my beam"',
    ]
    written = {"length_m", "depth_m", "s", "width_m", "between", "shore_a"}
    for title, record in zip(TABLES, (SizeEntry, WidthEntry, MaterialEntry), strict=True):
        rows += ["", f"[{title}]"]
        for entry, _ in keys_of(record).values():
            row = f"{entry.name} = {entry.example}"
            rows.append(f"{row if entry.name in written else '# ' + row}  # {entry.says}")
    return "\n".join([*rows, ""])


def _load(path: Path) -> tuple[str, dict[str, Any]]:
    if not path.exists():
        raise MechanicsError(f"{path} does not exist. Write one with `onebend design --new {path}`.")
    return read_toml(path, MechanicsError)


def _width(table: Any, mistakes: Mistakes) -> Profile | None:
    entry = read_table(WidthEntry, table, ("width",), mistakes)
    if entry is None:
        return None
    tabled = bool(entry.s or entry.width)
    if tabled == bool(entry.polynomial):
        mistakes.add(("width",), "[width] needs either polynomial_m, or s and width_m, not both.")
    elif tabled and (len(entry.s) != len(entry.width) or entry.s[0] != 0.0 or entry.s[-1] != 1.0):
        mistakes.add(("width", "s"), "[width] s must run from 0 to 1, with one width_m a place.")
    elif any(b <= a for a, b in pairwise(entry.s)):
        mistakes.add(("width", "s"), "[width] s must rise from place to place.")
    else:
        if not tabled:
            return Powers(entry.polynomial)
        straight = entry.between == "straight"
        return Polyline(entry.s, entry.width, entry.s[1:-1]) if straight else width_table(entry.s, entry.width)
    return None


def _material(table: Any, mistakes: Mistakes) -> tuple[ModulusEstimate, float] | None:
    entry = read_table(MaterialEntry, table, ("material",), mistakes)
    if entry is None:
        return None
    hard, known = math.isfinite(entry.shore_a), math.isfinite(entry.modulus)
    if hard == known:
        said = "not both" if hard else "and has none"
        mistakes.add(("material",), f"[material] needs shore_a or modulus_Pa, {said}.")
        return None
    try:
        estimate = from_shore_a(entry.shore_a) if hard else ModulusEstimate(entry.modulus, 0.0, "given")
    except MechanicsError as wrong:
        mistakes.add(("material", "shore_a"), f"[material] {wrong}.")
        return None
    log_sd = entry.modulus_log_sd if math.isfinite(entry.modulus_log_sd) else estimate.log_sd
    density = entry.density if math.isfinite(entry.density) else TYPICAL_DENSITY
    return replace(estimate, log_sd=log_sd), density


TURNS_DEG = (30.0, 60.0, 90.0)
GRAVITY = 9.81  # m/s^2
FINE = Resolution(order=16, widest=0.25)
DENSE = np.linspace(0.0, 1.0, 1001)
MOST_FORCE, TRIED = 8.0, 33  # times the force of small angles; forces tried at once


@dataclass(frozen=True)
class TipBend:
    """The tip bent by a tool that stays square to the beam there."""

    turn: float  # rad, of the tip
    force: float  # N, square to the beam
    tip: Array  # (2,) m
    strain: float  # largest surface strain

    def as_dict(self) -> dict[str, float]:
        return {
            "turn_deg": math.degrees(self.turn),
            "force_N": self.force,
            "tip_x_m": float(self.tip[0]),
            "tip_y_m": float(self.tip[1]),
            "surface_strain": self.strain,
        }


@dataclass(frozen=True)
class Expected:
    """Expected behaviour. Forces and stiffness scale with the modulus; shapes do not depend on it."""

    design: Design
    bends: tuple[TipBend, ...]
    compliance: float  # m/N, of the tip to a small transverse force
    buckling: float  # N, axial, at the tip
    frequency: tuple[float, ...]  # Hz, the two lowest in-plane modes
    sag: float  # m the tip sinks with the plane of bending flat
    droop: float  # m the tip sinks with that plane upright and the beam level

    def as_dict(self) -> dict[str, Any]:
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
    """Raises `MechanicsError`: no equilibrium found."""
    beam = design.beam()
    still = continuation.equilibrium(beam, loads.push((0.0, 0.0)), resolution=FINE)
    slowest = vibration(beam, still, rotary_inertia=design.along.rotary_inertia, count=2).frequency
    return Expected(
        design=design,
        bends=tuple(bend(design, math.radians(turn)) for turn in turns_deg),
        compliance=_compliance(beam, 2),
        buckling=buckling_force(beam),
        frequency=tuple(float(f) for f in slowest),
        sag=-_lowered(across_depth(design)),
        droop=-_lowered(beam),
    )


def bend(design: Design, turn: float) -> TipBend:
    """The force at the tip, square to the beam, that turns the tip by `turn` [rad]. Raises `MechanicsError`: there is
    none."""
    beam = design.beam()

    def from_the_tip(force: Array, places: Array) -> Array:
        """(2, B, S) angle [rad] and moment [N m] under forces (B,) at falling places: known at the tip, seen from
        there."""

        def slopes(s: float, state: Array) -> Array:
            angle, moment = state.reshape(2, -1)
            return np.concatenate([moment / float(beam.stiffness(s)), -beam.length * force * np.cos(angle)])

        still = np.zeros(2 * len(force))
        found = solve_ivp(slopes, (1.0, 0.0), still, method="DOP853", t_eval=places, rtol=1e-10, atol=1e-13)
        return np.asarray(found.y).reshape(2, len(force), -1)

    def short_of(forces: Array) -> Array:
        return -from_the_tip(forces, np.zeros(1))[0, :, 0] - turn

    tried = turn / _compliance(beam, 1) * np.linspace(0.0, MOST_FORCE, TRIED)
    enough = np.flatnonzero(short_of(tried) >= 0.0)
    if not len(enough):
        raise MechanicsError(f"no force on the tip of {design.name!r} turns it by {math.degrees(turn):.0f} degrees")
    closer = np.linspace(tried[enough[0] - 1], tried[enough[0]], TRIED)
    force = float(brentq(CubicSpline(closer, short_of(closer)), closer[0], closer[-1]))
    problem = make_problem(beam, loads.push((-force * math.sin(turn), force * math.cos(turn))), FINE)
    nodes = problem.grid.nodes
    q = from_the_tip(np.array([force]), nodes[::-1])[1, 0, ::-1] / problem.k
    solved = statics.found_near(problem, q[None], np.ones(1, dtype=bool))
    strain = 0.5 * np.asarray(design.width(nodes)) * np.abs(solved.q[0]) / design.length
    return TipBend(turn, force, np.asarray(solved.xy(np.array([1.0]))[0, 0]), float(np.max(strain)))


def _compliance(beam: model.Beam, power: int) -> float:
    """Tip deflection (power 2, m/N) or rotation (1, rad/N) per small transverse force: `int (L (1 - s))^p / k ds`."""
    grid = make_problem(beam, loads.push((0.0, 0.0)), FINE).grid
    arm = (1.0 - grid.nodes) ** power
    return float(beam.length**power * np.sum(grid.weights * arm / beam.stiffness(grid.nodes)))


def buckling_force(beam: model.Beam) -> float:
    """N: the least axial force on the tip that makes the straight beam unstable.

    The tangent of the straight shape is affine in the force, so the root is an eigenvalue.
    """
    problem = make_problem(beam, loads.push((-1.0, 0.0)), FINE)
    free, pushed = (statics.tangent(problem, np.zeros((1, problem.k.shape[-1])), factor)[0] for factor in (0.0, 1.0))
    softened = eigvals(np.linalg.solve(free, free - pushed)).real
    return float(1.0 / np.max(softened))


def across_depth(design: Design) -> model.Beam:
    """The same bar, bending across its depth."""
    turned = rectangular_bar(
        design.width, Uniform(design.depth), length=design.length, modulus=design.modulus, density=design.density
    )
    return model.Beam(design.length, turned.stiffness, mass_per_length=turned.mass_per_length)


def _lowered(beam: model.Beam) -> float:
    solved = continuation.equilibrium(beam, loads.weight((0.0, -GRAVITY)), resolution=FINE)
    return float(solved.xy(np.array([1.0]))[0, 0, 1]) if solved.converged[0] else math.nan


Kind = Literal["smooth", "stepped", "joint"]
DRAWN_PLACES = 401
RESOLUTION = Resolution(order=12, widest=0.1)  # resolves a table of k(s) and a narrow joint to 1e-9 L
FORCE_GROWTH, BATCH, MOST_BATCHES = 1.12, 10, 10  # of the forces tried
LARGEST_RATIO = 6.0  # stiffest over softest place of a smooth beam


def random_stiffness(kind: Kind, rng: np.random.Generator, *, level: float = 0.02) -> Profile:
    """k(s) [N m] around `level`."""
    s = np.linspace(0.0, 1.0, DRAWN_PLACES)
    size = level * np.exp(0.3 * rng.standard_normal())
    if kind == "stepped":
        jumps = np.sort(rng.uniform(0.15, 0.85, rng.integers(1, 3)))
        if len(jumps) == 2 and jumps[1] - jumps[0] < 0.15:
            jumps = jumps[:1]
        signs = rng.choice([-1.0, 1.0], len(jumps))
        log_k = np.concatenate([[0.0], np.cumsum(signs * np.log(rng.uniform(1.3, 3.0, len(jumps))))])
        values = size * np.exp(log_k - log_k.mean())
        return Steps((0.0, *jumps.tolist(), 1.0), tuple(values.tolist()))
    log_k = smooth_log(s, rng)
    if kind == "joint":
        centre, width, left = rng.uniform(0.2, 0.7), rng.uniform(0.02, 0.05), rng.uniform(0.2, 0.6)
        log_k = log_k + np.log1p((left - 1.0) * np.exp(-0.5 * ((s - centre) / width) ** 2))
    return Table(tuple(s.tolist()), tuple((size * np.exp(log_k)).tolist()))


def smooth_log(s: Array, rng: np.random.Generator) -> Array:
    """A taper and up to three broad bumps with a range of 1:1 to 6:1; mean zero."""
    taper, bow = rng.normal(0.0, 1.0), rng.normal(0.0, 1.5)
    log_k = taper * (s - 0.5) + bow * (s - rng.uniform(0.3, 0.7)) ** 2
    for _ in range(int(rng.integers(0, 4))):
        centre, width = rng.uniform(0.0, 1.0), rng.uniform(0.12, 0.4)
        log_k = log_k + rng.normal(0.0, 0.5) * np.exp(-0.5 * ((s - centre) / width) ** 2)
    wanted = rng.uniform(0.0, np.log(LARGEST_RATIO))
    log_k = log_k * (wanted / max(float(np.ptp(log_k)), 1e-9))
    return np.asarray(log_k - log_k.mean())


@one_blas_thread
def force_that_bends(beam: model.Beam, bend: float, direction: float, at_s: float = 1.0) -> float:
    """N: the force at angle `direction` [rad] that turns its place by `bend` [rad].

    If the beam would snap through first: nine tenths of the largest force on this branch.
    """
    unit = np.array([np.cos(direction), np.sin(direction)])
    softest = float(np.min(np.asarray(beam.stiffness(np.linspace(0.0, 1.0, DRAWN_PLACES)))))
    last, turned = 0.0, 0.0
    sizes = 0.2 * bend * softest / (beam.length * at_s**2) * FORCE_GROWTH ** np.arange(BATCH)
    for _ in range(MOST_BATCHES):
        solved = continuation.equilibrium(beam, loads.push(sizes[:, None] * unit, at_s), resolution=RESOLUTION)
        for size, stands, shape in zip(sizes, solved.converged, solved.angle(np.array([0.0, at_s])), strict=True):
            if not stands:
                return 0.9 * last
            now = abs(float(shape[1] - shape[0]))
            if now >= bend:
                return float(last + (size - last) * (bend - turned) / (now - turned))
            last, turned = float(size), now
        sizes = sizes * FORCE_GROWTH**BATCH
    return last
