"""The closed loop: design with margins, and correction by a camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import hypot, inf, isfinite, sqrt

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from onebend.beam.continuation import equilibrium, follow
from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, Rod, has_mass
from onebend.beam.sensitivity import of_force, respond
from onebend.beam.vibration import vibration
from onebend.control.goals import ComplexArray
from onebend.control.loaded_beam import prepared
from onebend.control.reach import ReachSettings, reach
from onebend.errors import ControlError, MechanicsError
from onebend.progress import one_blas_thread
from onebend.records import Array

# The beam about a working point, from the force at `push_s` to the position of `point_s`: small vibrations
# `eta_i'' + 2 zeta_i omega_i eta_i' + omega_i^2 eta_i = phi_i(push)^T F`, the point by `sum_i phi_i(point) eta_i`.
# Omitted modes respond at once, so that the static compliance is the exact `J(s_p) T^-1 J(s_a)^T` of (24).

MODES = 6
_SHORTEST_LAG = 1e-4  # s, for good conditioning


@dataclass(frozen=True)
class Plant:
    """A beam linearised about an equilibrium; m modes, none without a mass."""

    omega: Array  # (m,) rad/s
    damping: Array  # (m,) damping ratios
    pushed: Array  # (m, 2) kg^-1/2: modes at the force
    seen: Array  # (m, 2) kg^-1/2: modes at the point
    compliance: Array  # (2, 2) m/N, exact

    def stiffer(self, factor: float) -> Plant:
        """With all of k(s) times `factor`; exact without weight."""
        return replace(self, omega=sqrt(factor) * self.omega, compliance=self.compliance / factor)


def plant_at(
    beam: Rod,
    force: ArrayLike,
    *,
    push_s: float = 1.0,
    point_s: float = 1.0,
    damping_ratio: float = 0.05,
    gravity: ArrayLike | None = None,
) -> Plant:
    """The beam about its equilibrium under `force` (2,) N.

    `damping_ratio`: of the slowest vibration, proportional to frequency for others (Kelvin-Voigt).

    Raises `MechanicsError`: no stable equilibrium.
    """
    loads = push(np.asarray(force, dtype=float)[None], push_s)
    if gravity is not None:
        loads = loads + weight(gravity)
    solved = equilibrium(beam, loads)
    if not (solved.converged[0] and solved.stable[0]):
        raise MechanicsError(f"the beam has no stable shape under {np.asarray(force)} N to control it about")
    point = np.array([point_s])
    compliance = respond(solved, of_force(solved.problem, np.array([push_s]))).xy(point)[0, 0]
    if not has_mass(beam):
        return Plant(np.zeros(0), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)), compliance)
    small = vibration(beam, solved, count=MODES)
    omega = np.sqrt(small.squared)
    moved = small.moved(np.array([push_s, point_s]))
    return Plant(omega, damping_ratio * omega / omega[0], moved[:, 0], moved[:, 1], compliance)


@dataclass(frozen=True)
class StateSpace:
    """`x' = a x + b u`, `y = c x`: plant behind its actuator. N = 2 m + 2 states."""

    a: Array  # (N, N) 1/s
    b: Array  # (N, 2)
    c: Array  # (2, N)

    def over(self, time: float) -> tuple[Array, Array]:
        """The state after `time` s at constant input: (N, N), (N, 2)."""
        n = len(self.a)
        moved = expm(time * np.block([[self.a, self.b], [np.zeros((2, n + 2))]]))
        return moved[:n, :n], moved[:n, n:]


def behind_actuator(plant: Plant, lag: float) -> StateSpace:
    """With a first-order actuator of time constant `lag` s."""
    m, slow = len(plant.omega), max(lag, _SHORTEST_LAG)
    a = np.zeros((2 * m + 2, 2 * m + 2))
    a[:m, m : 2 * m] = np.eye(m)
    a[m : 2 * m, :m] = -np.diag(plant.omega**2)
    a[m : 2 * m, m : 2 * m] = -np.diag(2.0 * plant.damping * plant.omega)
    a[m : 2 * m, 2 * m :] = plant.pushed
    a[2 * m :, 2 * m :] = -np.eye(2) / slow
    b = np.vstack([np.zeros((2 * m, 2)), np.eye(2) / slow])
    omitted = plant.compliance - plant.seen.T @ (plant.pushed / plant.omega[:, None] ** 2)  # these respond at once
    c = np.hstack([plant.seen.T, np.zeros((2, m)), omitted])
    return StateSpace(a, b, c)


# Stability margins of the sampled loop. Every frame at `t_k = k / fps` the controller takes the error seen `delay`
# earlier, filters and integrates it, and holds the force to the next frame:
#
#     f_k = a f_(k-1) + (1 - a) e_k,    g_k = a g_(k-1) + (1 - a) f_k,    a = exp(-corner / fps)
#     u_k = u_(k-1) + (rate / fps) C^+ g_k
#
# The largest eigenvalue of this recursion with the plant decides stability (`SampledLoop.radius`); the eigenvalues of
# the 2 x 2 loop transfer on the unit circle give the phase margin.

_FREQUENCIES = 600
_SCAN_RATIO = 1.04
_MOST_SCAN_STEPS = 200


@dataclass(frozen=True)
class Timing:
    fps: float = 30.0  # 1/s
    delay: float = 0.05  # s, from exposure to the force
    lag: float = 0.02  # s, of the actuator

    def __post_init__(self) -> None:
        if not (0.0 < self.fps < inf and 0.0 <= self.delay < inf and 0.0 <= self.lag < inf):
            raise ControlError(
                f"a loop needs a frame rate above zero, a delay and a lag that are not negative, got "
                f"{self.fps:g} 1/s, {self.delay:g} s and {self.lag:g} s"
            )


@dataclass(frozen=True)
class Gains:
    """Rate of the integral, and corner of its two equal prefilters."""

    rate: float  # 1/s: the error falls as exp(-rate t) in the ideal case
    corner: float  # rad/s

    def __post_init__(self) -> None:
        if not (np.isfinite([self.rate, self.corner]).all() and self.rate > 0.0 and self.corner > 0.0):
            raise ControlError(f"gains must be finite and positive, got {self.rate:g} and {self.corner:g}")


@dataclass(frozen=True)
class SampledLoop:
    """A plant, and a controller with the map `inverse` from error to force."""

    plant: Plant
    inverse: Array  # (2, 2) N/m: C^+
    gains: Gains
    timing: Timing

    def _frame(self) -> tuple[Array, Array, Array, Array, int, float]:
        """Over one frame: the state from state (N, N) and force (N, 2), the camera's view (2, N) and (2, 2), whole
        frames of the delay, and the filter's factor."""
        linear, frames = behind_actuator(self.plant, self.timing.lag), self.timing.delay * self.timing.fps
        whole = int(np.floor(frames + 1e-9))
        a, b = linear.over(1.0 / self.timing.fps)
        seen, pushed = linear.over((1.0 - max(frames - whole, 0.0)) / self.timing.fps)
        return a, b, linear.c @ seen, linear.c @ pushed, whole, float(np.exp(-self.gains.corner / self.timing.fps))

    def matrix(self) -> Array:
        """(M, M): the loop from frame to frame."""
        a, b, seen, seen_by_force, whole, keep = self._frame()
        n = len(a)
        eye = np.eye(n + 2 * (whole + 4))
        state, late = eye[:n], eye[n : n + 2 * whole]  # views not delivered yet, then the oldest
        arrived, f, g, u = np.split(eye[n + 2 * whole :], 4)
        f = keep * f - (1.0 - keep) * arrived
        g = keep * g + (1.0 - keep) * f
        u = u + self.gains.rate / self.timing.fps * self.inverse @ g
        return np.vstack([a @ state + b @ u, seen @ state + seen_by_force @ u, late, f, g, u])

    @property
    def radius(self) -> float:
        """Spectral radius; stable below 1."""
        return float(np.max(np.abs(np.linalg.eigvals(self.matrix()))))

    def loci(self, frequency: Array) -> ComplexArray:
        """(R, 2): continuous characteristic loci at (R,) [rad/s]."""
        a, b, seen, seen_by_force, whole, keep = self._frame()
        z = np.exp(1j * frequency / self.timing.fps)
        inside = np.linalg.solve(z[:, None, None] * np.eye(len(a)) - a, np.broadcast_to(b, (len(z), *b.shape)))
        of_error = self.gains.rate / self.timing.fps * z / (z - 1.0) * ((1.0 - keep) * z / (z - keep)) ** 2
        transfer = (seen @ inside + seen_by_force) @ self.inverse
        found = np.linalg.eigvals((of_error * z ** -(whole + 1.0))[:, None, None] * transfer)
        before, here = found[:-1], found[1:]
        crossed = np.sum(np.abs(here - before), axis=1) > np.sum(np.abs(here[:, ::-1] - before), axis=1)
        swapped = np.append(False, np.cumsum(crossed) % 2 == 1)
        return np.where(swapped[:, None], found[:, ::-1], found)


