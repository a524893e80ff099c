"""Natural frequencies in signals of a free swing. All signals are a sum of damped sinusoids with common frequencies and
decays, fitted by least squares (variable projection). Modes are found in turn, as peaks of the spectrum of the
residuals. The sd come from scores summed over blocks of swings (White's estimate), and are at least those of
independent residuals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import least_squares

from onebend.errors import LearningError
from onebend.learning.outcome import Notice
from onebend.options import option
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray

_FEWEST = 30  # samples
_FAST = 0.2  # of the sampling rate: a faster mode may be one that is faster still
NYQUIST = 0.45  # of the sampling rate: nearer to half of it nothing is looked for
_CYCLES = 3.0  # of a mode in the record, at least
_PADDED = 4  # times the record's length, of the Fourier transform
_AROUND, _OF_ALL = 30, 0.02  # Fourier steps to either side at least, and share of all: the noise of a peak
_BY_CHANCE = 0.05  # how likely the highest of all peaks of noise may count as a mode
_MOST = 200_000  # numbers that are looked at
_APART = 3.0  # Fourier steps, or decay rates, to the next mode
_MULTIPLE = 0.01  # within which a frequency counts as twice or three times another
_ROUNDS = 3  # of weights by what each signal leaves
_BLOCK = 4.0  # swings of the slowest mode that are summed over
_HIGHEST_RATIO = 0.5
_DEADEST, _VAGUEST = 0.3, 0.03  # decay and sd over the frequency, of what is no mode any more
_REST = 0.25  # of a record, over which a swing is nearest to its middle
_CLEAR = 5.0  # sd of the noise that half a swing must exceed
_UNEVEN, _GROWS = 0.4, 1.2  # by which half swings may differ in time, and grow, as frames are few
_FEWEST_SEEN, _OFTEN = 12, 0.7  # samples of a signal in which a swing is looked for, and share of the most
_HALF_SWINGS = 4  # that are a swing


@dataclass(frozen=True)
class FilmPart:
    """Which frames to take, on the film's clock [s]; None: from the release found in the data, to the end."""

    begin: float | None = option(
        "--from-s", None, "The beam swings freely from here on in the film; default: found.", metavar="SECONDS"
    )
    end: float | None = option("--to-s", None, "And to here in the film; default: to the end.", metavar="SECONDS")


@dataclass(frozen=True)
class SwingFrequency:
    """One mode of a free swing."""

    frequency: float  # Hz, as it swings: damped
    sd: float  # Hz
    damping_ratio: float
    damping_ratio_sd: float
    share: float  # of the largest mode's, RMS over all signals at the beginning
    multiple_of: float = 0.0  # Hz, of the mode that it is twice or three times as fast as: no mode of its own; 0: none


@dataclass(frozen=True)
class FoundFrequencies:
    """What signals of a free swing say."""

    name: str  # of what was read
    modes: tuple[SwingFrequency, ...]  # the slowest first
    begin: float  # s, of the part that was used
    end: float  # s
    samples: int
    rate: float  # samples/s
    left: float  # of the signals' own size, RMS: what no mode explains
    remarks: tuple[Notice, ...] = ()

    def sped_up(self, times: float) -> FoundFrequencies:
        """As it was, where the record plays so many times slower."""
        modes = tuple(
            replace(one, frequency=times * one.frequency, sd=times * one.sd, multiple_of=times * one.multiple_of)
            for one in self.modes
        )
        return replace(self, modes=modes, rate=times * self.rate)


@dataclass(frozen=True)
class _Signals:
    time: Array  # (N,) s from the beginning
    value: Array  # (N, C), each over its own size; 0 where it is not known
    known: BoolArray  # (N, C)
    rate: float


