"""The force log, compared with the force from the shape: gain, direction, bias, drift and delay.

The log is taken to be `(1 + g) R(d) F(t - tau) + b + c (t - t0) + w(t)`. The force F from the shape has errors that
frames share and errors of each frame. The log's own error w is that of the fit of k(s) (`learning.force_error`); the
sizes of its parts are drawn from their posterior. Gauss-Newton for the seven numbers, with all errors integrated out.
The prior of the forces is divided out first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from onebend.learning.force_error import ForceError
from onebend.learning.hyperparameters import SPREAD
from onebend.learning.parameters import log_axes
from onebend.records import Array, CleanForce, IntArray

_ROUNDS, _CHOICES = 6, 2  # of Gauss-Newton, and of sizes, each about the last numbers
_MOST = 160  # frames: the log behind its low-pass has no more to say
FEWEST = 12  # frames
SURELY = 3.3  # sds: by chance in one of a thousand
_MEMORIES = (0.1, 0.2, 0.4, 0.8, 1.6)  # s, of the force in time
_DIRECTION_SD = 0.05  # rad, of the log's axes before the film: by hand and eye
_GAIN_SD, _DELAY_SD = 0.3, 0.25  # before the film, s: no sensor is farther off, nor a clock that was found
_LEAST = 1e-2  # of the largest force: the shape's errors, taken as linear, tell no frame's force more exactly
_TOLD = 1e-3  # of the prior's information: what a frame tells less of in a direction, it does not tell
_FRAME = 0.3  # noise of each frame over the coloured part that is expected
_FARTHEST = 4.0  # sd of their logs from what is expected
START = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # a log that is right
# Bias and drift have next to no prior.
_LOOSE = np.array([_GAIN_SD**-2, _DIRECTION_SD**-2, _DELAY_SD**-2, *np.full(4, 1e-12)])
_DRAWS, _EVERY, _STRIDE = 240, 4, 0.6  # of the sizes, by Metropolis: every fourth is kept; sd of a step


@dataclass(frozen=True)
class SensorCheck:
    """What a force log makes of the force on the beam; values with one sd each."""

    gain: tuple[float, float]  # 1: right
    direction: tuple[float, float]  # rad, by which the log's axes are turned against the beam's, as they are stated
    delay: tuple[float, float]  # s, of the log behind the film, on the clock that was found, whose sd is in it
    bias: tuple[Array, Array]  # (2,) N each, beam's frame; in the middle of the film, with what was taken off as zero
    drift: tuple[Array, Array]  # (2,) N/s each, likewise
    noise: float  # N, RMS of what is left of the log in each component
    frames: int

    def scale_agrees(self, stated_sd: float) -> bool:
        """Whether log and shape may have the same scale, which is stated to be known to `stated_sd` (a share)."""
        gain, sd = self.gain
        return abs(gain - 1.0) <= SURELY * float(np.hypot(sd, stated_sd))


@dataclass(frozen=True)
class SensedForces:
    """The force in T frames as the shape tells it, beam's frame."""

    time: Array  # (T,) s
    force: Array  # (T, 2) N
    covariance: Array  # (T, 2, 2) N^2
    common: Array  # (T, 2, r) N, change of the force for one sd of each of the r errors that all frames share
    prior_sd: float  # N, of each component before the shape was seen, mean zero

    def take(self, rows: IntArray) -> SensedForces:
        return SensedForces(self.time[rows], self.force[rows], self.covariance[rows], self.common[rows], self.prior_sd)

    def without_prior(self) -> SensedForces:
        """As the data alone tell it, each frame by itself; where they tell nothing the covariance is large."""
        information = np.linalg.inv(self.covariance)
        size, way = np.linalg.eigh(information)
        before = self.prior_sd**-2
        left = np.maximum(size - before, _TOLD * before)
        grown = (way * (size / left)[:, None]) @ np.swapaxes(way, 1, 2)
        return replace(
            self,
            force=(grown @ self.force[..., None])[..., 0],
            covariance=(way / left[:, None]) @ np.swapaxes(way, 1, 2),
            common=grown @ self.common,
        )


def check_sensor(
    told: SensedForces, logged: Array, error: ForceError, clean: CleanForce | None, clock_sd: float = 0.0
) -> SensorCheck | None:
    """Of the log (T, 2) [N] at the frames of `told`, with the `error` that is expected of it at these T frames, on a
    clock that is known to `clock_sd` [s]; None where too few frames have both."""
    good = np.flatnonzero(np.isfinite(told.force).all(axis=1) & np.isfinite(logged).all(axis=1)).astype(np.int64)
    if len(good) < FEWEST:
        return None
    some = np.linspace(0, len(good) - 1, min(_MOST, len(good))).astype(int)
    rows = good[some]
    check = _Check(told.take(rows), logged[rows], error, error.weights[rows])
    x, sizes = START, np.zeros(len(check.spread))
    for _ in range(_CHOICES):
        check.see(x, sizes)
        x, _ = check.settled(x, sizes)
        sizes = check.chosen(x, sizes)
    check.see(x, sizes)
    x, _ = check.settled(x, sizes)
    noise = check.noise(x, sizes)
    x, spread = check.over_sizes(x, sizes)
    along = spread[2] / spread[2, 2]  # what a delay does to the other numbers
    sd = np.sqrt(np.diag(spread) + (clock_sd * along) ** 2)
    zero, slope = (np.zeros(2), np.zeros(2)) if clean is None else (clean.tare, np.nan_to_num(clean.drift))
    return SensorCheck(
        gain=(float(x[0]), float(sd[0])),
        direction=(float(x[1]), float(sd[1])),
        delay=(float(x[2]), float(sd[2])),
        bias=(x[3:5] + zero, sd[3:5]),
        drift=(x[5:7] + slope, sd[5:7]),
        noise=noise,
        frames=len(good),
    )


