"""Two clocks made one: the offset between the video's clock and the force log's, from the data.

The force on an elastic beam that moves slowly is a smooth function of its markers' displacements, whatever the beam.
So for every offset the log is explained by low-order polynomials of the markers' leading principal components plus the
sensor's noise, and the offset is judged by how probable that makes the log. No stiffness enters.

Two things decide about the accuracy, and both are minded here:

- the log's rows stay fixed and the markers are shifted under them. Shifting the log instead would compare different
  samples of its noise, whose scatter is larger than what an offset of some hundredths of a second changes;
- the polynomials' coefficients are integrated out under a prior (evidence), not fitted: for a push in one direction
  a free function of the displacement could follow any offset, and a maximum would claim an accuracy it does not have.

The noise is coloured and wanders (`noise.py`), its sizes come from the same data. A push whose force rises at F' [N/s]
during T under a noise of spectral density S tells the offset to about sqrt(S / (F'^2 T)) and no method does better:
slow pushes with a weak force leave tens of milliseconds, and `sd` says so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import combinations_with_replacement

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from onebend.recording.noise import ForceNoise, first_guess, fit_noise, log_evidence
from onebend.recording.signals import bandwidth, bridged, outliers, runs, step
from onebend.records import Array, BoolArray, ClockOffset, ForceLog, Markers, Remark


@dataclass(frozen=True)
class ClockSettings:
    """How the offset is searched."""

    margin: float = 2.0  # s, searched beyond what was said plus its uncertainty
    components: int = 3  # principal components of the markers
    degree: int = 3  # of the polynomials
    prior: tuple[float, ...] = (2.0, 0.5, 0.25, 0.12)  # sd of a coefficient by degree, per largest force
    most_rows: int = 250  # of the log, after averaging
    slowest: float = 5.0  # rows per second at least
    longest_gap: float = 0.25  # s, a marker missing longer is not interpolated
    hold: float = 2.0  # s, a beam that stands still in the first (last) frames is taken to stand still before (after)


@dataclass(frozen=True)
class ClockFit:
    """The offset, and what was learned of the noise on the way (None where nothing was found)."""

    clock: ClockOffset
    noise: ForceNoise | None
    remarks: tuple[Remark, ...] = ()


@dataclass(frozen=True)
class Track:
    """The markers as polynomials of their principal components, to be averaged over any span of time."""

    integral: PPoly  # antiderivative of the (p,) features
    covered: BoolArray  # (T,) frames whose features are known
    time: Array  # (T,) s, video clock
    before: float  # s, how long the beam is taken to have stood still before the film, as in its first frames
    after: float  # s, the same after the film

    def mean(self, centre: Array, width: float) -> Array:
        """(N, p) features averaged over `width` [s] around every `centre`; NaN where the film does not cover them."""
        first_centre, last_centre = self.time[0] + width / 2, self.time[-1] - width / 2
        held = np.clip(centre, first_centre, last_centre)
        held = np.where((centre < first_centre - self.before) | (centre > last_centre + self.after), centre, held)
        low, high = held - width / 2, held + width / 2
        out = np.asarray((self.integral(high) - self.integral(low)) / width)
        holes = np.concatenate([[0], np.cumsum(~self.covered)])
        first, last = np.searchsorted(self.time, low), np.searchsorted(self.time, high)
        inside = (low >= self.time[0] - 1e-9) & (high <= self.time[-1] + 1e-9)
        full = holes[np.minimum(last + 1, len(self.time))] == holes[np.maximum(first - 1, 0)]
        out[~(inside & full)] = np.nan
        return out


@dataclass(frozen=True)
class Rows:
    """The log averaged over even bins (boxcar), outliers left out."""

    time: Array  # (N,) s, centres of the bins, log's clock
    force: Array  # (N, 2) N
    width: float  # s
    largest: float = field(default=0.0)  # N, largest deviation from the median


def find_offset(
    markers: Markers, log: ForceLog, said: float, uncertainty: float, *, settings: ClockSettings = ClockSettings()
) -> ClockOffset:
    """`log time = video time + offset`, searched over `said` +- (`uncertainty` + margin) [s]; see `fit_clock`."""
    return fit_clock(markers, log, said, uncertainty, settings=settings).clock


def fit_clock(
    markers: Markers, log: ForceLog, said: float, uncertainty: float, *, settings: ClockSettings = ClockSettings()
) -> ClockFit:
    """The posterior of the offset between the two clocks.

    The prior takes `uncertainty` [s] as two sd of `said`, with exponential tails beyond. Where `said` is NaN every
    offset counts alike under which half of the film is inside the log. `found` is False where the data leave more than
    half of the prior's spread; then the offset is what was said.

    Assumes that the film and the log both show the push, that what bends the beam is the logged force, and that the
    beam moves slowly against its own oscillations for most of the film.
    """
    low, high, prior = search_range(markers.time, log.time, said, uncertainty, settings)
    spread = prior_spread(low, high, prior)
    unsettled = ClockOffset(offset=said, sd=spread if np.isfinite(uncertainty) else np.inf, said=said, found=False)
    rate = bandwidth(markers.time, displacements(markers))
    if not np.isfinite(rate) or high <= low:
        return ClockFit(unsettled, None, (Remark("note", "Nothing moves in the film: the clocks cannot be matched."),))
    track = marker_track(markers, settings)
    rows = binned(log, rate, (markers.time[0] + low, markers.time[-1] + high), settings)
    if len(rows.time) < 10 or rows.largest == 0 or track.covered.sum() < 10:
        return ClockFit(unsettled, None, (Remark("note", "Too little force and motion to match the clocks."),))
    coarse = np.arange(low, high + 0.05, min(0.05, 0.25 / rate))
    noise, chance = coarse_search(track, rows, coarse, prior)
    offset, sd = refined(track, rows, coarse, chance, noise, prior)
    if not sd < 0.5 * spread:
        text = f"The clocks could not be matched from the data (one sd {sd:.2g} s); the written start time is used."
        return ClockFit(unsettled, None, (Remark("warning", text),))
    clock = ClockOffset(offset=offset, sd=sd, said=said, found=True)
    return ClockFit(clock, noise, remarks_on(clock, uncertainty, low, high))


def search_range(
    film: Array, log: Array, said: float, uncertainty: float, settings: ClockSettings
) -> tuple[float, float, Callable[[Array], Array]]:
    """Lowest and highest offset to try, and the log of the prior over offsets."""
    half = 0.5 * (film[-1] - film[0])
    first, last = log[0] - film[0] - half, log[-1] - film[-1] + half
    if not (np.isfinite(said) and np.isfinite(uncertainty)):
        return first, last, lambda offset: np.zeros_like(offset)
    reach, scale = uncertainty + settings.margin, uncertainty / 2 + 0.05

    def prior(offset: Array) -> Array:
        away = np.abs(offset - said) / scale
        return -np.where(away < 2, 0.5 * away**2, 2 * away - 2)

    return max(first, said - reach), min(last, said + reach), prior


def prior_spread(low: float, high: float, prior: Callable[[Array], Array]) -> float:
    """sd of the prior over offsets, s."""
    if high <= low:
        return float("inf")
    offset = np.linspace(low, high, 2001)
    return moments(offset, prior(offset))[1]


def moments(offset: Array, log_chance: Array) -> tuple[float, float]:
    """Mean and sd of a distribution given by its log on even points."""
    weight = np.exp(log_chance - log_chance.max())
    weight /= weight.sum()
    mean = float(weight @ offset)
    return mean, float(np.sqrt(weight @ (offset - mean) ** 2))


def displacements(markers: Markers) -> Array:
    """(T, 3m) every marker's x, y and angle against their medians; angles as arc lengths of a tenth of the reach."""
    with np.errstate(all="ignore"):
        reach = float(np.nanmax(np.abs(markers.xy))) if np.isfinite(markers.xy).any() else 1.0
    flat = np.concatenate([markers.xy.reshape(len(markers.time), -1), 0.1 * reach * markers.angle], axis=1)
    seen = np.isfinite(flat).any(axis=0)
    return np.asarray(flat[:, seen] - np.nanmedian(flat[:, seen], axis=0))


