"""What recording.toml states of the beam and the bench, and how exactly."""

from __future__ import annotations

import math

import numpy as np

from onebend.errors import RecordingError
from onebend.recording.entries import LONGEST, Recording
from onebend.recording.tables import Columns, read_columns
from onebend.records import GRAVITY_SD, Array, MassLine, PointMass, SectionShapeName, Stated, StatedSection

# recording.toml's width lies in the plane of bending
SIZES = ("width_m", "thickness_m", "diameter_m", "inner_diameter_m", "across_flats_m")
SHAPES = (("width_m", "thickness_m"), ("diameter_m", "inner_diameter_m"), ("across_flats_m",), ("I_m4",))
# Of each shape the sizes in and across the plane of bending, and the thickness of the rectangle that has its 12 I / A,
# over the first of them.
BY_SIZES: dict[SectionShapeName, tuple[str, str, float]] = {
    "rectangle": ("width_m", "thickness_m", 1.0),
    "circle": ("diameter_m", "diameter_m", math.sqrt(0.75)),
    "hexagon": ("across_flats_m", "across_flats_m", math.sqrt(5.0 / 6.0)),
}
OF_SQUARE = {"circle": math.pi / 4.0, "tube": math.pi / 4.0, "hexagon": math.sqrt(0.75)}  # areas over those of squares
FARTHEST_END = 0.05  # of the beam, from the first and the last place of a section to its ends


def stated_in(description: Recording) -> Stated:
    """The priors that the fit takes from the recording's description."""
    sizes = _sizes(description)
    section = _section(description, sizes)
    _check_known_shape(description, section)
    beam, tags, force = description.beam, description.tags, description.force
    mass, line = _mass(description) if beam.mass_along != "section" else _mass_of_section(description, section)
    _refuse_density(description, section, mass)
    return Stated(
        rest=beam.rest,
        mass=mass,
        placement_sd=tags.placement_sd,
        mass_line=line,
        weighed_sd=beam.mass_sd / mass,
        mass_along=beam.mass_along,
        stiffness_along=beam.stiffness_along,
        turn_sd=tags.turn_sd,
        place_sd=description.place_sd,
        direction_sd=description.direction_sd,
        gravity_sd=GRAVITY_SD if description.gravity is None else description.gravity.direction_sd,
        clamp_sd=description.clamp_sd,
        curvature_sd=beam.curvature_sd,
        scale_sd=description.scale_sd,
        gain_sd=0.0 if force is None else force.gain_sd,
        thickness=_thickness(sizes),
        tag_size=tags.size,
        load_error_sd=math.nan if force is None else force.bias_sd,
        section=section,
        modulus_varies=beam.modulus_varies,
        rest_change_sd=beam.rest_change_sd,
        masses=tuple(PointMass(one.s, one.mass) for one in beam.masses),
    )


def _refuse_density(rec: Recording, section: StatedSection | None, mass: float) -> None:
    """Raises `RecordingError` where a beam of this section and `mass` [kg; NaN: unknown] is of no material."""
    if section is None or section.moment is not None or not mass > 0.0:
        return
    inner = np.zeros(len(section.s)) if section.inner is None else section.inner
    area = OF_SQUARE.get(section.shape, 1.0) * (section.thickness * section.width - inner**2)
    density = mass / (rec.beam.length * max(float(np.mean(area)), 1e-300))
    if not 1.0 < density < 1e5:  # kg/m^3: osmium, the densest material, has 22,600; the lightest foams have 5
        raise RecordingError(
            f"{rec.folder}: with mass_kg, length_m and the section as written the beam is of {density:.3g} kg/m^3, as "
            "no material is. Check mass_kg (in kilograms) and the sizes (in metres)."
        )


def _section(rec: Recording, sizes: dict[str, Array]) -> StatedSection | None:
    """The section where it is whole."""
    beam, s = rec.beam, sizes["s"]
    if not math.isnan(beam.moment_sd) and "I_m4" not in sizes:
        raise RecordingError(f"{rec.folder}: I_sd is of a column I_m4 in section_file. Of sizes, give section_sd_m.")
    if "I_m4" in sizes:
        if not math.isnan(beam.section_sd):
            raise RecordingError(f"{rec.folder}: section_sd_m is of sizes. Of I_m4, give I_sd (0.05 = 5 %).")
        unknown = np.full(len(s), np.nan)
        return StatedSection("second moment", s, unknown, unknown, moment=sizes["I_m4"], moment_sd=beam.moment_sd)
    inner = sizes.get("inner_diameter_m")
    for shape, (name, across, _) in BY_SIZES.items():
        if name in sizes and across in sizes:
            whole = shape if inner is None else "tube"
            return StatedSection(whole, s, sizes[name], sizes[across], beam.section_sd, inner)
    return None


