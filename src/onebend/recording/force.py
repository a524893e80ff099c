"""The force log: read, put on the film's clock, cleaned, and where in it the beam is touched."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import chdtri

from onebend.errors import ObservationError
from onebend.recording import bag_topics, beam_frame, force_noise
from onebend.recording.clock import ClockFit, fit_clock
from onebend.recording.entries import Recording
from onebend.recording.force_log import FEWEST_ROWS, noise_remarks, read_force_log, refuse_other_unit, size_remarks
from onebend.recording.signals import MAD_TO_SD, at_times, bridged, low_pass, outliers, runs, step
from onebend.records import Array, BoolArray, CleanForce, ClockOffset, ForceLog, ForceNoise, Markers, Remark

# The film begins with a free beam. It is free again where its markers stand still at their first places, and where it
# swings with no more force than before the push. All else is contact.


WINDOW, FIRST = 5, 10  # frames that are averaged, and that must show the beam at rest
CHANCE = 1e-6  # of a false contact in one frame, were the noise as estimated
RETURNED = 0.005  # of the largest displacement: nearer to the first rest than this is back at rest
SHORTEST_REST = 0.25  # s
MARGIN = 0.1  # s, taken off a rest where it borders on contact: the tool touches before markers show it
RELEASED = 0.05  # of the largest force: less than this, to the end, is no force


@dataclass(frozen=True)
class Contact:
    """The film divided into rest and contact; times on the video's clock."""

    loaded: BoolArray  # (T,)
    rests: tuple[tuple[float, float], ...]  # s, spans with a free beam, margin taken off; usable for the force's tare
    still: BoolArray  # (T,) free and standing still: the rest shape can be read
    remarks: tuple[Remark, ...] = ()


def find_contact(markers: Markers, log: ForceLog | None = None, *, offset: float = 0.0) -> Contact:
    """Rest and contact of a film, with the force log (own clock = video clock + `offset`) where there is one."""
    time = markers.time
    departed, threshold = departure(markers)
    if not departed[0] <= threshold:
        text = (
            "The beam moves from the first frame on: no rest before contact is seen, so the force has no zero. "
            "Record three still seconds before the push."
        )
        loaded = np.full(len(time), log is not None)
        remark = Remark("warning", text, about="no rest")
        return Contact(loaded, (), np.zeros(len(time), dtype=bool), (remark,))
    first = int(np.argmax(departed > threshold)) if np.any(departed > threshold) else len(time)
    returned = departed < max(threshold, RETURNED * float(departed.max()))
    returned[:first] = True
    still = long_enough(returned, time)
    free = still.copy()
    remarks: list[Remark] = []
    if log is not None and not free[-1]:
        released = release(log, time[free & (time < time[min(first, len(time) - 1)])] + offset) - offset
        if released < time[-1]:
            free |= time >= released
            if np.any(~still & free):
                remarks.append(Remark("note", f"The beam swings freely from {released:.2f} s of the film on."))
    if not free[: max(first, 1)].any():
        text = "The rest before contact is too short to use: the force has no zero. Record three still seconds."
        remarks.append(Remark("warning", text, about="no rest"))
    spans = tuple(shrunk(time, start, stop) for start, stop in runs(free))
    rests = tuple((low, high) for low, high in spans if high - low >= 0.5 * SHORTEST_REST)
    return Contact(~free, rests, still & free, tuple(remarks))