@dataclass(frozen=True)
class Margins:
    """Infinite: no instability within a factor of 2500."""

    gain: float  # factor
    phase: float  # rad, lag in all directions; infinite if the gain never reaches 1
    delay: float  # s, beyond the loop's own
    softest: float  # smallest true k over model k with a stable loop
    radius: float  # of the loop; unless below 1 the rest is 0 or NaN


def margins(loop: SampledLoop) -> Margins:
    radius = loop.radius
    if not radius < 1.0:
        return Margins(0.0, 0.0, 0.0, np.nan, radius)

    def stiffer(factor: float) -> SampledLoop:
        return replace(loop, plant=loop.plant.stiffer(1.0 / factor))

    def later(extra: float) -> SampledLoop:
        return replace(loop, timing=replace(loop.timing, delay=loop.timing.delay + extra - _SHORTEST_DELAY))

    return Margins(
        gain=onset(lambda g: replace(loop, gains=replace(loop.gains, rate=g * loop.gains.rate))),
        phase=phase_margin(loop),
        delay=onset(later, first=_SHORTEST_DELAY) - _SHORTEST_DELAY,
        softest=1.0 / onset(stiffer),
        radius=radius,
    )


_SHORTEST_DELAY = 0.01  # s


def onset(of: Callable[[float], SampledLoop], *, first: float = 1.0) -> float:
    """The smallest number above `first` at which `of` is unstable, to 1e-4."""
    low = first
    for _ in range(_MOST_SCAN_STEPS):
        high = low * _SCAN_RATIO
        if of(high).radius >= 1.0:
            while high - low > 1e-4 * low:
                middle = 0.5 * (low + high)
                low, high = (low, middle) if of(middle).radius >= 1.0 else (middle, high)
            return 0.5 * (low + high)
        low = high
    return np.inf


