"""The evidence of a force log for every offset of its clock, by features of the film with unknown coefficients.

Three choices matter:
- The log's rows stay fixed and the markers are shifted: other rows would have other noise.
- Coefficients are integrated out under a prior, not fitted: a free function of the displacement fits any offset.
- The noise has coloured and random-walk parts, whose sizes come from the same data. A push whose force rises at F'
  [N/s] during T under a noise of spectral density S determines the offset to about sqrt(S / (F'^2 T)), and no method
  does better.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpotrf, dtbtrs, dtrtrs
from scipy.ndimage import uniform_filter1d

from onebend.recording.clock_features import FEWEST, HOLD, FilmFeatures, Track, lagging
from onebend.recording.force_noise import LEAST, TINY, first_guess, likeliest_noise
from onebend.recording.signals import outliers, step
from onebend.records import Array, ForceLog, ForceNoise, IntArray

Prior = Callable[[Array], Array]  # log of the prior over offsets, less a constant


@dataclass(frozen=True)
class BinnedLog:
    """The log averaged over bins of equal width, without outliers."""

    time: Array  # (N,) s, mean time of each bin's rows, log's clock
    force: Array  # (N, 2) N
    width: float  # s
    largest: float  # N, largest deviation from the median

    @cached_property
    def noise(self) -> ForceNoise:
        """A first guess."""
        return first_guess(self.force, self.width)

    def walk_variance(self) -> Array:
        """(N,) N^2: the variance so far of a random walk that moves only where the force changes, and by as much."""
        gaps, noise = np.diff(self.time), self.noise
        own = 2 * noise.white**2 + 2 * noise.coloured**2 * (1 - np.exp(-gaps / noise.tau)) + noise.walk**2 * gaps
        power = np.mean(np.diff(self.force, axis=0) ** 2, axis=1)
        size = max(3, round(1.0 / self.width))  # s, window around a row over which the power of its changes is averaged
        local = uniform_filter1d(power, size, mode="nearest")
        # Times the power of the noise's own changes: above it the force itself changes.
        return np.concatenate([[0.0], np.cumsum(np.where(local > 2.0 * own, local, 0.0))])


def binned(log: ForceLog, rate: float, span: tuple[float, float], highest_rate: float) -> BinnedLog:
    """The log within `span` [s] at `rate` rows per second, at most `highest_rate`, and no more than the log has."""
    inside = (log.time >= span[0]) & (log.time <= span[1]) & ~outliers(log.force, spacing=step(log.time))
    time, force = log.time[inside], log.force[inside]
    if len(time) < FEWEST:
        return BinnedLog(np.empty(0), np.empty((0, 2)), 1.0, 0.0)
    width = 1 / min(rate, highest_rate, 1 / step(time))
    index = np.floor((time - time[0]) / width + 1e-6).astype(np.int64)
    count = np.bincount(index)
    total = np.stack([np.bincount(index, column) for column in force.T], axis=1)
    # A bin that lost most of its rows to a dropout does not stand for its whole span.
    good = count > 0.5 * np.median(count[count > 0])
    mean = total[good] / count[good, None]
    largest = float(np.abs(mean - np.median(mean, axis=0)).max())
    # The time of a bin is the mean of its samples' times, not its middle.
    return BinnedLog(np.bincount(index, time)[good] / count[good], mean, width, largest)


def thinned(rows: BinnedLog, rate: float) -> BinnedLog:
    """Rows averaged further, to at most `rate` per second."""
    size = int(np.ceil(1.0 / (rate * rows.width) - 1e-9))
    count = len(rows.time) // max(size, 1)
    if size <= 1 or count < 10:
        return rows
    time = rows.time[: count * size].reshape(count, size).mean(axis=1)
    force = rows.force[: count * size].reshape(count, size, 2).mean(axis=1)
    return BinnedLog(time, force, size * rows.width, rows.largest)


MOST_ROWS, SLOWEST = 250, 5.0  # of the log, after averaging; and a second, at least


def compared_rows(film: FilmFeatures, log: ForceLog, within: tuple[float, float]) -> BinnedLog | None:
    """The log's rows that the film may cover at offsets `within` [s]; None where they are too few, or nothing moves."""
    if not 0.0 < film.rate < np.inf:
        return None
    span = (film.time[0] + within[0], film.time[-1] + within[1])
    highest_rate = MOST_ROWS / float(np.ptp(film.time) + HOLD)
    rows = binned(log, max(8 * film.rate, SLOWEST), span, highest_rate)
    return rows if len(rows.time) >= FEWEST and rows.largest > 0 else None


