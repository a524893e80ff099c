"""The maximum a posteriori: Gauss-Newton at fixed hyperparameters, hyperparameters at fixed shapes, in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from onebend.beam.stiffness import Profile
from onebend.errors import LearningError
from onebend.learning import condensed, frequencies, linear, normal, parameters, static_poses
from onebend.learning.allowances import BETWEEN, EVERY_ALLOWANCE, Sizes, between_recordings
from onebend.learning.fit_data import FitData, fit_data
from onebend.learning.frames import chosen_frames, distances, evenly_spread, marker_rms
from onebend.learning.hyperparameters import (
    Evidence,
    averaged_posterior,
    choose_hyperparameters,
    choose_sizes,
    expected_recording_noise,
    likely_sizes,
    new_noise,
    with_sites,
)
from onebend.learning.prediction import Prediction, predict
from onebend.options import NOT_NEGATIVE, option
from onebend.progress import Progress, Silent, each
from onebend.records import Array, BoolArray, Observations, covariance_with_camera, marker_words

# Levenberg-Marquardt along curved valleys: trial steps are corrected by chord Newton steps, which need no new
# derivatives. See Transtrum and Sethna (2012) on the geometry.

_FIRST_DAMPING, _LARGEST_DAMPING = 1.0, 1e9  # of the precision of z, whose prior alone gives 1
_HARDER, _EASIER = 8.0, 16.0  # factors on the damping after a rejected trial, and after an accepted one
_LONGEST = 1.5  # of log k, in one step
_CORRECTIONS = 4  # of one trial, at most
_ENOUGH_GAIN = 0.7  # of the predicted gain: a trial that reaches it needs no correction
_SLOW_CORRECTION = 0.5  # of the missing gain: a correction that leaves more of it is the last
_OWN_PASSES = 2  # Newton passes for each frame's own force
_ROUNDING = 1.0  # sd squared: where steps hardly lower the cost, a smaller predicted gain is error of the derivatives
_LITTLE = 0.03  # sd squared, smallest decrease of the cost that counts
_TOGETHER = 10.0  # recordings: with more, nearly all gain of a step is in the parameters of single ones
_NEARLY_LINEAR = 0.1  # of a step's effect on the tags: derivatives are kept where the error of linearity is smaller


@dataclass(frozen=True)
class MapEstimate:
    """The most probable parameters found so far."""

    x: Array  # (P,)
    hyperparameters: linear.Hyperparameters
    predictions: tuple[Prediction, ...]  # of each recording at x
    steps: int = 0
    converged: bool = False


@dataclass(frozen=True)
class _Linearised:
    """The problem about one estimate: z is the whitened parameters, see `Prior`."""

    problem: linear.FitProblem
    estimate: MapEstimate
    before: linear.Prior
    rows: Sequence[linear.ResidualRows]

    @cached_property
    def beside(self) -> list[linear.BesideTags]:
        """Of each recording."""
        return self.beside_at(self.estimate.x)

    def beside_at(self, x: Array) -> list[linear.BesideTags]:
        """Of each recording, at parameters x."""
        return [linear.beside_tags(self.problem, number, x) for number in range(len(self.rows))]

    @cached_property
    def in_own_z(self) -> tuple[linear.JointInformation, linear.Prior]:
        """Information of all data and the prior, with each recording's own parameters in z."""
        layout, estimate = self.problem.layout, self.estimate

        def of(
            number: int, rows: linear.ResidualRows, beside: linear.BesideTags, noise: linear.RecordingNoise
        ) -> normal.InformationForm:
            information = linear.recording_information(layout, number, rows, beside, estimate.x, noise)
            return linear.own_in_z(information, self.before, number)

        forms = each(of, range(len(self.rows)), self.rows, self.beside, estimate.hyperparameters.noise)
        return linear.JointInformation(forms, layout.parts), linear.prior_in_own_z(self.before)

    def solved(self, damping: float = 0.0) -> linear.Solved:
        """The posterior of the linearised model in z; `damping` is added to its precision."""
        return linear.solved(*self.in_own_z, damping)

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
        gradient, layout, noise = np.zeros(len(x)), self.problem.layout, self.estimate.hyperparameters.noise
        for i, (rows, here, there) in enumerate(zip(self.rows, self.beside, self.beside_at(x), strict=True)):
            gradient[layout.known_to(i)] += linear.tag_score(rows, r[i], noise[i]) + here.j.T @ there.r
        return np.asarray(self.before.transposed_times(gradient) - self.before.whiten(x))

    def residuals_at(self, tried: MapEstimate) -> list[Array]:
        """(F, R) of each recording, the effect of each frame's own force included, weighted as here."""
        pairs = zip(self.rows, tried.predictions, strict=True)
        return [rows.root_weight * linear.residuals(p) + linear.explained_by(rows.a, p.own) for rows, p in pairs]

    def cost(self, estimate: MapEstimate) -> float:
        """Minus twice the log posterior at the weights from here, but for a constant; infinite without equilibrium."""
        if not all_converged(estimate.predictions):
            return np.inf
        beside = sum(float(np.sum(one.r**2)) for one in self.beside_at(estimate.x))
        if not np.isfinite(beside):
            return np.inf
        every = zip(self.rows, estimate.predictions, estimate.hyperparameters.noise, strict=True)
        tags = sum(_misfit(rows.root_weight * linear.residuals(p), p.own, noise) for rows, p, noise in every)
        z = self.before.whiten(estimate.x)
        return float(tags + beside + z @ z)


