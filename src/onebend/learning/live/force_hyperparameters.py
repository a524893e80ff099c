"""The sizes of the force's error in the live learner: the evidence's choice, and what it leaves open.

One trial at a time, at what is known then. Some climb: one scale in turn is made larger or smaller, and kept if more
probable. The others look about: pairs to either side along and across the scales give the curvature of their
probability; pairs far out along its axes are the nodes over which log k is averaged (a cubature of degree three, as in
the fit). After a round of some thirty looks they begin anew.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dtrtrs

from onebend.learning.inference.hyperparameters import CHOSEN, SPREAD
from onebend.learning.live.key_frame_posterior import KeyFramePosterior, LiveHyperparameters
from onebend.records import Array

_CENTRE = 0.25  # share of the node in the middle
_FARTHEST = 4.0  # sd from what was expected
_SHORTEST, _LONGEST = 0.05, 0.7  # step of a log
_NEAR = 0.4  # sd of what was expected: so far out the curvature is looked at
_CLIMB_EVERY = 2  # trials
_TRUSTED = 1.0  # of a node's log weight: so far above what was expected, its look is not believed
_LEAST_CURVATURE = 0.5  # the prior alone has one
_SPREAD = dict(zip(CHOSEN, SPREAD.tolist(), strict=True)) | {"white": 0.7}
MEMORY_DOUBT = _SPREAD["memory"]


@dataclass(frozen=True)
class _CubatureNode:
    """What would be known of log k at other scales, in units of what is known at the optimum: as that shrinks, so does
    this."""

    log_weight: float  # over the middle's
    away: Array  # (p,) from the optimum
    spread: Array  # (p, p) about it


class HyperparameterSearch:
    """What to try next, and what the trials so far have told."""

    def __init__(self, expected: LiveHyperparameters, chosen: tuple[str, ...], memory_doubt: float) -> None:
        """`chosen` scales are searched; over all of them but white noise, which hardly matters, it is averaged.

        `memory_doubt`: sd of the log of the memory that is expected.
        """
        self._chosen = chosen
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
        """Trials that surely hold a whole round of looks."""
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
        """-2 log prior of the scales."""
        z = (np.log([getattr(hyperparameters, name) for name in self._chosen]) - self._expected) / self._spread
        return float(z @ z)

    def climbed(self, better: bool) -> None:
        """After a climb: longer steps after a success; shorter, the other way round, after a failure."""
        i = self._climbs % len(self._chosen)
        step = self._steps[i] * (1.5 if better else -0.6)
        self._steps[i] = np.sign(step) * np.clip(abs(step), _SHORTEST, _LONGEST)
        self._climbs += 1
        self._trials += 1

    def looked(self, worse: float, there: KeyFramePosterior, here: KeyFramePosterior) -> None:
        """After a look: by how much -2 log probability is larger there, and what is known there and at the optimum."""
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
        """One look near by: the slope drops out of a pair's sum."""
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
        """After a trial of scales that cannot be."""
        if self.climbs:
            self.climbed(False)
        elif self._look < 2 * len(self._pairs):
            self._curve(_NEAR**2)
        else:
            self._nodes.pop(self._look - 2 * len(self._pairs), None)
            self._advance()

    def averaged(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """(p,) and (p, p) of log k's coefficients, from those at the scales of the optimum."""
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
        """Where the next look is, in sd of what was expected, from the optimum."""
        out, side, pairs = np.zeros(len(self._chosen)), 1.0 - 2.0 * (self._look % 2), 2 * len(self._pairs)
        if self._look < pairs:
            i, j = self._pairs[self._look // 2]
            out[self._open[[i, j]]] = side * _NEAR
        else:
            count = len(self._open)
            out[self._open] = side * np.sqrt(count / (1.0 - _CENTRE)) * self._axes[:, (self._look - pairs) // 2]
        return out

    def _principal(self) -> Array:
        """(d, d) one sd along each axis of the scales' probability, in columns."""
        count = len(self._open)
        own = {i: c for (i, j), c in zip(self._pairs, self._curved, strict=True) if i == j}
        h = np.diag([own[i] for i in range(count)])
        for (i, j), c in zip(self._pairs, self._curved, strict=True):
            if i != j:
                h[i, j] = h[j, i] = 0.5 * (c - own[i] - own[j])
        values, vectors = np.linalg.eigh(h)
        return np.asarray(vectors / np.sqrt(np.maximum(values, _LEAST_CURVATURE)))
