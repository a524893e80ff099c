"""The sizes that the data choose: noise of the tags, noise of the force, and those in the prior of log k.

A recording's noise comes from its residuals by expectation-maximisation. The sizes of the force error are chosen by the
evidence of the linearised model under broad log-normal priors; the covariance of the parameters is averaged over the
values that stay probable (a cubature of degree three around the maximum). The sizes in the prior of log k are drawn
from their posterior (`stiffness_prior.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from onebend.learning.inference.fit_problem import FitProblem, Hyperparameters, RecordingNoise, prior
from onebend.learning.inference.information_form import InformationForm
from onebend.learning.inference.linear_gaussian import (
    LinearPosterior,
    ResidualRows,
    force_shrinkage,
    marginal,
    posterior_of,
    split_off_force,
)
from onebend.learning.inference.stiffness_prior import (
    Draws,
    StiffnessMixture,
    mean_part_variances,
    normal_mixture,
    stiffness_mixture,
)
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.force_error import ForceError
from onebend.records import Array

CHOSEN = ("coloured", "memory", "walk", "load")  # the sizes of the force error
# One sd of their logs. The coloured noise behind the filter is known to a factor of two in size and two and a half in
# correlation time (the clock search takes part of the force for it); the walk, of which one push is one draw, to a
# factor of three; what comes with the load to a factor of three.
SPREAD = np.array([0.7, 0.9, 1.1, 1.2])
_FARTHEST = 4.0  # sd of their logs from what is expected
_GUESS_COUNTS = 3.0  # numbers that the guessed noise of readings counts for
_CENTRE_SHARE = 0.25  # weight of the central node of the cubature
_CURVATURE_STEP = 0.3  # sd of their logs, of the differences that give the evidence's curvature
_LONGEST_LAG = 8  # a correlation time takes lags up to this part (1 / 8) of the frames
_UNCORRELATED = 0.05  # correlation from which on a correlation time is cut off
_ON_THE_WAY = Draws(chains=12, burn=15, kept=25)
_AT_THE_END = Draws(chains=4, burn=20, kept=60)  # for each of the nodes of the cubature
# Of what the tags' covariances say: no noise is taken as smaller. Markers that fit better are made by a simulator, and
# below this the solver's own error (1e-8 L) would have to be fitted.
_LEAST_NOISE = 0.02


@dataclass(frozen=True)
class Evidence:
    """The marginal likelihood of the linearised model as a function of the hyperparameters."""

    problem: FitProblem
    data: InformationForm  # of tags and rests

    def stiffness_form(self, hyperparameters: Hyperparameters, weight: float = 1.0) -> InformationForm:
        """What is known of log k beside its prior, all else integrated out."""
        layout, before = self.problem.layout, prior(self.problem, hyperparameters)
        p = layout.spline.count
        log_k = marginal(self.data, before, np.arange(p), np.arange(p, layout.size))
        return replace(log_k, weight=weight)

    def posterior(self, hyperparameters: Hyperparameters) -> LinearPosterior:
        """Of all parameters, at these hyperparameters."""
        return posterior_of(self.data, prior(self.problem, hyperparameters))

    def hyperparameters_at(self, start: Hyperparameters, z: Array) -> Hyperparameters:
        """Sizes of the force error z (4,) sd from what was expected, all else as at `start`."""
        logs = np.log(_chosen(self.problem.expected)) + SPREAD * np.clip(z, -_FARTHEST, _FARTHEST)
        return replace(start, **dict(zip(CHOSEN, np.exp(logs).tolist(), strict=True)))

    def cost(self, start: Hyperparameters) -> Callable[[Array], float]:
        """Minus log posterior of z. All but the force error is integrated out once.

        With C = L L' its covariance, H and b the information on it and its right side at the mean, `-2 log p` is a
        constant and `log det (I + L' H L) - |(I + L' H L)^-1/2 L' b|^2`.
        """
        axes, information, b, constant = self._of_force_error(start)

        def of(z: Array) -> float:
            sizes = self.hyperparameters_at(start, z)
            inside, right = information.copy(), b.copy()
            try:
                for error, where in axes:
                    root = error.root(*(getattr(sizes, name) for name in CHOSEN))
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

    def _of_force_error(
        self, hyperparameters: Hyperparameters
    ) -> tuple[list[tuple[ForceError, tuple[slice, slice]]], Array, Array, float]:
        """All but the force errors integrated out: where x and y of each recording's error stand, the information on
        them, its right side at their means, and minus the log of the constant factor."""
        problem = self.problem
        axes, order, start = [], [], 0
        for block in problem.layout.blocks:
            if block.name == "force" and block.start >= 0:
                index = np.arange(block.where.start, block.where.stop).reshape(-1, 2)
                order += [index[:, 0], index[:, 1]]
                ends = start, start + len(index), start + index.size
                axes.append((problem.recordings[block.recording].error, (slice(*ends[:2]), slice(*ends[1:]))))
                start = ends[2]
        mine = np.concatenate([np.zeros(0, dtype=np.int64), *order])
        others = np.setdiff1d(np.arange(problem.layout.size), mine)
        before = prior(problem, hyperparameters)
        errors, mean = marginal(self.data, before, mine, others), before.mean[mine]
        right = errors.vector - errors.matrix @ mean
        constant = 0.5 * (errors.constant - (errors.vector + right) @ mean) + errors.log_noise
        return axes, errors.matrix, right, float(constant)

    def place(self, hyperparameters: Hyperparameters) -> Array:
        """(4,) sd of the force error's sizes from what was expected."""
        return np.asarray(np.log(_chosen(hyperparameters) / _chosen(self.problem.expected)) / SPREAD)