# Row i of one axis is `x_i + w_i + e_i`: an Ornstein-Uhlenbeck process, a random walk and white noise. The precision P
# of the states (x_0, w_0, x_1, w_1, ...) is a band, and C^-1 = (1 - H (W P + H' H)^-1 H') / W with W the variance of e
# and H the sum of the two states of a row: one banded Cholesky factor.

_NEGLIGIBLE = 1e-14  # of the white variance: a step of a process below it is taken for it


@dataclass(frozen=True)
class NoiseFactor:
    """`C` (N, N) N^2, the covariance of the noise of one axis at N rows."""

    root: Array  # (3, 2 N) the lower Cholesky factor of W P + H' H, as a band
    white: float  # W, N^2
    log_root: float  # half of the log of the determinant of C

    def inner(self, columns: Array) -> Array:
        """(c, c): `columns' C^-1 columns` for `columns` (N, c)."""
        summed = np.repeat(columns, 2, axis=0)
        summed[1] = 0.0  # the walk begins at zero
        half, _ = dtbtrs(self.root, summed, uplo="L")
        return np.asarray((columns.T @ columns - half.T @ half) / self.white)


def noise_factor(noise: ForceNoise, time: Array, walked: Array | None = None) -> NoiseFactor:
    """Of the white, coloured and walking parts of `noise` at rising `time` (N,) [s], in a time that goes with the rows;
    `walked` (N,) [N^2]: variance so far of a second walk."""
    n, gaps = len(time), np.diff(time)
    coloured, walk = noise.coloured**2, noise.walk**2
    white = noise.white**2 + LEAST * (coloured + walk * (time[-1] - time[0])) + TINY
    of_x, of_w = np.full(n, coloured), np.ones(n)  # variances of the steps; w_0 is none
    of_x[1:] = -coloured * np.expm1(-2.0 * gaps / noise.tau)
    of_w[1:] = walk * gaps if walked is None else walk * gaps + np.diff(walked)
    of_x, of_w = np.maximum(of_x, _NEGLIGIBLE * white), np.maximum(of_w, _NEGLIGIBLE * white)
    decay, x, w = np.exp(-gaps / noise.tau), white / of_x, white / of_w
    w[0] = 1.0
    band = np.zeros((3, 2 * n))
    band[0, ::2] = 1.0 + x
    band[0, :-2:2] += decay**2 * x[1:]
    band[0, 1::2] = w
    band[0, 3::2] += 1.0
    band[0, 3:-2:2] += w[2:]
    band[1, 2::2] = 1.0
    band[2, :-2:2] = -decay * x[1:]
    band[2, 3:-2:2] = -w[2:]
    root, info = dpbtrf(band, lower=1)
    if info:
        raise np.linalg.LinAlgError("the covariance of the force's noise is not positive definite")
    steps = float(np.sum(np.log(of_x)) + np.sum(np.log(of_w[1:])))
    log_root = float(np.sum(np.log(root[0]))) + 0.5 * (steps - (n - 1) * np.log(white))
    return NoiseFactor(np.asarray(root), white, log_root)


@dataclass(frozen=True)
class LinearModel:
    """`values` along either axis as features with standard normal coefficients, and noise."""

    features: Array  # (N, c)
    own: int  # as of `Track`
    values: Array  # (N, 2)