def _thickness(sizes: dict[str, Array]) -> float:
    """m, mean in the plane of bending; of a round or hexagonal beam that of an equal rectangle. NaN: not stated."""
    s = sizes["s"]
    for name, _, share in BY_SIZES.values():
        if name in sizes:
            size = share * np.hypot(sizes[name], sizes.get("inner_diameter_m", np.zeros(len(s))))
            return float(np.trapezoid(size, s)) / float(s[-1] - s[0])
    return math.nan


def _sizes(rec: Recording) -> dict[str, Array]:
    """What is known of the section: places `s` (P,), and by its key each size [m] there, or `I_m4` [m^4]."""
    beam = rec.beam
    values = {name: getattr(beam, name.removesuffix("_m")) for name in SIZES}
    written = {name: value for name, value in values.items() if not math.isnan(value)}
    s, measured = np.array([0.0, 1.0]), {}
    if beam.section_file is not None:
        table = read_columns(beam.section_file, ("s",), (*SIZES, "I_m4"), kind="table of the section", strict=True)
        s, known = table.get("s"), [name for name in (*SIZES, "I_m4") if name in table.numbers]
        measured = {name: _measured(table, name, beam.length) for name in known}
        _refuse_places(table, "the sizes", steps=True)
        if not measured:
            raise RecordingError(
                f"{beam.section_file}: there is no column {', '.join(SIZES)} or I_m4 in it. Add one, in metres."
            )
        if "inner_diameter_m" in measured:
            outer = measured.get("diameter_m", np.full(len(s), written.get("diameter_m", np.nan)))
            table.refuse(measured["inner_diameter_m"] >= outer, "inner_diameter_m must be less than diameter_m.")
        for name in set(measured) & set(written):
            raise RecordingError(f"{rec.folder}: {name} stands in [beam] and in {beam.section_file.name}. Remove one.")
    found = {"s": s, **measured, **{name: np.full(len(s), value) for name, value in written.items()}}
    _refuse_two_shapes(rec, found)
    return found


def _refuse_two_shapes(rec: Recording, found: dict[str, Array]) -> None:
    """Raises `RecordingError` where sizes (by key) are not of one shape, or a shape is not whole."""
    names = [name for name in (*SIZES, "I_m4") if name in found]
    shapes = [shape for shape in SHAPES if set(names) & set(shape)]
    if len(shapes) > 1:
        raise RecordingError(
            f"{rec.folder}: the section has {' and '.join(names)}. diameter_m is of a round beam (a tube has "
            "inner_diameter_m too), across_flats_m of a hexagonal one, width_m and thickness_m of a rectangular one, "
            "I_m4 of any. Give one of these, not several."
        )
    if "inner_diameter_m" in found and "diameter_m" not in found:
        raise RecordingError(f"{rec.folder}: inner_diameter_m is of a tube. Give its diameter_m too.")
    if "inner_diameter_m" in found and np.any(found["inner_diameter_m"] >= found["diameter_m"]):
        raise RecordingError(f"{rec.folder}: inner_diameter_m must be less than diameter_m.")
    table = rec.beam.section_file
    if table is not None and shapes == [SHAPES[0]] and len(names) < 2:
        missing = next(name for name in SHAPES[0] if name not in names)
        raise RecordingError(
            f"{rec.folder}: the section is not whole: {missing} is missing. Give it in [beam], or as a column of "
            f"{table.name}; of a round beam diameter_m alone."
        )


def _check_known_shape(rec: Recording, section: StatedSection | None) -> None:
    """Raises `RecordingError` where k(s) is to follow a section that is not known all along the beam."""
    beam = rec.beam
    if beam.modulus_varies > 0.0 and beam.stiffness_along == "unknown":
        raise RecordingError(
            f'{rec.folder}: modulus_varies goes with stiffness_along = "section" or "even". Write one of them, or '
            "leave modulus_varies out: without, k(s) may vary as it will."
        )
    if beam.stiffness_along != "section":
        return
    if section is None:
        raise RecordingError(
            f'{rec.folder}: stiffness_along = "section" needs the section. Give its sizes in [beam] (width_m and '
            "thickness_m; diameter_m, of a tube inner_diameter_m too; across_flats_m), or section_file where they vary."
        )
    ends = float(section.s[0]), float(section.s[-1])
    if ends[0] > FARTHEST_END or ends[1] < 1.0 - FARTHEST_END:
        where = beam.section_file or rec.folder
        raise RecordingError(
            f'{where}: the section is known from s = {ends[0]:g} to {ends[1]:g} only, and stiffness_along = "section" '
            "goes by it from 0 to 1. Add a row at the clamp and at the tip."
        )


