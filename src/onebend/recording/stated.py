"""What recording.toml states of the beam and the bench, and how exactly."""

from __future__ import annotations

import math

import numpy as np

from onebend.errors import RecordingError
from onebend.recording.tables import read_columns
from onebend.recording.toml.entries import Recording
from onebend.records import MassLine, Stated


def stated_in(recording: Recording) -> Stated:
    """The priors that the fit takes from the recording's description.

    Raises:
        RecordingError: what is stated of the mass cannot be used.
    """
    mass, line = _mass(recording)
    beam, tags, force = recording.beam, recording.tags, recording.force
    return Stated(
        rest=beam.rest,
        mass=mass,
        placement_sd=tags.placement_sd,
        mass_line=line,
        mass_along=beam.mass_along,
        stiffness_along=beam.stiffness_along,
        turn_sd=tags.turn_sd,
        place_sd=recording.place_sd,
        direction_sd=recording.direction_sd,
        clamp_sd=recording.clamp_sd,
        curvature_sd=beam.curvature_sd,
        scale_sd=recording.scale_sd,
        gain_sd=0.0 if force is None else force.gain_sd,
        thickness=beam.width,
        depth=beam.thickness,
        tag_size=tags.size,
        load_error_sd=math.nan if force is None else force.bias_sd,
    )


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
    table.refuse(~((s >= 0.0) & (s <= 1.0)), "s must be between 0 at the clamp and 1 at the tip.")
    table.refuse(np.diff(s, prepend=-1.0) <= 0.0, "s must rise from row to row.")
    table.refuse(~(value > 0.0), "kg_per_m must be above zero.")
    table.refuse(np.full(len(s), len(s) < 2), "one place is no profile. Give mass_kg in [beam] instead.")
    fine = np.linspace(0.0, 1.0, 2001)
    total = rec.beam.length * float(np.trapezoid(np.interp(fine, s, value), fine))
    if math.isnan(rec.beam.mass):
        return total, MassLine(s, value)
    return rec.beam.mass, MassLine(s, value * rec.beam.mass / total)
