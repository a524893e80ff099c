"""What recording.toml states of the beam and the bench, and how exactly."""

from __future__ import annotations

import math

import numpy as np

from onebend.errors import RecordingError
from onebend.recording.tables import Columns, read_columns
from onebend.recording.toml.beam_entry import LONGEST
from onebend.recording.toml.entries import Recording
from onebend.records import Array, MassLine, Stated, StatedSection

SIZES = ("width_m", "thickness_m", "diameter_m")  # recording.toml's width lies in the plane of bending
ROUND = math.sqrt(0.75)  # thickness over diameter, of the rectangle that has a circle's A / I


def stated_in(recording: Recording) -> Stated:
    """The priors that the fit takes from the recording's description.

    Raises:
        RecordingError: what is stated of the mass or the section cannot be used.
    """
    mass, line = _mass(recording)
    sizes = _sizes(recording)
    beam, tags, force = recording.beam, recording.tags, recording.force
    return Stated(
        rest=beam.rest,
        mass=mass,
        placement_sd=tags.placement_sd,
        mass_line=line,
        weighed_sd=beam.mass_sd / mass,
        mass_along=beam.mass_along,
        stiffness_along=beam.stiffness_along,
        turn_sd=tags.turn_sd,
        place_sd=recording.place_sd,
        direction_sd=recording.direction_sd,
        clamp_sd=recording.clamp_sd,
        curvature_sd=beam.curvature_sd,
        scale_sd=recording.scale_sd,
        gain_sd=0.0 if force is None else force.gain_sd,
        thickness=_thickness(sizes),
        tag_size=tags.size,
        load_error_sd=math.nan if force is None else force.bias_sd,
        section=_section(sizes, beam.section_sd),
    )


def _section(sizes: dict[str, Array], sd: float) -> StatedSection | None:
    """The section where it is whole."""
    if "diameter_m" in sizes:
        return StatedSection("circle", sizes["s"], sizes["diameter_m"], sizes["diameter_m"], sd)
    if "width_m" in sizes and "thickness_m" in sizes:
        return StatedSection("rectangle", sizes["s"], sizes["width_m"], sizes["thickness_m"], sd)
    return None


def _thickness(sizes: dict[str, Array]) -> float:
    """m, in the plane of bending, mean along the beam; of a round beam that of a rectangle that stretches as much.
    NaN where nobody says it."""
    factor, size = (ROUND, sizes["diameter_m"]) if "diameter_m" in sizes else (1.0, sizes.get("width_m"))
    if size is None:
        return math.nan
    s = sizes["s"]
    return factor * float(np.trapezoid(size, s)) / float(s[-1] - s[0])


def _sizes(rec: Recording) -> dict[str, Array]:
    """What is known of the section: places `s` (P,), and by its key each size [m] there.

    Raises:
        RecordingError: a size that is given twice, a round beam that is a rectangle too, a table that cannot be used.
    """
    beam = rec.beam
    written = dict(zip(SIZES, (beam.width, beam.thickness, beam.diameter), strict=True))
    written = {name: value for name, value in written.items() if not math.isnan(value)}
    s, measured = np.array([0.0, 1.0]), {}
    if beam.section_file is not None:
        table = read_columns(beam.section_file, ("s",), SIZES, kind="table of the section", strict=True)
        s, measured = table.get("s"), {name: _measured(table, name) for name in SIZES if name in table.numbers}
        _refuse_places(table, "the sizes")
        if not measured:
            raise RecordingError(
                f"{beam.section_file}: there is no column {', '.join(SIZES)} in it. Add one, in metres."
            )
        for name in set(measured) & set(written):
            raise RecordingError(f"{rec.folder}: {name} stands in [beam] and in {beam.section_file.name}. Remove one.")
    found = {"s": s, **measured, **{name: np.full(len(s), value) for name, value in written.items()}}
    if "diameter_m" in found and len(found) > 2:
        raise RecordingError(
            f"{rec.folder}: diameter_m is of a round beam, width_m and thickness_m are of a rectangular one. Give "
            "either, not both."
        )
    if beam.section_file is not None and "diameter_m" not in found and len(found) < 3:
        missing = " and ".join(name for name in SIZES[:2] if name not in found)
        raise RecordingError(
            f"{rec.folder}: the section is not whole: {missing} is missing. Give it in [beam], or as a column of "
            f"{beam.section_file.name}; of a round beam diameter_m alone."
        )
    return found


def _measured(table: Columns, name: str) -> Array:
    """(P,) m, one size of the section."""
    size = table.get(name)
    table.refuse(~((size > 0.0) & (size <= LONGEST)), f"{name} must be above zero, and in metres.")
    return size


def _refuse_places(table: Columns, instead: str) -> None:
    """Raises `RecordingError` where places lie outside the beam, do not rise, or there is one alone."""
    s = table.get("s")
    table.refuse(~((s >= 0.0) & (s <= 1.0)), "s must be between 0 at the clamp and 1 at the tip.")
    table.refuse(np.diff(s, prepend=-1.0) <= 0.0, "s must rise from row to row.")
    table.refuse(np.full(len(s), len(s) < 2), f"one place is no profile. Give {instead} in [beam] instead.")


def _mass(rec: Recording) -> tuple[float, MassLine | None]:
    """kg (NaN where not known), and the mass per metre where it is not even, scaled to mass_kg where that is given.

    Raises:
        RecordingError: fewer than two rows, places outside the beam or that do not rise, a mass that is not positive.
    """
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