def all_converged(predictions: Sequence[Prediction]) -> bool:
    """Whether every frame of every recording has an equilibrium."""
    return all(np.all(p.solved.converged) for p in predictions)


def clear_slopes(estimate: MapEstimate) -> None:
    """Free the derivatives of a replaced estimate, which callers may still hold."""
    for prediction in estimate.predictions:
        prediction.clear_slopes()


def _with_exact_slopes(estimate: MapEstimate) -> MapEstimate:
    """The estimate without derivatives of nearby shapes."""
    exact = (p if p.nearby is None else replace(p, nearby=None) for p in estimate.predictions)
    return replace(estimate, predictions=tuple(exact))


def rows_of(estimate: MapEstimate) -> list[linear.ResidualRows]:
    """Rows of every recording, weighted by the noise of the estimate."""
    return list(each(linear.residual_rows, estimate.predictions, estimate.hyperparameters.noise))


def evidence_at(problem: linear.FitProblem, estimate: MapEstimate) -> Evidence:
    """Of the model that is linear about an estimate, with its noise."""
    information = linear.data_information(problem, rows_of(estimate), estimate.x, estimate.hyperparameters)
    return Evidence(problem, information)


def with_own_forces(estimate: MapEstimate) -> MapEstimate:
    """The estimate with each frame's own force at its most probable value; unchanged without equilibrium there."""

    def settled(p: Prediction, noise: linear.RecordingNoise) -> Prediction:
        rows = linear.residual_rows(p, noise, p.whitened_by_force)
        return predict(p.data, p.layout, p.x, p.solved.q, linear.split_off_force(rows, rows.r, noise)[1])

    for _ in range(_OWN_PASSES):
        moved = each(settled, estimate.predictions, estimate.hyperparameters.noise)
        if not all_converged(moved):
            break
        estimate = replace(estimate, predictions=moved)
    return estimate


def descend(
    problem: linear.FitProblem, estimate: MapEstimate, before: linear.Prior, most_steps: int, tolerance: float
) -> MapEstimate:
    """The maximum a posteriori at the estimate's hyperparameters; robust weights are updated at every step.

    Damped in z, in which the prior has covariance one. Ends where the gain of an undamped step is negligible. With many
    recordings, each keeps its derivatives while the motion of its tags is nearly linear; the last ones are exact.
    """
    many = max(1.0, len(problem.recordings) / _TOGETHER)
    damping, enough, little = _FIRST_DAMPING / many**2, many * tolerance**2, many * max(_LITTLE, tolerance**2)
    for _ in range(most_steps):
        here = _Linearised(problem, estimate, before, rows_of(estimate))
        kept = any(p.nearby is not None for p in estimate.predictions)
        found = None if here.gain < enough else _lowered(here, damping)
        if found is None and not kept:
            return replace(estimate, converged=here.gain < max(enough, _ROUNDING))
        if found is None:
            del here
            estimate = _with_exact_slopes(estimate)
            continue
        tried, gained, damping = found
        settled = here.gain < _ROUNDING and gained < little
        if many > 1.0 and not settled:
            tried = _with_slopes_kept(here, tried)
        del here, found  # they hold derivatives
        clear_slopes(estimate)
        estimate, damping = replace(tried, steps=estimate.steps + 1), max(damping / _EASIER, 1e-12)
        if settled and not kept:
            return replace(estimate, converged=True)
    return replace(_with_exact_slopes(estimate), converged=False)


def _lowered(here: _Linearised, damping: float) -> tuple[MapEstimate, float, float] | None:
    """A trial of lower cost, the decrease, and its damping; None where no step lowers the cost."""
    cost = here.cost(here.estimate)
    while damping <= _LARGEST_DAMPING:
        tried, reached = _trial(here, damping, cost)
        if reached <= cost + 1e-6:
            return tried, cost - reached, damping
        damping *= _HARDER
    return None


