"""How a known beam moves under a push: exact equilibria where it is slow, the equation of motion where it is fast."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite

import numpy as np

from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.motion.actions import Actions, AppliedForce
from onebend.beam.motion.dynamics import body
from onebend.beam.motion.integration import converged
from onebend.beam.motion.vibration import settle
from onebend.beam.profiles.stiffness import Profile, Scaled, Uniform
from onebend.beam.statics.continuation import equilibrium
from onebend.beam.statics.problem import Resolution
from onebend.errors import MechanicsError
from onebend.lab.pushes import PushProfile
from onebend.lab.random_beams import RESOLUTION
from onebend.records import Array

PLACES = np.linspace(0.0, 1.0, 121)
BATCH = 400  # equilibria at a time
STEP, TOLERANCE = 4e-3, 1e-5  # s, the first step tried; m, of the markers
ORDER = 12  # curvature nodes of a moving beam


@dataclass(frozen=True)
class MotionSettings:
    """What moves the beam apart from the push: its own weight and, if it `swings`, its inertia."""

    gravity: tuple[float, float] = (0.0, 0.0)  # m/s^2 in the clamp's frame
    swings: bool = False
    damping: float = 0.006  # s, internal (Kelvin-Voigt) damping over stiffness
    rotary_inertia: Profile = field(default_factory=lambda: Uniform(0.0))  # kg m


@dataclass(frozen=True)
class BeamShapes:
    """The beam at T times, in the clamp's frame, at `PLACES`."""

    time: Array  # (T,) s
    force: Array  # (T, 2) N on the beam
    xy: Array  # (T, 121, 2) m
    angle: Array  # (T, 121) rad

    def at(self, s: Array) -> tuple[Array, Array]:
        """(T, m, 2) m and (T, m) rad at places `s` (m,), by cubic interpolation between `PLACES`."""
        from_left = np.clip(s, 0.0, 1.0)
        xy = np.stack([cubic(self.xy[..., i], from_left) for i in range(2)], axis=-1)
        return xy, cubic(self.angle, from_left)


def cubic(values: Array, s: Array) -> Array:
    """(T, m) at `s` (m,) of (T, 121) at `PLACES`: Lagrange's cubic through the four nearest."""
    spacing = PLACES[1] - PLACES[0]
    first = np.clip(np.floor(s / spacing).astype(int) - 1, 0, len(PLACES) - 4)
    u = s / spacing - first
    total = np.zeros((len(values), len(s)))
    for i in range(4):
        weight_of = np.ones(len(s))
        for j in range(4):
            if j != i:
                weight_of = weight_of * (u - j) / (i - j)
        total += weight_of * values[:, first + i]
    return total


def shapes_at(beam: Beam, pushing: PushProfile, time: Array, motive: MotionSettings = MotionSettings()) -> BeamShapes:
    """The beam under `pushing` at times (T,) [s] that rise; before 0 it is at rest.

    Raises:
        MechanicsError: the beam snaps through, or weight or inertia are asked for and its mass is not known.
    """
    if (motive.swings or any(motive.gravity)) and not float(np.min(beam.mass_per_length(PLACES))) > 0.0:
        raise MechanicsError("a beam without mass has neither weight nor inertia. Give it a mass per length")
    return swinging(beam, pushing, time, motive) if motive.swings else standing(beam, pushing, time, motive)


def standing(beam: Beam, pushing: PushProfile, time: Array, motive: MotionSettings) -> BeamShapes:
    """Exact equilibria."""
    force = pushing.force(time)
    xy, angle = [], []
    for i in range(0, len(time), BATCH):
        part = force[i : i + BATCH]
        loads = push(part, pushing.at_s)
        if any(motive.gravity):
            loads = loads + weight(np.tile(motive.gravity, (len(part), 1)))
        solved = equilibrium(beam, loads, resolution=RESOLUTION)
        if not np.all(solved.converged):
            raise MechanicsError(f"the beam snaps through under {pushing.peak:.3g} N. Give a smaller force")
        xy.append(solved.xy(PLACES))
        angle.append(solved.angle(PLACES))
    return BeamShapes(time, force, np.concatenate(xy), np.concatenate(angle))


def swinging(beam: Beam, pushing: PushProfile, time: Array, motive: MotionSettings) -> BeamShapes:
    """The equation of motion, from rest under the weight."""
    damping = Scaled(motive.damping, beam.stiffness)
    moving = body(beam, rotary_inertia=motive.rotary_inertia, damping=damping, resolution=Resolution(ORDER))
    breaks = tuple(sorted({pushing.before, pushing.before + pushing.rise, *pushing.contact}))
    on_beam = AppliedForce(lambda t: pushing.force(np.array([t]))[0], pushing.at_s, breaks)
    actions = Actions(forces=(on_beam,), gravity=motive.gravity)
    start = settle(moving, actions)
    until = float(time[-1])
    if not (isfinite(until) and until > 0.0):
        raise MechanicsError("a film lasts longer than 0 s")
    motion = converged(moving, start, until, actions, tolerance=TOLERANCE, step=STEP, at_s=(1 / 3, 2 / 3, 1.0))
    theta = motion.states_at(np.clip(time, 0.0, until))
    xy = np.concatenate([moving.xy(PLACES, theta[i : i + BATCH]) for i in range(0, len(theta), BATCH)])
    angle = np.concatenate([moving.angle(PLACES, theta[i : i + BATCH]) for i in range(0, len(theta), BATCH)])
    return BeamShapes(time, pushing.force(time), xy, angle)