def phase_margin(loop: SampledLoop) -> float:
    """rad: least further lag at which a locus meets -1."""
    loci = loop.loci(frequencies(loop.timing))
    return min((_least_lag(curve) for curve in loci.T), default=np.inf)


def frequencies(timing: Timing) -> Array:
    """rad/s, up to half the frame rate."""
    return np.geomspace(1e-4, 1.0, _FREQUENCIES) * np.pi * timing.fps


def _least_lag(curve: ComplexArray) -> float:
    size, angle = np.log(np.abs(curve)), np.unwrap(np.angle(curve))
    at = np.flatnonzero(size[:-1] * size[1:] < 0.0)
    share = size[at] / (size[at] - size[at + 1])
    lags = np.mod(angle[at] + share * (angle[at + 1] - angle[at]) + np.pi, 2.0 * np.pi)
    return float(np.min(lags, initial=np.inf))


_CORNERS = np.geomspace(1.0, 100.0, 13)  # rad/s, of the filter
_FASTEST, _SLOWEST = 20.0, 0.02  # 1/s, of the integral


@dataclass(frozen=True)
class RequiredMargins:
    gain: float = 2.0
    phase: float = np.deg2rad(40.0)
    k_error: float = 0.3  # relative, either way

    def __post_init__(self) -> None:
        if not (self.gain > 1.0 and 0.0 < self.phase < 0.5 * np.pi and 0.0 <= self.k_error < 1.0):
            raise ControlError(
                "wanted margins are a gain above 1, a phase between 0 and a right angle, and an error of k below 1, "
                f"got {self.gain:g}, {np.rad2deg(self.phase):g} deg and {self.k_error:g}"
            )


