"""Linearises key frames through the equilibrium, those that share a grid together."""

from __future__ import annotations

import numpy as np

from onebend.learning.allowances.relaxation import lag_weights, relaxation_time_of, shift_factor
from onebend.learning.live.forward import REACHED, FrameInputs, Memory, linearise
from onebend.learning.live.key_frames import KeyFrames
from onebend.learning.live.session import LiveSession, PushGrid, grid_places, nearest_grid_place, push_grid_at
from onebend.records import Array


class Lineariser:
    """Holds the grids of all places of the push, made beforehand so that a new place costs no time."""

    def __init__(self, session: LiveSession) -> None:
        self._session = session
        self._grids = {s: push_grid_at(session, s) for s in grid_places()}
        self._pushed = 1.0  # place of the last push

    def pushed_at(self, push_s: float) -> None:
        """Take note of the place of the push."""
        self._pushed = nearest_grid_place(push_s)

    def near(self, keys: KeyFrames, chosen: list[int], i: int) -> list[int]:
        """The chosen key frames on the same grid as key frame i; where there are none, the first chosen one."""
        return [k for k in chosen if self._grid_of(keys, k) == self._grid_of(keys, i)] or chosen[:1]

    def renew(self, keys: KeyFrames, chosen: list[int], point: Array) -> set[int]:
        """Linearise key frames at parameters `point` (n,); returns those with an equilibrium there. The others stay."""
        solved: set[int] = set()
        grids = [self._grid_of(keys, i) for i in chosen]
        for push_s in dict.fromkeys(grids):
            part = [i for i, grid in zip(chosen, grids, strict=True) if grid == push_s]
            solved |= self._renew(keys, self._grids[push_s], part, point)
        return solved

    def _renew(self, keys: KeyFrames, push_grid: PushGrid, chosen: list[int], point: Array) -> set[int]:
        nodes, loaded = len(push_grid.weights), ~keys.rest[chosen]
        force = (keys.force[chosen] - keys.error[chosen]) * loaded[:, None]
        beyond = self._session.length * (keys.push_s[chosen] - push_grid.push_s) * loaded
        inputs = FrameInputs(
            force,
            keys.rate[chosen] * loaded[:, None],
            keys.gravity[chosen],
            beyond,
            keys.terms[chosen],
            self._memory(keys, push_grid, chosen, point),
        )
        there = linearise(self._session, push_grid, point, inputs, self._on_grid(keys, push_grid, chosen)[..., 0])
        good = there.converged
        solved = np.asarray(chosen)[good]
        if len(solved) == 0:
            return set()
        keys.q[solved, :nodes], keys.grid[solved] = there.q[good], push_grid.push_s
        keys.by_force[solved, :nodes], keys.lag[solved, :nodes] = there.by_force[good], there.lag[good]
        keys.set_linear(solved, point, there.pose[good], there.j[good], there.a[good])
        return set(solved.tolist())

    def _memory(self, keys: KeyFrames, push_grid: PushGrid, chosen: list[int], point: Array) -> Memory:
        """What the beam remembers in the chosen frames, from the key frame before each.

        The first of all, and averages in the making, keep what they have.
        """
        nodes, index = len(push_grid.weights), np.array(chosen)
        now = np.zeros((len(index), 2))
        if not self._session.carries("relaxation"):
            return Memory(np.zeros((len(index), nodes, 2)), now)
        layout = self._session.layout
        out = self._on_grid(keys, push_grid, chosen)[..., 3:].copy()
        follows = (index > 0) & (index < keys.used)
        if not np.any(follows):
            return Memory(out, now)
        last = index[follows] - 1
        centre = 0.5 * (keys.begin + keys.end)
        weights, by_log = lag_weights(
            centre[last + 1] - centre[last], relaxation_time_of(layout.get(point, "relaxation"))
        )
        before = self._on_grid(keys, push_grid, last.tolist())
        bending = before[..., 0] - push_grid.rest_on_nodes @ layout.get(point, "curvature")
        lag, lag_by_log = before[..., 3], before[..., 4]
        kept, input_before = weights[0, :, None], weights[1, :, None]
        out[follows, :, 0] = kept * lag + input_before * bending
        out[follows, :, 1] = kept * lag_by_log + by_log[0, :, None] * lag + by_log[1, :, None] * bending
        now[follows] = np.stack([weights[2], by_log[2]], axis=1)
        return Memory(out, now)

    def secant(self, keys: KeyFrames, point: Array, x: Array, covariance: Array) -> tuple[Array, Array]:
        """Mean (n,) and covariance (n, n) of the parameters, log k being made that of the secant stiffness of the push so
        far, `k_i (1 - a c)`."""
        if not self._session.carries("relaxation"):
            return x, covariance
        layout = self._session.layout
        where, p = layout.index["relaxation", -1].where, layout.spline.count
        share, (reached, by_log) = float(layout.get(x, "relaxation")[0]), self._reached(keys, point)
        out, onto = x.copy(), np.eye(len(x))
        factors = [shift_factor(share, c) for c in (reached, REACHED)]  # 1 + c factor: 1 / (1 - a c)
        left = [1.0 + factor * c for factor, c in zip(factors, (reached, REACHED), strict=True)]
        out[:p] += np.log(left[1] / left[0])
        onto[:p, where] = REACHED * left[1] - reached * left[0], -factors[0] * by_log
        return out, onto @ covariance @ onto.T

    def _reached(self, keys: KeyFrames, point: Array) -> tuple[float, float]:
        """c, the share of the curvature that the lagged one has reached over the frames in use, and its derivative with
        the log of the relaxation time."""
        curvature, rows = self._session.layout.get(point, "curvature"), []
        for i in range(keys.used):
            if keys.grid[i] != 0.0 and not keys.rest[i]:
                grid = self._grids[float(keys.grid[i])]
                q = keys.q[i, : len(grid.weights)] - grid.rest_on_nodes @ curvature
                here = grid.weights * keys.frames[i] * q
                rows.append([here @ keys.lag[i, : len(q), 0], here @ keys.lag[i, : len(q), 1], here @ q])
        if not rows:
            return REACHED, 0.0
        lagged, by_log, square = np.sum(rows, axis=0).tolist()
        return (lagged / square, by_log / square) if square > 0.0 else (REACHED, 0.0)

    def _on_grid(self, keys: KeyFrames, push_grid: PushGrid, chosen: list[int]) -> Array:
        """(B, Q, 5) shapes of key frames, interpolated where they are on another grid."""
        nodes = push_grid.grid.nodes
        out = keys.shape[chosen][:, : len(nodes)]
        for row, i in zip(out, chosen, strict=True):
            if keys.grid[i] != push_grid.push_s and keys.grid[i] != 0.0:
                before = self._grids[float(keys.grid[i])].grid.nodes
                for c in (0, 3, 4):
                    row[:, c] = np.interp(nodes, before, keys.shape[i, : len(before), c])
        return out

    def _grid_of(self, keys: KeyFrames, i: int) -> float:
        """Place of the push on the grid of key frame i; at rest any grid will do, and the last one is taken."""
        return self._pushed if keys.rest[i] else nearest_grid_place(float(keys.push_s[i]))
