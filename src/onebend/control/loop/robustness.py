"""Robustness of a closed loop: it is simulated on beams softer and stiffer than the model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.stiffness import Scaled, Uniform
from onebend.beam.statics.rod import has_mass
from onebend.blas import one_blas_thread
from onebend.control.loop.controller import Controller
from onebend.control.loop.felt import ForceSense
from onebend.control.loop.simulation import Actuator, LoopCamera, LoopSimulation, TrueSystem, simulate_loop
from onebend.errors import ControlError, MechanicsError
from onebend.records import Array

SETTLED = 1e-3  # m, from the goal: a point that stays nearer counts as settled
_LEAST_MASS = 0.01  # kg/m of a beam whose mass is not known: it then swings, quickly, as any beam does


@dataclass(frozen=True)
class LoopTrial:
    """One simulated loop. `run` is None where the beam snapped away."""

    factor: float  # of the model's k(s), everywhere alike
    run: LoopSimulation | None

    @property
    def steady(self) -> float:
        """m: the largest distance from the goal in the last second."""
        return float("inf") if self.run is None else self.run.steady()

    def settled(self, within: float) -> float:
        """s; infinite where it does not settle."""
        return float("inf") if self.run is None else self.run.settled(within)


@one_blas_thread
def simulate_range(
    control: Controller,
    *,
    k_error: float = 0.3,
    eye: LoopCamera = LoopCamera(),
    duration: float = 8.0,
    seed: int = 0,
    force_off: float = 0.0,
    feel: Callable[[Beam], ForceSense] | None = None,
) -> tuple[LoopTrial, ...]:
    """The loop on the model itself, and on beams whose k(s) is `k_error` lower and higher everywhere.

    A beam whose mass is not known is given a small one. The robot's force is off by `force_off` [N], to the left of the
    force that the model needs; `feel` makes what tells the force on the beam that moves.

    Raises:
        ControlError: an error of k that is not in [0, 1), a duration below two seconds, a force that is off by less
            than nothing.
    """
    if not (np.isfinite(force_off) and force_off >= 0.0):
        raise ControlError(f"a robot's force is off by a finite size, got {force_off} N")
    if not 0.0 <= k_error < 1.0:
        raise ControlError(f"the error of k is a share from 0 to below 1, got {k_error}")
    if not duration >= 2.0:
        raise ControlError(f"a simulation takes two seconds at least, got {duration} s")
    beam = _swinging(control.beam)
    factors = (1.0, 1.0 - k_error, 1.0 + k_error) if k_error else (1.0,)
    x, y = along(control) * force_off
    hand = Actuator(lag=control.settings.timing.lag, bias=(-float(y), float(x)))
    return tuple(LoopTrial(factor, _run(control, beam, factor, eye, hand, duration, seed, feel)) for factor in factors)


def along(control: Controller) -> Array:
    """(2,) the direction of the force that the model needs; that of x where it needs none."""
    force = control.reference.ends
    size = float(np.linalg.norm(force))
    return np.asarray(force / size) if size > 0.0 else np.array([1.0, 0.0])


def _swinging(beam: Beam) -> Beam:
    return beam if has_mass(beam) else replace(beam, mass_per_length=Uniform(_LEAST_MASS))


def _run(
    control: Controller,
    beam: Beam,
    factor: float,
    eye: LoopCamera,
    hand: Actuator,
    duration: float,
    seed: int,
    feel: Callable[[Beam], ForceSense] | None,
) -> LoopSimulation | None:
    truth = TrueSystem(
        replace(beam, stiffness=Scaled(factor, beam.stiffness)),
        damping_ratio=control.settings.damping_ratio,
        push_s=control.push_s,
        point_s=control.point_s,
        gravity=(float(control.gravity[0]), float(control.gravity[1])),
        eye=eye,
        hand=hand,
    )
    try:
        return simulate_loop(control, truth, duration, seed=seed, feel=None if feel is None else feel(truth.beam))
    except MechanicsError:
        return None
