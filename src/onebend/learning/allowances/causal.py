"""The allowances of a learner that sees frame after frame, and the course of the push as far as it has been seen.

They are those of a whole recording but for what needs frames to come or a camera's place. Displacements here are over
the beam's length: nobody knows the largest one before the end. So the parameters that go with it keep their units, and
their prior follows the largest so far (`course_scale`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.chosen import OF_ONE, AllowanceName
from onebend.learning.allowances.clamp import giving
from onebend.learning.allowances.contact import sliding, turn_at_push
from onebend.learning.allowances.course import PushCourse
from onebend.learning.allowances.discrepancy import ANGLE, XY, discrepancy_of, of_axes, smooth_functions
from onebend.learning.allowances.length import length
from onebend.learning.allowances.patches import patches
from onebend.learning.allowances.posture import DEGREE, on_each_axis, posture_bias, powers
from onebend.learning.allowances.relaxation import relaxation
from onebend.learning.allowances.section import section
from onebend.records import Array, BoolArray

# Of the others, inertia needs frames to come, gravity's direction the weight, and three need the camera's place.
CAUSAL_ALLOWANCES: frozenset[AllowanceName] = OF_ONE - {
    "inertia",
    "gravity direction",
    "heights",
    "camera",
    "rolling shutter",
}
_LINEAR = (0, 2)  # those of the discrepancy's functions that are linear in the displacement, on both ways
# For time's sake these stand for all five. Their sd is such that at the largest displacement they are worth as much.
_WORTH = float(np.sqrt((1.0 + 1.0 + 0.25 + 0.25 + 1.0) / (1.0 + 0.25)))
TERMS = 2 + DEGREE + len(_LINEAR)  # numbers of a frame, see `CourseSoFar.terms`
SLIDE, CLAMP = slice(0, 1), slice(1, 2)
POSTURE, SMOOTH = slice(2, 2 + DEGREE), slice(2 + DEGREE, TERMS)
OF_COURSE: tuple[AllowanceName, ...] = ("posture", "discrepancy", "angle discrepancy")  # their sds follow the push


def causal_allowances(marker_s: Array, beam_length: float, tag_size: float, *, thick: bool) -> tuple[Allowance, ...]:
    """All of them, without frames; `tag_size` m, NaN where not known; `thick`: the section's thickness is known."""
    tags = tuple(f"tag {i}" for i in range(1, len(marker_s) + 1))
    no_functions = np.zeros((0, len(_LINEAR)))
    empty = np.zeros(0)
    none = PushCourse(empty, empty, empty, empty, np.zeros((0, len(marker_s))))
    return (
        section(known=thick),
        relaxation(none),
        sliding(marker_s, none, np.zeros(0)),
        giving(none, 0),
        posture_bias(none, np.array([[1.0, 0.0]])),  # per N of the largest force
        patches(marker_s, beam_length, tag_size, None),
        length(),
        *(replace(one, prior_sd=_WORTH * one.prior_sd) for one in discrepancy_of(no_functions, tags, beam_length)),
    )


def course_scale(name: str, parameters: int, largest: float, bend: float) -> Array:
    """(n,) factors on an allowance's `prior_sd`: `largest` N, the largest force so far; `bend` the largest displacement
    over the length."""
    if name == "posture":
        return np.asarray((largest or 1.0) / np.tile(bend ** np.arange(1.0, DEGREE + 1.0), parameters // DEGREE))
    return np.full(parameters, 1.0 / bend if name in OF_COURSE else 1.0)


class CourseSoFar:
    """The course of a push, from frames as they come."""

    def __init__(self, marker_s: Array) -> None:
        self._marker_s = marker_s
        self._rest = np.full(len(marker_s), np.nan)  # rad, of each tag
        self._turn = np.zeros(len(marker_s))

    def terms(self, angle: Array, visible: BoolArray, bend: float, push_s: float, *, back: bool, loaded: bool) -> Array:
        """(TERMS,) of the next frame, zero at rest: the turn of the beam at the push, that of the first tag, the powers
        of the displacement, the discrepancy's functions.

        `angle` (m,) rad of the tags where `visible`; `bend` displacement over the length; `back`: the load falls.
        """
        unknown = visible & (np.isnan(self._rest) | (not loaded))
        self._rest[unknown] = angle[unknown]
        if not loaded:
            self._turn = np.zeros_like(self._turn)
            return np.zeros(TERMS)
        turn = angle - self._rest
        turn -= 2.0 * np.pi * np.round((turn - self._turn) / (2.0 * np.pi))
        self._turn = np.where(visible, turn, self._turn)
        out = np.empty(TERMS)
        once = np.zeros(1)
        run = PushCourse(once, np.array([bend]), np.array([float(back)]), once, self._turn[None])
        out[SLIDE] = turn_at_push(self._marker_s, run.turn, np.array([push_s]))
        out[CLAMP], out[POSTURE], out[SMOOTH] = self._turn[0], powers(run.bend), smooth_functions(run)[:, _LINEAR]
        return out


class CourseBases:
    """The allowances that go with the course of the push, at the `terms` (B, TERMS) of B frames; `carried` by name."""

    def __init__(self, terms: Array, tags: int, carried: Collection[str]) -> None:
        self._terms, self._carried = terms, carried
        self.force = on_each_axis(terms[:, POSTURE])  # (B, 2, 4) N per unit: the posture-dependent bias
        axes = {"discrepancy": XY, "angle discrepancy": ANGLE}
        self.poses = {name: of_axes(terms[:, SMOOTH], tags, of) for name, of in axes.items() if name in carried}

    def blocks(self, of: Mapping[str, Array]) -> dict[str, Array]:
        """(B, m, 3, n) by name, of the tags' poses, from those with the "push", its "place" and the "clamp"."""
        slide, clamp = (self._terms[:, None, None, part] for part in (SLIDE, CLAMP))
        out = {"slide": of["place"] * slide, "clamp gives": of["clamp"] * clamp} | self.poses
        if "posture" in self._carried:
            out["posture"] = of["push"] @ self.force[:, None]
        return out

    def moved(self, values: Mapping[str, Array]) -> Array | float:
        """(B, m, 3) by which the tags seem to be off at these parameters."""
        return sum((basis @ values[name] for name, basis in self.poses.items()), start=0.0)
