"""Key frames: a bounded set of frames that stands for all frames so far.

A key frame is linear in the parameters x and in its own force error e: `zeta = J x - A e + noise`. It keeps its
measurement, so that it can be linearised anew. Two neighbours in time under nearly the same force are averaged: the
mean of their residuals, added to the prediction under their mean force, counts as a measurement under that force.
Where no two are alike, the oldest is marginalised (`marginalised.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.learning.allowances.causal import TERMS
from onebend.learning.allowances.relaxation import TIMES
from onebend.learning.live.force_process import TimeSpans
from onebend.records import Array, BoolArray, IntArray

_SAME_PLACE = 0.01  # of s: pushes closer than this may be averaged
_SAME_GRAVITY = 0.5  # m/s^2
_SAME_FORCE = 0.15  # of the largest force
_SAME_STAGE = 0.5  # of the load's own time
AT_REST = 0.05  # of the force's white noise: sd of the log around its error, where nothing pushes
_EYE = np.eye(3)
_REST_SHARE = 0.1  # of its cost counts at rest: such frames say less and are averaged earlier


@dataclass
class KeyFrames:
    """Room for K frames; the first `used` are taken, in order of time. In few arrays, to move a frame quickly."""

    used: int
    numbers: Array  # (K, 14 + TERMS): `begin`, `end`, `own`, `frames`, `push_s`, `grid`, `force`, `rate`, ... in turn
    flags: BoolArray  # (K, 3): `rest`, `stale`, `lost`
    measured: Array  # (K, m, 3)
    information: Array  # (K, m, 3, 3) of `measured`; zero where a tag was not seen
    root: Array  # (K, m, 3, 3) R with R' R = information
    weight: Array  # (K, m) robust
    residual: Array  # (K, m, 3) measured less predicted, where it was linearised
    linear: Array  # (K, m, 3, n + 3): `j`, `a`, `zeta`
    rows: Array  # (K, 3 m, n + 3): the same, whitened
    shape: Array  # (K, Q, 3 + r): `q`, `by_force`, `lags`

    @property
    def begin(self) -> Array:
        """(K,) s."""
        return self.numbers[:, 0]

    @property
    def end(self) -> Array:
        """(K,) s."""
        return self.numbers[:, 1]

    @property
    def own(self) -> Array:
        """(K,) the load's own time there, but for its last changes."""
        return self.numbers[:, 2]

    @property
    def frames(self) -> Array:
        """(K,) how many were averaged."""
        return self.numbers[:, 3]

    @property
    def push_s(self) -> Array:
        """(K,)."""
        return self.numbers[:, 4]

    @property
    def grid(self) -> Array:
        """(K,) place of the push whose grid `q` is on; 0: there is none yet."""
        return self.numbers[:, 5]

    @property
    def force(self) -> Array:
        """(K, 2) N, as logged."""
        return self.numbers[:, 6:8]

    @property
    def rate(self) -> Array:
        """(K, 2) N/s."""
        return self.numbers[:, 8:10]

    @property
    def gravity(self) -> Array:
        """(K, 2) m/s^2."""
        return self.numbers[:, 10:12]

    @property
    def error(self) -> Array:
        """(K, 2) N, the force's, at which it was linearised."""
        return self.numbers[:, 12:14]

    @property
    def terms(self) -> Array:
        """(K, TERMS) of the allowances, see `CourseSoFar.terms`."""
        return self.numbers[:, 14:]

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
    def j(self) -> Array:
        """(K, m, 3, n) derivatives with the parameters."""
        return self.linear[..., :-3]

    @property
    def a(self) -> Array:
        """(K, m, 3, 2) derivatives with the force."""
        return self.linear[..., -3:-1]

    @property
    def zeta(self) -> Array:
        """(K, m, 3)."""
        return self.linear[..., -1]

    @property
    def rows_j(self) -> Array:
        """(K, 3 m, n) whitened."""
        return self.rows[..., :-3]

    @property
    def rows_a(self) -> Array:
        """(K, 3 m, 2) whitened."""
        return self.rows[..., -3:-1]

    @property
    def rows_z(self) -> Array:
        """(K, 3 m) whitened."""
        return self.rows[..., -1]

    @property
    def q(self) -> Array:
        """(K, Q) rad, the shape to start from."""
        return self.shape[..., 0]

    @property
    def by_force(self) -> Array:
        """(K, Q, 2) of it with the logged force."""
        return self.shape[..., 1:3]

    @property
    def lags(self) -> Array:
        """(K, Q, r) rad, curvatures that lag behind that of a beam that relaxes."""
        return self.shape[..., 3:]

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
