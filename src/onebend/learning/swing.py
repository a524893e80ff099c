"""Free swings: their modes, damping, and k over mass."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import least_squares

from onebend.beam.dynamics import Actions, Body, body
from onebend.beam.grid import Modes
from onebend.beam.model import Beam
from onebend.beam.stiffness import Profile, Scaled, Table, UncertainStiffness, Uniform
from onebend.beam.vibration import Vibration, settle, vibration_of
from onebend.errors import LearningError, MechanicsError
from onebend.learning.outcome import Notice
from onebend.learning.parameters import MASS_SPREAD
from onebend.options import option
from onebend.progress import one_blas_thread
from onebend.record_data import record_from
from onebend.records import Array, BoolArray, Observations, tags_among

# Natural frequencies in signals of a free swing. All signals are a sum of damped sinusoids with common frequencies and
# decays, fitted by least squares (variable projection). Modes are found in turn, as peaks of the spectrum of the
# residuals. The sd come from scores summed over blocks of swings (White's estimate), and are at least those of
# independent residuals.

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
_HIGHEST_RATIO = 0.5  # of damping, a bound of the search beyond `_DEADEST`
_DEADEST, _VAGUEST = 0.3, 0.03  # decay and sd over the frequency, of what is no mode any more
_REST = 0.25  # of a record, over which a swing is nearest to its middle
_CLEAR = 5.0  # sd of the noise that half a swing must exceed
_UNEVEN, _GROWS = 0.4, 1.2  # by which half swings may differ in time, and grow, as frames are few
_FEWEST_SEEN, _OFTEN = 12, 0.7  # samples of a signal in which a swing is looked for, and share of the most
_HALF_SWINGS = 4  # that are a swing


@dataclass(frozen=True)
class FilmPart:
    """Which frames to take, on the film's clock [s]; None: from the release found in the data, to the end."""

    begin: float | None = option("--from-s", None)
    end: float | None = option("--to-s", None)


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
        seen = np.isfinite(signals).sum(axis=0)
        often = seen >= _OFTEN * seen.max()
        if not often.all():  # what long gaps leave of a signal may hide the swing of the others
            return swing_frequencies(time, signals[:, often], most=most, name=name)
        raise LearningError(
            f"{name}: nothing in it swings. Film from the release on until the beam has almost stopped, at five frames "
            "or more a swing; say which part with --from-s and --to-s"
        )
    found, covariance = _fitted(s, found, weight)
    modes = _modes(s, found, covariance)
    size = float(np.sqrt(np.sum(_left(s, found) ** 2) / np.sum(s.value**2)))
    ends = float(time[0]), float(time[-1])
    return FoundFrequencies(name, modes, *ends, len(s.time), s.rate, size, _mode_notices(modes, s))


def _prepared(time: Array, signals: Array, name: str) -> _Signals:
    known = np.isfinite(signals)
    enough = known.sum(axis=0) >= max(_FEWEST, int(0.3 * len(time)))
    if len(time) < _FEWEST or not enough.any():
        raise LearningError(
            f"{name}: the free swing has {len(time)} samples; {_FEWEST} or more of one signal are needed. Film it for "
            "longer, or say where it is with --from-s and --to-s"
        )
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
        swing = half_swings(time[seen], value, roughness(value))
        found += [] if swing is None else [swing.passage]
    return min(found, default=float("nan"))


def roughness(value: Array) -> float:
    """The median of white noise without its sign, 0.67 sds, in a smooth signal (N,), N >= 3: by second differences."""
    return float(np.median(np.abs(np.diff(value, n=2))) / np.sqrt(6.0))


@dataclass(frozen=True)
class HalfSwings:
    """Half swings in a row, alike in time, of which none is larger than the one before."""

    passage: float  # s, where the first begins
    half: float  # s, how long one lasts
    end: float  # s, where the last one ends
    size: float  # of the first
    left: float  # size of the last over that of the first


