"""Score tests: would freeing a few more numbers lower the misfit by more than chance does?

The linearised model at the optimum is `r = J x + D b + noise` with the priors on x, all scales as the fit chose them.
With x integrated out, b has the information `C^-1 = H_bb - H_bx (H_xx + P)^-1 H_xb`, the estimate `C g` from the score
g, and `g' C g` is chi-squared with as many degrees of freedom as b has numbers, if the model is right (Rao 1948).
A misfit that lasts has raised the noise that the fit found. So the noise is taken as what is left once b is free, its
correlation in time included, and F takes the place of chi-squared, with the count of numbers that this correlation
leaves. For a parameter that the model has under a prior, freeing it is the same as asking whether the prior is wrong:
`x' (prior - posterior covariance)^-1 x` is chi-squared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi_squared
from scipy.stats import f as f_distribution

from onebend.learning.criticism.alternatives import Departure, Suspect
from onebend.learning.inference.hyperparameters import correlation_time
from onebend.learning.inference.linear_gaussian import (
    Rows,
    prior,
    quadratic,
    rest_quadratic,
    rows_of,
    shrink,
    split,
    together,
)
from onebend.learning.inference.optimizer import Optimum
from onebend.learning.model.fit_data import Film
from onebend.learning.model.parameters import Layout
from onebend.records import Array, IntArray

_BLIND = 1e-8  # of the information on b: what is left where the model's own parameters do the same
_TOLD = 0.05  # of the prior variance: what the data must have taken away for a pull to be judged
_WORTH = -2.0  # log10 of chi-squared's p: above it the noise is not looked at anew


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
class Linear:
    """The linearised model at the optimum of several films."""

    films: tuple[Film, ...]
    at: Layout
    optimum: Optimum
    rows: tuple[Rows, ...]
    known: tuple[IntArray, ...]  # indices of the parameters that each film knows
    covariance: Array  # (P, P) at the optimum's scales
    step: Array  # (P,) to where the slope is zero


def linear(films: Sequence[Film], at: Layout, optimum: Optimum, level: float) -> Linear:
    """Rows, covariance and the step that the search left undone; `level`: prior mean of log k."""
    own, best = list(films), optimum.x
    every = list(zip(own, optimum.predictions, optimum.scales.films, strict=True))
    rows = tuple(rows_of(p, n) for _, p, n in every)
    data = [quadratic(r, at, f.number, best, n) for r, (f, _, n) in zip(rows, every, strict=True)]
    total = together([*data, rest_quadratic(own, at)])
    precision, mean, _ = prior(own, at, level, optimum.scales)
    covariance = np.linalg.inv(total.information + precision)
    covariance = 0.5 * (covariance + covariance.T)
    step = covariance @ (total.b - total.information @ best - precision @ (best - mean))
    return Linear(tuple(own), at, optimum, rows, tuple(at.known_to(f.number) for f in own), covariance, step)


def pulls(line: Linear) -> list[Score]:
    """How far the nuisances came out from their priors: tags one by one, the parts of other blocks together.

    Directions of which the data say nothing are left out. Place and direction of the push are among the departures.
    """
    out = []
    for block in line.at.blocks:
        if block.start < 0 or block.name in ("stiffness", "force", "place", "direction", "end", "end turn"):
            continue
        whose = "" if block.recording < 0 else line.films[block.recording].observations.source.name
        tags = line.films[0].observations.tag_id.tolist() if block.name in ("along", "across", "turn") else [-1]
        for i, tag in enumerate(tags):
            own = np.array([i]) if tag >= 0 else np.arange(len(block.labels))
            suspect = Suspect("prior", block.name, tag, whose)
            out.append(_pull(line, suspect, block.start + own, block.prior_sd[own], block.unit))
    return out


def _pull(line: Linear, suspect: Suspect, index: IntArray, before: Array, unit: str) -> Score:
    x = line.optimum.x[index]
    told = np.eye(len(index)) - line.covariance[np.ix_(index, index)] / np.outer(before, before)
    values, vectors = np.linalg.eigh(0.5 * (told + told.T))
    seen = values > _TOLD
    freed = vectors[:, seen] @ ((vectors[:, seen].T @ (x / before)) / values[seen])  # in prior sds
    gain, count = float(freed @ (x / before)), int(np.sum(seen))
    log10_p = float(chi_squared.logsf(gain, count)) / np.log(10.0) if count else 0.0
    shift = line.covariance[: line.at.spline.count, index] @ (freed / before)
    size = float(np.linalg.norm(x)) if unit == "m" else 0.0
    return Score(suspect, before * freed if count else np.full(len(x), np.nan), before, gain, log10_p, size, shift)


@dataclass(frozen=True)
class _Extended:
    """The information on all departures' numbers, B together."""

    where: dict[Suspect, slice]
    d: tuple[Array, ...]  # (F, R, B) of each film, whitened
    information: Array  # (B,) of each number alone
    mixed: Array  # (B, P)
    left: Array  # (B, B) with the parameters integrated out
    score: Array  # (B,)


