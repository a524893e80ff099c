"""A recording played to the live learner, frame by frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.beam.stiffness import Profile
from onebend.beam.uncertain import UncertainStiffness
from onebend.learning.frames import push_places, usable_frames
from onebend.learning.online import OnlineLearner, OnlineSettings
from onebend.records import Observations

_MARGIN = 0.2  # s, kept away from contact when the rests are read


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
    clock = 0.0 if o.clock is None else float(o.clock.sd) if np.isfinite(o.clock.sd) else 1.0
    noise = float(np.nanmean(o.force_sd)) if np.any(o.force_sd > 0.0) else settings.force_noise
    return replace(
        settings,
        placement_sd=o.placement_sd,
        rest_unknown=o.rest == "unknown",
        calibrated=o.view is None or o.view.calibrated,
        force_noise=noise,
        priors=settings.priors if settings.priors.clock is not None else replace(settings.priors, clock=clock),
    )


def playable(observations: Observations) -> list[int]:
    """Frames that a live learner can use: those under load, and those at rest well away from contact."""
    o = observations
    known = np.all(np.isfinite(o.force), axis=1)
    touched = o.time[o.loaded]
    gap = np.min(np.abs(o.time[:, None] - touched), axis=1) if len(touched) else np.full(len(o.time), np.inf)
    return np.flatnonzero(usable_frames(o) & o.loaded | known & ~o.loaded & (gap > _MARGIN)).tolist()
