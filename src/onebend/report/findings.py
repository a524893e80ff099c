"""What a report is written from. A run of the pipeline is one; so is anything with these fields."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from onebend.beam.model import Beam
from onebend.learning.outcome import Comparison, Learned
from onebend.learning.posterior import Posterior
from onebend.records import Array, Observations, Remark


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
    return " + ".join(one.source.name for one in findings.recordings)


POOR = 0.15  # of a marker's own motion: an RMS beyond is said to be poor
MANY, SLIGHT = 5.0, 0.03  # times what the force's noise explains, of a marker's own motion: a validation has failed


def poor_fit(one: Comparison, *, other: bool = False) -> list[Remark]:
    """A warning where the simulated beam misses a marker by a large part of what the marker moves; `other`: it was not
    learned from."""
    motion = _motion(one)
    worst = int(np.argmax(np.nan_to_num(np.divide(one.rms, motion, out=np.zeros_like(motion), where=motion > 0.0))))
    if not one.rms[worst] > POOR * motion[worst]:
        return []
    check = "the force, its clock, the tags' size and places, and that the push was slow"
    if one.static:
        check = "the loads' and the points' units, the directions of axes and gravity, and the clamp's angle"
    if other:
        check = f"that this is the beam that was learned, {check}"
    text = (
        f"the simulated beam misses M{worst + 1} by {1000 * one.rms[worst]:.3g} mm RMS where it moves by "
        f"{1000 * motion[worst]:.3g} mm: this is no good fit. Check {check}"
    )
    return [Remark("warning", text)]


def another_beam(one: Comparison) -> list[Remark]:
    """A warning where a recording that was not learned from is missed by far more than its force's noise explains."""
    ratio = np.divide(one.rms, one.sensor_rms, out=np.zeros_like(one.rms), where=one.sensor_rms > 0.0)
    ratio = np.where(one.rms > SLIGHT * _motion(one), ratio, 0.0)
    worst = int(np.argmax(ratio))
    if not ratio[worst] > MANY:
        return []
    text = (
        f"M{worst + 1} is missed by {ratio[worst]:.2g} times what the force's noise explains: is this another beam "
        "than the learned one, or are the clock, the force or the place of the push wrong in one of the two recordings?"
    )
    return [Remark("warning", text)]


def _motion(one: Comparison) -> Array:
    """(m,) m, how far each marker moves."""
    motion = np.linalg.norm(np.fmax.reduce(one.measured) - np.fmin.reduce(one.measured), axis=-1)
    if one.static:  # poses may be few, or alike: counted from the straight beam
        motion = np.maximum(motion, np.nanmax(np.abs(one.measured[..., 1])))
    return np.asarray(motion)


def all_remarks(findings: Findings) -> list[tuple[str, Remark]]:
    """Every remark once, with the name of the recording it belongs to; warnings first."""
    found: dict[tuple[str, str], tuple[str, Remark]] = {}
    groups = [(name_of(findings), list(findings.remarks))]
    for one, seen in zip(findings.trainings, findings.recordings, strict=True):
        groups.append((one.name, [*seen.source.remarks, *one.remarks, *poor_fit(one)]))
    for one, seen in zip(findings.validations, findings.validation_observations, strict=True):
        groups.append((one.name, pair_remarks(one, seen)))
    for whose, remarks in groups:
        for remark in remarks:
            found.setdefault((whose, remark.text), (whose, remark))
    return sorted(found.values(), key=lambda pair: pair[1].level != "warning")


def pair_remarks(one: Comparison, seen: Observations) -> list[Remark]:
    """What is to be known of one validation."""
    return [*seen.source.remarks, *one.remarks, *(poor_fit(one, other=True) or another_beam(one))]
