"""One goal after another, for control loops: each force is found from the one before."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.model import Beam
from onebend.beam.statics.problem import Resolution
from onebend.blas import one_blas_thread
from onebend.control.reach.continuation import lead
from onebend.control.reach.loaded_beam import LoadedState, PushedBeam
from onebend.control.reach.newton import NewtonResult, solve_goal
from onebend.control.reach.search import from_rest, sampled, search, solutions
from onebend.control.reach.settings import ReachSettings, broken_bound, checked_goal
from onebend.control.reach.starts import starts_of
from onebend.errors import ControlError
from onebend.records import Array

_LARGEST_TURN = 0.4  # rad: a step that turns the beam by more anywhere may have left the branch


@dataclass(frozen=True, slots=True)
class HoldingLoad:
    """The load that holds a point on its goal."""

    force: Array  # (2,) N
    moment: float  # N m
    route: Literal["warm", "led", "rest"]  # Newton from the last load, small steps of the goal, or a search from rest
    iterations: int  # of Newton's method; 0 where the search did not count them


class WarmReach:
    """A beam whose point moves from goal to goal under the load at one place; it remembers its state.

    It stays on its branch of stable equilibria. A goal that is not on it is searched for from rest; a real beam may
    reach that state only by a jump (`HoldingLoad.route` is then "rest"). Not for two threads at once.
    """

    @one_blas_thread
    def __init__(
        self,
        beam: Beam,
        *,
        push_s: float = 1.0,
        point_s: float = 1.0,
        settings: ReachSettings = ReachSettings(),
        resolution: Resolution = Resolution(),
    ) -> None:
        """The beam at rest.

        Raises:
            ControlError: a place without meaning, or settings that only `reach` knows (paper, one direction).
        """
        if settings.method != "newton" or settings.direction is not None:
            raise ControlError("a warm reach is Newton's, with forces in all directions; take `reach` for others")
        self._settings = settings
        self._pushed = PushedBeam(beam, push_s, point_s, gravity=settings.gravity, resolution=resolution)
        self._starts = starts_of(self._pushed)
        self._state: LoadedState | None = None
        self._last: NewtonResult | None = None

    @property
    def jacobian(self) -> Array:
        """(2, 2) or (2, 3) m/N: how the point goes with the load, where the last `solve` ended. Equation (25)."""
        if self._state is None:
            raise ControlError("no goal has been reached yet: there is nothing to take derivatives of")
        return self._pushed.response(self._state)[:2, : self._settings.loads]

    @property
    def point(self) -> Array:
        """(3,) m, m, rad: where the point stands, and the tangent's angle there."""
        return self._pushed.pose((self._state or self._pushed.start).q)

    def reset(self) -> None:
        """Back to rest."""
        self._state = self._last = None

    @one_blas_thread
    def solve(self, goal: ArrayLike) -> HoldingLoad:
        """The load for `goal` (2,) m, or (3,) with an angle [rad].

        Raises:
            ControlError: a goal without meaning, or one that cannot be reached (the beam stays where it is).
        """
        wanted = checked_goal(goal, self._settings)
        if self._state is not None:
            result = solve_goal(
                self._pushed, self._predicted(wanted), wanted, self._settings.loads, most=8, trust=_LARGEST_TURN
            )
            if result.converged and result.positive:
                return self._take(result.state, "warm", result.iterations, result)
            led = lead(self._pushed, self._state, wanted, self._settings.loads)
            if led.arrived:
                return self._take(led.states[-1], "led", 0, None)
        for state, iterations in solutions(self._pushed, self._starts, wanted, self._settings.loads):
            if from_rest(self._pushed, state) is not None:
                return self._take(state, "rest", iterations, None)
        settled = search(self._pushed, wanted, self._settings, None, partial(sampled, self._pushed, self._settings))
        if settled is None:
            raise ControlError(
                f"the point s = {self._pushed.point_s:.4g} cannot be put on "
                f"{np.round(1e3 * wanted[:2], 3).tolist()} mm: no stable shape there to which the beam comes "
                "from rest. `reach` names the nearest point"
            )
        return self._take(settled.states[-1], "rest", settled.iterations, None)

    def _predicted(self, goal: Array) -> LoadedState:
        """The state one step ahead, by the derivatives at hand: they cost nothing more."""
        assert self._state is not None
        state, last = self._state, self._last
        if last is None or last.curvature_per_load is None or last.compliance is None:
            return state
        rows, columns = last.compliance.shape
        if rows != columns or rows != len(goal):
            return state
        change = np.linalg.solve(last.compliance, goal - self._pushed.pose(state.q)[: len(goal)])
        curve = last.curvature_per_load @ change
        if not np.max(np.abs(self._pushed.b @ curve)) < 0.5 * _LARGEST_TURN:
            return state
        load = state.load.copy()
        load[: len(change)] += change
        return LoadedState(state.q + curve, load)

    def _take(
        self, state: LoadedState, route: Literal["warm", "led", "rest"], count: int, last: NewtonResult | None
    ) -> HoldingLoad:
        wrong = broken_bound(self._pushed, state, self._settings)
        if wrong:
            raise ControlError(f"the goal is out of bounds: {wrong}. Give another goal, or wider bounds")
        self._state, self._last = state, last
        return HoldingLoad(state.load[:2].copy(), float(state.load[2]), route, count)
