"""The way down to the most probable parameters at fixed hyperparameters: Levenberg-Marquardt along curved valleys.

Exact data leave narrow valleys in the space of the parameters, and these bend: a straight step along one leaves it
sideways, by little for the parameters and by many sd for the data. Damping alone would make the steps short. So a trial
is brought back to the valley first, by Newton's method with the derivatives of the step's beginning (chord method); one
such correction costs equilibria, but no derivatives. See Transtrum and Sethna (2012) on the geometry.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from onebend.learning.inference.fit_problem import FitProblem, Hyperparameters, Prior, RecordingNoise
from onebend.learning.inference.information_form import InformationForm
from onebend.learning.inference.joint import JointInformation, Solved, own_in_z, prior_in_own_z, solved
from onebend.learning.inference.linear_gaussian import (
    ResidualRows,
    recording_information,
    residual_rows,
    residuals,
    rest_residuals,
    rest_score,
    rows_by_force,
    split_off_force,
    tag_score,
)
from onebend.learning.model.forward import Prediction, predict
from onebend.records import Array
from onebend.workers import each

_FIRST_DAMPING, _LARGEST_DAMPING = 1.0, 1e9
_HARDER, _EASIER = 8.0, 16.0  # factors on the damping after a trial that failed, and after one that did not
_LONGEST = 1.5  # of log k, in one step
_CORRECTIONS = 4  # of one trial, at most
_AS_PROMISED = 0.7  # of the promised gain: a trial that reaches it needs no correction
_WORTH_GOING_ON = 0.5  # of what is missing: a correction that leaves more of it was the last
_OWN_PASSES = 2  # in which each frame's own force is settled: the second leaves the square of what the first left
_ROUNDING = 1.0  # sd squared: where steps hardly lower the cost, a smaller promised gain is of the derivatives' errors
_LITTLE = 0.03  # of the cost, in sd squared, that a step lowers it by
_TOGETHER = 10.0  # recordings: of more, nearly all that a step gains is in the parameters of single ones
_AS_SAID = 0.1  # of what a step moves the tags by: where they went no farther off, its derivatives do for the next one


@dataclass(frozen=True)
class MapEstimate:
    """The most probable parameters found so far."""

    x: Array  # (P,)
    hyperparameters: Hyperparameters
    predictions: tuple[Prediction, ...]  # of each recording at x
    steps: int = 0
    converged: bool = False


@dataclass(frozen=True)
class _Linearised:
    """The problem about one estimate: z is the whitened parameters, see `Prior`."""

    problem: FitProblem
    estimate: MapEstimate
    before: Prior
    rows: Sequence[ResidualRows]

    @cached_property
    def frequency_slopes(self) -> list[Array]:
        """(N, P) of each recording with frequencies, over their sds."""
        here = self.problem.predicted_frequencies(self.estimate.x)
        return [one.slopes / one.data.sd[:, None] for one in here]

    @cached_property
    def in_own_z(self) -> tuple[JointInformation, Prior]:
        """What tags, rests and frequencies say, and the prior; the z of each recording's own parameters stand for
        them."""
        problem, x, noise = self.problem, self.estimate.x, self.estimate.hyperparameters.noise

        def of(number: int, rows: ResidualRows, noise: RecordingNoise) -> InformationForm:
            return own_in_z(recording_information(problem, number, rows, x, noise), self.before, number)

        forms = each(of, range(len(self.rows)), self.rows, noise)
        return JointInformation(forms, problem.layout.parts), prior_in_own_z(self.before)

    def solved(self, damping: float = 0.0) -> Solved:
        """The posterior of the linearised model in z; `damping` is added to its precision."""
        return solved(*self.in_own_z, damping)

    @cached_property
    def slope(self) -> Array:
        """(P,) minus half the cost's gradient with z."""
        return self.slope_at(self.estimate.x, [rows.r for rows in self.rows])

    @cached_property
    def gain(self) -> float:
        """Of an undamped step, in sd squared."""
        return float(self.slope @ self.solved().solve(self.slope))

    def bent(self, z: Array) -> float:
        """`z' A z`, A being the second derivatives of half the cost with z."""
        data, before = self.in_own_z
        x = before.times(z)
        return float(z @ z + x @ data.times(x))

    def slope_at(self, x: Array, r: Sequence[Array]) -> Array:
        """(P,) as `slope`, at parameters x with residuals r, (F, R) of each recording, by the derivatives from here."""
        told, layout = np.zeros(len(x)), self.problem.layout
        every = zip(self.problem.recordings, self.rows, r, self.estimate.hyperparameters.noise, strict=True)
        for recording, rows, residual, noise in every:
            told[layout.known_to(recording.number)] += tag_score(rows, residual, noise) + rest_score(
                recording, layout, x
            )
        if self.problem.frequencies:
            for slopes, there in zip(self.frequency_slopes, self.problem.predicted_frequencies(x), strict=True):
                told += slopes.T @ there.residuals
        return np.asarray(self.before.transposed_times(told) - self.before.whiten(x))

    def residuals_at(self, tried: MapEstimate) -> list[Array]:
        """(F, R) of each recording, the effect of each frame's own force included, weighted as here."""
        pairs = zip(self.rows, tried.predictions, strict=True)
        return [rows.root_weight * residuals(p) + np.einsum("frd,fd->fr", rows.a, p.own) for rows, p in pairs]

    def cost(self, estimate: MapEstimate) -> float:
        """Minus twice the log posterior at the weights from here, but for a constant; infinite without equilibrium."""
        if not all_converged(estimate.predictions):
            return np.inf
        x = estimate.x
        swings = sum(float(np.sum(one.residuals**2)) for one in self.problem.predicted_frequencies(x))
        if not np.isfinite(swings):
            return np.inf
        every = zip(self.rows, estimate.predictions, estimate.hyperparameters.noise, strict=True)
        tags = sum(_misfit(rows.root_weight * residuals(p), p.own, noise) for rows, p, noise in every)
        z = self.before.whiten(x)
        layout = self.problem.layout
        rests = sum(float(np.sum(rest_residuals(one, layout, x) ** 2)) for one in self.problem.recordings)
        return float(tags + swings + z @ z + rests)