@cache
def places_of(own: int, pairs: int) -> tuple[tuple[IntArray, IntArray], ...]:
    """Of each axis the places of its features, and of what they explain, among all coefficients and among columns."""
    return tuple(
        (
            np.r_[axis * own : (axis + 1) * own, 2 * own : 2 * own + pairs + 1],
            np.r_[:own, own + axis * pairs : own + (axis + 1) * pairs, own + 2 * pairs + axis],
        )
        for axis in (0, 1)
    )


def log_evidence(factor: NoiseFactor, model: LinearModel) -> float:
    """Log probability of the model's values, less a constant.

    The coefficients are shared by the axes and integrated out (Bayesian linear model; the p x p form of the matrix
    inversion lemma); the noise of the axes is independent, each one's covariance is that of `factor`.
    """
    products = factor.inner(np.hstack([model.features, model.values]))
    pairs = (model.features.shape[1] - model.own) // 2
    p = 2 * model.own + pairs
    inner = np.eye(p + 1)
    for rows, at in places_of(model.own, pairs):
        inner[rows[:, None], rows] += products[at[:, None], at]
    square = float(inner[p, p]) - 1.0
    root, _ = dpotrf(inner[:p, :p], lower=1)
    explained, _ = dtrtrs(root, inner[:p, p], lower=1)
    spread = 2 * factor.log_root + float(np.sum(np.log(np.diag(root))))
    return float(-0.5 * (square - explained @ explained) - spread)


def fit_noise(time: Array, model: LinearModel, start: ForceNoise) -> ForceNoise:
    """The likeliest noise of the model's values at `time` (N,) around anything that its columns can follow."""

    def misfit(noise: ForceNoise, square: float) -> float:
        return 0.5 * square - log_evidence(noise_factor(noise, time), model)

    return likeliest_noise(start, misfit, 120)


FIRST_LOOK, UNLIKELY = 60.0, 30.0  # rows per film in the rough search; log evidence below the best that is dropped
MOST_LOOKS, AROUND = 24, 0.5  # offsets that are searched finely, and how far around each, s
FAR_OFF, NEAR = 0.05, 0.02  # of the largest force: residual of an offset on the rough, the fine grid
APART, MOST_PEAKS = 0.15, 6  # s: estimates of the offset that are farther apart are each looked at closely
LEAST_SPAN = 0.2  # s, searched finely on either side of the first estimate at least


@dataclass(frozen=True)
class LaidOver:
    """The film over the log at one offset."""

    use: IntArray  # (n,) rows of the log that it covers
    model: LinearModel  # of them


def laid_over(track: Track, rows: BinnedLog, offset: Array) -> list[LaidOver | None]:
    """The film over the log at every offset; None where they have too little in common."""
    least = max(10.0, 0.25 * min(len(rows.time), track.duration / rows.width))
    reach = (track.time[0] - track.before - rows.width, track.time[-1] + track.after + rows.width)
    out = list[LaidOver | None]()
    for shift in offset:
        covered = np.arange(*np.searchsorted(rows.time, (reach[0] + shift, reach[1] + shift)))
        features = rows.largest * track.mean(rows.time[covered] - shift, rows.width)
        known = np.isfinite(features).all(axis=1)
        use = covered[known]
        model = LinearModel(features[known], track.own, rows.force[use])
        out.append(LaidOver(use, model) if len(use) >= least else None)
    return out


@dataclass(frozen=True)
class OffsetScan:
    """One set of features, with its log posterior at all offsets."""

    track: Track
    log_posterior: Array  # over the coarse offsets
    noise_at_best: Callable[[], ForceNoise]  # is fitted

    @cached_property
    def noise(self) -> ForceNoise:
        """The likeliest at the best offset."""
        return self.noise_at_best()