def _chosen(hyperparameters: Hyperparameters) -> Array:
    return np.array([getattr(hyperparameters, name) for name in CHOSEN])


def choose_hyperparameters(evidence: Evidence, start: Hyperparameters) -> Hyperparameters:
    """Sizes of the force error of greatest evidence, and the mean prior of log k under them; where its shape is stated,
    that prior stays as it is."""
    bounds = [(-_FARTHEST, _FARTHEST)] * len(CHOSEN)
    options = {"maxfun": 60, "eps": 1e-3, "ftol": 1e-5, "gtol": 0.03}
    result = minimize(evidence.cost(start), evidence.place(start), method="L-BFGS-B", bounds=bounds, options=options)
    chosen, problem = evidence.hyperparameters_at(start, result.x), evidence.problem
    if problem.layout.known is not None:
        return chosen
    spline = problem.layout.spline
    variances, chains = mean_part_variances(
        spline, evidence.stiffness_form(chosen), problem.level, _ON_THE_WAY, start.chains
    )
    return replace(chosen, part_variances=variances, chains=chains)


def averaged_posterior(evidence: Evidence, hyperparameters: Hyperparameters) -> tuple[StiffnessMixture, Array]:
    """log k and the covariance (P, P) of all parameters, averaged over the hyperparameters that the data leave open."""
    nodes, weights = _cubature(evidence, hyperparameters)
    best, problem = evidence.posterior(hyperparameters).mean, evidence.problem
    covariance, mean = np.zeros((len(best), len(best))), np.zeros(len(best))
    for weight, node in zip(weights, nodes, strict=True):
        posterior = evidence.posterior(node)
        mean += weight * posterior.mean
        covariance += weight * (posterior.covariance + np.outer(posterior.mean - best, posterior.mean - best))
    if problem.layout.known is not None:
        return normal_mixture(mean[: problem.layout.spline.count], covariance), 0.5 * (covariance + covariance.T)
    forms = [evidence.stiffness_form(node, weight) for weight, node in zip(weights, nodes, strict=True)]
    spline = problem.layout.spline
    stiffness = stiffness_mixture(spline, forms, problem.level, _AT_THE_END, hyperparameters.chains)
    p = spline.count
    regression = np.linalg.solve(covariance[:p, :p], covariance[:p]).T  # of all parameters on those of log k
    covariance = covariance + regression @ (stiffness.covariance - covariance[:p, :p]) @ regression.T
    return stiffness, 0.5 * (covariance + covariance.T)


def _cubature(evidence: Evidence, hyperparameters: Hyperparameters) -> tuple[list[Hyperparameters], Array]:
    """Nodes over the sizes of the force error, and weights as the evidence says: exact to degree three."""
    middle, cost = evidence.place(hyperparameters), evidence.cost(hyperparameters)
    values, vectors = np.linalg.eigh(_hessian(cost, middle, _CURVATURE_STEP))
    sd = 1.0 / np.sqrt(np.maximum(values, 0.5))  # the prior alone has curvature one
    n = len(middle)
    radius = np.sqrt(n / (1.0 - _CENTRE_SHARE))
    offsets = radius * np.concatenate([np.zeros((1, n)), (vectors * sd).T, -(vectors * sd).T])
    points = [middle + offset for offset in offsets]
    normal = 0.5 * radius**2 * np.concatenate([[0.0], np.ones(2 * n)])
    shares = np.array([_CENTRE_SHARE, *[(1.0 - _CENTRE_SHARE) / (2 * n)] * (2 * n)])
    logs = np.log(shares) - np.array([cost(z) for z in points]) + normal
    weights = np.exp(logs - np.max(logs))
    return [evidence.hyperparameters_at(hyperparameters, z) for z in points], weights / np.sum(weights)


