"""The closed loop: the model's force for a goal, corrected by what the camera sees.

The model gives forces that lead from the beam's present state to the goal (feedforward), and the positions that belong
to them (the reference). In every frame the measured position is compared with the reference at the time of exposure.
The error is filtered, multiplied by the inverse compliance of the model at that working point, and integrated
(integral action in task space). Where k(s) is wrong, the integral converges to the force that was missing. Where the
force on the beam is felt as well, the robot is asked for more or less until it is the wanted one (`felt.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import hypot, inf, isfinite

import numpy as np
from numpy.typing import ArrayLike

from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.statics.continuation import equilibrium, follow
from onebend.beam.statics.problem import Resolution
from onebend.beam.statics.sensitivity import of_force, respond
from onebend.blas import one_blas_thread
from onebend.control.loop.felt import Felt, FeltFrame, Offset, felt_in
from onebend.control.loop.margins import Gains, Margins, SampledLoop, Timing, margins
from onebend.control.loop.plant import Plant, plant_at
from onebend.control.loop.tuning import RequiredMargins, tuned
from onebend.control.reach.loaded_beam import prepared
from onebend.control.reach.reach import ReachSettings, reach
from onebend.errors import ControlError
from onebend.records import Array

_REFERENCE_PLACES = 33  # of the reference path
_GOAL_TOLERANCE = 1e-4  # share of the length by which the path's end may miss the goal
_COARSE_RESOLUTION = Resolution(8)  # of the shape behind the map from error to force, which need not be exact
_COMPLIANCE_SCALES = np.geomspace(0.6, 1.0 / 0.6, 9)  # of the model's compliance
# Share of the length: an error of the position this large is as likely as a factor e in k.
_POSITION_TRUST = 0.02


@dataclass(frozen=True)
class ControllerSettings:
    """What is known about the loop, and the margins it must have."""

    timing: Timing = field(default_factory=Timing)  # as known or guessed
    longest_delay: float = 0.1  # s: the margins are kept up to here
    damping_ratio: float = 0.03  # of the slowest vibration; a guess on the low side is safe
    wanted: RequiredMargins = field(default_factory=RequiredMargins)
    gains: Gains | None = None  # None: the fastest that keep the margins
    weak: float = 0.01  # a direction whose compliance is below this share of the largest is corrected slowly
    most_force: float = inf  # N, the bound on the wanted force; `felt` adds to it what the robot lacks
    force_sd: float = 0.2  # N, of how far the robot's force is off; counts where the force is felt
    rise: float | None = None  # s, from start to goal; None: two periods of the slowest vibration, 1 s at least
    feedforward: bool = True
    feedback: bool = True

    def __post_init__(self) -> None:
        if not (self.most_force > 0.0 and self.weak > 0.0 and 0.0 < self.damping_ratio < 1.0):
            raise ControlError(
                "a loop needs a bound on the force and a share `weak` above zero, and a damping ratio between 0 and 1, "
                f"got {self.most_force} N, {self.weak} and {self.damping_ratio}"
            )
        if not (isfinite(self.force_sd) and self.force_sd > 0.0):
            raise ControlError(f"a robot's force is off by a finite sd above zero, got {self.force_sd} N")
        if not isfinite(self.longest_delay) or self.longest_delay < 0.0:
            raise ControlError(f"the longest delay must be finite and not negative, got {self.longest_delay} s")
        if self.rise is not None and not (isfinite(self.rise) and self.rise > 0.0):
            raise ControlError(f"the way to a goal takes a positive time, got {self.rise} s")


@dataclass(frozen=True)
class Reference:
    """Where the model's beam is on its way to the goal: P places, at equal steps of the force."""

    begins: Array  # (2,) N
    ends: Array  # (2,) N
    rise: float  # s
    xy: Array  # (P, 2) m: the point's positions

    def share(self, time: float) -> float:
        """Of the way, `time` s after its start: the quintic that starts and ends without velocity or acceleration."""
        x = min(max(time / self.rise, 0.0), 1.0)
        return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)

    def force(self, time: float) -> Array:
        """(2,) N."""
        return np.asarray(self.begins + self.share(time) * (self.ends - self.begins))

    def position(self, time: float) -> Array:
        """(2,) m."""
        low, part = self._place(time)
        return np.asarray((1.0 - part) * self.xy[low] + part * self.xy[low + 1])

    def _place(self, time: float) -> tuple[int, float]:
        along = self.share(time) * (len(self.xy) - 1)
        low = min(int(along), len(self.xy) - 2)
        return low, along - low


