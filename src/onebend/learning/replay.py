"""A recording played to the live learner, frame by frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.beam.stiffness import Profile
from onebend.beam.uncertain import UncertainStiffness
from onebend.learning.force_error import force_error
from onebend.learning.frames import push_places, usable_frames
from onebend.learning.online import OnlineLearner, OnlineSettings
from onebend.learning.parameters import Priors, layout
from onebend.learning.spline import Spline
from onebend.records import Array, Observations

_MARGIN = 0.2  # s, kept away from contact when the rests are read
_FAST = 0.2  # of the force error that lasts: what it is off by in every frame anew


def replay(
    observations: Observations,
    start: Profile | float | UncertainStiffness,
    *,
    gain_sd: float = 0.0,
    settings: OnlineSettings = OnlineSettings(),
) -> OnlineLearner:
    """A learner that has seen a recording frame by frame, as if it were live.

    Placement, rest, camera, clock and force noise are taken from the observations where they say them.

    Raises:
        LearningError: as `OnlineLearner`.
    """
    o = observations
    learner = OnlineLearner(
        o.length,
        o.marker_s,
        start,
        mass=o.mass if np.isfinite(o.mass) else 0.0,
        gain_sd=gain_sd,
        settings=settings_for(o, settings),
    )
    places = push_places(o)
    for t in playable(o):
        learner.update(
            o.time[t],
            o.xy[t],
            o.angle[t],
            o.covariance[t],
            o.force[t],
            places[t],
            loaded=bool(o.loaded[t]),
            gravity=o.gravity[t],
        )
    return learner


def settings_for(observations: Observations, settings: OnlineSettings = OnlineSettings()) -> OnlineSettings:
    """Settings with what a recording says of placement, rest, camera, clock and force noise."""
    o = observations
    known = replace(settings, placement_sd=o.placement_sd, rest_unknown=o.rest == "unknown", priors=_priors(o, settings))
    if o.view is not None:
        known = replace(known, calibrated=o.view.calibrated)
    largest = float(np.nanmax(np.linalg.norm(o.force, axis=1))) if len(o.time) else 0.0
    if largest == 0.0:
        return known
    error = force_error(o, o.time[usable_frames(o)])
    short = error.filtered.covariance(error.noise.coloured, error.noise.tau, error.white)
    return replace(
        known,
        force_noise=error.size,
        force_white=_FAST * error.size,
        force_walk=error.noise.walk,
        force_memory=_memory(error.filtered.lag, short),
        force_zero=error.level,
    )


def _priors(o: Observations, settings: OnlineSettings) -> Priors:
    """What the fit takes as known before the data."""
    at = layout(Spline(settings.functions), [o], [0], settings.priors)
    sd = {name: float(at.index[name, 0].prior_sd[0]) for name in ("clamp", "origin", "clock", "place", "direction")}
    return replace(settings.priors, placement=float(at.index["along", -1].prior_sd[0]), **sd)


def _memory(lag: Array, covariance: Array) -> float:
    """s, of the exponential whose covariance has the same integral."""
    return float(np.trapezoid(np.maximum(covariance, 0.0), lag) / covariance[0])


def playable(observations: Observations) -> list[int]:
    """Frames that a live learner can use: those under load, and those at rest well away from contact."""
    o = observations
    known = np.all(np.isfinite(o.force), axis=1)
    touched = o.time[o.loaded]
    gap = np.min(np.abs(o.time[:, None] - touched), axis=1) if len(touched) else np.full(len(o.time), np.inf)
    return np.flatnonzero(usable_frames(o) & o.loaded | known & ~o.loaded & (gap > _MARGIN)).tolist()
