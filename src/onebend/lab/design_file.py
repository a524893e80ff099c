"""A design of the user's own: a TOML file with sizes, a width along the beam, and a material."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

from onebend.beam.profiles.piecewise import broken_line
from onebend.beam.profiles.stiffness import Powers, Profile
from onebend.errors import MechanicsError, ResultsError
from onebend.files.single_file import write_file
from onebend.lab.designs import Design, design_named, width_table
from onebend.lab.materials import TYPICAL_DENSITY, ModulusEstimate, from_shore_00, from_shore_a, silicone
from onebend.recording.toml.schema import (
    Check,
    Mistakes,
    key,
    keys_of,
    number,
    one_of,
    read_table,
    report_unknown,
    text,
)
from onebend.text_files import read_toml

FORMAT = 1
TABLES = ("beam", "width", "material")
NO_NAME = ""


def _numbers(least: int, item: Check) -> Check:
    def check(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) < least:
            raise ValueError(f"a list of at least {least} numbers")
        try:
            return tuple(float(item(entry)) for entry in value)
        except ValueError as wrong:
            raise ValueError(f"a list in which each entry is {wrong}") from None

    return check


@dataclass(frozen=True)
class SizeEntry:
    """[beam]: its outer sizes."""

    length: float = key("length_m", number(above=0), "the beam's length from clamp to tip, m", example="0.15")
    depth: float = key("depth_m", number(above=0), "its size across the plane of bending, m", example="0.03")


@dataclass(frozen=True)
class WidthEntry:
    """[width]: the size in the plane of bending, as a polynomial or a table."""

    polynomial: tuple[float, ...] = key(
        "polynomial_m",
        _numbers(1, number()),
        "the width's coefficients of s^0, s^1, ..., m",
        example="[0.010, 0.010]",
        default=(),
    )
    s: tuple[float, ...] = key(
        "s",
        _numbers(2, number(least=0, most=1)),
        "places from 0 (clamp) to 1 (tip)",
        example="[0.0, 0.5, 1.0]",
        default=(),
    )
    width: tuple[float, ...] = key(
        "width_m",
        _numbers(2, number(above=0)),
        "the width at each place of s, m",
        example="[0.02, 0.01, 0.02]",
        default=(),
    )
    between: Literal["smooth", "straight"] = key(
        "between",
        one_of("smooth", "straight"),
        'between the places: "smooth" (monotone cubic) or "straight" lines',
        example='"smooth"',
        default="smooth",
    )


@dataclass(frozen=True)
class MaterialEntry:
    """[material]: one of a named silicone, a hardness, or a modulus."""

    silicone: str = key("silicone", text, "a named silicone", example='"Dragon Skin 30"', default=NO_NAME)
    shore_a: float = key("shore_a", number(), "its hardness on scale A", example="30", default=math.nan)
    shore_00: float = key("shore_00", number(), "its hardness on scale 00", example="30", default=math.nan)
    modulus: float = key(
        "modulus_Pa", number(above=0), "Young's modulus at small strain, Pa", example="7.0e5", default=math.nan
    )
    modulus_log_sd: float = key(
        "modulus_log_sd",
        number(least=0),
        "how sure the modulus is: one sd of its logarithm (0.1 = 10 %)",
        example="0.1",
        default=math.nan,
    )
    density: float = key("density_kg_m3", number(above=0), "its density, kg/m^3", example="1080", default=math.nan)


def read_design(path: Path | str) -> Design:
    """The design in a TOML file (docs/lab.md lists its keys).

    Raises:
        MechanicsError: the file cannot be read, or everything that is wrong in it, each with its line.
    """
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
    """A named design, or the one in a TOML file."""
    path = Path(name_or_path)
    return read_design(path) if path.suffix == ".toml" or path.is_file() else design_named(name_or_path)


def write_design_template(path: Path | str) -> Path:
    """Write a commented design to fill in, and return its path.

    Raises:
        MechanicsError: the file exists already, or cannot be written.
    """
    path = Path(path)
    if path.exists():
        raise MechanicsError(f"{path} exists already. Edit it, or name another file.")
    try:
        write_file(path, template())
    except ResultsError as wrong:
        raise MechanicsError(str(wrong)) from None
    return path


def template() -> str:
    """The text of a design file; valid TOML that keeps the schema."""
    head = [
        "# A beam to cast, for onebend. Fill in your own values; lines that start with # are another way to say it.",
        "# It bends in the plane of its width; its depth is the size across that plane.",
        "",
        f"format = {FORMAT}",
        '# name = "my beam"',
    ]
    return "\n".join(
        [
            *head,
            *_section("[beam]", SizeEntry, {"length_m", "depth_m"}),
            *_section("[width]", WidthEntry, {"s", "width_m", "between"}),
            *_section("[material]", MaterialEntry, {"shore_a"}),
            "",
        ]
    )


def _section(title: str, record: type, written: set[str]) -> list[str]:
    rows = ["", title]
    for entry, _ in keys_of(record).values():
        row = f"{entry.name} = {entry.example}"
        rows.append(f"{row if entry.name in written else '# ' + row}  # {entry.says}")
    return rows


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
        make = broken_line if entry.between == "straight" else width_table
        return make(entry.s, entry.width) if tabled else Powers(entry.polynomial)
    return None


def _material(table: Any, mistakes: Mistakes) -> tuple[ModulusEstimate, float] | None:
    entry = read_table(MaterialEntry, table, ("material",), mistakes)
    if entry is None:
        return None
    given = [
        name
        for name, there in (
            ("silicone", entry.silicone != NO_NAME),
            ("shore_a", math.isfinite(entry.shore_a)),
            ("shore_00", math.isfinite(entry.shore_00)),
            ("modulus_Pa", math.isfinite(entry.modulus)),
        )
        if there
    ]
    if len(given) != 1:
        said = f"not {' and '.join(given)}" if given else "and has none"
        mistakes.add(("material",), f"[material] needs one of silicone, shore_a, shore_00 or modulus_Pa, {said}.")
        return None
    ways: dict[str, Callable[[], ModulusEstimate]] = {
        "silicone": lambda: silicone(entry.silicone).stiffness,
        "shore_a": lambda: from_shore_a(entry.shore_a),
        "shore_00": lambda: from_shore_00(entry.shore_00),
        "modulus_Pa": lambda: ModulusEstimate(entry.modulus, 0.0, "given"),
    }
    try:
        estimate = ways[given[0]]()
    except MechanicsError as wrong:
        mistakes.add(("material", given[0]), f"[material] {wrong}.")
        return None
    log_sd = entry.modulus_log_sd if math.isfinite(entry.modulus_log_sd) else estimate.log_sd
    usual = silicone(entry.silicone).density if entry.silicone else TYPICAL_DENSITY
    return ModulusEstimate(estimate.modulus, log_sd, estimate.source), entry.density if math.isfinite(
        entry.density
    ) else usual
