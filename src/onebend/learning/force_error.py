"""The error of a force log: slow, correlated, about zero after the tare.

It is a cubic spline in time; the knots follow the cut-off of the low-pass. The prior of its coefficients is a sum of a
coloured part (Ornstein-Uhlenbeck), a random walk, white noise, a level that the tare may have missed, and an error that
comes with the load. Their sizes come from the clock search (`records.ForceNoise`), times factors that the data choose.
The load's error has the covariance `exp(-|change of its own time|)`; that time advances where the load changes. Where
the zero is interpolated between two rests, the prior mean undoes that. Faster errors are noise of each frame. In the
rests the true force is zero, so the log shows its error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular, toeplitz
from scipy.linalg.lapack import dtpqrt

from onebend.recording.force import TARE_SPAN, within
from onebend.recording.force_noise import LOAD, TimeSpans, covariance, displacement, load_changes, own_time
from onebend.recording.signals import low_pass, low_pass_power
from onebend.records import Array, CleanForce, ForceNoise, IntArray, Observations

_MARGIN = 0.2  # s, kept away from contact when a rest is read, besides the low-pass's memory:
_MEMORY = 1.0  # periods of its cut-off
_BESIDE = TARE_SPAN  # s before and after the film, where the force's zero is read, too
_REACH = 2.0  # s, of the rest on either side of the push that counts at least: ten times the usual correlation time
_MOST_KNOTS = 100  # two unknowns each: a bound on the size of a fit
_SPACING = 0.25  # of the period of the cut-off: half of Nyquist's
_GRAIN = 0.03  # of the coloured part's variance: free from knot to knot, so that it can be inverted
_PANEL = 8  # columns that LAPACK takes together where it adds rows to a QR factor
_FINE = 4  # steps between knots, where the load's error is filtered
_REST_SHARE = 0.1  # of the coloured noise: least sd of the log in the rests about the spline
_LEAST = 1e-7  # of the largest force: least noise, for rounding
_UNKNOWN_NOISE = 0.02  # of the largest force, where the log's noise was never found


@dataclass(frozen=True)
class Filtered:
    """An Ornstein-Uhlenbeck process behind the low-pass: its covariance by a cosine transform."""

    lag: Array  # (K,) s
    frequency: Array  # (N,) Hz, quadrature nodes; empty without a filter
    weight: Array  # (N,) Hz, quadrature times what the filter lets through
    coarse: Array  # (A, N) complex, exp(i 2 pi f lag) at some of the lags
    fine: Array  # (B, N) complex, the same of what is added to each of these: the K lags are the first of A B sums

    def covariance(self, sd: float, tau: float, white: float = 0.0) -> Array:
        """(K,) of a process of that sd and correlation time [s], and of white noise of density `white` [N^2 / Hz]."""
        if not len(self.frequency):
            return np.asarray(sd**2 * np.exp(-self.lag / tau))
        density = white + 4.0 * tau * sd**2 / (1.0 + (2.0 * np.pi * self.frequency * tau) ** 2)
        return np.asarray(((self.coarse * (self.weight * density)) @ self.fine.T).real.ravel()[: len(self.lag)])


def filtered(lag: Array, cutoff: float) -> Filtered:
    """Gauss panels of four half waves of the longest lag each, up to thrice the cut-off [Hz]."""
    if not np.isfinite(cutoff) or not len(lag):
        nothing = np.zeros((len(lag), 0), dtype=complex)
        return Filtered(lag, np.zeros(0), np.zeros(0), nothing, nothing)
    x, w = np.polynomial.legendre.leggauss(12)
    highest = 3.0 * cutoff
    edges = np.linspace(0.0, highest, int(np.ceil(highest * float(lag[-1]) / 2.0)) + 2)
    f = (edges[:-1, None] + 0.5 * np.diff(edges)[:, None] * (x + 1.0)).ravel()
    weights = (0.5 * np.diff(edges)[:, None] * w).ravel() * low_pass_power(f, cutoff)
    even = len(lag) > 2 and np.allclose(np.diff(lag), lag[1] - lag[0], rtol=1e-9, atol=0.0)
    stride = int(np.ceil(np.sqrt(len(lag)))) if even else 1
    coarse, fine = (np.exp(2j * np.pi * each[:, None] * f) for each in (lag[::stride], lag[:stride] - lag[0]))
    return Filtered(lag, f, weights, coarse, fine)


@dataclass(frozen=True)
class ForceError:
    """Knots of one recording, and what is expected at them before the fit."""

    knots: Array  # (K,) s
    weights: Array  # (T, K): the error at each used frame is `weights @ values`
    rest_weights: Array  # (R, K): at instants of rest
    rest_values: Array  # (R, 2) N, the log there
    noise: ForceNoise  # as expected before the fit; its level is what the tare may have missed
    filtered: Filtered
    stages: Array  # (K, K) of one sd of that, behind the filter
    mean: Array  # (K, 2) N, expected: what a zero that runs straight between rests took off

    @cached_property
    def size(self) -> float:
        """N, expected sd of the coloured part; next to nothing where no force was logged."""
        if not len(self.knots):
            return 1e-9
        return float(np.sqrt(self.filtered.covariance(self.noise.coloured, self.noise.tau, self.white)[0]))

    @cached_property
    def rest_sd(self) -> float:
        """N, of the log in the rests about the spline: what the knots cannot follow, at least a share of the noise."""
        fitted, _, rank, _ = np.linalg.lstsq(self.rest_weights, self.rest_values)
        left = float(np.sum((self.rest_values - self.rest_weights @ fitted) ** 2)) / 2.0
        return max(_REST_SHARE * self.size, float(np.sqrt(left / max(len(self.rest_values) - int(rank), 1))))

    @property
    def white(self) -> float:
        """N^2 / Hz, one-sided density of the log's white noise."""
        return 2.0 * self.noise.white**2 * self.noise.spacing

    def covariance(self, coloured: float, memory: float, walk: float, load: float, white: float = 1.0) -> Array:
        """(K, K) N^2 of one axis; the arguments are factors on the expected sizes and on the correlation time."""
        root = self.root(coloured, memory, walk, load, white)
        return np.asarray(root @ root.T)

    def root(self, coloured: float, memory: float, walk: float, load: float, white: float = 1.0) -> Array:
        """(K, K) N, lower triangular factor of `covariance`, by QR of the factors of its parts."""
        size, tau = coloured * self.noise.coloured, memory * self.noise.tau
        short = self.filtered.covariance(size, tau, white**2 * self.white)
        upper = np.linalg.cholesky(toeplitz(short) + _GRAIN * short[0] * np.eye(len(short))).T
        level = np.full((1, len(short)), np.hypot(self.noise.level, load * self.noise.load))
        upper = _below(upper, walk * self.noise.walk * self._walk_factor)
        upper = _below(upper, load * self.noise.load * self._stages_factor)
        return _below(upper, level).T

    @cached_property
    def _walk_factor(self) -> Array:
        """(K - 1, K), upper triangular, of a random walk of one unit per root second from the first knot on."""
        later = np.arange(len(self.knots)) > np.arange(len(self.knots) - 1)[:, None]
        return np.asarray(np.sqrt(np.diff(self.knots))[:, None] * later)

    @cached_property
    def _stages_factor(self) -> Array:
        """(K, K), upper triangular, of `stages`."""
        values, vectors = np.linalg.eigh(self.stages)
        return np.asarray(np.linalg.qr(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T, mode="r"))


