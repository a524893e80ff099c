"""Two clocks made one: the offset between the video's clock and the force log's, from the data.

For every offset the log is explained by what the markers say of the force (`relation.py`: levers and polynomials with
unknown coefficients; no stiffness enters) plus the sensor's noise, and the offset is judged by how probable that makes
the log. Three things decide about the accuracy, and all are minded here:

- the log's rows stay fixed and the markers are shifted under them. Shifting the log instead would compare different
  samples of its noise, whose scatter is larger than what an offset of some hundredths of a second changes;
- coefficients are integrated out under a prior (evidence), not fitted: for a push in one direction a free function of
  the displacement could follow any offset, and a maximum would claim an accuracy it does not have;
- the noise is coloured and wanders (`noise.py`); its sizes come from the same data.

A push whose force rises at F' [N/s] during T under a noise of spectral density S tells the offset to about
sqrt(S / (F'^2 T)), and no method does better: slow pushes with a weak force leave tens of milliseconds. `sd` says so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from onebend.recording.clock_moments import make_moments
from onebend.recording.clock_rows import Rows, binned, thinned
from onebend.recording.clock_sharp import STEP_DOUBT, moments_of, sharpened
from onebend.recording.clock_words import TOO_LITTLE, as_written, remarks_on
from onebend.recording.noise import first_guess, fit_noise, log_evidence
from onebend.recording.relation import Track, make_track
from onebend.recording.signals import bandwidth
from onebend.records import Array, ClockOffset, ForceLog, ForceNoise, Markers, Remark

LONG = 12.0  # s: offsets of a longer range are looked through roughly first
FIRST_LOOK, UNLIKELY = 60.0, 30.0  # rows a film; log chance below the best that is not looked at again
MOST_LOOKS, AROUND = 24, 0.5  # offsets that are looked at again, and how far around them, s
FAR_OFF, NEAR = 0.05, 0.02  # of the largest force: what an offset of the first, second look may leave unexplained
LEAST = 0.2  # s, looked at closely on either side of the first estimate

Prior = Callable[[Array], Array]  # log of the prior over offsets, less a constant


@dataclass(frozen=True)
class ClockSettings:
    """How the offset is searched."""

    margin: float = 2.0  # s, searched beyond what was said plus its uncertainty
    corrections: tuple[float, ...] = (0.001, 0.01)  # prior of the polynomials that mend the levers, tried in turn
    most_rows: int = 250  # of the log, after averaging
    sharp_rows: int = 120  # of these, where they are explained by the spans' turns
    slowest: float = 5.0  # rows per second at least
    longest_gap: float = 0.25  # s, a marker missing longer is not interpolated
    steps: float = 0.3  # of the largest force: sd of a log's error that changes where the load begins, reverses, ends
    hold: float = 2.0  # s, a beam that stands still in the first (last) frames is taken to stand still before (after)


@dataclass(frozen=True)
class ClockFit:
    """The offset, and what was learned of the noise on the way (None where nothing was found)."""

    clock: ClockOffset
    noise: ForceNoise | None
    remarks: tuple[Remark, ...] = ()


@dataclass(frozen=True)
class Search:
    """One way to explain the log, tried at all offsets."""

    track: Track
    noise: ForceNoise
    chance: Array  # log posterior over the coarse offsets


def find_offset(
    markers: Markers,
    log: ForceLog,
    said: float,
    uncertainty: float,
    *,
    push_s: float | None = None,
    settings: ClockSettings = ClockSettings(),
) -> ClockOffset:
    """`log time = video time + offset`, searched over `said` +- (`uncertainty` + margin) [s]; see `fit_clock`."""
    return fit_clock(markers, log, said, uncertainty, push_s=push_s, settings=settings).clock


def fit_clock(
    markers: Markers,
    log: ForceLog,
    said: float,
    uncertainty: float,
    *,
    push_s: float | None = None,
    settings: ClockSettings = ClockSettings(),
) -> ClockFit:
    """The posterior of the offset between the two clocks.

    The prior takes `uncertainty` [s] as two sd of `said`, with exponential tails beyond. Where `said` is NaN every
    offset counts alike under which half of the film is inside the log. `found` is False where the data leave more than
    half of the prior's spread; then the offset is what was said. `push_s` is the place of the push; with it, `log`
    must be in the beam's axes (its sign and bias do not matter).

    Assumes that the film and the log both show the push, that what bends the beam is the logged force, and that the
    beam moves slowly against its own oscillations for most of the film.
    """
    low, high, prior = search_range(markers.time, log.time, said, uncertainty, settings)
    spread = prior_spread(low, high, prior)
    unsettled = ClockOffset(offset=said, sd=spread if np.isfinite(uncertainty) else np.inf, said=said, found=False)
    rate = bandwidth(markers.time, displacements(markers))
    if not np.isfinite(rate) or high <= low:
        return ClockFit(unsettled, None, (Remark("note", "Nothing moves in the film: the clocks cannot be matched."),))
    span = (markers.time[0] + low, markers.time[-1] + high)
    most = settings.most_rows / float(np.ptp(markers.time) + settings.hold)
    rows = binned(log, max(8 * rate, settings.slowest), span, most)
    enough = len(rows.time) >= 10 and rows.largest > 0
    ways = [track for track in tracks(markers, push_s, settings) if enough and track.covered.sum() >= 10]
    coarse = likely_offsets(ways[-1], rows, low, high, rate) if ways else np.empty(0)
    searches = [coarse_search(track, rows, coarse, prior) for track in ways]
    moments = None
    if push_s is not None and ways:
        moments = make_moments(markers, push_s=push_s, longest_gap=settings.longest_gap, hold=settings.hold)
    if ways and moments is None:  # the same with an error that changes with the load; the data say which it is
        which = int(np.argmax([search.chance.max() for search in searches]))
        stepped = tracks(markers, push_s, settings, settings.steps)[which]
        searches.append(coarse_search(stepped, rows, coarse, prior))
    searches = [search for search in searches if np.isfinite(search.chance).any()]
    if not searches:
        return ClockFit(unsettled, None, (Remark("warning", f"{TOO_LITTLE}; {as_written(uncertainty)}."),))
    best = max(searches, key=lambda search: float(search.chance.max()))
    offset, sd = refined(best, rows, coarse, prior)
    noise = best.noise
    sharp = None
    if moments is not None:
        few = thinned(rows, max(4 * rate, settings.sharp_rows / (moments.track.duration + settings.hold)))
        sharp = sharpened(moments, few, likely_span(searches, coarse, offset, low, high), offset, prior)
    if sharp is not None:
        offset, sd, noise = sharp
    if best is searches[-1] and len(searches) > len(ways):
        sd = float(np.hypot(sd, STEP_DOUBT))
    if not sd < 0.5 * spread:
        text = f"The clocks could not be matched from the data (one sd {sd:.2g} s); {as_written(uncertainty)}."
        return ClockFit(unsettled, noise, (Remark("warning", text),))
    clock = ClockOffset(offset=offset, sd=sd, said=said, found=True)
    return ClockFit(clock, noise, remarks_on(clock, uncertainty, low, high))


def likely_span(searches: list[Search], coarse: Array, first: float, low: float, high: float) -> tuple[float, float]:
    """s, lowest and highest offset that is worth a closer look."""
    chance = np.max([search.chance - search.chance.max() for search in searches], axis=0)
    good = coarse[chance > -UNLIKELY]
    return max(low, min(float(good.min()), first - LEAST)), min(high, max(float(good.max()), first + LEAST))


def tracks(markers: Markers, push_s: float | None, settings: ClockSettings, steps: float = 0.0) -> list[Track]:
    """The explanations to try: polynomials alone, and levers with small and larger polynomials to mend them."""
    same = {"longest_gap": settings.longest_gap, "hold": settings.hold, "steps": steps}
    ways = [(None, 1.0)] + ([(push_s, scale) for scale in settings.corrections] if push_s is not None else [])
    made = [make_track(markers, push_s=place, polynomials=scale, **same) for place, scale in ways]
    return [track for track in made if track is not None]


def search_range(
    film: Array, log: Array, said: float, uncertainty: float, settings: ClockSettings
) -> tuple[float, float, Prior]:
    """Lowest and highest offset to try, and the log of the prior over offsets."""
    half = 0.5 * (film[-1] - film[0])
    first, last = log[0] - film[0] - half, log[-1] - film[-1] + half
    if not (np.isfinite(said) and np.isfinite(uncertainty)):
        return first, last, lambda offset: np.zeros_like(offset)
    reach, scale = uncertainty + settings.margin, uncertainty / 2 + 0.05

    def prior(offset: Array) -> Array:
        away = np.abs(offset - said) / scale
        return np.asarray(-np.where(away < 2, 0.5 * away**2, 2 * away - 2))

    return max(first, said - reach), min(last, said + reach), prior


def prior_spread(low: float, high: float, prior: Prior) -> float:
    """sd of the prior over offsets, s."""
    if high <= low:
        return float("inf")
    offset = np.linspace(low, high, 2001)
    return moments_of(offset, prior(offset))[1]


def displacements(markers: Markers) -> Array:
    """(T, 2m) m, every marker's x and y against their medians; markers never seen are left out."""
    flat = markers.xy.reshape(len(markers.time), -1)
    flat = flat[:, np.isfinite(flat).any(axis=0)]
    return np.asarray(flat - np.nanmedian(flat, axis=0)) if flat.size else np.zeros((len(markers.time), 1))


