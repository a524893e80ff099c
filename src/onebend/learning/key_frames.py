"""A bounded set of frames that stand for all that was seen: averaged where alike, folded away where old.

A key frame is linear in the parameters x and in its own force error e: `zeta = J x - A e + noise`. It keeps what it was
measured at, so it can be linearised anew. Two neighbours in time under nearly the same force are averaged: what the
present estimate leaves of both, put on its prediction under the mean force, is as if measured there. Where none can be
averaged the oldest is folded away (`live_past.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from onebend.learning.force_process import Spans
from onebend.records import Array, BoolArray, IntArray

_SAME_PLACE = 0.01  # of s: pushes closer than this may be averaged
_SAME_GRAVITY = 0.5  # m/s^2
_SAME_FORCE = 0.15  # of the largest force
_SAME_STAGE = 0.5  # of the load's own time
AT_REST = 0.05  # of the force's white noise: where nothing pushes, the log IS the error
_REST_SHARE = 0.1  # a frame at rest says less: it is averaged earlier


@dataclass
class KeyFrames:
    """K places, `used` of them taken, in order of time."""

    used: int
    begin: Array  # (K,) s
    end: Array
    own: Array  # the load's own time there, but for its last changes
    frames: Array  # how many were averaged
    rest: BoolArray  # nothing pushes
    push_s: Array
    force: Array  # (K, 2) N, as logged
    rate: Array  # (K, 2) N/s
    gravity: Array  # (K, 2)
    measured: Array  # (K, m, 3)
    information: Array  # (K, m, 3, 3) of `measured`; zero where a tag was not seen
    root: Array  # (K, m, 3, 3) R with R' R = information
    weight: Array  # (K, m) robust
    error: Array  # (K, 2) N, the force's, at which it was linearised
    left: Array  # (K, m, 3) measured less predicted, where it was linearised
    zeta: Array  # (K, m, 3)
    j: Array  # (K, m, 3, n)
    a: Array  # (K, m, 3, 2)
    q: Array  # (K, Q) rad, the shape to start from
    grid: Array  # (K,) place of the push whose grid that is on; 0: there is none yet
    by_force: Array  # (K, Q, 2) of it with the logged force
    stale: BoolArray  # (K,) linearised at other parameters than the frames that came last, and to follow them
    lost: BoolArray  # (K,) has no equilibrium at those parameters: stays as it was linearised before
    rows_j: Array  # (K, 3 m, n) whitened
    rows_a: Array  # (K, 3 m, 2)
    rows_z: Array  # (K, 3 m)

    @property
    def centre(self) -> Array:
        """(used,) s, in the middle of each frame's stretch of time."""
        return 0.5 * (self.begin[: self.used] + self.end[: self.used])

    def spans(self, more: Array) -> Spans:
        """Stretches of time of the frames in use; `more` (used,) is added to the load's own time."""
        begin, end, frames = (values[: self.used].copy() for values in (self.begin, self.end, self.frames))
        return Spans(begin, end, frames, np.zeros(self.used), self.own[: self.used] + more)

    def arrays(self) -> list[Array]:
        """All that is kept of every frame."""
        return [getattr(self, field.name) for field in fields(self) if field.name != "used"]

    def drop(self, i: int) -> None:
        """Take frame i out."""
        for values in self.arrays():
            values[i : self.used - 1] = values[i + 1 : self.used]
        self.used -= 1

    def set_linear(self, i: IntArray, x: Array, pose: Array, j: Array, a: Array) -> None:
        """Linearise B frames at parameters x and their force errors.

        `pose` (B, m, 3) and its derivatives: `j` (B, m, 3, n) with x, `a` (B, m, 3, 2) with the force.
        """
        turns = np.round((self.measured[i, :, 2] - pose[..., 2]) / (2.0 * np.pi))
        self.measured[i, :, 2] -= 2.0 * np.pi * turns
        a = a * ~self.rest[i][:, None, None, None]
        left = self.measured[i] - pose
        self.j[i], self.a[i], self.left[i], self.stale[i], self.lost[i] = j, a, left, False, False
        self.zeta[i] = left + j @ x - (a @ self.error[i][:, None, :, None])[..., 0]
        self.whiten(i)

    def said(self, i: int, marker: float, white: float) -> Array:
        """(R, n + 3) what frame i says of x and its own force error at given noise: rows `[J, -A | zeta]` of unit
        noise, and two of the log itself where nothing pushes.
        """
        root = np.repeat(np.sqrt(self.weight[i]), 3)[:, None] / marker
        rows = root * np.concatenate([self.rows_j[i], -self.rows_a[i], self.rows_z[i][:, None]], axis=1)
        if not self.rest[i]:
            return np.asarray(rows)
        certain = np.sqrt(self.frames[i]) / (AT_REST * white)
        log = np.zeros((2, rows.shape[1]))
        log[:, -3:-1], log[:, -1] = certain * np.eye(2), certain * self.force[i]
        return np.concatenate([rows, log])

    def set_information(self, i: int, information: Array) -> None:
        """(m, 3, 3) of the measured poses of frame i; zero where a tag is not seen."""
        self.information[i], self.root[i] = information, _roots(information)

    def whiten(self, i: IntArray) -> None:
        """Renew the whitened rows of B frames."""
        count, root = len(i), self.root[i]
        self.rows_j[i] = (root @ self.j[i]).reshape(count, -1, self.j.shape[-1])
        self.rows_a[i] = (root @ self.a[i]).reshape(count, -1, 2)
        self.rows_z[i] = (root @ self.zeta[i][..., None]).reshape(count, -1)


