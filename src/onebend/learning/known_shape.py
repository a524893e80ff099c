"""What is stated of how k varies along the beam: then one number is learned of it, and a slow correction where wanted.

log k(s) = o(s) + l + e(s) + v(s): o is log I(s) of the stated section less its mean (zero where k is "even"), l one
level, e what an error of the section's stated sizes does to log I, v a slow variation of the modulus, a Gaussian
process of the stated sd with correlation exp(-d^2 / (2 C^2)) of places d apart, C being half of the beam.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from onebend.beam.profiles.measured_section import moment_errors, relative_moment
from onebend.beam.profiles.polyline import Polyline
from onebend.beam.profiles.stiffness import LogSpline, Profile, Uniform
from onebend.errors import LearningError
from onebend.records import Array, Observations, StatedSection, StiffnessAlong

CORRELATION = 0.5  # C, of the length
_LEAST = 1e-8  # of the largest: smaller parts of the slow variation are left out
_PLACES = np.linspace(0.0, 1.0, 201)


@dataclass(frozen=True)
class KnownShape:
    """How k varies along the beam but for a factor, as stated."""

    section: StatedSection | None  # whose second moment k goes with; None: k is one number
    varies: float  # one sd of the slow variation of log k

    @cached_property
    def offset(self) -> Polyline | None:
        """o(s); None where it is zero."""
        return None if self.section is None else relative_moment(self.section)

    @property
    def profile(self) -> Profile:
        """exp o(s): k over its geometric mean."""
        if self.offset is None:
            return Uniform(1.0)
        return LogSpline((0.0, 0.0, 1.0, 1.0), (0.0, 0.0), 1, self.offset)

    def offset_at(self, s: Array) -> Array:
        """`s.shape`: o."""
        return np.zeros(np.shape(s)) if self.offset is None else self.offset(s)

    def errors(self, s: Array) -> Array:
        """(S, n) functions whose coefficients, of sd one each, make e(s)."""
        return np.zeros((len(s), 0)) if self.section is None else moment_errors(self.section, s)

    def slow(self, s: Array) -> Array:
        """(S, n) functions whose coefficients, of sd one each, make v(s) (Karhunen and Loeve)."""
        apart = _PLACES[:, None] - _PLACES
        values, vectors = np.linalg.eigh(np.exp(-0.5 * (apart / CORRELATION) ** 2))
        kept = values > _LEAST * values[-1]
        functions = self.varies * vectors[:, kept] * np.sqrt(values[kept])
        columns = [np.interp(s, _PLACES, function) for function in functions.T if self.varies > 0.0]
        return np.stack(columns, axis=1) if columns else np.zeros((len(s), 0))


def with_shared_shape(recordings: Sequence[Observations]) -> Sequence[Observations]:
    """The recordings of a beam, each with what one of them states of its shape.

    Raises:
        LearningError: as `known_shape`.
    """
    known = known_shape(recordings)
    if known is None:
        return recordings
    along: StiffnessAlong = "even" if known.section is None else "section"
    out = [replace(o.stated, stiffness_along=along, modulus_varies=known.varies) for o in recordings]
    if known.section is not None:
        out = [replace(stated, section=known.section) for stated in out]
    return [replace(o, stated=stated) for o, stated in zip(recordings, out, strict=True)]


def known_shape(recordings: Sequence[Observations]) -> KnownShape | None:
    """What one recording of a beam says holds for all; None where nothing is stated.

    Raises:
        LearningError: the recordings contradict each other.
    """
    said = [o.stated for o in recordings if o.stated.stiffness_along != "unknown"]
    names = ", ".join(o.source.name for o in recordings)
    if len({one.stiffness_along for one in said}) > 1 or len({one.modulus_varies for one in said}) > 1:
        raise LearningError(
            f"{names}: stiffness_along or modulus_varies differ. It is one beam: write the same in each recording"
        )
    if not said:
        return None
    section = next((one.section for one in said if one.section is not None), None)
    if said[0].stiffness_along == "section" and section is None:
        raise LearningError(f'{names}: stiffness_along = "section" needs the section in one of them')
    return KnownShape(section if said[0].stiffness_along == "section" else None, said[0].modulus_varies)