def tuned(plants: list[tuple[Plant, Array]], timing: Timing, wanted: RequiredMargins) -> Gains:
    """Gains for plants with their maps (2, 2) [N/m] from error to force.

    For each corner the largest rate that keeps the margins, then the corner with the largest rate.
    """
    best = Gains(_SLOWEST, float(_CORNERS[0]))
    grid = frequencies(timing)
    for corner in _CORNERS:
        rate = min(
            _largest(SampledLoop(plant.stiffer(factor), inverse, Gains(1.0, float(corner)), timing).loci(grid), wanted)
            for plant, inverse in plants
            for factor in (1.0 - wanted.k_error, 1.0, 1.0 + wanted.k_error)
        )
        if rate > best.rate:
            best = Gains(rate, float(corner))
    return best


def _largest(loci: ComplexArray, wanted: RequiredMargins) -> float:
    """The largest factor on loci (R, 2) that keeps both margins."""
    lag, size = -np.unwrap(np.angle(loci), axis=0), np.abs(loci)
    unit = float(np.max(size, initial=1e-9, where=lag > np.pi - wanted.phase))
    real = float(np.max(size, initial=1e-9, where=lag > np.pi))
    return min(_FASTEST, 1.0 / unit, 1.0 / (wanted.gain * real))


# The closed loop. The model gives forces from the present state to the goal (feedforward) and the positions on the way
# (reference). In every frame the error against the reference at exposure is filtered, multiplied by the model's inverse
# compliance there, and integrated. With a wrong k(s) the integral converges to the missing force.

_REFERENCE_PLACES = 33  # of the reference
_GOAL_TOLERANCE = 1e-4  # share of the length
_COARSE_RESOLUTION = Resolution(8)  # need not be exact
_COMPLIANCE_SCALES = np.geomspace(0.6, 1.0 / 0.6, 9)
# Share of the length: such an error is as likely as a factor e in k.
_POSITION_TRUST = 0.02


@dataclass(frozen=True)
class ControllerSettings:
    timing: Timing = field(default_factory=Timing)
    longest_delay: float = 0.1  # s, for the margins
    damping_ratio: float = 0.03  # of the slowest vibration; low is safe
    wanted: RequiredMargins = field(default_factory=RequiredMargins)
    gains: Gains | None = None  # None: the fastest with these margins
    weak: float = 0.01  # below this share of the largest compliance: corrected slowly
    most_force: float = inf  # N
    rise: float | None = None  # s; None: two periods of the slowest vibration, at least 1 s
    feedforward: bool = True
    feedback: bool = True

    def __post_init__(self) -> None:
        if not (self.most_force > 0.0 and self.weak > 0.0 and 0.0 < self.damping_ratio < 1.0):
            raise ControlError(
                "a loop needs a bound on the force and a share `weak` above zero, and a damping ratio between 0 and 1, "
                f"got {self.most_force} N, {self.weak} and {self.damping_ratio}"
            )
        if not isfinite(self.longest_delay) or self.longest_delay < 0.0:
            raise ControlError(f"the longest delay must be finite and not negative, got {self.longest_delay} s")
        if self.rise is not None and not (isfinite(self.rise) and self.rise > 0.0):
            raise ControlError(f"the way to a goal takes a positive time, got {self.rise} s")


@dataclass(frozen=True)
class Reference:
    """The model on its way to the goal: P places, equal steps of force."""

    begins: Array  # (2,) N
    ends: Array  # (2,) N
    rise: float  # s
    xy: Array  # (P, 2) m of the point

    def share(self, time: float) -> float:
        """Of the way at `time` s: a quintic without velocity and acceleration at its ends."""
        x = min(max(time / self.rise, 0.0), 1.0)
        return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)

    def force(self, time: float) -> Array:
        """(2,) N."""
        return np.asarray(self.begins + self.share(time) * (self.ends - self.begins))

    def position(self, time: float) -> Array:
        """(2,) m."""
        along = self.share(time) * (len(self.xy) - 1)
        low = min(int(along), len(self.xy) - 2)
        return np.asarray(self.xy[low] + (along - low) * (self.xy[low + 1] - self.xy[low]))


