"""The state of a live learner: key frames, their posterior and the sizes of noise, renewed with every frame."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.stiffness import Profile, UncertainStiffness
from onebend.errors import LearningError
from onebend.learning.force_error import sized, spanned_error
from onebend.learning.hyperparameters import CHOSEN, SPREAD, averaged_stiffness
from onebend.learning.linear import Hyperparameters, RecordingNoise
from onebend.learning.normal import Draws
from onebend.learning.optimizer import starting
from onebend.learning.parameters import Layout
from onebend.learning.sites import first_site, updated
from onebend.live import key_frames, posterior as posteriors, residuals
from onebend.live.hyperparameters import OnlineSettings, StiffnessChains, expected_error
from onebend.live.key_frames import CheckedFrame, CourseSoFar, LoadStages, expect_shape, write_frame
from onebend.live.model import MOST_NODES, Lineariser, LiveSession, problem_of
from onebend.records import Array, BoolArray, ForceNoise
from onebend.report.sentences import say

_EXACT = 1e-12  # of the largest variance of a start: smaller ones are rounding


@dataclass(frozen=True)
class Start:
    """Where the learner begins."""

    x: Array  # (n,)
    level: float  # prior mean of log k
    stiffness: tuple[Array, Array] | None  # see `FitProblem`


def start_of(layout: Layout, start: Profile | float | UncertainStiffness) -> Start:
    if not isinstance(start, UncertainStiffness):
        x, level = starting(layout, start)
        return Start(x, level, None)
    x, p = np.zeros(layout.size), layout.spline.count
    if len(start.mean) < p:
        raise LearningError(
            f"the stiffness to go on from has {len(start.mean)} functions, fewer than the {p} of the settings: "
            "fit it with more, or go on with fewer"
        )
    s = np.linspace(0.0, 1.0, 8 * len(start.mean))
    onto = np.linalg.lstsq(layout.spline.basis(s), start.basis(s), rcond=None)[0]
    offset = np.zeros(p) if start.offset is None else layout.spline.nearest(start.offset)
    x[:p] = onto @ start.mean + offset
    size, ways = np.linalg.eigh(onto @ start.covariance @ onto.T)
    root = np.asarray(np.linalg.qr((ways * np.sqrt(np.maximum(size, _EXACT * size[-1]))).T, mode="r")).T
    return Start(x, float(np.mean(x[:p])), (x[:p], root))


_LAST = 2.0  # posterior sd of log k, RMS: a larger step is not the last
_SETTLED = 2  # solutions in a row without such a step: one may end a step short by chance
_MOST = 0.5  # of the tags: as many are not where they are expected because the estimate is wrong
_MOVED = 0.3  # posterior sd of log k, RMS: a larger step moves the linearisation point
_MANY = 6  # key frames linearised with one frame: after more, nothing else is done in that update
_STRIDE, _LAST_LOOKS = 0.05, 10  # sd, of the sizes of the force's error in one look for better ones; after a push
_WHITE_SPREAD = 0.7  # sd of the log of the force error's white part
_SETTLED_STEPS = 40  # of the chains, after a push
_DRAWS = Draws(chains=10, burn=2, kept=1, shaped=False)  # for a reading, of each node of the cubature
_TURNS = 8  # of so many updates without a solution one looks for a missed tag, one counts the effective parameters


class Smoother:
    """All state of a live learner; its size is fixed when it is made."""

    def __init__(self, session: LiveSession, start: Start, settings: OnlineSettings) -> None:
        traced, n = ~session.course.on_body, session.layout.size
        tags = len(traced)
        self.x = start.x  # (n,) the estimate
        self.point = start.x  # (n,) where all frames are linearised, or their mismatch would look like information
        self.keys = key_frames.empty(settings.key_frames, traced, n, MOST_NODES, session.terms.count)
        self.marginalised = posteriors.nothing_marginalised(n)
        self._session, self._start, self._settings = session, start, settings
        spline, noise = session.layout.spline, RecordingNoise(settings.marker_noise, settings.force.white)
        parts = spline.variances(settings.roughness, settings.steps)
        self.hyperparameters = Hyperparameters(parts, 1.0, 1.0, 1.0, 1.0, (noise,))
        drawn = settings.adapt and start.stiffness is None
        self._chains = StiffnessChains(spline, start.level, settings.roughness, settings.steps) if drawn else None
        self._stages, self._course = LoadStages(session.length, tags), CourseSoFar(session.course, session.terms)
        self._sites = [first_site(block) for block in session.bounded]
        self._spent, self._turns = 0.0, 0
        self._linearised = 0  # key frames linearised in the last update
        self.misfit = np.zeros(tags)  # (m,) of the markers, over their covariances; 0 while it is no more than noise
        self._failed = False  # whether the last solution failed
        self._unsettled = 0  # how many more solutions must be near the linearisation point
        self._missed = ""  # what `missed_tag` returned last
        self._too_soft = False  # whether the last frame had no equilibrium
        self.pending = True  # whether a frame has come since the last solution
        self._lineariser = Lineariser(session)
        self._away = np.zeros(tags, dtype=np.int64)
        self._largest = 0.0
        self._expected = np.zeros(2), np.zeros(0), 0.0  # force error of the last frame, before its tags count
        self.solution = self._solve()

    @property
    def marker(self) -> float:
        """Size of the tags' noise, over their covariances; without tags of the outline's."""
        return self.hyperparameters.noise[0].marker

    @property
    def sizes(self) -> Array:
        """(m,) sizes of the markers' noise, over their covariances: beside tags an outline's is as stated."""
        traced = self.keys.traced
        return np.where(traced & ~traced.all(), 1.0, self.marker)

    @property
    def noise(self) -> Array:
        """(m,) the same, a misfit beyond it included."""
        return np.maximum(self.sizes, self.misfit)

    def enter(self, frame: CheckedFrame, rate: Array) -> bool:
        """Add the frame as the last key frame, linearised; False where it has no equilibrium and is left out.

        Also linearise all others where the linearisation point has moved, and average or marginalise to make room.
        """
        keys = self.keys
        self._stages.add_frame(frame.time, frame.measured[:, :2], frame.visible, frame.loaded)
        i = self._write(frame, rate)
        over = 0 if self.pending else keys.used - self._settings.key_frames  # an update that solves does no averaging
        pairs = key_frames.closest_pairs(keys, i, self._largest, self._stages.own(keys.centre), over)
        fresh = [i]
        for slot, pair in enumerate(pairs, keys.used):
            key_frames.propose_average(keys, pair, slot)
            fresh.append(slot)
        fresh += np.flatnonzero(keys.stale[:i]).tolist()
        solved = self._linearise(fresh)
        self._too_soft = i not in solved
        if self._too_soft:
            keys.used -= 1
            return False
        if frame.loaded:
            self._largest = max(self._largest, float(np.linalg.norm(frame.force)))
        missed = set(fresh) - solved
        for pair, slot in sorted(zip(pairs, range(keys.used, keys.used + len(pairs)), strict=True), reverse=True):
            if missed.isdisjoint((pair, pair + 1, slot)):
                key_frames.accept_average(keys, pair, slot, self.point)
        while keys.used > self._settings.key_frames + 1:
            posteriors.marginalise_oldest(keys, self.marginalised, self._process, self.noise, self._stages.own)
        return True

    def _linearise(self, chosen: list[int]) -> set[int]:
        """Linearise the chosen key frames; returns those that have an equilibrium. The others count as lost."""
        self._linearised = len(chosen)
        solved = self._lineariser.renew(self.keys, chosen, self.point)
        gone = [k for k in chosen if k not in solved]
        self.keys.lost[gone], self.keys.stale[gone] = True, False
        return solved

    def _write(self, frame: CheckedFrame, rate: Array) -> int:
        """Write the frame behind the key frames in use; returns its index."""
        course, stages, angle, tags = self._course, self._stages, frame.measured[:, 2], frame.visible
        if frame.loaded:
            bend, back = stages.displacement / self._session.length, stages.falling
            terms = course.terms(angle, tags, frame.force, frame.push_s, bend=bend, back=back)
        else:
            terms = course.rest(angle, tags)
        keys, i = self.keys, write_frame(self.keys, frame, rate, terms)
        if frame.loaded:
            self._lineariser.pushed_at(frame.push_s)
        now = float(self._stages.own(np.array([frame.time]))[0])
        self._expected = self.solution.predicted_error(frame.time, now)
        expect_shape(keys, i, self._expected[0])
        return i

    def gate(self, frame: CheckedFrame) -> tuple[Array, Array, BoolArray]:
        """Innovation (m, 3) of the last key frame, its distance (m,) in sd, and which tags are used.

        A tag too far from where it was expected gets no weight, unless that lasts for some frames.
        """
        keys, i = self.keys, self.keys.used - 1
        innovation, distance = residuals.surprise(keys, frame, self.solution, self.x, self.sizes, self._expected[1:])
        far = frame.visible & (distance > self._settings.gate)
        self._away = np.where(far, self._away + 1, np.where(frame.visible, 0, self._away))
        used = np.asarray(frame.visible & (~far | (self._away >= self._settings.patience)))
        keys.weight[i] = used
        if not np.array_equal(used, frame.visible):
            keys.information[i] *= used[:, None, None]
            keys.root[i] *= used[:, None, None]
            keys.whiten(i)
        innovation[~frame.visible], distance[~frame.visible] = np.nan, np.nan
        return innovation, distance, used

    def advance(self) -> None:
        """After a frame: every other update solves for the posterior. The updates between take one step of the chains
        or seek other hyperparameters; after many linearisations they do neither, so that all updates cost alike.
        """
        if self.pending or self._failed:
            self.pending = False
            self.renew()
            return
        self.pending = True
        if self._linearised > _MANY:
            return
        self._turns += 1
        if self._turns % _TURNS == 0:
            self._missed = residuals.missed_tag(self.keys)
        elif self._turns % 2 and self._chains is not None:
            if not self.misfit.any():
                self._chains.step(self.solution.stiffness_form)
        elif self._settings.adapt and self._turns % _TURNS == 2:
            self._spent = self.solution.effective_parameters
        elif self._settings.adapt and self._turns % _TURNS == 4:
            self.look_about()
        elif self._turns % _TURNS == 6:
            self.renew_sites()

    def look_about(self) -> None:
        """Take better sizes of the force error, by the last solution's evidence."""
        with suppress(np.linalg.LinAlgError):
            chosen = self.solution.likelier(self.hyperparameters, _STRIDE)
            self.solution, self.hyperparameters = self.solution.model.posterior(chosen), chosen

    def renew_sites(self) -> None:
        """Renew the normal priors that stand for those with bounds, see `learning.sites`."""
        solution = self.solution
        for i, block in enumerate(self._session.bounded):
            rows = np.zeros((len(block.prior_sd), len(solution.x) + solution.e.size))
            rows[:, solution.e.size :][:, block.where] = np.eye(len(rows))
            mean, covariance = solution.x[block.where], solution.spread(rows)
            self._sites[i] = updated(block, self._sites[i], mean, covariance)

    def renew(self) -> bool:
        """Solve for the posterior, move the estimate, and renew the robust weights. False where the solution fails: the
        last one stays, and `doubts` says so until a later one succeeds."""
        keys, settings = self.keys, self._settings
        if self._chains is not None:
            self.hyperparameters = replace(self.hyperparameters, part_variances=self._chains.parts)
        self.misfit = residuals.misfit(keys, self.sizes)
        try:
            self.solution = solution = self._solve()
        except np.linalg.LinAlgError:
            self._failed = True
            return False
        self._failed = False
        self.x, fresh = self._within_reach(solution.x), not np.any(keys.stale[: keys.used])
        step = (solution.x - self.point)[: solution.count]
        size = np.mean(step**2 / np.diag(solution.solved.of_shared))
        self._unsettled = max(self._unsettled - fresh, 0) if size < _LAST**2 else _SETTLED
        residual = residuals.tag_residuals(keys, solution)
        if settings.adapt:
            marker = residuals.tag_noise_size(keys, residual, self._spent, settings.marker_noise)
            noise = replace(self.hyperparameters.noise[0], marker=marker)
            self.hyperparameters = replace(self.hyperparameters, noise=(noise,))
        keys.weight[: keys.used] = residuals.robust_weights(keys, residual, self.noise, settings.bulk)
        if fresh and size > _MOVED**2:
            self.move()
        return True

    def _within_reach(self, x: Array) -> Array:
        """Parameters on the way to x (n,), at most as far from where all is linearised as one step goes."""
        step = x - self.point
        largest = max(float(np.max(np.abs(step[: self._session.layout.spline.count]))), 1e-300)
        return np.asarray(self.point + step * min(1.0, self._settings.step / largest))

    def _solve(self) -> posteriors.KeyFramePosterior:
        """The posterior over the key frames as they are; a misfit beyond the markers' noise counts as noise."""
        keys, settings, session = self.keys, self._settings, self._session
        spans = posteriors.spans_of(keys, self.marginalised, self._stages.own)
        expected = replace(self.hyperparameters, coloured=1.0, memory=1.0, walk=1.0, load=1.0, white=1.0)
        error, start = spanned_error(self._expected_error, spans), (self._start.level, self._start.stiffness)
        p, white = session.layout.spline.count, self._process.white
        form = posteriors.information(keys, self.marginalised, p, sizes=self.noise, white=white)
        spread = np.where(np.array(CHOSEN) == "memory", settings.memory_doubt, np.append(SPREAD, _WHITE_SPREAD))
        model = posteriors.model_of(form, self._before, problem_of(session, error, start, expected), spread)
        return model.posterior(self.hyperparameters)

    @property
    def _process(self) -> ForceNoise:
        """The force's error, as it is now."""
        return sized(self._expected_error, *self.hyperparameters.of_force)

    @property
    def _expected_error(self) -> ForceNoise:
        return expected_error(self._settings, self._largest, self._rough > residuals.FAR_OFF)

    @property
    def _rough(self) -> float:
        """The misfit over the noise."""
        return float(np.max(self.misfit / self.sizes))

    def catch_up(self) -> None:
        """Solve now if a frame has come since the last time."""
        if self.pending and self.keys.used:
            self.renew()
            self.pending = False

    def settle(self, rounds: int) -> None:
        """Linearise all key frames and solve, several times; then try other hyperparameters for two rounds."""
        self.catch_up()
        if self._failed and not self.renew():  # its force errors belong to other key frames
            return
        for _ in range(rounds):
            self.move()
            self._linearise(list(range(self.keys.used)))
            if not self.renew():
                return
            self.renew_sites()
        if self._settings.adapt:
            for _ in range(_SETTLED_STEPS):
                if self._chains is not None:
                    self._chains.step(self.solution.stiffness_form)
            for _ in range(_LAST_LOOKS):
                self.look_about()

    def move(self) -> None:
        """Make the present estimate the linearisation point."""
        keys = self.keys
        self.point = self.x
        keys.error[: keys.used] = self.solution.e[len(self.solution.e) - keys.used :]
        keys.stale[: keys.used] = True

    def stiffen(self, amount: float) -> None:
        """Raise log k by `amount` and linearise there: the beam withstood a force that the estimate cannot."""
        self.x = self.x.copy()
        self.x[: self._session.layout.spline.count] += amount
        self.point = self.x
        self.keys.stale[: self.keys.used] = True

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons not to rely on the posterior as it is now; usually none."""
        self.catch_up()
        self._missed = residuals.missed_tag(self.keys)
        return self.last_doubts

    @property
    def last_doubts(self) -> tuple[str, ...]:
        """The same, with the missed tag of the last look for one."""
        unsettled = self._unsettled > 0 or np.mean(self._away > 0) > _MOST
        reasons = {"live: failed": self._failed, "live: too soft": self._too_soft, "live: unsettled": unsettled}
        own = residuals.key_frame_doubts(self.keys, self._rough, self._missed)
        return (*(say(code) for code, holds in reasons.items() if holds), *own)

    def posterior(self) -> tuple[Array, Array, Array]:
        """(n,) and (n, n) of the parameters, and mean steps (p - 1,) of log k, averaged over the hyperparameters."""
        self.catch_up()
        solution, p = self.solution, self._session.layout.spline.count
        k, covariance, steps = solution.x[:p], solution.solved.pair(0)[:p, :p], np.zeros(p - 1)
        if self._settings.adapt:
            chains = None if self._chains is None else self._chains.drawn
            nodes = solution.at_nodes(len(SPREAD))  # the white part keeps its size
            stiffness = averaged_stiffness(solution.model.evidence, nodes, _DRAWS, chains)
            k, covariance, steps = stiffness.mean, stiffness.covariance, stiffness.steps
        x, covariance = self._within_reach(solution.given_stiffness(k)), solution.covariance(covariance)
        return *self._lineariser.secant(self.keys, self.point, x, covariance), steps

    @property
    def nuisance_sd(self) -> Array:
        """(n - p,) one sd before the data of all parameters but log k's coefficients."""
        return self._session.other_sd(self._largest, self._stages.largest / self._session.length)

    @property
    def _before(self) -> tuple[Array, Array]:
        """(n - p,) means and sds of these before the data, those with bounds by their sites."""
        sd, p = self.nuisance_sd, self._session.layout.spline.count
        mean = np.zeros_like(sd)
        for block, site in zip(self._session.bounded, self._sites, strict=True):
            at = slice(block.start - p, block.where.stop - p)
            mean[at], sd[at] = site
        return mean, sd