def all_converged(predictions: Sequence[Prediction]) -> bool:
    """Whether every frame of every recording has an equilibrium."""
    return all(np.all(p.solved.converged) for p in predictions)


def release(estimate: MapEstimate) -> None:
    """Forget the derivatives at an estimate that another has taken the place of."""
    for prediction in estimate.predictions:
        prediction.release()


def rows_of(estimate: MapEstimate) -> list[ResidualRows]:
    """Of every recording, its tags weighted by their noise at the estimate."""
    return list(each(residual_rows, estimate.predictions, estimate.hyperparameters.noise))


def with_own_forces(estimate: MapEstimate) -> MapEstimate:
    """The estimate with each frame's own force where it is most probable, all else as it is; unchanged where a beam
    under these forces would not stand."""

    def settled(p: Prediction, noise: RecordingNoise) -> Prediction:
        rows = rows_by_force(p, noise)
        return predict(p.recording, p.layout, p.x, p.solved.q, split_off_force(rows, rows.r, noise)[1])

    for _ in range(_OWN_PASSES):
        moved = each(settled, estimate.predictions, estimate.hyperparameters.noise)
        if not all_converged(moved):
            break
        estimate = replace(estimate, predictions=moved)
    return estimate


def descend(
    problem: FitProblem, estimate: MapEstimate, before: Prior, most_steps: int, tolerance: float
) -> MapEstimate:
    """The maximum a posteriori at the estimate's hyperparameters; weights and frames' covariances are renewed at every
    step.

    Damped in z, in which the prior has covariance one: what the data hardly tell is held back, and what they fix well
    is not. Damped in the parameters' own units, a step along a valley that the data leave open would be a small part
    of its length. It ends where an undamped step would gain next to nothing. Of many recordings each keeps its
    derivatives for as long as its tags go where these say; those of the end are always its own.
    """
    many = max(1.0, len(problem.recordings) / _TOGETHER)  # the more there are, the nearer it begins, too
    damping, enough, little = _FIRST_DAMPING / many**2, many * tolerance**2, many * max(_LITTLE, tolerance**2)
    for _ in range(most_steps):
        here = _Linearised(problem, estimate, before, rows_of(estimate))
        kept = any(p.nearby is not None for p in estimate.predictions)
        found = None if here.gain < enough else _lowered(here, damping)
        if found is None and not kept:
            return replace(estimate, converged=here.gain < max(enough, _ROUNDING))
        if found is None:
            del here
            _release_kept(estimate)
            continue
        tried, gained, damping = found
        settled = here.gain < _ROUNDING and gained < little
        if many > 1.0 and not settled:
            tried = _with_slopes_kept(here, tried)
        del here, found  # with the derivatives of where it began
        release(estimate)
        estimate, damping = replace(tried, steps=estimate.steps + 1), max(damping / _EASIER, 1e-12)
        if settled and not kept:
            return replace(estimate, converged=True)
    _release_kept(estimate)
    return replace(estimate, converged=False)