@dataclass(frozen=True)
class ControllerState:
    began: float  # s
    correction: Array  # (2,) N: the integral
    filtered: Array  # (2, 2) m: error behind the first filter, and both
    frame_at: float  # s


@dataclass(frozen=True)
class Controller:
    """An immutable controller for one goal."""

    beam: Beam
    goal: Array  # (2,) m
    push_s: float
    point_s: float
    gravity: Array  # (2,) m/s^2
    reference: Reference
    inverse: Array  # (2, 2) N/m: from position error to force
    plant: Plant  # the model at the goal
    gains: Gains
    settings: ControllerSettings

    @one_blas_thread
    def begin(self, time: float, correction: ArrayLike = (0.0, 0.0)) -> ControllerState:
        """Starts the way to the goal at `time` s; `correction` (2,) N of an earlier state."""
        return ControllerState(time, np.asarray(correction, dtype=float), np.zeros((2, 2)), time)

    @one_blas_thread
    def step(self, state: ControllerState, seen: ArrayLike | None, time: float) -> tuple[ControllerState, Array]:
        """The force (2,) N from `time` s on, and the next state.

        `seen`: the point (2,) m in a frame that has just arrived; None: no frame, NaN: hidden. Call as often as the
        force can be set.
        """
        if seen is not None and self.settings.feedback:
            position = np.asarray(seen, dtype=float)
            if position.shape != (2,):
                raise ControlError(f"the loop sees one position (2,) [m], got shape {position.shape}")
            if isfinite(position[0]) and isfinite(position[1]):
                state = self._corrected(state, position, time)
        wanted = self._feedforward(time - state.began) + state.correction
        return state, bounded(wanted, self.settings.most_force)

    @one_blas_thread
    def margins(self) -> Margins:
        """At the goal, with the model's k(s)."""
        return margins(SampledLoop(self.plant, self.inverse, self.gains, self.settings.timing))

    def _corrected(self, state: ControllerState, position: Array, time: float) -> ControllerState:
        """A gap counts as one frame."""
        since = time - state.began
        passed = min(time - state.frame_at, 1.0 / self.settings.timing.fps)
        if not passed > 0.0:
            return state
        late = self.settings.timing.delay + self.settings.timing.lag
        error = self.reference.position(since - late) - position
        keep = np.exp(-self.gains.corner * passed)
        once = keep * state.filtered[0] + (1.0 - keep) * error
        filtered = np.stack([once, keep * state.filtered[1] + (1.0 - keep) * once])
        feedforward = self._feedforward(since)
        inverse = self.inverse_at(feedforward + state.correction, since)
        correction = state.correction + self.gains.rate * passed * inverse @ filtered[1]
        within = bounded(feedforward + correction, self.settings.most_force) - feedforward
        return replace(state, correction=within, filtered=filtered, frame_at=time)

    def inverse_at(self, force: Array, since: float) -> Array:
        """(2, 2) N/m: from position error to force, under `force` at `since` s.

        Among beams with the model's k(s) times 1/c, the one nearest to the reference is used: the model's shape under c
        times the force, and c times its compliance. Without a stable shape, the map at the goal.
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

    def _feedforward(self, since: float) -> Array:
        return self.reference.force(since) if self.settings.feedforward else self.reference.begins


def bounded(force: Array, most: float) -> Array:
    """(2,) N, shortened to `most`."""
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
    """The loop that brings r(`point_s`) to `goal` (2,) [m] by a force at `push_s`; `start`: the present force [N]."""
    wanted, begins = np.asarray(goal, dtype=float), np.asarray(start, dtype=float)
    x, y = np.asarray(gravity, dtype=float).tolist()
    bounds = ReachSettings(gravity=(x, y), max_force=settings.most_force)
    result = reach(beam, wanted, push_s=push_s, point_s=point_s, settings=bounds)
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
    """(2, 2) N/m: `C^T (C C^T + (weak |C|)^2)^-1`; directions with little compliance are corrected slowly."""
    least = weak * np.linalg.norm(compliance, 2)
    return np.asarray(compliance.T @ np.linalg.inv(compliance @ compliance.T + least**2 * np.eye(2)))
