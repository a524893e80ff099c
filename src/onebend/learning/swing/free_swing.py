"""The frames of a recording in which the beam swings freely, and a first look at how fast and how damped it swings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from onebend.errors import LearningError
from onebend.learning.model.frames import whitening
from onebend.records import Array, Observations, covariance_with_camera

_MARGIN = 0.1  # s after the last contact found: the tool leaves the beam within it
_FEWEST = 12  # frames
_VISIBLE = 10.0  # sd of a tag's noise that the swing must exceed
_END = 0.25  # of a record, over which a swing is nearest to its middle
_CLEAR = 5.0  # sd of a tag's place that half a swing must exceed
_UNEVEN, _GROWS = 0.4, 1.2  # by which half swings may differ in time, and grow, as frames are few
_HALF_SWINGS = 4  # that are a swing
_NYQUIST = 0.45  # of the frame rate: faster swings cannot be told from slower ones


@dataclass(frozen=True)
class FilmPart:
    """Which frames to take, on the film's clock [s]; None: from the release found in the data, to the end."""

    begin: float | None = None
    end: float | None = None


@dataclass(frozen=True)
class Swing:
    """Tags of T frames of free motion, m tags; what was seen of a tag is x, y [m] and its angle [rad]."""

    name: str
    time: Array  # (T,) s since the first of these frames
    begin: float  # s, the first of them on the film's clock
    s: Array  # (m,)
    seen: Array  # (T, m, 3) NaN where a tag was not seen
    whiten: Array  # (T, m, 3, 3) inverse Cholesky factors of the covariances; zero where a tag was not seen
    rest: Array  # (m, 3) the tags of the beam at rest
    gravity: Array  # (2,) m/s^2
    rate: float  # frames/s


@dataclass(frozen=True)
class Glance:
    """A damped sinusoid through one number of one tag."""

    tag: int  # index
    part: int  # 0, 1, 2: x, y, angle
    omega: float  # rad/s, of the damped swing
    decay: float  # 1/s, of its amplitude
    value: float  # m or rad from rest, at the first frame
    slope: float  # m/s or rad/s there


def find_swing(o: Observations, part: FilmPart = FilmPart()) -> Swing:
    """The free swing after the last contact, or in the part of the film asked for.

    Raises:
        LearningError: no such frames, too few of them, no rest to swing about, a base that turns, no visible motion.
    """
    film_time = o.time - (o.source.clock.offset if o.source.clock is not None else 0.0)
    begin = _release(o, film_time) if part.begin is None else part.begin
    chosen = (film_time >= begin) & (film_time <= (np.inf if part.end is None else part.end))
    seen = np.concatenate([o.xy, o.angle[..., None]], axis=-1)
    there = np.isfinite(seen).all(axis=-1) & np.isfinite(covariance_with_camera(o)).all(axis=(-1, -2))
    chosen &= there.any(axis=1)
    if chosen.sum() < _FEWEST:
        raise LearningError(
            f"{o.source.name}: {int(chosen.sum())} frames show tags from {begin:.2f} s of the film on; at least "
            f"{_FEWEST} are needed. Film on after the release until the beam has almost stopped"
        )
    rest = np.concatenate([o.rest_xy, o.rest_angle[:, None]], axis=-1)
    if not np.isfinite(rest).all():
        raise LearningError(
            f"{o.source.name}: not every tag is seen at rest. Begin the film with the free beam at rest"
        )
    if np.ptp(o.gravity[chosen], axis=0).max() > 0.2:
        raise LearningError(
            f"{o.source.name}: the base turns while the beam swings. Let it swing from a base that stands"
        )
    shown = np.where(there[chosen][..., None], seen[chosen], np.nan)
    swing = Swing(
        name=o.source.name,
        time=o.time[chosen] - o.time[chosen][0],
        begin=float(film_time[chosen][0]),
        s=o.marker_s,
        seen=shown,
        whiten=whitening(shown, covariance_with_camera(o)[chosen]),
        rest=rest,
        gravity=np.asarray(o.gravity[chosen].mean(axis=0)),
        rate=1.0 / float(np.median(np.diff(o.time))),
    )
    away = np.einsum("tmij,tmj->tmi", swing.whiten, np.nan_to_num(swing.seen - rest))
    if np.abs(away).max() < _VISIBLE:
        raise LearningError(
            f"{o.source.name}: the beam hardly moves from {begin:.2f} s of the film on. Bend it further"
        )
    return swing


def shortened(swing: Swing, duration: float) -> Swing:
    """Its first part."""
    keep = swing.time <= duration
    return replace(swing, time=swing.time[keep], seen=swing.seen[keep], whiten=swing.whiten[keep])