class _Check:
    """Generalised least squares of T frames; `sizes` of the log's error: sds of their logs from what is expected.

    Slopes are taken at a force that is smooth in time, and from the log where the shape shows little: noise in a slope
    would count as information.
    """

    def __init__(self, told: SensedForces, logged: Array, error: ForceError, weights: Array) -> None:
        data = told.without_prior()
        self.force, self.common, self.logged = data.force, data.common, logged
        size, way = np.linalg.eigh(data.covariance - data.common @ np.swapaxes(data.common, 1, 2))
        self.own = (way * np.maximum(size, 0.0)[:, None]) @ np.swapaxes(way, 1, 2)
        self.later = told.time - 0.5 * (told.time[0] + told.time[-1])
        self.error, self.weights = error, weights
        self.spread = SPREAD if weights.size else np.zeros(0)
        self.frame = max(_FRAME * error.size, _LEAST * float(np.max(np.abs(logged))))
        self.smooth = _smooth(told.time, self.force, self.common, self.own + self.frame**2 * np.eye(2))
        self.seen, self.common = self.smooth.force, self.smooth.common
        self.rate = self.smooth.rate

    def see(self, x: Array, sizes: Array) -> None:
        """Take the slopes at the force as it is most likely by the shape and, where that tells little, by the log."""
        common = self.common.reshape(2 * len(self.force), -1)
        before = self.smooth.covariance + common @ common.T
        whole = before.copy()
        self._add_log(whole, sizes)
        corrected = (self.logged - x[3:5] - self.later[:, None] * x[5:7]) @ log_axes(x[1:2]) / x[0]
        pull = np.linalg.solve(whole, (corrected - self.smooth.force).ravel())
        self.seen = self.smooth.force + (before @ pull).reshape(-1, 2)

    def chosen(self, x: Array, sizes: Array) -> Array:
        """The sizes of greatest evidence of the model that is linear about `x` (7,), which is integrated out."""
        if not len(sizes):
            return sizes
        slopes, away = self._about(x)

        def cost(z: Array) -> float:
            return self._linear(x, slopes, away, z)[0]

        options = {"maxfun": 60, "eps": 1e-3, "ftol": 1e-5, "gtol": 0.03}
        bounds = [(-_FARTHEST, _FARTHEST)] * len(sizes)
        return np.asarray(minimize(cost, sizes, method="L-BFGS-B", bounds=bounds, options=options).x)

    def over_sizes(self, x: Array, sizes: Array) -> tuple[Array, Array]:
        """Mean (7,) and covariance (7, 7) of the seven numbers, averaged over sizes as likely as the log makes them;
        from `x` and `sizes` on, about which the model is linear."""
        slopes, away = self._about(x)
        now = self._linear(x, slopes, away, sizes)
        kept, rng = [now], np.random.default_rng(0)
        for draw in range(_DRAWS if len(sizes) else 0):
            other = sizes + _STRIDE * rng.standard_normal(len(sizes))
            if np.max(np.abs(other)) < _FARTHEST:
                there = self._linear(x, slopes, away, other)
                if math.log(rng.random()) < now[0] - there[0]:
                    sizes, now = other, there
            if draw % _EVERY == 0:
                kept.append(now)
        means = np.array([one[1] for one in kept])
        apart = np.cov(means, rowvar=False, bias=True) if len(kept) > 1 else 0.0
        return np.mean(means, axis=0), np.mean([one[2] for one in kept], axis=0) + apart

    def _linear(self, x: Array, slopes: Array, away: Array, sizes: Array) -> tuple[float, Array, Array]:
        """Minus the log evidence of `sizes` but for a constant; mean (7,) and covariance (7, 7) of the numbers, the
        model being linear about `x`."""
        factor = cho_factor(self._covariance(x, sizes), lower=True)
        weighed = cho_solve(factor, np.column_stack([slopes, away]))
        normal = slopes.T @ weighed[:, :-1] + np.diag(_LOOSE)
        right = slopes.T @ weighed[:, -1] - _LOOSE * (x - START)
        left = np.linalg.inv(normal)
        misfit = float(away @ weighed[:, -1] - right @ left @ right)
        told = 2.0 * float(np.sum(np.log(np.diag(factor[0])))) + float(np.linalg.slogdet(normal)[1])
        return 0.5 * (float(sizes @ sizes) + misfit + told), x + left @ right, left

    def settled(self, x: Array, sizes: Array) -> tuple[Array, Array]:
        """The seven numbers (7,) after Gauss-Newton from `x`, and their covariance (7, 7)."""
        for _ in range(_ROUNDS):
            _, x, spread = self._linear(x, *self._about(x), sizes)
        return x, spread

    def _about(self, x: Array) -> tuple[Array, Array]:
        """(2 T, 7) and (2 T,) N: the log's slopes at `x` (7,), and what is left of it."""
        return self._slopes(x).reshape(-1, len(x)), self._away(x).ravel()

    def noise(self, x: Array, sizes: Array) -> float:
        """N, RMS of each component of the log's own error, as likely as all errors are."""
        left = self._away(x) - x[0] * self._off(x, sizes) @ log_axes(x[1:2]).T
        return float(np.sqrt(np.mean(left**2)))

    def _off(self, x: Array, sizes: Array) -> Array:
        """(T, 2) N, what is to be added to the force that is told, as likely as all errors are."""
        pull = np.linalg.solve(self._covariance(x, sizes), self._away(x).ravel()).reshape(-1, 2) @ log_axes(x[1:2])
        shared = np.einsum("tcr,tc->r", self.common, pull)
        return np.asarray((self.own @ pull[..., None])[..., 0] + self.common @ shared)

    def _away(self, x: Array) -> Array:
        """(T, 2) N, the log less what the seven numbers make of the force that is told."""
        moved = self.force - x[2] * self.rate
        return np.asarray(self.logged - (x[0] * moved @ log_axes(x[1:2]).T + x[3:5] + self.later[:, None] * x[5:7]))

    def _covariance(self, x: Array, sizes: Array) -> Array:
        """(2 T, 2 T) N^2 of all errors in that, in the log's axes; as large as in a log whose gain is right."""
        turn, count = log_axes(x[1:2]), len(self.force)
        common = (turn @ self.common).reshape(2 * count, -1)
        whole = common @ common.T
        blocks, every = whole.reshape(count, 2, count, 2), np.arange(count)
        blocks[every, :, every, :] += turn @ self.own @ turn.T
        self._add_log(whole, sizes)
        return whole

    def _add_log(self, whole: Array, sizes: Array) -> None:
        """To a covariance (2 T, 2 T) N^2 that of the log's own error and of what no frame's force is told better."""
        slow = self.frame**2 * np.eye(len(self.force))
        if self.weights.size:
            factors = np.exp(self.spread * np.clip(sizes, -_FARTHEST, _FARTHEST))
            root = self.weights @ self.error.root(*factors)
            slow += root @ root.T
        whole[::2, ::2] += slow
        whole[1::2, 1::2] += slow

    def _slopes(self, x: Array) -> Array:
        """(T, 2, 7) of the log with the seven numbers."""
        turn, turned = log_axes(x[1:2]), log_axes(x[1:2] + 0.5 * np.pi)
        moved = self.seen - x[2] * self.rate
        slopes = np.zeros((len(moved), 2, len(x)))
        slopes[..., 0], slopes[..., 1] = moved @ turn.T, x[0] * moved @ turned.T
        slopes[..., 2] = -x[0] * self.rate @ turn.T
        slopes[:, [0, 1], [3, 4]] = 1.0
        slopes[:, [0, 1], [5, 6]] = self.later[:, None]
        return slopes


