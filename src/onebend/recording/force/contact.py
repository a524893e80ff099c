"""Contact and rest: when the beam is pushed and when it is free, from the markers and the force.

The film must begin with a free beam (the camera starts before the push). The beam is free where its markers stand still
at their first places, and where it swings about that rest with no more force than before the push. All else is contact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import chdtri

from onebend.recording.signals import MAD_TO_SD, bridged, outliers, runs, step
from onebend.records import Array, BoolArray, ForceLog, Markers, Remark


@dataclass(frozen=True)
class ContactSettings:
    """Thresholds between contact and rest."""

    window: int = 5  # frames averaged
    first: int = 10  # frames that must show the beam at rest
    chance: float = 1e-6  # of a false contact in one frame, were the noise as estimated
    returned: float = 0.005  # of the largest displacement: nearer to the first rest than this is back at rest
    shortest_rest: float = 0.25  # s
    margin: float = 0.1  # s, taken off a rest where it borders on contact: the tool touches before markers show it
    released: float = 0.05  # of the largest force: less than this, to the end, is no force


@dataclass(frozen=True)
class Contact:
    """The film divided into rest and contact; times on the video's clock."""

    loaded: BoolArray  # (T,)
    rests: tuple[tuple[float, float], ...]  # s, spans with a free beam, margin taken off; usable for the force's tare
    still: BoolArray  # (T,) free and standing still: the rest shape can be read
    begin: float  # s, first contact; NaN where there is none
    end: float  # s, end of the last contact; infinite where it outlasts the film; NaN where there is none
    remarks: tuple[Remark, ...] = ()


def find_contact(
    markers: Markers,
    log: ForceLog | None = None,
    *,
    offset: float = 0.0,
    settings: ContactSettings = ContactSettings(),
) -> Contact:
    """Rest and contact of a film, with the force log (own clock = video clock + `offset`) where there is one."""
    time = markers.time
    departed, threshold = departure(markers, settings)
    if not departed[0] <= threshold:
        text = (
            "The beam moves from the first frame on: no rest before contact is seen, so the force has no zero. "
            "Record three still seconds before the push."
        )
        loaded = np.full(len(time), log is not None)
        remark = Remark("warning", text, about="no rest")
        return Contact(loaded, (), np.zeros(len(time), dtype=bool), float(time[0]), np.inf, (remark,))
    first = int(np.argmax(departed > threshold)) if np.any(departed > threshold) else len(time)
    returned = departed < max(threshold, settings.returned * float(departed.max()))
    returned[:first] = True
    still = long_enough(returned, time, settings.shortest_rest)
    free = still.copy()
    remarks: list[Remark] = []
    if log is not None and not free[-1]:
        released = release(log, time[free & (time < time[min(first, len(time) - 1)])] + offset, settings) - offset
        if released < time[-1]:
            free |= time >= released
            if np.any(~still & free):
                remarks.append(Remark("note", f"The beam swings freely from {released:.2f} s of the film on."))
    if not free[: max(first, 1)].any():
        text = "The rest before contact is too short to use: the force has no zero. Record three still seconds."
        remarks.append(Remark("warning", text, about="no rest"))
    spans = tuple(shrunk(time, start, stop, settings) for start, stop in runs(free))
    rests = tuple((low, high) for low, high in spans if high - low >= 0.5 * settings.shortest_rest)
    touched = np.flatnonzero(~free)
    begin = float(time[touched[0]]) if len(touched) else np.nan
    end = np.nan if not len(touched) else np.inf if touched[-1] == len(time) - 1 else float(time[touched[-1]])
    return Contact(~free, rests, still & free, begin, end, tuple(remarks))


def departure(markers: Markers, settings: ContactSettings) -> tuple[Array, float]:
    """(T,) distance of every frame from the first frames in sd of the noise, and how far noise alone would go.

    The noise of each coordinate is the larger of what second differences say and the scatter of the first frames;
    the first frames are taken anew, up to the first departure, once that is known.
    """
    count = len(markers.time)
    flat = np.concatenate([markers.xy.reshape(count, -1), markers.angle], axis=1)
    measured = np.isfinite(flat).sum(axis=0) > settings.window
    filled = bridged(markers.time, flat[:, measured])
    if not filled.size:
        return np.full(count, np.inf), 0.0
    bends = np.abs(np.diff(filled, n=2, axis=0)) / np.sqrt(6)
    # Tracks rounded to a few digits jump seldom but far: the mean square sees that, the median does not.
    early = np.sqrt(np.mean(bends[: settings.first] ** 2, axis=0))
    floor = 1e-5 * float(np.abs(filled).max()) + np.finfo(float).tiny
    quick = floor + np.maximum(np.median(bends, axis=0) * MAD_TO_SD, early)
    smooth = uniform_filter1d(filled, settings.window, axis=0, mode="nearest")
    first_frames = min(count, settings.first)
    threshold = 2.0 * float(np.sqrt(chdtri(filled.shape[1], settings.chance) / settings.window))
    distance = np.zeros(count)
    for _ in range(3):
        rest = filled[:first_frames]
        noise = np.maximum(quick, np.minimum(np.std(rest, axis=0), 3 * quick))
        distance = np.linalg.norm((smooth - np.median(rest, axis=0)) / noise, axis=1)
        if np.ptp(smooth[:first_frames] / noise, axis=0).max() > 2 * threshold:
            distance[0] = np.inf
            return distance, threshold
        beyond = distance > threshold
        steady = uniform_filter1d(beyond.astype(float), settings.window, mode="nearest") > 0.9
        first_frames = max(int(np.argmax(steady)) - settings.window, first_frames) if steady.any() else count
    return distance, threshold


def release(log: ForceLog, rest: Array, settings: ContactSettings) -> float:
    """Time on the log's clock from which the force stays what it was in `rest` [s, log's clock]; infinite if never."""
    good = ~outliers(log.force, spacing=step(log.time))
    time, force = log.time[good], log.force[good]
    before = (time >= rest.min(initial=np.inf)) & (time <= rest.max(initial=-np.inf))
    width = 0.1
    if before.sum() < 10:
        return float("inf")
    change = force - np.median(force[before], axis=0)
    span = max(1, round(width / float(np.median(np.diff(time)))))
    size = np.linalg.norm(uniform_filter1d(change, span, axis=0, mode="nearest"), axis=1)
    noise = float(np.sqrt(np.mean(size[before] ** 2)))
    pushed = np.flatnonzero(size > max(6 * noise, settings.released * size.max()))
    if not len(pushed) or time[-1] - time[pushed[-1]] < 2 * settings.shortest_rest:
        return float("inf")
    return float(time[pushed[-1]] + width / 2)


def long_enough(mask: BoolArray, time: Array, shortest: float) -> BoolArray:
    """`mask` without runs of True shorter than `shortest` [s]."""
    kept_runs = np.zeros_like(mask)
    for start, stop in runs(mask):
        if time[stop - 1] - time[start] >= shortest:
            kept_runs[start:stop] = True
    return kept_runs


def shrunk(time: Array, start: int, stop: int, settings: ContactSettings) -> tuple[float, float]:
    """The span of the frames [start, stop), less the margin on the sides that border on contact, and open where the
    film begins or ends: the log may show more of the same rest."""
    low = -np.inf if start == 0 else float(time[start]) + settings.margin
    high = np.inf if stop == len(time) else float(time[stop - 1]) - settings.margin
    return low, high