@dataclass(frozen=True)
class ControllerState:
    """The state of a controller. `Controller.begin` makes the first."""

    began: float  # s
    correction: Array  # (2,) N: the integral
    filtered: Array  # (2, 2) m: the error behind the first filter, and behind both
    frame_at: float  # s: when the last frame that counted arrived
    offset: Offset = field(default_factory=Offset)  # what the felt force adds to what is asked for


@dataclass(frozen=True)
class Controller:
    """A controller for one goal. It is constant; what changes is its `ControllerState`."""

    beam: Beam
    goal: Array  # (2,) m
    push_s: float
    point_s: float
    gravity: Array  # (2,) m/s^2
    reference: Reference
    inverse: Array  # (2, 2) N/m: the map from position error to force at the goal
    plant: Plant  # the model at the goal
    gains: Gains
    settings: ControllerSettings

    @one_blas_thread
    def begin(self, time: float, correction: ArrayLike = (0.0, 0.0), offset: ArrayLike = (0.0, 0.0)) -> ControllerState:
        """The state in which the way to the goal starts at `time` s; `offset` (2,) N: of the state before."""
        carried = np.asarray(correction, dtype=float)
        begun = Offset(np.asarray(offset, dtype=float), carried, frame_at=time)
        return ControllerState(time, carried, np.zeros((2, 2)), time, begun)

    @one_blas_thread
    def step(
        self, state: ControllerState, seen: ArrayLike | None, time: float, *, felt: Felt | None = None
    ) -> tuple[ControllerState, Array]:
        """The force (2,) N to ask for from `time` s on, and the state after it.

        `seen`: the point's position (2,) m in a frame that has just arrived; None where none has, NaN where the point
        was hidden in it. Both leave the integral as it is. `felt`: the force on the beam in a frame that has just
        arrived, as a sensor or the beam's shape tells it. Call it as often as the force can be set.
        """
        shown = False
        if seen is not None and self.settings.feedback:
            position = np.asarray(seen, dtype=float)
            if position.shape != (2,):
                raise ControlError(f"the loop sees one position (2,) [m], got shape {position.shape}")
            shown = isfinite(position[0]) and isfinite(position[1])
            if shown:
                state = self._corrected(state, position, time)
        if felt is not None:
            timing = self.settings.timing
            late = timing.delay + timing.lag
            wanted = self._feedforward(time - state.began - late)
            frame = FeltFrame(felt, wanted, state.correction, shown, time, late)
            put_right = felt_in(state.offset, frame, self.gains, fps=timing.fps, sd=self.settings.force_sd)
            state = replace(state, offset=put_right)
        return state, self._wished(state, time)

    @one_blas_thread
    def margins(self) -> Margins:
        """How far the loop at the goal is from ringing, k(s) being the model's."""
        return margins(SampledLoop(self.plant, self.inverse, self.gains, self.settings.timing))

    def _corrected(self, state: ControllerState, position: Array, time: float) -> ControllerState:
        """The state after one frame. A gap counts as one frame: time without a measurement adds no correction."""
        since = time - state.began
        passed = min(time - state.frame_at, 1.0 / self.settings.timing.fps)
        if not passed > 0.0:
            return state
        late = self.settings.timing.delay + self.settings.timing.lag
        error = self.reference.position(since - late) - position
        keep = np.exp(-self.gains.corner * passed)
        once = keep * state.filtered[0] + (1.0 - keep) * error
        twice = keep * state.filtered[1] + (1.0 - keep) * once
        feedforward = self._feedforward(since)
        inverse = self.inverse_at(feedforward + state.correction, since)
        correction = state.correction + self.gains.rate * passed * inverse @ twice
        within = bounded(feedforward + correction, self.settings.most_force) - feedforward
        return replace(state, correction=within, filtered=np.stack([once, twice]), frame_at=time)

    def inverse_at(self, force: Array, since: float) -> Array:
        """(2, 2) N/m: the map from position error to force where the beam stands under `force` at `since` s.

        Among the beams with k(s) of the model times 1/c, the one nearest to the reference under this force is taken.
        Its shape is that of the model under c times the force, its compliance c times the model's there. Where the
        model has no stable shape, the map at the goal is used.
        """
        point = np.array([self.point_s])
        x, y = self.gravity.tolist()
        under = prepared(self.beam, self.push_s, self.point_s, (x, y), _COARSE_RESOLUTION).loaded(np.append(force, 0.0))
        solved = follow(under.take(np.zeros(len(_COMPLIANCE_SCALES), dtype=int)).loaded(_COMPLIANCE_SCALES))
        off = solved.xy(point)[:, 0] - self.reference.position(since)
        cost = np.sum(off**2, axis=1) + (_POSITION_TRUST * self.beam.length * np.log(_COMPLIANCE_SCALES)) ** 2
        cost[~(solved.converged & solved.stable)] = inf
        best = int(np.argmin(cost))
        if not isfinite(cost[best]):
            return self.inverse
        compliance = respond(solved, of_force(solved.problem, np.array([self.push_s]))).xy(point)[best, 0]
        return damped_inverse(_COMPLIANCE_SCALES[best] * compliance, self.settings.weak)

    def _wished(self, state: ControllerState, time: float) -> Array:
        wanted = self._feedforward(time - state.began) + state.correction
        return bounded(wanted, self.settings.most_force) + state.offset.force

    def _feedforward(self, since: float) -> Array:
        return self.reference.force(since) if self.settings.feedforward else self.reference.begins


