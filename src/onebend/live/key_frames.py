"""Key frames: a bounded set of frames that stands for all frames so far.

A key frame is linear in the parameters x and in its own force error e: `zeta = J x - A e + noise`. It keeps its
measurement, so that it can be linearised anew. Neighbours in time under nearly the same force are averaged; where no
two are alike, the oldest is marginalised (`posterior.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike

from onebend.errors import LearningError
from onebend.learning.allowances import TIMES, Allowance, PushCourse, allowances_of
from onebend.recording.force_noise import LoadChange, TimeSpans, load_changes, own_time
from onebend.records import Array, BoolArray, IntArray, left_of, unit

# What the allowances know of a frame are their bases. A key frame keeps them, one after the other, as its `terms`.
# Displacements are over the beam's length; the priors follow the largest one so far (`course_scale`).


def course_of_frame(
    marker_s: Array, beam_length: float, tag_size: float, *, thick: bool, traced: BoolArray | None = None
) -> PushCourse:
    """One frame under a force of one newton, unbent; `tag_size` m, NaN where not known; the `traced` (m,) of its
    markers are points of an outline, none where not given."""
    rest, m = np.zeros(1), len(marker_s)
    traced = np.zeros(m, dtype=bool) if traced is None else traced
    return PushCourse(
        length=beam_length,
        marker_s=marker_s,
        on_body=~traced,
        across=across_of(np.zeros(m), traced)[None],
        tags=tuple(f"tag {i}" for i in np.flatnonzero(~traced) + 1),
        tag_size=tag_size,
        thick=thick,
        friction_sd=0.0,
        time=rest,
        force=np.array([[1.0, 0.0]]),
        largest=1.0,
        push_s=rest,
        bend=rest,
        back=rest,
        elapsed=rest,
        turn=np.zeros((1, m)),
        moved=np.zeros((1, 2)),
    )


def across_of(angle: Array, traced: BoolArray) -> Array:
    """(m, 2) unit vectors across an outline at its `traced` points (m,), where it has these angles (m,); else zeros."""
    return left_of(unit(angle)) * traced[:, None]


@dataclass(frozen=True)
class FrameTerms:
    """Allowances that go with the frames, each with its basis in one frame."""

    allowances: tuple[Allowance, ...]

    @cached_property
    def names(self) -> frozenset[str]:
        return frozenset(a.name for a in self.allowances)

    @cached_property
    def ends(self) -> list[int]:
        """Where each ends among the terms."""
        return list(accumulate(a.basis.size for a in self.allowances))

    @property
    def count(self) -> int:
        return self.ends[-1] if self.ends else 0

    def with_terms(self, terms: Array) -> list[Allowance]:
        """The allowances with their bases in B frames of these `terms` (B, count)."""
        parts = np.split(terms, self.ends[:-1], axis=1) if self.ends else []
        pairs = zip(self.allowances, parts, strict=True)
        return [replace(a, basis=part.reshape(len(terms), *a.basis.shape[1:])) for a, part in pairs]


def course_scale(one: Allowance, largest: float, bend: float) -> Array:
    """(n,) factors on its `prior_sd`: `largest` N, the largest force so far; `bend` the largest displacement over the
    length."""
    force = (largest or 1.0) if one.of_force else 1.0
    return np.asarray(force / bend**one.powers) if len(one.powers) else np.ones(one.count)


class CourseSoFar:
    """The course of a push, from frames as they come."""

    def __init__(self, course: PushCourse, terms: FrameTerms) -> None:
        """`course` of one frame, and the allowances whose bases are wanted."""
        self._course, self._terms = course, terms
        self._rest = np.full(len(course.marker_s), np.nan)  # rad, of each tag
        self._turn = np.zeros(len(course.marker_s))

    def terms(self, angle: Array, visible: BoolArray, force: Array, push_s: float, *, bend: float, back: bool) -> Array:
        """(count,) of the next frame, under a force (2,) N at `push_s`.

        `angle` (m,) rad of the tags where `visible`; `bend` displacement over the length; `back`: the load falls.
        """
        unknown = visible & np.isnan(self._rest)
        self._rest[unknown] = angle[unknown]
        turn = angle - self._rest
        turn -= 2.0 * np.pi * np.round((turn - self._turn) / (2.0 * np.pi))
        self._turn = np.where(visible, turn, self._turn)
        course = replace(
            self._course,
            across=across_of(angle, ~self._course.on_body)[None],
            force=force[None],
            push_s=np.array([push_s]),
            bend=np.array([bend]),
            back=np.array([float(back)]),
            turn=self._turn[None],
        )
        found = allowances_of(course, self._terms.names)
        return np.concatenate([np.zeros(0), *(a.basis.ravel() for a in found)])

    def rest(self, angle: Array, visible: BoolArray) -> Array:
        """(count,) of the next frame, at rest."""
        self._rest[visible], self._turn = angle[visible], np.zeros_like(self._turn)
        if self._course.on_body.all():
            return np.zeros(self._terms.count)
        return self.terms(angle, visible, np.zeros(2), 1.0, bend=0.0, back=False)


_FINE = 0.005  # of the largest displacement: smaller differences are not kept
_MOST_POINTS = 1000  # of the course of the load
_USUAL = 0.1  # of the length: the largest displacement that is expected before the data


class LoadStages:
    """The load's own time, from frames as they come, of bounded size: `load_changes` of the course so far.

    A reversal is noticed late and then counts for the frames before, too.
    """

    def __init__(self, length: float, tags: int) -> None:
        self.largest = _USUAL * length  # m, displacement so far
        self.displacement = 0.0  # m, of the last frame
        self._here = np.full((tags, 2), np.nan)  # m, where tags were seen last
        self._rest = np.full((tags, 2), np.nan)
        self._course = np.zeros((0, 3))  # s, m, loaded
        self._changes: list[LoadChange] = []

    def add_frame(self, time: float, xy: Array, visible: BoolArray, loaded: bool) -> None:
        """The next frame: tags at `xy` (m, 2) m where `visible`."""
        self._here[visible] = xy[visible]
        rest = np.isnan(self._rest) if loaded else visible[:, None] & np.ones((1, 2), dtype=bool)
        self._rest[rest] = self._here[rest]
        away = (self._here - self._rest).ravel()
        away = away[np.isfinite(away)]
        self.displacement = size = float(np.sqrt(2.0 * (away @ away) / max(len(away), 1))) if loaded else 0.0
        self.largest = max(self.largest, size)
        course = np.vstack([self._course, (time, size, loaded)])
        self._changes = load_changes(course[:, 0], course[:, 1], course[:, 2] > 0.0, self.largest)
        if len(course) == 1 or loaded != course[-2, 2] or abs(size - course[-2, 1]) > _FINE * self.largest:
            self._course = course[-_MOST_POINTS:]

    @property
    def falling(self) -> bool:
        """The load has reversed since it began, and not again."""
        since = len(self._changes) - max((i + 1 for i, one in enumerate(self._changes) if one.release), default=0)
        return since > 0 and since % 2 == 0

    def own(self, time: Array) -> Array:
        """(N,) own time at `time` (N,) [s]."""
        return own_time(self._changes, time)


_SAME_PLACE = 0.01  # of s: pushes closer than this may be averaged
_SAME_GRAVITY = 0.5  # m/s^2
_SAME_FORCE = 0.15  # of the largest force
_SAME_STAGE = 0.5  # of the load's own time
AT_REST = 0.05  # of the force's white noise: sd of the log around its error, where nothing pushes
_EYE = np.eye(3)
_REST_SHARE = 0.1  # of its cost counts at rest: such frames say less and are averaged earlier


class _View:
    """Some of the last axis of one of the arrays of `KeyFrames`, to read and to write into."""

    def __init__(self, array: str, which: int | slice) -> None:
        self._array, self._which = array, which

    def __get__(self, keys: KeyFrames, _: type | None = None) -> Array:
        out: Array = getattr(keys, self._array)[..., self._which]
        return out


@dataclass
class KeyFrames:
    """Room for K frames; the first `used` are taken, in order of time. In few arrays, to move a frame quickly."""

    used: int
    begun: bool  # the first one is that in which the push begins
    traced: BoolArray  # (m,) which of the markers are points of an outline, and no tags
    numbers: Array  # (K, 13 + terms)
    flags: BoolArray  # (K, 3): `rest`, `stale`, `lost`
    measured: Array  # (K, m, 3)
    information: Array  # (K, m, 3, 3) of `measured`; zero where a tag was not seen
    root: Array  # (K, m, 3, 3) R with R' R = information
    weight: Array  # (K, m) robust
    residual: Array  # (K, m, 3) measured less predicted, where it was linearised
    linear: Array  # (K, m, 3, n + 3)
    rows: Array  # (K, 3 m, n + 3): the same, whitened
    shape: Array  # (K, Q, 1 + r)

    begin = _View("numbers", 0)  # (K,) s
    end = _View("numbers", 1)  # (K,) s
    frames = _View("numbers", 2)  # (K,) how many were averaged
    push_s = _View("numbers", 3)  # (K,)
    grid = _View("numbers", 4)  # (K,) place of the push whose grid `q` is on; 0: there is none yet
    force = _View("numbers", slice(5, 7))  # (K, 2) N, as logged
    rate = _View("numbers", slice(7, 9))  # (K, 2) N/s
    gravity = _View("numbers", slice(9, 11))  # (K, 2) m/s^2
    error = _View("numbers", slice(11, 13))  # (K, 2) N, the force's, at which it was linearised
    terms = _View("numbers", slice(13, None))  # (K, terms) of the allowances
    j = _View("linear", slice(None, -3))  # (K, m, 3, n) derivatives with the parameters
    a = _View("linear", slice(-3, -1))  # (K, m, 3, 2) derivatives with the force
    zeta = _View("linear", -1)  # (K, m, 3)
    rows_j = _View("rows", slice(None, -3))  # (K, 3 m, n) whitened
    rows_a = _View("rows", slice(-3, -1))  # (K, 3 m, 2) whitened
    rows_z = _View("rows", -1)  # (K, 3 m) whitened
    q = _View("shape", 0)  # (K, Q) rad, the shape to start from
    lags = _View("shape", slice(1, None))  # (K, Q, r) rad, curvatures that lag behind that of a beam that relaxes

    @property
    def rest(self) -> BoolArray:
        """(K,) nothing pushes."""
        return self.flags[:, 0]

    @property
    def stale(self) -> BoolArray:
        """(K,) linearised at an earlier linearisation point; to be renewed."""
        return self.flags[:, 1]

    @property
    def lost(self) -> BoolArray:
        """(K,) has no equilibrium at the linearisation point; keeps its earlier linearisation."""
        return self.flags[:, 2]

    @property
    def centre(self) -> Array:
        """(used,) s, in the middle of each frame's stretch of time."""
        return 0.5 * (self.begin[: self.used] + self.end[: self.used])

    def spans(self, own: Array) -> TimeSpans:
        """Stretches of time of the frames in use; `own` (used,): the load's own time there."""
        begin, end, frames = (values[: self.used].copy() for values in (self.begin, self.end, self.frames))
        return TimeSpans(begin, end, frames, np.zeros(self.used), own)

    def arrays(self) -> list[Array | BoolArray]:
        """All that is kept of every frame."""
        shapes = [self.residual, self.linear, self.rows, self.shape]
        return [self.numbers, self.flags, self.measured, self.information, self.root, self.weight, *shapes]

    def drop(self, i: int) -> None:
        """Take frame i out."""
        for values in self.arrays():
            values[i : self.used - 1] = values[i + 1 : self.used]
        self.used, self.begun = self.used - 1, self.begun and i > 0

    def set_linear(self, i: IntArray, x: Array, pose: Array, j: Array, a: Array) -> None:
        """Linearise B frames at parameters x and their force errors.

        `pose` (B, m, 3) and its derivatives: `j` (B, m, 3, n) with x, `a` (B, m, 3, 2) with the force.
        """
        measured, error, linear = self.measured[i], self.error[i], np.empty((len(i), *self.linear.shape[1:]))
        measured[..., 2] -= 2.0 * np.pi * np.round((measured[..., 2] - pose[..., 2]) / (2.0 * np.pi))
        residual = measured - pose
        linear[..., :-3] = j
        linear[..., -3:-1] = a * ~self.rest[i][:, None, None, None]
        linear[..., -1] = residual + j @ x - (linear[..., -3:-1] @ error[:, None, :, None])[..., 0]
        self.measured[i], self.residual[i], self.linear[i], self.flags[i, 1:] = measured, residual, linear, False
        self.rows[i] = (self.root[i] @ linear).reshape(len(i), -1, linear.shape[-1])

    def whiten(self, i: int) -> None:
        """Renew the whitened rows of frame i."""
        self.rows[i] = (self.root[i] @ self.linear[i]).reshape(self.rows.shape[1:])