def departure(markers: Markers) -> tuple[Array, float]:
    """(T,) distance of every frame from the first frames in sd of the noise, and how far noise alone would go.

    The noise of each coordinate is the larger of what second differences say and the scatter of the first frames;
    the first frames are taken anew, up to the first departure, once that is known.
    """
    count = len(markers.time)
    flat = np.concatenate([markers.xy.reshape(count, -1), markers.angle], axis=1)
    measured = np.isfinite(flat).sum(axis=0) > WINDOW
    filled = bridged(markers.time, flat[:, measured])
    if not filled.size:
        return np.full(count, np.inf), 0.0
    bends = np.abs(np.diff(filled, n=2, axis=0)) / np.sqrt(6)
    # Tracks rounded to a few digits jump seldom but far: the mean square sees that, the median does not.
    early = np.sqrt(np.mean(bends[:FIRST] ** 2, axis=0))
    floor = 1e-5 * float(np.abs(filled).max()) + np.finfo(float).tiny
    quick = floor + np.maximum(np.median(bends, axis=0) * MAD_TO_SD, early)
    smooth = uniform_filter1d(filled, WINDOW, axis=0, mode="nearest")
    first_frames = min(count, FIRST)
    threshold = 2.0 * float(np.sqrt(chdtri(filled.shape[1], CHANCE) / WINDOW))
    distance = np.zeros(count)
    for _ in range(3):
        rest = filled[:first_frames]
        noise = np.maximum(quick, np.minimum(np.std(rest, axis=0), 3 * quick))
        distance = np.linalg.norm((smooth - np.median(rest, axis=0)) / noise, axis=1)
        if np.ptp(smooth[:first_frames] / noise, axis=0).max() > 2 * threshold:
            distance[0] = np.inf
            return distance, threshold
        beyond = distance > threshold
        steady = uniform_filter1d(beyond.astype(float), WINDOW, mode="nearest") > 0.9
        first_frames = max(int(np.argmax(steady)) - WINDOW, first_frames) if steady.any() else count
    return distance, threshold


def release(log: ForceLog, rest: Array) -> float:
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
    pushed = np.flatnonzero(size > max(6 * noise, RELEASED * size.max()))
    if not len(pushed) or time[-1] - time[pushed[-1]] < 2 * SHORTEST_REST:
        return float("inf")
    return float(time[pushed[-1]] + width / 2)


def long_enough(mask: BoolArray, time: Array) -> BoolArray:
    """`mask` without runs of True shorter than a rest."""
    kept_runs = np.zeros_like(mask)
    for start, stop in runs(mask):
        if time[stop - 1] - time[start] >= SHORTEST_REST:
            kept_runs[start:stop] = True
    return kept_runs


def shrunk(time: Array, start: int, stop: int) -> tuple[float, float]:
    """The span of the frames [start, stop) less the margin beside contact, open where the film begins or ends."""
    low = -np.inf if start == 0 else float(time[start]) + MARGIN
    high = np.inf if stop == len(time) else float(time[stop - 1]) - MARGIN
    return low, high


OVERTONE = 2.0  # cut-off over the bandwidth of the markers' motion: see `choose_cutoff`
TARE_SPAN = 3.0  # s of a rest, nearest to contact, for the zero; a longer one adds drift, a shorter one noise
LONGEST_GAP = 0.1  # s, or as long as the filter's memory where that is longer: a longer gap stays a gap


@dataclass(frozen=True)
class Zero:
    """The log's zero at each rest, beam's frame, and its sd."""

    time: Array  # (r,) s, log's clock
    value: Array  # (r, 2) N
    sd: float  # N, of each value

    def at(self, time: Array) -> Array:
        """(N, 2) N: straight in time between rests, constant beyond; zero where no rest is known."""
        if not len(self.time):
            return np.zeros((len(time), 2))
        return np.stack([np.interp(time, self.time, column) for column in self.value.T], axis=1)


def choose_cutoff(motion: float) -> float:
    """Cut-off of the low-pass from the bandwidth `motion` [Hz] of the markers; infinite where that is not known.

    A beam that moves slowly is in equilibrium with the force, so the force is a function of the markers'
    displacements. The function is nonlinear: its square terms double the bandwidth. Hence twice that of the markers.
    """
    return OVERTONE * motion if np.isfinite(motion) and motion > 0 else math.inf


