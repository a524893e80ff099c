"""Effect of each allowance on k(s), and what in a recording contradicts its description.

The effect on the width of the band, and on k(s) itself: with C the posterior covariance, b an
allowance's parameters and c the coefficients of log k: if b were known, the variance of c would be `C_cc - C_cb C_bb^-1
C_bc`; if b were b_0, its value for the ideal bench, log k would change by `C_cb C_bb^-1 (b_0 - b)`. The expected square
of that change, given the data, orders the allowances. Squares are averaged over places with the precision of log k as
weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.beam.section import modulus_band
from onebend.beam.stiffness import UncertainStiffness
from onebend.learning import allowances, criticism, fit_data, frames, parameters, prediction
from onebend.learning.linear import FitProblem, log_k_map
from onebend.learning.optimizer import Optimum
from onebend.learning.outcome import SOFTEST, STIFFEST, shown_places, stated_section
from onebend.records import POINT_ID, Array, IntArray

# What in a recording contradicts its description or the fit's model, and by how much k(s) may be off for it.
#
# Every contradiction has a size: the change of log k that it may stand for, in sds of log k. Sizes add up in squares.
# Where they exceed `TRUSTED` together, the true k(s) may lie outside its 95 % band. A contradiction that the fit
# explains by a well-determined cause, as axes of the log that are turned, changes k(s) little and so is small.

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
    "force curve": "how the force grows",
    "clock runs": "the clocks of film and log",
}
NO_MATERIAL = "no material"
_ABOUT = {"the axes of the force": "axes", "the tags' places at rest": "tag places", "Young's modulus": NO_MATERIAL}
_OF_THE_FORCE = ("force direction", "axis scale", "force curve", "clock", "clock runs", "mass", "weight", "push place")


@dataclass(frozen=True)
class Contradiction:
    """Two statements that do not agree."""

    name: str  # of what may be wrong
    shift: float  # of log k
    sds: float  # the same in sds of log k
    about: str = ""  # what a warning on it is about; empty where a test of the model speaks


def contradictions(
    problem: FitProblem, optimum: Optimum, critic: criticism.Criticism, known: UncertainStiffness
) -> tuple[Contradiction, ...]:
    """All of a fit, the largest first; `known`: k(s) with its band."""
    sd = _typical_sd(known)
    striking = critic.causes or critic.alarms  # causes about as likely, freed; without one the trends that stand out
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


def _named(critic: criticism.Criticism) -> str:
    name = critic.causes[0].score.suspect.name if critic.causes else "the model"
    return _STATED.get(name, name)


def _explained(critic: criticism.Criticism) -> bool:
    """Whether what stands out is a cause that makes the log predict other shapes."""
    return any(one.score.suspect.name in _OF_THE_FORCE for one in critic.causes)


def _of_the_log(problem: FitProblem, optimum: Optimum) -> float:
    """Share of the tags' motion that is predicted wrongly without the slow error that the fit takes off the log: small
    forces and bends are proportional, so it is the share of k that rests on this error. A zero that no rest has shown
    is no part of it."""
    shares = [0.0]
    for data, now in zip(problem.recordings, optimum.predictions, strict=True):
        if not len(data.error.knots):
            continue
        x, where = optimum.x.copy(), problem.layout.index["force", data.number].where
        clean = data.observations.source.clean_force
        unknown = clean is not None and not len(clean.zero_time)
        x[where] = np.tile(np.mean(x[where].reshape(-1, 2), axis=0), len(data.error.knots)) if unknown else 0.0
        off = data.off(prediction.predict(data, problem.layout, x, now.solved.q).pose)
        motion = _motion(data)
        missed = np.nan_to_num(frames.marker_rms(off[..., :2]))  # nothing of a tag that was never seen
        shares.append(float(np.max(missed / np.maximum(motion, _LITTLE * np.max(motion)))))
    return max(shares)


def _of_the_axes(problem: FitProblem) -> float:
    """Share of the moments that the log's axes leave unexplained where others would leave far less."""
    remarks = (remark for one in problem.recordings for remark in one.observations.source.remarks)
    return max((remark.share for remark in remarks), default=0.0)


def _motion(data: fit_data.FitData) -> Array:
    """(m,) m, how far each tag moves."""
    xy = data.measured[..., :2]
    return np.asarray(np.linalg.norm(np.fmax.reduce(xy) - np.fmin.reduce(xy), axis=-1))


def _of_the_rest(data: fit_data.FitData) -> float:
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


FORCE_SCALE = "force's scale"
GROUPS = parameters.groups()  # blocks of the layout, by the common name of their cause
# Unknown on every bench, and so no allowance for a bench that is not ideal.
_OF_EVERY_BENCH = (
    "error of the force log",
    "clock",
    "places of the tags",
    "clamp and origin",
    "direction of the force",
)
WIDENS = 1.1  # the band, at least
_MUCH = float(np.sqrt(1.0 - 1.0 / WIDENS**2))  # of the sd of log k: the change to be expected of what widens it so
SHIFTS, _SURE = 0.02, 2.0  # log k, at least, by something that is so many sd from nothing
_LEAST_LEFT = 1e-4  # of the variance: what is left at least