def likely_offsets(track: Track, rows: Rows, low: float, high: float, rate: float) -> Array:
    """Offsets to try from `low` to `high` [s], dense; of a long range only those around what a first look finds."""
    fine = np.arange(low, high + 0.05, min(0.05, 0.25 / rate))
    if high - low < LONG:
        return fine
    look = np.arange(low, high, max(min(0.25, 0.25 / rate), 0.05))
    thin = thinned(rows, FIRST_LOOK / track.duration)
    chance = chances(track, thin, look, roughly(first_guess(thin.force, thin.width), FAR_OFF * rows.largest))
    best = np.argsort(-chance)[:MOST_LOOKS]
    good = look[best[chance[best] >= chance.max() - UNLIKELY]]
    return np.asarray(fine[np.abs(fine[:, None] - good).min(axis=1) < AROUND])


def roughly(noise: ForceNoise, size: float) -> ForceNoise:
    """`noise` with a coloured part of at least `size` [N]: what offsets that are a little off leave unexplained."""
    return replace(noise, coloured=max(noise.coloured, size), tau=max(noise.tau, 0.5))


def coarse_search(track: Track, rows: Rows, offset: Array, prior: Prior) -> Search:
    """The log posterior over all offsets, with the noise fitted at the best of them, twice."""
    noise = first_guess(rows.force, rows.width)
    chance = np.full(len(offset), -np.inf)
    for size in (NEAR * rows.largest, 0.0):
        chance = chances(track, rows, offset, roughly(noise, size) if size else noise)
        if not np.isfinite(chance).any():
            break
        design = rows.largest * track.mean(rows.time - offset[int(np.argmax(chance + prior(offset)))], rows.width)
        use = np.isfinite(design).all(axis=(1, 2))
        noise = fit_noise(rows.time[use], design[use], rows.force[use], noise)
    return Search(track, noise, chance + prior(offset))