def half_swings(
    time: Array, value: Array, noise: float, *, fewest: int = _HALF_SWINGS, starts: int | None = None
) -> HalfSwings | None:
    """The longest row of half swings clear of `noise` in a signal (N,) that is zero at rest; of those that begin
    at one of the first `starts` passages through rest, where said. None: all have less than `fewest`."""
    change = np.flatnonzero(np.diff(np.sign(value)) != 0.0)
    share = value[change] / (value[change] - value[change + 1])
    passage = time[change] + share * (time[change + 1] - time[change])
    size = np.array([np.max(np.abs(part)) for part in np.split(value, change + 1)[1:-1]])
    lasts, rows = np.diff(passage), []
    for i in range(len(lasts))[:starts]:
        usual, stop = lasts[i], i
        while stop < len(lasts) and size[stop] > _CLEAR * noise and abs(lasts[stop] / usual - 1.0) < _UNEVEN:
            if stop > i and size[stop] > _GROWS * size[stop - 1]:
                break
            stop += 1
            usual = float(np.median(lasts[i:stop]))
        if stop - i >= fewest:
            rows.append((i, stop))
    if not rows:
        return None
    i, stop = max(rows, key=lambda row: row[1] - row[0])
    half = float(np.median(lasts[i:stop]))
    return HalfSwings(float(passage[i]), half, float(passage[stop]), float(size[i]), float(size[stop - 1] / size[i]))


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
        bases = (
            one.frequency
            for one in out
            if not one.multiple_of
            for n in (2, 3)
            if abs(hz / (n * one.frequency) - 1.0) < _MULTIPLE
        )
        base = next(bases, 0.0)
        ratio_sd, share = float(sd[i, 1]) / omega, float(strength[i] / strength.max())
        out.append(SwingFrequency(hz, float(sd[i, 0]) / (2.0 * np.pi), ratio, ratio_sd, share, base))
    return tuple(out)


def _mode_notices(modes: tuple[SwingFrequency, ...], s: _Signals) -> tuple[Notice, ...]:
    fastest = modes[-1].frequency
    fast = (Notice("fast mode", {"frequency": fastest, "rate": s.rate}),) if fastest > _FAST * s.rate else ()
    multiples = [one for one in modes if one.multiple_of]
    return (*fast, *(Notice("multiple", {"frequency": one.frequency, "of": one.multiple_of}) for one in multiples))


_MARGIN = 0.1  # s after the last contact found: the tool leaves the beam within it
_STANDS = 0.2  # m/s^2, by which gravity may turn while the base stands


@dataclass(frozen=True)
class Swing:
    """Tags of T frames of free motion, m tags."""

    name: str
    time: Array  # (T,) s since the first of these frames
    begin: float  # s, the first of them on the film's clock
    s: Array  # (m,)
    xy: Array  # (T, m, 2) m, NaN where a tag was not seen
    gravity: Array  # (2,) m/s^2
    rate: float  # frames/s

    def signals(self) -> Array:
        """(T, 2 m) m."""
        return self.xy.reshape(len(self.time), -1)


def find_swing(o: Observations, part: FilmPart = FilmPart()) -> Swing:
    """The free swing after the last contact, or in `part` of the film. Raises `LearningError` where there is no
    release, no tag, or a base that turns."""
    film_time = o.time - (o.source.clock.offset if o.source.clock is not None else 0.0)
    begin = _release(o, film_time) if part.begin is None else part.begin
    chosen = (film_time >= begin) & (film_time <= (np.inf if part.end is None else part.end))
    xy, tags = _watched(o), tags_among(o)
    chosen &= np.isfinite(xy).any(axis=(1, 2))
    if not chosen.any():
        raise LearningError(
            f"{o.source.name}: no frame shows tags from {begin:.2f} s of the film on. Film on after the release until "
            "the beam has almost stopped"
        )
    if np.ptp(o.gravity[chosen], axis=0).max() > _STANDS:
        raise LearningError(
            f"{o.source.name}: the base turns while the beam swings. Let it swing from a base that stands"
        )
    return Swing(
        name=o.source.name,
        time=o.time[chosen] - o.time[chosen][0],
        begin=float(film_time[chosen][0]),
        s=o.marker_s[tags] if tags.any() else o.marker_s,
        xy=xy[chosen],
        gravity=np.asarray(o.gravity[chosen].mean(axis=0)),
        rate=1.0 / float(np.median(np.diff(o.time))),
    )