def empty(most: int, traced: BoolArray, parameters: int, nodes: int, terms: int) -> KeyFrames:
    """Room for `most` key frames, two new ones, and two averages in the making."""
    count, tags = most + 4, len(traced)

    def room(*shape: int) -> Array:
        return np.zeros((count, *shape))

    return KeyFrames(
        used=0,
        begun=True,
        traced=traced,
        numbers=room(13 + terms),
        flags=np.zeros((count, 3), dtype=bool),
        measured=room(tags, 3),
        information=room(tags, 3, 3),
        root=room(tags, 3, 3),
        weight=room(tags),
        residual=room(tags, 3),
        linear=room(tags, 3, parameters + 3),
        rows=room(3 * tags, parameters + 3),
        shape=room(nodes, 1 + len(TIMES)),
    )


def _roots(information: Array) -> Array:
    """R (m, 3, 3) with R' R = information; zero where that is zero."""
    visible = information[:, 0, 0] > 0.0
    safe = np.where(visible[:, None, None], information, _EYE)
    return np.asarray(np.swapaxes(np.linalg.cholesky(safe), 1, 2) * visible[:, None, None])


def closest_pairs(keys: KeyFrames, count: int, largest: float, own: Array, most: int) -> list[int]:
    """At most `most` pairs (i, i + 1) of the first `count` frames to average: those alike whose averaging loses least
    (Ward's sum of squares). No frame is in two pairs. `largest`: N, largest force; `own` (used,): the load's own time.
    """
    if count < 2 or most < 1:
        return []
    part, rear = slice(0, count - 1), slice(1, count)
    away = keys.force[rear] - keys.force[part]
    rest, n = keys.rest[part], keys.frames
    force = np.where(rest, 0.0, np.sqrt(np.sum(away * away, axis=1)) / max(largest, 1e-300))
    centre = 0.5 * (keys.begin + keys.end)
    time = (centre[rear] - centre[part]) / max(keys.end[count - 1] - keys.begin[0], 1e-300)
    alike = (rest == keys.rest[rear]) & (force <= _SAME_FORCE)
    alike &= ~(keys.lost[part] | keys.lost[rear])
    alike &= np.abs(own[1:count] - own[: count - 1]) <= _SAME_STAGE
    alike &= (np.abs(keys.push_s[rear] - keys.push_s[part]) <= _SAME_PLACE) | rest
    alike &= np.abs(keys.gravity[rear] - keys.gravity[part]).max(axis=1) <= _SAME_GRAVITY
    cost = n[part] * n[rear] / (n[part] + n[rear]) * (force**2 + time**2) * np.where(rest, _REST_SHARE, 1.0)
    cost = np.where(alike, cost, np.inf)
    out: list[int] = []
    while len(out) < most:
        i = int(np.argmin(cost))
        if cost[i] == np.inf:
            break
        out.append(i)
        cost[max(i - 1, 0) : i + 2] = np.inf
    return out


