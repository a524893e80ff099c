"""What a report is written from: a run of the pipeline, or anything with the same fields."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

import numpy as np

from onebend.beam.model import Beam
from onebend.learning.outcome import Comparison, Learned
from onebend.records import Array, Observations, Remark

if TYPE_CHECKING:  # for the type alone: the fit takes a quarter of a second to load
    from onebend.learning.posterior import Posterior


class Findings(Protocol):
    """A beam, what it was learned from and how, and the recordings it was validated on."""

    @property
    def beam(self) -> Beam: ...

    @property
    def learned(self) -> Learned | None: ...

    @property
    def posterior(self) -> Posterior | None: ...

    @property
    def recordings(self) -> tuple[Observations, ...]: ...

    @property
    def trainings(self) -> tuple[Comparison, ...]: ...

    @property
    def validations(self) -> tuple[Comparison, ...]: ...

    @property
    def validation_observations(self) -> tuple[Observations, ...]: ...

    @property
    def remarks(self) -> tuple[Remark, ...]: ...

    @property
    def stage_seconds(self) -> Mapping[str, float]: ...

    @property
    def video_seconds(self) -> float: ...


def name_of(findings: Findings) -> str:
    """The recordings that were learned from, in one line."""
    return " + ".join(recording.source.name for recording in findings.recordings)


POOR = 0.15  # of a marker's own motion: an RMS beyond is said to be poor
LIKELY = 3.0  # times what the band of k(s) and the tolerances of the push let expect: an error up to that is no news
MANY, SLIGHT = 5.0, 0.03  # times what the force's noise explains, of a marker's own motion: a validation has failed


def poor_fit(comparison: Comparison, *, other: bool = False) -> list[Remark]:
    """A warning where the simulated beam misses a marker by a large part of what the marker moves; `other`: it was not
    learned from."""
    motion = _motion(comparison)
    worst = int(
        np.argmax(np.nan_to_num(np.divide(comparison.rms, motion, out=np.zeros_like(motion), where=motion > 0.0)))
    )
    if not comparison.rms[worst] > POOR * motion[worst]:
        return []
    check = "the force, its clock, the tags' size and places, and that the push was slow"
    if comparison.static:
        check = "the loads' and the points' units, the directions of axes and gravity, and the clamp's angle"
    if other:
        check = f"that this is the beam that was learned, {check}"
    text = (
        f"the simulated beam misses tag {comparison.tag_id[worst]} by {1000 * comparison.rms[worst]:.3g} mm RMS where "
        "it moves by "
        f"{1000 * motion[worst]:.3g} mm: this is no good fit. Check {check}"
    )
    return [Remark("warning", text, about="tag missed")]


def another_beam(comparison: Comparison) -> list[Remark]:
    """A warning where a recording that was not learned from is missed by far more than its force's noise explains."""
    ratio = np.divide(
        comparison.rms, comparison.sensor_rms, out=np.zeros_like(comparison.rms), where=comparison.sensor_rms > 0.0
    )
    odd = (comparison.rms > SLIGHT * _motion(comparison)) & ~(comparison.rms <= LIKELY * comparison.likely_rms)
    ratio = np.where(odd, ratio, 0.0)
    worst = int(np.argmax(ratio))
    if not ratio[worst] > MANY:
        return []
    text = (
        f"tag {comparison.tag_id[worst]} is missed by {ratio[worst]:.2g} times the force noise: is this another beam "
        "than the learned one, or are the clock, the force or the place of the push wrong in one of the two recordings?"
    )
    return [Remark("warning", text, about="another beam")]


def _motion(comparison: Comparison) -> Array:
    """(m,) m, how far each marker moves."""
    motion = np.linalg.norm(np.fmax.reduce(comparison.measured) - np.fmin.reduce(comparison.measured), axis=-1)
    if comparison.static:  # poses may be few, or alike: counted from the straight beam
        motion = np.maximum(motion, np.nanmax(np.abs(comparison.measured[..., 1])))
    return np.asarray(motion)


def all_remarks(findings: Findings) -> list[tuple[str, Remark]]:
    """Every remark once, with the name of the recording it belongs to; warnings first."""
    found: dict[tuple[str, str], tuple[str, Remark]] = {}
    groups = [(name_of(findings), list(findings.remarks))]
    for comparison, recording in zip(findings.trainings, findings.recordings, strict=True):
        said = [*recording.source.remarks, *comparison.remarks]
        if not (comparison.static and findings.posterior):  # how far the fit stays from static poses is its own remark
            said += poor_fit(comparison)
        groups.append((comparison.name, said))
    for comparison, recording in zip(findings.validations, findings.validation_observations, strict=True):
        groups.append((comparison.name, pair_remarks(comparison, recording)))
    for whose, remarks in groups:
        for remark in remarks:
            found.setdefault((whose, remark.text), (whose, remark))
    return sorted(found.values(), key=lambda pair: pair[1].level != "warning")


def pair_remarks(comparison: Comparison, observations: Observations) -> list[Remark]:
    """What is to be known of one validation."""
    return [
        *observations.source.remarks,
        *comparison.remarks,
        *(poor_fit(comparison, other=True) or another_beam(comparison)),
    ]