def glance(swing: Swing, expected: float) -> Glance:
    """Frequency and decay from the number that is seen most often; `expected`: rad/s, what the model says.

    Raises:
        LearningError: the film is too slow for this beam, or too short.
    """
    highest = _NYQUIST * swing.rate * 2.0 * np.pi
    if expected > highest:
        raise LearningError(
            f"{swing.name}: {swing.rate:.3g} frames/s cannot show a swing of {expected / (2 * np.pi):.3g} Hz. "
            f"Film at {expected / (2 * np.pi) / 0.2:.3g} frames/s or more"
        )
    tag, part = _clearest(swing)
    values = swing.seen[:, tag, part] - swing.rest[tag, part]
    good = np.isfinite(values)
    time, values = swing.time[good], values[good]
    if time[-1] - time[0] < np.pi / expected:
        raise LearningError(f"{swing.name}: {time[-1] - time[0]:.2g} s are less than half a swing. Film for longer")
    lowest, apart = expected / 3.0, np.pi / 4.0 / (time[-1] - time[0])
    tried = np.arange(lowest, min(3.0 * expected, highest), min(apart, 0.05 * lowest))
    pairs = [(omega, omega * share) for omega in tried for share in (0.003, 0.01, 0.03, 0.1, 0.3)]
    errors = [np.sum(_left(time, values, omega, decay)[0] ** 2) for omega, decay in pairs]
    best = least_squares(
        lambda x: _left(time, values, x[0], x[1])[0], pairs[int(np.argmin(errors))], x_scale=[expected, 0.1 * expected]
    )
    omega, decay = float(best.x[0]), max(float(best.x[1]), 1e-3 * float(best.x[0]))
    _, (a, b) = _left(time, values, omega, decay)
    return Glance(tag, part, omega, decay, float(a), float(omega * b - decay * a))


def _release(o: Observations, film_time: Array) -> float:
    """s on the film's clock from which the beam is free: after the last contact, or from where the tags swing through
    rest though a force is logged, as sensors do that forget a load slowly."""
    touched = np.flatnonzero(o.loaded)
    free = _swings_from(o, film_time)
    if np.isfinite(free) and not (len(touched) and film_time[touched[-1]] < free):
        return free
    if not len(touched):
        raise LearningError(f"{o.source.name}: no contact was found, so no release. Say when the beam swings: --from-s")
    if touched[-1] == len(o.time) - 1:
        raise LearningError(
            f"{o.source.name}: the beam is pushed to the end of the film. Film on after the release; or, where it "
            "swings freely in a part of the film, say from when on: --from-s"
        )
    return float(film_time[touched[-1]]) + _MARGIN


def _swings_from(o: Observations, film_time: Array) -> float:
    """s, of the first passage through rest of a swing that is regular and dies away; NaN where no tag shows one."""
    spread = np.sqrt(np.trace(covariance_with_camera(o)[..., :2, :2], axis1=-2, axis2=-1))
    found = []
    for i in range(len(o.tag_id)):
        seen = np.isfinite(o.xy[:, i]).all(axis=1) & np.isfinite(spread[:, i])
        if seen.sum() < _FEWEST or not np.isfinite(o.rest_xy[i]).all():
            continue
        away = o.xy[seen, i] - o.rest_xy[i]
        along = np.linalg.svd(away, full_matrices=False)[2][0]
        found.append(_first_passage(film_time[seen], away @ along, _CLEAR * float(np.median(spread[seen, i]))))
    return float(np.nanmin(found)) if np.isfinite(found).any() else float("nan")


def swinging_part(time: Array, signals: Array) -> tuple[float, float]:
    """s, from the first passage through the middle of a regular swing that dies away, to the end; all of it where no
    signal (N, C) shows one."""
    found = []
    for column in signals.T:
        seen = np.isfinite(column)
        if seen.sum() < _FEWEST:
            continue
        value = column[seen] - np.median(column[seen][-max(int(_END * seen.sum()), _FEWEST) :])
        rough = float(np.median(np.abs(np.diff(value, n=2)))) / np.sqrt(6.0)
        found.append(_first_passage(time[seen], value, _CLEAR * rough))
    begin = float(np.nanmin(found)) if np.isfinite(found).any() else float(time[0])
    return begin, float(time[-1])


def _first_passage(time: Array, value: Array, least: float) -> float:
    """s, where the longest chain of half swings begins: alike in time, none much larger than the one before, none below
    `least`; NaN where no chain has enough of them."""
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


def _clearest(swing: Swing) -> tuple[int, int]:
    """Tag and part with the largest motion over noise, in root mean square times the root of how often it is seen."""
    own = np.nan_to_num((swing.seen - swing.rest) * np.diagonal(swing.whiten, axis1=2, axis2=3))
    first = np.sum(np.isfinite(swing.seen).all(axis=-1), axis=0)
    often = first >= 0.9 * first.max()
    power = np.where(often[:, None], np.sum(own**2, axis=0), 0.0)
    tag, part = np.unravel_index(int(np.argmax(power)), power.shape)
    return int(tag), int(part)


def _left(time: Array, values: Array, omega: float, decay: float) -> tuple[Array, Array]:
    """What a damped sinusoid about a constant leaves, and its factors of cosine and sine."""
    fall = np.exp(-np.clip(decay, -1e3, 1e3) * time / max(1.0, 0.02 * abs(decay) * time[-1]))
    rows = np.stack([fall * np.cos(omega * time), fall * np.sin(omega * time), np.ones_like(time)], axis=1)
    found = np.linalg.lstsq(rows, values, rcond=None)[0]
    return values - rows @ found, found[:2]
