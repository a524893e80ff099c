"""A rehearsal of the closed loop: a beam that is not the model, in full motion (7), under an actuator and a camera."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from onebend.beam.actions import Actions, Force, acting
from onebend.beam.collocation import Method, tableau
from onebend.beam.dynamics import Body, body
from onebend.beam.model import Beam
from onebend.beam.modes import Modes
from onebend.beam.problem import Resolution
from onebend.beam.stepping import Stepper
from onebend.beam.stiffness import Scaled
from onebend.control.feedback import Controller
from onebend.errors import MechanicsError
from onebend.records import Array

_METHOD = Method(3, "radau")


@dataclass(frozen=True)
class Eye:
    """The camera and all that lies between it and the controller."""

    fps: float = 30.0
    delay: float = 0.05  # s, from exposure to arrival
    jitter: float = 0.0  # s, sd of the delay of a frame
    noise: float = 5e-5  # m, sd of each coordinate
    dropped: float = 0.0  # share of frames that never arrive
    hidden: tuple[tuple[float, float], ...] = ()  # s, times in which the point is not seen


@dataclass(frozen=True)
class Hand:
    """The robot that applies the force."""

    lag: float = 0.02  # s, time constant
    gain: float = 1.0
    bias: tuple[float, float] = (0.0, 0.0)  # N


@dataclass(frozen=True)
class Truth:
    """The beam that is really there, and what is done to it."""

    beam: Beam
    damping_ratio: float = 0.05  # of the slowest vibration about rest
    push_s: float = 1.0
    point_s: float = 1.0
    gravity: tuple[float, float] = (0.0, 0.0)
    eye: Eye = field(default_factory=Eye)
    hand: Hand = field(default_factory=Hand)
    modes: int = 8


@dataclass(frozen=True)
class Rehearsal:
    """What happened: T times."""

    goal: Array  # (2,) m
    time: Array  # (T,) s
    xy: Array  # (T, 2) m, where the point was
    asked: Array  # (T, 2) N, the force that the controller asked for
    force: Array  # (T, 2) N, the force on the beam

    @property
    def error(self) -> Array:
        """(T,) m, distance from the goal."""
        return np.asarray(np.linalg.norm(self.xy - self.goal, axis=1))

    def steady(self, last: float = 1.0) -> float:
        """m: the largest distance from the goal in the last seconds."""
        return float(np.max(self.error[self.time > self.time[-1] - last]))

    def settled(self, within: float) -> float:
        """s: time after which the point stays `within` m of the goal; infinite where it does not."""
        outside = np.flatnonzero(self.error > within)
        if not outside.size:
            return 0.0
        return float(self.time[outside[-1] + 1]) if outside[-1] + 1 < len(self.time) else np.inf


def rehearse(
    control: Controller, truth: Truth, duration: float, *, seed: int = 0, tick: float = 1.0 / 240.0
) -> Rehearsal:
    """Run `control` on `truth` from rest for `duration` s; the force is set anew every `tick` s.

    Raises:
        MechanicsError: the beam's mass is not known, or its motion could not be followed.
    """
    on = _body(truth)
    rng = np.random.default_rng(seed)
    stepper, numbers = Stepper(on, tableau(_METHOD), tick, tolerance=1e-8), tableau(_METHOD)
    theta, momentum, guess = np.zeros(on.n), np.zeros(on.n), np.zeros((on.n, len(numbers.c)))
    count = int(np.ceil(duration / tick))
    arrivals = _frames(truth.eye, duration, rng)
    state, force = control.begin(0.0), np.zeros(2)
    rows = np.zeros((count + 1, 7))
    place = np.array([truth.point_s])
    for i in range(count + 1):
        now = i * tick
        rows[i, 0], rows[i, 1:3], rows[i, 5:] = now, on.xy(place, theta[None])[0, 0], force
        asked = None
        while arrivals and arrivals[0][0] <= now + 1e-9:
            _, exposed, noise = arrivals.popleft()
            at = np.array([np.interp(exposed, rows[: i + 1, 0], rows[: i + 1, c]) for c in (1, 2)])
            state, asked = control.step(state, at + noise, now)
        if asked is None:
            state, asked = control.step(state, None, now)
        rows[i, 3:5] = asked
        goes_to, begin, lag = truth.hand.gain * asked + np.array(truth.hand.bias), force, truth.hand.lag

        def applied(t: float, now: float = now, a: Array = begin, b: Array = goes_to, lag: float = lag) -> Array:
            return b + (a - b) * np.exp(-(t - now) / lag)

        acts = acting(
            on, Actions((Force(applied, truth.push_s),), gravity=truth.gravity), now + tick * numbers.c
        )
        found = stepper.advance(theta, momentum, guess, acts, now)
        theta, momentum, guess = found.theta, found.momentum, found.velocity @ numbers.ahead.T
        force = applied(now + tick)
    return Rehearsal(control.goal, rows[:, 0], rows[:, 1:3], rows[:, 3:5], rows[:, 5:])


def _body(truth: Truth) -> Body:
    from onebend.beam.motion import State
    from onebend.beam.vibration import vibration_of

    plain = body(truth.beam, Modes(truth.modes), resolution=Resolution(24))
    omega = 2.0 * np.pi * vibration_of(plain, State(np.zeros(plain.n), np.zeros(plain.n))).frequency[0]
    damping = Scaled(2.0 * truth.damping_ratio / omega, truth.beam.stiffness)
    return body(truth.beam, Modes(truth.modes), damping=damping, resolution=Resolution(24))


def _frames(eye: Eye, duration: float, rng: np.random.Generator) -> deque[tuple[float, float, Array]]:
    """Arrival, exposure and noise (2,) of every frame, in the order of arrival; NaN where the point is hidden."""
    exposed = np.arange(0.0, duration, 1.0 / eye.fps)
    arrives = exposed + np.maximum(eye.delay + eye.jitter * rng.standard_normal(len(exposed)), 0.0)
    noise = eye.noise * rng.standard_normal((len(exposed), 2))
    for first, last in eye.hidden:
        noise[(exposed >= first) & (exposed < last)] = np.nan
    kept = np.flatnonzero(rng.random(len(exposed)) >= eye.dropped)
    order = kept[np.argsort(arrives[kept], kind="stable")]
    return deque((float(arrives[j]), float(exposed[j]), noise[j]) for j in order)
