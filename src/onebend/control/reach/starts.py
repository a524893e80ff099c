"""Starts of Newton's method on shape and load: shapes bent by simple moments, one of which is near the goal.

A push at s_a bends the beam by a moment that falls to nothing at s_a. Two such moments, a straight line and one that
changes sign, make a family of shapes; the point's places in them are a table that is made once for a beam. Its entry
nearest to a goal, of near ones the least bent, is the start; the load that fits its moments best goes with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from onebend.control.reach.loaded_beam import LoadedState, PushedBeam
from onebend.records import Array

_TURNS = 2.6 * np.sign(x := np.linspace(-1.0, 1.0, 41)) * np.abs(x) ** 1.7  # rad, largest turn by the first moment
_CURLS = np.array([-1.6, -1.1, -0.7, -0.4, -0.2, 0.0, 0.2, 0.4, 0.7, 1.1, 1.6])  # rad, by the second
_TURN_WEIGHT, _CURL_WEIGHT = 0.03, 0.3  # of L: the distance that a radian of each weighs
_SAME_START = 0.5  # rad: starts that differ by less are one


@dataclass(frozen=True)
class StartTable:
    """A table of shapes of a `PushedBeam` and where they bring its point."""

    pushed: PushedBeam
    shapes: Array  # (2, n) rad a unit turn: the two curvatures
    amounts: Array  # (C, 2) rad
    places: Array  # (C, 2) m

    def near(self, goal: Array, count: int) -> list[LoadedState]:
        """Up to `count` starts for a goal (2,), the best first."""
        length = float(self.pushed.problem.length)
        away = np.sum((self.places - goal) ** 2, axis=1) / length**2
        score = away + self.amounts**2 @ np.array([_TURN_WEIGHT**2, _CURL_WEIGHT**2])
        if count == 1:
            return [self._state(int(np.argmin(score)))]
        chosen: list[int] = []
        for i in np.argsort(score):
            if all(np.max(np.abs(self.amounts[i] - self.amounts[j])) > _SAME_START for j in chosen):
                chosen.append(int(i))
            if len(chosen) == count:
                break
        return [self._state(i) for i in chosen]

    def _state(self, i: int) -> LoadedState:
        """The shape and the force that balances it best, in the measure of bending energy."""
        pushed = self.pushed
        q = pushed.start.q + self.amounts[i] @ self.shapes
        unbalanced, _, cos, sin = pushed.balance(q, np.zeros(3))
        r = pushed.of_load(cos, sin)[:, :2]
        weighed = r / pushed.stiff[:, None]
        normal = weighed.T @ r
        normal = normal + 1e-6 * np.trace(normal) * np.eye(2)  # a straight beam does not feel a force along itself
        return LoadedState(q, np.append(np.linalg.solve(normal, weighed.T @ unbalanced), 0.0))


@lru_cache(maxsize=32)
def starts_of(pushed: PushedBeam) -> StartTable:
    """The table for a beam; bent from its rest shape, or from how it hangs."""
    t = np.clip(pushed.problem.grid.nodes[: pushed.count] / pushed.push_s, 0.0, 1.0)
    shapes = np.stack([1.0 - t, (1.0 - t) * (1.0 - 3.0 * t)]) / pushed.problem.k[: pushed.count]
    shapes = shapes / np.max(np.abs(shapes @ pushed.b.T), axis=1, keepdims=True)
    amounts = np.stack(np.meshgrid(_TURNS, _CURLS, indexing="ij"), axis=-1).reshape(-1, 2)
    alpha = pushed.angles(pushed.start.q) + amounts @ (shapes @ pushed.b.T)
    places = np.stack([np.cos(alpha) @ pushed.row, np.sin(alpha) @ pushed.row], axis=-1)
    return StartTable(pushed, shapes, amounts, places)
