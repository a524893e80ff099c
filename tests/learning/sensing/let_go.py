"""A beam that is pushed and let go, or led back by a hand, in motion: what a camera sees of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.continuation import equilibrium
from onebend.beam.dynamics import Actions, AppliedForce, Body, body
from onebend.beam.grid import Modes
from onebend.beam.integration import simulate
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.stiffness import Scaled, Uniform
from onebend.beam.vibration import settle, vibration
from onebend.records import Array, Observations
from tests.learning.sensing.drawn import drawn_shapes, place_off

FINE = 1e-3  # s, a step of the motion
_REST, _RISE = 0.25, 0.6  # s before the push, and in which it grows


@dataclass(frozen=True)
class Release:
    """How a push ends, and how it is filmed."""

    kind: str  # "let go" within `fall`, "led" back by a hand that keeps to the beam as long as it can, or "slow"
    end: float  # s, when the force is zero
    fall: float  # s, in which it goes to zero
    shape: int  # of the fall: straight, as a cosine, or as a square
    hz: float  # the beam's lowest natural frequency
    damping: float  # ratio of it
    fps: float
    noise: tuple[float, float]  # m, rad
    force: tuple[float, float]  # N, at its largest
    after: float = 0.9  # s of the film after the end


@dataclass(frozen=True)
class Seen:
    """Shapes of a motion at the times of the frames."""

    on: Body
    theta: Array  # (F, n)

    def xy(self, s: Array) -> Array:
        return self.on.xy(s, self.theta)

    def angle(self, s: Array) -> Array:
        return self.on.angle(s, self.theta)


def release(seed: int, kind: str = "let go") -> Release:
    """One of many."""
    rng = np.random.default_rng([seed, 17])
    falls = {"let go": rng.uniform(0.0, 0.1), "led": rng.uniform(0.8, 2.0), "slow": rng.uniform(0.6, 1.0)}
    size, turn = rng.uniform(0.1, 0.3), rng.uniform(0.9, 2.2)
    return Release(
        kind=kind,
        end=_REST + _RISE + falls[kind] + rng.uniform(0.3, 0.5),
        fall=falls[kind],
        shape=int(rng.integers(3)),
        hz=float(np.exp(rng.uniform(np.log(2.5), np.log(8.0)))),
        damping=float(np.exp(rng.uniform(np.log(0.02), np.log(0.3)))),
        fps=float(rng.choice([30.0, 60.0, 120.0, 240.0])),
        noise=((8e-5, 3e-3), (3e-5, 1e-3), (1e-5, 3e-4))[int(rng.integers(3))],
        force=(size * float(np.cos(turn)), size * float(np.sin(turn))),
        after=float(rng.uniform(0.6, 2.0)),
    )


def sized(one: Release, time: Array) -> Array:
    """Of the largest force, at `time`."""
    rise = _smooth((time - _REST) / _RISE)
    left = np.clip((one.end - time) / one.fall, 0.0, 1.0)  # of the fall
    if one.kind == "led":
        omega, loss = 2.0 * np.pi * one.hz, 2.0 * one.damping / (2.0 * np.pi * one.hz)
        rate, bend = _smooth_rates(left)
        return np.asarray(rise * np.maximum(_smooth(left) - loss * rate / one.fall + bend / (omega * one.fall) ** 2, 0))
    falls = (left, 0.5 - 0.5 * np.cos(np.pi * left), left**2)
    return np.asarray(rise * falls[one.shape])


def moved(seed: int, one: Release) -> tuple[Observations, Array]:
    """What is seen of it, with all that is unknown drawn; and the axes of the clamp."""
    count = int((one.end + one.after) * one.fps)
    time = np.arange(count) / one.fps

    def shapes(beam: Beam) -> Seen:
        light = replace(beam, mass_per_length=Uniform(0.1))
        hz = float(vibration(light, equilibrium(light, push((0.0, 0.0))), count=1).frequency[0])
        heavy = replace(beam, mass_per_length=Uniform(0.1 * (hz / one.hz) ** 2))
        tau = one.damping / (np.pi * one.hz)
        on = body(heavy, Modes(8), damping=Scaled(tau, beam.stiffness))
        force = np.array(one.force)

        def value(now: float) -> Array:
            return np.asarray(sized(one, np.array([now]))[0] * force)

        at_s = 0.9 + place_off(seed)
        pushed = AppliedForce(value, at_s=at_s, breaks=(one.end - one.fall, one.end))
        motion = simulate(on, settle(on), float(time[-1]) + FINE, FINE, Actions(forces=(pushed,)))
        return Seen(on, motion.states_at(time))

    return drawn_shapes(seed, shapes, count, noise=one.noise, fps=one.fps)


def _smooth(way: Array) -> Array:
    """From zero to one with the least jerk."""
    u = np.clip(way, 0.0, 1.0)
    return np.asarray(10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5)


def _smooth_rates(way: Array) -> tuple[Array, Array]:
    """Its first and second derivatives."""
    u = np.clip(way, 0.0, 1.0)
    return np.asarray(30.0 * u**2 * (1.0 - u) ** 2), np.asarray(60.0 * u * (1.0 - u) * (1.0 - 2.0 * u))