def _with_slopes_kept(here: _Linearised, tried: MapEstimate) -> MapEstimate:
    """The trial; recordings whose tags moved nearly linearly keep the derivatives of its beginning."""
    step, layout = tried.x - here.estimate.x, here.problem.layout

    def kept(rows: linear.ResidualRows, now: Prediction, r: Array) -> Prediction:
        moved = rows.moved_by(step[layout.known_to(now.data.number)])
        near = float(np.sum((r - rows.r + moved) ** 2)) <= _NEARLY_LINEAR**2 * float(np.sum(moved**2))
        return replace(now, nearby=rows.whitened) if near else now

    return replace(tried, predictions=each(kept, here.rows, tried.predictions, here.residuals_at(tried)))


def _trial(here: _Linearised, damping: float, cost: float) -> tuple[MapEstimate, float]:
    """A damped step from an estimate of this cost, corrected while that helps, and its cost."""
    before, damped = here.before, here.solved(damping)
    z = damped.solve(here.slope)
    of_k = before.times(z)[: here.problem.layout.spline.count]
    share = min(1.0, _LONGEST / max(float(np.max(np.abs(of_k))), 1e-300))
    aim, z = share * here.slope, share * z
    predicted = cost - float(2.0 * z @ here.slope - here.bent(z))
    best = _moved(here, here.estimate, [rows.r for rows in here.rows], before.times(z))
    lowest = here.cost(best)
    tried, reached, offset = best, lowest, z
    for _ in range(_CORRECTIONS):
        missing = reached - predicted
        if not np.isfinite(reached) or missing <= (1.0 - _ENOUGH_GAIN) * (cost - predicted):
            break
        r = here.residuals_at(tried)
        # Newton step of the damped cost; `aim` is its slope at the beginning, also for a shortened step
        correction = damped.solve(here.slope_at(tried.x, r) - (here.slope - aim) - damping * offset)
        tried, offset = _moved(here, tried, r, before.times(correction)), offset + correction
        reached = here.cost(tried)
        if reached < lowest:
            best, lowest = tried, reached
        if reached - predicted > _SLOW_CORRECTION * missing:
            break
    return best, lowest


def _moved(here: _Linearised, begin: MapEstimate, r: Sequence[Array], step: Array) -> MapEstimate:
    """A trial after a step (P,) from one with residuals r, each frame's own force linearised."""
    x, layout = begin.x + step, here.problem.layout

    def moved(rows: linear.ResidualRows, residual: Array, now: Prediction, noise: linear.RecordingNoise) -> Prediction:
        left = residual - rows.moved_by(step[layout.known_to(now.data.number)])
        own = linear.split_off_force(rows, left, noise)[1]
        return predict(now.data, layout, x, now.solved.q, own)

    predictions = each(moved, here.rows, r, begin.predictions, begin.hyperparameters.noise)
    return replace(begin, x=x, predictions=predictions)


def _misfit(residual: Array, own: Array, noise: linear.RecordingNoise) -> float:
    """Minus twice the log probability of residuals (F, R) and of the frames' own forces (F, 2)."""
    return float(np.sum(residual**2)) / noise.marker**2 + float(np.sum(own**2)) / noise.force**2


MISS = 0.05  # of a tag's own motion: a fit with larger residuals does not explain the recording
HOPELESS = 0.2  # of the motion of all tags together: the fit has no meaning
DOUBTS = {  # by what a remark on the recording is about
    "tool place": "the film shows the tool elsewhere",
    "force unit": "the noise of the force log contradicts its sensor or its unit",
    "sensor's end": "the sensor was at the end of its range",
    "length": "the body does not end where length_m says",
    "drift": "the force's zero drifted by more than half of the push",
}
CONTRADICTED = "the force contradicts the bending"  # what all others say
_LEAST_MISS = 3.0  # times a tag's own noise: a smaller distance is no miss, however little the tag moves


@dataclass(frozen=True)
class Miss:
    """A recording that the fit cannot explain."""

    name: str
    tag: str  # the worst, in words
    rms: float  # m
    motion: float  # m, of the tag
    share: float  # of the motion of all tags together, missed

    @property
    def hopeless(self) -> bool:
        """Whether nothing that was fitted means anything."""
        return self.share > HOPELESS

    @property
    def words(self) -> str:
        """A description of the misfit."""
        return (
            f"the fit misses {self.tag} by {1000 * self.rms:.3g} mm RMS where it moves by {1000 * self.motion:.3g} mm"
        )


def recording_rms(data: FitData, fitted: Prediction) -> Array:
    """(m,) m: distance of the tags from the fit; NaN for a tag that was never seen."""
    return marker_rms(data.off(fitted.pose))


def misses(recordings: Sequence[FitData], fitted: Sequence[Prediction]) -> tuple[Miss, ...]:
    """The recordings that the fit cannot explain, with all nuisances included in `fitted`."""
    every = [_miss(data, recording_rms(data, p)) for data, p in zip(recordings, fitted, strict=True)]
    return tuple(miss for miss in every if miss is not None)