def coarse_search(track: Track, rows: BinnedLog, offset: Array, prior: Prior) -> OffsetScan:
    """The log posterior over all offsets, under the noise that is likeliest at the best one of a first look."""
    laid = laid_over(track, rows, offset)

    def fitted(log_posterior: Array, start: ForceNoise) -> ForceNoise:
        best = laid[int(np.argmax(log_posterior))]
        return start if best is None else fit_noise(rows.time[best.use], best.model, start)

    def searched(noise: ForceNoise) -> Array:
        return evidence_ratios(laid, rows, noise) + prior(offset)

    noise = fitted(searched(with_slow_noise(rows.noise, NEAR * rows.largest)), rows.noise)
    log_posterior = searched(noise)
    return OffsetScan(track, log_posterior, lambda: fitted(log_posterior, noise))


def feature_scans(film: FilmFeatures, rows: BinnedLog, offsets: Array, prior: Prior) -> list[OffsetScan]:
    """The scans over `offsets` (N,) [s] by the sets of features, the most probable first; of those that have enough in
    common with the log."""
    scans = [coarse_search(track, rows, offsets, prior) for track in film.tracks]
    scans = [scan for scan in scans if np.isfinite(scan.log_posterior).any()]
    return sorted(scans, key=lambda scan: -float(scan.log_posterior.max()))


def evidence_ratios(laid: Sequence[LaidOver | None], rows: BinnedLog, noise: ForceNoise) -> Array:
    """Log evidence ratio of every offset; minus infinity where film and log overlap too little.

    Each offset covers other rows of the log. So the evidence with the markers is divided by that without them, of the
    same rows. Without markers a changing force counts as a random walk, a constant one as noise of the size of the
    first guess: whatever noise the markers leave, it is divided by the same."""
    log_ratio = np.full(len(laid), -np.inf)
    walk_variance = rows.walk_variance()
    of_rows: dict[bytes, tuple[NoiseFactor, float]] = {}
    for i, film in ((i, film) for i, film in enumerate(laid) if film is not None):
        if (key := film.use.tobytes()) not in of_rows:
            time = rows.time[film.use]
            nothing = LinearModel(np.full((len(time), 1), 10 * rows.largest), 1, rows.force[film.use])
            walks = noise_factor(rows.noise, time, walk_variance[film.use])
            of_rows[key] = noise_factor(noise, time), log_evidence(walks, nothing)
        factor, without = of_rows[key]
        log_ratio[i] = log_evidence(factor, film.model) - without
    return log_ratio


def with_slow_noise(noise: ForceNoise, size: float) -> ForceNoise:
    """`noise` with a coloured part of at least `size` [N]: the residual of an offset between grid points."""
    return replace(noise, coloured=max(noise.coloured, size), tau=max(noise.tau, 0.5))


def likely_offsets(film: FilmFeatures, rows: BinnedLog, low: float, high: float) -> Array:
    """A fine grid of offsets from `low` to `high` [s]; of a long range only those near the peaks of a rough search."""
    spacing = min(0.05, 0.1 * (high - low))
    fine = np.arange(low, high + spacing, min(spacing, 0.25 / film.rate))
    if high - low < 12.0 or not film.tracks:  # s: a longer range is searched roughly first
        return fine
    rough = np.arange(low, high, max(min(0.25, 0.25 / film.rate), 0.05))
    track = film.tracks[0]
    few_rows = thinned(rows, FIRST_LOOK / track.duration)
    noise = with_slow_noise(few_rows.noise, FAR_OFF * rows.largest)
    log_ratio = evidence_ratios(laid_over(track, few_rows, rough), few_rows, noise)
    best = np.argsort(-log_ratio)[:MOST_LOOKS]
    likely = rough[best[log_ratio[best] >= log_ratio.max() - UNLIKELY]]
    return np.asarray(fine[np.abs(fine[:, None] - likely).min(axis=1) < AROUND])


def likely_span(scans: Sequence[OffsetScan], offsets: Array, low: float, high: float) -> tuple[float, float]:
    """s, the lowest and the highest offset that need a finer search."""
    log_ratio = np.max([scan.log_posterior - scan.log_posterior.max() for scan in scans], axis=0)
    good, first = offsets[log_ratio > -UNLIKELY], float(offsets[int(np.argmax(scans[0].log_posterior))])
    return max(low, min(float(good.min()), first - LEAST_SPAN)), min(high, max(float(good.max()), first + LEAST_SPAN))