def _release_kept(estimate: MapEstimate) -> None:
    """Forget the derivatives of shapes near by, so that those of the recordings' own are worked out."""
    for prediction in estimate.predictions:
        if prediction.nearby is not None:
            prediction.release()


def _lowered(here: _Linearised, damping: float) -> tuple[MapEstimate, float, float] | None:
    """A trial of lower cost, by how much it is lower, and the damping that it took; None where no step lowers the cost
    any more."""
    cost = here.cost(here.estimate)
    while damping <= _LARGEST_DAMPING:
        tried, reached = _trial(here, damping, cost)
        if reached <= cost + 1e-6:
            return tried, cost - reached, damping
        damping *= _HARDER
    return None


def _with_slopes_kept(here: _Linearised, tried: MapEstimate) -> MapEstimate:
    """The trial with the derivatives of its beginning in those recordings whose tags went where these had said."""
    step, layout = tried.x - here.estimate.x, here.problem.layout

    def kept(rows: ResidualRows, now: Prediction, r: Array) -> Prediction:
        moved = rows.moved_by(step[layout.known_to(now.recording.number)])
        near = float(np.sum((r - rows.r + moved) ** 2)) <= _AS_SAID**2 * float(np.sum(moved**2))
        return replace(now, nearby=rows.whitened) if near else now

    return replace(tried, predictions=each(kept, here.rows, tried.predictions, here.residuals_at(tried)))


def _trial(here: _Linearised, damping: float, cost: float) -> tuple[MapEstimate, float]:
    """A damped step from an estimate of this cost, corrected while that helps, and the cost that it reaches."""
    before, damped = here.before, here.solved(damping)
    z = damped.solve(here.slope)
    of_k = before.times(z)[: here.problem.layout.spline.count]
    share = min(1.0, _LONGEST / max(float(np.max(np.abs(of_k))), 1e-300))
    aim, z = share * here.slope, share * z
    promised = cost - float(2.0 * z @ here.slope - here.bent(z))
    best = _moved(here, here.estimate, [rows.r for rows in here.rows], before.times(z))
    lowest = here.cost(best)
    tried, reached, offset = best, lowest, z
    for _ in range(_CORRECTIONS):
        missing = reached - promised
        if not np.isfinite(reached) or missing <= (1.0 - _AS_PROMISED) * (cost - promised):
            break
        r = here.residuals_at(tried)
        # of the damped cost, whose slope at the beginning is `aim`, where a step was cut short too
        correction = damped.solve(here.slope_at(tried.x, r) - (here.slope - aim) - damping * offset)
        tried, offset = _moved(here, tried, r, before.times(correction)), offset + correction
        reached = here.cost(tried)
        if reached < lowest:
            best, lowest = tried, reached
        if reached - promised > _WORTH_GOING_ON * missing:
            break
    return best, lowest


def _moved(here: _Linearised, begin: MapEstimate, r: Sequence[Array], step: Array) -> MapEstimate:
    """A trial a step (P,) on, from one whose residuals are r; each frame's own force is then, to first order, the most
    probable one."""
    x, layout = begin.x + step, here.problem.layout

    def moved(rows: ResidualRows, residual: Array, now: Prediction, noise: RecordingNoise) -> Prediction:
        left = residual - rows.moved_by(step[layout.known_to(now.recording.number)])
        own = split_off_force(rows, left, noise)[1]
        return predict(now.recording, layout, x, now.solved.q, own)

    predictions = each(moved, here.rows, r, begin.predictions, begin.hyperparameters.noise)
    return replace(begin, x=x, predictions=predictions)


def _misfit(residual: Array, own: Array, noise: RecordingNoise) -> float:
    """Minus twice the log probability of the tags' residuals (F, R), and of the frames' own forces (F, 2)."""
    return float(np.sum(residual**2)) / noise.marker**2 + float(np.sum(own**2)) / noise.force**2