def _miss(data: FitData, rms: Array) -> Miss | None:
    o, xy = data.observations, data.measured[..., :2]
    motion = distances(np.fmax.reduce(xy) - np.fmin.reduce(xy))
    if o.static:  # points near the clamp hardly move, and a ruler reads them no better
        zeroed = o.readings.bare >= 0
        straight = np.zeros(2) if zeroed else o.length * o.marker_s[:, None] * np.array([1.0, 0.0])
        motion = np.full_like(motion, np.nanmax(distances(xy - straight)))
    elif o.traced is not None:  # so do those of a curve, whose errors are alike along it
        motion[o.traced] = np.nanmax(motion[o.traced])
    variance = np.trace(covariance_with_camera(o)[..., :2, :2], axis1=2, axis2=3)
    off = rms > _LEAST_MISS * np.sqrt(np.fmin.reduce(variance))
    missing = np.divide(rms, motion, out=np.zeros_like(rms), where=off & (motion > 0.0))
    worst = int(np.argmax(missing))
    if not missing[worst] > MISS:
        return None
    share = float(np.sqrt(np.nansum(rms**2) / np.nansum(motion**2)))
    tag = marker_words(int(o.tag_id[worst]), float(o.marker_s[worst]))
    return Miss(o.source.name, tag, float(rms[worst]), float(motion[worst]), share)


_LOST_FORCE = (
    "Check that this log is of this push, then start_s and the frame rate of the film. If they are right, push harder, "
    "or take a force sensor that is exact to a tenth of the push; zero it just before, and let go before the log ends, "
    "so that its drift shows"
)


_LOST_WEIGHT = (
    "Gravity pulls elsewhere than [gravity] says, or the mass is another one: check direction_deg, base_angle_deg and "
    "mass_kg."
)


def is_of_a_beam(pull: float) -> bool:
    """Whether a beam of the written mass may pull so much at its clamp, as a share of what an even one does: a cone has
    0.5, a mass at the tip 2."""
    return 0.42 < pull < 2.2


def refuse_lost_force(problem: linear.FitProblem, estimate: MapEstimate) -> None:
    """Check that the fitted error of some force log varies less than the corrected force.

    Raises:
        LearningError: every log varies by its error; k(s) and the force may both go to zero.
    """
    lost = []
    for data in problem.recordings:
        loaded = np.any(data.force != 0.0, axis=1)
        if not len(data.error.knots) or not np.any(loaded):
            return
        values = problem.layout.get(estimate.x, "force", data.number).reshape(-1, 2)
        error = (data.error_weights @ values)[loaded]
        of_error, of_force = _rms_change(error), _rms_change(data.force[loaded] - error)
        if of_error <= of_force:
            return
        name = data.observations.source.name
        lost.append(f"{name}: the error of the force log changes by {of_error:.2g} N, the force by {of_force:.2g} N")
    if lost:
        every = (remark for one in problem.recordings for remark in one.observations.source.remarks)
        causes = [remark.text for remark in every if remark.level == "warning"] or [f"{_LOST_FORCE}."]
        if any(np.any(one.observations.gravity) for one in problem.recordings):
            heavier, sloped = problem.layout.get(estimate.x, "mass")[:2].tolist()
            likely = is_of_a_beam(1.0 + heavier + sloped / 3.0)
            causes = [*causes, f"Or: {_LOST_WEIGHT}"] if likely else [_LOST_WEIGHT, "Or:", *causes]
        raise LearningError(
            f"{'; '.join(lost)} (RMS, as tags and log say together): the log does not tell the force, and so not k(s). "
            + " ".join(causes)
        )


def _rms_change(force: Array) -> float:
    """N, root mean square of (T, 2) about its mean."""
    return float(np.sqrt(np.mean(np.sum((force - np.mean(force, axis=0)) ** 2, axis=1))))


def doubts_of(observations: Observations) -> tuple[str, ...]:
    """Doubts about a recording, from its own remarks."""
    said = (DOUBTS.get(one.about, CONTRADICTED) for one in observations.source.remarks if one.doubt)
    return tuple(dict.fromkeys(said))


_HELD_SD = 1e-5  # of log k where it is held fixed
_STEADY_NOISE = 0.1  # change of the log of a recording's noise between rounds, below which it has converged
_FEW, _LIKELY = 10, 5  # recordings; sampled values of the size of their differences
_STEPS_ON_THE_WAY = 20  # at most, in all rounds but the last


@dataclass(frozen=True)
class OptimizerSettings:
    """When the optimizer stops."""

    most_steps: int = 60
    coarse_rounds: int = 3  # first rounds, in which the tags' noise is taken as large as their residuals
    rounds: int = 6  # at most; each but the last ends with new hyperparameters, until the noise is steady
    on_the_way: float = 0.3  # as `tolerance`, in all rounds but the last
    tolerance: float = 0.02  # expected gain of the last step, as a share of one sd