def propose_average(keys: KeyFrames, i: int, slot: int) -> None:
    """Write the average of frames i and i + 1, its tags aside, to the free `slot`; it is linearised there next."""
    k = i + 1
    first, second = keys.numbers[i], keys.numbers[k]
    share = keys.frames[k] / (keys.frames[i] + keys.frames[k])
    keys.numbers[slot] = (1.0 - share) * first + share * second
    keys.shape[slot] = (1.0 - share) * keys.shape[i] + share * keys.shape[k]
    keys.begin[slot], keys.end[slot], keys.frames[slot] = first[0], second[1], first[2] + second[2]
    keys.rest[slot], keys.lost[slot] = keys.rest[i], False
    keys.grid[slot] = keys.grid[i]
    if keys.grid[k] != keys.grid[i]:
        keys.shape[slot] = keys.shape[i]
    keys.measured[slot], keys.root[slot] = 0.0, 0.0


def accept_average(keys: KeyFrames, i: int, slot: int, x: Array) -> None:
    """The average in `slot` replaces frames i and i + 1. All three have just been linearised at parameters x."""
    k = i + 1
    share = keys.frames[k] / keys.frames[slot]
    # At rest the error of reading a tag is the same in all frames: their average counts as one frame.
    counts = (1.0 - share, share) if keys.rest[i] else (1.0, 1.0)
    informations = [
        w * keys.weight[f][:, None, None] * keys.information[f] for f, w in zip((i, k), counts, strict=True)
    ]
    total = informations[0] + informations[1]
    visible = total[:, 0, 0] > 0.0
    both = informations[0] @ keys.residual[i][..., None] + informations[1] @ keys.residual[k][..., None]
    residual = np.linalg.solve(np.where(visible[:, None, None], total, _EYE), both)[..., 0] * visible[:, None]
    keys.information[slot], keys.root[slot], keys.weight[slot] = total, _roots(total), visible
    keys.measured[slot] += residual - keys.residual[slot]
    keys.residual[slot] = residual
    linear = keys.linear[slot]
    linear[..., -1] = residual + linear[..., :-3] @ x - linear[..., -3:-1] @ keys.error[slot]
    keys.whiten(slot)
    for values in keys.arrays():
        values[i] = values[slot]
    keys.drop(k)