def clean_force(
    log: ForceLog,
    rests: Sequence[tuple[float, float]],
    *,
    rotation: float = 0.0,
    acts_on: Literal["beam", "robot"] = "beam",
    cutoff: float = math.inf,
    noise: ForceNoise | None = None,
) -> CleanForce:
    """Force on the beam in the beam's frame, F = +-R(rotation) F_log, without outliers, zeroed at `rests` and filtered.

    `rests` are spans of the log's clock with a free beam. With rests on both sides of the contact the zero runs
    straight between them, which takes most of the sensor's drift off; with one it is constant; with none the force
    keeps its bias, its noise is unknown (NaN) and a warning says so. `noise` is what is known of the sensor's noise
    (from the clock search); without it the scatter at rest stands for it, and drift is not in `noise_sd`.
    """
    bad = outliers(log.force, spacing=step(log.time))
    force = log.force @ to_beam(rotation)
    if acts_on == "robot":
        force = -force
    force = bridged(log.time, np.where(bad[:, None], np.nan, force))
    smooth = low_pass(log.time, force, cutoff, longest_gap=gap_limit(log.time, cutoff))
    zero = zero_of(log.time, force, rests, noise)
    clean = smooth - zero.at(log.time)
    remarks = zero_remarks(zero, float(np.abs(clean).max()), cutoff)
    noise_sd = remaining_sd(log.time, smooth, rests, zero, cutoff, noise)
    drift, spacing = np.full(2, np.nan), step(log.time)
    if len(zero.time) > 1:
        drift = (zero.value[-1] - zero.value[0]) / (zero.time[-1] - zero.time[0])
    if noise is not None:  # the log's own samples show its white part
        noise = replace(noise, white=force_noise.first_guess(force, spacing).white, spacing=spacing)
    return CleanForce(
        time=log.time,
        force=clean,
        push_s=log.push_s,
        noise_sd=noise_sd,
        tare=zero.value[0] if len(zero.time) else np.zeros(2),
        drift=drift,
        cutoff=cutoff,
        outliers=int(bad.sum()),
        noise=noise,
        zero_time=zero.time,
        zero=zero.value,
        remarks=(*log.remarks, *remarks),
    )


def to_beam(rotation: float) -> Array:
    """(2, 2) matrix that turns rows of force in the log's axes into the beam's: F_beam = R(rotation) F_log."""
    cos, sin = math.cos(rotation), math.sin(rotation)
    return np.array([[cos, sin], [-sin, cos]])


def within(time: Array, span: tuple[float, float]) -> BoolArray:
    return np.asarray((time >= span[0]) & (time <= span[1]))


def zero_of(time: Array, force: Array, rests: Sequence[tuple[float, float]], noise: ForceNoise | None) -> Zero:
    """Mean force over each rest, of the part nearest to contact where the rest is long."""
    times, values, sizes = [], [], []
    for i, span in enumerate(rests):
        rows = np.flatnonzero(within(time, span))
        if len(rows) < 2:
            continue
        # The first rest is followed by contact, later ones are preceded by it.
        distance = time[rows[-1]] - time[rows] if i == 0 else time[rows] - time[rows[0]]
        rows = rows[distance <= TARE_SPAN]
        if len(rows) >= 2:
            times.append(float(np.mean(time[rows])))
            values.append(np.mean(force[rows], axis=0))
            sizes.append(float(np.ptp(time[rows])))
    shortest = min(sizes, default=math.nan)
    sd = math.nan
    if noise is not None and sizes:
        # Mean of a process of correlation time tau over a span; the walk within the span.
        sd = math.sqrt(min(1.0, 2 * noise.tau / shortest) * noise.coloured**2 + noise.walk**2 * shortest / 3)
    return Zero(np.array(times), np.array(values).reshape(-1, 2), sd)


def remaining_sd(
    time: Array,
    smooth: Array,
    rests: Sequence[tuple[float, float]],
    zero: Zero,
    cutoff: float,
    noise: ForceNoise | None,
) -> Array:
    """(2,) N, sd of the clean force's error in mid-contact: the filtered noise, the error of the zero, and the drift
    beside the zero (a random walk: a bridge between two rests, free after one). NaN without a rest."""
    if not len(zero.time):
        return np.full(2, math.nan)
    at_rest = np.any([within(time, span) for span in rests], axis=0)
    scatter = np.sqrt(np.mean((smooth - zero.at(time))[at_rest] ** 2, axis=0))
    if noise is None:
        return np.asarray(scatter)
    if len(zero.time) > 1:
        wander = noise.walk**2 * float(np.diff(zero.time).max()) / 6
    else:
        wander = noise.walk**2 * (time[-1] - zero.time[0]) / 2
    filtered = np.maximum(noise.passed(cutoff), scatter)
    return np.asarray(np.sqrt(filtered**2 + zero.sd**2 + wander))


