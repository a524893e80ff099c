"""One mode of a beam under a force that vanishes: `y + 2 z y' / w + y'' / w^2 = f`, f zero from the end on.

Whatever f was, y is a free swing, that of the time after the end, continued to all times, and before the end besides
what f does with nothing at the end (both y and its rate zero there), going back in time. So `y` is linear in two
amplitudes and in f. With `u` the time that is left to the end, what `u^n / n!` does is

    p(u) - p(0) free(1, 0) + p'(0) free(0, 1),   p = sum over m of the m-th derivative of u^n / n! times d_m,
    d = 1, a, a^2 - b, a^3 - 2 a b,   a = 2 z / w, b = 1 / w^2.

f is a sum of: powers of u; a walk (white noise, integrated twice over u); and a fall to zero within a given time, along
a straight line with a bridge (zero at both ends) of any shape on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np

from onebend.records import Array

POWERS = 3  # u, u^2 / 2, u^3 / 6
STEPS = 24  # of the walk
FALLS = tuple(5e-3 * 2.0 ** (i / 2.0) for i in range(11))  # s, 5 to 160 ms
PIECES = 8  # of a fall: the straight line, and 7 of the bridge
SWING = 4  # two amplitudes, frequency, damping
_BRIDGE = 0.25  # of the fall: sd of the bridge's first wave; the next ones less
_SLIGHT = 1e-4


@dataclass(frozen=True)
class Mode:
    """A damped mode, and its free swing about a given time."""

    rate: float  # rad/s, w
    damping: float  # z, below 1
    origin: float  # s
    start: float  # y at the origin
    speed: float  # y' there over w

    def free(self, since: Array) -> tuple[Array, Array]:
        """y `since` (...) s after y = 1, y' = 0, and after y = 0, y' = w."""
        w, z = self.rate, self.damping
        root = np.sqrt(1.0 - z**2)
        decay = np.exp(-z * w * since)
        sine = decay * np.sin(root * w * since) / root
        return np.asarray(decay * np.cos(root * w * since) + z * sine), np.asarray(sine)

    def swing(self, time: Array) -> Array:
        """(F, 4): free swings of the two amplitudes, and what a change of log frequency and of damping does."""
        since = time - self.origin
        one, two = self.free(since)
        away = []
        for rate, damping in ((self.rate * (1.0 + _SLIGHT), self.damping), (self.rate, self.damping + _SLIGHT)):
            a, b = Mode(rate, damping, 0.0, 0.0, 0.0).free(since)
            away.append((self.start * (a - one) + self.speed * (b - two)) / _SLIGHT)
        return np.stack([one, two, *away], axis=-1)

    def of_powers(self, left: Array, most: int) -> Array:
        """(..., most + 1): what u^n / n! does, n = 0 ... most, `left` (...) s before the end; 0 after it."""
        a, b = 2.0 * self.damping / self.rate, self.rate**-2
        by = (1.0, a, a**2 - b, a**3 - 2.0 * a * b)
        u = np.maximum(left, 0.0)
        one, two = self.free(-u)
        out = []
        for n in range(most + 1):
            p = sum(by[m] * u ** (n - m) / factorial(n - m) for m in range(n + 1))
            out.append(np.where(left > 0.0, p - by[n] * one + (by[n - 1] / self.rate if n else 0.0) * two, 0.0))
        return np.stack(out, axis=-1)


def columns(mode: Mode, time: Array, ends: Array, long: float) -> Array:
    """(n, F, 4 + 3 + 24 + 8 falls): what each part does at `time` (F,) for ends (n,); u in `long` s, falls to one."""
    left = ends[:, None] - time
    swing = np.broadcast_to(mode.swing(time), (*left.shape, SWING))
    powers = (mode.of_powers(left, POWERS) / long ** np.arange(POWERS + 1))[..., 1:]
    step = max(0.5 * float(np.median(np.diff(time))), 0.02 * long)
    edges = np.concatenate([[0.0], np.geomspace(step, 1.5 * max(long, step), STEPS)])
    reach = mode.of_powers(left[..., None] - edges, 2)[..., 2] / long**2
    walk = (reach[..., :-1] - reach[..., 1:]) / np.sqrt(np.diff(edges) / long) * np.sqrt(3.0)
    return np.concatenate([swing, powers, walk, *(_fall(mode, left, lasts) for lasts in FALLS)], axis=-1)


def _fall(mode: Mode, left: Array, lasts: float) -> Array:
    """(n, F, 8): of a fall to zero within `lasts` s: the straight line, and the bridge's waves with an sd of one."""
    at = np.arange(PIECES + 1) / PIECES
    wave = np.arange(1, PIECES)
    values = np.column_stack([at, np.sin(np.pi * np.outer(at, wave)) * _BRIDGE / wave**1.5])
    slopes = np.diff(values, axis=0) * PIECES / lasts
    kinks = np.diff(np.vstack([np.zeros(PIECES), slopes, np.zeros(PIECES)]), axis=0)
    return np.asarray(mode.of_powers(left[..., None] - lasts * at, 1)[..., 1] @ kinks)
