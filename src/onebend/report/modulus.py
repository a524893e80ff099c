"""Young's modulus as people read it, where the beam's section was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.learning.modulus import modulus_along, modulus_unit, shown_places, size_words, stated_section
from onebend.records import Array
from onebend.report.findings import Findings
from onebend.report.wording import significant

_PLACES = 201


@dataclass(frozen=True)
class ModulusRows:
    """E and its band at some places in one unit, as shown; `low` and `high` are empty where k(s) has no band."""

    unit: str
    values: tuple[str, ...]
    low: tuple[str, ...]
    high: tuple[str, ...]


def modulus_rows(findings: Findings, s: Array) -> ModulusRows | None:
    """E at places `s` (S,); None where no recording states the section."""
    uncertain = None if findings.posterior is None else findings.posterior.stiffness
    band = modulus_along(findings.beam, uncertain, findings.recordings, s)
    if band is None:
        return None
    factor, unit = modulus_unit(band.modulus[shown_places(band)])
    columns = [
        tuple(significant(float(value)) for value in edge / factor) for edge in (band.modulus, band.low, band.high)
    ]
    return ModulusRows(unit, *(columns if uncertain is not None else (columns[0], (), ())))


def modulus_range(findings: Findings) -> str:
    """Smallest and largest E where k(s) is identified, of all that is known where it is nowhere: "0.68 … 0.73 MPa";
    empty where no recording states the section, or at no place."""
    uncertain = None if findings.posterior is None else findings.posterior.stiffness
    band = modulus_along(findings.beam, uncertain, findings.recordings, np.linspace(0.0, 1.0, _PLACES))
    if band is None or not np.any(shown := shown_places(band)):
        return ""
    found = band.modulus[shown]
    factor, unit = modulus_unit(found)
    return f"{significant(float(found.min()) / factor)} … {significant(float(found.max()) / factor)}\u00a0{unit}"


def modulus_words(findings: Findings) -> list[str]:
    """E in a sentence, with the sizes that it rests on; empty where no recording states the section."""
    section = stated_section(findings.recordings)
    if section is None:
        return []
    known = f"known to {significant(1e3 * section.sd, 2)} mm (sd)" if section.sd > 0.0 else "taken as exact"
    found = modulus_range(findings) or "not known at any place"
    return [f"Young's modulus E = k L / I: {found}, by {', '.join(size_words(section))}, {known}"]