@dataclass(frozen=True)
class Attribution:
    """What one thing about the bench does to k(s), over the places looked at."""

    name: str
    widening: float  # the sd of log k over what it would be, were this known exactly
    shift: float  # RMS of the change of log k, were this as on the ideal bench
    sds: float  # how far its parameters are from the ideal bench's, in sd, less what several reach by chance
    size: float  # RMS of the same change, as the data leave it open
    sd: float  # of log k

    @property
    def matters(self) -> bool:
        """Whether k(s) or its band would be visibly otherwise without it."""
        much = self.size > _MUCH * self.sd or (self.sure and self.shift > SHIFTS)
        return self.name not in _OF_EVERY_BENCH and much

    @property
    def sure(self) -> bool:
        """Whether the data show it clearly."""
        return self.sds > _SURE


def attributions(problem: FitProblem, optimum: Optimum, gain_sd: float, s: Array) -> tuple[Attribution, ...]:
    """All allowances, by their size at places `s` (S,), the largest first; then the remaining discrepancy, then those
    of every bench. `gain_sd`: of the force's common scale, 0 if exact."""
    layout, covariance = problem.layout, optimum.covariance
    basis = _basis(problem, s)
    variance = np.einsum("sp,pq,sq->s", basis, covariance.of_shared, basis, optimize=True) + gain_sd**2
    weights = 1.0 / variance / np.sum(1.0 / variance)
    out = [_attribution(FORCE_SCALE, weights, variance, np.full(len(s), gain_sd**2))] if gain_sd > 0.0 else []
    for name, blocks in GROUPS.items():
        free = [b for b in layout.blocks if b.name in blocks and b.start >= 0]
        if not free:
            continue
        index, away = _away(problem, optimum, free)
        known = covariance.conditioned(basis, index, away)
        change = np.hypot(known.change, _to_instantaneous(name, optimum))
        count = sum(len(one) for one in away)
        sds = float(np.sqrt(max(known.chi_squared - (count - 1), 0.0)))
        out.append(_attribution(name, weights, variance, known.explained, change, sds))
    return tuple(sorted(out, key=_place))


def hidden_by(problem: FitProblem, optimum: Optimum, gain_sd: float, s: Array) -> tuple[Array, dict[str, Array]]:
    """(S,) sd of log k at places `s` (S,) if all else were known exactly; and the same with one group of `GROUPS` left
    unknown, by its name."""
    layout, covariance = problem.layout, optimum.covariance
    basis = _basis(problem, s)
    variance = np.einsum("sp,pq,sq->s", basis, covariance.of_shared, basis, optimize=True)
    log_k, _ = log_k_map(problem)

    def spread(left: tuple[str, ...]) -> Array:
        known = [b for b in layout.blocks if b.start >= 0 and b.name not in left]
        index, away = _away(problem, optimum, known)
        others = ~np.isin(index[0], log_k)
        index[0], away[0] = index[0][others], away[0][others]
        explained = covariance.conditioned(basis, index, away).explained
        return np.asarray(np.sqrt(np.maximum(variance - explained, 0.0) + gain_sd**2))

    free = {b.name for b in layout.blocks if b.start >= 0}
    return spread(()), {name: spread(blocks) for name, blocks in GROUPS.items() if free & set(blocks)}


def _basis(problem: FitProblem, s: Array) -> Array:
    """(S, n) log k at places, by the shared parameters."""
    log_k, onto = log_k_map(problem)
    basis = np.zeros((len(s), problem.layout.shared))
    basis[:, log_k] = problem.layout.spline.finer.basis(s) @ onto
    return basis


def _attribution(
    name: str, weights: Array, variance: Array, explained: Array, change: Array | float = 0.0, sds: float = 0.0
) -> Attribution:
    """From log k's `variance` (S,), the part of it that is `explained` (S,), and the `change` (S,) of log k."""
    whole, part, square = float(weights @ variance), float(weights @ explained), float(np.sum(weights * change**2))
    widening = float(np.sqrt(whole / max(whole - part, _LEAST_LEFT * whole)))
    size = float(np.sqrt(square + max(part, 0.0)))
    return Attribution(name, widening, float(np.sqrt(square)), sds, size, float(np.sqrt(whole)))


def _away(problem: FitProblem, optimum: Optimum, blocks: list[parameters.Block]) -> tuple[list[IntArray], list[Array]]:
    """Where blocks stand in the parts of the parameters, and how far they are from the ideal bench's."""
    index: list[IntArray] = [np.zeros(0, dtype=np.int64) for _ in problem.layout.parts]
    away = [np.zeros(0) for _ in problem.layout.parts]
    for block in blocks:
        part, where = 1 + block.recording, block.where
        begin = problem.layout.parts[part].start
        index[part] = np.append(index[part], np.arange(where.start - begin, where.stop - begin))
        away[part] = np.append(away[part], optimum.x[where] - _ideal(problem, block))
    return index, away


def _place(one: Attribution) -> tuple[bool, bool, float]:
    return one.name in _OF_EVERY_BENCH, one.name == allowances.LEFT, -one.size


def _to_instantaneous(name: str, optimum: Optimum) -> float:
    """Log of the instantaneous stiffness over k(s), the secant stiffness: what relaxation itself makes of k(s)."""
    if name != "relaxation" or not optimum.predictions:
        return 0.0
    shares = [prediction.secant_of(p) for p in optimum.predictions]
    return float(-np.mean(np.log(shares)))


def _ideal(problem: FitProblem, block: parameters.Block) -> Array:
    """(n,) parameters of the ideal bench. What the rests say of the force log's error is known without the fit."""
    if block.name == "force":
        return np.asarray(problem.recordings[block.recording].error.mean.ravel())
    if block.name == "section":
        return np.full(len(block.prior_sd), allowances.NO_THICKNESS)
    return np.zeros(len(block.prior_sd))
