"""The force that brings a point of a beam to a goal: (23)-(25), exactly or by the paper's own iteration.

`method="newton"`: Newton's method on shape and force together (`newton.py`) from a start near the goal
(`starts.py`). A solution counts only if it is stable and connected to rest by stable equilibria: as the force
grows in proportion, or else as the goal moves there from a sampled equilibrium (`search.py`).
`method="paper"`: Algorithm 1 exactly as printed (`paper_iteration.py`); its force is then applied to the exact beam.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.statics.continuation import refine
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.problem import Resolution
from onebend.blas import one_blas_thread
from onebend.control.goals.targets import BEYOND, METRES
from onebend.control.reach.continuation import EquilibriumPath, densified, trace
from onebend.control.reach.loaded_beam import LoadedState, PushedBeam, prepared
from onebend.control.reach.paper_iteration import paper_force
from onebend.control.reach.reachable import NearestPoint, ReachableSet
from onebend.control.reach.search import ReachCandidate, from_rest, resolved, sampled, search
from onebend.control.reach.settings import ReachSettings, checked_goal
from onebend.errors import ControlError
from onebend.records import Array

__all__ = ["Reach", "ReachSettings", "reach"]


@dataclass(frozen=True)
class Reach:
    """A force for a goal, or why there is none; then force and shape are those of the nearest point that was found."""

    pushed: PushedBeam  # the beam, where it is pushed, the point
    goal: Array  # (2,) m, or (3,) m, m, rad
    settings: ReachSettings
    states: tuple[LoadedState, ...]  # equilibria on one branch from rest to the last
    reached: Array  # (3,) m, m, rad: the point and the tangent's angle there
    converged: bool  # the point is on its goal, within all bounds, and the beam comes there from rest
    reason: str
    iterations: int  # of Newton's method, or of Algorithm 1
    nearest: NearestPoint | None  # to a goal that cannot be reached
    known: bool = False  # found one step from an equilibrium that was known beforehand

    @property
    def beam(self) -> Beam:
        return self.pushed.beam

    @property
    def push_s(self) -> float:
        return self.pushed.push_s

    @property
    def point_s(self) -> float:
        return self.pushed.point_s

    @property
    def resolution(self) -> Resolution:
        """The nodes of `solved`."""
        return self.pushed.resolution

    @property
    def force(self) -> Array:
        """(2,) N."""
        return self.states[-1].load[:2].copy()

    @property
    def moment(self) -> float:
        """N m."""
        return float(self.states[-1].load[2])

    @cached_property
    @one_blas_thread
    def solved(self) -> Equilibrium:
        """The last shape, solved again under its load by the beam's own statics."""
        last = self.states[-1]
        return refine(self.pushed.loaded(last.load), self.pushed.whole(last.q)[None])

    @cached_property
    @one_blas_thread
    def way(self) -> tuple[LoadedState, ...]:
        """P equilibria from rest, `settings.steps` steps at least; made when it is first asked for."""
        straight = from_rest(self.pushed, self.states[-1]) if self.known else None
        return densified(self.pushed, self.states if straight is None else straight.states, self.settings.steps)

    @property
    def path(self) -> Array:
        """(P, 3) N, N, N m: loads from rest, each an equilibrium on one branch."""
        return np.array([state.load for state in self.way])

    @property
    def path_points(self) -> Array:
        """(P, 2) m: where they hold the point."""
        return np.array([self.pushed.pose(state.q)[:2] for state in self.way])

    @property
    def error(self) -> float:
        """m, distance of the point from its goal."""
        return float(np.linalg.norm(self.reached[:2] - self.goal[:2]))

    @property
    def stable(self) -> bool:
        """Whether the shape is a stable equilibrium."""
        return self.pushed.stable(self.states[-1])

    @property
    def loads(self) -> Loads:
        """All that acts on the beam at last."""
        weighs = weight(self.settings.gravity)
        return weighs + push(self.force, self.push_s) + twist(self.moment, self.push_s)

    def shapes(self, s: Array) -> Array:
        """(P, S, 2) m: places `s` (S,) of the beam along the path."""
        q = np.array([self.pushed.whole(state.q) for state in self.way])
        return replace(self.solved, q=q).xy(s)


@one_blas_thread
def reach(
    beam: Beam,
    goal: ArrayLike,
    *,
    push_s: float = 1.0,
    point_s: float = 1.0,
    settings: ReachSettings = ReachSettings(),
    start: Reach | None = None,
) -> Reach:
    """The force at `push_s` that puts the point at `point_s` on `goal`.

    Args:
        goal: (2,) m in the beam's frame; (3,) with the tangent's angle [rad], where the gripper gives a moment.
        start: an earlier result for the same beam and places, from which the goal is led first.

    Returns:
        the result; look at `converged` and `reason`: a goal that cannot be reached is not an error.

    Raises:
        ControlError: a goal, place or bound without meaning.
        MechanicsError: k(s) is not positive somewhere.
    """
    wanted = checked_goal(goal, settings)
    pushed = prepared(beam, push_s, point_s, settings.gravity, Resolution())
    if settings.method == "paper":
        return _by_paper(pushed, wanted, settings)
    samples = partial(sampled, pushed, settings)
    begin = None if start is None else _way_of(pushed, start)
    far, candidate = _too_far(pushed, wanted), None
    if not far and settings.direction is None:
        candidate = search(pushed, wanted, settings, begin, samples)
        if candidate is not None and not candidate.wrong:
            return _result(resolved(candidate, wanted, settings), wanted, settings, "")
    return _unreached(pushed, wanted, settings, far or (candidate.wrong if candidate else ""), samples())


