"""Settings of the live learner, and what follows from them."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg.lapack import dpstrf, dtrtrs

from onebend.errors import LearningError
from onebend.learning import normal
from onebend.learning.allowances import LIVE_ALLOWANCES
from onebend.learning.hyperparameters import CHOSEN, SPREAD
from onebend.learning.normal import RHO, TAU, InformationForm
from onebend.learning.parameters import Priors, Spline
from onebend.live.posterior import KeyFramePosterior, LiveHyperparameters
from onebend.recording.force_noise import LOAD
from onebend.records import Array, ForceNoise

# A search for the most probable hyperparameters of the force error, one trial with every fourth frame. Climbs change
# one of them and keep what is better. Looks come in pairs: near the optimum for the curvature, far out as cubature
# nodes.

_CHOSEN = ("coloured", "memory", "walk", "load", "white")  # log k is averaged over all but the last
_CENTRE = 0.25  # share of the node in the middle
_FARTHEST = 4.0  # prior sd from the prior's median
_SHORTEST, _LONGEST = 0.05, 0.7  # step of a log
_NEAR = 0.4  # prior sd: distance of the looks that give the curvature
_CLIMB_EVERY = 2  # trials
_TRUSTED = 1.0  # a node's log weight is cut off so far above its weight in the cubature
_LEAST_CURVATURE = 0.5  # the prior alone gives 1
_SPREAD = dict(zip(CHOSEN, SPREAD.tolist(), strict=True)) | {"white": 0.7}
MEMORY_DOUBT = _SPREAD["memory"]


@dataclass(frozen=True)
class _CubatureNode:
    """Mean and covariance of log k at other hyperparameters, in units of the posterior at the optimum. They shrink as
    it does."""

    log_weight: float  # relative to the middle node
    away: Array  # (p,) mean, from that at the optimum
    spread: Array  # (p, p) covariance


def _logs(hyperparameters: LiveHyperparameters) -> Array:
    return np.log([getattr(hyperparameters, name) for name in _CHOSEN])


class HyperparameterSearch:
    """Proposes the next trial, and keeps the results of those before."""

    def __init__(self, expected: LiveHyperparameters, memory_doubt: float) -> None:
        """`expected`: medians of the priors; `memory_doubt`: sd of the log of the memory's prior."""
        self._expected = _logs(expected)
        self._spread = np.array([memory_doubt if name == "memory" else _SPREAD[name] for name in _CHOSEN])
        self._steps = np.array([0.7 if name == "load" else 0.3 for name in _CHOSEN])  # it may be ten times as large
        self._open = np.array([i for i, name in enumerate(_CHOSEN) if name != "white"])
        self._nodes: dict[int, _CubatureNode] = {}
        self._trials, self._climbs, self._look = 0, 0, 0
        self._begin()

    @property
    def climbs(self) -> bool:
        return self._trials % _CLIMB_EVERY == 0

    @property
    def round(self) -> int:
        """So many trials hold at least one whole round of looks."""
        return 2 * (len(self._pairs) + len(self._open)) * _CLIMB_EVERY // (_CLIMB_EVERY - 1) + 1

    def proposal(self, now: LiveHyperparameters) -> LiveHyperparameters:
        logs = _logs(now)
        if self.climbs:
            i = self._climbs % len(_CHOSEN)
            logs[i] += self._steps[i]
        else:
            logs += self._spread * self._away()
        room = _FARTHEST * self._spread
        values = np.exp(np.clip(logs, self._expected - room, self._expected + room))
        return replace(now, **dict(zip(_CHOSEN, values.tolist(), strict=True)))

    def cost(self, hyperparameters: LiveHyperparameters) -> float:
        z = (_logs(hyperparameters) - self._expected) / self._spread
        return float(z @ z)

    def trial(
        self,
        now: LiveHyperparameters,
        here: KeyFramePosterior,
        solved: Callable[[LiveHyperparameters], KeyFramePosterior],
    ) -> tuple[LiveHyperparameters, KeyFramePosterior]:
        """One trial, by the posterior `solved` there; returns `now` and its posterior `here`, or what is better."""
        tried = self.proposal(now)
        try:
            there = solved(tried)
        except np.linalg.LinAlgError:
            self.failed()
            return now, here
        worse = there.minus_log + self.cost(tried) - here.minus_log - self.cost(now)
        if not self.climbs:
            self.looked(worse, there, here)
            return now, here
        self.climbed(worse < 0.0)
        return (tried, there) if worse < 0.0 else (now, here)

    def climbed(self, better: bool) -> None:
        """After a climb: the next step is longer if this one was `better`, else shorter and the other way."""
        i = self._climbs % len(_CHOSEN)
        step = self._steps[i] * (1.5 if better else -0.6)
        self._steps[i] = np.sign(step) * np.clip(abs(step), _SHORTEST, _LONGEST)
        self._climbs += 1
        self._trials += 1

    def looked(self, worse: float, there: KeyFramePosterior, here: KeyFramePosterior) -> None:
        """After a look. `worse`: increase of -2 log p; `there`, `here`: the posteriors there and at the optimum."""
        if self._look < 2 * len(self._pairs):
            self._curve(worse)
            return
        count = len(self._open)
        share = np.log((1.0 - _CENTRE) / (2 * count) / _CENTRE)
        log_weight = min(share + 0.5 * count / (1.0 - _CENTRE) - 0.5 * worse, share + _TRUSTED)
        p = len(here.lower)
        away = here.lower.T @ (there.x[:p] - here.x[:p])
        half, _ = dtrtrs(there.lower, here.lower, lower=1)
        spread = half.T @ half + np.outer(away, away)
        self._nodes[self._look - 2 * len(self._pairs)] = _CubatureNode(float(log_weight), away, spread)
        self._advance()

    def _curve(self, worse: float) -> None:
        """One look near the optimum; in the sum of a pair the slope cancels."""
        self._curved[self._look // 2] += 0.5 * worse / _NEAR**2
        if self._look == 2 * len(self._pairs) - 1:
            self._axes = self._principal()
        self._advance()

    def _advance(self) -> None:
        self._trials += 1
        self._look += 1
        if self._look == 2 * (len(self._pairs) + len(self._open)):
            self._begin()

    def failed(self) -> None:
        if self.climbs:
            self.climbed(False)
        elif self._look < 2 * len(self._pairs):
            self._curve(_NEAR**2)
        else:
            self._nodes.pop(self._look - 2 * len(self._pairs), None)
            self._advance()

    def averaged(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """Mean (p,) and covariance (p, p) of log k's coefficients over all nodes, from those at the optimum."""
        nodes = list(self._nodes.values())
        weights = np.exp([0.0, *(node.log_weight for node in nodes)])
        weights /= np.sum(weights)
        away, spread = np.zeros(len(mean)), weights[0] * np.eye(len(mean))
        for weight, node in zip(weights[1:], nodes, strict=True):
            away += weight * node.away
            spread += weight * node.spread
        spread -= np.outer(away, away)
        root = np.linalg.inv(np.linalg.cholesky(np.linalg.inv(covariance))).T
        out = root @ spread @ root.T
        return mean + root @ away, np.asarray(0.5 * (out + out.T))

    def _begin(self) -> None:
        count = len(self._open)
        self._pairs = [(i, j) for i in range(count) for j in range(i + 1)]
        self._curved = np.zeros(len(self._pairs))
        self._axes = np.zeros((count, count))
        self._look = 0

    def _away(self) -> Array:
        out, side, pairs = np.zeros(len(_CHOSEN)), 1.0 - 2.0 * (self._look % 2), 2 * len(self._pairs)
        if self._look < pairs:
            i, j = self._pairs[self._look // 2]
            out[self._open[[i, j]]] = side * _NEAR
        else:
            count = len(self._open)
            out[self._open] = side * np.sqrt(count / (1.0 - _CENTRE)) * self._axes[:, (self._look - pairs) // 2]
        return out

    def _principal(self) -> Array:
        """(d, d) columns: one sd along each principal axis of the hyperparameters' probability."""
        count = len(self._open)
        own = {i: c for (i, j), c in zip(self._pairs, self._curved, strict=True) if i == j}
        h = np.diag([own[i] for i in range(count)])
        for (i, j), c in zip(self._pairs, self._curved, strict=True):
            if i != j:
                h[i, j] = h[j, i] = 0.5 * (c - own[i] - own[j])
        values, vectors = np.linalg.eigh(h)
        return np.asarray(vectors / np.sqrt(np.maximum(values, _LEAST_CURVATURE)))


_LEVEL = 0.05  # of the largest force: one sd of the log's zero
_WRONG = 4.0  # times the error that comes with the load, while the model misses the tags by far
UNKNOWN_FORCE = ForceNoise(white=0.01, coloured=0.01, tau=0.3, walk=0.003, load=np.nan)


@dataclass(frozen=True)
class OnlineSettings:
    """How the live learner works. Sizes of noise are first values; unless `adapt` is off, it learns them."""

    functions: int = 45  # of the spline of log k
    key_frames: int = 30
    renewed: int = 5  # key frames linearised anew with every other update; one with those between
    # `clock` None: camera and force log share one; `scale` None: the camera is calibrated
    priors: Priors = field(default_factory=Priors)
    marker_noise: float = 1.5  # over what the tags' covariances say
    # `level` comes on top of 5 % of the largest force; `load` NaN: 3 % of it
    force: ForceNoise = UNKNOWN_FORCE
    memory_doubt: float = MEMORY_DOUBT  # sd of the log of `force.tau`
    roughness: float = TAU  # of log k
    steps: float = RHO  # of log k
    adapt: bool = True  # False: the hyperparameters keep their first values
    bulk: float = 3.0  # sd: a tag that fits worse gets less weight; infinite: plain least squares
    gate: float = 8.0  # sd: a tag farther from where it is expected is left out,
    patience: int = 8  # unless it is that far off in so many frames in a row
    step: float = 0.7  # of log k: the most that one update moves it
    allowances: frozenset[str] = LIVE_ALLOWANCES  # what a real beam and bench may also do
    thickness: float | None = None  # m, of the section in the plane of bending; None: not known
    tag_size: float | None = None  # m, side of a tag's black square; None: not known

    @property
    def hyperparameters(self) -> LiveHyperparameters:
        """The values that the hyperparameters begin with."""
        return LiveHyperparameters(
            marker=self.marker_noise,
            white=self.force.white,
            coloured=self.force.coloured,
            memory=self.force.tau,
            walk=self.force.walk,
            load=1.0,
        )

    def check(self) -> None:
        """Raises `LearningError` for settings without meaning."""
        force = self.force
        if not min(force.white, force.coloured, force.tau, force.walk) > 0.0 or force.level < 0.0 or force.load < 0.0:
            raise LearningError(f"the parts of force must be positive, got {force}")
        for name in ("marker_noise", "memory_doubt", "roughness", "steps", "bulk", "gate", "step"):
            if not getattr(self, name) > 0.0:
                raise LearningError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("thickness", "tag_size"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise LearningError(f"{name} must be a length in m, got {value}")
        if not self.allowances <= LIVE_ALLOWANCES:
            other = ", ".join(sorted(self.allowances - LIVE_ALLOWANCES))
            raise LearningError(f"the live learner has no allowance for: {other}")
        for name, least in (("functions", 5), ("key_frames", 5), ("renewed", 1), ("patience", 1)):
            if getattr(self, name) < least:
                raise LearningError(f"{name} must be at least {least}, got {getattr(self, name)}")


def force_process(
    settings: OnlineSettings, hyperparameters: LiveHyperparameters, largest: float, far_off: bool
) -> ForceNoise:
    """The force log's error. `largest`: N, the largest force so far; `far_off`: the residuals are far above the tags'
    noise, so the force may also be further off than its log says."""
    first = settings.force
    level = float(np.hypot(first.level, max(_LEVEL * largest, first.coloured)))
    load = hyperparameters.load * (LOAD * largest if np.isnan(first.load) else first.load)
    if far_off:
        load *= _WRONG
    h = hyperparameters
    return ForceNoise(h.white, h.coloured, h.memory, h.walk, level=level, load=load)


# Hyperparameters of log k's prior: a few Markov chains run while frames come, and their last draws are kept. Given the
# hyperparameters log k is normal, so its mean and covariance are averages over draws.

_CHAINS = 2
_KEPT_STEPS = 20  # the last steps, whose draws are kept
_COPIES, _LEFT_OUT, _READ = 2, 5, 20  # for the band: copies of every chain, their burn-in and draws
_LEAST_INFORMATION = 1e-3  # of log k: directions with less are left out


class StiffnessChains:
    """The chains and their last draws."""

    def __init__(self, spline: Spline, level: float, tau: float, rho: float) -> None:
        """`level`: prior mean of log k; `tau`, `rho`: first values of roughness and steps."""
        self._spline, self._level = spline, level
        self._rng = np.random.default_rng(0)
        self._stand = np.tile(np.append(np.log([tau, rho]), np.ones(len(spline.share))), (_CHAINS, 1))
        first = normal.part_variances(spline, self._stand[:, :2], self._stand[:, 2:])[0]
        self._logs_drawn = np.tile(np.log(first), (_KEPT_STEPS, 1))  # (B KEPT, n) of the parts' variances
        self._next_draw = 0

    @property
    def parts(self) -> Array:
        """(n,) geometric means of the parts' variances over the kept draws: the prior for the estimate. A few draws of
        large steps would dominate an arithmetic mean."""
        return np.asarray(np.exp(np.mean(self._logs_drawn, axis=0)))

    def step(self, stiffness_form: InformationForm) -> None:
        target = self._target(stiffness_form, _CHAINS)
        (now,) = normal.drawn_chains(target, normal.Draws(_CHAINS, 0, 1), self._stand, self._rng)
        self._stand = now.stand
        self._logs_drawn[self._next_draw : self._next_draw + _CHAINS] = np.log(now.variance)
        self._next_draw = (self._next_draw + _CHAINS) % len(self._logs_drawn)

    def mixed(self, stiffness_form: InformationForm) -> tuple[Array, Array, Array]:
        """Mean (p,) and covariance (p, p) of log k averaged over fresh draws, and the mean steps (p - 1,).

        Copies of the chains make fresh draws: reading a band changes nothing.
        """
        target = self._target(stiffness_form, _COPIES * _CHAINS)
        draws, begin = normal.Draws(_COPIES * _CHAINS, _LEFT_OUT, _READ), np.repeat(self._stand, _COPIES, axis=0)
        drawn = list(normal.drawn_chains(target, draws, begin, deepcopy(self._rng)))
        mean, covariance, steps, _ = normal.moments_of(target, drawn)
        return mean + self._level, covariance, steps

    def _target(self, stiffness_form: InformationForm, chains: int) -> normal.Target:
        """Of so many chains; one row for each direction of log k with information."""
        rows, seen = self._rows(stiffness_form)
        return normal.Target(
            self._spline, np.tile(rows, (chains, 1, 1)), np.tile(seen, (chains, 1)), np.full(chains, 1.0 / chains)
        )

    def _rows(self, stiffness_form: InformationForm) -> tuple[Array, Array]:
        """(r, p) and (r,): the information form as rows of unit noise on log k less its level, and what they showed."""
        lower, order, rank, _ = dpstrf(stiffness_form.matrix, tol=_LEAST_INFORMATION, lower=1)
        if rank == 0:
            return np.zeros((1, self._spline.count)), np.zeros(1)
        order, right = order - 1, stiffness_form.vector - self._level * np.sum(stiffness_form.matrix, axis=1)
        values, _ = dtrtrs(lower[:rank, :rank], right[order[:rank]], lower=1)
        rows = np.zeros((rank, len(order)))
        rows[:, order] = np.tril(lower[:, :rank]).T
        return rows, values
