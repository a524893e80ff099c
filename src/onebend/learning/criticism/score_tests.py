"""Score tests: would a few more free numbers lower the misfit by more than chance does?

The linearised model at the optimum is `r = J x + D b + noise` with the priors on x, at the hyperparameters of the fit.
With x integrated out, b has the information `C^-1 = H_bb - H_bx (H_xx + P)^-1 H_xb`, the estimate `C g` from the score
g, and `g' C g` is chi-squared with as many degrees of freedom as b has numbers, if the model is right (Rao 1948).

A lasting misfit has raised the noise that the fit found. So the noise is estimated anew with b free, its correlation
in time included, and the F distribution takes the place of chi-squared, with as many degrees of freedom as independent
numbers remain.

For a parameter that the model has under a prior, freeing it is the same as asking whether the prior is wrong:
`x' (prior - posterior covariance)^-1 x` is chi-squared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from onebend.learning.criticism.alternatives import Alternative, Suspect
from onebend.learning.inference.fit_problem import FitProblem, prior
from onebend.learning.inference.hyperparameters import correlation_time
from onebend.learning.inference.linear_gaussian import (
    ResidualRows,
    data_information,
    force_shrinkage,
    posterior_of,
    residual_rows,
    split_off_force,
)
from onebend.learning.inference.optimizer import Optimum
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.readings import unwhitened, whitened
from onebend.records import Array, IntArray

_BLIND = 1e-8  # share of the information on b: less remains only where the model's own parameters do the same
_LEAST_REMOVED = 0.05  # share of the prior variance: a pull is judged where the data have removed more than this
_NEW_NOISE = -2.0  # log10 of chi-squared's p: the noise is estimated anew below it


@dataclass(frozen=True)
class Score:
    """One test."""

    suspect: Suspect
    value: Array  # (n,) the numbers, freed; NaN where the model's own parameters can do the same
    sd: Array  # (n,) of it; before the data where the model has it under a prior
    gain: float  # decrease of -2 log p when it is freed, under the noise that is then left
    log10_p: float  # log10 of the probability of as large a gain, the model being right
    size: float  # m, RMS over the frames of what the tag that it moves most moves by, all else refitted
    shift: Array  # (p,) by which the coefficients of log k change
    noise: float = 1.0  # variance that the fit took for noise over what is left of it, not below 1


@dataclass(frozen=True)
class LinearisedFit:
    """The linearised model at the optimum."""

    problem: FitProblem
    optimum: Optimum
    rows: tuple[ResidualRows, ...]  # of each recording
    known: tuple[IntArray, ...]  # indices of the parameters that each recording depends on
    covariance: Array  # (P, P) at the optimum's hyperparameters
    step: Array  # (P,) to where the slope is zero


def linearised(problem: FitProblem, optimum: Optimum) -> LinearisedFit:
    """The linearised model at an optimum."""
    layout, x, noise = problem.layout, optimum.x, optimum.hyperparameters.noise
    rows = tuple(residual_rows(now, n) for now, n in zip(optimum.predictions, noise, strict=True))
    data = data_information(problem, rows, x, optimum.hyperparameters)
    posterior = posterior_of(data, prior(problem, optimum.hyperparameters))
    known = tuple(layout.known_to(recording.number) for recording in problem.recordings)
    return LinearisedFit(problem, optimum, rows, known, posterior.covariance, posterior.mean - x)


def pulls(fit: LinearisedFit) -> list[Score]:
    """How far the nuisances came out from their priors: tags one by one, the parts of other blocks together.

    Directions without information from the data are left out. Place and direction of the push are among the
    alternatives.
    """
    untested = {"stiffness", "force", "place", "direction", "end", "end turn", "zero"}
    untested |= {a.name for recording in fit.problem.recordings for a in recording.allowances}
    out = []
    for block in fit.problem.layout.blocks:
        if block.start < 0 or block.name in untested:
            continue
        whose = "" if block.recording < 0 else fit.problem.recordings[block.recording].observations.source.name
        tags = (
            fit.problem.recordings[0].observations.tag_id.tolist()
            if block.name in ("along", "across", "turn")
            else [-1]
        )
        for i, tag in enumerate(tags):
            own = np.array([i]) if tag >= 0 else np.arange(len(block.labels))
            suspect = Suspect("prior", block.name, tag, whose)
            out.append(_pull(fit, suspect, block.start + own, block.prior_sd[own], block.unit))
    return out


def _pull(fit: LinearisedFit, suspect: Suspect, index: IntArray, before: Array, unit: str) -> Score:
    x = fit.optimum.x[index]
    removed = np.eye(len(index)) - fit.covariance[np.ix_(index, index)] / np.outer(before, before)
    values, vectors = np.linalg.eigh(0.5 * (removed + removed.T))
    judged = values > _LEAST_REMOVED
    freed = vectors[:, judged] @ ((vectors[:, judged].T @ (x / before)) / values[judged])  # in prior sds
    gain, count = float(freed @ (x / before)), int(np.sum(judged))
    log10_p = float(_distributions().chi2.logsf(gain, count)) / np.log(10.0) if count else 0.0
    shift = fit.covariance[: fit.problem.layout.spline.count, index] @ (freed / before)
    size = float(np.linalg.norm(x)) if unit == "m" else 0.0
    return Score(suspect, before * freed if count else np.full(len(x), np.nan), before, gain, log10_p, size, shift)


@dataclass(frozen=True)
class _Extended:
    """The information on the numbers of all alternatives, B together."""

    where: dict[Suspect, slice]
    d: tuple[Array, ...]  # (F, R, B) of each recording, whitened
    information: Array  # (B,) of each number alone
    mixed: Array  # (B, P)
    marginal: Array  # (B, B) with the parameters integrated out
    score: Array  # (B,)


def scores(fit: LinearisedFit, patterns: Sequence[Sequence[Alternative]]) -> list[Score]:
    """The tests of the alternatives of each recording; those of one suspect belong together."""
    every = _extended(fit, patterns)
    return [_score(fit, every, suspect) for suspect in every.where]


def _extended(fit: LinearisedFit, patterns: Sequence[Sequence[Alternative]]) -> _Extended:
    where: dict[Suspect, slice] = {}
    count = 0
    for one in (d for recording in patterns for d in recording):
        if one.suspect not in where:
            where[one.suspect] = slice(count, count + one.pattern.shape[-1])
            count += one.pattern.shape[-1]
    bb, bx, g = np.zeros((count, count)), np.zeros((count, fit.problem.layout.size)), np.zeros(count)
    whole = []
    for i, (recording, rows, known) in enumerate(zip(fit.problem.recordings, fit.rows, fit.known, strict=True)):
        noise = fit.optimum.hyperparameters.noise[i]
        d = np.zeros((*rows.r.shape, count))
        for one in patterns[i]:
            d[..., where[one.suspect]] = rows.root_weight[..., None] * whitened(recording.whiten, one.pattern)
        unexplained = d - rows.a @ (force_shrinkage(rows, noise) @ (np.swapaxes(rows.a, 1, 2) @ d))
        weighted = unexplained.reshape(-1, count) / noise.marker**2
        bb += weighted.T @ d.reshape(-1, count)
        bx[:, known] += weighted.T @ rows.slopes.written.reshape(-1, len(known))
        g += weighted.T @ rows.r.ravel()
        whole.append(d)
    marginal = bb - bx @ fit.covariance @ bx.T
    return _Extended(where, tuple(whole), np.diag(bb).copy(), bx, marginal, g - bx @ fit.step)


def _score(fit: LinearisedFit, every: _Extended, suspect: Suspect) -> Score:
    part, p = every.where[suspect], fit.problem.layout.spline.count
    size = np.sqrt(np.maximum(every.information[part], 1e-300))
    scaled = every.marginal[part, part] / np.outer(size, size)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    visible = values > _BLIND
    count = int(np.sum(visible))
    if count == 0:
        unknown = np.full(len(size), np.nan)
        return Score(suspect, unknown, unknown, 0.0, 0.0, 0.0, np.zeros(p))
    inverse = (vectors[:, visible] / values[visible]) @ vectors[:, visible].T / np.outer(size, size)
    b = inverse @ every.score[part]
    chi2 = float(every.score[part] @ b)
    step = -fit.covariance @ (every.mixed[part].T @ b)
    log10_p = float(_distributions().chi2.logsf(chi2, count)) / np.log(10.0)
    recordings = zip(every.d, fit.rows, fit.known, strict=True)
    changes = [d[..., part] @ b + r.slopes.times(step[k]) for d, r, k in recordings]
    ratio = 1.0
    if log10_p < _NEW_NOISE:
        ratio, numbers = _noise_left(fit, changes)
        chi2 *= ratio
        freedom = max(numbers - len(b), 5.0)
        log10_p = float(_distributions().f.logsf(chi2 / count, count, freedom)) / np.log(10.0)
    moved = max(_moved(f, r, c) for f, r, c in zip(fit.problem.recordings, fit.rows, changes, strict=True))
    sd = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    return Score(suspect, b, sd, chi2, log10_p, moved, step[:p], max(ratio, 1.0))


def _noise_left(fit: LinearisedFit, changes: Sequence[Array]) -> tuple[float, float]:
    """Variance of the noise that the fit found over that which is left after the changes (F, R) of the residuals,
    correlation in time included; and how many independent numbers are left.

    Afterwards the coordinate with the longest correlation counts: otherwise an alternative that is smooth in time would
    pass for signal where the noise of one tag is slow and that of the others is not.
    """
    before, after, numbers = 0.0, 0.0, 0.0
    for rows, known, change, noise in zip(fit.rows, fit.known, changes, fit.optimum.hyperparameters.noise, strict=True):
        plain = rows.r - rows.slopes.times(fit.step[known])
        old, new = (split_off_force(rows, r, noise)[0] for r in (plain, plain - change))
        time = max(correlation_time(column[:, None]) for column in new.T)
        before += float(np.sum(old**2)) * correlation_time(old)
        after += float(np.sum(new**2)) * time
        numbers += float(np.sum(rows.known)) / time
    return before / max(after, 1e-300), numbers


def _moved(recording: FitData, rows: ResidualRows, change: Array) -> float:
    """m: RMS over the frames of the tag that a change (F, R) of the whitened poses moves most."""
    weight = np.where(rows.root_weight > 0.0, rows.root_weight, 1.0)
    away = unwhitened(recording.whiten, change / weight)[..., :2]
    known = np.any(rows.known.reshape(len(away), -1, 3), axis=-1)  # a pose may lack its angle, or a coordinate
    squares = np.sum(away**2, axis=-1)
    return float(np.sqrt(np.max(np.sum(squares, axis=0) / np.maximum(np.sum(known, axis=0), 1))))


def _distributions() -> Any:
    """`scipy.stats`. It takes half a second to load, and commands that only read a fit's results do not need it."""
    from scipy import stats

    return stats
