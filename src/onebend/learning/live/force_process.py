"""The error of a force log as a process in time: a level, a random walk, an Ornstein-Uhlenbeck part, white noise, and
what comes with the load (`recording/force/load_stages.py`), whose time is its own: it runs on where the load changes.

Frames that are averaged into one key frame share one number per axis: the mean of the error over their times. Key
frames follow each other in time and do not overlap, so the covariances of these means have short closed forms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from onebend.records import Array

_LEAST = 1e-12  # of each variance: what rounding leaves of two that are the same


@dataclass(frozen=True)
class ForceProcess:
    """Sizes of the parts, one sd each."""

    level: float  # N, constant
    walk: float  # N per root second
    coloured: float  # N, Ornstein-Uhlenbeck
    memory: float  # s, its correlation time
    white: float  # N, of every frame
    load: float = 0.0  # N, what comes with the load: as much that stays, as much that changes


@dataclass(frozen=True)
class Spans:
    """K stretches of time, in order, that do not overlap."""

    begin: Array  # (K,) s, first frame
    end: Array  # (K,) s, last frame
    frames: Array  # (K,) how many
    slow: Array  # (K,) 1 where only level, walk and load count, at `end`; else 0
    own: Array  # (K,) the load's own time

    def after(self, time: float, own: float) -> Spans:
        """With a first one, of which only the slow part counts."""
        first = (time, time, 1.0, 1.0, own)
        every = zip(first, (self.begin, self.end, self.frames, self.slow, self.own), strict=True)
        return Spans(*(np.concatenate([[one], v]) for one, v in every))

    @cached_property
    def centre(self) -> Array:
        """(K,) s since the first."""
        return np.asarray(0.5 * (self.begin + self.end) - self.begin[0])

    @cached_property
    def width(self) -> Array:
        """(K,) s."""
        return np.asarray(self.end - self.begin)

    @cached_property
    def fast(self) -> Array:
        """(K,) 1 where coloured and white part count."""
        return np.asarray(1.0 - self.slow)

    @cached_property
    def walked(self) -> Array:
        """(K, K) s: covariance of a walk of size one."""
        out = np.minimum(self.centre[:, None], self.centre)
        out.ravel()[:: len(out) + 1] -= self.width / 6.0
        return out

    @cached_property
    def gap(self) -> Array:
        """(K, K) s between them; infinite to those of which only the slow part counts."""
        out = np.maximum(self.begin[:, None], self.begin) - np.minimum(self.end[:, None], self.end)
        np.maximum(out, 0.0, out=out)
        if np.any(self.slow):
            apart = self.slow > 0.0
            out[apart], out[:, apart] = np.inf, np.inf
        return out

    @cached_property
    def stages(self) -> Array:
        """(K, K) covariance of what comes with the load, of size one."""
        return np.asarray(1.0 + np.exp(-np.abs(self.own[:, None] - self.own)))


def covariance(process: ForceProcess, spans: Spans) -> Array:
    """(K, K) N^2 of the mean errors over the spans, for one axis."""
    share, own = _averaging(spans.width / process.memory)
    out = np.exp(spans.gap * (-1.0 / process.memory))
    out *= (process.coloured * share)[:, None] * (process.coloured * share)
    diagonal = out.ravel()[:: len(out) + 1]
    diagonal[:] = spans.fast * (process.coloured**2 * own + process.white**2 / spans.frames)
    out += process.walk**2 * spans.walked
    out += process.load**2 * spans.stages
    out += process.level**2
    diagonal *= 1.0 + _LEAST
    return np.asarray(out)


def with_one_more(process: ForceProcess, spans: Spans, time: float, own: float) -> tuple[Array, float]:
    """N^2, covariance (K,) of a single frame at `time`, after all spans, with them, and its variance."""
    begin = float(spans.begin[0]) if len(spans.begin) else time
    slow = process.level**2 + process.load**2
    alone = slow + process.load**2 + process.walk**2 * (time - begin) + process.coloured**2 + process.white**2
    share, _ = _averaging(spans.width / process.memory)
    fast = process.coloured**2 * spans.fast * share
    out = process.walk**2 * spans.centre if len(spans.begin) else np.zeros(0)
    out = out + fast * np.exp((spans.end - time) / process.memory)
    return out + slow + process.load**2 * np.exp(-np.abs(own - spans.own)), float(alone)


def fast_variance(process: ForceProcess, width: float, frames: float) -> float:
    """N^2: what coloured and white part add to the mean over one span."""
    _, own = _averaging(np.array([width / process.memory]))
    return float(process.coloured**2 * own[0] + process.white**2 / frames)


def slow_variance(process: ForceProcess, seconds: float, own: float) -> float:
    """N^2 by which walk and load make the slow part differ after `seconds` and so much of the load's own time."""
    return float(process.walk**2 * max(seconds, 0.0) - 2.0 * process.load**2 * np.expm1(-abs(own)))


def _averaging(u: Array) -> tuple[Array, Array]:
    """What averaging over u correlation times leaves of covariance with others, and of the variance itself."""
    wide = np.maximum(u, 1e-4)
    share = -np.expm1(-wide) / wide
    return np.where(u < 1e-4, 1.0, share), np.where(u < 1e-4, 1.0, 2.0 * (1.0 - share) / wide)
