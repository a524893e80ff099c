"""What a report is written from. A run of the pipeline is one; so is anything with these fields."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from onebend.beam.model import Beam
from onebend.learning.outcome import Comparison, Learned
from onebend.learning.posterior import Posterior
from onebend.records import Observations, Remark


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
    return " + ".join(one.name for one in findings.recordings)


POOR = 0.15  # of a marker's own motion: an RMS beyond is said to be poor


def poor_fit(one: Comparison) -> list[Remark]:
    """A warning where the simulated beam misses a marker by a large part of what the marker moves."""
    motion = np.linalg.norm(np.fmax.reduce(one.measured) - np.fmin.reduce(one.measured), axis=-1)
    if one.static:  # poses may be few, or alike: counted from the straight beam
        motion = np.maximum(motion, np.nanmax(np.abs(one.measured[..., 1])))
    worst = int(np.argmax(np.nan_to_num(np.divide(one.rms, motion, out=np.zeros_like(motion), where=motion > 0.0))))
    if not one.rms[worst] > POOR * motion[worst]:
        return []
    check = "the force, its clock, the tags' size and places, and that the push was slow"
    if one.static:
        check = "the loads' and the points' units, the directions of axes and gravity, and the clamp's angle"
    text = (
        f"the simulated beam misses M{worst + 1} by {1000 * one.rms[worst]:.3g} mm RMS where it moves by "
        f"{1000 * motion[worst]:.3g} mm: this is no good fit. Check {check}"
    )
    return [Remark("warning", text)]


def all_remarks(findings: Findings) -> list[tuple[str, Remark]]:
    """Every remark once, with the name of the recording it belongs to; warnings first."""
    found: dict[tuple[str, str], tuple[str, Remark]] = {}
    groups = [(name_of(findings), list(findings.remarks))]
    every = zip(
        (*findings.recordings, *findings.validation_observations),
        (*findings.trainings, *findings.validations),
        strict=True,
    )
    groups += [(comparison.name, pair_remarks(comparison, seen)) for seen, comparison in every]
    for whose, remarks in groups:
        for remark in remarks:
            found.setdefault((whose, remark.text), (whose, remark))
    return sorted(found.values(), key=lambda pair: pair[1].level != "warning")


def pair_remarks(one: Comparison, seen: Observations) -> list[Remark]:
    """What is to be known of one validation."""
    return [*seen.remarks, *one.remarks, *poor_fit(one)]
