"""Noise of the tags in the live learner, from what the present estimate leaves of the last frames, as in the fit.

An average of frames forgets how they scattered. So every frame keeps its departure from the key frame it went into: its
residual now is that and the key frame's, less all that an error of its force could explain: as in the fit, what the
log's noise does is not the tags'. The sd of these, times the root of their correlation time, is the noise.
"""

from __future__ import annotations

import numpy as np

from onebend.learning.key_frames import KeyFrames
from onebend.learning.live_solve import Solution
from onebend.learning.scales import correlation_time
from onebend.records import Array

_KEPT = 512  # frames
_FEWEST = 20  # frames that tell a noise
_BULK = 5.0  # sd: beyond, a tag was read wrong
_LEAST = 0.02  # of what the tags' covariances say
_GUESS_COUNTS = 20.0  # frames that the size it begins with counts like


class Scatter:
    """The last frames under load, each against its key frame."""

    def __init__(self, tags: int, expected: float) -> None:
        self._expected = expected
        self._count = 0  # frames ever
        self._own = np.full(_KEPT, -1)  # the key frame it went into; -1: folded
        self._away = np.zeros((_KEPT, tags, 3))  # residual less the key frame's
        self._root = np.zeros((_KEPT, tags, 3, 3))  # R with R' R = information
        self._force = np.zeros((_KEPT, 3 * tags, 2))  # unit vectors of what its force could explain, whitened

    def add(self, i: int, root: Array, by_force: Array) -> None:
        """A frame that has become key frame i; `root` (m, 3, 3) is zero where a tag is not used.

        `by_force` (3 m, 2): derivatives with the force, whitened.
        """
        at = self._count % _KEPT
        self._own[at], self._away[at], self._root[at] = i, 0.0, root
        self._force[at], _ = np.linalg.qr(by_force)
        self._count += 1

    def averaged(self, i: int, before: Array, after: Array) -> None:
        """Key frames i and i + 1 have become one: `before` (2, m, 3) their residuals, `after` (m, 3) its own."""
        for k in range(2):
            self._away[self._own == i + k] += before[k] - after
        self._own[self._own > i] -= 1

    def folded(self, left: Array) -> None:
        """The first key frame is gone; `left` (m, 3) is what its residual was."""
        self._away[self._own == 0] += left
        self._own[self._own >= 0] -= 1

    def forget(self) -> None:
        """All frames so far."""
        self._count = 0
        self._own[:] = -1

    def noise(self, keys: KeyFrames, solution: Solution, spent: float) -> float | None:
        """Size of the tags' noise over what their covariances say; None while too few frames tell it.

        `spent`: parameters that the tags settled.
        """
        kept = min(self._count, _KEPT)
        if kept < _FEWEST:
            return None
        order = (self._count - kept + np.arange(kept)) % _KEPT
        own, used = self._own[order], keys.used
        e = solution.e[len(solution.e) - used :]
        now = keys.zeta[:used] - keys.j[:used] @ solution.x + (keys.a[:used] @ e[:, None, :, None])[..., 0]
        left = self._away[order] + np.where(own >= 0, 1.0, 0.0)[:, None, None] * now[own]
        r = (self._root[order] @ left[..., None]).reshape(kept, -1, 1)
        ways = self._force[order]
        r = (r - ways @ (np.swapaxes(ways, 1, 2) @ r))[..., 0]
        numbers = 3.0 * float(np.count_nonzero(self._root[order, :, 0, 0])) - 2.0 * kept
        share = max(1.0 - spent / max(numbers, 1.0), 0.3)
        most = _BULK * float(np.median(np.abs(r[r != 0.0]))) / 0.6745 if np.any(r) else 0.0
        bulk = np.clip(r, -most, most)
        white = float(np.sum(bulk**2)) / max(numbers * share, 1.0)
        found = max(white * correlation_time(r), _LEAST**2)
        more = kept / (kept + _GUESS_COUNTS)
        return max(float(np.exp(0.5 * more * np.log(found) + (1.0 - more) * np.log(self._expected))), _LEAST)