@one_blas_thread
def frequencies_of(
    time: Array, signals: Array, part: FilmPart = FilmPart(), *, most: int = 4, name: str = "the signals"
) -> FoundFrequencies:
    """`swing_frequencies` of a part of the record; by default from the release on, if one is seen. Raises the same."""
    _refuse_unordered(time, name)
    free = first_passage(time, signals)
    ends = float(time[0]) if np.isnan(free) else free, float(time[-1])
    begin, end = (known if asked is None else asked for asked, known in zip((part.begin, part.end), ends, strict=True))
    inside = np.flatnonzero((time >= begin) & (time <= end) & np.isfinite(signals).any(axis=1))
    looked_at = inside[: _MOST // signals.shape[1]]
    found = swing_frequencies(time[looked_at], signals[looked_at], most=most, name=name)
    if len(looked_at) == len(inside):
        return found
    values = {"samples": len(inside), "used": len(looked_at)}
    values |= {"begin": time[inside[0]], "end": time[inside[-1]], "last": time[looked_at[-1]]}
    return replace(found, remarks=(*found.remarks, Notice("many samples", values)))


def swing_frequencies(time: Array, signals: Array, *, most: int = 4, name: str = "the signals") -> FoundFrequencies:
    """The modes in signals (N, C) at times (N,) s, NaN where unknown. Raises `LearningError` for too few samples, times
    that do not rise, or no swing."""
    s = _prepared(time, signals, name)
    found: list[tuple[float, float]] = []  # rad/s, 1/s
    refused: list[tuple[float, float]] = []
    weight, left = np.ones(s.value.shape[1]), s.value
    while len(found) < most and len(refused) < most:
        peak = _highest_peak(s, left * np.sqrt(weight), [*found, *refused])
        if peak is None:
            break
        tried, covariance = _fitted(s, [*found, (peak, 0.01 * peak)], weight)
        for _ in range(_ROUNDS):
            weight = _weights(s, _left(s, tried))
            tried, covariance = _fitted(s, tried, weight)
        if _is_mode(tried, covariance):
            found, left = tried, _left(s, tried)
        else:
            refused.append((peak, 0.0))
            weight = _weights(s, left) if found else np.ones(s.value.shape[1])
    if not found:
        raise LearningError(
            f"{name}: nothing in it swings. Film from the release on until the beam has almost stopped, at five frames "
            "or more a swing; say which part with --from-s and --to-s"
        )
    found, covariance = _fitted(s, found, weight)
    modes = _modes(s, found, covariance)
    size = float(np.sqrt(np.sum(_left(s, found) ** 2) / np.sum(s.value**2)))
    ends = float(time[0]), float(time[-1])
    return FoundFrequencies(name, modes, *ends, len(s.time), s.rate, size, _notices(modes, s))


def _prepared(time: Array, signals: Array, name: str) -> _Signals:
    known = np.isfinite(signals)
    enough = known.sum(axis=0) >= max(_FEWEST, int(0.3 * len(time)))
    if len(time) < _FEWEST or not enough.any():
        raise LearningError(f"{name}: {len(time)} samples are too few; {_FEWEST} or more of one signal are needed")
    _refuse_unordered(time, name)
    known, signals = known[:, enough], signals[:, enough]
    value = np.where(known, signals - np.nanmean(signals, axis=0), 0.0)
    size = np.sqrt(np.sum(value**2, axis=0) / known.sum(axis=0))
    if not np.any(size > 0.0):
        raise LearningError(f"{name}: nothing in it moves")
    moves = size > 1e-12 * size.max()
    steps = np.diff(time)
    rate = 1.0 / float(np.mean(steps[steps < 1.5 * np.median(steps)]))
    return _Signals(time - time[0], value[:, moves] / size.max(), known[:, moves], rate)


def _refuse_unordered(time: Array, name: str) -> None:
    if not (np.isfinite(time).all() and np.all(np.diff(time) > 0.0)):
        raise LearningError(f"{name}: the times must be known and rise from row to row")


def first_passage(time: Array, signals: Array) -> float:
    """s, of the first passage through rest of a swing that is regular and dies away; NaN if no signal (N, C) shows
    one."""
    found, most = [], int(np.max(np.isfinite(signals).sum(axis=0), initial=0))
    for column in signals.T:
        seen = np.isfinite(column)
        if seen.sum() < max(_FEWEST_SEEN, _OFTEN * most):
            continue
        value = column[seen] - np.median(column[seen][-max(int(_REST * seen.sum()), _FEWEST_SEEN) :])
        rough = float(np.median(np.abs(np.diff(value, n=2)))) / np.sqrt(6.0)
        found.append(_first_passage(time[seen], value, _CLEAR * rough))
    return float(np.nanmin(found)) if np.isfinite(found).any() else float("nan")


def _first_passage(time: Array, value: Array, least: float) -> float:
    """s, begin of the longest chain of half swings that are alike in time, do not grow and exceed `least`; NaN if it is
    short."""
    change = np.flatnonzero(np.diff(np.sign(value)) != 0.0)
    share = value[change] / (value[change] - value[change + 1])
    passage = time[change] + share * (time[change + 1] - time[change])
    size = np.array([np.max(np.abs(part)) for part in np.split(value, change + 1)[1:-1]])
    lasts = np.diff(passage)
    best, first = 0, float("nan")
    for i in range(len(lasts)):
        usual, stop = lasts[i], i
        while stop < len(lasts) and size[stop] > least and abs(lasts[stop] / usual - 1.0) < _UNEVEN:
            if stop > i and size[stop] > _GROWS * size[stop - 1]:
                break
            stop += 1
            usual = float(np.median(lasts[i:stop]))
        if stop - i > best:
            best, first = stop - i, float(passage[i])
    return first if best >= _HALF_SWINGS else float("nan")


def basis_of(t: Array, modes: list[tuple[float, float]]) -> Array:
    """(N, 2 + 2 K): a level, a drift, and the two phases of each mode."""
    columns = [np.ones_like(t), t / t[-1] - 0.5]
    for omega, decay in modes:
        fall = np.exp(-decay * t)
        columns += [fall * np.cos(omega * t), fall * np.sin(omega * t)]
    return np.stack(columns, axis=1)


def _left(s: _Signals, modes: list[tuple[float, float]]) -> Array:
    """(N, C) what modes of these frequencies and decays leave; 0 where not known."""
    return s.value - _explained(s, modes)[0]


def _explained(s: _Signals, modes: list[tuple[float, float]]) -> tuple[Array, Array]:
    """(N, C) what the modes explain, and their sizes (2 + 2 K, C)."""
    basis, sizes = basis_of(s.time, modes), np.zeros((2 + 2 * len(modes), s.value.shape[1]))
    whole = s.known.all(axis=0)
    sizes[:, whole] = np.linalg.lstsq(basis, s.value[:, whole], rcond=None)[0]
    for c in np.flatnonzero(~whole):
        rows = s.known[:, c]
        sizes[:, c] = np.linalg.lstsq(basis[rows], s.value[rows, c], rcond=None)[0]
    return np.where(s.known, basis @ sizes, 0.0), sizes


def _weights(s: _Signals, left: Array) -> Array:
    """(C,) of the squares of each signal, by what it leaves; the largest is 1."""
    variance = np.sum(left**2, axis=0) / np.maximum(s.known.sum(axis=0), 1)
    return np.asarray(np.maximum(variance.min(), 1e-12) / np.maximum(variance, 1e-12))


def _fitted(s: _Signals, modes: list[tuple[float, float]], weight: Array) -> tuple[list[tuple[float, float]], Array]:
    """Frequencies and decays by least squares, and their covariance (2 K, 2 K) in (rad/s, 1/s) pairs."""
    scale = np.array([value for omega, _ in modes for value in (1.0 / s.time[-1], 1.0 / s.time[-1])])
    root = np.sqrt(weight)

    def residuals(x: Array) -> Array:
        return (_left(s, _pairs(x)) * root).ravel()

    start = np.array(modes).ravel()
    slowest = 2.0 * np.pi * _CYCLES / s.time[-1]
    low = np.array([value for omega, _ in modes for value in (max(0.5 * omega, slowest), 0.0)])
    high = np.array([value for omega, _ in modes for value in (1.5 * omega, _HIGHEST_RATIO * omega)])
    best = least_squares(residuals, np.clip(start, low + 1e-9 * scale, high), x_scale=scale, bounds=(low, high))
    return _pairs(best.x), _covariance(s, best.jac, best.fun, min(omega for omega, _ in modes))


def _pairs(x: Array) -> list[tuple[float, float]]:
    return [(float(omega), float(decay)) for omega, decay in x.reshape(-1, 2)]


def _is_mode(modes: list[tuple[float, float]], covariance: Array) -> bool:
    sd = np.sqrt(np.diag(covariance)).reshape(-1, 2)[:, 0]
    pairs = zip(modes, sd, strict=True)
    return all(decay < _DEADEST * omega and away < _VAGUEST * omega for (omega, decay), away in pairs)


def _covariance(s: _Signals, jacobian: Array, left: Array, slowest: float) -> Array:
    """Of least squares whose residuals (N C,) may be alike over some swings."""
    samples = float(s.known.sum())
    free = max(samples - jacobian.shape[1] - 2.0 * (1 + jacobian.shape[1]), 1.0)
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    plain = inverse * float(left @ left) / free
    scores = (jacobian * left[:, None]).reshape(len(s.time), -1, jacobian.shape[1]).sum(axis=1)
    block = np.floor(s.time * slowest / (2.0 * np.pi * _BLOCK)).astype(int)
    summed = np.stack([np.bincount(block, column) for column in scores.T], axis=1)
    blocks = max(len(summed), 2)
    meat = summed.T @ summed * blocks / (blocks - 1) * samples / free
    alike = inverse @ meat @ inverse
    stretch = np.sqrt(np.maximum(np.diag(alike) / np.maximum(np.diag(plain), 1e-300), 1.0))
    return np.asarray(plain * np.outer(stretch, stretch))


def _highest_peak(s: _Signals, left: Array, known: list[tuple[float, float]]) -> float | None:
    """rad/s, of the highest peak of the spectrum that is no noise and no part of a mode already found."""
    count = round(s.time[-1] * s.rate) + 1
    even = np.linspace(0.0, s.time[-1], count)
    columns = [_without_memory(_on_even_times(even, s.time[rows], left[rows, c])) for c, rows in enumerate(s.known.T)]
    taper = np.cos(0.5 * np.pi * even / even[-1]) ** 2  # whole where a swing is largest
    windowed = np.stack(columns, axis=1) * taper[:, None]
    power = np.sum(np.abs(np.fft.rfft(windowed, _PADDED * count, axis=0)) ** 2, axis=1)
    step = 2.0 * np.pi * s.rate / (_PADDED * count)
    omega = step * np.arange(len(power))
    around = median_filter(power, 2 * max(_AROUND, int(_OF_ALL * count)) * _PADDED + 1)
    around = np.maximum(around, 1e-3 * np.median(around))
    allowed = (omega > _CYCLES * 2.0 * np.pi / s.time[-1]) & (omega < 2.0 * np.pi * NYQUIST * s.rate)
    for other, decay in known:
        allowed &= np.abs(omega - other) > _APART * max(decay, _PADDED * step)
    allowed[1:-1] &= (power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])
    # The power of noise is exponentially distributed, its median ln 2 of the mean.
    allowed &= power > around / np.log(2.0) * np.log(len(power) / _BY_CHANCE)
    if not allowed.any():
        return None
    return float(omega[np.argmax(np.where(allowed, power, 0.0))])