# A frame as it comes.


@dataclass(frozen=True)
class CheckedFrame:
    """m tags, or points of an outline, and a force at one time."""

    time: float  # s
    measured: Array  # (m, 3) m, m, rad; 0 where not seen
    covariance: Array  # (m, 3, 3); the unit matrix where not seen
    root: Array  # (m, 3, 3) R with R' R its inverse; zero where not seen
    visible: BoolArray  # (m,)
    force: Array  # (2,) N, as logged
    push_s: float
    loaded: bool
    gravity: Array  # (2,) m/s^2


def checked_frame(
    traced: BoolArray,
    time: float,
    xy: ArrayLike,
    angle: ArrayLike,
    covariance: ArrayLike,
    force: ArrayLike,
    push_s: float,
    loaded: bool,
    gravity: ArrayLike,
) -> CheckedFrame:
    """A frame of m markers. The `traced` (m,) are points of an outline with its direction for an angle: only what is
    across it counts. Raises `LearningError` where something does not fit or is not finite."""
    tags = len(traced)
    position = _array(xy, (tags, 2), "xy", time)
    turn = _array(angle, (tags,), "angle", time)
    spread = _array(covariance, (tags, 3, 3), "covariance", time)
    pushed, pulled = _array(force, (2,), "force", time), _array(gravity, (2,), "gravity", time)
    if not np.isfinite(time):
        raise LearningError(f"a frame's time must be a finite number, got {time}")
    if not (np.all(np.isfinite(pushed)) and np.all(np.isfinite(pulled))):
        raise LearningError(
            f"frame at {time:g} s: force and gravity must be finite, got {pushed.tolist()} N and {pulled.tolist()} "
            "m/s^2. Leave out frames whose force is not known"
        )
    if loaded and not 0.0 < push_s <= 1.0:
        raise LearningError(f"frame at {time:g} s: the force acts at s in (0, 1], got {push_s}")
    measured = np.concatenate([position, turn[:, None]], axis=1)
    if np.any(np.isinf(measured)):
        raise LearningError(f"frame at {time:g} s: a tag at infinity; give NaN where a tag is not seen")
    visible = np.asarray(np.all(np.isfinite(measured), axis=1) & np.all(np.isfinite(spread), axis=(1, 2)))
    spread = np.where(visible[:, None, None], spread, _EYE)
    if traced.any():
        across = np.pad(across_of(np.where(visible, turn, 0.0), traced)[traced], ((0, 0), (0, 1)))
        only = across[:, :, None] * across[:, None]  # projects on it
        spread[traced] = _EYE - only + only @ spread[traced] @ only  # 1 m^2, rad^2 of what is not measured
    try:
        lower = np.linalg.cholesky(spread)
    except np.linalg.LinAlgError as error:
        raise LearningError(
            f"frame at {time:g} s: the covariance of a tag is not positive definite; give one sd squared of x, y [m^2] "
            "and angle [rad^2] on its diagonal"
        ) from error
    where = push_s if loaded else 1.0
    root = np.linalg.inv(lower) * visible[:, None, None]
    return CheckedFrame(
        time, np.where(visible[:, None], measured, 0.0), spread, root, visible, pushed, where, loaded, pulled
    )