def chances(track: Track, rows: Rows, offset: Array, noise: ForceNoise) -> Array:
    """Log evidence of every offset; minus infinity where film and log have too little in common.

    Each offset covers other rows with film, so they are compared by what the markers add to the rows they cover: the
    evidence with them over the evidence without, which takes a force that changes for a random walk and a force that
    stands still for noise. A film laid over a quiet stretch of the log gains nothing.
    """
    chance = np.full(len(offset), -np.inf)
    least = max(10.0, 0.25 * min(len(rows.time), track.duration / rows.width))
    moved = rows.moved(first_guess(rows.force, rows.width))
    reach = (track.time[0] - track.before - rows.width, track.time[-1] + track.after + rows.width)
    none: dict[bytes, float] = {}
    roots: dict[bytes, Array] = {}
    for i, each in enumerate(offset):
        near = np.arange(*np.searchsorted(rows.time, (reach[0] + each, reach[1] + each)))
        if len(near) < least:
            continue
        design = rows.largest * track.mean(rows.time[near] - each, rows.width)
        told = np.isfinite(design).all(axis=(1, 2))
        use, design = near[told], design[told]
        if len(use) < least:
            continue
        time, force, key = rows.time[use], rows.force[use], use.tobytes()
        if key not in roots:
            roots[key] = noise.root(time)
            walk = np.minimum(moved[use][:, None], moved[use]) - moved[use][0]
            root = np.linalg.cholesky(noise.covariance(time) + walk)
            nothing = np.zeros((len(time), 2, 2)) + 10 * rows.largest * np.eye(2)
            none[key] = log_evidence(root, nothing, force)
        chance[i] = log_evidence(roots[key], design, force) - none[key]
    return chance