@dataclass(frozen=True)
class Optimum:
    """The posterior, and why the optimizer stopped."""

    x: Array  # (P,) log k's mean over its hyperparameters, and all else where it is most probable with that
    covariance: normal.JointCovariance
    jumps: Array  # (p - 1,) mean steps of log k from coefficient to coefficient, without the smooth part
    shape: Array  # (levels, S) of the bands of log k, see `UncertainStiffness`
    hyperparameters: linear.Hyperparameters
    sizes: tuple[Sizes, ...]  # of the allowances, equally probable: those that the posterior is averaged over
    predictions: tuple[Prediction, ...]
    log_evidence: float
    steps: int
    converged: bool
    stopped: str


def estimate_at(problem: linear.FitProblem, x: Array, shapes: Sequence[Array | None] | None = None) -> MapEstimate:
    """The estimate to begin with, at parameters x; `shapes`: (F, Q) of each recording at x, where they are known.

    Raises:
        LearningError: the beam has no equilibrium there under the measured forces, or does not stand in a posture
            in which its frequencies were measured.
    """
    warm: Sequence[Array | None] = [None] * len(problem.recordings) if shapes is None else shapes
    if not problem.swings(x):
        raise LearningError(
            "with the mass as written, the beam would buckle under its weight in a posture in which it was seen to "
            "swing. Check mass_kg, length_m and the base_angle_deg of each [[frequencies]]"
        )
    predictions = each(lambda data, q: predict(data, problem.layout, x, q), problem.recordings, warm)
    if not all_converged(predictions):
        raise LearningError(
            "the start stiffness lets the beam snap through under the measured forces; start from a stiffer beam"
        )
    return MapEstimate(x, problem.expected, predictions)


def find_maximum(
    problem: linear.FitProblem, estimate: MapEstimate, settings: OptimizerSettings, progress: Progress
) -> MapEstimate:
    """The maximum a posteriori, from an estimate to begin with.

    Raises:
        LearningError: force logs with more error than force, so that k(s) goes to zero and the force with it.
    """
    steady = False
    try:
        for round_number in range(settings.rounds):
            last = steady or round_number == settings.rounds - 1
            if round_number < settings.coarse_rounds:
                estimate = replace(estimate, hyperparameters=_coarse(problem, estimate.predictions))
            most, tolerance = (
                (settings.most_steps, settings.tolerance) if last else (_STEPS_ON_THE_WAY, settings.on_the_way)
            )
            estimate = descend(problem, estimate, linear.prior(problem, estimate.hyperparameters), most, tolerance)
            progress.advance()
            if last:
                break
            if round_number >= settings.coarse_rounds - 1:
                before, after = estimate.hyperparameters, _new_hyperparameters(problem, estimate)
                estimate = replace(estimate, hyperparameters=after)
                changes = [np.log(b.marker / a.marker) for b, a in zip(before.noise, after.noise, strict=True)]
                steady = round_number >= settings.coarse_rounds and bool(np.max(np.abs(changes)) < _STEADY_NOISE)
    except np.linalg.LinAlgError:
        refuse_lost_force(problem, estimate)
        raise
    refuse_lost_force(problem, estimate)
    return estimate


def laplace_posterior(problem: linear.FitProblem, estimate: MapEstimate, settings: OptimizerSettings) -> Optimum:
    """The posterior around the maximum, averaged over the hyperparameters that the data leave open."""
    hyperparameters = estimate.hyperparameters
    evidence = evidence_at(problem, estimate)
    clear_slopes(estimate)
    sizes, log_evidence = _likely(evidence, hyperparameters), evidence.posterior(hyperparameters).log_evidence
    stiffness, covariance = averaged_posterior(evidence, hyperparameters, sizes)
    del evidence  # it holds the information of every recording
    x, predictions = _at_mean_stiffness(problem, estimate, stiffness.mean, covariance)
    return Optimum(
        x=x,
        covariance=covariance,
        jumps=stiffness.steps,
        shape=stiffness.shape,
        hyperparameters=hyperparameters,
        sizes=sizes,
        predictions=predictions,
        log_evidence=log_evidence,
        steps=estimate.steps,
        converged=estimate.converged,
        stopped=f"the last step moved the parameters by less than {settings.tolerance:g} sd"
        if estimate.converged
        else f"{settings.most_steps} steps were not enough",
    )


def _likely(evidence: Evidence, hyperparameters: linear.Hyperparameters) -> tuple[Sizes, ...]:
    """Equally probable sizes of the allowances: few recordings leave the differences between mountings open."""
    sizes, few = hyperparameters.sizes, len(evidence.problem.recordings) <= _FEW
    if BETWEEN not in sizes or not few:
        return (dict(sizes),)
    return tuple({**sizes, BETWEEN: float(f)} for f in likely_sizes(evidence, hyperparameters, BETWEEN, _LIKELY))


