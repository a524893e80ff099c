"""The search for the optimum: Gauss-Newton at fixed scales, scales at fixed shapes, from coarse noise to fine."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.errors import LearningError
from onebend.learning.inference.hyperparameters import Known, averaged, choose_scales, new_noise
from onebend.learning.inference.linear_gaussian import (
    FilmNoise,
    Quadratic,
    Rows,
    Scales,
    prior,
    quadratic,
    residuals,
    rest_quadratic,
    rows_of,
    split,
    together,
)
from onebend.learning.model.fit_data import Film
from onebend.learning.model.forward import Prediction, predict
from onebend.learning.model.parameters import Layout
from onebend.progress import Progress
from onebend.records import Array

_HELD = 1e-5  # of log k: held in its place
_STEADY = 0.1  # of the log of a film's noise from round to round


@dataclass(frozen=True)
class Effort:
    """How hard to search."""

    most_steps: int = 60
    coarse_rounds: int = 3  # far from the optimum the markers' fine print misleads
    rounds: int = 6  # at most; each ends with new scales, until the noise is steady
    on_the_way: float = 0.3  # as `tolerance`, in all rounds but the last
    tolerance: float = 0.02  # expected gain of the last step, as a share of one sd


@dataclass(frozen=True)
class Found:
    """Where the search ended."""

    x: Array  # (P,) the most probable parameters under `scales`
    scales: Scales
    predictions: tuple[Prediction, ...]
    steps: int
    converged: bool


@dataclass(frozen=True)
class Optimum:
    """The posterior, and why the search ended."""

    x: Array  # (P,) log k's mean, its scales averaged over, and what is most probable with it
    covariance: Array  # (P, P)
    jumps: Array  # (p - 1,) mean steps of log k from coefficient to coefficient, what is smooth apart
    shape: Array  # (levels, S) of the bands of log k, see `UncertainStiffness`
    scales: Scales
    predictions: tuple[Prediction, ...]
    log_evidence: float
    steps: int
    converged: bool
    stopped: str


def search(
    films: list[Film],
    at: Layout,
    x: Array,
    level: float,
    scales: Scales,
    expected: Scales,
    effort: Effort,
    progress: Progress,
    shapes: list[Array] | None = None,
) -> Found:
    """From parameters x and scales to the maximum a posteriori; `level`: prior mean of log k; `shapes`: (F, Q) of each
    film at x, where they are known.

    Raises:
        LearningError: the start has no equilibrium under the measured forces.
    """
    steps, converged, steady = 0, False, False
    begin: list[Array | None] = [None] * len(films) if shapes is None else [*shapes]
    now = [predict(seen, at, x, q) for seen, q in zip(films, begin, strict=True)]
    if not all(np.all(p.solved.converged) for p in now):
        raise LearningError(
            "the start stiffness lets the beam snap through under the measured forces; start from a stiffer beam"
        )
    for round_number in range(effort.rounds):
        last = steady or round_number == effort.rounds - 1
        if round_number < effort.coarse_rounds:
            size = [float(np.sqrt(np.mean(residuals(p) ** 2))) for p in now]
            coarse = tuple(replace(n, marker=max(s, 1.5)) for n, s in zip(expected.films, size, strict=True))
            scales = replace(expected, films=coarse)
        most, tolerance = (effort.most_steps, effort.tolerance) if last else (20, effort.on_the_way)
        x, now, taken, converged = _descend(films, at, x, now, level, scales, most, tolerance)
        steps += taken
        rows = [rows_of(p, n) for p, n in zip(now, scales.films, strict=True)]
        progress.advance()
        if last:
            break
        if round_number >= effort.coarse_rounds - 1:
            before, scales = scales, _new_scales(films, at, rows, x, level, scales, expected)
            steady = round_number >= effort.coarse_rounds and _alike(before, scales)
    return Found(x, scales, tuple(now), steps, converged)


def conclude(films: list[Film], at: Layout, found: Found, level: float, expected: Scales, effort: Effort) -> Optimum:
    """The posterior around where the search ended, what the scales leave open included."""
    scales, now = found.scales, found.predictions
    rows = [rows_of(p, n) for p, n in zip(now, scales.films, strict=True)]
    known = Known(_data(films, at, rows, found.x, scales), films, at, level, expected)
    of_k, covariance = averaged(known, scales)
    x, now = _settled(films, at, found, of_k.mean, covariance)
    return Optimum(
        x=x,
        covariance=covariance,
        jumps=of_k.steps,
        shape=of_k.shape,
        scales=scales,
        predictions=now,
        log_evidence=known.solve(scales)[1],
        steps=found.steps,
        converged=found.converged,
        stopped=f"the last step was worth less than {effort.tolerance:g} of a sd"
        if found.converged
        else f"{effort.most_steps} steps were not enough",
    )


def _settled(
    films: list[Film], at: Layout, found: Found, k: Array, covariance: Array
) -> tuple[Array, tuple[Prediction, ...]]:
    """All else where the tags want it with log k's coefficients at k (p,); as found where the beam would not stand."""
    p, parts = at.spline.count, found.scales.parts
    x = found.x + np.linalg.solve(covariance[:p, :p], covariance[:p]).T @ (k - found.x[:p])
    now = [predict(f, at, x, one.solved.q, one.own) for f, one in zip(films, found.predictions, strict=True)]
    if not all(np.all(one.solved.converged) for one in now):
        return found.x, found.predictions
    held = replace(found.scales, parts=np.full_like(parts, _HELD**2))
    x, now, _, _ = _descend(films, at, x, now, k, held, 10, 0.1)
    return x, tuple(now)


