"""Recordings of one beam: what their files alone say against it."""

from __future__ import annotations

from collections.abc import Sequence

from onebend.errors import LearningError, ObservationError
from onebend.recording.toml.entries import Recording

SAME_LENGTH = 0.01  # of the length: a larger difference is another beam, or a wrong length_m
SAME_PLACE = 4.0  # placement tolerances: written places of one tag that differ by more are a mistake


def check_together(wanted: Sequence[Recording], *, jointly: bool) -> None:
    """Raises `LearningError` where the recordings cannot be learned from together, read from their files alone;
    `jointly`: by a method that takes several."""
    first = wanted[0]
    if not jointly and len(wanted) > 1:
        raise LearningError("the regression learns from one recording; give one, or learn from all with the fit")
    for i, one in enumerate(wanted[1:], start=1):
        if any(one.folder.resolve() == other.folder.resolve() for other in wanted[:i]):
            raise LearningError(f"{one.folder} is given twice: the same data would count as two pushes. Give it once")
        if abs(one.beam.length - first.beam.length) > 1e-9 or _ids(one) != _ids(first):
            raise LearningError(
                f"{one.folder} is not of the beam of {first.folder}: {1000 * one.beam.length:.4g} mm with tags "
                f"{_ids(one)}, against {1000 * first.beam.length:.4g} mm with tags {_ids(first)}. Learn from "
                "recordings of one beam, or correct length_m and the tags"
            )
        for tag, same in zip(one.tags.on_beam, first.tags.on_beam, strict=True):
            away = abs(tag.s - same.s) * first.beam.length
            if away > SAME_PLACE * max(one.tags.placement_sd, first.tags.placement_sd, 1e-6):
                raise LearningError(
                    f"tag {tag.id} is at s = {tag.s:.4g} in {one.folder} and at s = {same.s:.4g} in {first.folder}. "
                    "Recordings that are learned from together need the same tags in the same places"
                )


def _ids(one: Recording) -> list[int]:
    return [tag.id for tag in one.tags.on_beam]


def check_same_length(length: float, recording: Recording) -> None:
    """Raises `ObservationError` where the recording is not of a beam of that length [m]."""
    if abs(recording.beam.length - length) > SAME_LENGTH * length:
        raise ObservationError(
            f"{recording.folder}: its beam is {1000 * recording.beam.length:.4g} mm long, the learned one "
            f"{1000 * length:.4g} mm. Validate on recordings of the same beam, or correct length_m"
        )
