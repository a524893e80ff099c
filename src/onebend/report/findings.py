"""What a report is written from. A run of the pipeline is one; so is anything with these fields."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from onebend.learning.outcome import Comparison, Learned
from onebend.records import Observations, Remark


class Findings(Protocol):
    """One learned recording, and the recordings it was validated on."""

    @property
    def learned(self) -> Learned: ...

    @property
    def observations(self) -> Observations: ...

    @property
    def validations(self) -> tuple[Comparison, ...]: ...

    @property
    def validation_observations(self) -> tuple[Observations, ...]: ...

    @property
    def stage_seconds(self) -> Mapping[str, float]: ...

    @property
    def video_seconds(self) -> float: ...


def all_remarks(findings: Findings) -> list[tuple[str, Remark]]:
    """Every remark once, with the name of the recording it belongs to; warnings first."""
    found: dict[tuple[str, str], tuple[str, Remark]] = {}
    name = findings.observations.name
    own = (*findings.observations.remarks, *findings.learned.remarks, *findings.learned.training.remarks)
    others = zip(findings.validation_observations, findings.validations, strict=True)
    groups = [(name, own)]
    groups += [(comparison.name, (*seen.remarks, *comparison.remarks)) for seen, comparison in others]
    for whose, remarks in groups:
        for remark in remarks:
            found.setdefault((whose, remark.text), (whose, remark))
    return sorted(found.values(), key=lambda pair: pair[1].level != "warning")