def scores(line: Linear, patterns: Sequence[Sequence[Departure]]) -> list[Score]:
    """The tests of the departures of each film; those of one suspect belong together."""
    every = _extended(line, patterns)
    return [_score(line, every, suspect) for suspect in every.where]


def _extended(line: Linear, patterns: Sequence[Sequence[Departure]]) -> _Extended:
    where: dict[Suspect, slice] = {}
    count = 0
    for one in (d for film in patterns for d in film):
        if one.suspect not in where:
            where[one.suspect] = slice(count, count + one.pattern.shape[-1])
            count += one.pattern.shape[-1]
    bb, bx, g = np.zeros((count, count)), np.zeros((count, line.at.size)), np.zeros(count)
    whole = []
    for i, (seen, rows, known) in enumerate(zip(line.films, line.rows, line.known, strict=True)):
        noise = line.optimum.scales.films[i]
        d = np.zeros((*rows.r.shape, count))
        for one in patterns[i]:
            flat = (seen.whiten @ one.pattern).reshape(*rows.r.shape, -1)
            d[..., where[one.suspect]] = rows.root_weight[..., None] * flat
        across = d - rows.a @ (shrink(rows, noise) @ (np.swapaxes(rows.a, 1, 2) @ d))
        weighted = across.reshape(-1, count) / noise.marker**2
        bb += weighted.T @ d.reshape(-1, count)
        bx[:, known] += weighted.T @ rows.slopes.written.reshape(-1, len(known))
        g += weighted.T @ rows.r.ravel()
        whole.append(d)
    left = bb - bx @ line.covariance @ bx.T
    return _Extended(where, tuple(whole), np.diag(bb).copy(), bx, left, g - bx @ line.step)


def _score(line: Linear, every: _Extended, suspect: Suspect) -> Score:
    part, p = every.where[suspect], line.at.spline.count
    size = np.sqrt(np.maximum(every.information[part], 1e-300))
    scaled = every.left[part, part] / np.outer(size, size)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    seen = values > _BLIND
    count = int(np.sum(seen))
    if count == 0:
        unknown = np.full(len(size), np.nan)
        return Score(suspect, unknown, unknown, 0.0, 0.0, 0.0, np.zeros(p))
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T / np.outer(size, size)
    b = inverse @ every.score[part]
    chi2 = float(every.score[part] @ b)
    step = -line.covariance @ (every.mixed[part].T @ b)
    log10_p = float(chi_squared.logsf(chi2, count)) / np.log(10.0)
    films = zip(every.d, line.rows, line.known, strict=True)
    changes = [d[..., part] @ b + r.slopes.times(step[k]) for d, r, k in films]
    ratio = 1.0
    if log10_p < _WORTH:
        ratio, numbers = _noise_left(line, changes)
        chi2 *= ratio
        freedom = max(numbers - len(b), 5.0)
        log10_p = float(f_distribution.logsf(chi2 / count, count, freedom)) / np.log(10.0)
    moved = max(_moved(f, r, c) for f, r, c in zip(line.films, line.rows, changes, strict=True))
    sd = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    return Score(suspect, b, sd, chi2, log10_p, moved, step[:p], max(ratio, 1.0))


def _noise_left(line: Linear, changes: Sequence[Array]) -> tuple[float, float]:
    """Variance of the noise that the fit found over that which is left after the changes (F, R) of the residuals,
    correlation in time included; and how many independent numbers are left.

    Afterwards the coordinate with the longest correlation counts: a departure that is smooth in time would else pass
    for signal where one tag's noise is slow and the others' is not.
    """
    before, after, numbers = 0.0, 0.0, 0.0
    for rows, known, change, noise in zip(line.rows, line.known, changes, line.optimum.scales.films, strict=True):
        plain = rows.r - rows.slopes.times(line.step[known])
        old, new = (split(rows, r, noise)[0] for r in (plain, plain - change))
        time = max(correlation_time(column[:, None]) for column in new.T)
        before += float(np.sum(old**2)) * correlation_time(old)
        after += float(np.sum(new**2)) * time
        numbers += float(np.sum(rows.known)) / time
    return before / max(after, 1e-300), numbers


def _moved(seen: Film, rows: Rows, change: Array) -> float:
    """m: RMS over the frames of the tag that a change (F, R) of the whitened poses moves most."""
    weight = np.where(rows.root_weight > 0.0, rows.root_weight, 1.0)
    there = np.any(seen.whiten != 0.0, axis=-1)  # (F, m, 3): a pose may lack its angle, or a coordinate
    safe = seen.whiten + ~there[..., None] * np.eye(3)
    away = np.linalg.solve(safe, (change / weight).reshape(*there.shape, 1))[..., :2, 0]
    squares, known = np.sum(np.where(there[..., :2], away, 0.0) ** 2, axis=-1), np.any(there, axis=-1)
    return float(np.sqrt(np.max(np.sum(squares, axis=0) / np.maximum(np.sum(known, axis=0), 1))))