def peaks(scans: Sequence[OffsetScan], offsets: Array) -> list[float]:
    """s, the offsets at which a scan's posterior has a maximum, the highest of each scan first; not near each other."""
    found: list[tuple[float, float]] = []
    for scan in scans:
        p = np.concatenate([[-np.inf], scan.log_posterior - scan.log_posterior.max(), [-np.inf]])
        # Log posterior below the highest peak at which another one is left: a share of 3e-4.
        top = (p[1:-1] >= p[:-2]) & (p[1:-1] >= p[2:]) & (p[1:-1] > -8.0)
        found += zip((-p[1:-1][top]).tolist(), offsets[top].tolist(), strict=True)
    kept: list[float] = []
    for _, offset in sorted(found, key=lambda one: one[0]):
        if all(abs(offset - other) > APART for other in kept):
            kept.append(offset)
    return kept[:MOST_PEAKS]


def refined(scan: OffsetScan, rows: BinnedLog, offsets: Array, prior: Prior) -> tuple[float, float]:
    """Mean and sd of the posterior around its highest peak. Other peaks widen the sd by their probability."""
    best = centre = float(offsets[int(np.argmax(scan.log_posterior))])
    spacing = offsets[1] - offsets[0]
    reach = max(3 * spacing, min(0.1, 0.25 * float(np.ptp(offsets))))
    mean, sd = centre, float("inf")
    for _ in range(6):
        near = np.linspace(centre - reach, centre + reach, 33)
        gain = evidence_over_same_rows(scan, rows, near)
        if gain is None:
            break
        mean, sd = moments_of(near, gain + prior(near))
        if 0.08 * reach < sd < 0.3 * reach and abs(mean - centre) < 0.5 * reach:
            break
        centre, reach = mean, min(max(4.5 * sd, 1e-3), 2 * reach)
    sd = float(np.hypot(max(sd, 1e-3), scan.track.doubt))
    ends = evidence_over_same_rows(scan, rows, np.array([best, mean]))
    outside = np.abs(offsets - mean) > max(reach, 4 * sd)
    if ends is None or not outside.any():
        return mean, sd
    # The offsets may straddle a sharp peak: its own height, then its mass as a normal distribution.
    peak = float(scan.log_posterior.max() + max(ends[1] - ends[0], 0.0))
    mass = np.exp(scan.log_posterior[outside] - peak) * spacing
    total = float(mass.sum()) + sd * np.sqrt(2 * np.pi)
    return mean, float(np.sqrt(sd**2 + mass @ (offsets[outside] - mean) ** 2 / total))


def evidence_over_same_rows(scan: OffsetScan, rows: BinnedLog, offsets: Array) -> Array | None:
    """Log evidence at all `offsets` over the rows that each of them covers; None where these are too few."""
    every = [rows.largest * scan.track.mean(rows.time - shift, rows.width) for shift in offsets]
    use = np.all([np.isfinite(features).all(axis=1) for features in every], axis=0)
    if use.sum() < FEWEST:
        return None
    factor, own, force = noise_factor(scan.noise, rows.time[use]), scan.track.own, rows.force[use]
    return np.array([log_evidence(factor, LinearModel(features[use], own, force)) for features in every])


