"""What learning and validation return: frozen results that carry their reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.section import ModulusBand, modulus_band, section_as_dict
from onebend.beam.stiffness import UncertainStiffness
from onebend.records import Array, BoolArray, IntArray, Observations, Remark, StatedSection


@dataclass(frozen=True)
class Comparison:
    """One recording against a simulated beam under the measured forces (Fig. 5 of the paper)."""

    name: str
    frame: IntArray  # (T,) index in the video; only the frames that were simulated
    time: Array  # (T,) s
    tag_id: IntArray  # (m,)
    marker_s: Array  # (m,)
    measured: Array  # (T, m, 2) m, NaN where missing
    predicted: Array  # (T, m, 2) m
    force: Array  # (T, 2) N
    push_s: Array  # (T,)
    stable: BoolArray  # (T,) the simulated equilibrium is stable
    rms: Array  # (m,) m, root mean square distance per marker over all frames where it was seen
    sensor_rms: Array  # (m,) m, the part that the noise left in the force alone explains (first order); NaN if unknown
    likely_rms: (
        Array  # (m,) m, as the same noise, the band of k(s) and the push's tolerances let expect; NaN if unknown
    )
    remarks: tuple[Remark, ...] = ()
    static: bool = False  # bench poses: `time` counts them


@dataclass(frozen=True)
class Explained:
    """A recording as a fit explains it, its nuisances applied; `comparison.force` is the corrected force."""

    comparison: Comparison  # over the frames that the fit used
    line: Array  # (T, places, 2) m, the beam's centre line from the clamp to the tip
    logged: Array  # (T, 2) N, the force as logged


@dataclass(frozen=True)
class Trial:
    """One row of the paper's table: n curvature modes, m stiffness functions."""

    n: int
    m: int
    coefficients: Array  # (m,) gamma of (17), N m
    rms: Array  # (tags,) m, per marker in some hundred frames of the training recording; NaN if it cannot be simulated
    bic: float  # infinity if out of the running
    lowest_k: float  # N m, min of k(s) on [0, 1]
    condition: float  # of X in X gamma = Y
    why_out: str = ""  # empty if in the running


@dataclass(frozen=True)
class Learned:
    """The learned beam, and how it came about."""

    beam: Beam
    method: str  # "regression" or "paper"
    family: str  # "gaussians" or "powers"
    trials: tuple[Trial, ...]
    chosen: int  # index in `trials`
    training: Comparison
    remarks: tuple[Remark, ...] = ()


# Young's modulus of a learned beam whose section was measured, and whether there is such a material.
#
# The section is the one that recording.toml states. What the fit learns of the section's thickness, from how the beam
# stretches and shears, is another thing and is not used: E goes with the third power of h, and the fit tells h badly.

SOFTEST, STIFFEST = 1e3, 1.2e12  # Pa: a soft hydrogel, diamond
UNITS = ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa"))
_PLACES = 201
_POWERS = {  # with which a section's sizes count
    "rectangle": "width_m counts with its third power",
    "second moment": "it is in m^4: 1 mm^4 is 1e-12",
}
_FOURTH_POWER = "the size counts with its fourth power"
_TOO_STIFF = "stiff: a size is too small or the forces are too large"


def stated_section(recordings: Sequence[Observations]) -> StatedSection | None:
    """The first section that a recording states; None where none does."""
    return next((one.stated.section for one in recordings if one.stated.section is not None), None)


def modulus_along(
    beam: Beam, uncertain: UncertainStiffness | None, section: StatedSection | None, s: Array, level: float = 0.95
) -> ModulusBand | None:
    """E(s) [Pa] at places s (S,), with its band where k(s) has one; None where the section is not known.

    Raises:
        MechanicsError: sizes of the section that are not positive.
    """
    return None if section is None else modulus_band(uncertain or beam.stiffness, beam.length, section, s, level)


def shown_places(band: ModulusBand) -> BoolArray:
    """(S,) where E counts: where it is identified; wherever it is known, where it is identified nowhere."""
    known = np.isfinite(band.modulus)
    return np.asarray(band.identified if np.any(band.identified) else known)


def modulus_unit(values: Array) -> tuple[float, str]:
    """Pa, and the name, of the unit in which these moduli [Pa] read best."""
    known = values[np.isfinite(values)]
    middle = float(np.median(np.abs(known))) if known.size else 0.0
    return next((unit for unit in UNITS if middle >= unit[0]), UNITS[-1])


def size_words(section: StatedSection) -> list[str]:
    """Each size by its key in recording.toml: "width_m 12 mm in the plane of bending", "diameter_m 4 to 9 mm"."""
    if section.moment is not None:
        return [f"I_m4 {_span_words(1e12 * section.moment, 'mm^4')}"]
    if section.shape == "hexagon":
        return [f"across_flats_m {_length_words(section.thickness)}"]
    if section.shape in ("circle", "tube"):
        outer = f"diameter_m {_length_words(section.thickness)}"
        return [outer] if section.inner is None else [outer, f"inner_diameter_m {_length_words(section.inner)}"]
    inside, across = _length_words(section.thickness), _length_words(section.width)
    return [f"width_m {inside} in the plane of bending", f"thickness_m {across} across it"]


def modulus_remarks(
    beam: Beam, uncertain: UncertainStiffness | None, recordings: Sequence[Observations]
) -> tuple[Remark, ...]:
    """A warning where no material has such a modulus, one where the recordings state different sections."""
    section, s = stated_section(recordings), np.linspace(0.0, 1.0, _PLACES)
    band = modulus_along(beam, uncertain, section, s)
    if section is None or band is None:
        return ()
    others = [one.stated.section for one in recordings]
    said = tuple(
        Remark(
            "warning",
            f"the recordings state different sections of one beam: E is by that of {whose}. Correct them",
            about="two sections",
        )
        for whose in [next(one.source.name for one in recordings if one.stated.section is not None)]
        if not all(other is None or _same(section, other) for other in others)
    )
    if uncertain is not None and not np.any(band.identified):
        return said
    return said + _no_such_material(section, band)


def _no_such_material(section: StatedSection, band: ModulusBand) -> tuple[Remark, ...]:
    """A warning where the band, or the modulus that has none, lies wholly beyond all materials."""
    low, high = (np.where(np.isfinite(edge), edge, band.modulus) for edge in (band.low, band.high))
    counts = shown_places(band)
    soft, stiff = counts & (high < SOFTEST), counts & (low > STIFFEST)
    if not np.any(soft | stiff):
        return ()
    found = band.modulus[soft | stiff]
    factor, unit = modulus_unit(found)
    said = ", ".join(size_words(section))
    power = _POWERS.get(section.shape, _FOURTH_POWER)
    way = "soft: a size is too large or the forces are too small" if np.any(soft) else _TOO_STIFF
    text = (
        f"with the section that recording.toml states, Young's modulus is {_span_words(found / factor, unit)}. No "
        f"material is that {way}. Check {said} ({power}), and that the forces are in N"
    )
    return (Remark("warning", text, about="no material"),)


def _length_words(size: Array) -> str:
    return _span_words(size, "m") if np.max(size) >= 1.0 else _span_words(1e3 * size, "mm")


def _span_words(values: Array, unit: str) -> str:
    least, most = f"{float(np.min(values)):.3g}", f"{float(np.max(values)):.3g}"
    return f"{least} {unit}" if least == most else f"{least} to {most} {unit}"


def _same(one: StatedSection, other: StatedSection) -> bool:
    return section_as_dict(one) == section_as_dict(other)
