"""Numerical continuation of equilibria: as a load grows in proportion, or as a goal moves."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg.lapack import dposv

from onebend.control.reach.loaded_beam import LoadedState, PushedBeam
from onebend.control.reach.newton import TOLERANCE, solve_goal
from onebend.records import Array

_LARGEST_STEP_TURN, _TRUST, _TRUST_GROWTH, _LEAST_TRUST = 0.7, 0.25, 0.5, 1e-3  # as `continuation.Search`
_GOAL_TRUST, _SHORTEST_GOAL_STEP = 0.4, 1e-4  # rad of turn, share of the way of a step in which the goal moves
_SHORTEST_LOAD_STEP = 1e-6  # share of the load: a shorter step has met the end of the branch
_SAME_SHAPE = 1e-6  # rad: shapes nearer than this are one


@dataclass(frozen=True)
class EquilibriumPath:
    """Equilibria under a load that grows in proportion, each reached from the one before."""

    states: tuple[LoadedState, ...]  # the first at rest
    share: tuple[float, ...]  # of the load
    arrived: bool  # at the full load, stable all the way


def trace(
    pushed: PushedBeam,
    load: Array,
    *,
    start: LoadedState | None = None,
    widest: float = 1.0,
    shortest: float = _SHORTEST_LOAD_STEP,
) -> EquilibriumPath:
    """Shapes while the load grows from that of `start` (default: rest) straight to `load` (3,), stable all the way.

    `widest`, `shortest`: the largest step, and the step that counts as none, as shares of the way.

    As in `beam/statics/continuation.py`, a step counts only where the corrector moved the shape little and it is
    stable.
    """
    begin_state = start or pushed.start
    begin, way = begin_state.load, load - begin_state.load
    states, shares = [begin_state], [0.0]
    share, step = 0.0, 1.0
    q = begin_state.q
    _, tangent, cos, sin = pushed.balance(q, begin)
    while share < 1.0:
        _, slope, info = dposv(tangent, pushed.of_load(cos, sin) @ way, lower=1)
        if info != 0:
            return EquilibriumPath(tuple(states), tuple(shares), False)
        turn = float(np.max(np.abs(pushed.b @ slope)))
        step = min(step, 1.0 - share, widest, _LARGEST_STEP_TURN / max(turn, 1e-300))
        corrected = None
        while corrected is None:
            if step < shortest:
                return EquilibriumPath(tuple(states), tuple(shares), False)
            now = 1.0 if share + step > 1.0 - 1e-12 else share + step
            trust = min(_TRUST, _LEAST_TRUST + _TRUST_GROWTH * step * turn)
            corrected = _correct(pushed, q + step * slope, begin + now * way, trust)
            step = step * (2.0 if corrected is not None else 0.25)
        q, tangent, cos, sin = corrected
        share = now
        states.append(LoadedState(q, begin + share * way))
        shares.append(share)
    return EquilibriumPath(tuple(states), tuple(shares), True)


def lead(pushed: PushedBeam, start: LoadedState, goal: Array, loads: int = 2) -> EquilibriumPath:
    """Equilibria while the goal moves straight from where `start` has the point to `goal`, stable all the way.

    The loads follow the goal; `share` is of the way. It ends early where no force leads on (the edge of what can be
    reached, or of stability).
    """
    begin = pushed.pose(start.q)[: len(goal)]
    states, shares, step = [start], [0.0], 1.0
    while shares[-1] < 1.0 and step > _SHORTEST_GOAL_STEP:
        now = min(1.0, shares[-1] + step)
        result = solve_goal(pushed, states[-1], begin + now * (goal - begin), loads, most=8, trust=_GOAL_TRUST)
        if result.converged and pushed.stable(result.state):
            states.append(result.state)
            shares.append(now)
            step *= 2.0
        else:
            step *= 0.25
    return EquilibriumPath(tuple(states), tuple(shares), shares[-1] == 1.0)


def _correct(pushed: PushedBeam, q: Array, load: Array, trust: float) -> tuple[Array, Array, Array, Array] | None:
    """Newton at a fixed load, proved stable by Cholesky's factor at every iteration."""
    moved: Array | float = 0.0
    for _ in range(8):
        unbalanced, tangent, cos, sin = pushed.balance(q, load)
        _, update, info = dposv(tangent, unbalanced, lower=1)
        if info != 0:
            return None
        q = q - update
        turn = pushed.b @ update
        moved = moved + turn
        if not float(np.max(np.abs(moved))) < trust:
            return None
        if float(np.max(np.abs(turn))) < TOLERANCE:
            return q, tangent, cos, sin
    return None


def densified(pushed: PushedBeam, states: tuple[LoadedState, ...], steps: int) -> tuple[LoadedState, ...]:
    """The same path with at least `steps` steps: intermediate equilibria are added where the loads allow."""
    between = -(-steps // max(len(states) - 1, 1))
    out = [states[0]]
    for begin, end in pairwise(states):
        finer = trace(pushed, end.load, start=begin, widest=1.0 / between)
        same = finer.arrived and float(np.max(np.abs(pushed.b @ (finer.states[-1].q - end.q)))) < _SAME_SHAPE
        out += [*(finer.states[1:-1] if same else ()), end]
    return tuple(out)
