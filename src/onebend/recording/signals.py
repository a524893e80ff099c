"""Small tools for sampled signals: bandwidth, outliers, gaps, the zero-phase low-pass. Arrays in, arrays out."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import maximum_filter1d, median_filter, percentile_filter, uniform_filter1d

from onebend.errors import RecordingError
from onebend.records import Array, BoolArray, IntArray, Remark, unit

LATEST = 1e11  # s: no clock of a recording, since 1970 or since it was started, says more
MOST_STEPS = 5e7  # of a log: half a day at 1 kHz
MOST_FRAMES = 2e6  # of a film or of tracks: half a day at 50 Hz
MAD_TO_SD = 1.4826  # of a normal distribution
LONG_GAP = 0.25  # s: motion within a longer gap is not interpolated
SEPARATE = 10.0  # periods of the cut-off: stretches farther apart are filtered separately
SIDE, FEWEST_ON_LINE = 0.25, 8  # periods, and samples at least, beside a gap that give the level and slope there
BRIDGE = 15  # points of a bridge over a gap
SPIKE = 0.75  # s, in which outliers are looked for
FILTER_ORDER = 2  # run forwards and backwards: four poles, no phase


def check_span(time: Array, where: str, *, most: float = MOST_STEPS) -> None:
    """Raise `RecordingError` where rising times (N,) span so many of their usual steps that one must be wrong."""
    if len(time) < 2 or float(np.ptp(time)) < most * step(time):
        return
    gap = int(np.argmax(np.diff(time)))
    raise RecordingError(
        f"{where}: {len(time)} times span {np.ptp(time):.3g} s, one every {step(time):.3g} s, with a gap from "
        f"{time[gap]:.6g} to {time[gap + 1]:.6g} s. Correct the wrong times, or cut it there."
    )


def step(time: Array) -> float:
    """Median time between samples, s."""
    return float(np.median(np.diff(time)))


def bridged(time: Array, values: Array, longest_gap: Array | float = np.inf) -> Array:
    """`values` (T, c) with NaN replaced by linear interpolation in time, but in gaps longer than `longest_gap` () or
    (c,) [s]; a column without two numbers becomes zero."""
    filled = np.array(values, dtype=float)
    for column, longest in zip(filled.T, np.broadcast_to(longest_gap, filled.shape[1]), strict=True):
        good = np.isfinite(column)
        if not good.all():
            ends = np.concatenate([[-np.inf], time[good], [np.inf]])
            after = np.searchsorted(ends, time[~good])
            between = np.interp(time[~good], time[good], column[good]) if good.sum() > 1 else 0.0
            column[~good] = np.where(ends[after] - ends[after - 1] > longest, np.nan, between)
    return filled


def from_clamp(s: Array, xy: Array, angle: Array) -> tuple[Array, Array, Array]:
    """Places `s` (m,), points (T, m, 2) and angles (T, m) with the clamp, all zeros, before them; sorted by s."""
    order, count = np.argsort(np.append(0.0, s), kind="stable"), len(xy)
    xy = np.concatenate([np.zeros((count, 1, 2)), xy], axis=1)
    angle = np.concatenate([np.zeros((count, 1)), angle], axis=1)
    return np.append(0.0, s)[order], xy[:, order], angle[:, order]


def along_tags(s: Array, xy: Array, angle: Array, length: float) -> CubicHermiteSpline:
    """The beam's axis from clamp and tags, s (m,), (m, 2) m, (m,) rad: a cubic with their directions."""
    at, (places,), (angles,) = from_clamp(s, xy[None], angle[None])
    at, first = np.unique(at, return_index=True)
    return CubicHermiteSpline(at, places[first], length * unit(angles[first]))