def _measured(table: Columns, name: str, length: float) -> Array:
    """(P,) m, one size of the section; m^4 its second moment."""
    size = table.get(name)
    unit = "m^4" if name == "I_m4" else "metres"
    table.refuse(~((size > 0.0) & (size <= LONGEST)), f"{name} must be above zero, and in {unit}.")
    if name != "thickness_m":  # in the plane of bending; 12 I is the fourth power of a square's side
        thick = (12.0 * size) ** 0.25 if name == "I_m4" else size
        table.refuse(thick > length, f"the beam is thicker than long there. Correct {name}; it is in {unit}.")
    return size


def _refuse_places(table: Columns, instead: str, *, steps: bool = False) -> None:
    """`RecordingError` where places lie outside the beam, do not rise or are one; with `steps` one may stand twice."""
    s = table.get("s")
    table.refuse(~((s >= 0.0) & (s <= 1.0)), "s must be between 0 at the clamp and 1 at the tip.")
    table.refuse(np.full(len(s), len(s) < 2), f"one place is no profile. Give {instead} in [beam] instead.")
    apart, more = np.diff(s, prepend=-1.0), ""
    wrong = apart <= 0.0
    if steps:
        third = np.concatenate([[1.0], apart[:-1]]) == 0.0
        wrong = (apart < 0.0) | ((apart == 0.0) & (third | (s == s[0]) | (s == s[-1])))
        more = " A place that stands twice, within the beam, is a step."
    table.refuse(wrong, f"s must rise from row to row.{more}")


def _mass(rec: Recording) -> tuple[float, MassLine | None]:
    """kg (NaN where not known), and the mass per metre where it is not even, scaled to mass_kg where that is given."""
    if (rec.beam.mass_along == "table") > (rec.beam.mass_file is not None):
        raise RecordingError(
            f'{rec.folder}: mass_along = "table" needs the table. Give mass_file in [beam], columns s and kg_per_m.'
        )
    if rec.beam.mass_file is None:
        return rec.beam.mass, None
    if rec.beam.mass_along not in ("unknown", "table"):
        raise RecordingError(
            f'{rec.folder}: mass_file and mass_along = "{rec.beam.mass_along}" both say how the mass is spread. '
            'Remove one, or write mass_along = "table".'
        )
    table = read_columns(rec.beam.mass_file, ("s", "kg_per_m"), kind="table of the mass")
    s, value = table.get("s"), table.get("kg_per_m")
    _refuse_places(table, "mass_kg")
    table.refuse(~(value > 0.0), "kg_per_m must be above zero.")
    fine = np.linspace(0.0, 1.0, 2001)
    total = rec.beam.length * float(np.trapezoid(np.interp(fine, s, value), fine))
    if math.isnan(rec.beam.mass):
        return total, MassLine(s, value)
    return rec.beam.mass, MassLine(s, value * rec.beam.mass / total)


def _mass_of_section(rec: Recording, section: StatedSection | None) -> tuple[float, MassLine]:
    """kg, and the mass per metre as the section's area: between its places by their sizes, beyond them as there."""
    if rec.beam.mass_file is not None:
        raise RecordingError(
            f'{rec.folder}: mass_file and mass_along = "section" both say how the mass is spread. Remove one.'
        )
    if section is None or section.moment is not None:
        raise RecordingError(
            f'{rec.folder}: mass_along = "section" needs the section\'s sizes. Give them in [beam] or section_file.'
        )
    if math.isnan(rec.beam.mass):
        raise RecordingError(f'{rec.folder}: mass_along = "section" needs the mass. Give mass_kg in [beam].')
    pairs = [(i, i + 1) for i in range(len(section.s) - 1) if section.s[i] < section.s[i + 1]]
    share = np.linspace(0.0, 1.0, 9)  # places from one row of a section to the next, for its area

    def along(size: Array) -> Array:
        return np.concatenate([size[i] + share * (size[j] - size[i]) for i, j in pairs])

    inner = np.zeros(len(section.s)) if section.inner is None else section.inner
    s, area = along(section.s), along(section.thickness) * along(section.width) - along(inner) ** 2
    ends = np.trapezoid(area, s) + area[0] * s[0] + area[-1] * (1.0 - s[-1])
    return rec.beam.mass, MassLine(s, area * rec.beam.mass / (rec.beam.length * float(ends)))