@dataclass(frozen=True)
class SpannedError(ForceError):
    """The same of key frames, each the mean of frames in a span of time, instead of knots."""

    spans: TimeSpans

    def root(self, coloured: float, memory: float, walk: float, load: float, white: float = 1.0) -> Array:
        """(K, K) N, lower triangular factor of the covariance."""
        noise = sized(self.noise, coloured, memory, walk, load, white)
        return np.asarray(np.linalg.cholesky(covariance(noise, self.spans)), dtype=float)


def sized(n: ForceNoise, coloured: float, memory: float, walk: float, load: float, white: float) -> ForceNoise:
    """The error at these factors on what is expected."""
    parts = {"white": white * n.white, "coloured": coloured * n.coloured, "tau": memory * n.tau}
    return replace(n, **parts, walk=walk * n.walk, load=load * n.load)


def spanned_error(noise: ForceNoise, spans: TimeSpans) -> SpannedError:
    """Of K key frames, before any of them counts."""
    nothing, square, mean = np.zeros((0, len(spans.begin))), np.zeros((0, 0)), np.zeros((len(spans.begin), 2))
    return SpannedError(
        spans.begin, nothing, nothing, np.zeros((0, 2)), noise, filtered(np.zeros(0), np.inf), square, mean, spans
    )