def empty(most: int, tags: int, parameters: int, nodes: int) -> KeyFrames:
    """Room for `most` key frames, two that have come since, and two averages that are being made."""
    count = most + 4

    def room(*shape: int) -> Array:
        return np.zeros((count, *shape))

    return KeyFrames(
        used=0,
        begin=room(),
        end=room(),
        own=room(),
        frames=room(),
        rest=np.zeros(count, dtype=bool),
        push_s=room(),
        force=room(2),
        rate=room(2),
        gravity=room(2),
        measured=room(tags, 3),
        information=room(tags, 3, 3),
        root=room(tags, 3, 3),
        weight=room(tags),
        error=room(2),
        left=room(tags, 3),
        zeta=room(tags, 3),
        j=room(tags, 3, parameters),
        a=room(tags, 3, 2),
        q=room(nodes),
        grid=room(),
        by_force=room(nodes, 2),
        stale=np.zeros(count, dtype=bool),
        lost=np.zeros(count, dtype=bool),
        rows_j=room(3 * tags, parameters),
        rows_a=room(3 * tags, 2),
        rows_z=room(3 * tags),
    )


def _roots(information: Array) -> Array:
    """R (m, 3, 3) with R' R = information; zero where that is zero."""
    seen = information[:, 0, 0] > 0.0
    safe = np.where(seen[:, None, None], information, np.eye(3))
    return np.asarray(np.swapaxes(np.linalg.cholesky(safe), 1, 2) * seen[:, None, None])


def closest_pairs(keys: KeyFrames, count: int, largest: float, own: Array, most: int) -> list[int]:
    """Neighbours (i, i + 1) among the first `count` whose averaging loses least (Ward's sum of squares), none in two of
    them; at most so many, and those that are alike. `own` (used,): the load's own time.
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


def propose_average(keys: KeyFrames, i: int, at: int) -> None:
    """What acts on the average of frames i and i + 1, written to the free place `at`, to be linearised there."""
    k = i + 1
    share = keys.frames[k] / (keys.frames[i] + keys.frames[k])
    for values in (keys.own, keys.force, keys.rate, keys.gravity, keys.push_s, keys.error, keys.q):
        values[at] = (1.0 - share) * values[i] + share * values[k]
    keys.begin[at], keys.end[at], keys.frames[at] = keys.begin[i], keys.end[k], keys.frames[i] + keys.frames[k]
    keys.rest[at], keys.lost[at] = keys.rest[i], False
    keys.grid[at] = keys.grid[i]
    if keys.grid[k] != keys.grid[i]:
        keys.q[at] = keys.q[i]
    keys.measured[at], keys.root[at] = 0.0, 0.0


def accept_average(keys: KeyFrames, i: int, at: int, x: Array) -> None:
    """The average at `at` replaces frames i and i + 1. All three were linearised just now, at parameters x."""
    k = i + 1
    share = keys.frames[k] / keys.frames[at]
    # At rest all frames are alike, and tags are read wrong in the same way: an average of them counts as one.
    counts = (1.0 - share, share) if keys.rest[i] else (1.0, 1.0)
    says = [w * keys.weight[f][:, None, None] * keys.information[f] for f, w in zip((i, k), counts, strict=True)]
    total = says[0] + says[1]
    seen = total[:, 0, 0] > 0.0
    inverse = np.linalg.inv(np.where(seen[:, None, None], total, np.eye(3))) * seen[:, None, None]
    left = (inverse @ (says[0] @ keys.left[i][..., None] + says[1] @ keys.left[k][..., None]))[..., 0]
    pose = keys.measured[at] - keys.left[at]
    keys.set_information(at, total)
    keys.weight[at] = seen
    keys.measured[at], keys.left[at] = pose + left, left
    keys.zeta[at] = left + keys.j[at] @ x - keys.a[at] @ keys.error[at]
    keys.whiten(np.array([at]))
    for values in keys.arrays():
        values[i] = values[at]
    keys.drop(k)
