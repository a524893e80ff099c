"""k(s) while the beam is being pushed: the posterior of the marker-space fit, renewed with every frame.

A bounded set of key frames stands for all frames so far (`key_frames.py`). Each update linearises a few of them anew
and solves for the posterior over all of them (`posterior.py`), so a poor start is forgotten. Memory and time per update
do not grow.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.grid import powers_to_legendre
from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Profile, UncertainStiffness, Uniform
from onebend.errors import LearningError
from onebend.learning.allowances import OF_ONE
from onebend.learning.force_error import sized, spanned_error
from onebend.learning.hyperparameters import CHOSEN, SPREAD, averaged_posterior, likeliest
from onebend.learning.linear import Hyperparameters, RecordingNoise
from onebend.learning.normal import Draws
from onebend.learning.optimizer import MISS, starting
from onebend.learning.parameters import Layout, Spline
from onebend.learning.posterior import Nuisance
from onebend.live import key_frames
from onebend.live.hyperparameters import OnlineSettings, StiffnessChains, expected_error
from onebend.live.key_frames import CourseSoFar, KeyFrames, LoadStages
from onebend.live.model import MOST_NODES, Lineariser, LiveSession, problem_of, session_of
from onebend.live.posterior import (
    KeyFramePosterior,
    LiveHyperparameters,
    force_in,
    information,
    marginalise_oldest,
    model_of,
    nothing_marginalised,
    robust_weights,
    spans_of,
    tag_noise_size,
    tag_residuals,
    without_force,
)
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray, ForceNoise
from onebend.report.sentences import say


@dataclass(frozen=True)
class CheckedFrame:
    """m tags and a force at one time."""

    time: float  # s
    measured: Array  # (m, 3) m, m, rad; 0 where not seen
    covariance: Array  # (m, 3, 3); the unit matrix where not seen
    root: Array  # (m, 3, 3) R with R' R its inverse; zero where not seen
    visible: BoolArray  # (m,)
    force: Array  # (2,) N, as logged
    push_s: float
    loaded: bool
    gravity: Array  # (2,) m/s^2


def checked_frame(
    tags: int,
    time: float,
    xy: ArrayLike,
    angle: ArrayLike,
    covariance: ArrayLike,
    force: ArrayLike,
    push_s: float,
    loaded: bool,
    gravity: ArrayLike,
) -> CheckedFrame:
    """A frame of `tags` tags. Raises `LearningError` where something does not fit or is not finite."""
    position = _array(xy, (tags, 2), "xy", time)
    turn = _array(angle, (tags,), "angle", time)
    spread = _array(covariance, (tags, 3, 3), "covariance", time)
    pushed, pulled = _array(force, (2,), "force", time), _array(gravity, (2,), "gravity", time)
    if not np.isfinite(time):
        raise LearningError(f"a frame's time must be a finite number, got {time}")
    if not (np.all(np.isfinite(pushed)) and np.all(np.isfinite(pulled))):
        raise LearningError(
            f"frame at {time:g} s: force and gravity must be finite, got {pushed.tolist()} N and {pulled.tolist()} "
            "m/s^2. Leave out frames whose force is not known"
        )
    if loaded and not 0.0 < push_s <= 1.0:
        raise LearningError(f"frame at {time:g} s: the force acts at s in (0, 1], got {push_s}")
    measured = np.concatenate([position, turn[:, None]], axis=1)
    if np.any(np.isinf(measured)):
        raise LearningError(f"frame at {time:g} s: a tag at infinity; give NaN where a tag is not seen")
    visible = np.asarray(np.all(np.isfinite(measured), axis=1) & np.all(np.isfinite(spread), axis=(1, 2)))
    spread = np.where(visible[:, None, None], spread, np.eye(3))
    try:
        lower = np.linalg.cholesky(spread)
    except np.linalg.LinAlgError as error:
        raise LearningError(
            f"frame at {time:g} s: the covariance of a tag is not positive definite; give one sd squared of x, y [m^2] "
            "and angle [rad^2] on its diagonal"
        ) from error
    where = push_s if loaded else 1.0
    root = np.linalg.inv(lower) * visible[:, None, None]
    return CheckedFrame(
        time, np.where(visible[:, None], measured, 0.0), spread, root, visible, pushed, where, loaded, pulled
    )


def _array(values: ArrayLike, shape: tuple[int, ...], name: str, time: float) -> Array:
    out = np.asarray(values, dtype=float)
    if out.shape != shape:
        raise LearningError(f"frame at {time:g} s: {name} must have shape {shape}, got {out.shape}")
    return out


def write_frame(keys: KeyFrames, frame: CheckedFrame, rate: Array, terms: Array) -> int:
    """Write the frame behind the key frames in use; returns its index. `rate` (2,) N/s of its force, `terms` (TERMS,)
    of its allowances."""
    i = keys.used
    keys.begin[i] = keys.end[i] = frame.time
    keys.frames[i], keys.rest[i], keys.push_s[i] = 1.0, not frame.loaded, frame.push_s
    keys.force[i], keys.rate[i], keys.gravity[i], keys.terms[i] = frame.force, rate, frame.gravity, terms
    keys.measured[i], keys.weight[i] = frame.measured, frame.visible
    keys.root[i], keys.information[i] = frame.root, frame.root.swapaxes(1, 2) @ frame.root
    keys.used += 1
    return i


_FARTHEST = 2.0  # changes of the force like the last one, over which a shape is extrapolated


def expect_shape(keys: KeyFrames, i: int, error: Array) -> None:
    """First guess of the shape of frame i, the last one, under the force error (2,) [N] that is expected: it goes on as
    it changed last, as the force does."""
    keys.error[i], keys.stale[i], keys.lost[i] = error, False, False
    keys.shape[i], keys.grid[i] = (keys.shape[i - 1], keys.grid[i - 1]) if i else (0.0, 0.0)
    if i > 1 and keys.grid[i - 2] == keys.grid[i - 1]:
        near = slice(i - 2, i + 1)
        before, now = np.diff((keys.force[near] - keys.error[near]) * ~keys.rest[near, None], axis=0)
        share = np.clip(now @ before / max(float(before @ before), 1e-300), -_FARTHEST, _FARTHEST)
        keys.q[i] += share * (keys.q[i - 1] - keys.q[i - 2])


def surprise(
    keys: KeyFrames,
    frame: CheckedFrame,
    solution: KeyFramePosterior,
    x: Array,
    marker: float,
    expected: tuple[Array, float],
) -> tuple[Array, Array]:
    """Innovation (m, 3) of the last key frame at parameters x, and its distance (m,) in sd.

    `marker`: noise of the tags; `expected`: rows (slots,) of the frame's force error on the known ones, its variance.
    """
    i, tags, (rows, own) = keys.used - 1, len(frame.visible), expected
    j, a = keys.j[i].reshape(-1, len(x)), keys.a[i].reshape(-1, 2)
    innovation = keys.zeta[i] - keys.j[i] @ x + keys.a[i] @ keys.error[i]
    by_errors, p = (-a[:, None, :] * rows[None, :, None]).reshape(len(j), -1), solution.count
    spread = solution.spread(np.concatenate([j[:, :p], by_errors, j[:, p:]], axis=1)) + own * a @ a.T
    blocks = spread.reshape(tags, 3, tags, 3)[np.arange(tags), :, np.arange(tags)]
    solved = np.linalg.solve(blocks + marker**2 * frame.covariance, innovation[..., None])[..., 0]
    return innovation, np.sqrt(np.maximum(np.sum(innovation * solved, axis=1), 0.0))


FAR_OFF = 5.0  # times the tags' noise: a larger misfit is not of the tags alone
_ROUGH = 1.7  # times the tags' noise: smaller misfits pass as noise
_CLEAR_MISS = 3.0  # times the noise that a tag's covariance states: a smaller residual is no miss


def misfit(keys: KeyFrames, marker: float) -> float:
    """Root mean square of the tags' whitened residuals at the linearisation point, less what a force error in each
    frame explains; 0 where it is no more than noise of size `marker`.
    """
    loaded = ~keys.rest[: keys.used]
    residual = (keys.root[: keys.used] @ keys.residual[: keys.used][..., None]).reshape(keys.used, -1)[loaded]
    r = without_force(residual, keys.rows_a[: keys.used][loaded])
    size = float(np.sqrt(np.vdot(r, r) / max(np.count_nonzero(r) - 2.0 * len(r), 1.0)))
    return size if size > _ROUGH * marker else 0.0


def key_frame_doubts(keys: KeyFrames, marker: float, size: float, missed: str) -> tuple[str, ...]:
    """The doubts that the key frames raise.

    `marker`: noise of the tags over their covariances; `size`: of the `misfit`; `missed`: what `missed_tag` returned.
    """
    out = []
    if size > FAR_OFF * marker:
        out.append(say("live: far off", times=size / marker))
    out += [missed] if missed else []
    lost = int(np.count_nonzero(keys.lost[: keys.used]))
    if lost:
        out.append(say("live: no equilibrium", lost=lost, frames=keys.used))
    return tuple(out)


def missed_tag(keys: KeyFrames) -> str:
    """A sentence on the tag whose residual is the largest share of its motion, whatever the force error; empty where
    the fit would accept that share (`MISS`)."""
    used = keys.used
    visible = keys.information[:used, :, 0, 0] > 0.0
    pushed = visible & ~keys.rest[:used, None]
    if not np.any(pushed):
        return ""
    frames = pushed * keys.frames[:used, None]
    counts = np.maximum(frames.sum(axis=0), 1.0)  # (m,) frames
    force = force_in((keys.root[:used] @ keys.residual[:used][..., None]).reshape(used, -1), keys.rows_a[:used])
    residual = keys.residual[:used, :, :2] - (keys.a[:used, :, :2] @ force[:, None, :, None])[..., 0]
    rms = np.sqrt((frames[..., None] * residual**2).sum(axis=(0, 2)) / counts)
    of_xy = (pushed * (keys.information[:used, :, 0, 0] + keys.information[:used, :, 1, 1])).sum(axis=0)
    noise = 2.0 / np.sqrt(np.maximum(of_xy / counts, 1e-300))  # m, of one frame, x and y alike
    motion = _motion(keys.measured[:used, :, :2], visible)
    share = np.where(np.any(pushed, axis=0) & (rms > _CLEAR_MISS * noise), rms / np.maximum(motion, 1e-300), 0.0)
    worst = int(np.argmax(share))
    if share[worst] <= MISS:
        return ""
    return say("live: tag missed", tag=worst + 1, rms=rms[worst], motion=motion[worst])


def _motion(xy: Array, visible: BoolArray) -> Array:
    """(m,) m: diagonal of the rectangle in which each tag was seen; infinite where it never was."""
    part = visible[..., None]
    across = np.max(xy, axis=0, initial=-np.inf, where=part) - np.min(xy, axis=0, initial=np.inf, where=part)
    return np.asarray(np.sqrt(across[:, 0] ** 2 + across[:, 1] ** 2))


_MOVED = 0.5  # posterior sd: a larger distance from the linearisation point moves that point
_MANY = 6  # key frames linearised with one frame: after more, nothing else is done in that update
_LOOK, _LAST_LOOK = (10, 0.05), (60, 0.5)  # evaluations of the evidence, and sd: in one look, and after a push
_WHITE_SPREAD = 0.7  # sd of the log of the force error's white part
_SETTLED_STEPS = 40  # of the chains, after a push
_DRAWS = Draws(chains=1, burn=5, kept=15, shaped=False)  # for a reading, of each node of the cubature
_TURNS = 8  # of so many updates without a solution one looks for a missed tag, one counts the effective parameters


class Smoother:
    """All state of a live learner; its size is fixed when it is made."""

    def __init__(self, session: LiveSession, start: _Start, settings: OnlineSettings) -> None:
        tags, n = len(session.observations.marker_s), session.layout.size
        self.x = start.x  # (n,) the estimate
        self.point = start.x  # (n,) where all frames are linearised, or their mismatch would look like information
        self.keys = key_frames.empty(settings.key_frames, tags, n, MOST_NODES, session.terms.count)
        self.marginalised = nothing_marginalised(n)
        self._session, self._start, self._settings = session, start, settings
        spline, noise = session.layout.spline, RecordingNoise(settings.marker_noise, settings.force.white)
        parts = spline.variances(settings.roughness, settings.steps)
        self.hyperparameters = Hyperparameters(parts, 1.0, 1.0, 1.0, 1.0, (noise,))
        drawn = settings.adapt and start.stiffness is None
        self._chains = StiffnessChains(spline, start.level, settings.roughness, settings.steps) if drawn else None
        self._stages, self._course = LoadStages(session.length, tags), CourseSoFar(session.course, session.terms)
        self._spent = 0.0
        self._turns = 0
        self._linearised = 0  # key frames linearised in the last update
        self.misfit = 0.0  # of the tags, over their covariances; 0 while it is no more than noise
        self._failed = False  # whether the last solution failed
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
        """Size of the tags' noise, over their covariances."""
        return self.hyperparameters.noise[0].marker

    def enter(self, frame: CheckedFrame, rate: Array) -> bool:
        """Add the frame as the last key frame, linearised; False where it has no equilibrium and is left out.

        Also linearise the stale key frames that have waited longest, and average or marginalise others to make room.
        """
        keys = self.keys
        self._stages.add_frame(frame.time, frame.measured[:, :2], frame.visible, frame.loaded)
        i = self._write(frame, rate)
        over = 0 if self.pending else keys.used - self._settings.key_frames  # an update that solves does no averaging
        pairs = key_frames.closest_pairs(keys, i, self._largest, self._stages.own(keys.centre), over)
        fresh = [i]
        for slot, pair in enumerate(pairs, keys.used):
            key_frames.propose_average(keys, pair, slot)
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
                key_frames.accept_average(keys, pair, slot, self.point)
        while keys.used > self._settings.key_frames + 1:
            marginalise_oldest(keys, self.marginalised, self._process, max(self.marker, self.misfit), self._stages.own)
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
        innovation, distance = surprise(keys, frame, self.solution, self.x, self.marker, self._expected[1:])
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
            self._missed = missed_tag(self.keys)
        elif self._turns % 2 and self._chains is not None:
            if self.misfit == 0.0:
                self._chains.step(self.solution.stiffness_form)
        elif self._settings.adapt and self._turns % _TURNS == 2:
            self._spent = self.solution.effective_parameters
        elif self._settings.adapt and self._turns % _TURNS == 4:
            self.look_about(*_LOOK)

    def look_about(self, evaluations: int, stride: float) -> None:
        """Seek better sizes of the force error in the last solution's evidence, near those of now: see `likeliest`."""
        with suppress(np.linalg.LinAlgError):
            model = self.solution.model
            chosen = likeliest(model.evidence, self.hyperparameters, evaluations, stride)
            self.solution, self.hyperparameters = model.posterior(chosen), chosen

    def renew(self) -> bool:
        """Solve for the posterior, move the estimate, and renew the robust weights. False where the solution fails: the
        last one stays, and `doubts` says so until a later one succeeds."""
        keys, settings = self.keys, self._settings
        if self._chains is not None:
            self.hyperparameters = replace(self.hyperparameters, part_variances=self._chains.parts)
        self.misfit = misfit(keys, self.marker)
        try:
            self.solution = solution = self._solve()
        except np.linalg.LinAlgError:
            self._failed = True
            return False
        self._failed = False
        step = solution.x - self.x
        largest = max(float(np.max(np.abs(step[: self._session.layout.spline.count]))), 1e-300)
        self.x = self.x + step * min(1.0, settings.step / largest)
        residual = tag_residuals(keys, solution)
        if settings.adapt:
            marker = tag_noise_size(keys, residual, self._spent, settings.marker_noise)
            noise = replace(self.hyperparameters.noise[0], marker=marker)
            self.hyperparameters = replace(self.hyperparameters, noise=(noise,))
        marker = max(self.marker, self.misfit)
        keys.weight[: keys.used] = robust_weights(keys, residual, marker, settings.bulk)
        fresh = not np.any(keys.stale[: keys.used])
        if fresh and solution.distance(keys.error[: keys.used], self.x - self.point) > _MOVED:
            self.move()
        return True

    def _solve(self) -> KeyFramePosterior:
        """The posterior over the key frames as they are; a misfit beyond the tags' noise counts as noise."""
        keys, settings, session = self.keys, self._settings, self._session
        spans = spans_of(keys, self.marginalised, self._stages.own)
        expected = replace(self.hyperparameters, coloured=1.0, memory=1.0, walk=1.0, load=1.0, white=1.0)
        error, start = spanned_error(self._expected_error, spans), (self._start.level, self._start.stiffness)
        p, marker = session.layout.spline.count, max(self.marker, self.misfit)
        form = information(keys, self.marginalised, p, marker=marker, white=self._process.white)
        spread = np.where(np.array(CHOSEN) == "memory", settings.memory_doubt, np.append(SPREAD, _WHITE_SPREAD))
        model = model_of(form, self.nuisance_sd, problem_of(session, error, start, expected), spread)
        return model.posterior(self.hyperparameters)

    @property
    def _process(self) -> ForceNoise:
        """The force's error, as it is now."""
        return sized(self._expected_error, *self.hyperparameters.of_force)

    @property
    def _expected_error(self) -> ForceNoise:
        return expected_error(self._settings, self._largest, self.misfit > FAR_OFF * self.marker)

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
            for _ in range(_SETTLED_STEPS):
                if self._chains is not None:
                    self._chains.step(self.solution.stiffness_form)
            self.look_about(*_LAST_LOOK)

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
        reasons = {"live: failed": self._failed, "live: too soft": self._too_soft}
        own = key_frame_doubts(self.keys, self.marker, self.misfit, self._missed)
        return (*(say(code) for code, holds in reasons.items() if holds), *own)

    def posterior(self) -> tuple[Array, Array, Array]:
        """(n,) and (n, n) of the parameters, and mean steps (p - 1,) of log k, averaged over the hyperparameters."""
        solution, p = self.solution, self._session.layout.spline.count
        k, covariance, steps = solution.x[:p], solution.solved.pair(0)[:p, :p], np.zeros(p - 1)
        if self._settings.adapt:
            sizes, evidence = self.hyperparameters, solution.model.evidence
            sizes = replace(sizes, chains=None if self._chains is None else self._chains.stand)
            of_others = replace(evidence, spread=evidence.spread[: len(SPREAD)])  # the white part keeps its size
            stiffness, _ = averaged_posterior(of_others, sizes, [{}], _DRAWS)
            k, covariance, steps = stiffness.mean, stiffness.covariance, stiffness.steps
        x, covariance = solution.given_stiffness(k), solution.covariance(covariance)
        return *self._lineariser.secant(self.keys, self.point, x, covariance), steps

    @property
    def nuisance_sd(self) -> Array:
        """(n - p,) one sd before the data of all parameters but log k's coefficients."""
        return self._session.other_sd(self._largest, self._stages.largest / self._session.length)