def _below(upper: Array, more: Array) -> Array:
    """(K, K) R of the QR factors of an upper triangle (K, K) above rows (m, K), upper triangular if m > 1."""
    if not len(upper):
        return upper
    rows = len(more) if len(more) > 1 else 0
    return np.triu(dtpqrt(rows, min(_PANEL, len(upper)), upper, more)[0])


def expected_noise(observations: Observations, largest: float) -> ForceNoise:
    """Noise found by the clock search; a share of the largest force where it found none."""
    clean = observations.source.clean_force
    if clean is not None and clean.noise is not None:
        return replace(clean.noise, coloured=max(clean.noise.coloured, _LEAST * largest))
    size = float(np.nanmean(observations.force_sd)) if np.any(np.isfinite(observations.force_sd)) else 0.0
    size = max(size, _LEAST * largest) if size > 0.0 else _UNKNOWN_NOISE * largest
    seconds = float(np.ptp(observations.time)) if len(observations.time) > 1 else 1.0
    return ForceNoise(white=0.0, coloured=size, tau=0.2, walk=size / np.sqrt(max(seconds, 1.0)))


def force_error(observations: Observations, time: Array) -> ForceError:
    """Knots for the frames at `time` (T,) and the rests of the recording's force log."""
    clean = observations.source.clean_force
    largest = float(np.nanmax(np.linalg.norm(observations.force, axis=1))) if len(time) else 0.0
    if largest == 0.0 or observations.static:  # only the weight acts, or loads that were weighed
        empty, square, pairs = np.zeros(0), np.zeros((0, 0)), np.zeros((0, 2))
        none, no_filter = ForceNoise(0.0, 0.0, 1.0, 0.0), filtered(empty, np.inf)
        return ForceError(empty, np.zeros((len(time), 0)), square, pairs, none, no_filter, square, pairs)
    noise, cutoff, spacing = expected_noise(observations, largest), np.inf, 0.3
    if clean is not None and np.isfinite(clean.cutoff) and clean.cutoff > 0.0:
        cutoff, spacing = clean.cutoff, _SPACING / clean.cutoff
    span = _told(observations, (_MOST_KNOTS - 3) * spacing)
    spacing = max(spacing, (span[1] - span[0]) / (_MOST_KNOTS - 3))
    rest_time, rest_force = _in_rests(observations, span, 0.5 * spacing, _MARGIN + _MEMORY / cutoff)
    everything = np.concatenate([time, rest_time])
    begin, end = float(np.min(everything)), float(np.max(everything))
    count = max(int(np.ceil((end - begin) / spacing)) + 3, 4)
    step = (end - begin) / (count - 3)
    knots = np.asarray(begin + step * (np.arange(count) - 1.0), dtype=float)
    sd = observations.force_sd
    return ForceError(
        knots=knots,
        weights=spline_weights(knots, time),
        rest_weights=spline_weights(knots, rest_time),
        rest_values=rest_force,
        noise=replace(
            noise,
            level=min(largest, 3.0 * float(np.max(sd))) if np.all(np.isfinite(sd)) else largest,
            load=LOAD * largest if np.isnan(observations.stated.load_error_sd) else observations.stated.load_error_sd,
        ),
        filtered=filtered(knots - knots[0], cutoff),
        stages=_stages(observations, knots, cutoff),
        mean=ramp(clean, knots),
    )