def _way_of(pushed: PushedBeam, start: Reach) -> EquilibriumPath:
    """The way to where an earlier result stands."""
    if (start.push_s, start.point_s) != (pushed.push_s, pushed.point_s) or start.beam != pushed.beam:
        raise ControlError("`start` is a result for another beam or other places; leave it out")
    states = [pushed.start]
    for state in start.states[1:]:
        step = trace(pushed, state.load, start=states[-1])
        if not step.arrived:
            return EquilibriumPath(tuple(states), (0.0,), False)
        states.append(step.states[-1])
    return EquilibriumPath(tuple(states), (1.0,), True)


def _too_far(pushed: PushedBeam, goal: Array) -> str:
    """Why no shape at all can bring the point to the goal: it is too far away. Else empty."""
    arm, away = float(pushed.problem.length) * pushed.point_s, float(np.hypot(*goal[:2]))
    if away >= arm:
        text = f"the goal is {1e3 * away:.4g} mm from the clamp, and the beam up to the point {1e3 * arm:.4g} mm long"
        return f"{text}. {METRES}" if away > BEYOND * float(pushed.problem.length) else text
    return ""


def _unreached(pushed: PushedBeam, goal: Array, settings: ReachSettings, known: str, samples: ReachableSet) -> Reach:
    """The nearest point to a goal that was not found; where that lies within the tolerance, the goal is reached."""
    nearest = samples.nearest(goal[:2])
    last = nearest.states[-1]
    trail = from_rest(pushed, last)
    states = nearest.states if trail is None else trail.states
    there = nearest.distance <= settings.tolerance and len(goal) == 2
    why = "" if there else _why(pushed, goal, settings, known, nearest)
    return _result(ReachCandidate(pushed, states, len(states) - 1), goal, settings, why, None if there else nearest)


def _why(pushed: PushedBeam, goal: Array, settings: ReachSettings, known: str, nearest: NearestPoint) -> str:
    """One sentence on why the goal is not reached, one on the nearest alternative."""
    if not known:
        way = "" if settings.direction is None else f" at {math.degrees(settings.direction):.4g} deg"
        most = "" if settings.max_force is None else f" of up to {settings.max_force:.3g} N"
        bent = "" if settings.max_curvature is None else f" within {settings.max_curvature:.3g} 1/m"
        load = "load" if settings.moment else "force"
        known = f"no {load}{most}{way} has a stable shape{bent} there to which the beam comes from rest"
    by = "a force and a moment" if settings.moment else "a force"
    known += "" if known.endswith("?") else "."
    angle = f" at {math.degrees(goal[2]):.4g} deg" if len(goal) > 2 else ""
    return (
        f"the point s = {pushed.point_s:.4g} cannot be put on ({1e3 * goal[0]:.4g}, {1e3 * goal[1]:.4g}) mm{angle} "
        f"by {by} at s = {pushed.push_s:.4g}: {known} {_instead(pushed, settings, nearest)}"
    )


def _instead(pushed: PushedBeam, settings: ReachSettings, nearest: NearestPoint) -> str:
    """The nearest point that a force alone reaches, whatever angle was asked for."""
    at, turn = 1e3 * nearest.point, math.degrees(math.atan2(nearest.force[1], nearest.force[0]))
    needs = f"it needs {nearest.size:.3g} N at {turn:.4g} deg"
    if settings.moment:
        there = math.degrees(float(pushed.pose(nearest.states[-1].q)[2]))
        needs += f" and no moment; the tangent is then at {there:.4g} deg"
    if nearest.distance <= settings.tolerance:
        held = "An end that is held can be stable where one under a load is not: see onebend shape --grip"
        return f"A force alone brings the point there: {needs}. {held}"
    return (
        f"The nearest reachable point is ({at[0]:.4g}, {at[1]:.4g}) mm, {1e3 * nearest.distance:.3g} mm away; {needs}"
    )


def _result(
    candidate: ReachCandidate, goal: Array, settings: ReachSettings, why: str, nearest: NearestPoint | None = None
) -> Reach:
    """The result; `why`: the reason if the goal is not reached, else empty."""
    pushed, last = candidate.pushed, candidate.states[-1]
    reached = pushed.pose(last.q)
    allowed = settings.tolerance if settings.method == "newton" else 2.0 * settings.paper.tolerance
    close = np.linalg.norm(reached[:2] - goal[:2]) <= allowed
    if not why and not (close and pushed.stable(last)):
        why = "a force was found, but on nodes fine enough its shape is not stable, or not on the goal"
    return Reach(
        pushed=pushed,
        goal=goal,
        settings=settings,
        states=candidate.states,
        reached=reached,
        converged=not why,
        reason=why or "reached",
        iterations=candidate.iterations,
        nearest=nearest,
        known=candidate.known,
    )


def _by_paper(pushed: PushedBeam, goal: Array, settings: ReachSettings) -> Reach:
    """Algorithm 1, and what its force does to the exact beam."""
    force = paper_force(pushed.beam, goal, pushed.push_s, pushed.point_s, settings.paper)
    trail = trace(pushed, np.append(force.force, 0.0))
    last = trail.states[-1]
    if not force.converged:
        why = f"the paper's iteration did not settle within {force.iterations} turns"
    elif not trail.arrived:
        why = "the paper's iteration ends at a force under which the exact beam has no stable shape on its branch"
    else:
        off = float(np.linalg.norm(pushed.pose(last.q)[:2] - goal))
        near = off <= 2.0 * settings.paper.tolerance
        why = (
            ""
            if near
            else f"the paper's iteration settled, but under its force the exact beam is {1e3 * off:.3g} mm off"
        )
    return _result(ReachCandidate(pushed, trail.states, force.iterations), goal, settings, why)