def zero_remarks(zero: Zero, largest: float, cutoff: float) -> tuple[Remark, ...]:
    """Remarks on the zero and the filter; `largest`: N, of the clean force's two parts."""
    remarks = []
    change = float(np.abs(np.diff(zero.value, axis=0)).max(initial=0.0))
    if not len(zero.time):
        text = "The force log shows no rest: its zero is unknown and nothing was taken off. Start it before the push."
        remarks.append(Remark("warning", text, about="no rest"))
    elif len(zero.time) == 1:
        text = (
            "The drift of the force is unknown: the log ends before the beam is free again. Let go before the log ends."
        )
        remarks.append(Remark("note", text))
    elif change > 0.2 * largest:  # of the largest force: a zero that changes by more between two rests is warned of
        text = f"The force's zero drifted by {change:.2g} N between the rests. Let the sensor warm up."
        if doubt := change > 0.5 * largest:  # by more than this, the log hardly tells the force
            text = (
                f"The force's zero drifted by {change:.2g} N between the rests, and the push is {largest:.2g} N: how "
                "the zero ran during the push is a guess. Push harder, or let the sensor warm up."
            )
        remarks.append(Remark("warning", text, doubt=doubt, about="drift"))
    if not math.isfinite(cutoff):
        remarks.append(Remark("note", "The force is not low-passed: no motion tells its bandwidth."))
    return tuple(remarks)


def gap_limit(time: Array, cutoff: float) -> float:
    """Longest span between two rows that may be interpolated, s."""
    memory = 1 / (2 * math.pi * cutoff) if math.isfinite(cutoff) and cutoff > 0 else 0.0
    return max(LONGEST_GAP, memory, 3 * step(time))


def read_log(rec: Recording) -> ForceLog | None:
    """The force log, where the recording has one."""
    if rec.force is None:
        return None
    if rec.force.topic:
        return bag_topics.read_bag_force(rec.force)
    column = rec.push.column if rec.push else ""
    log = read_force_log(rec.force.file, rec.force.columns, column, time_unit=rec.force.time_unit)
    return replace(log, remarks=(*log.remarks, *noise_remarks(log, rec.force.sensor, rec.force.white_sd)))


def match_clocks(
    rec: Recording, markers: Markers, log: ForceLog | None, base: beam_frame.BaseLog | None
) -> tuple[ForceLog | None, ClockFit]:
    """The offset from the force, else from the base's turn, else as written; 0 where there is no second clock.

    The log is given back from a rest's length before the film to as long after it: nothing tells what acts farther off.
    Where its sensor is slow, it is as one that is not would have written it."""
    stated, uncertainty = rec.start
    if log is None and base is None:
        start = stated if math.isfinite(stated) else 0.0
        return None, ClockFit(ClockOffset(offset=start, sd=uncertainty, stated=stated, found=False))
    exact = uncertainty == 0.0 and math.isfinite(stated)
    fit = ClockFit(ClockOffset(offset=stated, sd=0.0 if exact else math.inf, stated=stated, found=exact))
    if log is not None and rec.force is not None:
        check_pace(rec, markers, log)
        axes, place = to_beam(rec.force.rotation), push_place(rec, log)

        def fitted(log: ForceLog) -> ClockFit:
            turned = replace(log, force=log.force @ axes)
            return fit_clock(markers, turned, stated, uncertainty, push_s=place)

        fit = fitted(log)
        if fit.lag is not None:
            log, remark = without_lag(log, fit.lag, choose_cutoff(fit.rate)), _slow_words(fit.lag)
            fit = fitted(log)
            fit = replace(fit, remarks=(remark, *fit.remarks))
    if base is not None and not fit.clock.found:
        base_offset = beam_frame.base_clock(markers, base, stated, uncertainty)
        if base_offset.found or log is None:
            fit = ClockFit(base_offset, rate=fit.rate)
    if not math.isfinite(fit.clock.offset):
        raise ObservationError(
            f"{rec.name}: nothing says when the film (or the tracks) starts on the log's clock, and the data do not "
            "show it. Write start_s in recording.toml.",
            about="clock",
        )
    times = log.time if log is not None else base.time if base is not None else markers.time
    beam_frame.check_overlap(markers, times, fit.clock.offset, "force log" if log is not None else "base angle log")
    if log is not None:
        begin, end = markers.time[[0, -1]] + fit.clock.offset
        log = log.rows(within(log.time, (begin - TARE_SPAN, end + TARE_SPAN)))
    return log, fit


def _slow_words(tau: float) -> Remark:
    """The warning of a sensor with the lag `tau` [s]."""
    text = (
        f"The force sensor is slow: its log follows the force with a time constant of about {tau:.2g} s, which makes "
        "every peak too low and k(s) too small. This was undone, as well as the log allows. Switch the sensor's filter "
        "off, or push more slowly."
    )
    return Remark("warning", text, about="clock")