def _told(observations: Observations, most: float) -> tuple[float, float]:
    """s: from where to where the error of the log counts: the push, and the rests beside it.

    Knots for `most` [s] are there; the push has them first. What acts long before and after the film is unknown, and
    where the beam is held at the film's begin or end, also what acts just beyond.
    """
    time, held = observations.time, observations.loaded
    loaded = time[held] if np.any(held) else time
    reach = max(_REACH, 0.5 * (most - float(np.ptp(loaded))))
    begin, end = time[0] - (0.0 if held[0] else _BESIDE), time[-1] + (0.0 if held[-1] else _BESIDE)
    return float(max(begin, loaded[0] - reach)), float(min(end, loaded[-1] + reach))


def _in_rests(observations: Observations, span: tuple[float, float], step: float, margin: float) -> tuple[Array, Array]:
    """(R,) s and (R, 2) N: instants of a span at least `step` [s] apart, `margin` [s] from any contact, and the log.

    The margin covers what the low-pass makes of the contact: read as an error of the log, it would shift k(s).
    """
    clean, loaded = observations.source.clean_force, observations.time[observations.loaded]
    if clean is None or not len(loaded):
        return np.zeros(0), np.zeros((0, 2))
    free = (clean.time < loaded[0] - margin) | (clean.time > loaded[-1] + margin)
    free &= within(clean.time, span) & np.all(np.isfinite(clean.force), axis=1)
    pick = _spread(clean.time, np.flatnonzero(free).astype(np.int64), step)
    return clean.time[pick], clean.force[pick]


def _stages(observations: Observations, knots: Array, cutoff: float) -> Array:
    """(K, K) covariance of the coefficients of an error of one sd that comes with the load, behind the low-pass."""
    step = float(knots[1] - knots[0])
    fine = np.arange(knots[0] - 4.0 * step, knots[-1] + 4.0 * step, step / _FINE)
    o = observations
    own = own_time(load_changes(o.time, displacement(o.time, o.xy, o.rest_xy), o.loaded), fine)
    inside = (fine >= knots[1]) & (fine <= knots[-2])
    q, r = np.linalg.qr(spline_weights(knots, fine[inside]))
    passed = low_pass(fine, np.eye(len(fine)), cutoff, longest_gap=np.inf)[inside]
    to_knots = solve_triangular(r, q.T @ passed)  # (K, N) least squares, of what the filter lets through
    return np.asarray(to_knots @ np.exp(-np.abs(own[:, None] - own)) @ to_knots.T)


def ramp(clean: CleanForce | None, knots: Array) -> Array:
    """(K, 2) N at the knots: the first rest's zero less the one that was taken off."""
    if clean is None or len(clean.zero_time) < 2:
        return np.zeros((len(knots), 2))
    taken = np.stack([np.interp(knots, clean.zero_time, column) for column in clean.zero.T], axis=1)
    return np.asarray(clean.zero[0] - taken)


def spline_weights(knots: Array, time: Array) -> Array:
    """(T, K) values at `time` of cubic B-splines centred at the evenly spaced `knots` (they sum to 1 inside)."""
    u = np.abs(time[:, None] - knots) / (knots[1] - knots[0])
    near = 2.0 / 3.0 - u**2 + 0.5 * u**3
    far = (2.0 - np.minimum(u, 2.0)) ** 3 / 6.0
    weights = np.where(u < 1.0, near, far)
    return np.asarray(weights / np.sum(weights, axis=1, keepdims=True))


def _spread(time: Array, rows: IntArray, step: float) -> IntArray:
    """A subset of `rows` whose times are at least `step` apart."""
    chosen: list[int] = []
    last = -np.inf
    for row in rows:
        if time[row] - last >= step:
            chosen.append(int(row))
            last = time[row]
    return np.asarray(chosen, dtype=np.int64)
