"""Robustness of a closed loop: it is simulated on beams softer and stiffer than the model, or drawn from its band."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.model import Beam
from onebend.beam.profiles.stiffness import Profile, Scaled, Uniform
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.beam.statics.rod import has_mass
from onebend.blas import one_blas_thread
from onebend.control.loop.controller import Controller, ControllerSettings
from onebend.control.loop.felt import ForceSense
from onebend.control.loop.margins import Timing
from onebend.control.loop.simulation import Actuator, LoopCamera, LoopSimulation, TrueSystem, simulate_loop
from onebend.control.loop.tuning import RequiredMargins
from onebend.errors import ControlError, MechanicsError
from onebend.records import Array

SETTLED = 1e-3  # m, from the goal: a point that stays nearer counts as settled
MOST_DRAWN = 100  # beams: each takes as long as it takes to simulate
_LEAST_MASS = 0.01  # kg/m of a beam whose mass is not known: it then swings, quickly, as any beam does
_PLACES = np.linspace(0.0, 1.0, 101)  # s, over which log k is averaged


@dataclass(frozen=True)
class TrialBeam:
    """What the true beam is taken to be in a simulated loop."""

    stiffness: Profile
    factor: float  # k(s) over the model's; of a drawn beam the geometric mean over s
    drawn: bool = False  # from the band; else the factor is the same everywhere


@dataclass(frozen=True)
class LoopTrial:
    """One simulated loop. `run` is None where the beam snapped away."""

    beam: TrialBeam
    run: LoopSimulation | None

    @property
    def factor(self) -> float:
        """k(s) over the model's, as of the beam."""
        return self.beam.factor

    @property
    def steady(self) -> float:
        """m: the largest distance from the goal in the last second."""
        return float("inf") if self.run is None else self.run.steady()

    def settled(self, within: float) -> float:
        """s; infinite where it does not settle."""
        return float("inf") if self.run is None else self.run.settled(within)


def trial_settings(fps: float, delay: float, k_error: float = 0.3, most_force: float = math.inf) -> ControllerSettings:
    """A controller's settings for a camera that is `delay` s late, with margins for k(s) wrong by `k_error`."""
    return ControllerSettings(
        timing=Timing(fps=fps, delay=delay),
        longest_delay=max(0.1, delay),
        wanted=RequiredMargins(k_error=k_error),
        most_force=most_force,
    )


def wrong_beams(beam: Beam, k_error: float) -> tuple[TrialBeam, ...]:
    """The model itself, and beams whose k(s) is `k_error` lower and higher everywhere.

    Raises:
        ControlError: an error of k that is not in [0, 1).
    """
    if not 0.0 <= k_error < 1.0:
        raise ControlError(f"the error of k is a share from 0 to below 1, got {k_error}")
    factors = (1.0, 1.0 - k_error, 1.0 + k_error) if k_error else (1.0,)
    return tuple(TrialBeam(Scaled(factor, beam.stiffness), factor) for factor in factors)


@one_blas_thread
def drawn_beams(beam: Beam, known: UncertainStiffness | None, count: int, *, seed: int = 0) -> tuple[TrialBeam, ...]:
    """The model itself, and `count` beams as probable as the band of its k(s) says.

    Raises:
        ControlError: the model has no band, or the count is not from 1 to `MOST_DRAWN`.
    """
    if known is None:
        raise ControlError("the model has no band to draw beams from: give an error of k instead, or learn with a band")
    if not 1 <= count <= MOST_DRAWN:
        raise ControlError(f"from 1 to {MOST_DRAWN} beams can be drawn, got {count}")
    ours = np.log(beam.stiffness(_PLACES))
    drawn = [
        TrialBeam(one, float(np.exp(np.mean(np.log(one(_PLACES)) - ours))), drawn=True)
        for one in known.draw(count, seed=seed)
    ]
    return (TrialBeam(beam.stiffness, 1.0), *drawn)


def simulate_trials(
    control: Controller,
    beams: Iterable[TrialBeam],
    *,
    eye: LoopCamera = LoopCamera(),
    duration: float = 8.0,
    seed: int = 0,
    force_off: float = 0.0,
    feel: Callable[[Beam], ForceSense] | None = None,
) -> Iterator[LoopTrial]:
    """The loop on one beam after the other. A beam whose mass is not known is given a small one.

    The robot's force is off by `force_off` [N], to the left of the force that the model needs; `feel` makes what tells
    the force on the beam that moves.

    Raises:
        ControlError: a duration below two seconds, a force that is off by less than nothing.
    """
    if not duration >= 2.0:
        raise ControlError(f"a simulation takes two seconds at least, got {duration} s")
    if not (np.isfinite(force_off) and force_off >= 0.0):
        raise ControlError(f"a robot's force is off by a finite size, got {force_off} N")
    x, y = along(control) * force_off
    hand = Actuator(lag=control.settings.timing.lag, bias=(-float(y), float(x)))
    for beam in beams:
        truth = _true_system(control, beam, eye, hand)
        yield LoopTrial(beam, _run(control, truth, duration, seed, None if feel is None else feel(truth.beam)))


def along(control: Controller) -> Array:
    """(2,) the direction of the force that the model needs; that of x where it needs none."""
    force = control.reference.ends
    size = float(np.linalg.norm(force))
    return np.asarray(force / size) if size > 0.0 else np.array([1.0, 0.0])


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
    """The loop on the `wrong_beams` of its model, as `simulate_trials`.

    Raises:
        ControlError: as `wrong_beams` and `simulate_trials`.
    """
    beams = wrong_beams(control.beam, k_error)
    trials = simulate_trials(control, beams, eye=eye, duration=duration, seed=seed, force_off=force_off, feel=feel)
    return tuple(trials)


def _true_system(control: Controller, beam: TrialBeam, eye: LoopCamera, hand: Actuator) -> TrueSystem:
    model = control.beam
    mass = model.mass_per_length if has_mass(model) else Uniform(_LEAST_MASS)
    return TrueSystem(
        replace(model, stiffness=beam.stiffness, mass_per_length=mass),
        damping_ratio=control.settings.damping_ratio,
        push_s=control.push_s,
        point_s=control.point_s,
        gravity=(float(control.gravity[0]), float(control.gravity[1])),
        eye=eye,
        hand=hand,
    )


@one_blas_thread
def _run(
    control: Controller, truth: TrueSystem, duration: float, seed: int, feel: ForceSense | None
) -> LoopSimulation | None:
    try:
        return simulate_loop(control, truth, duration, seed=seed, feel=feel)
    except MechanicsError:
        return None