def _watched(o: Observations) -> Array:
    """(T, m, 2) m, the tags, which every frame may show; without tags the points of the outline."""
    tags = tags_among(o)
    return o.xy[:, tags] if tags.any() else o.xy


def _release(o: Observations, film_time: Array) -> float:
    """s on the film's clock from which the beam is free: from the first regular passage through rest, or after the last
    contact."""
    touched = np.flatnonzero(o.loaded)
    free = first_passage(film_time, _watched(o).reshape(len(film_time), -1))
    if np.isfinite(free):
        return free
    if not len(touched):
        raise LearningError(f"{o.source.name}: no contact was found, so no release. Say when the beam swings: --from-s")
    if touched[-1] == len(o.time) - 1:
        raise LearningError(
            f"{o.source.name}: the beam is pushed to the end of the film. Film on after the release; or, where it "
            "swings freely in a part of the film, say from when on: --from-s"
        )
    return float(film_time[touched[-1]]) + _MARGIN


# The swing's first mode, a damped sinusoid of frequency w and decay d, is compared with the first small vibration of
# the beam about rest, whose stiffness is `c (k + g)`: d = tau c k / 2 with Kelvin-Voigt damping d(s) = tau k(s), and
# w^2 + d^2 = c k + g with the weight's part g. A large swing is no small vibration, air damps it more, and clamps
# slide: the later half of the swing, of half the size, tells by how much, and its difference counts as an sd.


@dataclass(frozen=True)
class _Mode:
    """Square of the undamped frequency, and decay, of a swing's first mode."""

    squared: float  # (rad/s)^2
    decay: float  # 1/s
    squared_sd: float
    decay_sd: float


def _first_mode(swing: Swing) -> tuple[_Mode, tuple[SwingFrequency, ...]]:
    """The largest mode, and all of them."""
    modes = swing_frequencies(swing.time, swing.signals(), name=swing.name).modes
    one = max((mode for mode in modes if not mode.multiple_of), key=lambda mode: mode.share)
    undamped = 2.0 * np.pi * one.frequency / np.sqrt(1.0 - one.damping_ratio**2)
    squared, decay = undamped**2, one.damping_ratio * undamped
    sd = 4.0 * np.pi * undamped * one.sd
    return _Mode(squared, decay, sd, undamped * one.damping_ratio_sd), modes


def _with_later_part(swing: Swing, whole: _Mode) -> _Mode:
    """With what the later part of the swing says otherwise as sd."""
    late = swing.time >= min(np.log(2.0) / max(whole.decay, 1e-9), 0.5 * float(swing.time[-1]))
    try:
        later, _ = _first_mode(replace(swing, time=swing.time[late], xy=swing.xy[late]))
    except LearningError:  # too short, or too small
        return whole
    return replace(
        whole,
        squared_sd=float(np.hypot(whole.squared_sd, later.squared - whole.squared)),
        decay_sd=float(np.hypot(whole.decay_sd, later.decay - whole.decay)),
    )


def scaled(on: Body, factor: float, loss_time: float, *, mass_known: bool) -> Body:
    """With k over mass times `factor`: by k where the mass is known, else by the mass; and damping tau k."""
    if mass_known:
        stiff = factor * on.stiffness
        return replace(on, stiffness=stiff, damping=loss_time * stiff)
    mass = 1.0 / factor
    return replace(
        on, carried=mass * on.carried, lever=mass * on.lever, mass=mass * on.mass, damping=loss_time * on.stiffness
    )


def _of_bending(found: Vibration) -> Array:
    """(m,) (rad/s)^2: what the beam's stiffness adds to the squared frequencies; the rest is of its weight."""
    return np.asarray(np.einsum("ni,nm,mi->i", found.shapes, found.body.stiffness, found.shapes))


