"""What in a recording contradicts its description or the fit's model, and by how much k(s) may be off for it.

Every contradiction has a size: the change of log k that it may stand for, in sds of log k. Sizes add up in squares.
Where they exceed `TRUSTED` together, the true k(s) may lie outside its 95 % band. A contradiction that the fit explains
by a well-determined cause, as axes of the log that are turned, changes k(s) little and so is small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.beam.section import modulus_band
from onebend.beam.stiffness import UncertainStiffness
from onebend.learning.criticism import Criticism
from onebend.learning.fit_data import FitData
from onebend.learning.frames import marker_rms
from onebend.learning.linear import FitProblem
from onebend.learning.optimizer import Optimum
from onebend.learning.outcome import SOFTEST, STIFFEST, shown_places, stated_section
from onebend.learning.prediction import predict
from onebend.records import POINT_ID, Array

TRUSTED = 2.0  # sds of log k: what a 95 % band covers
_NAMED = 0.3  # of all together: smaller ones are not named
_LARGE = 1.0  # of log k: the sizes are of first order
_PLACED = 4.0  # tolerances, beyond which the places of the tags at rest contradict recording.toml
_LITTLE = 0.3  # of the largest motion of a tag: a miss of one that moves less says little
_OF_LENGTHS = 1.0  # relative change of k with all measured lengths: shapes and k scale alike
_STATED = {  # what a cause is of, in words
    "along": "the place of a tag",
    "across": "the place of a tag",
    "turn": "the turn of a tag",
    "scale": "the scale of lengths",
    "origin": "the place of the clamp",
    "clamp": "the direction of the clamp",
    "push place": "the place of the push",
    "force direction": "the direction of the force",
}
NO_MATERIAL = "no material"
_ABOUT = {"the axes of the force": "axes", "the tags' places at rest": "tag places", "Young's modulus": NO_MATERIAL}
_OF_THE_FORCE = ("force direction", "axis scale", "clock", "mass", "weight", "push place")


@dataclass(frozen=True)
class Contradiction:
    """Two statements that do not agree."""

    name: str  # of what may be wrong
    shift: float  # of log k
    sds: float  # the same in sds of log k
    about: str = ""  # what a warning on it is about; empty where a test of the model speaks


def contradictions(
    problem: FitProblem, optimum: Optimum, critic: Criticism, known: UncertainStiffness
) -> tuple[Contradiction, ...]:
    """All of a fit, the largest first; `known`: k(s) with its band."""
    sd = _typical_sd(known)
    striking = critic.causes[:1] or critic.alarms  # the likeliest cause, freed; without one the trends that stand out
    found = {
        _named(critic): max((one.sds for one in striking), default=0.0),
        "the force log": 0.0 if _explained(critic) else _of_the_log(problem, optimum) / sd,
        "the axes of the force": 0.0 if _explained(critic) else _of_the_axes(problem) / sd,
        "the tags' places at rest": max(map(_of_the_rest, problem.recordings), default=0.0) / sd,
        "Young's modulus": _of_the_modulus(problem, known) / sd,
    }
    named = [Contradiction(name, sds * sd, sds, _ABOUT.get(name, "")) for name, sds in found.items() if sds > 0.0]
    return tuple(sorted(named, key=lambda one: -one.sds))


def doubt_of(every: Sequence[Contradiction]) -> str:
    """What they make doubtful together, in words; empty where the band covers it."""
    shift, sds = (float(np.linalg.norm([getattr(one, name) for one in every])) for name in ("shift", "sds"))
    if sds <= TRUSTED:
        return ""
    names = " and ".join(one.name for one in every if one.sds > _NAMED * sds)
    size = f"{100.0 * np.expm1(shift):.2g} %" if shift < _LARGE else "any factor"
    return f"recording and description disagree on {names}: k(s) could be off by {size} ({sds:.2g} sd)"


def _typical_sd(known: UncertainStiffness) -> float:
    s = np.linspace(0.0, 1.0, 101)
    identified = known.band(s).identified
    sd = np.hypot(known.log_at(s)[1], known.gain_sd)
    return float(np.median(sd[identified] if np.any(identified) else sd))


def _named(critic: Criticism) -> str:
    name = critic.causes[0].score.suspect.name if critic.causes else "the model"
    return _STATED.get(name, name)


def _explained(critic: Criticism) -> bool:
    """Whether what stands out is a cause that makes the log predict other shapes."""
    return any(one.score.suspect.name in _OF_THE_FORCE for one in critic.causes)


def _of_the_log(problem: FitProblem, optimum: Optimum) -> float:
    """Share of the tags' motion that is predicted wrongly without the slow error that the fit takes off the log: small
    forces and bends are proportional, so it is the share of k that rests on this error."""
    shares = [0.0]
    for data, now in zip(problem.recordings, optimum.predictions, strict=True):
        if not len(data.error.knots):
            continue
        x = optimum.x.copy()
        x[problem.layout.index["force", data.number].where] = 0.0
        off = data.off(predict(data, problem.layout, x, now.solved.q).pose)
        motion = _motion(data)
        missed = np.nan_to_num(marker_rms(off[..., :2]))  # nothing of a tag that was never seen
        shares.append(float(np.max(missed / np.maximum(motion, _LITTLE * np.max(motion)))))
    return max(shares)


def _of_the_axes(problem: FitProblem) -> float:
    """Share of the moments that the log's axes leave unexplained where others would leave far less."""
    remarks = (remark for one in problem.recordings for remark in one.observations.source.remarks)
    return max((remark.share for remark in remarks), default=0.0)


def _motion(data: FitData) -> Array:
    """(m,) m, how far each tag moves."""
    xy = data.measured[..., :2]
    return np.asarray(np.linalg.norm(np.fmax.reduce(xy) - np.fmin.reduce(xy), axis=-1))


def _of_the_rest(data: FitData) -> float:
    """Relative change of k if lengths in the pictures are as wrong as the tags at rest show."""
    o = data.observations
    if o.static:
        return 0.0
    off = np.fmax.reduce(np.abs(o.rest_xy[:, 0] - o.length * o.marker_s)[o.tag_id < POINT_ID], initial=0.0)
    curved = 0.0 if o.stated.rest == "straight" else o.length * o.stated.curvature_sd**2  # a curve ends nearer
    return _OF_LENGTHS * float(off) / o.length if off > _PLACED * o.stated.placement_sd + curved else 0.0


def _of_the_modulus(problem: FitProblem, known: UncertainStiffness) -> float:
    """How far log E is outside of what materials have."""
    every = [one.observations for one in problem.recordings]
    section = stated_section(every)
    if section is None:
        return 0.0
    band = modulus_band(known, every[0].length, section, np.linspace(0.0, 1.0, 201))
    log_e = np.log(band.modulus[shown_places(band)])
    return float(max(np.max(np.log(SOFTEST) - log_e), np.max(log_e - np.log(STIFFEST)), 0.0)) if log_e.size else 0.0
