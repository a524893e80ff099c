"""The state of the live learner: key frames, their posterior, and the search for the hyperparameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.learning.allowances.causal import CourseSoFar
from onebend.learning.live.doubts import FAILED, FAR_OFF, TOO_SOFT, key_frame_doubts, misfit, missed_tag
from onebend.learning.live.force_hyperparameters import HyperparameterSearch
from onebend.learning.live.force_process import ForceProcess, LoadStages
from onebend.learning.live.incoming_frame import CheckedFrame, expect_shape, surprise, write_frame
from onebend.learning.live.key_frame_posterior import (
    KeyFramePosterior,
    KeyFrameSums,
    LiveHyperparameters,
    LivePrior,
    gather,
    solve,
)
from onebend.learning.live.key_frames import accept_average, closest_pairs, empty, propose_average
from onebend.learning.live.linearised_frames import Lineariser
from onebend.learning.live.marginalised import marginalise_oldest, nothing_marginalised
from onebend.learning.live.session import MOST_PANELS, ORDER, LiveSession, SmootherSettings
from onebend.learning.live.settings import force_process
from onebend.learning.live.stiffness_hyperparameters import StiffnessChains
from onebend.learning.live.tag_noise import robust_weights, tag_noise_size, tag_residuals
from onebend.records import Array, BoolArray

_MOVED = 0.5  # posterior sd: a larger distance from the linearisation point moves that point
_NOISE_EVERY = 8  # of so many trials one counts the effective parameters instead
_MANY = 6  # key frames linearised with one frame: after more, nothing else is done in that update
_MISSED_EVERY = 8  # of so many updates without a solution one looks for a missed tag


class Smoother:
    """All state of a live learner; its size is fixed when it is made."""

    def __init__(
        self,
        session: LiveSession,
        prior: LivePrior,
        x: Array,
        hyperparameters: LiveHyperparameters,
        settings: SmootherSettings,
    ) -> None:
        tags, n = len(session.marker_s), session.layout.size
        self.x = x  # (n,) the estimate
        self.point = x  # (n,) linearisation point; one for all frames, or their mismatch would look like information
        self.hyperparameters = hyperparameters
        self.keys = empty(settings.key_frames, tags, n, MOST_PANELS * ORDER)
        self.marginalised = nothing_marginalised(n)
        self._session, self._prior, self._settings = session, prior, settings
        self._search = HyperparameterSearch(hyperparameters, settings.memory_doubt)
        spline, level = session.layout.spline, float(prior.mean[0])
        begin = spline.variances(settings.roughness, settings.steps)
        self._stiffness_prior = prior.stiffness_prior(begin)
        drawn = settings.adapt and prior.fixed is None
        self._chains = StiffnessChains(spline, level, settings.roughness, settings.steps) if drawn else None
        self._stages, self._course = LoadStages(session.length, tags), CourseSoFar(session.marker_s)
        self._before = 0.0  # the load's own time from changes of the load that are settled
        self._guess, self._spent = hyperparameters.marker, 0.0
        self._looks, self._turns = 0, 0
        self._linearised = 0  # key frames linearised in the last update
        self._misfit = 0.0  # of the tags, over their covariances; 0 while it is no more than noise
        self._failed = False  # whether the last solution failed
        self._missed = ""  # what `missed_tag` returned last
        self._too_soft = False  # whether the last frame had no equilibrium
        self.pending = True  # whether a frame has come since the last solution
        self._lineariser = Lineariser(session)
        self._away = np.zeros(tags, dtype=np.int64)
        self._largest = 0.0
        self._expected = np.zeros(2), np.zeros(0), 0.0  # force error of the last frame, before its tags count
        self._sums: KeyFrameSums = gather(self.keys, self.marginalised)
        self.solution: KeyFramePosterior = solve(
            self._sums, prior, self._stiffness_prior, hyperparameters, self._process(hyperparameters)
        )

    def enter(self, frame: CheckedFrame, rate: Array) -> bool:
        """Add the frame as the last key frame, linearised; False where it has no equilibrium and is left out.

        Also linearise the stale key frames that have waited longest, and average or marginalise others to make room.
        """
        keys = self.keys
        self._stages.add_frame(frame.time, frame.measured[:, :2], frame.visible, frame.loaded)
        i = self._write(frame, rate)
        over = 0 if self.pending else keys.used - self._settings.key_frames  # an update that solves does no averaging
        own = keys.own[: keys.used] + self._stages.own(keys.centre)
        pairs = closest_pairs(keys, i, self._largest, own, over)
        fresh = [i]
        for slot, pair in enumerate(pairs, keys.used):
            propose_average(keys, pair, slot)
            fresh += [slot, *(k for k in (pair, pair + 1) if keys.stale[k])]
        if keys.stale[0] and 0 not in fresh and keys.used - len(pairs) > self._settings.key_frames + 1:
            fresh.append(0)  # it is marginalised next, with the linearisation that it has then
        room = 1 if self.pending else self._settings.renewed - len(fresh) + 1
        waiting = [k for k in np.flatnonzero(keys.stale[:i]).tolist() if k not in fresh][: max(room, 0)]
        solved = self._linearise([*fresh, *self._lineariser.near(keys, waiting, i)])
        self._too_soft = i not in solved
        if self._too_soft:
            keys.used -= 1
            return False
        if frame.loaded:
            self._largest = max(self._largest, float(np.linalg.norm(frame.force)))
        missed = set(fresh) - solved
        for pair, slot in sorted(zip(pairs, range(keys.used, keys.used + len(pairs)), strict=True), reverse=True):
            if missed.isdisjoint((pair, pair + 1, slot)):
                accept_average(keys, pair, slot, self.point)
        while keys.used > self._settings.key_frames + 1:
            marker = max(self.hyperparameters.marker, self._misfit)
            marginalise_oldest(keys, self.marginalised, self._process(self.hyperparameters), marker, self._stages.own)
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
        bend, back = self._stages.displacement / self._session.length, self._stages.falling
        angle, tags = frame.measured[:, 2], frame.visible
        terms = self._course.terms(angle, tags, bend, frame.push_s, back=back, loaded=frame.loaded)
        keys, i = self.keys, write_frame(self.keys, frame, rate, terms)
        if frame.loaded:
            self._lineariser.pushed_at(frame.push_s)
        self._forget_changes(i)
        now = keys.own[i] + float(self._stages.own(np.array([frame.time]))[0])
        self._expected = self.solution.predicted_error(frame.time, now)
        expect_shape(keys, i, self._expected[0])
        return i

    def _forget_changes(self, i: int) -> None:
        """Add the settled changes of the load to the own times of the frames before; i: the frame that just came."""
        keys, self.keys.own[i] = self.keys, self._before
        added, after = self._stages.forgotten(np.append(keys.centre, self.marginalised.time))
        keys.own[: keys.used] += added[:-1]
        self.marginalised.own += float(added[-1])
        self._before += after

    def gate(self, frame: CheckedFrame) -> tuple[Array, Array, BoolArray]:
        """Innovation (m, 3) of the last key frame, its distance (m,) in sd, and which tags are used.

        A tag too far from where it was expected gets no weight, unless that lasts for some frames.
        """
        keys, i = self.keys, self.keys.used - 1
        marker, expected = self.hyperparameters.marker, self._expected[1:]
        innovation, distance = surprise(keys, frame, self.solution, self.x, marker, expected)
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
        or try other hyperparameters; after many linearisations they do neither, so that all updates cost alike.
        """
        if self.pending or self._failed:
            self.pending = False
            self.renew()
            return
        self.pending = True
        if self._linearised > _MANY:
            return
        self._turns += 1
        if self._turns % _MISSED_EVERY == 0:
            self._missed = missed_tag(self.keys)
        elif self._turns % 2 and self._chains is not None:
            if self._misfit == 0.0:
                self._chains.step(self.solution.stiffness_form)
        elif self._settings.adapt:
            self.look_about()

    def look_about(self) -> None:
        """Try other hyperparameters on the last solution's sums, or count the effective parameters."""
        self._looks += 1
        if self._looks % _NOISE_EVERY == 0:
            self._spent = self.solution.effective_parameters(self._prior, self._stiffness_prior)
        else:
            tried = self._search.trial(self.hyperparameters, self.solution, self._solve)
            self.hyperparameters, self.solution = tried

    def renew(self) -> bool:
        """Solve for the posterior, move the estimate, and renew the robust weights. False where the solution fails: the
        last one stays, and `doubts` says so until a later one succeeds."""
        keys, settings = self.keys, self._settings
        self._sums = gather(keys, self.marginalised, self._stages.own)
        bend = self._stages.largest / self._session.length
        self._prior = replace(self._prior, scale=self._session.prior_scale(self._largest, bend))
        if self._chains is not None:
            self._stiffness_prior = self._prior.stiffness_prior(self._chains.parts)
        self._misfit = misfit(keys, self.hyperparameters.marker)
        try:
            self.solution = solution = self._solve(self.hyperparameters)
        except np.linalg.LinAlgError:
            self._failed = True
            return False
        self._failed = False
        step = solution.x - self.x
        largest = max(float(np.max(np.abs(step[: self._session.layout.spline.count]))), 1e-300)
        self.x = self.x + step * min(1.0, settings.step / largest)
        residual = tag_residuals(keys, solution)
        if settings.adapt:
            marker = tag_noise_size(keys, residual, self._spent, self._guess)
            self.hyperparameters = replace(self.hyperparameters, marker=marker)
        marker = max(self.hyperparameters.marker, self._misfit)
        keys.weight[: keys.used] = robust_weights(keys, residual, marker, settings.bulk)
        fresh = not np.any(keys.stale[: keys.used])
        if fresh and solution.distance(keys.error[: keys.used], self.x - self.point) > _MOVED:
            self.move()
        return True

    def _solve(self, hyperparameters: LiveHyperparameters) -> KeyFramePosterior:
        """The posterior under these hyperparameters; a misfit beyond the tags' noise counts as noise."""
        coarse = replace(hyperparameters, marker=max(hyperparameters.marker, self._misfit))
        return solve(self._sums, self._prior, self._stiffness_prior, coarse, self._process(hyperparameters))

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
        if self._settings.adapt:
            for _ in range(2 * self._search.round):
                self.look_about()
                if self._chains is not None:
                    self._chains.step(self.solution.stiffness_form)

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
        self._missed = missed_tag(self.keys)
        return self.last_doubts

    @property
    def last_doubts(self) -> tuple[str, ...]:
        """The same, with the missed tag of the last look for one."""
        reasons = {FAILED: self._failed, TOO_SOFT: self._too_soft}
        return tuple(words for words, holds in reasons.items() if holds) + key_frame_doubts(
            self.keys, self.hyperparameters.marker, self._misfit, self._missed
        )

    def posterior(self) -> tuple[Array, Array, Array]:
        """(n,) and (n, n) of the parameters, and mean steps (p - 1,) of log k, averaged over the hyperparameters."""
        solution, p = self.solution, self._session.layout.spline.count
        if self._chains is None:
            k, covariance, steps = solution.x[:p], solution.covariance()[:p, :p], np.zeros(p - 1)
        else:
            k, covariance, steps = self._chains.mixed(solution.stiffness_form)
        x, covariance = solution.with_stiffness(*self._search.averaged(k, covariance))
        return *self._lineariser.secant(self.keys, self.point, x, covariance), steps

    @property
    def nuisance_sd(self) -> Array:
        """(n - p,) one sd before the data of all parameters but log k's coefficients."""
        return self._prior.nuisance_sd

    def _process(self, hyperparameters: LiveHyperparameters) -> ForceProcess:
        """The force log's error under these hyperparameters."""
        far_off = self._misfit > FAR_OFF * hyperparameters.marker
        return force_process(self._settings, hyperparameters, self._largest, far_off)
