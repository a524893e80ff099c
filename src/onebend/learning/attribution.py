"""Effect of each allowance on k(s): on the width of its band, and on its value. With C the posterior covariance, b an
allowance's parameters and c the coefficients of log k: if b were known, the variance of c would be `C_cc - C_cb C_bb^-1
C_bc`; if b were b_0, its value for the ideal bench, log k would change by `C_cb C_bb^-1 (b_0 - b)`. The expected square
of that change, given the data, orders the allowances. Squares are averaged over places with the precision of log k as
weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.learning.allowances import LEFT, NO_THICKNESS
from onebend.learning.linear import FitProblem, log_k_map
from onebend.learning.optimizer import Optimum
from onebend.learning.parameters import Block, groups
from onebend.learning.prediction import secant_of
from onebend.records import Array, IntArray

FORCE_SCALE = "force's scale"
GROUPS = groups()  # blocks of the layout, by the common name of their cause
# Unknown on every bench, and so no allowance for a bench that is not ideal.
_OF_EVERY_BENCH = (
    "error of the force log",
    "clock",
    "places of the tags",
    "clamp and origin",
    "direction of the force",
)
WIDENS = 1.1  # the band, at least
_MUCH = float(
    np.sqrt(1.0 - 1.0 / WIDENS**2)
)  # of the sd of log k: the change to be expected of what widens it by so much
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


def _away(problem: FitProblem, optimum: Optimum, blocks: list[Block]) -> tuple[list[IntArray], list[Array]]:
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
    return one.name in _OF_EVERY_BENCH, one.name == LEFT, -one.size


def _to_instantaneous(name: str, optimum: Optimum) -> float:
    """Log of the instantaneous stiffness over k(s), the secant stiffness: what relaxation itself makes of k(s)."""
    if name != "relaxation" or not optimum.predictions:
        return 0.0
    shares = [secant_of(p) for p in optimum.predictions]
    return float(-np.mean(np.log(shares)))


def _ideal(problem: FitProblem, block: Block) -> Array:
    """(n,) parameters of the ideal bench. What the rests say of the force log's error is known without the fit."""
    if block.name == "force":
        return np.asarray(problem.recordings[block.recording].error.mean.ravel())
    if block.name == "section":
        return np.full(len(block.prior_sd), NO_THICKNESS)
    return np.zeros(len(block.prior_sd))