def _on_even_times(even: Array, time: Array, value: Array) -> Array:
    after = np.clip(np.searchsorted(time, even), 1, len(time) - 1)
    near = np.minimum(np.abs(even - time[after - 1]), np.abs(time[after] - even)) < 0.75 * (even[1] - even[0])
    return np.where(near, np.interp(even, time, value), 0.0)


def _without_memory(value: Array) -> Array:
    """(N,) less what the sample before lets expect: noise with a memory has no hill at low frequencies then."""
    power = float(value @ value)
    share = float(value[1:] @ value[:-1]) / power if power > 0.0 else 0.0
    return np.asarray(np.concatenate([value[:1], value[1:] - share * value[:-1]]))


def _modes(s: _Signals, found: list[tuple[float, float]], covariance: Array) -> tuple[SwingFrequency, ...]:
    _, sizes = _explained(s, found)
    strength = np.sqrt(np.sum(sizes[2:] ** 2, axis=1).reshape(-1, 2).sum(axis=1))
    sd = np.sqrt(np.diag(covariance)).reshape(-1, 2)
    out: list[SwingFrequency] = []
    for i in np.argsort([omega for omega, _ in found]):
        omega, decay = found[i]
        ratio = decay / float(np.hypot(omega, decay))
        hz = omega / (2.0 * np.pi)
        base = next((one.frequency for one in out if not one.multiple_of and _is_multiple(hz, one.frequency)), 0.0)
        ratio_sd, share = float(sd[i, 1]) / omega, float(strength[i] / strength.max())
        out.append(SwingFrequency(hz, float(sd[i, 0]) / (2.0 * np.pi), ratio, ratio_sd, share, base))
    return tuple(out)


def _is_multiple(hz: float, base: float) -> bool:
    return any(abs(hz / (n * base) - 1.0) < _MULTIPLE for n in (2, 3))


def _notices(modes: tuple[SwingFrequency, ...], s: _Signals) -> tuple[Notice, ...]:
    fastest = modes[-1].frequency
    fast = (Notice("fast mode", {"frequency": fastest, "rate": s.rate}),) if fastest > _FAST * s.rate else ()
    multiples = [one for one in modes if one.multiple_of]
    return (*fast, *(Notice("multiple", {"frequency": one.frequency, "of": one.multiple_of}) for one in multiples))
