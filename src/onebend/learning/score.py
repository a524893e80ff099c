"""Score tests: would freeing a few more numbers lower the misfit by more than chance does?

The linearised model at the optimum, `r = J x + D b + noise` with the priors on x, all scales as the fit chose them. With
x integrated out b has the information `C^-1 = H_bb - H_bx (H_xx + P)^-1 H_xb`, the estimate `C g` from the score g, and
`g' C g` is chi-squared with as many degrees of freedom as b has numbers, if the model is right (Rao's score test).
A misfit that lasts has raised the noise that the fit found; so the noise is taken as what is left once b is free, with
its correlation in time, and F takes the place of chi-squared, with the count of frames that this correlation leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2 as chi_squared
from scipy.stats import f as f_distribution

from onebend.learning.departures import Departure
from onebend.learning.forward import Film
from onebend.learning.gauss_newton import Rows, prior, quadratic, rest_quadratic, rows_of, shrink, split, together
from onebend.learning.posterior import Posterior
from onebend.learning.scales import correlation_time
from onebend.records import Array

_BLIND = 1e-8  # of the information on b: what is left where the model's own parameters do the same
_TOLD = 0.05  # of the prior variance: what the data must have taken away for a pull to be judged


@dataclass(frozen=True)
class Score:
    """One test."""

    key: str
    b: Array  # (n,) estimate; NaN where the model's own parameters can do the same
    sd: Array  # (n,)
    chi2: float  # under the noise that the fit found
    gain: float  # the same under the noise that is left
    size: float  # m, RMS over the frames of what it moves the tag that it moves most, the rest refitted
    log10_p: float  # log10 of the probability of as large a statistic, the model being right


@dataclass(frozen=True)
class Linear:
    """The linearised model at the optimum."""

    rows: tuple[Rows, ...]
    known: tuple[Array, ...]  # indices of the parameters that each film knows
    slope: Array  # (P,) of the log posterior: zero at a perfect optimum
    covariance: Array  # (P, P) at the optimum's scales


def linear(posterior: Posterior) -> Linear:
    """Rows, what is left of the slope, and the covariance at fixed scales."""
    films, at, best = list(posterior.films), posterior.at, posterior.optimum
    every = list(zip(films, best.predictions, best.scales.films, strict=True))
    rows = tuple(rows_of(f, at, best.x, p, n) for f, p, n in every)
    data = [quadratic(r, at, f.number, best.x, n) for r, (f, _, n) in zip(rows, every, strict=True)]
    total = together([*data, rest_quadratic(films, at)])
    precision, mean, _ = prior(films, at, posterior.level, best.scales)
    slope = total.b - total.information @ best.x - precision @ (best.x - mean)
    covariance = np.linalg.inv(total.information + precision)
    return Linear(rows, tuple(at.known_to(f.number) for f in films), slope, 0.5 * (covariance + covariance.T))


def scores(posterior: Posterior, patterns: Sequence[Sequence[Departure]]) -> list[Score]:
    """The tests of the departures of every film; those of one key belong together."""
    line = linear(posterior)
    where: dict[str, slice] = {}
    count = 0
    for one in (d for film in patterns for d in film):
        if one.key not in where:
            where[one.key] = slice(count, count + one.pattern.shape[-1])
            count += one.pattern.shape[-1]
    bb, bx, g = np.zeros((count, count)), np.zeros((count, posterior.at.size)), np.zeros(count)
    whole = []
    for seen, rows, known, noise, own in zip(
        posterior.films, line.rows, line.known, posterior.optimum.scales.films, patterns, strict=True
    ):
        d = np.zeros((*rows.r.shape, count))
        for one in own:
            d[..., where[one.key]] = _whitened(seen, rows, one.pattern)
        across = d - rows.a @ (shrink(rows, noise) @ (np.swapaxes(rows.a, 1, 2) @ d))
        flat = across.reshape(-1, count) / noise.marker**2
        bb += flat.T @ d.reshape(-1, count)
        bx[:, known] += flat.T @ rows.j.reshape(-1, len(known))
        g += flat.T @ rows.r.ravel()
        whole.append(d)
    g = g - bx @ (line.covariance @ line.slope)
    left = bb - bx @ line.covariance @ bx.T
    return [_score(posterior, line, whole, key, part, (bb, bx, g, left)) for key, part in where.items()]


def _score(
    posterior: Posterior, line: Linear, whole: list[Array], key: str, part: slice, of: tuple[Array, Array, Array, Array]
) -> Score:
    bb, bx, g, left = of
    n = part.stop - part.start
    size = np.sqrt(np.maximum(np.diag(bb)[part], 1e-300))
    scaled = left[part, part] / np.outer(size, size)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    seen = values > _BLIND
    count = int(np.sum(seen))
    if count == 0:
        nothing = np.full(n, np.nan)
        return Score(key, nothing, nothing, 0.0, 0.0, 0.0, 0.0)
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T / np.outer(size, size)
    b = inverse @ g[part]
    chi2 = float(g[part] @ b)
    dx = line.covariance @ (line.slope - bx[part].T @ b)
    dx0 = line.covariance @ line.slope
    before, after, frames, moved = 0.0, 0.0, 0.0, 0.0
    for seen_film, rows, known, noise, d in zip(
        posterior.films, line.rows, line.known, posterior.optimum.scales.films, whole, strict=True
    ):
        change = np.einsum("frn,n->fr", d[..., part], b) + rows.j @ (dx - dx0)[known]
        plain = rows.r - rows.j @ dx0[known]
        old, new = (split(rows, r, noise)[0] for r in (plain, plain - change))
        time_old, time_new = correlation_time(old), correlation_time(new)
        before += float(np.sum(old**2)) * time_old / noise.marker**2
        after += float(np.sum(new**2)) * time_new / noise.marker**2
        frames += float(np.sum(rows.known)) / time_new
        moved = max(moved, _moved(seen_film, rows, change))
    ratio = before / max(after, 1e-300)
    freedom = max(frames - n, 5.0)
    gain = chi2 * max(ratio, 1.0)
    log10_p = float(f_distribution.logsf(gain / count, count, freedom)) / np.log(10.0)
    return Score(key, b, np.sqrt(np.maximum(np.diag(inverse), 0.0)), chi2, gain, moved, log10_p)


def _whitened(seen: Film, rows: Rows, pattern: Array) -> Array:
    """(F, R, n) as the rows are."""
    flat = (seen.whiten @ pattern).reshape(len(pattern), -1, pattern.shape[-1])
    return np.asarray(rows.root_weight[..., None] * flat)


def _moved(seen: Film, rows: Rows, change: Array) -> float:
    """m: RMS over frames of the tag that a whitened change (F, R) moves most."""
    weight = np.where(rows.root_weight > 0.0, rows.root_weight, 1.0)
    plain = (change / weight).reshape(len(change), -1, 3)
    known = np.any(seen.whiten != 0.0, axis=(-1, -2))
    safe = np.where(known[..., None, None], seen.whiten, np.eye(3))
    away = np.linalg.solve(safe, plain[..., None])[..., 0]
    squares = np.sum(np.where(known[..., None], away, 0.0)[..., :2] ** 2, axis=-1)
    return float(np.sqrt(np.max(np.sum(squares, axis=0) / np.maximum(np.sum(known, axis=0), 1))))


def pulls(posterior: Posterior, line: Linear) -> list[Score]:
    """How far the nuisances came out from their priors: `x' (prior - posterior covariance)^-1 x` is chi-squared.

    Directions of which the data say nothing are left out. Tags one by one; the parts of other blocks together.
    """
    out = []
    for block in posterior.at.blocks:
        if block.start < 0 or block.name in ("stiffness", "force"):
            continue
        single = block.name in ("along", "across", "turn")
        groups = [[i] for i in range(len(block.labels))] if single else [list(range(len(block.labels)))]
        for group in groups:
            index = block.start + np.array(group)
            x, before = posterior.mean[index], block.prior_sd[group]
            told = np.eye(len(group)) - line.covariance[np.ix_(index, index)] / np.outer(before, before)
            values, vectors = np.linalg.eigh(told)
            seen = values > _TOLD
            along = vectors[:, seen].T @ (x / before)
            chi2, count = float(np.sum(along**2 / values[seen])), int(np.sum(seen))
            log10_p = float(chi_squared.logsf(chi2, count)) / np.log(10.0) if count else 0.0
            key = block.labels[group[0]] if single else block.labels[0].rsplit(" ", 1)[0] if len(group) > 1 else block.labels[0]
            length = float(np.max(np.abs(x))) if block.unit == "m" else np.nan
            out.append(Score(key, x, before, chi2, chi2, length, log10_p))
    return out