def _coarse(problem: linear.FitProblem, predictions: Sequence[Prediction]) -> linear.Hyperparameters:
    """The expected hyperparameters, with the tags' noise as large as their residuals: robust far from the maximum."""
    sizes = [float(np.sqrt(np.mean(linear.residuals(p) ** 2))) for p in predictions]
    pairs = zip(problem.expected.noise, sizes, strict=True)
    return replace(problem.expected, noise=tuple(replace(noise, marker=max(size, 1.5)) for noise, size in pairs))


def _at_mean_stiffness(
    problem: linear.FitProblem, estimate: MapEstimate, log_k: Array, covariance: normal.JointCovariance
) -> tuple[Array, tuple[Prediction, ...]]:
    """Log k at its mean (p,) and all else at its most probable value; the estimate itself if that fails."""
    p = problem.layout.spline.count
    follow = covariance.with_shared(slice(p))
    x = estimate.x + follow @ np.linalg.solve(follow[:p], log_k - estimate.x[:p])
    moved = each(lambda now: predict(now.data, problem.layout, x, now.solved.q, now.own), estimate.predictions)
    if not (all_converged(moved) and problem.swings(x)):
        return estimate.x, estimate.predictions
    variances = np.full_like(estimate.hyperparameters.part_variances, _HELD_SD**2)
    held = replace(estimate.hyperparameters, part_variances=variances)
    settled = descend(problem, MapEstimate(x, held, moved), linear.prior(problem, held, log_k), 10, 0.1)
    return (settled.x, settled.predictions) if settled.converged else (estimate.x, estimate.predictions)


def _new_hyperparameters(problem: linear.FitProblem, estimate: MapEstimate) -> linear.Hyperparameters:
    """Noise of every recording from its residuals, then all else by the evidence."""
    hyperparameters, rows = estimate.hyperparameters, rows_of(estimate)
    noise = each(new_noise, problem.recordings, rows, hyperparameters.noise, _spent(problem, estimate, rows))
    hyperparameters = replace(hyperparameters, noise=noise)
    evidence = Evidence(problem, linear.data_information(problem, rows, estimate.x, hyperparameters))
    hyperparameters = replace(hyperparameters, sizes=choose_sizes(evidence, hyperparameters))
    hyperparameters = with_sites(evidence, hyperparameters)
    return choose_hyperparameters(evidence, hyperparameters)


def _spent(problem: linear.FitProblem, estimate: MapEstimate, rows: Sequence[linear.ResidualRows]) -> tuple[float, ...]:
    """Effective number of parameters of each recording: trace of its tags' information times the covariance."""
    x, hyperparameters = estimate.x, estimate.hyperparameters
    data = linear.data_information(problem, rows, x, hyperparameters)
    posterior = linear.solved(data, linear.prior(problem, hyperparameters))

    def of(number: int, form: normal.InformationForm) -> float:
        j = linear.beside_tags(problem, number, x).j
        return float(np.sum(posterior.pair(number) * (form.matrix - j.T @ j)))

    return each(of, range(len(rows)), data.forms)


_FEWEST_FRAMES = 20  # of each of very many recordings


@dataclass(frozen=True)
class FitSettings:
    """How the marker-space fit runs."""

    functions: int = 45  # of the spline of log k
    most_frames: int = 500  # of each recording, after neighbours are averaged; `condensed.worth` may be fewer
    most_frames_together: int = 5000  # of all recordings
    first_frames: int = 24  # of each recording, for the way from the start to near the optimum
    first_recordings: int = 10  # evenly chosen, for the same
    clamp_sd: float | None = option("--clamp-sd-deg", None, within=NOT_NEGATIVE)  # rad
    optimizer: OptimizerSettings = field(default_factory=OptimizerSettings)
    first_rounds: int = 4  # at most, with the first frames
    last_rounds: int = 6  # at most, with all frames
    allowances: frozenset[str] = EVERY_ALLOWANCE  # what a real beam and bench may also do


