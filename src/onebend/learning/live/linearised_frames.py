"""Linearises key frames through the equilibrium, those that share a grid together."""

from __future__ import annotations

from typing import Any

import numpy as np

from onebend.learning.allowances.relaxation import LARGEST, TIMES, lag_weights
from onebend.learning.live.forward import linearise
from onebend.learning.live.key_frames import KeyFrames
from onebend.learning.live.session import (
    REACHED,
    FrameInputs,
    LiveSession,
    Memory,
    PushGrid,
    grid_places,
    nearest_grid_place,
    push_grid_at,
)
from onebend.records import Array


class Lineariser:
    """Holds the grids of all places of the push, made beforehand so that a new place costs no time."""

    def __init__(self, session: LiveSession) -> None:
        self._session = session
        self._grids = {s: push_grid_at(session, s) for s in grid_places()}
        self._pushed = 1.0  # place of the last push

    def __getstate__(self) -> dict[str, Any]:
        """Without the grids: they are a hundred times as large as all else, and are made again where wanted."""
        return vars(self) | {"_grids": {}}

    def _grid(self, push_s: float) -> PushGrid:
        if push_s not in self._grids:
            self._grids[push_s] = push_grid_at(self._session, push_s)
        return self._grids[push_s]

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
            solved |= self._renew(keys, self._grid(push_s), part, point)
        return solved

    def _renew(self, keys: KeyFrames, push_grid: PushGrid, chosen: list[int], point: Array) -> set[int]:
        nodes, loaded, here = len(push_grid.weights), ~keys.rest[chosen], self._on_grid(keys, push_grid, chosen)
        force = (keys.force[chosen] - keys.error[chosen]) * loaded[:, None]
        beyond = self._session.length * (keys.push_s[chosen] - push_grid.push_s) * loaded
        inputs = FrameInputs(
            force,
            keys.rate[chosen] * loaded[:, None],
            keys.gravity[chosen],
            beyond,
            keys.terms[chosen],
            self._memory(keys, push_grid, (chosen, here), point),
        )
        there = linearise(self._session, push_grid, point, inputs, here[..., 0])
        solved, good = np.asarray(chosen), there.converged
        if not good.all():
            solved, there = solved[good], there.take(good)
        if len(solved) == 0:
            return set()
        keys.shape[solved, :nodes] = np.concatenate([there.q[..., None], there.by_force, there.lags], axis=2)
        keys.grid[solved] = push_grid.push_s
        keys.set_linear(solved, point, there.pose, there.j, there.a)
        return set(solved.tolist())

    def _memory(self, keys: KeyFrames, push_grid: PushGrid, frames: tuple[list[int], Array], point: Array) -> Memory:
        """What the beam remembers in the chosen frames, from the key frame before each; with the shapes that `_on_grid`
        gives of them.

        The first of all, and averages in the making, keep what they have.
        """
        chosen, here = frames
        before, now = here[..., 3:], np.zeros((len(chosen), len(TIMES)))
        if not self._session.carries("relaxation"):
            return Memory(np.zeros_like(before), now, REACHED)
        bending = here[..., :1] - (push_grid.rest_on_nodes @ self._session.layout.get(point, "curvature"))[:, None]
        centre = 0.5 * (keys.begin + keys.end)
        kept, entered, last = (w.T for w in lag_weights(np.diff(centre)))
        place = {k: b for b, k in enumerate(chosen)}
        for k in sorted(chosen):
            if not 0 < k < keys.used:
                continue
            b, b0 = place[k], place.get(k - 1)
            if b0 is None:
                same = keys.grid[k - 1] == push_grid.push_s
                other = keys.shape[k - 1] if same else self._on_grid(keys, push_grid, [k - 1])[0]
                other = other[: len(push_grid.weights)]
                lags, bent = other[:, 3:], other[:, :1] - (here[b, :, :1] - bending[b])
            else:
                lags, bent = before[b0] + now[b0] * bending[b0], bending[b0]
            now[b] = last[k - 1]
            before[b] = kept[k - 1] * lags + entered[k - 1] * bent
        return Memory(before, now, REACHED)

    def secant(self, keys: KeyFrames, point: Array, x: Array, covariance: Array) -> tuple[Array, Array]:
        """Mean (n,) and covariance (n, n) of the parameters, log k being made that of the secant stiffness of the push
        so far, `k_i (1 - c)`."""
        if not self._session.carries("relaxation"):
            return x, covariance
        layout, reached = self._session.layout, self._reached(keys, point)
        where, p, shares = layout.index["relaxation", -1].where, layout.spline.count, layout.get(x, "relaxation")
        left, usual = (1.0 - min(float(shares @ part), LARGEST) for part in (reached, REACHED))
        out, onto = x.copy(), np.eye(len(x))
        out[:p] += np.log(left / usual)
        onto[:p, where] = REACHED / usual - reached / left
        return out, onto @ covariance @ onto.T

    def _reached(self, keys: KeyFrames, point: Array) -> Array:
        """(r,) parts of the curvature that those which lag behind it have reached over the frames in use."""
        curvature, lagged, square = self._session.layout.get(point, "curvature"), np.zeros(len(TIMES)), 0.0
        for i in range(keys.used):
            if keys.grid[i] != 0.0 and not keys.rest[i]:
                grid = self._grid(float(keys.grid[i]))
                q = keys.q[i, : len(grid.weights)] - grid.rest_on_nodes @ curvature
                here = grid.weights * keys.frames[i] * q
                lagged, square = lagged + here @ keys.lags[i, : len(q)], square + float(here @ q)
        return lagged / square if square > 0.0 else REACHED

    def _on_grid(self, keys: KeyFrames, push_grid: PushGrid, chosen: list[int]) -> Array:
        """(B, Q, 3 + r) shapes of key frames, interpolated where they are on another grid."""
        out, grids = keys.shape[chosen, : len(push_grid.weights)], keys.grid[chosen].tolist()
        for row, i, grid in zip(out, chosen, grids, strict=True):
            if grid not in (push_grid.push_s, 0.0):
                nodes, before = push_grid.grid.nodes, self._grid(float(keys.grid[i])).grid.nodes
                for c in (0, *range(3, out.shape[-1])):
                    row[:, c] = np.interp(nodes, before, keys.shape[i, : len(before), c])
        return out

    def _grid_of(self, keys: KeyFrames, i: int) -> float:
        """Place of the push on the grid of key frame i; at rest any grid will do, and the last one is taken."""
        return self._pushed if keys.rest[i] else nearest_grid_place(float(keys.push_s[i]))