_EXACT = 1e-12  # of the largest variance of a start: smaller ones are rounding
_HELD = frozenset({"patches"})  # what k(s) of a fit has in it
_STIFFER = 0.2  # added to log k where the estimate has no equilibrium under a force that the beam withstood


@dataclass(frozen=True)
class Update:
    """The result of one frame."""

    innovation: Array  # (m, 3) m, m, rad: measured minus expected; NaN where a tag was not seen
    distance: Array  # (m,) the same in sd of what was expected (root of chi-square with 3 degrees); NaN likewise
    accepted: BoolArray  # (m,) tags that were used
    solved: bool  # False: the estimate has no equilibrium under this force, nothing was learned from the frame
    doubts: tuple[str, ...]  # reasons not to rely on k(s) after this frame; usually none


class OnlineLearner:
    """Learns k(s) of one beam frame by frame. Not thread-safe."""

    @one_blas_thread
    def __init__(
        self,
        length: float,
        marker_s: ArrayLike,
        start: Profile | float | UncertainStiffness,
        *,
        mass: float = 0.0,
        gain_sd: float = 0.0,
        settings: OnlineSettings = OnlineSettings(),
    ) -> None:
        """A learner that has seen nothing.

        Args:
            length: m.
            marker_s: (m,) the tags' places along the beam.
            start: stiffness to begin with [N m], a poor guess will do; or what a fit has found, to go on from there.
            mass: kg, needed where gravity acts in the plane.
            gain_sd: of the force sensor's common scale; it widens the band and is not learned.

        Raises:
            LearningError: a length or stiffness that is not positive, tags outside (0, 1], settings without meaning.
        """
        s = np.asarray(marker_s, dtype=float)
        _check(length, s, mass)
        settings.check()
        self._held = _HELD if isinstance(start, UncertainStiffness) else frozenset()
        thickness, tag_size = (np.nan if v is None else v for v in (settings.thickness, settings.tag_size))
        self.settings, self._gain_sd = settings, gain_sd
        self._session = session_of(
            Spline(settings.functions),
            s,
            settings.sds,
            length=length,
            mass=mass,
            allowances=settings.allowances - self._held,
            thickness=thickness,
            tag_size=tag_size,
        )
        self._state = Smoother(self._session, _start_of(self._session.layout, start), settings)
        self._doubts = start.doubts if isinstance(start, UncertainStiffness) else ()  # what it rests on stays in doubt
        self._last: tuple[float, Array] | None = None
        self._frames = 0

    @one_blas_thread
    def update(
        self,
        time: float,
        xy: ArrayLike,
        angle: ArrayLike,
        covariance: ArrayLike,
        force: ArrayLike,
        push_s: float = 1.0,
        *,
        loaded: bool = True,
        gravity: ArrayLike = (0.0, 0.0),
    ) -> Update:
        """One frame.

        Args:
            time: s, later than the frame before.
            xy: (m, 2) m, the tags in the beam's frame; NaN where not seen.
            angle: (m,) rad, whole turns do not matter; NaN where not seen.
            covariance: (m, 3, 3) of (x, y, angle) of every tag.
            force: (2,) N on the beam, in its frame, as logged.
            push_s: place of the force.
            loaded: False where nothing touches the beam: the frame then shows the rest shape and the log's zero. Leave
                out frames in which that is not sure.
            gravity: (2,) m/s^2 in the beam's frame.

        Raises:
            LearningError: shapes that do not fit, numbers that are not finite (missing tags apart), a covariance that
                is not positive definite, time that does not go on, a place outside (0, 1], gravity without mass. The
                learner stays as it was.
        """
        tags = len(self._session.observations.marker_s)
        frame = checked_frame(tags, time, xy, angle, covariance, force, push_s, loaded, gravity)
        if self._last is not None and not time > self._last[0]:
            raise LearningError(f"frames must come in order of time: {time:g} s after {self._last[0]:g} s")
        if np.any(frame.gravity != 0.0) and self._session.observations.stated.mass <= 0.0:
            raise LearningError("gravity acts in the plane, so the beam's mass must be given")
        rate = np.zeros(2) if self._last is None else (frame.force - self._last[1]) / (time - self._last[0])
        self._last = (time, frame.force)
        nothing = np.full((tags, 3), np.nan), np.full(tags, np.nan), np.zeros(tags, dtype=bool)
        state = self._state
        if loaded and not np.any(frame.visible):
            return Update(*nothing, solved=True, doubts=self._doubts + state.last_doubts)
        if not state.enter(frame, rate):
            state.stiffen(_STIFFER)
            return Update(*nothing, solved=False, doubts=self._doubts + state.last_doubts)
        gated = state.gate(frame)
        state.advance()
        self._frames += 1
        return Update(*gated, solved=True, doubts=self._doubts + state.last_doubts)

    @one_blas_thread
    def settle(self, rounds: int = 10) -> None:
        """Linearise all key frames anew and solve, several times: for the end of a push, not for a loop."""
        self._state.settle(rounds)

    @property
    def frames(self) -> int:
        """Count of the frames learned from."""
        return self._frames

    @property
    def left_out(self) -> tuple[str, ...]:
        """What the fit allows for and this learner does not: it takes the beam and the bench as ideal there,
        and its band holds no more of it than what the discrepancy takes in."""
        return tuple(sorted(OF_ONE - self._session.columns.keys() - self._held))

    @property
    def causes_of_width(self) -> dict[str, float]:
        """What the width of the band follows from, beside the frames: the tags' misfit or noise, whichever is larger,
        and the parts of the force error over what was expected."""
        state, found = self._state, self._state.hyperparameters
        force = math.hypot(found.coloured, found.white)
        return {"tags": max(state.marker, state.misfit), "force": force, "drift": found.walk, "load": found.load}

    @property
    @one_blas_thread
    def hyperparameters(self) -> LiveHyperparameters:
        """Sizes of the tags' noise and of the force error, as they are now."""
        noise, state = self._state.solution.process, self._state
        load = state.hyperparameters.load
        return LiveHyperparameters(state.marker, noise.white, noise.coloured, noise.tau, noise.walk, load)

    @property
    @one_blas_thread
    def parameters(self) -> tuple[Array, Array]:
        """(n,) and (n, n): mean and covariance of all parameters; log k's coefficients come first."""
        self._state.catch_up()
        mean, covariance, _ = self._state.posterior()
        return mean, covariance

    @property
    @one_blas_thread
    def stiffness(self) -> UncertainStiffness:
        """k(s) with its band, as it is now; while there are `doubts`, no place of it counts as identified."""
        self._state.catch_up()
        spline, (mean, covariance, steps) = self._session.layout.spline, self._state.posterior()
        fine, onto, p = spline.finer, spline.on_finer, spline.count
        index = np.arange(p)
        if "patches" in self._session.columns:  # k(s) has them in it
            under_tags = self._session.layout.index["patches", -1].where
            index = np.append(index, np.arange(under_tags.start, under_tags.stop))
            onto = np.column_stack([onto, self._session.patches_on_finer])
        spread = onto @ covariance[np.ix_(index, index)] @ onto.T + np.tensordot(steps**2, spline.unseen, 1)
        coefficients, spread = onto @ mean[index], 0.5 * (spread + spread.T)
        return UncertainStiffness(
            fine.knots, coefficients, spread, self._gain_sd, doubts=self._doubts + self._state.doubts
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons not to rely on `stiffness` as it is now; usually none."""
        self._state.catch_up()
        return self._doubts + self._state.doubts

    @property
    @one_blas_thread
    def force_error(self) -> Array:
        """(2,) N: the log's error at the last frame, as far as it is known."""
        self._state.catch_up()
        e = self._state.solution.e
        return e[-1].copy() if len(e) else np.zeros(2)

    @one_blas_thread
    def nuisances(self) -> list[Nuisance]:
        """Every parameter but k's, before and after the frames so far."""
        mean, covariance = self.parameters
        sd, p = np.sqrt(np.diag(covariance)), self._session.layout.spline.count
        before = np.concatenate([np.ones(p), self._state.nuisance_sd])
        out = []
        for block in self._session.layout.blocks:
            if block.start >= 0 and block.name != "stiffness":
                values = zip(block.labels, mean[block.where], sd[block.where], before[block.where], strict=True)
                out += [Nuisance(n, block.unit, float(v), float(s), float(p)) for n, v, s, p in values]
        return out

    @property
    @one_blas_thread
    def beam(self) -> Beam:
        """The beam as it is now."""
        self._state.catch_up()
        theta0 = self._session.layout.get(self._state.x, "curvature")
        rest: Profile = Uniform(0.0)
        if np.any(theta0 != 0.0):
            rest = Powers(tuple(np.linalg.solve(powers_to_legendre(len(theta0)), theta0).tolist()))
        length = self._session.length
        mass = Uniform(self._session.observations.stated.mass / length)
        return Beam(length, self.stiffness.profile, rest_curvature=rest, mass_per_length=mass)


@dataclass(frozen=True)
class _Start:
    """Where the learner begins."""

    x: Array  # (n,)
    level: float  # prior mean of log k
    stiffness: tuple[Array, Array] | None  # see `FitProblem`


def _start_of(layout: Layout, start: Profile | float | UncertainStiffness) -> _Start:
    if not isinstance(start, UncertainStiffness):
        x, level = starting(layout, start)
        return _Start(x, level, None)
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
    return _Start(x, float(np.mean(x[:p])), (x[:p], root))


def _check(length: float, marker_s: Array, mass: float) -> None:
    if not (np.isfinite(length) and length > 0.0):
        raise LearningError(f"a beam's length must be positive, got {length} m")
    if marker_s.ndim != 1 or len(marker_s) == 0 or not np.all((marker_s > 0.0) & (marker_s <= 1.0)):
        raise LearningError(f"tags are at s in (0, 1], got {marker_s.tolist()}")
    if not mass >= 0.0:
        raise LearningError(f"a beam's mass cannot be negative, got {mass} kg")
