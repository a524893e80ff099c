"""Young's modulus as people read it, where the beam's section was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.modulus import ModulusBand, one_modulus
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.learning.modulus import modulus_along, modulus_unit, shown_places, size_words, stated_section
from onebend.records import Array, StatedSection
from onebend.report.findings import Findings
from onebend.report.wording import significant, span

_PLACES = 201


@dataclass(frozen=True)
class ModulusRows:
    """E and its band at some places in one unit, as shown; `low` and `high` are empty where k(s) has no band."""

    unit: str
    values: tuple[str, ...]
    low: tuple[str, ...]
    high: tuple[str, ...]


@dataclass(frozen=True)
class MeasuredBeam:
    """A learned beam, k(s) with its band where it has one, and its section where that is known."""

    beam: Beam
    uncertain: UncertainStiffness | None
    section: StatedSection | None

    def band(self, s: Array) -> ModulusBand | None:
        """E at places `s` (S,); None where the section is not known."""
        return modulus_along(self.beam, self.uncertain, self.section, s)


def measured_beam(findings: Findings) -> MeasuredBeam:
    """The beam of the findings, with the section that its recordings state."""
    uncertain = None if findings.posterior is None else findings.posterior.stiffness
    return MeasuredBeam(findings.beam, uncertain, stated_section(findings.recordings))


def modulus_rows(measured: MeasuredBeam, s: Array) -> ModulusRows | None:
    """E at places `s` (S,); None where the section is not known."""
    band = measured.band(s)
    if band is None:
        return None
    factor, unit = modulus_unit(band.modulus[shown_places(band)])
    columns = [
        tuple(significant(float(value)) for value in edge / factor) for edge in (band.modulus, band.low, band.high)
    ]
    return ModulusRows(unit, *(columns if measured.uncertain is not None else (columns[0], (), ())))


def one_modulus_words(measured: MeasuredBeam) -> str:
    """E as one number with its band: "50.5 GPa (49.8 to 51.2)"; empty where k(s) was not learned as the section's shape
    times a modulus."""
    found = one_modulus(measured.uncertain or measured.beam.stiffness, measured.beam.length, measured.section)
    if found is None:
        return ""
    factor, unit = modulus_unit(np.array(found[:1]))
    middle, low, high = (significant(value / factor) for value in found)
    return f"{middle}\u00a0{unit} ({low} to {high})"


def modulus_range(measured: MeasuredBeam) -> str:
    """Smallest and largest E where k(s) is identified, of all that is known where it is nowhere: "0.68 … 0.73 MPa";
    empty where the section is not known, or at no place."""
    band = measured.band(np.linspace(0.0, 1.0, _PLACES))
    if band is None or not np.any(shown := shown_places(band)):
        return ""
    found = band.modulus[shown]
    factor, unit = modulus_unit(found)
    return f"{span(float(found.min()) / factor, float(found.max()) / factor, ' … ')}\u00a0{unit}"


def modulus_words(measured: MeasuredBeam) -> list[str]:
    """E in a sentence, with the sizes that it rests on; empty where the section is not known."""
    section = measured.section
    if section is None:
        return []
    known = f"known to {significant(1e3 * section.sd, 2)} mm (sd)" if section.sd > 0.0 else "taken as exact"
    if section.moment_sd > 0.0:
        known = f"known to {significant(100.0 * section.moment_sd, 2)} % (sd)"
    found = modulus_range(measured) or "not known at any place"
    one = one_modulus_words(measured)
    found = f"{one}, 95 %, mean along the beam; {found} at its places" if one else found
    return [f"Young's modulus E = k L / I: {found}, by {', '.join(size_words(section))}, {known}"]