def shared_among(settings: FitSettings, recordings: int) -> FitSettings:
    """The settings for so many recordings: each gives fewer frames, the more there are."""
    each_one = max(settings.most_frames_together // recordings, _FEWEST_FRAMES)
    return replace(settings, most_frames=min(settings.most_frames, each_one))


def first_recordings(recordings: Sequence[Observations], settings: FitSettings) -> list[int]:
    """Which recordings the fit begins with."""
    evenly = np.linspace(0, len(recordings) - 1, settings.first_recordings)
    return sorted({int(i) for i in evenly.round()})


def first_problem(
    recordings: Sequence[Observations], start: Profile | float, settings: FitSettings
) -> tuple[linear.FitProblem, Array]:
    """The problem with a few frames of some recordings, and the initial parameters (P,)."""
    spline, most = parameters.Spline(settings.functions), min(settings.first_frames, settings.most_frames)
    if widths := [o.width for o in recordings if o.width is not None and len(o.width)]:
        spline = parameters.with_width(spline, max(widths, key=len))
    data, layout = _prepared(recordings, [chosen_frames(o, most) for o in recordings], spline, settings)
    noise = tuple(expected_recording_noise(d) for d in data)
    x, level = starting(layout, start)
    expected = linear.Hyperparameters(layout.first_variances, 1.0, 1.0, 1.0, 1.0, noise)
    return linear.FitProblem(data, layout, level, expected, frequencies.frequency_data(recordings, spline)), x


def whole_problem(
    recordings: Sequence[Observations], problem: linear.FitProblem, settings: FitSettings
) -> linear.FitProblem:
    """The problem with all frames of all recordings."""
    spline = problem.layout.spline
    frames = each(lambda o: chosen_frames(o, min(settings.most_frames, condensed.worth(o))), recordings)
    data, layout = _prepared(recordings, frames, spline, settings)
    expected = replace(problem.expected, noise=tuple(expected_recording_noise(d) for d in data))
    return linear.FitProblem(data, layout, problem.level, expected, frequencies.frequency_data(recordings, spline))


def rewritten_problem(
    recordings: Sequence[Observations], problem: linear.FitProblem, settings: FitSettings, most: int | None = None
) -> linear.FitProblem:
    """The problem with the same frames of the same recordings, or `most` of them, described otherwise."""
    rows = [np.flatnonzero(one.frames) for one in problem.recordings]
    frames = [
        evenly_spread(r, most or len(r), len(one.frames)) for r, one in zip(rows, problem.recordings, strict=True)
    ]
    data, layout = _prepared(recordings, frames, problem.layout.spline, settings)
    return replace(problem, recordings=data, layout=layout)


def _prepared(
    recordings: Sequence[Observations], frames: Sequence[BoolArray], spline: parameters.Spline, settings: FitSettings
) -> tuple[tuple[FitData, ...], parameters.Layout]:
    """Data of the recordings in these frames (T,) of each, and their parameters."""
    known, allowances = parameters.known_shape(recordings), settings.allowances

    def of(number: int, o: Observations, mask: BoolArray) -> FitData:
        data = fit_data(o, number, mask, spline, allowances, known)
        if len(recordings) == 1 or BETWEEN not in allowances:
            return data
        return replace(data, allowances=(*data.allowances, between_recordings(data.problem.grid.nodes)))

    data = each(of, range(len(recordings)), recordings, frames)
    knots = [len(d.error.knots) for d in data]
    said = [] if settings.clamp_sd is None else [replace(o.stated, clamp_sd=settings.clamp_sd) for o in recordings]
    stated = [replace(o, stated=one) for o, one in zip(recordings, said, strict=True)] if said else list(recordings)
    return data, parameters.make_layout(spline, stated, knots, [d.allowances for d in data])


def starting(layout: parameters.Layout, start: Profile | float) -> tuple[Array, float]:
    """Parameters (P,) and the level of log k to begin with."""
    s = np.linspace(0.0, 1.0, 8 * layout.spline.count)
    k = np.full(len(s), float(start)) if isinstance(start, float | int) else np.asarray(start(s))
    if not np.all(k > 0.0):
        raise LearningError("the start stiffness must be positive everywhere")
    x, level = np.zeros(layout.size), float(np.mean(np.log(k)))
    own = np.log(k) if layout.known is None else np.full(len(s), level)
    x[: layout.spline.count] = np.linalg.lstsq(layout.spline.basis(s), own, rcond=None)[0]
    return x, level


def with_mass_found(
    recordings: Sequence[Observations], problem: linear.FitProblem, near: MapEstimate
) -> tuple[Sequence[Observations], MapEstimate]:
    """Recordings and estimate with a guessed mass replaced by the fitted one; its uneven parts are relative to it."""
    if not any(np.isfinite(o.stated.mass_sd) for o in recordings):
        return recordings, near
    mass, even = problem.layout.index["mass", -1].where, np.array([1.0, 0.0, 0.0, 0.0])
    factor, x = 1.0 + max(float(near.x[mass.start]), -0.9), near.x.copy()
    x[mass] = (x[mass] + even) / factor - even
    heavier = [replace(o, stated=replace(o.stated, mass=factor * o.stated.mass)) for o in recordings]
    return heavier, replace(near, x=x)


def carried_over(
    problem: linear.FitProblem, near: MapEstimate, whole: linear.FitProblem, some: list[int]
) -> MapEstimate:
    """An estimate for all frames of all recordings, from that for a few frames of `some`. Own parameters of the others
    begin at their prior mean, their noise at the median."""
    x, found = np.zeros(whole.layout.size), near.hyperparameters
    for (name, recording), block in whole.layout.index.items():
        if block.start >= 0 and (recording < 0 or recording in some):
            x[block.where] = problem.layout.get(near.x, name, recording if recording < 0 else some.index(recording))
        elif block.start >= 0 and name == "force":
            x[block.where] = whole.recordings[recording].error.mean.ravel()
    pairs = list(zip(found.noise, problem.expected.noise, strict=True))
    marker, force = (
        float(np.median(one)) for one in zip(*((f.marker, f.force / e.force) for f, e in pairs), strict=True)
    )
    noise = tuple(
        found.noise[some.index(i)] if i in some else linear.RecordingNoise(marker, force * before.force)
        for i, before in enumerate(whole.expected.noise)
    )
    shapes: list[Array | None] = [None] * len(whole.recordings)
    for i, few, prediction in zip(some, problem.recordings, near.predictions, strict=True):
        every, q = whole.recordings[i], prediction.solved.q
        if np.array_equal(few.problem.grid.nodes, every.problem.grid.nodes):
            same = np.array_equal(few.frames, every.frames)
            shapes[i] = q if same else None if every.observations.static else between(few, every, q)
    clear_slopes(near)
    begin = estimate_at(whole, x, shapes)
    return with_own_forces(replace(begin, hyperparameters=replace(found, noise=noise), steps=near.steps))


def between(few: FitData, every: FitData, q: Array) -> Array:
    """(F, Q) shapes of every frame of a film, between those of a few of them: of several equilibria those nearby."""
    known, wanted = (one.observations.time[one.frames] for one in (few, every))
    rows = [np.interp(wanted, known, column) for column in q[: len(known)].T]
    return np.concatenate([np.stack(rows, axis=1), q[len(known) :]])


# Static poses may have several equilibria. Poses without a stable one near their points wait; at each maximum all poses
# choose anew. Poses that remain far from every stable equilibrium are left out.

_ROUNDS = 6  # of choosing, at most
_SAME = 1e-3  # of the length: poses whose tags are nearer are in one equilibrium


def find_on_branches(
    problem: linear.FitProblem, estimate: MapEstimate, settings: OptimizerSettings, progress: Progress
) -> tuple[linear.FitProblem, MapEstimate]:
    """The maximum a posteriori from an estimate to begin with, and the problem without the poses that were left out."""
    if all(data.poses is None for data in problem.recordings):
        return problem, find_maximum(problem, estimate, settings, progress)
    kept = [_explained(one) for one in estimate.predictions]
    for _ in range(_ROUNDS):
        begin = tuple(map(_part, estimate.predictions, kept))
        some = replace(problem, recordings=tuple(one.data for one in begin))
        found = find_maximum(some, replace(estimate, predictions=begin, converged=False), settings, progress)
        again = tuple(map(_chosen_anew, problem.recordings, kept, found.predictions))
        estimate = replace(found, predictions=again)
        before, kept = kept, [_explained(one) for one in again]
        if all(map(_same, before, kept, found.predictions, again)):
            break
        progress = Silent()
    return some, found


def _part(every: Prediction, kept: BoolArray) -> Prediction:
    """Some frames (F,) of a recording of poses."""
    if np.all(kept):
        return every
    data, chosen = every.data, every.data.frames.copy()
    chosen[np.flatnonzero(chosen)[~kept]] = False
    part = fit_data(data.observations, data.number, chosen, every.layout.spline)
    return predict(part, every.layout, every.x, None, every.own[kept])


def _chosen_anew(data: FitData, kept: BoolArray, now: Prediction) -> Prediction:
    """Every pose in the equilibrium nearest to its points; a film unchanged."""
    if data.poses is None:
        return now
    own = np.zeros_like(data.force)
    own[kept] = now.own
    return predict(data, now.layout, now.x, None, own)


def _explained(prediction: Prediction) -> BoolArray:
    """(F,) frames near a stable equilibrium; of a film all."""
    data = prediction.data
    off = data.off(prediction.pose)
    if data.poses is None or len(off) == 1:
        return np.ones(len(off), dtype=bool)
    return ~static_poses.unexplained(
        np.where(_is_free(data), static_poses.pose_rms(off), 0.0), data.observations.length
    )


def _same(before: BoolArray, now: BoolArray, found: Prediction, again: Prediction) -> bool:
    """Whether no pose of a recording has changed, nor its equilibrium."""
    if not np.array_equal(before, now):
        return False
    change = np.abs(found.pose - again.pose[before])[_is_free(again.data)[before], :, :2]
    return bool(np.max(change, initial=0.0) < _SAME * again.data.observations.length)


def _is_free(data: FitData) -> BoolArray:
    """(F,) frames with a free end."""
    free = np.ones(len(data.measured), dtype=bool)
    if data.ends is not None:
        free[data.ends.frames] = False
    return free
