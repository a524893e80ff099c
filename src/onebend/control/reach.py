"""The force that puts a point of the beam on a goal, and the reachable goals."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from onebend.beam.continuation import ContinuationSettings, follow, refine
from onebend.beam.grid import solve_each, transposed
from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem, make_problems, missed_by_angles
from onebend.beam.sensitivity import of_stiffness, respond
from onebend.beam.setup import Bent, Renewed, SetUp
from onebend.beam.statics import Equilibrium, tangent
from onebend.beam.stiffness import UncertainStiffness
from onebend.control.goals import BEYOND, METRES
from onebend.control.loaded_beam import (
    LARGEST_STEP_TURN,
    EquilibriumPath,
    LoadedState,
    PushedBeam,
    ReachSettings,
    broken_bound,
    checked_goal,
    densified,
    lead,
    paper_force,
    prepared,
    solve_goal,
    trace,
    trusted,
)
from onebend.control.reach_set import NearestPoint, ReachableSet, reachable
from onebend.errors import ControlError
from onebend.progress import one_blas_thread
from onebend.records import Array, BoolArray

# Precomputed equilibria under forces in all directions and sizes. A goal near one is a step away: predicted by
# derivatives, corrected by Newton's method, accepted if the correction is small and every tangent positive.

_DIRECTIONS = 20
_SIZES = 0.5 * 2.0 ** np.arange(6)  # times k / (L s_a^2)
_WAY = ContinuationSettings(tolerance=1e-8, min_step=0.05, max_steps=7)  # longer ways are omitted
_TURN_WEIGHT = 0.03  # of L per radian: prefers the less bent of two
_SAME_START = 0.5  # rad, between different ones
_LEAST_DETERMINANT = 1e-9  # of the compliance over its squared size; below it the goal does not determine the force


@dataclass(frozen=True)
class KnownEquilibria:
    """C stable equilibria of a `PushedBeam`, with rest, and their derivatives by the force."""

    q: Array  # (C, n) rad
    force: Array  # (C, 2) N
    places: Array  # (C, 2) m
    bent: Array  # (C,) m^2: weight of the turn
    shape_by_force: Array  # (C, n, 2) rad/N: Y
    force_by_place: Array  # (C, 2, 2) N/m: inverse of S
    turned: Array  # (C, Q) rad, from rest

    def near(self, goal: Array, count: int) -> list[LoadedState]:
        """Up to `count` different ones near a goal (2,), the best first; of two as near the less bent."""
        chosen: list[int] = []
        for i in np.argsort(np.sum((self.places - goal) ** 2, axis=1) + self.bent).tolist():
            if all(np.max(np.abs(self.turned[i] - self.turned[j])) > _SAME_START for j in chosen):
                chosen.append(i)
            if len(chosen) == count:
                break
        return [LoadedState(self.q[i], np.append(self.force[i], 0.0)) for i in chosen]


def known_equilibria(pushed: PushedBeam) -> KnownEquilibria:
    """Cached with the beam."""
    key = (KnownEquilibria, pushed.push_s, pushed.point_s, pushed.gravity, pushed.resolution)
    return pushed.beam.memory.once(key, lambda: _sampled(pushed))


def step_to(pushed: PushedBeam, goal: Array) -> ReachCandidate | None:
    """From the nearest known equilibrium one step to the goal (2,); None if that fails."""
    known = known_equilibria(pushed)
    away = goal - known.places
    i = int(np.argmin(away[:, 0] ** 2 + away[:, 1] ** 2 + known.bent))
    change = known.force_by_place[i] @ away[i]
    curve = known.shape_by_force[i] @ change
    turn = float(np.abs(pushed.b @ curve).max())
    if not turn < LARGEST_STEP_TURN:
        return None
    x, y = known.force[i] + change
    ahead = LoadedState(known.q[i] + curve, np.array([x, y, 0.0]))
    result = solve_goal(pushed, ahead, goal, most=8, trust=trusted(turn))
    if not (result.converged and result.positive):
        return None
    near = LoadedState(known.q[i], np.array([*known.force[i], 0.0]))
    return ReachCandidate(pushed, (pushed.start, near, result.state), result.iterations, known=True)


def _sampled(pushed: PushedBeam) -> KnownEquilibria:
    turn = np.arange(_DIRECTIONS) * (2.0 * np.pi / _DIRECTIONS)
    size = pushed.force_scale * np.concatenate([np.zeros(1), np.repeat(_SIZES, _DIRECTIONS)])
    turn = np.concatenate([np.zeros(1), np.tile(turn, len(_SIZES))])
    force = size[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    loads = push(force, pushed.push_s) + weight(pushed.gravity)
    solved = follow(make_problem(pushed.beam, loads, pushed.resolution), settings=_WAY)
    good = solved.converged & solved.stable
    q, force = solved.q[good, : pushed.count], force[good]
    alpha = q @ pushed.b.T + pushed.angles(np.zeros(pushed.count))
    cos, sin = np.cos(alpha), np.sin(alpha)
    pulls = np.stack([-pushed.pull * sin[:, : pushed.count], pushed.pull * cos[:, : pushed.count]], axis=1)
    matrices = tangent(solved.problem, solved.q)[good][:, : pushed.count, : pushed.count]
    by_force = solve_each(matrices, transposed(pulls @ pushed.square))
    moves = np.stack([-pushed.row * sin, pushed.row * cos], axis=1)
    compliance = (moves @ pushed.b) @ by_force
    places = np.stack([cos @ pushed.row, sin @ pushed.row], axis=-1)
    turned = (q - pushed.start.q) @ pushed.b.T
    weighs = (_TURN_WEIGHT * float(pushed.problem.length) * np.max(np.abs(turned), axis=1)) ** 2
    size = np.abs(np.linalg.det(compliance)) / np.maximum(np.sum(compliance**2, axis=(1, 2)), 1e-300)
    told = size > _LEAST_DETERMINANT
    inverse = np.linalg.inv(compliance[told])
    return KnownEquilibria(q[told], force[told], places[told], weighs[told], by_force[told], inverse, turned[told])


_MOST_STARTS = 8
_MOST_SAMPLES = 5
_FORCE_WITHOUT_BOUND = 30.0  # times k / (L s_a^2): largest force without a bound
_MOST_REFINEMENTS = 3  # halvings of panels
_SURELY_FINE = 0.01  # of the tolerance


@dataclass(frozen=True)
class ReachCandidate:
    """Equilibria from rest to one on the goal."""

    pushed: PushedBeam
    states: tuple[LoadedState, ...]
    iterations: int
    wrong: str = ""  # violated bound
    known: bool = False  # one step from a known equilibrium

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
        """The last shape, by `beam.statics`."""
        last = self.states[-1]
        return refine(self.pushed.loaded(last.load), self.pushed.whole(last.q)[None])

    @cached_property
    def reached(self) -> Array:
        """(3,) m, m, rad: pose of the point."""
        return self.pushed.pose(self.states[-1].q)

    @property
    def stable(self) -> bool:
        return self.pushed.stable(self.states[-1])

    @property
    def loads(self) -> Loads:
        """All final loads."""
        weighs = weight(self.pushed.gravity)
        return weighs + push(self.force, self.push_s) + twist(self.moment, self.push_s)


def search(pushed: PushedBeam, goal: Array, settings: ReachSettings) -> ReachCandidate | None:
    """An equilibrium on the goal reached from rest; out of bounds only if there is no other."""
    spare = None
    for candidate in _tries(pushed, goal, settings):
        last = candidate.states[-1]
        wrong = broken_bound(float(np.hypot(*last.load[:2])), pushed.bend(last.q), settings)
        if not wrong:
            return candidate
        spare = spare or replace(candidate, wrong=wrong)
    return spare


def from_rest(pushed: PushedBeam, state: LoadedState) -> EquilibriumPath | None:
    """The way under a proportional load; None if it ends elsewhere."""
    trail = trace(pushed, state.load)
    return trail if trail.arrived and pushed.same(trail.states[-1], state) else None


@lru_cache(maxsize=8)
def sampled(pushed: PushedBeam, settings: ReachSettings) -> ReachableSet:
    """Coarse, once for each beam and settings."""
    return reachable(
        pushed.beam,
        push_s=pushed.push_s,
        point_s=pushed.point_s,
        max_force=settings.max_force or float(_FORCE_WITHOUT_BOUND * pushed.force_scale),
        max_curvature=settings.max_curvature,
        directions=36,
        sizes=8,
        gravity=settings.gravity,
    )


def _tries(pushed: PushedBeam, goal: Array, settings: ReachSettings) -> Iterator[ReachCandidate]:
    if len(goal) == settings.loads == 2:
        step = step_to(pushed, goal)
        if step is not None:
            yield step
    iterations = 0
    for begin in known_equilibria(pushed).near(goal[:2], _MOST_STARTS):
        result = solve_goal(pushed, begin, goal, settings.loads)
        iterations += result.iterations
        trail = from_rest(pushed, result.state) if result.converged and pushed.stable(result.state) else None
        if trail is not None:
            yield ReachCandidate(pushed, trail.states, iterations)
    for near in sampled(pushed, settings).samples_near(goal[:2], _MOST_SAMPLES):
        yield from _led(pushed, trace(pushed, near.load), goal, settings.loads)


def _led(pushed: PushedBeam, trail: EquilibriumPath, goal: Array, loads: int) -> Iterator[ReachCandidate]:
    """Leads the goal from the end of a way; first its place, then its angle."""
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
    """Rows from curvatures to the unknown nodes of a finer grid."""
    return pushed.problem.grid.value_at(finer.problem.grid.nodes[: finer.count])


def resolved(candidate: ReachCandidate, goal: Array, settings: ReachSettings) -> ReachCandidate:
    """On a grid for which refinement moves the point by less than a tenth of the tolerance, or whose own error is below
    a hundredth of it."""
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


# `method="newton"`: shape and force together; a solution must be stable and connected to rest by stable equilibria.
# `method="paper"`: Algorithm 1 as printed; its force is applied to the exact beam.

__all__ = ["Reach", "ReachSettings", "reach"]


@dataclass(frozen=True, repr=False, kw_only=True)
class Reach(ReachCandidate):
    """A force for a goal, or the reason why there is none, with the nearest point found."""

    goal: Array  # (2,) m, or (3,) m, m, rad
    settings: ReachSettings
    converged: bool  # on the goal, within bounds, reached from rest
    reason: str
    nearest: NearestPoint | None  # to an unreachable goal

    tag = None  # as of `ReachInSetUp`

    def __repr__(self) -> str:
        goal, force = (", ".join(f"{value:.4g}" for value in values) for values in (self.goal, self.force))
        return f"Reach(goal=({goal}) m, {f'force=({force}) N' if self.converged else f'no force: {self.reason}'})"

    @cached_property
    @one_blas_thread
    def way(self) -> tuple[LoadedState, ...]:
        """P equilibria from rest, at least `settings.steps` steps; computed on demand."""
        straight = from_rest(self.pushed, self.states[-1]) if self.known else None
        return densified(self.pushed, self.states if straight is None else straight.states, self.settings.steps)

    @property
    def path(self) -> Array:
        """(P, 3) N, N, N m: loads from rest on one branch."""
        return np.array([state.load for state in self.way])

    @property
    def path_points(self) -> Array:
        """(P, 2) m: the point."""
        return np.array([self.pushed.pose(state.q)[:2] for state in self.way])

    @property
    def on_beam(self) -> Array:
        """(2,) N."""
        return self.force

    @property
    def error(self) -> float:
        """m, from the goal."""
        return float(np.linalg.norm(self.reached[:2] - self.goal[:2]))

    def shapes(self, s: Array) -> Array:
        """(P, S, 2) m at `s` (S,)."""
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
) -> Reach:
    """The force at `push_s` that puts the point at `point_s` on `goal`; an unreachable goal is no error (`converged`).

    Args:
        goal: (2,) m in the beam's frame; (3,) with the tangent's angle [rad], with a moment.

    Raises `ControlError`: an invalid goal, place or bound. Raises `MechanicsError`: k(s) is not positive.
    """
    wanted = checked_goal(goal, settings)
    pushed = prepared(beam, push_s, point_s, settings.gravity, Resolution())
    if settings.method == "paper":
        return _by_paper(pushed, wanted, settings)
    far, candidate = _too_far(pushed, wanted), None
    if not far:
        candidate = search(pushed, wanted, settings)
        if candidate is not None and not candidate.wrong:
            return _result(resolved(candidate, wanted, settings), wanted, settings, "")
    return _unreached(pushed, wanted, settings, far or (candidate.wrong if candidate else ""))


def _too_far(pushed: PushedBeam, goal: Array) -> str:
    """Why no shape can reach the goal, or ""."""
    arm, away = float(pushed.problem.length) * pushed.point_s, float(np.hypot(*goal[:2]))
    if away >= arm:
        text = f"the goal is {1e3 * away:.4g} mm from the clamp, and the beam up to the point {1e3 * arm:.4g} mm long"
        return f"{text}. {METRES}" if away > BEYOND * float(pushed.problem.length) else text
    return ""


def _unreached(pushed: PushedBeam, goal: Array, settings: ReachSettings, known: str) -> Reach:
    """The nearest point; within the tolerance it counts as reached."""
    nearest = sampled(pushed, settings).nearest(goal[:2])
    last = nearest.states[-1]
    trail = from_rest(pushed, last)
    states = nearest.states if trail is None else trail.states
    there = nearest.distance <= settings.tolerance and len(goal) == 2
    why = "" if there else _why(pushed, goal, settings, known, nearest)
    return _result(ReachCandidate(pushed, states, len(states) - 1), goal, settings, why, None if there else nearest)


def _why(pushed: PushedBeam, goal: Array, settings: ReachSettings, known: str, nearest: NearestPoint) -> str:
    """Why the goal is not reached, and the nearest alternative."""
    if not known:
        most = "" if settings.max_force is None else f" of up to {settings.max_force:.3g} N"
        bent = "" if settings.max_curvature is None else f" within {settings.max_curvature:.3g} 1/m"
        load = "load" if settings.moment else "force"
        known = f"no {load}{most} has a stable shape{bent} there to which the beam comes from rest"
    by = "a force and a moment" if settings.moment else "a force"
    known += "" if known.endswith("?") else "."
    angle = f" at {math.degrees(goal[2]):.4g} deg" if len(goal) > 2 else ""
    return (
        f"the point s = {pushed.point_s:.4g} cannot be put on ({1e3 * goal[0]:.4g}, {1e3 * goal[1]:.4g}) mm{angle} "
        f"by {by} at s = {pushed.push_s:.4g}: {known} {_instead(pushed, settings, nearest)}"
    )


def _instead(pushed: PushedBeam, settings: ReachSettings, nearest: NearestPoint) -> str:
    """The nearest point without its angle."""
    at, turn = 1e3 * nearest.point, math.degrees(math.atan2(nearest.force[1], nearest.force[0]))
    needs = f"it needs {np.hypot(*nearest.force):.3g} N at {turn:.4g} deg"
    if settings.moment:
        there = math.degrees(float(pushed.pose(nearest.states[-1].q)[2]))
        needs += f" and no moment; the tangent is then at {there:.4g} deg"
    if nearest.distance <= settings.tolerance:
        held = "An end that is held can be stable where one under a load is not: see onebend shape --grip"
        return f"A force alone brings the point there: {needs}. {held}"
    where = f"({at[0]:.4g}, {at[1]:.4g}) mm, {1e3 * nearest.distance:.3g} mm away"
    return f"The nearest reachable point is {where}; {needs}"


def _result(
    candidate: ReachCandidate, goal: Array, settings: ReachSettings, why: str, nearest: NearestPoint | None = None
) -> Reach:
    """`why`: reason if the goal is not reached."""
    allowed = settings.tolerance if settings.method == "newton" else 2.0 * settings.paper.tolerance
    close = np.linalg.norm(candidate.reached[:2] - goal[:2]) <= allowed
    if not why and not (close and candidate.stable):
        why = "a force was found, but on nodes fine enough its shape is not stable, or not on the goal"
    return Reach(
        candidate.pushed,
        candidate.states,
        candidate.iterations,
        known=candidate.known,
        goal=goal,
        settings=settings,
        converged=not why,
        reason=why or "reached",
        nearest=nearest,
    )


def _by_paper(pushed: PushedBeam, goal: Array, settings: ReachSettings) -> Reach:
    """Algorithm 1, and the exact beam under its force."""
    force, iterations, settled = paper_force(pushed.beam, goal, pushed.push_s, pushed.point_s, settings.paper)
    trail, why = trace(pushed, np.append(force, 0.0)), ""
    off = float(np.linalg.norm(pushed.pose(trail.states[-1].q)[:2] - goal))
    if not settled:
        why = f"the paper's iteration did not settle within {iterations} turns"
    elif not trail.arrived:
        why = "the paper's iteration ends at a force under which the exact beam has no stable shape on its branch"
    elif off > 2.0 * settings.paper.tolerance:
        why = f"the paper's iteration settled, but under its force the exact beam is {1e3 * off:.3g} mm off"
    return _result(ReachCandidate(pushed, trail.states, iterations), goal, settings, why)


SURE = 0.95  # of the ellipse


def _squared_radius(level: float) -> float:
    """Squared Mahalanobis radius of a plane normal with probability `level`."""
    return -2.0 * math.log1p(-level)


@dataclass(frozen=True)
class ErrorEllipse:
    semi_axes: Array  # (2,) m, longer first
    angle: float  # rad, of the first

    def outline(self, count: int = 97) -> Array:
        """(count, 2) m."""
        turn = np.linspace(0.0, 2.0 * np.pi, count)
        cos, sin = math.cos(self.angle), math.sin(self.angle)
        along = np.stack([np.cos(turn), np.sin(turn)], axis=-1) * self.semi_axes
        return np.asarray(along @ np.array([[cos, sin], [-sin, cos]]))


@dataclass(frozen=True)
class PredictedError:
    """The reached point as a normal variable."""

    point: Array  # (2,) m, under the most probable k(s)
    mean: Array  # (2,) m, differs from `point` by nonlinearity
    covariance: Array  # (2, 2) m^2
    lost: float  # share of drawn beams that snap away

    def ellipse(self, level: float = SURE) -> ErrorEllipse:
        """Contains the real point with probability `level`."""
        values, vectors = np.linalg.eigh(self.covariance)
        size = np.sqrt(np.maximum(values[::-1], 0.0) * _squared_radius(level))
        return ErrorEllipse(size, math.atan2(vectors[1, 1], vectors[0, 1]))

    def distance(self, xy: Array) -> Array:
        """(...) squared Mahalanobis distance of (..., 2)."""
        away = np.asarray(xy, dtype=float) - self.mean
        return np.asarray(np.einsum("...i,ij,...j->...", away, np.linalg.pinv(self.covariance), away))

    def holds(self, xy: Array, level: float = SURE) -> bool:
        return bool(self.distance(xy) <= _squared_radius(level))


_DRAWS = 400
_NO_BOUND = (
    "{lost} of {draws} beams within the band do not stand under this load: its error has no bound. "
    "Learn the beam better, or take a goal with a smaller force"
)


@one_blas_thread
def predicted_error(
    beam: Beam,
    uncertain: UncertainStiffness,
    result: ReachCandidate,
    *,
    same_sensor: bool = False,
    draws: int = _DRAWS,
) -> PredictedError:
    """Uncertainty of the point under the load found, due to the band of k(s).

    `same_sensor`: the beam was learned with the sensor that gives the force; its scale error cancels. `draws`: beams
    drawn from the band; 0: first order in log k, faster, but too thin for long ellipses.

    Raises `ControlError`: beam, band and result do not match, or too few drawn beams are stable.
    """
    s = np.linspace(0.0, 1.0, 41)
    if beam != result.beam or not np.allclose(uncertain.profile(s), beam.stiffness(s), rtol=1e-6):
        raise ControlError("the band is not that of the beam that was led: give beam, band and result of one model")
    known = replace(uncertain, gain_sd=0.0) if same_sensor else uncertain
    if draws == 0:
        return PredictedError(result.reached[:2], result.reached[:2], _first_order(known, result), 0.0)
    beams = [replace(beam, stiffness=profile) for profile in known.draw(draws, seed=0)]
    problem = make_problems(beams, result.loads, result.resolution)
    solved = refine(problem, np.repeat(result.solved.q, draws, axis=0))
    stands = solved.converged & solved.stable
    if np.sum(stands) < max(3, draws // 2):
        raise ControlError(_NO_BOUND.format(lost=int(np.sum(~stands)), draws=draws))
    places = solved.xy(np.array([result.point_s]))[stands, 0]
    return PredictedError(result.reached[:2], np.mean(places, axis=0), np.cov(places.T), float(np.mean(~stands)))


def _first_order(known: UncertainStiffness, result: ReachCandidate) -> Array:
    """(2, 2) m^2."""
    nodes = result.solved.problem.grid.nodes
    basis = np.column_stack([known.basis(nodes), np.ones(len(nodes))])
    functions = np.asarray(result.beam.stiffness(nodes))[:, None] * basis
    moved = respond(result.solved, of_stiffness(result.solved, functions)).xy(np.array([result.point_s]))[0, 0]
    if not np.all(np.isfinite(moved)):
        raise ControlError("the shape is at a limit point, where the smallest error of k(s) is too much")
    common = known.gain_sd**2 * np.outer(moved[:, -1], moved[:, -1])
    return np.asarray(moved[:, :-1] @ known.covariance @ moved[:, :-1].T + common)


# In its set-up: Newton's method from the nearest of some forces, each grown from rest.

_MET = 1e-6  # of the length
_SHARES = np.array([0.1, 0.3, 0.5, 0.75, 1.0, 1.5, 2.5])  # of the largest force of the recording
_AROUND = 24  # directions
_STEP, _LONGEST, _MOST_TRIALS, _SHORTER = 1e-3, 0.3, 20, 0.3  # the first two likewise
_NOWHERE = 1e3  # sds: where the beam does not stand
_NEARLY, _KNOWN = 0.02, 0.1  # of the length: largest distance from a goal that is not met, and its larger semi-axis
_MOST_STARTS_IN_SETUP = 12
_ON_THE_WAY = 20


@dataclass(frozen=True)
class ReachInSetUp:
    """A force for a goal in the set-up in which the beam was learned, or in one with new parts."""

    beam: Beam
    settings: ReachSettings
    push_s: float
    point_s: float
    goal: Array  # (2,) m
    way: Bent  # P shapes from rest under a force that grows in proportion
    path: Array  # (P, 3) N, N, N m: that force, as the sensor of the set-up shows it
    iterations: int
    predicted: PredictedError  # of the point
    tag: int | None = None  # whose centre is the point; None: the axis at `point_s`

    stable, moment, nearest = True, 0.0, None  # as of `Reach`

    @property
    def converged(self) -> bool:
        """Whether the point is on its goal under the most probable k(s) and set-up."""
        return self.error < _MET * self.beam.length

    @property
    def reason(self) -> str:
        return "reached" if self.converged else "no force meets the goal; the 95 % ellipse of this one contains it"

    @property
    def force(self) -> Array:
        """(2,) N, as the sensor shows it."""
        return np.asarray(self.path[-1, :2])

    @property
    def on_beam(self) -> Array:
        """(2,) N."""
        return np.asarray(self.way.acting[-1])

    @property
    def reached(self) -> Array:
        """(3,) m, m, rad: the point, and the tangent there."""
        return np.append(self.path_points[-1], self.way.solved.angle(np.array([self.point_s]))[-1])

    @property
    def error(self) -> float:
        """m, from the goal, in the model."""
        return float(np.linalg.norm(self.path_points[-1] - self.goal))

    @property
    def path_points(self) -> Array:
        """(P, 2) m: the point."""
        return self.way.point(self.point_s, self.tag)

    def shapes(self, s: Array) -> Array:
        """(P, S, 2) m at `s` (S,)."""
        return self.way.xy(s)


@one_blas_thread
def reach_in_setup(
    beam: Beam,
    uncertain: UncertainStiffness,
    setup: SetUp,
    goal: ArrayLike,
    *,
    push_s: float | None = None,
    point_s: float = 1.0,
    tag: int | None = None,
    settings: ReachSettings = ReachSettings(),
    new: Iterable[Renewed] = (),
) -> ReachInSetUp:
    """As `reach`, for the set-up of the recording: its place of the push, clamp, sensor, section and length.

    The goal is in the frame of the recording. `new`: what is another one now, its parts drawn from their priors.
    `push_s`: default as in the recording. `tag`: the id of one of its tags, whose centre is then the point, in place of
    that of the axis at `point_s`. The error is that of draws from the joint posterior. `uncertain` is the band of
    `beam`. If no force up to 1.5 times the largest of the recording meets the goal, but a smaller one comes
    within 2 % of the length of it, and the 95 % ellipse of that one contains the goal, that one is the answer
    (`converged` is false). Raises `ControlError` where the goal cannot be reached, and as `reach`. Raises
    `MechanicsError`: a tag that the recording did not have.
    """
    wanted, point_s = checked_goal(goal, settings), point_s if tag is None else setup.tags[setup.tag_at(tag)]
    now = setup.renewed(new, push_s=push_s, length=beam.length)

    def bent(force: Array, at: tuple[Array, Array] | None = None, near: Array | None = None) -> Bent:
        return now.bent(beam, uncertain, force, at, near=near, gravity=settings.gravity)

    def at(force: Array) -> tuple[Array, BoolArray]:
        there = bent(force)
        return there.point(point_s, tag), there.stands

    def answer(force: Array, trials: int) -> ReachInSetUp:
        path = np.linspace(0.0, 1.0, _ON_THE_WAY + 1)[:, None] * force
        way = bent(path)
        bend = float(np.max(np.abs(way.solved.q - way.solved.problem.q0) / way.solved.problem.length))
        if wrong := broken_bound(float(np.hypot(*force)), bend, settings):
            raise ControlError(f"the goal is out of bounds in this set-up: {wrong}")
        felt = force + now.force_sd * np.random.default_rng([0, 1]).standard_normal((_DRAWS, 2))
        drawn = bent(felt, now.draw(uncertain, _DRAWS, seed=0), np.repeat(way.solved.q[-1:], _DRAWS, axis=0))
        if np.sum(drawn.stands) < max(3, _DRAWS // 2):
            raise ControlError(_NO_BOUND.format(lost=int(np.sum(~drawn.stands)), draws=_DRAWS))
        places, there = drawn.point(point_s, tag)[drawn.stands], way.point(point_s, tag)
        covariance = np.cov(places.T) + (now.discrepancy * np.linalg.norm(there[-1] - there[0])) ** 2 * np.eye(2)
        error = PredictedError(there[-1], np.mean(places, axis=0), covariance, float(np.mean(~drawn.stands)))
        loads = np.column_stack([path, np.zeros(len(path))])
        return ReachInSetUp(beam, settings, now.push_s, point_s, wanted, way, loads, trials, error, tag)

    largest = float(np.hypot(*setup.force))
    starts = _nearest_first(at, wanted, largest)
    tries = (_newton_in_setup(at, wanted, start, largest, _MET * beam.length) for start in starts)
    exact = next((one for one in tries if one is not None), None)
    if exact is None or now.beyond(exact[0]):
        with contextlib.suppress(ControlError):  # of that force alone
            spread = answer(np.zeros(2), 0).predicted.covariance
            smaller = answer(*_likely_in_setup(at, wanted, largest, spread))
            near = smaller.error < _NEARLY * beam.length
            known = smaller.predicted.ellipse().semi_axes[0] < _KNOWN * beam.length
            if near and known and smaller.predicted.holds(wanted):
                return smaller
    if exact is None:
        alone = reach(beam, wanted, push_s=now.push_s, point_s=point_s, settings=settings)
        size = float(np.hypot(*alone.force))
        why = (
            f"no force in this set-up puts the point on its goal; the beam alone would need {size:.3g} N, and it was "
            f"learned from {largest:.3g} N. Take a goal nearer to where the recording led the point, or learn from a "
            "harder push"
            if alone.converged
            else alone.reason
        )
        raise ControlError(why if tag is None else f"tag {tag}, at s = {point_s:.4g}: {why}")
    return answer(*exact)


_Led = Callable[[Array], tuple[Array, BoolArray]]  # (T, 2) m the point under forces (T, 2) N, (T,) whether it stands


def _nearest_first(at: _Led, goal: Array, largest: float) -> Array:
    """(n, 2) N: forces under which the point comes nearest to the goal, of many sizes and directions."""
    turn = np.arange(_AROUND) * (2.0 * np.pi / _AROUND)
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    starts = np.concatenate([np.zeros((1, 2)), *(largest * share * around for share in _SHARES)])
    places, stands = at(starts)
    away = np.linalg.norm(places - goal, axis=1)
    return np.asarray(starts[np.argsort(np.where(stands, away, np.inf))[:_MOST_STARTS_IN_SETUP]])


def _likely_in_setup(at: _Led, goal: Array, largest: float, spread: Array) -> tuple[Array, int]:
    """(2,) N of the greatest probability, and the number of trials, on the way from rest, where the point errs by
    `spread` (2, 2) [m^2] and each axis of the force has a normal density of the sd `largest`."""
    root = np.linalg.inv(np.linalg.cholesky(spread))

    def away(force: Array) -> Array:
        [place], [stands] = at(force[None])
        off = root @ (place - goal) if stands else np.full(2, _NOWHERE)
        return np.append(off, force / largest)

    found = least_squares(away, np.zeros(2), x_scale=largest, diff_step=_STEP, max_nfev=_MOST_TRIALS)
    return found.x, int(found.nfev)


def _newton_in_setup(at: _Led, goal: Array, base: Array, largest: float, met: float) -> tuple[Array, int] | None:
    """(2,) N that the sensor shows where the point is within `met` [m] of the goal, and the number of trials: from the
    force `base` (2,) [N], by steps that shorten until they come nearer."""
    change, best, step = np.zeros(2), np.inf, _STEP * largest
    for trial in range(_MOST_TRIALS):
        force = base + change
        places, stands = at(force + step * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
        off = float(np.linalg.norm(goal - places[0]))
        if not (np.all(stands) and off < best):
            change = _SHORTER * change
            continue
        if off < met:
            return force, trial
        base, best = force, off
        change = np.linalg.lstsq((places[1:] - places[0]).T / step, goal - places[0], rcond=1e-9)[0]
        change = change * min(1.0, _LONGEST * largest / float(np.hypot(*change)))
    return None
