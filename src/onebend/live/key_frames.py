"""Key frames: a bounded set of frames that stands for all frames so far.

A key frame is linear in the parameters x and in its own force error e: `zeta = J x - A e + noise`. It keeps its
measurement, so that it can be linearised anew. Neighbours in time under nearly the same force are averaged; where no
two are alike, the oldest is marginalised (`posterior.py`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from onebend.learning import allowances
from onebend.learning.allowances import ANGLE, DEGREE, OF_ONE, TIMES, XY, Allowance, AllowanceName, PushCourse, length
from onebend.recording.force_noise import BEFORE, CLEAR, EARLY, TURN, LoadChange, TimeSpans, own_time
from onebend.records import Array, BoolArray, IntArray

# Allowances of a learner that sees frame after frame: those that need no later frame and no place of the camera.
# Displacements are over the beam's length; the priors follow the largest one so far (`course_scale`).

# Of the others, inertia needs frames to come, gravity's direction the weight, and three need the camera's place.
CAUSAL_ALLOWANCES: frozenset[AllowanceName] = OF_ONE - {
    "outline",
    "inertia",
    "gravity direction",
    "heights",
    "camera",
    "rolling shutter",
}
_LINEAR = (0, 2)  # those of the discrepancy's functions that are linear in the displacement, on both ways
# For time's sake these stand for all five. Their sd is such that at the largest displacement they are worth as much.
_WORTH = float(np.sqrt((1.0 + 1.0 + 0.25 + 0.25 + 1.0) / (1.0 + 0.25)))
TERMS = 2 + DEGREE + len(_LINEAR)  # numbers of a frame, see `CourseSoFar.terms`
SLIDE, CLAMP = slice(0, 1), slice(1, 2)
POSTURE, SMOOTH = slice(2, 2 + DEGREE), slice(2 + DEGREE, TERMS)
OF_COURSE: tuple[AllowanceName, ...] = ("posture", "discrepancy", "angle discrepancy")  # their sds follow the push


def causal_allowances(marker_s: Array, beam_length: float, tag_size: float, *, thick: bool) -> tuple[Allowance, ...]:
    """All of them, without frames; `tag_size` m, NaN where not known; `thick`: the section's thickness is known."""
    tags = tuple(f"tag {i}" for i in range(1, len(marker_s) + 1))
    no_functions = np.zeros((0, len(_LINEAR)))
    empty = np.zeros(0)
    none = PushCourse(empty, empty, empty, empty, np.zeros((0, len(marker_s))), 0.0)
    return (
        allowances.section(known=thick),
        allowances.relaxation(none),
        allowances.sliding(marker_s, none, np.zeros(0)),
        allowances.giving(none, 0),
        allowances.posture_bias(none, np.array([[1.0, 0.0]])),  # per N of the largest force
        allowances.patches(marker_s, beam_length, tag_size, None),
        length(),
        *(
            replace(one, prior_sd=_WORTH * one.prior_sd)
            for one in allowances.discrepancy_of(no_functions, tags, beam_length)
        ),
    )


