"""Linearises key frames through the equilibrium, those that share a grid together."""

from __future__ import annotations

import numpy as np

from onebend.learning.live.forward import FrameInputs, linearise
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
        inputs = FrameInputs(force, keys.rate[chosen] * loaded[:, None], keys.gravity[chosen], beyond)
        there = linearise(self._session, push_grid, point, inputs, self._start(keys, push_grid, chosen))
        good = there.converged
        solved = np.asarray(chosen)[good]
        if len(solved) == 0:
            return set()
        keys.q[solved, :nodes], keys.grid[solved] = there.q[good], push_grid.push_s
        keys.by_force[solved, :nodes] = there.by_force[good]
        keys.set_linear(solved, point, there.pose[good], there.j[good], there.a[good])
        return set(solved.tolist())

    def _start(self, keys: KeyFrames, push_grid: PushGrid, chosen: list[int]) -> Array:
        """(B, Q) shapes to start from, interpolated where they are on another grid."""
        nodes = push_grid.grid.nodes
        out = keys.q[chosen][:, : len(nodes)]
        for row, i in zip(out, chosen, strict=True):
            if keys.grid[i] != push_grid.push_s and keys.grid[i] != 0.0:
                before = self._grids[float(keys.grid[i])].grid.nodes
                row[:] = np.interp(nodes, before, keys.q[i, : len(before)])
        return out

    def _grid_of(self, keys: KeyFrames, i: int) -> float:
        """Place of the push on the grid of key frame i; at rest any grid will do, and the last one is taken."""
        return self._pushed if keys.rest[i] else nearest_grid_place(float(keys.push_s[i]))
