"""Which frames of a recording can be learned from, and what acts on the beam in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from onebend.beam.loads import Loads, push, weight
from onebend.beam.statics import Equilibrium
from onebend.beam.stiffness import Polyline, Profile, Table, Uniform
from onebend.errors import LearningError
from onebend.recording.signals import low_pass, nan_mean, nan_median
from onebend.records import Array, BoolArray, IntArray, Observations, read_before_fit, tags_among

_BENT = 5.0  # times the median change by a second low-pass: a larger change is not noise
_SLIGHT = 0.01  # of the largest force: a smaller change is neglected
_MEMORY = 0.5  # of a period of the cut-off: reach of a change through the filter
_STILL = 4.0  # times a tag's noise: a larger displacement is motion
_NO_PUSH = 3e-3  # of the length, likewise
_LEAST_LEFT = 0.5  # of the usable frames: if fewer remain, all are used
_FEWEST = 5  # frames of a recording


def usable_frames(o: Observations) -> BoolArray:
    """(T,) frames under load whose force is known and that show at least one tag."""
    seen = np.any(np.isfinite(o.xy), axis=(1, 2))
    forced = np.all(np.isfinite(o.force), axis=1) & np.isfinite(push_places(o))
    weighed = np.any(o.gravity != 0.0, axis=1)
    return np.asarray(seen & forced & (o.loaded | weighed))


def nothing_moves(o: Observations) -> str:
    """An error message for a film in which no tag leaves its rest position by more than noise; empty otherwise."""
    if o.static or o.held is not None or np.any(o.gravity != 0.0):
        return ""
    away = distances(o.xy - rest_places(o))
    seen = np.any(np.isfinite(away), axis=0)
    if not seen.any():
        return ""
    usual = np.sqrt(np.trace(nan_median(o.covariance[:, seen, :2, :2]), axis1=1, axis2=2))
    farthest = np.nanpercentile(away[:, seen], 95.0, axis=0)
    if np.any(farthest > _STILL * usual) or np.any(farthest > _NO_PUSH * o.length):
        return ""
    return f"nothing moves in the film: the tags stay within {1e3 * float(np.max(farthest)):.2g} mm of where they rest"


def learnable_frames(observations: Observations) -> BoolArray:
    """(T,) usable frames without the neighbours of force changes faster than the low-pass filter.

    The tags are not filtered. The change by a second pass of the filter shows where the first one distorted the force.
    """
    usable, clean = usable_frames(observations), observations.source.clean_force
    if clean is None or not np.isfinite(clean.cutoff) or not usable.any():
        return usable
    known = np.all(np.isfinite(clean.force), axis=1)
    time, force = clean.time[known], clean.force[known]
    bent = distances(low_pass(time, force, clean.cutoff, longest_gap=np.inf) - force)
    used = observations.time[usable]
    inside = (time >= used[0]) & (time <= used[-1])
    usual = float(np.median(bent[inside])) if inside.any() else 0.0
    largest = float(np.max(distances(observations.force[usable])))
    wrong = time[bent > max(_BENT * usual, _SLIGHT * largest)]
    reach = _MEMORY / clean.cutoff
    after = np.searchsorted(wrong, observations.time)
    padded = np.concatenate([[-np.inf], wrong, [np.inf]])
    near = np.minimum(observations.time - padded[after], padded[after + 1] - observations.time) < reach
    kept = usable & ~near
    return np.asarray(kept if kept.sum() >= _LEAST_LEFT * usable.sum() else usable)


def chosen_frames(o: Observations, most: int) -> BoolArray:
    """(T,) at most `most` learnable frames, evenly spread.

    Raises:
        LearningError: fewer than can be learned from.
    """
    usable = np.flatnonzero(learnable_frames(o)).astype(np.int64)
    least = 1 if o.static else _FEWEST
    if len(usable) < least:
        raise LearningError(
            f"{o.source.name}: {len(usable)} frames show a load, with a force and a tag; at least {least} are needed. "
            "Push for longer (a second or more), keep the tags in view, and let the force log cover the whole film"
        )
    return evenly_spread(usable, most, len(o.time))


def evenly_spread(rows: IntArray, most: int, count: int) -> BoolArray:
    """(count,) at most `most` of the `rows`, evenly spread among them."""
    out = np.zeros(count, dtype=bool)
    out[rows[np.linspace(0, len(rows) - 1, min(most, len(rows))).astype(int)]] = True
    return out


def check_same_beam(recordings: Sequence[Observations]) -> None:
    """Raises `LearningError` where the recordings are not of one beam, or there is none."""
    if not recordings:
        raise LearningError("no recording was given")
    first = recordings[0]
    for o in recordings[1:]:
        if o.length != first.length or not np.array_equal(o.tag_id, first.tag_id):
            raise LearningError(
                f"{o.source.name} is not of the beam of {first.source.name}: length {o.length} m against "
                f"{first.length} m, tags {o.tag_id.tolist()} against {first.tag_id.tolist()}"
            )


def with_seen_tags(recordings: Sequence[Observations]) -> list[Observations]:
    """The recordings of one beam without the tags that none of them ever shows: they tell nothing, and cost time; and
    without the points of an outline that not all of them have."""
    several = [set(one.tag_id[~tags_among(one)].tolist()) for one in recordings]
    points = list(set.intersection(*several))
    recordings = [of_tags(one, tags_among(one) | np.isin(one.tag_id, points)) for one in recordings]
    if len({one.tag_id.tobytes() for one in recordings}) != 1:
        return recordings
    seen = np.any([np.isfinite(one.xy).any(axis=(0, 2)) for one in recordings], axis=0)
    return [of_tags(one, seen) for one in recordings]


def read_alone(one: Observations) -> Observations:
    """The observations without the points of an outline; where there are no tags with few of these."""
    kept = np.zeros(len(one.tag_id), dtype=bool)
    kept[read_before_fit(one)] = True
    return of_tags(one, kept)


def of_tags(one: Observations, kept: BoolArray) -> Observations:
    """The observations of the tags `kept` (m,) alone."""
    if kept.all():
        return one
    every = slice(None), kept
    changes = _taken(one, ("tag_id", "marker_s", "rest_xy", "rest_angle", "rest_covariance", "traced"), kept)
    changes |= _taken(one, ("xy", "angle", "covariance", "by_camera"), every)
    if not np.any(changes.get("traced", False)):
        changes |= {"traced": None, "width": None}  # which the outline shows
    if one.means is not None:
        changes["means"] = replace(one.means, **_taken(one.means, ("acceleration",), every))
    return replace(one, **changes)


def at_frames(one: Observations, kept: BoolArray) -> Observations:
    """The observations of a film in the frames `kept` (T,) alone; the rest is unchanged."""
    assert not one.static, "the readings of static poses name one of them by its number"
    changes = _taken(one, ("time", "frame", "xy", "angle", "covariance", "force", "push_s", "loaded", "gravity"), kept)
    changes |= _taken(one, ("held", "by_camera"), kept)
    if one.known_loads is not None:
        names = ("force", "force_s", "moment", "moment_s")
        changes["known_loads"] = replace(one.known_loads, **_taken(one.known_loads, names, kept))
    if one.means is not None:
        changes["means"] = replace(one.means, **_taken(one.means, ("count", "acceleration"), kept))
    return replace(one, **changes)


def _taken(one: Any, names: tuple[str, ...], index: Any) -> dict[str, Any]:
    """The fields of these names at an index, those that are not None."""
    return {name: value[index] for name in names if (value := getattr(one, name)) is not None}


def push_places(observations: Observations) -> Array:
    """(T,) where the force acts; the tip in frames without any force, where the place does not matter."""
    forceless = np.all(observations.force == 0.0, axis=1)
    return np.where(forceless & np.isnan(observations.push_s), 1.0, observations.push_s)


def loads_of(observations: Observations, frames: BoolArray) -> Loads:
    """The measured loads in those frames, weight included."""
    loads = push(observations.force[frames], push_places(observations)[frames]) + known_loads(observations, frames)
    return loads + weight(observations.gravity[frames])


def known_loads(observations: Observations, frames: BoolArray) -> Loads:
    """The loads in those frames besides the logged force and the weight."""
    known = observations.known_loads
    if known is None:
        return Loads()
    return Loads(known.force[frames], known.force_s[frames], known.moment[frames], known.moment_s[frames])


def mass_profile(observations: Observations) -> Profile:
    """kg/m along the beam, as written down; zero where no mass is known."""
    line, mass = observations.stated.mass_line, observations.stated.mass
    if line is not None and observations.stated.mass_along == "section":
        return Polyline(tuple(line.s.tolist()), tuple(line.value.tolist()))
    if line is not None:
        return Table(tuple(line.s.tolist()), tuple(line.value.tolist()))
    return Uniform(mass / observations.length if np.isfinite(mass) else 0.0)


def whitening(measured: Array, covariance: Array) -> Array:
    """(..., 3, 3) inverse Cholesky factors of the covariances (..., 3, 3) of poses; zero where a number is missing.

    A pose may lack its angle, or one coordinate: the rest of it counts by its own part of the covariance.
    """
    return _inverse_root(covariance, _known(measured, covariance))


def _known(measured: Array, covariance: Array) -> BoolArray:
    """(..., 3) which numbers of poses (..., 3) are measured, with a covariance (..., 3, 3)."""
    return np.asarray(np.isfinite(measured) & np.all(np.isfinite(covariance), axis=(-1, -2))[..., None])


def _inverse_root(covariance: Array, known: BoolArray) -> Array:
    """(..., n, n) inverse Cholesky factors of the known (..., n) parts of covariances (..., n, n); zero elsewhere."""
    both = known[..., :, None] & known[..., None, :]
    factors = np.linalg.inv(np.linalg.cholesky(np.where(both, covariance, np.eye(known.shape[-1]))))
    return np.asarray(np.where(both, factors, 0.0))


def distances(difference: Array) -> Array:
    """(...) m, lengths of differences (..., 2) over the coordinates that are there; NaN where none is."""
    there = np.isfinite(difference)
    length = np.sqrt(np.sum(np.where(there, difference, 0.0) ** 2, axis=-1))
    return np.asarray(np.where(np.any(there, axis=-1), length, np.nan))


def rest_places(o: Observations) -> Array:
    """(m, 2) m, where the tags were seen at rest; on a straight beam, where they were not."""
    straight = o.length * o.marker_s[:, None] * np.array([1.0, 0.0])
    return np.where(np.isfinite(o.rest_xy), o.rest_xy, straight)


def moved_by(o: Observations) -> Array:
    """(T,) m, root mean square distance of the tags from rest; NaN where no tag was seen."""
    return np.asarray(np.sqrt(nan_mean(distances(o.xy - rest_places(o)) ** 2, axis=1)))


def marker_rms(difference: Array) -> Array:
    """(m,) m, root mean square length of differences (T, m, 2); NaN for a tag that was never seen."""
    return np.asarray(np.sqrt(nan_mean(distances(difference) ** 2)))


# Readings of static poses: a hand-traced curve has correlated errors, a ruler or dial gauge stands at a fixed x while
# the beam slides beneath it, and gauges are zeroed in one pose.

STEEPEST = 0.05  # cosine of the beam's angle under a ruler, at least
_LOOKED_AT = np.linspace(0.0, 1.0, 201)
_OWN = 0.1  # of the variance across a curve whose errors are alike along it: each point's own, as of its edges
_HALF = 1.678346990016661  # where `(1 + a) exp(-a)` is a half
_SETTLE = 4  # steps of Newton's method from there


def pose_whitening(o: Observations, measured: Array, covariance: Array, across: Array) -> Array:
    """Whitening matrices of poses (F, m, 3) with covariances (F, m, 3, 3), zero where a number is missing. Of a point
    with a direction `across` (F, m, 2), zeros at the others, only the place along that is measured.

    (F, m, 3, 3) for independent points; (F, 3 m, 3 m) where errors are correlated along the beam. Then errors of x and
    y are a Matern 3/2 process with correlation `(1 + a) exp(-a)` at a distance d, `a = 1.68 d / error_length`; a share
    `_OWN` of the variance across a curve is each point's own. Errors of angles are independent.
    """
    frames, m = measured.shape[:2]
    known, onto = _known(measured, covariance), np.zeros((frames, m, 3, 3))
    onto[:] = np.eye(3)
    curve = np.any(across != 0.0, axis=-1)
    if curve.any():  # one row of each such point: that of the coordinate which it tells most of
        row = np.argmax(np.abs(across), axis=-1)[..., None] == np.arange(3)
        known = np.where(curve[..., None], row & known[..., :2].all(axis=-1, keepdims=True), known)
        along = np.concatenate([across, np.zeros((frames, m, 1))], axis=-1)
        onto = np.where(curve[..., None, None], row[..., None] * along[..., None, :], onto)
        covariance = onto @ covariance @ np.swapaxes(onto, -1, -2)
    if o.readings.error_length == 0.0:
        return _inverse_root(covariance, known) @ onto
    apart = o.length * np.abs(o.marker_s[:, None] - o.marker_s)
    share = _HALF * apart / o.readings.error_length
    alike = np.ones((frames, m, m, 3)) * ((1.0 + share) * np.exp(-share))[..., None]
    alike[..., 2] = np.eye(m)
    own = _OWN * curve[..., None]
    alike = alike * np.sqrt((1.0 - own[:, :, None]) * (1.0 - own[:, None]))
    alike += own[:, :, None] * np.eye(m)[..., None]
    values, vectors = np.linalg.eigh(np.where(known[..., :, None] & known[..., None, :], covariance, np.eye(3)))
    root = (vectors * np.sqrt(values)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    whole = np.einsum("fiab,fijb,fjcb->fiajc", root, alike, root).reshape(frames, 3 * m, 3 * m)
    whiten = _inverse_root(whole, known.reshape(frames, 3 * m)).reshape(frames, 3 * m, m, 3)
    return np.asarray(np.einsum("frjb,fjbc->frjc", whiten, onto).reshape(whole.shape))


def whitened(whiten: Array, poses: Array) -> Array:
    """(F, 3 m, n) of columns of poses (F, m, 3, n), by `pose_whitening`."""
    flat = poses.reshape(len(poses), -1, poses.shape[-1])
    if whiten.ndim == 3:
        return np.asarray(whiten @ flat)
    return np.asarray((whiten @ poses).reshape(flat.shape))


def unwhitened(whiten: Array, rows: Array) -> Array:
    """(F, m, 3) of rows (F, 3 m): back from `whitened`, zero where a number is missing."""
    known = np.any(whiten != 0.0, axis=-1)
    safe = whiten + ~known[..., None] * np.eye(whiten.shape[-1])
    away = np.linalg.solve(safe, rows.reshape(*known.shape, 1))[..., 0]
    return np.asarray(np.where(known, away, 0.0).reshape(len(rows), -1, 3))


def ruler_places(solved: Equilibrium, x: Array) -> tuple[Array, Array]:
    """(F, m) s under rulers at x (F, m) [m], and (F, m) m beyond the tip where the beam is too short."""
    there = solved.xy(_LOOKED_AT)[..., 0]
    reached = there[:, None, :] >= x[..., None]  # (F, m, S)
    after = np.maximum(np.argmax(reached, axis=-1), 1)
    ahead, behind = (np.take_along_axis(there, i, axis=1) for i in (after, after - 1))
    share = np.clip((x - behind) / np.where(ahead == behind, 1.0, ahead - behind), 0.0, 1.0)
    low, high = _LOOKED_AT[after - 1], _LOOKED_AT[after]
    s = low + share * (high - low)
    length = np.max(solved.problem.length)
    for _ in range(_SETTLE):
        s = np.clip(s + (x - solved.xy(s)[..., 0]) / (length * steepness(solved.angle(s))), low, high)
    tip = solved.angle(np.ones(1))
    over = (x - solved.xy(np.ones(1))[..., 0]) / steepness(tip)
    short = ~np.any(reached, axis=-1)
    return np.where(short, 1.0, s), np.where(short, over, 0.0)


def steepness(angle: Array) -> Array:
    """(...) cosine of the beam's angle under a ruler, bounded from below."""
    return np.maximum(np.cos(angle), STEEPEST)


