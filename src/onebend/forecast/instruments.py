"""The instruments of a setup before the first push, as the fit would describe them, for the Fisher information.

The force's noise is the sensor's own, in the parts that the fit models. Every push has its own errors: of its place, of
the force's axes, and of the force as the load begins and reverses. Where the clock offset is found from the data, its
sd follows a rule of thumb, within a factor of two for pushes of 4 to 13 s: a share of the push's duration that is in
proportion to the relative error of the force, with 3 % for what a linear relation misses (docs/plan.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from onebend.forecast.setup import Setup
from onebend.lab.pushes import PushProfile
from onebend.lab.sensors import ForceSensor
from onebend.lab.virtual import LOG_BEFORE
from onebend.learning.design.instruments import ForceDoubt, Instruments, PlannedPush
from onebend.learning.inference.stages import FitSettings
from onebend.recording.beam_frame import MOUNTING_SD
from onebend.records import CLAMP_SD, CURVATURE_SD, DIRECTION_SD, PLACE_SD

FUNCTIONS = FitSettings.functions  # of log k
MOST_FRAMES = 200  # of a push that prediction and fit use
_CUTOFF_CYCLES = 11.0  # over the seconds of contact, Hz: what the filter's choice comes to for a smooth push
_LEAST_WALK = 1.5e-3  # of the peak, N / sqrt(s): the fit takes no log as better
# Share of the sensor's reversal error that acts as one constant error over the push. The error is drawn anew as the
# load begins and as it reverses; the difference between both halves shows, as one force gives one shape.
_REVERSAL_SHARE = 0.75
_CLOCK_SHARE, _RELATION_MISFIT = 0.28, 0.03  # of the push's time; of the peak


@dataclass(frozen=True)
class PushUncertainty:
    """Errors that every push has of its own; one sd."""

    place: float = PLACE_SD  # m, along the beam
    direction: float = DIRECTION_SD  # rad, of the force log's axes
    load: float = 0.0  # N, each axis: error of the force that comes with the load


@dataclass(frozen=True)
class RehearsalInstruments:
    """The instruments of a rehearsal, and the errors of a push."""

    bench: Instruments
    push: PushUncertainty


def even_push(push: PushProfile) -> PlannedPush:
    """The push as one that grows evenly from nothing, in its middle direction."""
    return PlannedPush(push.at_s, push.direction, push.peak)


def instruments(setup: Setup) -> RehearsalInstruments:
    """Instruments and errors before any push; where pushes differ, those of the longest."""
    push = max(setup.pushes, key=_seconds)
    seconds, tags = _seconds(push), len(setup.tags)
    shared = ("along", "across", "turn") if setup.rest == "straight" else ("curvature", "along", "across", "turn")
    sd = {"curvature": [CURVATURE_SD] * 3, "turn": [setup.turn_sd] * tags}
    prior = np.concatenate([sd.get(name, [setup.placement_sd] * tags) for name in shared])
    clock = clock_sd(setup.sensor, push) if math.isnan(setup.clock_sd) else setup.clock_sd
    bench = Instruments(
        length=setup.beam.length,
        tags=setup.tags,
        tag_sd=np.tile([setup.noise.white_xy, setup.noise.white_xy, setup.noise.white_angle], (tags, 1)),
        frames=min(round(seconds * setup.fps), MOST_FRAMES),
        seconds=seconds,
        rest_before=push.before + LOG_BEFORE,
        rest_after=push.after + LOG_BEFORE if push.after > 0.0 else 0.0,
        placement_sd=setup.placement_sd,
        turn_sd=setup.turn_sd,
        curvature_sd=0.0 if setup.rest == "straight" else CURVATURE_SD,
        mass_sd=0.0,
        mass_spread_sd=0.0,
        clamp_sd=clamp_sd(setup, CLAMP_SD),
        origin_sd=setup.placement_sd,
        scale_sd=0.0,
        clock_sd=clock,
        force=force_doubt(setup.sensor, push),
        gain_sd=setup.gain_sd,
        gravity=(0.0, 0.0),
        curvature=1.0,
        pushes=(),
        shared=shared,
        shared_slope=np.zeros((len(prior), FUNCTIONS)),
        shared_covariance=np.diag(prior**2),
        place_sd=0.0,  # what a push is off by stands in `PushUncertainty`
        direction_sd=0.0,
    )
    return RehearsalInstruments(bench, PushUncertainty(load=_REVERSAL_SHARE * setup.sensor.reversal))


def clamp_sd(setup: Setup, own: float) -> float:
    """rad, as the fit takes it (`learning.parameters.clamp_sd`) from a beam whose tags are all seen at rest."""
    if setup.rest == "unknown":
        return float(np.hypot(own, MOUNTING_SD))
    reach = setup.beam.length * float(np.linalg.norm(setup.tags))
    return float(np.hypot(own, 2.0 * setup.placement_sd / reach))


def force_doubt(sensor: ForceSensor, push: PushProfile) -> ForceDoubt:
    """A sensor's errors behind the low-pass filter."""
    seconds = _seconds(push)
    cutoff = _CUTOFF_CYCLES / seconds
    white = sensor.white_sd * np.sqrt(min(2.0 * cutoff / sensor.rate, 1.0))
    walk = np.hypot(sensor.drift, _LEAST_WALK * push.peak)
    coloured, tau = sensor.coloured_sd, sensor.coloured_time
    if coloured == 0.0:  # a process of next to no size
        coloured, tau = 1e-4 * push.peak, 0.3
    return ForceDoubt(
        level=max(float(np.hypot(*sensor.bias)), push.peak),
        coloured=coloured,
        tau=tau,
        cutoff=cutoff,
        walk=float(walk),
        frame=float(white),
    )


def clock_sd(sensor: ForceSensor, push: PushProfile) -> float:
    """s, sd of the clock offset that the clock search would give, as the fit takes it."""
    error = float(np.sqrt(2.0 * sensor.reversal**2 + sensor.drift**2 * _seconds(push) + sensor.coloured_sd**2))
    return _CLOCK_SHARE * 0.5 * _seconds(push) * float(np.hypot(error / push.peak, _RELATION_MISFIT))


def _seconds(push: PushProfile) -> float:
    begin, end = push.contact
    return end - begin