def _matched(on: Body, swing: Swing, squared: float, *, mass_known: bool) -> tuple[float, Vibration]:
    """The factor on k over mass with which the slowest vibration is as fast as the swing, and the vibrations."""
    factor = 1.0
    for _ in range(6):
        found = _vibration(scaled(on, factor, 0.0, mass_known=mass_known), swing)
        step = (squared - found.squared[0]) / _of_bending(found)[0]
        factor *= max(1.0 + float(step), 0.2)
        if abs(step) < 1e-9:
            break
    return factor, _vibration(scaled(on, factor, 0.0, mass_known=mass_known), swing)


def _off_shape(swing: Swing, modes: tuple[SwingFrequency, ...], about: Vibration) -> tuple[Array, Array]:
    """(m,) m RMS over a swing: by what each tag's first mode differs from the beam's, and its size. NaN: not seen."""
    ordered = sorted(modes, key=lambda mode: -mode.share)
    pairs = [(2.0 * np.pi * mode.frequency, mode.damping_ratio * 2.0 * np.pi * mode.frequency) for mode in ordered]
    signals, basis = swing.signals(), basis_of(swing.time, pairs)
    sizes = np.full(signals.shape[1], np.nan, dtype=complex)
    for c, known in enumerate(np.isfinite(signals).T):
        if known.sum() > basis.shape[1]:
            cos, sin = np.linalg.lstsq(basis[known], signals[known, c], rcond=None)[0][2:4]
            sizes[c] = cos - 1j * sin
    seen, shape = sizes.reshape(-1, 2), about.moved(swing.s)[0]
    there = np.isfinite(seen).all(axis=1)
    along = np.sum(shape[there] * seen[there]) / np.sum(shape[there] ** 2)
    return np.linalg.norm(seen - along * shape, axis=1) / np.sqrt(2.0), np.linalg.norm(seen, axis=1) / np.sqrt(2.0)


MassAlong = Literal["even", "width"]

_DRAWS = 60  # of k(s) and of the mass, for what they do to the frequency
_CONTRADICTS = 3.0  # sd by which c differs from 1 before it is called a contradiction
_HARDLY = 0.3  # relative sd of the loss time beyond which it is hardly known
_FAR_OFF = 0.1  # of a tag's own motion (RMS): further from that of the model's mode, the model is said to be wrong
_GRID = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True)
class DampingSettings:
    """How the swing is fitted."""

    mass_along: MassAlong = option("--mass-along", "even")
    modes: int = 10  # curvature modes of the beam
    seed: int = 0  # of the draws