@dataclass(frozen=True)
class _Smooth:
    """Forces as a Gaussian process in time has them."""

    force: Array  # (T, 2) N
    rate: Array  # (T, 2) N/s
    covariance: Array  # (2 T, 2 T) N^2
    common: Array  # (T, 2, r) N, change for one sd of each of the r errors that all frames share


def _smooth(time: Array, force: Array, common: Array, covariance: Array) -> _Smooth:
    """Through forces (T, 2) of `covariance` (T, 2, 2), of the memory that fits them best."""
    apart, every, count = time[:, None] - time, np.arange(len(time)), len(time)
    size = float(np.quantile(np.linalg.norm(force, axis=1), 0.9))
    columns = np.concatenate([force[..., None], common], axis=-1).reshape(2 * count, -1)
    best = np.inf
    for memory in _MEMORIES:
        one = size**2 * np.exp(-0.5 * (apart / memory) ** 2)
        whole = np.kron(one, np.eye(2))
        before = whole.copy()
        whole.reshape(count, 2, count, 2)[every, :, every, :] += covariance
        factor = cho_factor(whole, lower=True)
        pull = cho_solve(factor, columns)
        cost = 0.5 * float(columns[:, 0] @ pull[:, 0]) + float(np.sum(np.log(np.diag(factor[0]))))
        if cost < best:
            best = cost
            rate = np.kron(-apart / memory**2 * one, np.eye(2)) @ pull[:, 0]
            smooth = (before @ pull).reshape(count, 2, -1)
            left = before - before @ cho_solve(factor, before)
    return _Smooth(smooth[..., 0], rate.reshape(count, 2), left, smooth[..., 1:])
