"""Cleaning the force log: sign, frame, outliers, zero, zero-phase low-pass, and the noise that remains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from onebend.recording.force.noise import first_guess
from onebend.recording.signals import at_times, low_pass, outliers, step
from onebend.records import Array, BoolArray, CleanForce, ForceLog, ForceNoise, Remark

_DRIFTED = 0.2  # of the largest force: a zero that changes by more between two rests is warned of
_LOST = 0.5  # by more than this, the log hardly tells the force


@dataclass(frozen=True)
class ForceSettings:
    """How the log is cleaned."""

    overtone: float = 2.0  # cut-off over the bandwidth of the markers' motion: see `choose_cutoff`
    tare_span: float = (
        3.0  # s of a rest, nearest to contact, for the zero; a longer one adds drift, a shorter one noise
    )
    outlier_sd: float = 6.0
    longest_gap: float = 0.1  # s, or as long as the filter's memory where that is longer: a longer gap stays a gap


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


def choose_cutoff(motion: float, settings: ForceSettings) -> float:
    """Cut-off of the low-pass from the bandwidth `motion` [Hz] of the markers; infinite where that is not known.

    A beam that moves slowly is in equilibrium with the force, so the force is a function of the markers'
    displacements. The function is nonlinear: its square terms double the bandwidth. Hence twice that of the markers.
    """
    return settings.overtone * motion if np.isfinite(motion) and motion > 0 else math.inf


def clean_force(
    log: ForceLog,
    rests: Sequence[tuple[float, float]],
    *,
    rotation: float = 0.0,
    acts_on: Literal["beam", "robot"] = "beam",
    cutoff: float = math.inf,
    noise: ForceNoise | None = None,
    settings: ForceSettings = ForceSettings(),
) -> CleanForce:
    """Force on the beam in the beam's frame, F = +-R(rotation) F_log, without outliers, zeroed at `rests` and filtered.

    `rests` are spans of the log's clock with a free beam. With rests on both sides of the contact the zero runs
    straight between them, which takes most of the sensor's drift off; with one it is constant; with none the force
    keeps its bias, its noise is unknown (NaN) and a warning says so. `noise` is what is known of the sensor's noise
    (from the clock search); without it the scatter at rest stands for it, and drift is not in `noise_sd`.
    """
    bad = outliers(log.force, spacing=step(log.time), threshold=settings.outlier_sd)
    force = log.force @ to_beam(rotation)
    if acts_on == "robot":
        force = -force
    force[bad] = np.stack([np.interp(log.time[bad], log.time[~bad], column[~bad]) for column in force.T], axis=1)
    smooth = low_pass(log.time, force, cutoff, longest_gap=gap_limit(log.time, cutoff, settings))
    zero = zero_of(log.time, force, rests, noise, settings)
    clean = smooth - zero.at(log.time)
    remarks = zero_remarks(zero, float(np.abs(clean).max()), cutoff)
    drift = np.full(2, np.nan)
    if len(zero.time) > 1:
        drift = (zero.value[-1] - zero.value[0]) / (zero.time[-1] - zero.time[0])
    return CleanForce(
        time=log.time,
        force=clean,
        push_s=log.push_s,
        noise_sd=remaining_sd(log.time, smooth, rests, zero, cutoff, noise),
        tare=zero.value[0] if len(zero.time) else np.zeros(2),
        drift=drift,
        cutoff=cutoff,
        outliers=int(bad.sum()),
        noise=None if noise is None else _with_white(noise, log.time, force),
        zero_time=zero.time,
        zero=zero.value,
        remarks=(*log.remarks, *remarks),
    )


def _with_white(noise: ForceNoise, time: Array, force: Array) -> ForceNoise:
    """`noise` with its white part as the log's own samples show it: there it stands out from all that is slower."""
    spacing = step(time)
    return replace(noise, white=first_guess(force, spacing).white, spacing=spacing)


def to_beam(rotation: float) -> Array:
    """(2, 2) matrix that turns rows of force in the log's axes into the beam's: F_beam = R(rotation) F_log."""
    cos, sin = math.cos(rotation), math.sin(rotation)
    return np.array([[cos, sin], [-sin, cos]])


def within(time: Array, span: tuple[float, float]) -> BoolArray:
    return np.asarray((time >= span[0]) & (time <= span[1]))


def zero_of(
    time: Array, force: Array, rests: Sequence[tuple[float, float]], noise: ForceNoise | None, settings: ForceSettings
) -> Zero:
    """Mean force over each rest, of the part nearest to contact where the rest is long."""
    times, values, sizes = [], [], []
    for i, span in enumerate(rests):
        rows = np.flatnonzero(within(time, span))
        if len(rows) < 2:
            continue
        # The first rest is followed by contact, later ones are preceded by it.
        distance = time[rows[-1]] - time[rows] if i == 0 else time[rows] - time[rows[0]]
        rows = rows[distance <= settings.tare_span]
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
        text = "The force's drift cannot be seen: the beam is not free again. Let go before the log ends."
        remarks.append(Remark("note", text))
    elif change > _DRIFTED * largest:
        text = f"The force's zero drifted by {change:.2g} N between the rests. Let the sensor warm up."
        if doubt := change > _LOST * largest:
            text = (
                f"The force's zero drifted by {change:.2g} N between the rests, and the push is {largest:.2g} N: how "
                "the zero ran during the push is a guess. Push harder, or let the sensor warm up."
            )
        remarks.append(Remark("warning", text, doubt=doubt, about="drift"))
    if not math.isfinite(cutoff):
        remarks.append(Remark("note", "The force is not low-passed: no motion tells its bandwidth."))
    return tuple(remarks)


def gap_limit(time: Array, cutoff: float, settings: ForceSettings = ForceSettings()) -> float:
    """Longest span between two rows that may be interpolated, s."""
    memory = 1 / (2 * math.pi * cutoff) if math.isfinite(cutoff) and cutoff > 0 else 0.0
    return max(settings.longest_gap, memory, 3 * step(time))


def force_at(clean: CleanForce, time: Array, *, settings: ForceSettings = ForceSettings()) -> Array:
    """(T, 2) N at the times `time` [s, log's clock]; NaN outside the log and in its gaps."""
    return at_times(clean.time, clean.force, time, longest_gap=gap_limit(clean.time, clean.cutoff, settings))
