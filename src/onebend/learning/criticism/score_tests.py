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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, fdtrc

from onebend.learning.criticism.alternatives import Alternative, Suspect
from onebend.learning.inference.fit_problem import FitProblem, prior
from onebend.learning.inference.hyperparameters import correlation_time
from onebend.learning.inference.joint import Solved, solved
from onebend.learning.inference.joint_covariance import JointCovariance
from onebend.learning.inference.linear_gaussian import (
    ResidualRows,
    data_information,
    force_shrinkage,
    residual_rows,
    split_off_force,
)
from onebend.learning.inference.optimizer import Optimum
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.readings import unwhitened, whitened
from onebend.records import Array, IntArray
from onebend.workers import each

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

    @property
    def able(self) -> bool:
        """Whether the data tell anything of it, beside the model's own parameters."""
        return bool(np.all(np.isfinite(self.value)))


@dataclass(frozen=True)
class LinearisedFit:
    """The linearised model at the optimum."""

    problem: FitProblem
    optimum: Optimum
    rows: tuple[ResidualRows, ...]  # of each recording
    known: tuple[IntArray, ...]  # indices of the parameters that each recording depends on
    solved: Solved  # the posterior at the optimum's hyperparameters
    covariance: JointCovariance  # the same
    step: Array  # (P,) to where the slope is zero


def linearised(problem: FitProblem, optimum: Optimum) -> LinearisedFit:
    """The linearised model at an optimum."""
    layout, x, noise = problem.layout, optimum.x, optimum.hyperparameters.noise
    rows = each(residual_rows, optimum.predictions, noise)
    before = prior(problem, optimum.hyperparameters)
    posterior = solved(data_information(problem, rows, x, optimum.hyperparameters), before)
    known = tuple(layout.known_to(recording.number) for recording in problem.recordings)
    return LinearisedFit(problem, optimum, rows, known, posterior, posterior.covariance, posterior.mean - x)


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
    where = slice(int(index[0]), int(index[-1]) + 1)
    after = fit.covariance.among(where)
    removed = np.eye(len(index)) - after / np.outer(before, before)
    values, vectors = np.linalg.eigh(0.5 * (removed + removed.T))
    judged = values > _LEAST_REMOVED
    freed = vectors[:, judged] @ ((vectors[:, judged].T @ (x / before)) / values[judged])  # in prior sds
    gain, count = float(freed @ (x / before)), int(np.sum(judged))
    log10_p = _log10(chdtrc(count, gain)) if count else 0.0
    shift = fit.covariance.shared_with(where)[: fit.problem.layout.spline.count] @ (freed / before)
    size = float(np.linalg.norm(x)) if unit == "m" else 0.0
    return Score(suspect, before * freed if count else np.full(len(x), np.nan), before, gain, log10_p, size, shift)


@dataclass(frozen=True)
class _Freed:
    """The numbers b of one suspect, freed: what they do to the recordings that show it."""

    suspect: Suspect
    log_k: Array | None  # (p, n) what they are of log k's coefficients; None: nothing
    numbers: tuple[int, ...]  # of these recordings
    d: tuple[Array, ...]  # (F, R, n) of each, whitened
    information: Array  # (n,) of each number alone
    marginal: Array  # (n, n) information, with the parameters integrated out
    score: Array  # (n,)
    response: tuple[Array, ...]  # of each recording, (C, n): its parameters follow b by minus this


def scores(fit: LinearisedFit, patterns: Sequence[Sequence[Alternative]]) -> list[Score]:
    """The tests of the alternatives of each recording. Those of one suspect belong together; what only one recording
    shows is judged by that one."""
    places: dict[Suspect, list[tuple[int, Alternative]]] = {}
    for number, alternatives in enumerate(patterns):
        for one in alternatives:
            places.setdefault(one.suspect, []).append((number, one))
    return list(each(lambda suspect, shown: _score(fit, _freed(fit, suspect, shown)), places, places.values()))