def check_pace(rec: Recording, markers: Markers, log: ForceLog) -> None:
    """Raise where the log has too few rows during the film: its times are in another unit, or it is too sparse."""
    film, spacing = float(np.ptp(markers.time)), step(log.time)
    if spacing * FEWEST_ROWS > film:
        raise ObservationError(
            f"{rec.name}: the force log has a row every {spacing:.3g} s, fewer than {FEWEST_ROWS} during the film of "
            f"{film:.3g} s. Times must be in seconds: for milliseconds write "
            'time_unit = "ms" in [force]. Or log more often.',
            about="unit",
        )


def push_place(rec: Recording, log: ForceLog) -> float | None:
    """Where the force acts, if that stays the same to 2 % of the beam and no weight bends it too; else None."""
    if rec.gravity is not None:
        return None
    if log.push_s is None:
        return rec.push.at if rec.push else None
    return float(np.median(log.push_s)) if float(np.ptp(log.push_s)) < 0.02 else None


def without_lag(log: ForceLog, tau: float, cutoff: float) -> ForceLog:
    """The log without its sensor's lag `tau` [s]: `F + tau F'`, low-passed at `cutoff` [Hz] against noise."""
    bad = outliers(log.force, spacing=step(log.time))
    known = bridged(log.time, np.where(bad[:, None], np.nan, log.force))
    smooth = low_pass(log.time, known, cutoff, longest_gap=max(0.1, 3.0 * step(log.time)))
    return replace(log, force=smooth + tau * np.gradient(smooth, log.time, axis=0))


def cleaned(rec: Recording, log: ForceLog, contact: Contact, fit: ClockFit) -> CleanForce:
    """The force on the beam, its cut-off from the markers' motion and its zero from the rests."""
    assert rec.force is not None
    offset = fit.clock.offset
    clean = clean_force(
        log,
        [(low + offset, high + offset) for low, high in contact.rests],
        rotation=rec.force.rotation,
        acts_on=rec.force.acts_on,
        cutoff=choose_cutoff(fit.rate),
        noise=fit.noise,
    )
    refuse_other_unit(clean.force, rec.beam.mass, rec.name)
    return replace(clean, remarks=(*clean.remarks, *size_remarks(clean.force, rec.beam.mass)))


def force_at(
    clean: CleanForce, time: Array, push_s: float = math.nan, *, epsilon: float | None = None
) -> tuple[Array, Array]:
    """(T, 2) N force and (T,) place of the push at the times `time` [s, log's clock]; NaN where the log is silent.

    Interpolated, or of the nearest row of the log that is within `epsilon` [s]. The place is `push_s` where the log
    has none."""
    columns = clean.force if clean.push_s is None else np.column_stack([clean.force, clean.push_s])
    if epsilon is not None:
        after = np.clip(np.searchsorted(clean.time, time), 1, len(clean.time) - 1)
        row = np.where(time - clean.time[after - 1] < clean.time[after] - time, after - 1, after)
        close = np.abs(clean.time[row] - time) <= epsilon
        seen = np.where(close[:, None], columns[row], np.nan)
    else:
        seen = at_times(clean.time, columns, time, longest_gap=gap_limit(clean.time, clean.cutoff))
    if clean.push_s is None:
        return seen, np.full(len(time), push_s)
    return seen[:, :2], seen[:, 2]


def usable(markers: Markers, force: Array) -> tuple[BoolArray, tuple[Remark, ...]]:
    """(T,) frames with a force and at least one marker, and remarks on the others."""
    has_force: BoolArray = np.isfinite(force).min(axis=1)
    has_marker: BoolArray = np.isfinite(markers.xy).min(axis=-1).max(axis=1)
    remarks = [
        Remark("note", f"{int(np.sum(~good))} of {len(good)} frames {why}; left out.")
        for good, why in ((has_force, "lie outside the force log or in its gaps"), (has_marker, "show no marker"))
        if not good.all()
    ]
    good: BoolArray = np.asarray(has_force & has_marker)
    if not good.any():
        raise ObservationError(
            "No frame has both a marker and a force. Check the film, the log and start_s.", about="no overlap"
        )
    return good, tuple(remarks)