def marker_track(markers: Markers, settings: ClockSettings) -> Track:
    """Polynomials of the principal components of the markers that are hardly ever missing."""
    moved = displacements(markers)
    missing = ~np.isfinite(moved)
    long = np.zeros_like(missing)
    for i, column in enumerate(missing.T):
        for start, stop in runs(column):
            edge = start == 0 or stop == len(column)
            if edge or markers.time[stop] - markers.time[start - 1] > settings.longest_gap:
                long[start:stop, i] = True
    lost = long.sum(axis=0)
    kept = lost <= lost.min()
    full = bridged(markers.time, moved[:, kept])
    full -= full[: max(5, len(full) // 50)].mean(axis=0)
    left, size, _ = np.linalg.svd(full, full_matrices=False)
    count = int(min(settings.components, np.sum(size > 1e-9 * size[0])))
    scores = left[:, :count] / np.abs(left[:, :count]).max(axis=0)
    terms = [
        settings.prior[degree - 1] * np.prod(scores[:, list(which)], axis=1)
        for degree in range(1, settings.degree + 1)
        for which in combinations_with_replacement(range(count), degree)
    ]
    # The first column is a free constant: the log's bias, far wider than any force.
    features = np.stack([np.full(len(full), 10.0), *terms], axis=1)
    spline = CubicSpline(markers.time, features, axis=0)
    before, after = (settings.hold if is_still(full, rows) else 0.0 for rows in (slice(0, 10), slice(-10, None)))
    return Track(spline.antiderivative(), np.asarray(~long[:, kept].any(axis=1)), markers.time, before, after)


def is_still(moved: Array, rows: slice) -> bool:
    """Whether nothing moves in `rows` of (T, c) displacements: less than a thousandth of the whole motion, or noise."""
    part = moved[rows]
    half = len(part) // 2
    change = np.abs(part[half:].mean(axis=0) - part[:half].mean(axis=0))
    noise = np.std(np.diff(moved, n=2, axis=0)[rows], axis=0)
    return bool(np.all(change < np.maximum(2e-3 * np.ptp(moved, axis=0).max(), 2 * noise)))


def binned(log: ForceLog, rate: float, span: tuple[float, float], settings: ClockSettings) -> Rows:
    """The log within `span`, averaged: eight rows per period of the fastest motion, within the settings' limits."""
    inside = (log.time >= span[0]) & (log.time <= span[1]) & ~outliers(log.force)
    time, force = log.time[inside], log.force[inside]
    if len(time) < 10:
        return Rows(np.empty(0), np.empty((0, 2)), 1.0)
    per_second = min(max(8 * rate, settings.slowest), settings.most_rows / (time[-1] - time[0]), 1 / step(time))
    width = 1 / per_second
    index = np.floor((time - time[0]) / width).astype(np.int64)
    count = np.bincount(index)
    total = np.stack([np.bincount(index, column) for column in force.T], axis=1)
    # A bin that lost most of its rows to a dropout does not stand for its whole span.
    good = count > 0.5 * np.median(count[count > 0])
    mean = total[good] / count[good, None]
    largest = float(np.abs(mean - np.median(mean, axis=0)).max())
    return Rows(time[0] + width * (np.flatnonzero(good) + 0.5), mean, width, largest)


def coarse_search(track: Track, rows: Rows, offset: Array, prior: Callable[[Array], Array]) -> tuple[ForceNoise, Array]:
    """The noise at the best offset and the log posterior over all of them.

    Each offset covers other rows with film, so they are compared by what the markers add to the rows they cover: the
    evidence with them over the evidence of a plain random walk as large as the force.
    """
    noise = first_guess(rows.force, rows.width)
    span = max(rows.time[-1] - rows.time[0], 1.0)
    wander = ForceNoise(noise.white, noise.coloured, noise.tau, rows.largest / np.sqrt(span))
    chance = np.full(len(offset), -np.inf)
    for _ in range(2):
        for i, each in enumerate(offset):
            design = rows.largest * track.mean(rows.time - each, rows.width)
            use = np.isfinite(design).all(axis=1)
            if use.sum() >= max(10, 0.25 * len(rows.time)):
                time, force = rows.time[use], rows.force[use]
                plain = log_evidence(wander.covariance(time), design[use, :1], force)
                chance[i] = log_evidence(noise.covariance(time), design[use], force) - plain
        best = offset[int(np.argmax(chance + prior(offset)))]
        design = rows.largest * track.mean(rows.time - best, rows.width)
        use = np.isfinite(design).all(axis=1)
        if not np.isfinite(chance).any():
            break
        noise = fit_noise(rows.time[use], design[use], rows.force[use], noise)
        wander = ForceNoise(noise.white, noise.coloured, noise.tau, max(wander.walk, noise.walk))
    return noise, chance + prior(offset)


def refined(
    track: Track, rows: Rows, coarse: Array, chance: Array, noise: ForceNoise, prior: Callable[[Array], Array]
) -> tuple[float, float]:
    """Mean and sd of the posterior around its highest peak; other peaks widen the sd by their share."""
    if not np.isfinite(chance).any():
        return float("nan"), float("inf")
    centre, reach = float(coarse[int(np.argmax(chance))]), max(3 * (coarse[1] - coarse[0]), 0.1)
    mean, sd = centre, float("inf")
    for _ in range(6):
        offset = np.linspace(centre - reach, centre + reach, 41)
        ends = [track.mean(rows.time - each, rows.width)[:, 0] for each in (offset[0], offset[-1])]
        use = np.isfinite(ends).all(axis=0)
        if use.sum() < 10:
            break
        spread = noise.covariance(rows.time[use])
        gain = np.full(len(offset), -np.inf)
        for i, each in enumerate(offset):
            design = rows.largest * track.mean(rows.time[use] - each, rows.width)
            if np.isfinite(design).all():
                gain[i] = log_evidence(spread, design, rows.force[use])
        mean, sd = moments(offset, gain + prior(offset))
        if sd < 0.3 * reach and abs(mean - centre) < 0.5 * reach and sd > 0.08 * reach:
            break
        centre, reach = mean, min(max(4.5 * sd, 1e-3), 2 * reach)
    away = np.abs(coarse - mean) > max(reach, 4 * sd)
    peak = np.exp(chance - np.max(chance))
    share = float(peak[away].sum() / peak.sum()) if away.any() else 0.0
    far = float(peak[away] @ (coarse[away] - mean) ** 2 / peak[away].sum()) if share > 0 else 0.0
    return mean, float(np.sqrt(max(sd, 1e-3) ** 2 + share * far))


def remarks_on(clock: ClockOffset, uncertainty: float, low: float, high: float) -> tuple[Remark, ...]:
    """What is odd about a found offset."""
    out = []
    if min(clock.offset - low, high - clock.offset) < 2 * clock.sd:
        text = "The clock offset found lies at the edge of the range searched; give a better start_s in [video]."
        out.append(Remark("warning", text))
    elif abs(clock.offset - clock.said) > uncertainty + 2 * clock.sd:
        text = f"The film starts {clock.offset - clock.said:+.2f} s from start_s, more than its uncertainty."
        out.append(Remark("warning", text))
    if clock.sd > 0.1:
        out.append(
            Remark("note", f"The clocks are matched to {clock.sd:.2f} s (one sd) only: the push is slow or weak.")
        )
    return tuple(out)
