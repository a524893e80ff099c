"""The learned beam swinging: where its tags are, for a loss time, k over mass, and a state to start from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.motion.actions import Actions
from onebend.beam.motion.collocation import Method
from onebend.beam.motion.dynamics import Body
from onebend.beam.motion.integration import IntegrationSettings, MotionState, simulate
from onebend.beam.motion.vibration import Vibration, settle
from onebend.learning.swing.free_swing import Glance, Swing
from onebend.records import Array

_STEPS = 40  # a period of the slowest mode
_METHOD = IntegrationSettings(Method(3, "radau"))  # the fastest modes are over-damped; Gauss would let them ring


@dataclass(frozen=True)
class SwingProblem:
    """What the parameters (log tau, log c, displacements, rates along the modes) are compared with."""

    body: Body
    swing: Swing
    about: Vibration
    mass_known: bool
    units: Array  # (p,) what the initial state's parameters are multiples of

    @property
    def unknown(self) -> int:
        return 2 + 2 * len(self.units)


def units_of(about: Vibration, swing: Swing, most: int) -> Array:
    """Amplitudes of the modes that move some tag as far as the swing does."""
    count = min(most, len(about.squared))
    furthest = np.nanmax(np.linalg.norm(swing.seen[..., :2] - swing.rest[:, :2], axis=-1))
    return np.asarray(furthest / np.linalg.norm(about.moved(swing.s)[:count], axis=-1).max(axis=1))


def first_guess(problem: SwingProblem, seen: Glance) -> Array:
    """Parameters from a damped sinusoid in the slowest mode."""
    about, x = problem.about, np.zeros(problem.unknown)
    squared = seen.omega**2 + seen.decay**2
    x[0], x[1] = np.log(2.0 * seen.decay / squared), np.log(squared / about.squared[0])
    if seen.part < 2:
        per_unit = about.moved(problem.swing.s[[seen.tag]])[0, 0, seen.part]
    else:
        per_unit = (about.body.to_places(problem.swing.s[[seen.tag]]) @ about.shapes)[0, 0]
    per_unit *= problem.units[0]
    count = len(problem.units)
    x[2], x[2 + count] = seen.value / per_unit, seen.slope / per_unit / np.sqrt(about.squared[0])
    return x


def predict(problem: SwingProblem, x: Array) -> Array:
    """(T, m, 3) where the tags are."""
    swing, count, factor = problem.swing, len(problem.units), float(np.exp(x[1]))
    on = scaled(problem.body, factor, float(np.exp(x[0])), mass_known=problem.mass_known)
    actions = Actions(gravity=swing.gravity)
    rest = at_rest(on, swing.gravity)
    shapes = problem.about.shapes[:, :count] * problem.units
    rates = shapes * np.sqrt(np.abs(problem.about.squared[:count]))
    start = MotionState(rest.theta + shapes @ x[2 : 2 + count], rates @ x[2 + count :])
    period = 2.0 * np.pi / np.sqrt(problem.about.squared[0] * factor)
    motion = simulate(on, start, float(swing.time[-1]), period / _STEPS, actions, settings=_METHOD)
    states = motion.states_at(np.minimum(swing.time, motion.time[-1]))
    return _riding(on, states, rest.theta, swing)


def _riding(on: Body, states: Array, at_rest: Array, swing: Swing) -> Array:
    """(T, m, 3) tags that sit on the beam as they do at rest, for states (T, n)."""
    still, tangent = at_rest[None], on.angle(swing.s, at_rest[None])[0]
    away = swing.rest[:, :2] - on.xy(swing.s, still)[0]
    turned = on.angle(swing.s, states)
    by = turned - tangent
    cos, sin = np.cos(by), np.sin(by)
    shift = np.stack([cos * away[:, 0] - sin * away[:, 1], sin * away[:, 0] + cos * away[:, 1]], axis=-1)
    return np.concatenate([on.xy(swing.s, states) + shift, (by + swing.rest[:, 2])[..., None]], axis=-1)


def scaled(on: Body, factor: float, loss_time: float, *, mass_known: bool) -> Body:
    """With k over mass times `factor`: by k where the mass is known, else by the mass; and damping tau k."""
    if mass_known:
        stiff = factor * on.stiffness
        return replace(on, stiffness=stiff, damping=loss_time * stiff)
    mass = 1.0 / factor
    return replace(
        on, carried=mass * on.carried, lever=mass * on.lever, mass=mass * on.mass, damping=loss_time * on.stiffness
    )


def at_rest(on: Body, gravity: Array) -> MotionState:
    """The body at rest under its weight."""
    return settle(on, Actions(gravity=gravity), load_steps=20 if np.any(gravity) else 1)