def points_of(o: Observations, frames: BoolArray, solved: Equilibrium) -> Array:
    """(F, m, 2) m predicted readings of shapes `solved` in these frames (T,): marks, or rulers."""
    if o.readings.at == "mark":
        return solved.xy(o.marker_s)
    x = o.xy[frames][..., 0]
    asked = np.where(np.isfinite(x), x, 0.0)
    s, over = ruler_places(solved, asked)
    y = solved.xy(s)[..., 1] + over * np.sin(solved.angle(s))
    return np.stack([x, np.where(np.isfinite(x), y, np.nan)], axis=-1)


def from_the_clamp(o: Observations, frames: BoolArray, predicted: Array) -> Array:
    """(F, m, 2) m, readings of these frames (T,) from the clamp: zeroed gauges are shifted to the `predicted` (F, m, 2)
    pose of their zero, or to the mean of all shapes if that pose is not among the frames."""
    read, zeroed = o.xy[frames], o.readings.bare
    if zeroed < 0:
        return read
    away = np.where(np.isfinite(read), predicted - read, np.nan)
    shift = away[int(np.sum(frames[:zeroed]))] if frames[zeroed] else nan_mean(away)
    return read + (shift if o.readings.at == "mark" else shift * np.array([0.0, 1.0]))


def zeroed_coordinates(o: Observations) -> tuple[tuple[int, int], ...]:
    """(point, axis) of every reading that counts from a zero of its own."""
    if o.readings.bare < 0:
        return ()
    axes = (0, 1) if o.readings.at == "mark" else (1,)
    seen = np.any(np.isfinite(o.xy), axis=0)
    return tuple((i, c) for i in range(len(o.marker_s)) for c in axes if seen[i, c])
