"""The offset between the film's clock and the force log's, with its posterior."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.recording import clock_evidence
from onebend.recording.clock_features import HOLD, FilmFeatures, film_features
from onebend.recording.clock_moments import offset_from_moments
from onebend.records import Array, ClockOffset, ForceLog, ForceNoise, Markers, Remark

FARTHER = 2.0  # s, searched beyond the stated offset and its uncertainty
SHARP_ROWS = 120  # of the log, for the model by the spans' moments
ROUGHLY = 0.1  # s: a start stated to this uncertainty or less was measured, and is trusted


def search_range(
    film: Array, log: Array, stated: float, uncertainty: float
) -> tuple[float, float, clock_evidence.Prior]:
    """The lowest and highest offset to try [s], and the log prior of offsets. `uncertainty` must be above 0."""
    half = 0.5 * (film[-1] - film[0])
    first, last = log[0] - film[0] - half, log[-1] - film[-1] + half
    if not (np.isfinite(stated) and np.isfinite(uncertainty)):
        return first, last, lambda offset: np.zeros_like(offset)
    uncertainty = max(uncertainty, 1e-6)  # s, a smaller uncertainty counts as this
    reach = reach_of(uncertainty)
    # s, added to the prior's sd of a start with an uncertainty of `ROUGHLY` or more.
    scale = uncertainty / 2 + 0.05 * min(1.0, (uncertainty / ROUGHLY) ** 2)

    def prior(offset: Array) -> Array:
        distance = np.abs(offset - stated) / scale
        return np.asarray(-np.where(distance < 2, 0.5 * distance**2, 2 * distance - 2))

    return max(first, stated - reach), min(last, stated + reach), prior


def reach_of(uncertainty: float) -> float:
    """s, how far from the stated offset is searched: beyond its uncertainty, but not far where that is small."""
    return uncertainty + min(FARTHER, 20.0 * uncertainty)  # times a small uncertainty: how far beyond it is searched


def prior_spread(low: float, high: float, prior: clock_evidence.Prior) -> float:
    """sd of the prior over offsets, s."""
    if high <= low:
        return float("inf")
    offset = np.linspace(low, high, 2001)
    return clock_evidence.moments_of(offset, prior(offset))[1]


AS_WRITTEN = "start_s is used as it is written"
TOO_LITTLE = (
    f"Film and log share too little force and motion to match the clocks; {AS_WRITTEN}. Push further, or measure "
    "start_s."
)


def unsettled_remark(shift: float, sd: float, uncertainty: float) -> Remark:
    """The remark where the offset stays uncertain (`sd` [s]); `shift` [s]: the best offset less the stated one."""
    if uncertainty < ROUGHLY and abs(shift) > uncertainty + 3.0 * sd:  # sd of the data beyond the uncertainty
        text = f"The data would have the film start {shift:+.3f} s from start_s, more than its uncertainty"
        text += f"; {AS_WRITTEN}. If it may be wrong, give a larger start_uncertainty_s."
        return Remark("warning", text, about="clock")
    if uncertainty < ROUGHLY:
        return Remark("note", f"The data tell the clocks' offset no better than start_uncertainty_s; {AS_WRITTEN}.")
    text = f"The clocks could not be matched from the data (one sd {sd:.2g} s); {AS_WRITTEN}. Check it."
    return Remark("warning", text, about="clock")


def remarks_on(clock: ClockOffset, uncertainty: float, low: float, high: float) -> tuple[Remark, ...]:
    """Warnings and notes on an offset that was found."""
    remarks = []
    if min(clock.offset - low, high - clock.offset) < 2 * clock.sd:
        text = "The clock offset found lies at the edge of the range searched; give a better start_s in [video]."
        remarks.append(Remark("warning", text, about="clock"))
    elif abs(clock.offset - clock.stated) > uncertainty + 2 * clock.sd:
        text = f"The film starts {clock.offset - clock.stated:+.2f} s from start_s, more than its uncertainty. Correct "
        remarks.append(Remark("warning", f"{text}start_s.", about="clock"))
    if clock.sd > 0.1:
        text = f"The clocks are matched to {clock.sd:.2f} s (one sd) only: the push is slow or weak."
        remarks.append(Remark("note", text))
    return tuple(remarks)


@dataclass(frozen=True)
class ClockFit:
    """The offset, and what the comparison of film and log says of the sensor."""

    clock: ClockOffset
    noise: ForceNoise | None = None  # of the log; None where it was not fitted
    remarks: tuple[Remark, ...] = ()
    rate: float = float("nan")  # Hz, bandwidth of the tags' motion
    lag: float | None = None  # s, of a slow sensor


def fit_clock(
    markers: Markers, log: ForceLog, stated: float, uncertainty: float, *, push_s: float | None = None
) -> ClockFit:
    """The posterior of the offset between the two clocks, and the lag of a sensor that is certainly slow.

    The prior takes `uncertainty` [s] as two sd of `stated`, with exponential tails; where `stated` is NaN, all offsets
    that put half of the film inside the log are equally likely. `found` is False where the posterior sd is more than
    half of the prior's. An `uncertainty` of 0 says that `stated` is exact. With the place of the push `push_s`, `log`
    must be in the beam's axes (its sign and bias do not matter). The beam must move slowly against its own
    oscillations."""
    film = film_features(markers, push_s)
    fit = fit_offset(film, log, stated, uncertainty)
    lag = clock_evidence.find_lag(film, log, fit.clock.offset) if fit.clock.found else None
    return replace(fit, rate=film.rate, lag=lag)


def fit_offset(film: FilmFeatures, log: ForceLog, stated: float, uncertainty: float) -> ClockFit:
    """The posterior of the offset alone."""
    exact = uncertainty == 0.0 and np.isfinite(stated)
    low, high = stated, stated
    prior: clock_evidence.Prior = np.zeros_like
    if not exact:
        low, high, prior = search_range(film.time, log.time, stated, uncertainty)
    rows = clock_evidence.compared_rows(film, log, (low, high))
    if exact:
        scans = [] if rows is None else clock_evidence.feature_scans(film, rows, np.array([stated]), prior)
        clock = ClockOffset(offset=stated, sd=0.0, stated=stated, found=True)
        return ClockFit(clock, scans[0].noise if scans else None)
    spread = prior_spread(low, high, prior)
    doubt = min(spread, uncertainty) if uncertainty < ROUGHLY else spread if np.isfinite(uncertainty) else np.inf
    unsettled = ClockOffset(offset=stated, sd=doubt, stated=stated, found=False)
    if not 0.0 < film.rate < np.inf or high <= low:
        return ClockFit(unsettled, None, (Remark("note", "Nothing moves in the film: the clocks cannot be matched."),))
    match = None if rows is None else matched(film, rows, (low, high), prior)
    if match is None:
        return ClockFit(unsettled, None, (Remark("warning", TOO_LITTLE, about="clock"),))
    offset, sd, noise = match
    if not sd < 0.5 * spread:
        return ClockFit(unsettled, noise, (unsettled_remark(offset - stated, sd, uncertainty),))
    clock = ClockOffset(offset=offset, sd=sd, stated=stated, found=True)
    return ClockFit(clock, noise, remarks_on(clock, uncertainty, low, high))


def matched(
    film: FilmFeatures, rows: clock_evidence.BinnedLog, within: tuple[float, float], prior: clock_evidence.Prior
) -> tuple[float, float, ForceNoise] | None:
    """Offset [s] between `within`, its sd [s] and the log's noise; None where film and log have too little in common.

    The first search models the force by features of the tags, the second by the moments of a push at a known place."""
    offsets = clock_evidence.likely_offsets(film, rows, *within)
    scans = clock_evidence.feature_scans(film, rows, offsets, prior)
    if not scans:
        return None
    if film.moments is not None:
        few = clock_evidence.thinned(rows, max(4 * film.rate, SHARP_ROWS / (film.moments.track.duration + HOLD)))
        span = clock_evidence.likely_span(scans, offsets, *within)
        sharp = offset_from_moments(film.moments, few, span, clock_evidence.peaks(scans, offsets), prior)
        if sharp is not None:
            return sharp
    return *clock_evidence.averaged_over(
        scans, [clock_evidence.refined(scan, rows, offsets, prior) for scan in scans]
    ), scans[0].noise
