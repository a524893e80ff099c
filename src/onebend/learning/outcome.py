"""Results of learning and validation: frozen, with their reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.section import ModulusBand, modulus_band, section_as_dict
from onebend.beam.stiffness import UncertainStiffness
from onebend.records import Array, BoolArray, IntArray, Observations, Remark, StatedSection, marker_words

if TYPE_CHECKING:  # the fit itself takes long to load
    pass


@dataclass(frozen=True)
class Notice:
    """Something a person should know: a code and its numbers. `report.sentences` has the sentence of each code."""

    code: str  # a key of `report.sentences.SENTENCES`
    values: Mapping[str, Any] = field(default_factory=dict)  # SI and radians
    whose: str = ""  # the recording it is about, where there are several


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
    likely_rms: Array  # (m,) m, expected from that noise, the band of k(s) and the push's tolerances; NaN if unknown
    remarks: tuple[Notice | Remark, ...] = ()
    static: bool = False  # bench poses: `time` counts them

    @property
    def failed(self) -> bool:
        """Whether another push misses a marker by far more than is likely: the band of k(s) is not to be trusted."""
        least = np.maximum(SLIGHT * motion_of(self), MANY * np.nan_to_num(self.sensor_rms))
        return bool(np.any((self.rms > LIKELY * self.likely_rms) & (self.rms > least)))


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
    remarks: tuple[Notice | Remark, ...] = ()


POOR = 0.15  # of a marker's own motion: a larger RMS is a poor fit
LIKELY = 3.0  # times the RMS that the band of k(s) and the tolerances of the push predict: a larger RMS is unusual
MANY, SLIGHT = 5.0, 0.03  # times the effect of the force's noise; of a marker's own motion: a larger RMS is a failure


def poor_fit(one: Comparison, *, other: bool = False) -> tuple[Notice, ...]:
    """A warning if the beam misses a marker by a large part of its motion. `other`: it was not learned from this
    recording."""
    motion = motion_of(one)
    share = np.nan_to_num(np.divide(one.rms, motion, out=np.zeros_like(motion), where=motion > 0.0))
    worst = int(np.argmax(share))
    if not one.rms[worst] > POOR * motion[worst]:
        return ()
    code = f"tag missed{' by another beam' if other else ''}{' in poses' if one.static else ''}"
    tag = marker_words(int(one.tag_id[worst]), float(one.marker_s[worst]))
    values = {"tag": tag, "rms": float(one.rms[worst]), "motion": float(motion[worst])}
    return (Notice(code, values),)


def another_beam(one: Comparison) -> tuple[Notice, ...]:
    """A warning if a validation misses a marker by far more than the force's noise explains."""
    ratio = np.divide(one.rms, one.sensor_rms, out=np.zeros_like(one.rms), where=one.sensor_rms > 0.0)
    unusual = (one.rms > SLIGHT * motion_of(one)) & ~(one.rms <= LIKELY * one.likely_rms)
    ratio = np.where(unusual, ratio, 0.0)
    worst = int(np.argmax(ratio))
    if not ratio[worst] > MANY:
        return ()
    tag = marker_words(int(one.tag_id[worst]), float(one.marker_s[worst]))
    return (Notice("another beam", {"tag": tag, "times": float(ratio[worst])}),)


def motion_of(one: Comparison) -> Array:
    """(m,) m, how far each marker moves."""
    motion = np.linalg.norm(np.fmax.reduce(one.measured) - np.fmin.reduce(one.measured), axis=-1)
    if one.static:  # poses may be few, or alike: counted from the straight beam
        motion = np.maximum(motion, np.nanmax(np.abs(one.measured[..., 1])))
    return np.asarray(motion)


# Young's modulus of a learned beam whose section is stated. The thickness that the fit learns from stretch and shear is
# not used: E goes with its third power, and the fit determines it badly.

SOFTEST, STIFFEST = 1e3, 1.2e12  # Pa: a soft hydrogel, diamond


def stated_section(recordings: Sequence[Observations]) -> StatedSection | None:
    """The first section that a recording states; None if there is none."""
    return next((one.stated.section for one in recordings if one.stated.section is not None), None)


def modulus_along(
    beam: Beam, uncertain: UncertainStiffness | None, section: StatedSection | None, s: Array, level: float = 0.95
) -> ModulusBand | None:
    """E(s) [Pa] at places s (S,), with its band if k(s) has one; None without a section. Raises `MechanicsError` for
    sizes that are not positive."""
    return None if section is None else modulus_band(uncertain or beam.stiffness, beam.length, section, s, level)


def shown_places(band: ModulusBand) -> BoolArray:
    """(S,) where E is identified; if it is identified nowhere, where it is known."""
    return np.asarray(band.identified if np.any(band.identified) else np.isfinite(band.modulus))


def modulus_notices(
    beam: Beam, uncertain: UncertainStiffness | None, recordings: Sequence[Observations]
) -> tuple[Notice, ...]:
    """A warning if no material has such a modulus, and one if the recordings state different sections."""
    section = stated_section(recordings)
    band = modulus_along(beam, uncertain, section, np.linspace(0.0, 1.0, 201))
    if section is None or band is None:
        return ()
    first = next(one.source.name for one in recordings if one.stated.section is not None)
    others = [one.stated.section for one in recordings if one.stated.section is not None]
    alike = all(section_as_dict(section) == section_as_dict(other) for other in others)
    different = () if alike else (Notice("two sections", {"recording": first}),)
    if uncertain is not None and not np.any(band.identified):
        return different
    low, high = (np.where(np.isfinite(edge), edge, band.modulus) for edge in (band.low, band.high))
    soft, stiff = shown_places(band) & (high < SOFTEST), shown_places(band) & (low > STIFFEST)
    if not np.any(soft | stiff):
        return different
    code = "too soft" if np.any(soft) else "too stiff"
    return (*different, Notice(code, {"modulus": band.modulus[soft | stiff], "section": section}))
