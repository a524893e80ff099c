"""The search for an equilibrium with the point on its goal, connected to rest; the quickest attempts come first."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from onebend.beam.statics.nodal_beam import missed_by_angles
from onebend.control.reach.continuation import EquilibriumPath, lead, trace
from onebend.control.reach.known import step_to
from onebend.control.reach.loaded_beam import LoadedState, PushedBeam, prepared
from onebend.control.reach.newton import solve_goal
from onebend.control.reach.reachable import ReachableSet, reachable
from onebend.control.reach.settings import ReachSettings, broken_bound
from onebend.control.reach.starts import StartTable, starts_of
from onebend.records import Array

_MOST_STARTS = 8  # starts that are tried
_MOST_SAMPLES = 5  # sampled equilibria that the goal is led from
_SAME_SHAPE = 1e-6  # rad: shapes nearer than this are one
_FORCE_WITHOUT_BOUND = 30.0  # times k / (L s_a^2): the largest force thought of where no bound is given
_MOST_REFINEMENTS = 3  # halvings of the panels that are tried
_SURELY_FINE = 0.01  # of the tolerance


@dataclass(frozen=True)
class ReachCandidate:
    """Equilibria from rest to the last, which has the point on its goal."""

    pushed: PushedBeam
    states: tuple[LoadedState, ...]
    iterations: int
    wrong: str = ""  # the bound it breaks
    known: bool = False  # one step from a known equilibrium, which is the state between


def search(
    pushed: PushedBeam,
    goal: Array,
    settings: ReachSettings,
    begin: EquilibriumPath | None,
    samples: Callable[[], ReachableSet],
) -> ReachCandidate | None:
    """An equilibrium on the goal that the beam comes to from rest; one out of bounds where there is no other."""
    spare = None
    for candidate in _tries(pushed, goal, settings, begin, samples):
        wrong = broken_bound(pushed, candidate.states[-1], settings)
        if not wrong:
            return candidate
        spare = spare or replace(candidate, wrong=wrong)
    return spare


def solutions(pushed: PushedBeam, starts: StartTable, goal: Array, loads: int) -> Iterator[tuple[LoadedState, int]]:
    """Stable equilibria with the point on the goal, from one start after another, and the iterations so far."""
    iterations, before = 0, list[LoadedState]()
    for first in (True, False):
        for begin in starts.near(goal[:2], 1) if first else starts.near(goal[:2], _MOST_STARTS)[1:]:
            result = solve_goal(pushed, begin, goal, loads)
            iterations += result.iterations
            if not (result.converged and pushed.stable(result.state)):
                continue
            if not any(_same(pushed, result.state, known) for known in before):
                before.append(result.state)
                yield result.state, iterations


def from_rest(pushed: PushedBeam, state: LoadedState) -> EquilibriumPath | None:
    """The way to an equilibrium while its load grows in proportion; None where that ends elsewhere."""
    trail = trace(pushed, state.load)
    return trail if trail.arrived and _same(pushed, trail.states[-1], state) else None


def _same(pushed: PushedBeam, first: LoadedState, other: LoadedState) -> bool:
    return float(np.max(np.abs(pushed.b @ (first.q - other.q)))) < _SAME_SHAPE


@lru_cache(maxsize=8)
def sampled(pushed: PushedBeam, settings: ReachSettings) -> ReachableSet:
    """The reachable set within the settings, sampled coarsely."""
    return reachable(
        pushed.beam,
        push_s=pushed.push_s,
        point_s=pushed.point_s,
        max_force=settings.max_force or float(_FORCE_WITHOUT_BOUND * pushed.force_scale),
        max_curvature=settings.max_curvature,
        direction=settings.direction,
        directions=36,
        sizes=8,
        gravity=settings.gravity,
    )


def _tries(
    pushed: PushedBeam,
    goal: Array,
    settings: ReachSettings,
    begin: EquilibriumPath | None,
    samples: Callable[[], ReachableSet],
) -> Iterator[ReachCandidate]:
    if begin is not None:
        yield from _led(pushed, begin, goal, settings.loads)
    elif len(goal) == settings.loads == 2:
        step = step_to(pushed, goal)
        if step is not None:
            yield ReachCandidate(pushed, (pushed.start, step[0], step[1].state), step[1].iterations, known=True)
    for state, count in solutions(pushed, starts_of(pushed), goal, settings.loads):
        trail = from_rest(pushed, state)
        if trail is not None:
            yield ReachCandidate(pushed, trail.states, count)
    for near in samples().samples_near(goal[:2], _MOST_SAMPLES):
        yield from _led(pushed, trace(pushed, near.load), goal, settings.loads)


def _led(pushed: PushedBeam, trail: EquilibriumPath, goal: Array, loads: int) -> Iterator[ReachCandidate]:
    """The goal led on from the end of a way; its place first, then its angle."""
    if not trail.arrived:
        return
    states, arrived = trail.states, True
    for wanted, count in ((goal[:2], 2), (goal, 3))[: loads - 1]:
        led = lead(pushed, states[-1], wanted, count)
        states, arrived = (*states, *led.states[1:]), arrived and led.arrived
    if arrived:
        yield ReachCandidate(pushed, states, len(states) - 1)


@lru_cache(maxsize=32)
def _onto(pushed: PushedBeam, finer: PushedBeam) -> Array:
    """Rows that give curvatures at the unknown nodes of a finer grid."""
    return pushed.problem.grid.value_at(finer.problem.grid.nodes[: finer.count])


def resolved(candidate: ReachCandidate, goal: Array, settings: ReachSettings) -> ReachCandidate:
    """The same on a grid fine enough that a finer one moves the point by less than a tenth of the tolerance.

    The grid at hand is fine enough where what its angles miss moves the point by less than a hundredth of it.
    """
    pushed = candidate.pushed
    for _ in range(_MOST_REFINEMENTS):
        last, grid = candidate.states[-1], pushed.problem.grid
        q = pushed.whole(last.q)
        if missed_by_angles(grid, q) * np.abs(q).max() * pushed.problem.length < _SURELY_FINE * settings.tolerance:
            break
        resolution = replace(pushed.resolution, widest=0.5 * float(np.diff(grid.edges).max()))
        finer = prepared(pushed.beam, pushed.push_s, pushed.point_s, settings.gravity, resolution)
        rows = _onto(pushed, finer)
        exact = solve_goal(finer, LoadedState(rows @ q, last.load), goal, settings.loads, trust=0.1)
        if exact.compliance is None or not finer.stable(exact.state):
            break
        moved = exact.compliance[:2] @ (exact.state.load - last.load)[: settings.loads]
        if float(np.hypot(*moved)) < 0.1 * settings.tolerance:
            break
        states = tuple(LoadedState(rows @ pushed.whole(state.q), state.load) for state in candidate.states[:-1])
        candidate, pushed = replace(candidate, pushed=finer, states=(*states, exact.state)), finer
    return candidate