def averaged_over(scans: Sequence[OffsetScan], ends: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean and sd [s] of the offset over sets of features, weighted by their evidence, if their sd is finite."""
    mean, sd = np.transpose(ends)
    mass = np.array([np.logaddexp.reduce(scan.log_posterior) for scan in scans])
    kept = np.isfinite(sd)
    if not kept.any():
        return float(mean[int(np.argmax(mass))]), float("inf")
    return mixed(mass[kept], mean[kept], sd[kept])


def mixed(log_evidence: Array, mean: Array, sd: Array) -> tuple[float, float]:
    """Mean and sd of normal densities with these means and sds, weighted by their evidence."""
    share = np.exp(log_evidence - np.logaddexp.reduce(log_evidence))
    middle = float(share @ mean)
    return middle, float(np.sqrt(share @ (sd**2 + (mean - middle) ** 2)))


def moments_of(offset: Array, log_density: Array) -> tuple[float, float]:
    """Mean and sd of a density given by its log at rising points."""
    weight = np.exp(log_density - log_density.max()) * np.gradient(offset)
    weight /= weight.sum()
    mean = float(weight @ offset)
    return mean, float(np.sqrt(weight @ (offset - mean) ** 2))


# A slow sensor's filter delays and lowers peaks: k(s) comes out too small, and the offset takes up the delay. But the
# log goes on falling when the tags stand still. So it is compared with features that went through such a filter.

QUICK = (0.0, 0.2)  # s: a sensor as quick as that hardly changes k(s)
SLOW = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)  # s
LAG_REACH, MARGIN = 1.0, 0.1  # offsets compared: from this many lags before the one found, and s on either side
LAGS_APART, OF_LAG = 0.05, 0.1  # s between them, or this share of the lag where that is more


def find_lag(film: FilmFeatures, log: ForceLog, offset: float) -> float | None:
    """s, the lag (first-order) of the sensor that wrote `log`, where it is certain. `offset` [s]: the clock's."""
    rows = compared_rows(film, log, (offset - LAG_REACH * SLOW[-1] - MARGIN, offset + MARGIN))
    if rows is None or not film.tracks:
        return None
    # Of the film: a longer lag leaves no push to see.
    slow = [lag for lag in SLOW if lag <= 0.25 * film.tracks[0].duration]

    @cache
    def at(i: int) -> float:
        return lag_evidence(film.tracks[0], rows, offset, slow[i])

    best = next((i for i in range(1, len(slow), 2) if at(i) > 0.0), None)
    if best is None:
        return None
    while (higher := max(range(max(best - 1, 0), min(best + 2, len(slow))), key=at)) != best:
        best = higher
    # Log evidence of a slow sensor over a quick one; other errors that last reach half of that.
    if best + 1 >= len(slow) or not at(best) > 30.0:
        return None  # at the end of the range it is something else
    fine = np.geomspace((*QUICK[-1:], *slow)[best], slow[best + 1], 9)
    logs = np.array([lag_evidence(film.tracks[0], rows, offset, lag, within=float(fine[-1])) for lag in fine])
    weight = np.exp(logs - np.max(logs))
    return float(weight @ fine / np.sum(weight))


def lag_evidence(track: Track, rows: BinnedLog, offset: float, tau: float, *, within: float = 0.0) -> float:
    """Log evidence of the log under a lag `tau` [s] over that under a quick sensor, each at its likeliest offset.

    The rows are those that every offset covers, up to a lag of `within` [s]; minus infinity where they are too few.
    Where it is negative over a sensor without a lag, other quick ones are not tried."""
    apart, reach = max(LAGS_APART, OF_LAG * tau), LAG_REACH * max(tau, within)
    offsets = np.arange(offset - reach - MARGIN, offset + MARGIN + 0.5 * apart, apart)
    longest = lagging(track, max(tau, within))
    covered = [np.isfinite(longest.mean(rows.time - shift, rows.width)).all(axis=1) for shift in offsets]
    known = np.all(covered, axis=0)
    if known.sum() < FEWEST:
        return -np.inf
    same = replace(rows, time=rows.time[known], force=rows.force[known])

    def at_best(lag: float) -> float:
        return float(np.max(coarse_search(lagging(track, lag), same, offsets, np.zeros_like).log_posterior))

    quick, slow = at_best(QUICK[0]), at_best(tau)
    if slow > quick:
        quick = max(quick, *(at_best(lag) for lag in QUICK[1:]))
    return slow - quick if np.isfinite(quick) else -np.inf