def course_scale(name: str, parameters: int, largest: float, bend: float) -> Array:
    """(n,) factors on an allowance's `prior_sd`: `largest` N, the largest force so far; `bend` the largest displacement
    over the length."""
    if name == "posture":
        return np.asarray((largest or 1.0) / np.tile(bend ** np.arange(1.0, DEGREE + 1.0), parameters // DEGREE))
    return np.full(parameters, 1.0 / bend if name in OF_COURSE else 1.0)


class CourseSoFar:
    """The course of a push, from frames as they come."""

    def __init__(self, marker_s: Array) -> None:
        self._marker_s = marker_s
        self._rest = np.full(len(marker_s), np.nan)  # rad, of each tag
        self._turn = np.zeros(len(marker_s))

    def terms(self, angle: Array, visible: BoolArray, bend: float, push_s: float, *, back: bool, loaded: bool) -> Array:
        """(TERMS,) of the next frame, zero at rest: the turn of the beam at the push, that of the first tag, the powers
        of the displacement, the discrepancy's functions.

        `angle` (m,) rad of the tags where `visible`; `bend` displacement over the length; `back`: the load falls.
        """
        unknown = visible & (np.isnan(self._rest) | (not loaded))
        self._rest[unknown] = angle[unknown]
        if not loaded:
            self._turn = np.zeros_like(self._turn)
            return np.zeros(TERMS)
        turn = angle - self._rest
        turn -= 2.0 * np.pi * np.round((turn - self._turn) / (2.0 * np.pi))
        self._turn = np.where(visible, turn, self._turn)
        out = np.empty(TERMS)
        once = np.zeros(1)
        run = PushCourse(once, np.array([bend]), np.array([float(back)]), once, self._turn[None], 0.0)
        out[SLIDE] = allowances.turn_at_push(self._marker_s, run.turn, np.array([push_s]))
        out[CLAMP], out[POSTURE], out[SMOOTH] = (
            self._turn[0],
            allowances.powers(run.bend),
            allowances.smooth_functions(run)[:, _LINEAR],
        )
        return out


class CourseBases:
    """The allowances that go with the course of the push, at the `terms` (B, TERMS) of B frames; `carried` by name."""

    def __init__(self, terms: Array, tags: int, carried: Collection[str]) -> None:
        self._terms, self._carried = terms, carried
        self.force = allowances.on_each_axis(terms[:, POSTURE])  # (B, 2, 4) N per unit: the posture-dependent bias
        axes = {"discrepancy": XY, "angle discrepancy": ANGLE}
        self.poses = {
            name: allowances.of_axes(terms[:, SMOOTH], tags, of) for name, of in axes.items() if name in carried
        }

    def blocks(self, of: Mapping[str, Array]) -> dict[str, Array]:
        """(B, m, 3, n) by name, of the tags' poses, from those with the "push", its "place" and the "clamp"."""
        slide, clamp = (self._terms[:, None, None, part] for part in (SLIDE, CLAMP))
        out = {"slide": of["place"] * slide, "clamp gives": of["clamp"] * clamp} | self.poses
        if "posture" in self._carried:
            out["posture"] = of["push"] @ self.force[:, None]
        return out

    def moved(self, values: Mapping[str, Array]) -> Array | float:
        """(B, m, 3) by which the tags seem to be off at these parameters."""
        return sum((basis @ values[name] for name, basis in self.poses.items()), start=0.0)


_FINE = 0.005  # of the largest displacement: smaller differences are not kept
_PATH_LENGTH = 256  # displacements of one stage
_CHANGES = 6  # the last ones, whose spans may still change
_USUAL = 0.1  # of the length: the largest displacement that is expected before the data


class LoadStages:
    """The load's own time, from frames as they come, of bounded size; see `load_changes` for a whole recording.

    A load begins, reverses where the beam comes back by a share of the largest displacement so far, and ends. A
    reversal is noticed late and then counts for the frames before, too.
    """

    def __init__(self, length: float, tags: int) -> None:
        self.largest = _USUAL * length  # m, displacement so far
        self.displacement = 0.0  # m, of the last frame
        self._here = np.full((tags, 2), np.nan)  # m, where tags were seen last
        self._rest = np.full((tags, 2), np.nan)
        self._loaded = False
        self._rising, self._extreme, self._peak = True, 0.0, 0.0  # m, and when
        self._path: deque[tuple[float, float]] = deque(maxlen=_PATH_LENGTH)  # s, m
        self._changes: deque[LoadChange] = deque()
        self._past: deque[LoadChange] = deque()
        self._open: float | None = None  # m, displacement where the present change began; None: it is over

    def add_frame(self, time: float, xy: Array, visible: BoolArray, loaded: bool) -> None:
        """The next frame: tags at `xy` (m, 2) m where `visible`."""
        self._here[visible] = xy[visible]
        if not loaded:
            self._rest[visible] = xy[visible]
            if self._loaded:
                self._release()
            self._loaded, self.displacement = False, 0.0
            return
        unknown = np.isnan(self._rest)
        self._rest[unknown] = self._here[unknown]
        away = (self._here - self._rest).ravel()
        away = away[np.isfinite(away)]
        self.displacement = size = float(np.sqrt(2.0 * (away @ away) / max(len(away), 1)))
        self.largest = max(self.largest, size)
        if not self._loaded:
            self._loaded = self._rising = True
            self._extreme, self._peak, self._open = size, time, 0.0
            self._path.clear()
            self._add(LoadChange(time - EARLY, time, release=False))
        elif self._open is not None:
            self._go_on(time, abs(size - self._open) > CLEAR * self.largest)
        if not self._path or abs(size - self._path[-1][1]) > _FINE * self.largest:
            self._path.append((time, size))
        if size >= self._extreme if self._rising else size <= self._extreme:
            self._extreme, self._peak = size, time
        elif abs(size - self._extreme) > TURN * self.largest:
            self._turn(time, size)

    @property
    def falling(self) -> bool:
        """The load has reversed since it began, and not again."""
        return not self._rising

    def _go_on(self, time: float, over: bool) -> None:
        self._changes[-1] = replace(self._changes[-1], end=time)
        self._open = None if over else self._open

    def _turn(self, time: float, size: float) -> None:
        """The load has reversed; the change began where the beam was last clear of the turning point."""
        before = [t for t, d in self._path if t < self._peak and abs(d - self._extreme) > BEFORE * self.largest]
        low = before[-1] if before else (self._path[0][0] if self._path else self._peak)
        self._add(LoadChange(min(low, self._peak), time, release=False))
        self._open = self._extreme
        self._rising, self._extreme, self._peak = not self._rising, size, time
        self._path = deque([point for point in self._path if point[0] >= low], maxlen=_PATH_LENGTH)

    def _release(self) -> None:
        clear = [t for t, d in self._path if d > CLEAR * self.largest]
        end = self._path[-1][0]
        self._add(LoadChange(clear[-1] if clear else end, end + EARLY, release=True))
        self._open = None

    def _add(self, change: LoadChange) -> None:
        if len(self._changes) == _CHANGES:
            self._past.append(self._changes.popleft())
        self._changes.append(change)

    def own(self, time: Array) -> Array:
        """(N,) own time at `time` (N,) [s] from the changes that may still change."""
        return own_time(self._changes, time)

    def forgotten(self, time: Array) -> tuple[Array, float]:
        """(N,) own time at `time` (N,) [s] from the changes settled since the last call, and of later frames."""
        out = own_time(self._past, time), float(sum(change.amount for change in self._past))
        self._past.clear()
        return out


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
    numbers: Array  # (K, 14 + TERMS)
    flags: BoolArray  # (K, 3): `rest`, `stale`, `lost`
    measured: Array  # (K, m, 3)
    information: Array  # (K, m, 3, 3) of `measured`; zero where a tag was not seen
    root: Array  # (K, m, 3, 3) R with R' R = information
    weight: Array  # (K, m) robust
    residual: Array  # (K, m, 3) measured less predicted, where it was linearised
    linear: Array  # (K, m, 3, n + 3)
    rows: Array  # (K, 3 m, n + 3): the same, whitened
    shape: Array  # (K, Q, 3 + r)

    begin = _View("numbers", 0)  # (K,) s
    end = _View("numbers", 1)  # (K,) s
    own = _View("numbers", 2)  # (K,) the load's own time there, but for its last changes
    frames = _View("numbers", 3)  # (K,) how many were averaged
    push_s = _View("numbers", 4)  # (K,)
    grid = _View("numbers", 5)  # (K,) place of the push whose grid `q` is on; 0: there is none yet
    force = _View("numbers", slice(6, 8))  # (K, 2) N, as logged
    rate = _View("numbers", slice(8, 10))  # (K, 2) N/s
    gravity = _View("numbers", slice(10, 12))  # (K, 2) m/s^2
    error = _View("numbers", slice(12, 14))  # (K, 2) N, the force's, at which it was linearised
    terms = _View("numbers", slice(14, None))  # (K, TERMS) of the allowances, see `CourseSoFar.terms`
    j = _View("linear", slice(None, -3))  # (K, m, 3, n) derivatives with the parameters
    a = _View("linear", slice(-3, -1))  # (K, m, 3, 2) derivatives with the force
    zeta = _View("linear", -1)  # (K, m, 3)
    rows_j = _View("rows", slice(None, -3))  # (K, 3 m, n) whitened
    rows_a = _View("rows", slice(-3, -1))  # (K, 3 m, 2) whitened
    rows_z = _View("rows", -1)  # (K, 3 m) whitened
    q = _View("shape", 0)  # (K, Q) rad, the shape to start from
    by_force = _View("shape", slice(1, 3))  # (K, Q, 2) of it with the logged force
    lags = _View("shape", slice(3, None))  # (K, Q, r) rad, curvatures that lag behind that of a beam that relaxes

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

    def spans(self, more: Array) -> TimeSpans:
        """Stretches of time of the frames in use; `more` (used,) is added to the load's own time."""
        begin, end, frames = (values[: self.used].copy() for values in (self.begin, self.end, self.frames))
        return TimeSpans(begin, end, frames, np.zeros(self.used), self.own[: self.used] + more)

    def arrays(self) -> list[Array | BoolArray]:
        """All that is kept of every frame."""
        shapes = [self.residual, self.linear, self.rows, self.shape]
        return [self.numbers, self.flags, self.measured, self.information, self.root, self.weight, *shapes]

    def drop(self, i: int) -> None:
        """Take frame i out."""
        for values in self.arrays():
            values[i : self.used - 1] = values[i + 1 : self.used]
        self.used -= 1

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


def empty(most: int, tags: int, parameters: int, nodes: int) -> KeyFrames:
    """Room for `most` key frames, two new ones, and two averages in the making."""
    count = most + 4

    def room(*shape: int) -> Array:
        return np.zeros((count, *shape))

    return KeyFrames(
        used=0,
        numbers=room(14 + TERMS),
        flags=np.zeros((count, 3), dtype=bool),
        measured=room(tags, 3),
        information=room(tags, 3, 3),
        root=room(tags, 3, 3),
        weight=room(tags),
        residual=room(tags, 3),
        linear=room(tags, 3, parameters + 3),
        rows=room(3 * tags, parameters + 3),
        shape=room(nodes, 3 + len(TIMES)),
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
    keys.begin[slot], keys.end[slot], keys.frames[slot] = first[0], second[1], first[3] + second[3]
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