def bounded(force: Array, most: float) -> Array:
    """(2,) N: the force, shortened to `most`."""
    size = hypot(force[0], force[1])
    return force if size <= most else np.asarray(force * (most / size))


@one_blas_thread
def controller(
    beam: Beam,
    goal: ArrayLike,
    *,
    push_s: float = 1.0,
    point_s: float = 1.0,
    gravity: ArrayLike = (0.0, 0.0),
    start: ArrayLike = (0.0, 0.0),
    settings: ControllerSettings = ControllerSettings(),
) -> Controller:
    """The loop that brings r(`point_s`) to `goal` (2,) [m] by a force at `push_s`; `start`: the force now [N]."""
    wanted, begins = np.asarray(goal, dtype=float), np.asarray(start, dtype=float)
    result = reach(beam, wanted, push_s=push_s, point_s=point_s, settings=_as_reach(gravity, settings))
    if not result.converged:
        raise ControlError(result.reason)
    ends = result.force
    forces = begins + np.linspace(0.0, 1.0, _REFERENCE_PLACES)[:, None] * (ends - begins)
    solved = equilibrium(beam, push(forces, push_s) + weight(gravity))
    xy = solved.xy(np.array([point_s]))[:, 0]
    if not np.all(solved.converged & solved.stable) or np.linalg.norm(xy[-1] - wanted) > _GOAL_TOLERANCE * beam.length:
        raise ControlError(
            f"the force cannot go straight from {np.round(begins, 4)} N to the goal's {np.round(ends, 4)} N: the beam "
            "would snap through on the way. Give goals between"
        )
    compliance = respond(solved, of_force(solved.problem, np.array([push_s]))).xy(np.array([point_s]))[-1, 0]
    inverse = damped_inverse(compliance, settings.weak)
    places = (_REFERENCE_PLACES // 2, _REFERENCE_PLACES - 1)
    plants = [
        plant_at(beam, forces[i], push_s=push_s, point_s=point_s, damping_ratio=settings.damping_ratio, gravity=gravity)
        for i in places
    ]
    late = replace(settings.timing, delay=max(settings.longest_delay, settings.timing.delay))
    ways = [(plant, damped_inverse(plant.compliance, settings.weak)) for plant in plants]
    gains = settings.gains or tuned(ways, late, settings.wanted)
    periods = [4.0 * np.pi / plant.omega[0] for plant in plants if len(plant.omega)]
    rise = settings.rise if settings.rise is not None else max([1.0, *periods])
    reference = Reference(begins, ends, rise, xy)
    down = np.asarray(gravity, dtype=float)
    return Controller(beam, wanted, push_s, point_s, down, reference, inverse, plants[-1], gains, settings)


def damped_inverse(compliance: Array, weak: float) -> Array:
    """(2, 2) N/m: `C^T (C C^T + (weak |C|)^2)^-1`. A direction with little compliance is corrected slowly."""
    least = weak * np.linalg.norm(compliance, 2)
    return np.asarray(compliance.T @ np.linalg.inv(compliance @ compliance.T + least**2 * np.eye(2)))


def _as_reach(gravity: ArrayLike, settings: ControllerSettings) -> ReachSettings:
    x, y = np.asarray(gravity, dtype=float)
    most = settings.most_force if isfinite(settings.most_force) else None
    return ReachSettings(gravity=(float(x), float(y)), max_force=most)