def _hessian(cost: Callable[[Array], float], middle: Array, h: float) -> Array:
    """Second derivatives by central differences."""
    n, e = len(middle), h * np.eye(len(middle))
    out = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            pairs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
            terms = [a * b * cost(middle + a * e[i] + b * e[j]) for a, b in pairs]
            out[i, j] = out[j, i] = sum(terms) / (4.0 * h**2)
    return out


def expected_recording_noise(recording: FitData) -> RecordingNoise:
    """The noise before any residual is known."""
    if recording.observations.static:
        return RecordingNoise(1.0, _load_sd(recording))
    return RecordingNoise(1.5, 0.5 * recording.error.size)


def new_noise(recording: FitData, rows: ResidualRows, before: RecordingNoise, spent: float) -> RecordingNoise:
    """The noise from the residuals.

    Static poses have no order in time, and the sd of their loads is as stated. Few points tell little of the noise, so
    a guessed sd counts for a few numbers, and the noise is never taken as smaller than a stated sd.
    """
    if not recording.observations.static:
        return updated_noise(rows, before, spent)
    unexplained, _ = split_off_force(rows, rows.r, before)
    numbers = float(np.sum(rows.known))
    free = max(numbers - spent, 0.3 * numbers)
    marker = float(np.sqrt((np.sum(rows.r * unexplained) + _GUESS_COUNTS) / (free + _GUESS_COUNTS)))
    return RecordingNoise(max(marker, 1.0) if recording.observations.sd_known else marker, _load_sd(recording))


def _load_sd(recording: FitData) -> float:
    """N, of a weighed load; next to nothing where it is known exactly."""
    return max(float(np.max(recording.observations.force_sd)), 1e-9)


def updated_noise(rows: ResidualRows, before: RecordingNoise, spent: float) -> RecordingNoise:
    """Noise of a recording from its residuals, by expectation-maximisation over the frames' own force errors.

    `spent`: how many parameters the recording's tags settled (trace of their information times the covariance).
    """
    numbers = float(np.sum(rows.known))
    share = max(1.0 - spent / max(numbers, 1.0), 0.3)
    noise, by_force, squares = before, rows.by_force(rows.r), float(np.sum(rows.r**2))
    for _ in range(30):
        shrinkage = force_shrinkage(rows, noise)
        force = np.einsum("fde,fe->fd", shrinkage, by_force)
        moments = noise.marker**2 * shrinkage + force[:, :, None] * force[:, None]  # (F, 2, 2) of each frame's force
        rest = squares - 2.0 * float(np.sum(force * by_force)) + float(np.sum(moments * rows.gram))
        own = np.mean(np.trace(moments, axis1=1, axis2=2)) / 2.0
        noise = RecordingNoise(float(np.sqrt(max(rest / (numbers * share), _LEAST_NOISE**2))), float(np.sqrt(own)))
    unexplained, force = split_off_force(rows, rows.r, noise)
    marker = noise.marker * np.sqrt(correlation_time(unexplained))
    return RecordingNoise(float(marker), noise.force * float(np.sqrt(correlation_time(force))))


def correlation_time(r: Array) -> float:
    """`1 + 2 sum rho` of residuals (F, channels) over the lags where the correlation is positive, pooled."""
    z = r - np.mean(r, axis=0)
    spread = np.median(np.abs(z), axis=0) / 0.6745
    z = np.clip(np.divide(z, spread, out=np.zeros_like(z), where=spread > 0.0), -3.0, 3.0)
    power = float(np.sum(z**2))
    total = 1.0
    for lag in range(1, max(len(z) // _LONGEST_LAG, 2)):
        rho = float(np.sum(z[:-lag] * z[lag:])) / max(power, 1e-12)
        if rho < _UNCORRELATED:
            break
        total += 2.0 * rho
    return total