@dataclass(frozen=True)
class Damping:
    """How the beam's motion dies, as `model.json` keeps it."""

    loss_time: float  # tau = d / k, s
    loss_time_sd: float  # s
    frequency: tuple[float, ...]  # Hz, natural (undamped) ones of small vibrations about rest, slowest first
    frequency_sd: float  # Hz, of the first
    ratio: tuple[float, ...]  # damping ratio of each; pi f tau where no weight acts
    ratio_sd: float  # of the first
    recording: str

    def as_dict(self) -> dict[str, Any]:
        """Plain data from which `Damping.from_dict` makes an equal one."""
        return {key + _UNITS.get(key, ""): value for key, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Damping:
        """Inverse of `as_dict`. Raises `LearningError` for an entry that is missing, unknown or without meaning."""
        names = {key + _UNITS.get(key, ""): key for key in cls.__dataclass_fields__}
        if set(data) != set(names):
            raise LearningError(f"must have the keys {', '.join(names)}")
        try:
            found = record_from(cls, {key: data[name] for name, key in names.items()})
        except (TypeError, ValueError) as error:
            raise LearningError(f"holds no number where one should be ({error})") from error
        numbers = (found.loss_time, *found.frequency, *found.ratio, found.loss_time_sd, found.frequency_sd)
        if not (np.all(np.isfinite(numbers)) and min(numbers) >= 0.0 and found.loss_time > 0.0 and found.frequency):
            raise LearningError("holds a number without meaning")
        return found


_UNITS = {"loss_time": "_s", "loss_time_sd": "_s", "frequency": "_Hz", "frequency_sd": "_Hz"}


@dataclass(frozen=True)
class SwingFit:
    """What a free swing says."""

    beam: Beam  # with the mass that it swings with
    damping: Damping
    mass_known: bool
    factor: float  # c: k over mass as it swings, over the model's; 1 by choice where the mass was unknown
    factor_sd: float  # from the swing alone; NaN where the mass was unknown
    model_sd: float  # relative sd of the model's own, from the band on k and how the mass lies; NaN without a band
    mass: float  # kg, the model's; what makes the frequency right where it was unknown
    mass_sd: float  # kg; NaN where the mass was known
    swing: Swing
    rms: Array  # (m,) m over a swing, by which a tag moves otherwise than in the model's first mode
    remarks: tuple[Notice, ...]


@one_blas_thread
def learn_damping(
    beam: Beam,
    recording: Observations,
    *,
    uncertain: UncertainStiffness | None = None,
    part: FilmPart = FilmPart(),
    settings: DampingSettings = DampingSettings(),
) -> SwingFit:
    """Loss time, and k over mass, from a free swing of a learned beam. A beam without a mass gets the recording's, or
    else the mass that fits the frequency. `uncertain`: the band on k(s). Raises `LearningError` if no swing is seen, or
    no motion of this beam fits."""
    swing = find_swing(recording, part)
    weighed, known = _with_mass(beam, recording, settings)
    try:
        on = _body(weighed, settings)
        _refuse_slow(swing, float(_vibration(on, swing).frequency[0]))
        mode, modes = _first_mode(swing)
        mode = _with_later_part(swing, mode)
        factor, found = _matched(on, swing, mode.squared, mass_known=known)
        off = _off_shape(swing, modes, found)
        model_sd = _model_sd(weighed, uncertain, swing, settings)
    except MechanicsError as error:
        raise LearningError(f"{recording.source.name}: the learned beam cannot swing so ({error})") from error
    fit = _result(swing, mode, factor, found, weighed, model_sd, off[0], mass_known=known)
    return replace(fit, remarks=_notices(fit, off[1]))


def _refuse_slow(swing: Swing, expected: float) -> None:
    """Raises `LearningError` where the film has too few frames for a swing of `expected` Hz."""
    if expected > NYQUIST * swing.rate:
        raise LearningError(
            f"{swing.name}: {swing.rate:.3g} frames/s cannot show a swing of {expected:.3g} Hz. "
            f"Film at {expected / 0.2:.3g} frames/s or more"
        )


def _with_mass(beam: Beam, recording: Observations, settings: DampingSettings) -> tuple[Beam, bool]:
    """The beam with a mass, and whether it is known; 1 kg/m stands for it where it is not."""
    own = beam.mass_per_length(_GRID)
    if np.all(own > 0.0) and not isinstance(beam.mass_per_length, Uniform):
        return beam, True
    known = bool(np.all(own > 0.0) or recording.stated.mass > 0.0)  # NaN is not
    total = float(own[0]) * beam.length if np.all(own > 0.0) else recording.stated.mass if known else beam.length
    along: Profile = Uniform(total / beam.length)
    if settings.mass_along == "width":
        share = np.cbrt(np.maximum(beam.stiffness(_GRID), 0.0))
        share = share / np.trapezoid(share, _GRID)
        along = Table(tuple(_GRID.tolist()), tuple((total / beam.length * share).tolist()))
    return replace(beam, mass_per_length=along), known


def _body(beam: Beam, settings: DampingSettings) -> Body:
    smooth = not (beam.stiffness.jumps or beam.rest_curvature.jumps or beam.mass_per_length.jumps)
    return body(beam, Modes(settings.modes) if smooth else None)


def _vibration(on: Body, swing: Swing, most: int = 2) -> Vibration:
    actions = Actions(gravity=swing.gravity)
    rest = settle(on, actions, load_steps=20 if np.any(swing.gravity) else 1)
    return vibration_of(on, rest, actions, count=most)


def _model_sd(beam: Beam, uncertain: UncertainStiffness | None, swing: Swing, settings: DampingSettings) -> float:
    """Relative sd of the model's own omega^2: the band on k(s), and how a mass known only as a whole may lie."""
    if uncertain is None:
        return float("nan")
    rng, squared = np.random.default_rng(settings.seed), []
    spread = MASS_SPREAD if isinstance(beam.mass_per_length, Uniform) else 0.0
    for one in uncertain.draw(_DRAWS, seed=settings.seed):
        drawn = replace(beam, stiffness=one, mass_per_length=_uneven(beam.mass_per_length, spread, rng))
        squared.append(float(_vibration(_body(drawn, settings), swing, 1).squared[0]))
    return float(np.std(np.log(np.maximum(squared, 1e-300))))


def _uneven(mass: Profile, spread: float, rng: np.random.Generator) -> Profile:
    """A mass of the same total, with Legendre parts of sd `spread`."""
    if spread == 0.0:
        return mass
    share = 1.0 + np.polynomial.legendre.legval(2.0 * _GRID - 1.0, [0.0, *(spread * rng.standard_normal(3))])
    share = np.maximum(share, 0.05)
    return Table(tuple(_GRID.tolist()), tuple((mass(_GRID) * share / np.trapezoid(share, _GRID)).tolist()))


def _result(
    swing: Swing, mode: _Mode, factor: float, found: Vibration, beam: Beam, model_sd: float, rms: Array, *,
    mass_known: bool,
) -> SwingFit:  # fmt: skip
    bending = _of_bending(found)
    loss, sd = 2.0 * mode.decay / float(bending[0]), mode.squared_sd / float(bending[0])
    loss_sd = float(np.hypot(mode.decay_sd / max(mode.decay, 1e-300), sd))
    ratio = 0.5 * loss * bending / np.sqrt(found.squared)
    return SwingFit(
        beam=beam if mass_known else replace(beam, mass_per_length=Scaled(1.0 / factor, beam.mass_per_length)),
        damping=Damping(
            loss_time=loss,
            loss_time_sd=loss * loss_sd,
            frequency=tuple(found.frequency.tolist()),
            frequency_sd=float(0.5 * mode.squared_sd / found.squared[0] * found.frequency[0]),
            ratio=tuple(ratio.tolist()),
            ratio_sd=float(ratio[0]) * loss_sd,
            recording=swing.name,
        ),
        mass_known=mass_known,
        factor=factor if mass_known else 1.0,
        factor_sd=factor * sd if mass_known else float("nan"),
        model_sd=model_sd,
        mass=found.body.mass,
        mass_sd=float("nan") if mass_known else found.body.mass * float(np.hypot(sd, model_sd)),
        swing=swing,
        rms=rms,
        remarks=(),
    )


def _notices(fit: SwingFit, motion: Array) -> tuple[Notice, ...]:
    """`motion` (m,) m RMS of the tags over a swing."""
    out: list[Notice] = []
    share = np.nan_to_num(fit.rms / motion)
    worst = int(np.argmax(share))
    if share[worst] > _FAR_OFF:
        values = {"s": float(fit.swing.s[worst]), "rms": float(fit.rms[worst]), "motion": float(motion[worst])}
        out.append(Notice("swing missed", values))
    if fit.damping.loss_time_sd > _HARDLY * fit.damping.loss_time:
        out.append(Notice("damping unseen"))
    if fit.mass_known:
        sd = float(np.hypot(fit.factor_sd, fit.model_sd))
        away = abs(np.log(fit.factor)) / sd if np.isfinite(sd) else 0.0
        code = "swing agrees" if away <= _CONTRADICTS else "swing contradicts"
        values = {"factor": fit.factor, "sd": sd, "swing_sd": fit.factor_sd, "model_sd": fit.model_sd, "away": away}
        out.append(Notice(code if np.isfinite(sd) else "swing without a band", values))
    elif not np.isfinite(fit.mass_sd):
        out.append(Notice("mass without a band"))
    return tuple(out)
