"""How far the beam is bent along its slowest mode: of what a free beam does, nearly all is that one number.

The modes are those of small vibrations about rest, for the model's k(s) and mass per length (an even one where none is
known). Orthogonal in stiffness: the curvature that the tags show, less that at rest, times k times the mode's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.modal import Modes
from onebend.beam.model import Beam
from onebend.beam.motion.dynamics import body
from onebend.beam.motion.vibration import settle, vibration_of
from onebend.beam.profiles.stiffness import Uniform
from onebend.learning.paper.inverse_kinematics import solve_states
from onebend.records import Array, IntArray, Observations

_STATES = 4  # of a shape as the tags show it
_MODES = 6  # of the beam in motion


@dataclass(frozen=True)
class ModeBending:
    """Along the slowest mode, in T frames: as much as turns the tip by 1 rad is 1; NaN in frames without tags."""

    time: Array  # (T,) s
    value: Array  # (T,)
    sd: Array  # (T,) of the tags' noise

    def take(self, rows: IntArray | slice) -> ModeBending:
        """Of some frames."""
        return ModeBending(*(values[rows] for values in vars(self).values()))


def bending(beam: Beam, o: Observations) -> ModeBending:
    """Of every frame of a recording of a beam that swings freely, its far end not held."""
    states = solve_states(o, min(_STATES, 2 * len(o.marker_s)))
    mass = np.asarray(beam.mass_per_length(np.linspace(0.0, 1.0, 11)))
    on = body(beam if np.all(mass > 0.0) else replace(beam, mass_per_length=Uniform(1.0)), Modes(_MODES))
    shape = vibration_of(on, settle(on), count=1).shapes[:, 0]
    shape = shape / float((on.to_places(np.array([1.0])) @ shape)[0])
    bends = on.curvature @ shape
    weight = on.grid.weights * np.asarray(beam.stiffness(on.grid.nodes)) * bends
    to_mode = weight @ states.modes.curvature(on.grid.nodes) / float(weight @ bends)
    value = (states.theta - states.theta0) @ to_mode
    variance = np.einsum("i,tij,j->t", to_mode, states.covariance, to_mode)
    return ModeBending(o.time, np.where(states.converged, value, np.nan), np.sqrt(variance))