def _alike(before: Scales, after: Scales) -> bool:
    """Whether the tags' noise has come to rest: what the beam could not follow yet counts as noise."""
    pairs = zip(before.films, after.films, strict=True)
    return all(abs(np.log(b.marker / a.marker)) < _STEADY for b, a in pairs)


def _new_scales(
    films: list[Film], at: Layout, rows: list[Rows], x: Array, level: float, scales: Scales, expected: Scales
) -> Scales:
    """Noise of every film from its residuals, then the evidence's choice of the rest."""
    every = zip(films, rows, scales.films, strict=True)
    said = [quadratic(r, at, f.number, x, noise) for f, r, noise in every]
    precision, _, _ = prior(films, at, level, scales)
    left = np.linalg.inv(together([*said, rest_quadratic(films, at)]).information + precision)
    spent = [float(np.sum(left * one.information)) for one in said]  # parameters that each film's tags settled
    noise = tuple(new_noise(*every) for every in zip(films, rows, scales.films, spent, strict=True))
    scales = replace(scales, films=noise)
    return choose_scales(Known(_data(films, at, rows, x, scales), films, at, level, expected), scales)


def _data(films: list[Film], at: Layout, rows: list[Rows], x: Array, scales: Scales) -> Quadratic:
    """What all films' tags and rests say."""
    every = zip(films, rows, scales.films, strict=True)
    tags = [quadratic(r, at, f.number, x, noise) for f, r, noise in every]
    return together([*tags, rest_quadratic(films, at)])


def _descend(
    films: list[Film],
    at: Layout,
    x: Array,
    now: list[Prediction],
    level: float | Array,
    scales: Scales,
    most: int,
    tolerance: float,
) -> tuple[Array, list[Prediction], int, bool]:
    """Levenberg-Marquardt at fixed scales; weights and frames' covariances are renewed at every step."""
    precision, mean, _ = prior(films, at, level, scales)
    rests = rest_quadratic(films, at)
    damping = 1e-4

    def cost(rows: list[Rows], shapes: list[Prediction], at_x: Array) -> float:
        if not all(np.all(p.solved.converged) for p in shapes):
            return np.inf
        every = zip(rows, shapes, scales.films, strict=True)
        tags = sum(_misfit(r.root_weight * residuals(p), p.own, noise) for r, p, noise in every)
        away = at_x - mean
        return float(tags + away @ precision @ away + at_x @ rests.information @ at_x - 2.0 * rests.b @ at_x)

    for step_number in range(1, most + 1):
        rows = [rows_of(p, n) for p, n in zip(now, scales.films, strict=True)]
        data = _data(films, at, rows, x, scales)
        hessian = data.information + precision
        slope = data.b - data.information @ x - precision @ (x - mean)
        diagonal, before = np.diag(hessian), cost(rows, now, x)
        while True:
            step = np.linalg.solve(hessian + damping * np.diag(diagonal), slope)
            tried = x + step * min(1.0, 1.5 / max(float(np.max(np.abs(step[: at.spline.count]))), 1e-300))
            every = zip(rows, now, scales.films, strict=True)
            forces = [_own(r, p, noise, tried - x, damping) for r, p, noise in every]
            there = [predict(f, at, tried, p.solved.q, own) for f, p, own in zip(films, now, forces, strict=True)]
            if cost(rows, there, tried) <= before + 1e-6:
                break
            damping *= 8.0
            if damping > 1e9:
                return x, now, step_number, False
        decrease = float(step @ slope)  # twice the cost's expected decrease, in units of one sd squared
        x, now, damping = tried, there, max(damping / 16.0, 1e-12)
        if decrease < tolerance**2:
            return x, now, step_number, True
    return x, now, most, False


def _misfit(left: Array, own: Array, noise: FilmNoise) -> float:
    """Minus twice the log probability of what is left of the tags (F, R), and of the frames' own forces (F, 2)."""
    return float(np.sum(left**2)) / noise.marker**2 + float(np.sum(own**2)) / noise.force**2


def _own(rows: Rows, now: Prediction, noise: FilmNoise, step: Array, damping: float) -> Array:
    """(F, 2) N: each frame's own force after a step of the parameters, to first order the most probable one."""
    best = split(rows, rows.r - rows.slopes.times(step[now.at.known_to(now.seen.number)]), noise)[1]
    return np.asarray(now.own + (best - now.own) / (1.0 + damping))
