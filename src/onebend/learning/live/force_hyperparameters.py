"""Hyperparameters of the force error in the live learner: a search for the most probable, and an average around them.

The search makes one trial at a time, with the data so far. Every second trial is a climb: one hyperparameter is made
larger or smaller, and the change is kept if it is more probable. The others are looks. Pairs of looks near the optimum
give the curvature of the log probability; pairs far out along its principal axes are the nodes over which log k is
averaged (a cubature of degree three, as in the fit). A round of looks is followed by the next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dtrtrs

from onebend.learning.inference.hyperparameters import CHOSEN, SPREAD
from onebend.learning.live.key_frame_posterior import KeyFramePosterior, LiveHyperparameters
from onebend.records import Array

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


class HyperparameterSearch:
    """Proposes the next trial, and keeps the results of those before."""

    def __init__(self, expected: LiveHyperparameters, memory_doubt: float) -> None:
        """`expected`: medians of the priors; `memory_doubt`: sd of the log of the memory's prior."""
        self._chosen = chosen = _CHOSEN
        self._expected = np.log([getattr(expected, name) for name in chosen])
        self._spread = np.array([memory_doubt if name == "memory" else _SPREAD[name] for name in chosen])
        self._steps = np.array([0.7 if name == "load" else 0.3 for name in chosen])  # it may be ten times as large
        self._open = np.array([i for i, name in enumerate(chosen) if name != "white"])
        self._nodes: dict[int, _CubatureNode] = {}
        self._trials, self._climbs, self._look = 0, 0, 0
        self._begin()

    @property
    def climbs(self) -> bool:
        """Whether the next trial is a climb."""
        return self._trials % _CLIMB_EVERY == 0

    @property
    def round(self) -> int:
        """So many trials hold at least one whole round of looks."""
        return 2 * (len(self._pairs) + len(self._open)) * _CLIMB_EVERY // (_CLIMB_EVERY - 1) + 1

    def proposal(self, now: LiveHyperparameters) -> LiveHyperparameters:
        """The next trial."""
        logs = np.log([getattr(now, name) for name in self._chosen])
        if self.climbs:
            i = self._climbs % len(self._chosen)
            logs[i] += self._steps[i]
        else:
            logs += self._spread * self._away()
        room = _FARTHEST * self._spread
        values = np.exp(np.clip(logs, self._expected - room, self._expected + room))
        return replace(now, **dict(zip(self._chosen, values.tolist(), strict=True)))

    def cost(self, hyperparameters: LiveHyperparameters) -> float:
        """-2 log prior."""
        z = (np.log([getattr(hyperparameters, name) for name in self._chosen]) - self._expected) / self._spread
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
        i = self._climbs % len(self._chosen)
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
        """After a trial that has no posterior."""
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
        """A new round of looks."""
        count = len(self._open)
        self._pairs = [(i, j) for i in range(count) for j in range(i + 1)]
        self._curved = np.zeros(len(self._pairs))
        self._axes = np.zeros((count, count))
        self._look = 0

    def _away(self) -> Array:
        """Offset of the next look from the optimum, in sd of the priors."""
        out, side, pairs = np.zeros(len(self._chosen)), 1.0 - 2.0 * (self._look % 2), 2 * len(self._pairs)
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
