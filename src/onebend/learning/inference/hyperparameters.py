"""The sizes that the data choose: noise of the tags, noise of the force, roughness of log k.

A film's noise comes from its residuals by expectation-maximisation. The sizes of the force's error are chosen by the
evidence of the linearised model under broad log-normal priors, and what they leave open widens the covariance of the
parameters: it is averaged over scales as probable as the evidence says (a cubature of degree three around its
maximum). The sizes in log k's prior are drawn from their posterior (`stiffness_prior.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.optimize import minimize

from onebend.learning.inference.linear_gaussian import (
    FilmNoise,
    Quadratic,
    Rows,
    Scales,
    prior,
    shrink,
    split,
)
from onebend.learning.inference.stiffness_prior import Draws, Mixed, Told, drawn_parts, mixed
from onebend.learning.model.fit_data import Film
from onebend.learning.model.force_error import ForceError
from onebend.learning.model.parameters import Layout
from onebend.records import Array

CHOSEN = ("coloured", "memory", "walk", "load")
# One sd of their logs. The coloured noise behind the filter is known to a factor of two in size and two and a half in
# correlation time (the clock search takes part of the force for it); the walk, of which one push is one draw, to a
# factor of three; what comes with the load to a factor of three.
SPREAD = np.array([0.7, 0.9, 1.1, 1.2])
_MOST = 4.0
_GUESS_COUNTS = 3.0
_CENTRE = 0.25  # share of the node in the middle
_ON_THE_WAY = Draws(chains=12, burn=15, kept=25)
_AT_THE_END = Draws(chains=4, burn=20, kept=60)  # for each of the scales that are averaged over
# Of what the tags' covariances say: no noise is taken as smaller. Markers that fit better are made by a simulator, and
# below this the solver's own error (1e-8 L) would have to be fitted.
_LEAST = 0.02


@dataclass(frozen=True)
class Known:
    """All that the evidence for scales is computed from."""

    data: Quadratic  # what tags and rests say
    films: list[Film]
    at: Layout
    level: float  # prior mean of log k
    expected: Scales

    def told(self, scales: Scales, weight: float = 1.0) -> Told:
        """What is known of log k beside its prior, all else being integrated out."""
        precision, mean, _ = prior(self.films, self.at, self.level, scales)
        p, right = self.at.spline.count, self.data.b.copy()
        right[p:] += precision[p:, p:] @ mean[p:]
        across = self.data.information[p:, :p]
        less = np.linalg.solve(self.data.information[p:, p:] + precision[p:, p:], across)
        return Told(
            self.data.information[:p, :p] - across.T @ less + self.at.evenness, right[:p] - less.T @ right[p:], weight
        )

    def solve(self, scales: Scales) -> tuple[Array, float, tuple[Array, bool]]:
        """Most probable parameters, log evidence (but for a constant), and the factor of their precision (scipy's)."""
        precision, mean, log_det = prior(self.films, self.at, self.level, scales)
        data = self.data
        factor = cho_factor(data.information + precision, lower=True)
        right = data.b + precision @ mean
        best = cho_solve(factor, right)
        away = data.c - right @ best + mean @ precision @ mean
        ratio = log_det - 2.0 * np.sum(np.log(np.diag(factor[0])))
        return best, float(0.5 * ratio - 0.5 * away - data.log_noise), factor

    def scaled(self, start: Scales, z: Array) -> Scales:
        """Scales z (4,) sd from what was expected."""
        logs = np.log(_chosen(self.expected)) + SPREAD * np.clip(z, -_MOST, _MOST)
        return replace(start, **dict(zip(CHOSEN, np.exp(logs).tolist(), strict=True)))

    def cost(self, start: Scales) -> Callable[[Array], float]:
        """Minus log posterior of z. All but the force's error is integrated out once.

        With C = L L' its covariance, H and b what is said of it less its mean, `-2 log p` is a constant and
        `log det (I + L' H L) - |(I + L' H L)^-1/2 L' b|^2`.
        """
        axes, information, b, constant = self._of_error(start)

        def of(z: Array) -> float:
            scales = self.scaled(start, z)
            inside, right = information.copy(), b.copy()
            try:
                for error, where in axes:
                    root = np.linalg.cholesky(error.covariance(*(getattr(scales, name) for name in CHOSEN)))
                    for axis in where:
                        inside[:, axis] = inside[:, axis] @ root
                        inside[axis] = root.T @ inside[axis]
                        right[axis] = root.T @ right[axis]
                factor = np.linalg.cholesky(inside + np.eye(len(b)))
            except np.linalg.LinAlgError:
                return 1e12
            explained = np.sum(solve_triangular(factor, right, lower=True, check_finite=False) ** 2)
            return constant + float(0.5 * (z @ z - explained) + np.sum(np.log(np.diag(factor))))

        return of

    def _of_error(self, scales: Scales) -> tuple[list[tuple[ForceError, tuple[slice, slice]]], Array, Array, float]:
        """What is said of the force errors less their means, all else integrated out: for each film where x and y
        stand, the information, its right side, and minus the log of what is left."""
        axes, order, start = [], [], 0
        for block in self.at.blocks:
            if block.name == "force" and block.start >= 0:
                index = np.arange(block.where.start, block.where.stop).reshape(-1, 2)
                order += [index[:, 0], index[:, 1]]
                ends = start, start + len(index), start + index.size
                axes.append((self.films[block.recording].error, (slice(*ends[:2]), slice(*ends[1:]))))
                start = ends[2]
        mine = np.concatenate([np.zeros(0, dtype=np.int64), *order])
        other = np.setdiff1d(np.arange(self.at.size), mine)
        precision, mean, _ = prior(self.films, self.at, self.level, scales)
        data, before = self.data, precision[np.ix_(other, other)]
        right = data.b - data.information @ mean
        across = data.information[np.ix_(other, mine)]
        factor = cho_factor(data.information[np.ix_(other, other)] + before)
        best = cho_solve(factor, right[other])
        left = data.information[np.ix_(mine, mine)] - across.T @ cho_solve(factor, across)
        away = data.c - (data.b + right) @ mean - right[other] @ best
        ratio = np.linalg.slogdet(before)[1] - 2.0 * np.sum(np.log(np.diag(factor[0])))
        return axes, left, right[mine] - across.T @ best, float(0.5 * away - 0.5 * ratio + data.log_noise)

    def place(self, scales: Scales) -> Array:
        """(4,) sd of scales from what was expected."""
        return np.asarray(np.log(_chosen(scales) / _chosen(self.expected)) / SPREAD)


def _chosen(scales: Scales) -> Array:
    return np.array([getattr(scales, name) for name in CHOSEN])


def choose_scales(known: Known, start: Scales) -> Scales:
    """Force-error sizes of greatest evidence, and the prior of log k that its posterior calls for under them."""
    bounds = [(-_MOST, _MOST)] * len(CHOSEN)
    options = {"maxfun": 60, "eps": 1e-3, "ftol": 1e-5, "gtol": 0.03}
    found = minimize(known.cost(start), known.place(start), method="L-BFGS-B", bounds=bounds, options=options)
    chosen = known.scaled(start, found.x)
    told = known.told(chosen)
    parts, chains = drawn_parts(known.at.spline, told, known.level, _ON_THE_WAY, start.chains)
    return replace(chosen, parts=parts, chains=chains)


def averaged(known: Known, scales: Scales) -> tuple[Mixed, Array]:
    """log k and the covariance (P, P) of all parameters, averaged over the scales that the data leave open."""
    nodes, weights = _around(known, scales)
    best = known.solve(scales)[0]
    out = np.zeros((len(best), len(best)))
    for weight, one in zip(weights, nodes, strict=True):
        there, _, factor = known.solve(one)
        out += weight * (cho_solve(factor, np.eye(len(best))) + np.outer(there - best, there - best))
    told = [known.told(one, weight) for weight, one in zip(weights, nodes, strict=True)]
    of_k, p = mixed(known.at.spline, told, known.level, _AT_THE_END, scales.chains), known.at.spline.count
    follow = np.linalg.solve(out[:p, :p], out[:p]).T  # how the rest follows log k
    out = out + follow @ (of_k.covariance - out[:p, :p]) @ follow.T
    return of_k, 0.5 * (out + out.T)


def _around(known: Known, scales: Scales) -> tuple[list[Scales], Array]:
    """Scales of the force's error as probable as the evidence says, and their weights: exact to degree three."""
    middle, cost = known.place(scales), known.cost(scales)
    values, vectors = np.linalg.eigh(_hessian(cost, middle, 0.3))
    sd = 1.0 / np.sqrt(np.maximum(values, 0.5))  # the prior alone has curvature one
    n = len(middle)
    away = np.sqrt(n / (1.0 - _CENTRE))
    offsets = away * np.concatenate([np.zeros((1, n)), (vectors * sd).T, -(vectors * sd).T])
    points = [middle + one for one in offsets]
    normal = 0.5 * away**2 * np.concatenate([[0.0], np.ones(2 * n)])
    shares = np.array([_CENTRE, *[(1.0 - _CENTRE) / (2 * n)] * (2 * n)])
    logs = np.log(shares) - np.array([cost(z) for z in points]) + normal
    weights = np.exp(logs - np.max(logs))
    return [known.scaled(scales, z) for z in points], weights / np.sum(weights)


def _hessian(cost: Callable[[Array], float], at: Array, h: float) -> Array:
    """Second derivatives by central differences."""
    n, e = len(at), h * np.eye(len(at))
    out = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            pairs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
            terms = [a * b * cost(at + a * e[i] + b * e[j]) for a, b in pairs]
            out[i, j] = out[j, i] = sum(terms) / (4.0 * h**2)
    return out


def noise_before(seen: Film) -> FilmNoise:
    """A film's noise before its residuals are known."""
    if seen.observations.static:
        return FilmNoise(1.0, _load_sd(seen))
    return FilmNoise(1.5, 0.5 * seen.error.size)


def new_noise(seen: Film, rows: Rows, before: FilmNoise, spent: float) -> FilmNoise:
    """A film's noise from its residuals.

    That of static poses has no order in time, and their loads' is as it was said. Few points tell little of it: a guess
    counts like a few numbers, and a sd that was said is never taken for smaller.
    """
    if not seen.observations.static:
        return film_noise(rows, before, spent)
    across, _ = split(rows, rows.r, before)
    numbers = float(np.sum(rows.known))
    left = max(numbers - spent, 0.3 * numbers)
    marker = float(np.sqrt((np.sum(rows.r * across) + _GUESS_COUNTS) / (left + _GUESS_COUNTS)))
    return FilmNoise(max(marker, 1.0) if seen.observations.sd_known else marker, _load_sd(seen))


def _load_sd(seen: Film) -> float:
    """N, of a weighed load; next to nothing where it is known exactly."""
    return max(float(np.max(seen.observations.force_sd)), 1e-9)


def film_noise(rows: Rows, before: FilmNoise, spent: float) -> FilmNoise:
    """Noise of a film from its residuals, by expectation-maximisation over the frames' own force errors.

    `spent`: how many parameters the film's tags settled (trace of their information times the covariance).
    """
    numbers = float(np.sum(rows.known))
    share = max(1.0 - spent / max(numbers, 1.0), 0.3)
    noise, by_force, squares = before, rows.by_force(rows.r), float(np.sum(rows.r**2))
    for _ in range(30):
        less = shrink(rows, noise)
        force = np.einsum("fde,fe->fd", less, by_force)
        second = noise.marker**2 * less + force[:, :, None] * force[:, None]  # (F, 2, 2) moments of each frame's force
        left = squares - 2.0 * float(np.sum(force * by_force)) + float(np.sum(second * rows.gram))
        own = np.mean(np.trace(second, axis1=1, axis2=2)) / 2.0
        noise = FilmNoise(float(np.sqrt(max(left / (numbers * share), _LEAST**2))), float(np.sqrt(own)))
    across, force = split(rows, rows.r, noise)
    marker = noise.marker * np.sqrt(correlation_time(across))
    return FilmNoise(float(marker), noise.force * float(np.sqrt(correlation_time(force))))


def correlation_time(r: Array) -> float:
    """`1 + 2 sum rho` of residuals (F, channels) over the lags where the correlation is positive, pooled."""
    z = r - np.mean(r, axis=0)
    spread = np.median(np.abs(z), axis=0) / 0.6745
    z = np.clip(np.divide(z, spread, out=np.zeros_like(z), where=spread > 0.0), -3.0, 3.0)
    power = float(np.sum(z**2))
    total = 1.0
    for lag in range(1, max(len(z) // 8, 2)):
        rho = float(np.sum(z[:-lag] * z[lag:])) / max(power, 1e-12)
        if rho < 0.05:
            break
        total += 2.0 * rho
    return total