def _array(values: ArrayLike, shape: tuple[int, ...], name: str, time: float) -> Array:
    out = np.asarray(values, dtype=float)
    if out.shape != shape:
        raise LearningError(f"frame at {time:g} s: {name} must have shape {shape}, got {out.shape}")
    return out


def write_frame(keys: KeyFrames, frame: CheckedFrame, rate: Array, terms: Array) -> int:
    """Write the frame behind the key frames in use; returns its index. `rate` (2,) N/s of its force, `terms` (TERMS,)
    of its allowances."""
    i = keys.used
    keys.begin[i] = keys.end[i] = frame.time
    keys.frames[i], keys.rest[i], keys.push_s[i] = 1.0, not frame.loaded, frame.push_s
    keys.force[i], keys.rate[i], keys.gravity[i], keys.terms[i] = frame.force, rate, frame.gravity, terms
    keys.measured[i], keys.weight[i] = frame.measured, frame.visible
    keys.root[i], keys.information[i] = frame.root, frame.root.swapaxes(1, 2) @ frame.root
    keys.used += 1
    return i


_FARTHEST = 2.0  # changes of the force like the last one, over which a shape is extrapolated


def expect_shape(keys: KeyFrames, i: int, error: Array) -> None:
    """First guess of the shape of frame i, the last one, under the force error (2,) [N] that is expected: it goes on as
    it changed last, as the force does."""
    keys.error[i], keys.stale[i], keys.lost[i] = error, False, False
    keys.shape[i], keys.grid[i] = (keys.shape[i - 1], keys.grid[i - 1]) if i else (0.0, 0.0)
    if i > 1 and keys.grid[i - 2] == keys.grid[i - 1]:
        near = slice(i - 2, i + 1)
        before, now = np.diff((keys.force[near] - keys.error[near]) * ~keys.rest[near, None], axis=0)
        share = np.clip(now @ before / max(float(before @ before), 1e-300), -_FARTHEST, _FARTHEST)
        keys.q[i] += share * (keys.q[i - 1] - keys.q[i - 2])