def _freed(fit: LinearisedFit, suspect: Suspect, shown: Sequence[tuple[int, Alternative]]) -> _Freed:
    every = [(number, *_mixed(fit, number, one.pattern)) for number, one in shown]
    steps = [fit.step[fit.known[number]] for number, *_ in every]
    bb = np.sum([one for *_, one, _, _ in every], axis=0)
    g = np.sum([told - bx @ step for (*_, bx, told), step in zip(every, steps, strict=True)], axis=0)
    if len(every) == 1:
        (number, _, _, bx, _) = every[0]
        response = [fit.covariance.pairs[number] @ bx.T]
        marginal = bb - bx @ response[0]
    else:
        wide = np.zeros((fit.problem.layout.size, len(bb)))
        for number, *_, bx, _ in every:
            wide[fit.known[number]] += bx.T
        whole = fit.solved.times_covariance(wide)
        response = [whole[fit.known[number]] for number, *_ in every]
        marginal = bb - wide.T @ whole
    numbers, d = tuple(one[0] for one in every), tuple(one[1] for one in every)
    return _Freed(suspect, shown[0][1].log_k, numbers, d, np.diag(bb).copy(), marginal, g, tuple(response))


def _mixed(fit: LinearisedFit, number: int, pattern: Array) -> tuple[Array, Array, Array, Array]:
    """A pattern (F, m, 3, n) in one recording: whitened (F, R, n), the information on its numbers (n, n) and with the
    recording's parameters (n, C), and the score (n,) at the optimum."""
    recording, rows, noise = fit.problem.recordings[number], fit.rows[number], fit.optimum.hyperparameters.noise[number]
    d = rows.root_weight[..., None] * whitened(recording.whiten, pattern)
    unexplained = d - rows.a @ (force_shrinkage(rows, noise) @ (np.swapaxes(rows.a, 1, 2) @ d))
    weighted = unexplained.reshape(-1, d.shape[-1]) / noise.marker**2
    bb = weighted.T @ d.reshape(-1, d.shape[-1])
    return d, bb, rows.onto_parameters(weighted.reshape(d.shape)), weighted.T @ rows.r.ravel()


def _score(fit: LinearisedFit, freed: _Freed) -> Score:
    suspect, p = freed.suspect, fit.problem.layout.spline.count
    size = np.sqrt(np.maximum(freed.information, 1e-300))
    scaled = freed.marginal / np.outer(size, size)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    visible = values > _BLIND
    count = int(np.sum(visible))
    if count == 0:
        unknown = np.full(len(size), np.nan)
        return Score(suspect, unknown, unknown, 0.0, 0.0, 0.0, np.zeros(p))
    inverse = (vectors[:, visible] / values[visible]) @ vectors[:, visible].T / np.outer(size, size)
    b = inverse @ freed.score
    chi2 = float(freed.score @ b)
    log10_p = _log10(chdtrc(count, chi2))
    steps = [-response @ b for response in freed.response]
    every = zip(freed.numbers, freed.d, steps, strict=True)
    changes = {number: d @ b + fit.rows[number].moved_by(step) for number, d, step in every}
    ratio = 1.0
    if log10_p < _NEW_NOISE:
        ratio, numbers = _noise_left(fit, changes)
        chi2 *= ratio
        freedom = max(numbers - len(b), 5.0)
        log10_p = _log10(fdtrc(count, freedom, chi2 / count))
    moved = max(_moved(fit.problem.recordings[number], fit.rows[number], c) for number, c in changes.items())
    sd = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    shift = steps[0][:p] if freed.log_k is None else steps[0][:p] + freed.log_k @ b
    return Score(suspect, b, sd, chi2, log10_p, moved, shift, max(ratio, 1.0))


def _noise_left(fit: LinearisedFit, changes: Mapping[int, Array]) -> tuple[float, float]:
    """Variance of the noise that the fit found over that which is left after the changes (F, R) of the residuals of
    some recordings, correlation in time included; and how many independent numbers are left.

    Afterwards the coordinate with the longest correlation counts: otherwise an alternative that is smooth in time would
    pass for signal where the noise of one tag is slow and that of the others is not.
    """
    before, after, numbers = 0.0, 0.0, 0.0
    for number, change in changes.items():
        rows, noise = fit.rows[number], fit.optimum.hyperparameters.noise[number]
        plain = rows.r - rows.moved_by(fit.step[fit.known[number]])
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


def _log10(chance: float) -> float:
    """Its logarithm; minus infinity where it is too small for a number."""
    return float(np.log10(chance)) if chance > 0.0 else -np.inf