def refined(search: Search, rows: Rows, coarse: Array, prior: Prior) -> tuple[float, float]:
    """Mean and sd of the posterior around its highest peak; other peaks widen the sd by their share."""
    centre, reach = float(coarse[int(np.argmax(search.chance))]), max(3 * (coarse[1] - coarse[0]), 0.1)
    mean, sd = centre, float("inf")
    for _ in range(6):
        offset = np.linspace(centre - reach, centre + reach, 33)
        gain = fixed_rows(search, rows, offset)
        if gain is None:
            break
        mean, sd = moments_of(offset, gain + prior(offset))
        if 0.08 * reach < sd < 0.3 * reach and abs(mean - centre) < 0.5 * reach:
            break
        centre, reach = mean, min(max(4.5 * sd, 1e-3), 2 * reach)
    return mean, with_other_peaks(search, rows, coarse, mean, max(sd, 1e-3), reach)


def with_other_peaks(search: Search, rows: Rows, coarse: Array, mean: float, sd: float, reach: float) -> float:
    """`sd` of the peak at `mean` widened by the share of all that lies farther away than `reach`."""
    best = float(coarse[int(np.argmax(search.chance))])
    ends = fixed_rows(search, rows, np.array([best, mean]))
    away = np.abs(coarse - mean) > max(reach, 4 * sd)
    if ends is None or not away.any():
        return sd
    # The coarse offsets may straddle a sharp peak: its own height, then its mass as a normal distribution.
    peak = float(search.chance.max() + max(ends[1] - ends[0], 0.0))
    mass = np.exp(search.chance[away] - peak) * (coarse[1] - coarse[0])
    whole = float(mass.sum()) + sd * np.sqrt(2 * np.pi)
    return float(np.sqrt(sd**2 + mass @ (coarse[away] - mean) ** 2 / whole))


def fixed_rows(search: Search, rows: Rows, offset: Array) -> Array | None:
    """Log evidence at every `offset`, over the rows that all of them cover; None where these are too few."""
    designs = [rows.largest * search.track.mean(rows.time - each, rows.width) for each in offset]
    use = np.all([np.isfinite(design).all(axis=(1, 2)) for design in designs], axis=0)
    if use.sum() < 10:
        return None
    root = search.noise.root(rows.time[use])
    return np.array([log_evidence(root, design[use], rows.force[use]) for design in designs])