def bandwidth(time: Array, values: Array) -> float:
    """Frequency below which 99.9 % of the power of the velocity of `values` lies, Hz; NaN where nothing moves.

    The samples' white noise rises as sin^2(pi f dt) in the velocity's spectrum; its size is the median above 0.4 of the
    highest frequency. It is taken off, and only frequencies count where the power is five times the noise. (T, c)
    columns share a unit and are summed. The velocity runs straight across long gaps."""
    dt = step(time)
    grid = np.arange(time[0], time[-1] + 0.5 * dt, dt)
    if len(grid) < 16:
        return float("nan")
    full = bridged(time, values)
    even = np.stack([np.interp(grid, time, column) for column in full.T], axis=1)
    velocity = steady(np.diff(even, axis=0) / dt, grid, time, values)
    power = np.sum(np.abs(np.fft.rfft(velocity * np.hanning(len(velocity))[:, None], axis=0)) ** 2, axis=1)
    frequency = np.fft.rfftfreq(len(velocity), dt)
    noise = np.sin(np.pi * frequency * dt) ** 2
    high = frequency > 0.4 * frequency[-1]
    # The power of noise is exponentially distributed for one column: its median is ln 2 of the mean.
    noise *= float(np.median(power[high] / noise[high])) / np.log(2)
    window = min(11, len(power) // 2)
    counts = uniform_filter1d(power, window, mode="nearest") > 5 * uniform_filter1d(noise, window, mode="nearest")
    total = np.cumsum(np.where(counts, np.maximum(power - noise, 0.0), 0.0))
    if not total[-1] > 0:
        return float("nan")
    return float(frequency[int(np.searchsorted(total, 0.999 * total[-1]))])


def steady(velocity: Array, grid: Array, time: Array, values: Array) -> Array:
    """(N - 1, c) `velocity` between the instants `grid`, straight over gaps longer than `LONG_GAP` in `values` (T,
    c)."""
    straightened = velocity.copy()
    for column, measured in zip(straightened.T, np.isfinite(values).T, strict=True):
        known = time[measured]
        if len(known) < 2:
            continue
        after = np.searchsorted(known, grid[1:] - 0.5 * (grid[1] - grid[0]))
        gap = np.concatenate([[np.inf], np.diff(known), [np.inf]])[after]
        good = gap <= LONG_GAP
        if good.any() and not good.all():
            column[~good] = np.interp(np.flatnonzero(~good), np.flatnonzero(good), column[good])
    return straightened


def outliers(values: Array, *, spacing: float = 0.0) -> BoolArray:
    """(N,) True where a column deviates from its running median by more than six robust local sd (Hampel).

    The local scale is the running median of the absolute deviation over ten times the window, but at least half of the
    whole signal's, and what the signal changes from sample to sample. A signal without noise has no outliers. With
    samples `spacing` [s] apart the window is at most `SPIKE`, but five samples."""
    size = 2 * int(np.clip(0.5 * SPIKE / spacing, 2, 7) if spacing > 0.0 else 7) + 1
    is_outlier = np.zeros(len(values), dtype=bool)
    if len(values) < size:
        return is_outlier
    for column in values.T:
        deviation = np.abs(column - median_filter(column, size, mode="nearest"))
        overall = MAD_TO_SD * float(np.median(deviation))
        stride = max(1, size // 3)
        coarse = MAD_TO_SD * median_filter(deviation[::stride], max(3, 10 * size // stride), mode="nearest")
        scale = np.maximum(np.repeat(coarse, stride)[: len(deviation)], 0.5 * overall)
        change = median_filter(np.abs(np.diff(column, append=column[-1:])), size, mode="nearest")
        if overall > 0:
            is_outlier |= deviation > 6.0 * np.maximum(scale, change)
    return is_outlier


def within_noise(column: Array) -> bool:
    """Whether the samples (N,) scatter by more than the steps in which they are written."""
    steps = np.diff(np.unique(column))
    if len(column) < 10 or not len(steps):
        return False
    # Steps of the last digit: larger noise is visible.
    return bool(np.median(np.abs(np.diff(column, n=2))) > 3.0 * float(np.min(steps)))


def low_pass(time: Array, values: Array, cutoff: float, *, longest_gap: float) -> Array:
    """Zero-phase Butterworth low-pass (half power twice, so -6 dB, at `cutoff` [Hz]) of (N, c) `values` at `time`.

    The gain is applied to the spectrum of the samples, less the cubic with the level and slope at their two ends, and
    their even reflection: what begins or ends on a slope is not flattened there. Irregular samples are interpolated to
    an even grid and back. A gap longer than `longest_gap` [s] is bridged by such a cubic. Stretches more than
    `SEPARATE` periods apart are filtered separately; one too short to filter becomes its mean."""
    filtered = np.array(values, dtype=float)
    if not np.isfinite(cutoff):
        return filtered
    dt = step(time)
    if cutoff >= 0.45 / dt:
        return filtered
    farthest = max(longest_gap, SEPARATE / cutoff)
    for rows in np.split(np.arange(len(time)), 1 + np.flatnonzero(np.diff(time) > farthest)):
        t, bridge = bridged_gaps(time[rows], values[rows], longest_gap, SIDE / cutoff)
        grid = t[0] + dt * np.arange(int(np.floor((t[-1] - t[0]) / dt + 0.5)) + 1)
        if len(grid) < 16:
            filtered[rows] = np.mean(values[rows], axis=0)
            continue
        even = resampled(t, bridge, grid)
        first, last = (np.abs(grid - grid[end]) <= SIDE / cutoff for end in (0, -1))
        slope = cubic_between(grid, even, first, last)(grid)
        reflected = np.concatenate([even - slope, (even - slope)[-2:0:-1]])
        ratio = np.tan(np.pi * np.fft.rfftfreq(len(reflected))) / np.tan(np.pi * cutoff * dt)
        gain = flattened(1.0 / (1.0 + ratio[:, None] ** (2 * FILTER_ORDER)))
        smooth = np.fft.irfft(gain * np.fft.rfft(reflected, axis=0), len(reflected), axis=0)[: len(even)]
        filtered[rows] = resampled(grid, smooth + slope, time[rows])
    return filtered


def resampled(time: Array, values: Array, at: Array) -> Array:
    """(T, c) `values` (N, c) at `at` (T,), straight between the rising `time` (N,); unchanged where these are the
    same."""
    if len(at) == len(time) and np.max(np.abs(at - time)) < 1e-6 * step(time):
        return values
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)


def bridged_gaps(time: Array, values: Array, longest_gap: float, reach: float) -> tuple[Array, Array]:
    """`time` (N,) and `values` (N, c) with a cubic in every gap longer than `longest_gap` [s]; its ends and slopes are
    those of the lines through the `reach` [s] before and behind it."""
    gaps = np.flatnonzero(np.diff(time) > longest_gap)
    if not len(gaps):
        return time, values
    times, rows = [], []
    borders = np.concatenate([[-1], gaps, [len(time) - 1]])
    for before, gap, after in zip(borders, gaps, borders[2:], strict=False):
        left, right = np.arange(before + 1, gap + 1), np.arange(gap + 1, after + 1)
        left, right = left[time[left] >= time[gap] - reach], right[time[right] <= time[gap + 1] + reach]
        inside = np.linspace(time[gap], time[gap + 1], BRIDGE + 2)[1:-1]
        times.append(inside)
        rows.append(cubic_between(time, values, left, right, (int(gap), int(gap) + 1))(inside))
    where = np.repeat(gaps + 1, BRIDGE)
    return np.insert(time, where, np.concatenate(times)), np.insert(values, where, np.concatenate(rows), axis=0)


def cubic_between(
    time: Array, values: Array, left: IntArray | BoolArray, right: IntArray | BoolArray, at: tuple[int, int] = (0, -1)
) -> CubicHermiteSpline:
    """The cubic from sample `at[0]` to `at[1]`; its ends and slopes are those of the lines through the samples `left`
    and `right` of `time` (N,) and `values` (N, c)."""
    ends = [line_at(time[near], values[near], time[i]) for near, i in zip((left, right), at, strict=True)]
    return CubicHermiteSpline(time[list(at)], [level for level, _ in ends], [slope for _, slope in ends])


def line_at(time: Array, values: Array, at: float) -> tuple[Array, Array]:
    """(c,) value and slope at `at` of the line through `values` (N, c); of few values the mean, with slope zero."""
    if len(time) < FEWEST_ON_LINE:
        return np.asarray(values.mean(axis=0)), np.zeros(values.shape[1])
    basis = np.stack([np.ones_like(time), time - at], axis=1)
    line = np.linalg.lstsq(basis, values, rcond=None)[0]
    return line[0], line[1]


def low_pass_power(frequency: Array, cutoff: float) -> Array:
    """Share of a signal's power that `low_pass` lets through at `frequency` [Hz]: the filter's gain runs twice."""
    return np.asarray(flattened(1.0 / (1.0 + (frequency / cutoff) ** (2 * FILTER_ORDER))) ** 2)


def flattened(gain: Array) -> Array:
    """The gain of a filter that is run again over what it took away (Tukey's twicing): a loss becomes its square."""
    return gain * (2.0 - gain)


def at_times(time: Array, values: Array, at: Array, *, longest_gap: float) -> Array:
    """(T, c) `values` interpolated at `at`; NaN outside `time` and inside gaps longer than `longest_gap` [s]."""
    interpolated = np.stack([np.interp(at, time, column) for column in values.T], axis=1)
    after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    outside = (at < time[0]) | (at > time[-1])
    on_sample = (at == time[after]) | (at == time[after - 1])
    interpolated[outside | ((time[after] - time[after - 1] > longest_gap) & ~on_sample)] = np.nan
    return interpolated


def runs(mask: BoolArray) -> IntArray:
    """(r, 2) first and one-past-last index of every run of True."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int64), [0]]))
    return np.stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)], axis=1).astype(np.int64)


HELD, SLOW = 0.5, 20.0  # s, and usual run lengths: forces that repeat for longer were not measured


def missing(time: Array) -> int:
    """How many samples are missing between those at `time` [s, rising]; 0 where the spacing is uneven."""
    if len(time) < 3:
        return 0
    steps, spacing = np.diff(time), step(time)
    # Of the samples: with more at uneven spacings the log has no rate, and missing ones cannot be counted.
    if not spacing > 0 or np.mean(np.abs(steps - spacing) > spacing / 2) > 0.1:
        return 0
    return int(np.sum(np.maximum(np.rint(steps / spacing) - 1, 0)))


def missing_remarks(time: Array, what: str) -> tuple[Remark, ...]:
    """A remark on missing samples at `time` [s, rising]; `what` names them, as "rows of the force log"."""
    count = missing(time)
    if not count:
        return ()
    longest = float(np.diff(time).max())
    text = f"Missing {what}: about {count}, beside {len(time)} present; the longest gap is {longest:.3g} s."
    if count <= 0.01 * len(time):  # of the samples: if more are missing, it is a warning
        return (Remark("note", text, about="bad rows"),)
    return (Remark("warning", f"{text} Look at what drops them, and record again.", about="bad rows"),)


def false_zeros(force: Array) -> BoolArray:
    """(N,) rows in which `force` (N, c) is exactly zero between other values: the robot did not stream.

    A run of zeros between two jumps is false. One without jumps may be a true zero force; it counts as false only where
    several false runs exist and it is no longer than the longest of them."""
    zero = np.asarray(np.all(force == 0.0, axis=1))
    if not zero.any() or zero.all():
        return np.zeros(len(force), dtype=bool)
    size = np.linalg.norm(force, axis=1)
    pairs = ~zero[1:] & ~zero[:-1]
    noise = MAD_TO_SD * float(np.median(np.linalg.norm(np.diff(force, axis=0), axis=1)[pairs])) if pairs.any() else 0.0
    false = np.zeros(len(force), dtype=bool)
    spans = runs(zero).tolist()
    sure = []
    for begin, end in spans:
        beside = [size[i] for i in (begin - 1, end) if 0 <= i < len(size)]
        # Noise sd: a run of zeros between smaller jumps may be a true zero force.
        if noise > 0 and min(beside) > 5.0 * noise:
            sure.append((begin, end))
    if len(sure) >= 3:  # runs of zeros that are certainly false; with so many, other runs as short count as false too
        longest = max(end - begin for begin, end in sure)
        sure += [(begin, end) for begin, end in spans if end - begin <= longest]
    for begin, end in sure:
        false[begin:end] = True
    return false


def held(time: Array, force: Array) -> BoolArray:
    """(N,) rows that repeat the forces (N, c) of the row before for so long that the sensor or the logger hung.

    Logs without noise are not judged, nor are zeros, which may be true, and the largest and smallest forces."""
    hung = np.zeros(len(force), dtype=bool)
    if not len(force):
        return hung
    same = np.concatenate([[False], np.all(np.diff(force, axis=0) == 0.0, axis=1)])
    fresh = force[~same]
    if len(fresh) < 10 or not any(within_noise(column) for column in fresh.T):
        return hung
    run = float(np.median(np.diff(np.flatnonzero(~same))))
    extreme = np.all((force == force.max(axis=0)) | (force == force.min(axis=0)), axis=1)
    same &= ~extreme & np.any(force != 0.0, axis=1)
    for begin, end in runs(same):
        if end - begin > SLOW * run and time[end - 1] - time[begin] > HELD:
            hung[begin:end] = True
    return hung


AROUND = 3  # samples on either side that tell how fast points move
STANDS = 0.3  # of the usual step: packing a film moves the tags of a copy by up to as much


def copies_in_motion(time: Array, points: Array, still: float, least: float) -> BoolArray:
    """(T,) samples in which points (T, m, 2) stand as in the one before (to `still`), though they move on.

    A recorder that drops frames fills their places with copies, and a camera may hang. After n copies the points have
    gone n + 1 steps. They must go by more than `least`, by more than their noise, and by half of these steps at the
    speed before or after (three of a long stretch): points that only begin to move go one step."""
    out = np.zeros(len(points), dtype=bool)
    shown = np.flatnonzero(np.isfinite(points).min(axis=-1).max(axis=1))
    if len(shown) < 4:
        return out
    time, there = time[shown], bridged(time[shown], points[shown].reshape(len(shown), -1))
    step = np.linalg.norm(np.diff(there, axis=0), axis=1)
    usual = percentile_filter(step, 70, 2 * AROUND + 3, mode="nearest")
    own = np.flatnonzero(np.append(True, step > np.maximum(still, STANDS * usual)))
    speed = np.linalg.norm(np.diff(there[own], axis=0), axis=1) / np.diff(time[own])
    bends = np.linalg.norm(np.diff(there[own], n=2, axis=0), axis=1)
    least = max(least, 2.0 * MAD_TO_SD * float(np.median(bends)) if len(bends) else 0.0)
    for k in np.flatnonzero(np.diff(own) > 1).tolist():
        begin, end = int(own[k]), int(own[k + 1])
        sides = [part for part in (speed[max(k - AROUND, 0) : k], speed[k + 1 : k + 1 + AROUND]) if len(part)]
        one = max((float(part.mean()) for part in sides), default=0.0) * (time[end] - time[end - 1])
        if step[end - 1] > max(min(0.5 * (end - begin), 3.0) * one, least):
            out[shown[begin + 1 : end]] = True
    return out


LONGEST_LAG = 8  # a correlation time takes lags up to this part (1 / 8) of the frames
UNCORRELATED = 0.05  # correlation from which on a correlation time is cut off


JUMP = 6.0  # times the usual distance to the points beside and half the motion from frame to frame


def jumps(path: Array, least: float) -> BoolArray:
    """(N,) which points of a path (N, 2) lie `least` or more away from those beside them, in its unit, and by far more
    than noise and motion explain; none of a path without three points on either side of one."""
    if len(path) < 7:
        return np.zeros(len(path), dtype=bool)
    padded = np.pad(path, ((3, 3), (0, 0)), mode="reflect")
    beside = np.median([padded[k : k + len(path)] for k in (0, 1, 2, 4, 5, 6)], axis=0)
    away = np.linalg.norm(path - beside, axis=1)
    motion = maximum_filter1d(np.linalg.norm(np.gradient(beside, axis=0), axis=1), 7)
    usual = median_filter(away, 15, mode="mirror")  # of a swing it is large
    return np.asarray(away > np.maximum(least, JUMP * (usual + 0.5 * motion)))


def correlation_time(r: Array, longest: int = LONGEST_LAG) -> float:
    """`1 + 2 sum rho` of residuals (F, channels) over the lags where the correlation is positive, up to a part of F,
    pooled."""
    z = r - np.mean(r, axis=0)
    spread = MAD_TO_SD * np.median(np.abs(z), axis=0)
    z = np.clip(np.divide(z, spread, out=np.zeros_like(z), where=spread > 0.0), -3.0, 3.0)
    power = float(np.sum(z**2))
    total = 1.0
    for lag in range(1, max(len(z) // longest, 2)):
        rho = float(np.sum(z[:-lag] * z[lag:])) / max(power, 1e-12)
        if rho < UNCORRELATED:
            break
        total += 2.0 * rho
    return total


def running_median(values: Array, count: int) -> Array:
    """Medians over `count` rows around each row of `values` (N, ...), NaN left out; the ends repeat."""
    padded = np.pad(values, [(count // 2, count // 2), *[(0, 0)] * (values.ndim - 1)], mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, count, axis=0)
    return np.asarray(np.median(windows, axis=-1)) if np.isfinite(values).all() else nan_median(windows, axis=-1)


def nan_median(values: Array, axis: int = 0) -> Array:
    """Median of what is there; NaN where nothing is."""
    known = np.isfinite(values).any(axis=axis)
    return np.where(known, np.nanmedian(np.where(np.expand_dims(known, axis), values, 0.0), axis=axis), np.nan)


def nan_mean(values: Array, axis: int = 0) -> Array:
    """Mean of what is there; NaN where nothing is."""
    known = np.isfinite(values)
    count, total = known.sum(axis=axis), np.where(known, values, 0.0).sum(axis=axis)
    return np.asarray(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))
