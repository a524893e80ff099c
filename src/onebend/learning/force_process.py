"""The error of a force log as a process in time: a level, a random walk, an Ornstein-Uhlenbeck part and white noise.

Frames that are averaged into one key frame share one number per axis: the mean of the error over their times. Key
frames follow each other in time and do not overlap, so the covariances of these means have short closed forms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.records import Array


@dataclass(frozen=True)
class ForceProcess:
    """Sizes of the parts, one sd each."""

    level: float  # N, constant
    walk: float  # N per root second
    coloured: float  # N, Ornstein-Uhlenbeck
    memory: float  # s, its correlation time
    white: float  # N, of every frame


@dataclass(frozen=True)
class Spans:
    """K stretches of time, in order, that do not overlap."""

    begin: Array  # (K,) s, first frame
    end: Array  # (K,) s, last frame
    frames: Array  # (K,) how many
    slow: Array  # (K,) 1 where only level and walk count, at `end`; else 0

    def after(self, time: float) -> Spans:
        """With a first one, of which only the slow part counts."""
        first = (time, time, 1.0, 1.0)
        every = zip(first, (self.begin, self.end, self.frames, self.slow), strict=True)
        return Spans(*(np.insert(v, 0, one) for one, v in every))

    def then(self, time: float) -> Spans:
        """With one more, a single frame."""
        return Spans(
            np.append(self.begin, time), np.append(self.end, time), np.append(self.frames, 1.0), np.append(self.slow, 0)
        )


def covariance(process: ForceProcess, spans: Spans) -> Array:
    """(K, K) N^2 of the mean errors over the spans, for one axis."""
    begin, end = spans.begin - spans.begin[0], spans.end - spans.begin[0]
    centre, width = 0.5 * (begin + end), end - begin
    walk = np.minimum(centre[:, None], centre)
    diagonal = np.arange(len(centre))
    walk[diagonal, diagonal] -= width / 6.0
    out = process.level**2 + process.walk**2 * walk
    fast = 1.0 - spans.slow
    share, own = _averaging(width / process.memory)
    gap = np.maximum(begin[:, None], begin) - np.minimum(end[:, None], end)
    coloured = np.exp(-np.maximum(gap, 0.0) / process.memory) * np.outer(share, share)
    coloured[diagonal, diagonal] = own
    out += process.coloured**2 * np.outer(fast, fast) * coloured
    out[diagonal, diagonal] += fast * process.white**2 / spans.frames
    out[diagonal, diagonal] += 1e-12 * out[diagonal, diagonal]
    return np.asarray(out)


def fast_variance(process: ForceProcess, width: float, frames: float) -> float:
    """N^2: what coloured and white part add to the mean over one span."""
    _, own = _averaging(np.array([width / process.memory]))
    return float(process.coloured**2 * own[0] + process.white**2 / frames)


def _averaging(u: Array) -> tuple[Array, Array]:
    """What averaging over u correlation times leaves of covariance with others, and of the variance itself."""
    wide = np.maximum(u, 1e-4)
    share = -np.expm1(-wide) / wide
    return np.where(u < 1e-4, 1.0, share), np.where(u < 1e-4, 1.0, 2.0 * (1.0 - share) / wide)
