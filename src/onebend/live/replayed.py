"""A recording played to the live learner, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.stiffness import Profile, UncertainStiffness
from onebend.errors import LearningError
from onebend.learning.force_error import ForceError, force_error, ramp
from onebend.learning.frames import of_tags, push_places, usable_frames
from onebend.learning.parameters import STATED_ERRORS
from onebend.live.hyperparameters import OnlineSettings
from onebend.live.learner import OnlineLearner
from onebend.progress import one_blas_thread
from onebend.records import END_ID, Array, BoolArray, Observations, covariance_with_camera

_MARGIN = 0.2  # s, kept away from contact when the rests are read
_REST_STEP = 0.05  # s, between two looks at the log where no film was made
_LONGER, _LEAST_DOUBT = 1.5, 0.1  # a filter makes memories alike: how much, by trial
_FAST = 0.2  # of the force error that lasts: what it is off by in every frame anew


@one_blas_thread
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
        LearningError: as `OnlineLearner`, or masses ride on the beam, which it does not know.
    """
    o = of_tags(observations, observations.tag_id != END_ID)  # what is along an outline is not read live
    if o.stated.masses and np.any(o.gravity != 0.0):
        text = f"{o.source.name}: the live learner knows nothing of masses that ride on the beam"
        raise LearningError(f"{text} ([[beam.masses]]). Learn the recording as a whole")
    learner = OnlineLearner(
        o.length,
        o.marker_s,
        start,
        traced=o.traced,
        width=o.width,
        mass=o.stated.mass if np.isfinite(o.stated.mass) else 0.0,
        gain_sd=gain_sd,
        settings=settings_for(o, settings),
    )
    for frame in live_frames(o):
        learner.update(**vars(frame))
    return learner


def settings_for(observations: Observations, settings: OnlineSettings = OnlineSettings()) -> OnlineSettings:
    """Settings with what a recording says of placement, rest, camera, clock and force noise."""
    o = observations
    known = replace(
        settings,
        sds=_sds(o, settings),
        thickness=_known(o.stated.thickness, settings.thickness),
        tag_size=_known(o.stated.tag_size, settings.tag_size),
    )
    largest = float(np.nanmax(np.linalg.norm(o.force, axis=1))) if len(o.time) else 0.0
    if largest == 0.0 or not (np.any(o.force_sd > 0.0) or o.source.clean_force is not None):
        return known  # nothing is said of the force's noise
    error = force_error(o, o.time[usable_frames(o)])
    memory, longer = _memory(error, 1.0), _memory(error, _LONGER)
    return replace(
        known,
        force=replace(error.noise, white=_FAST * error.size, coloured=error.size, tau=memory),
        memory_doubt=settings.memory_doubt * max(np.log(longer / memory) / np.log(_LONGER), _LEAST_DOUBT),
    )


def _known(stated: float, wanted: float | None) -> float | None:
    return stated if np.isfinite(stated) else wanted


def _sds(o: Observations, settings: OnlineSettings) -> dict[str, float]:
    """Of `STATED_ERRORS` but the mass, as the recording states them where the settings do not."""
    known = {one.name: one.allowance([o], ("",)).prior_sd[0] for one in STATED_ERRORS if one.name != "mass"}
    return {**known, **settings.sds}


def _memory(error: ForceError, times: float) -> float:
    """s, of the exponential with the integral of the filtered covariance, the noise's own memory being longer."""
    short = error.filtered.covariance(error.noise.coloured, times * error.noise.tau, error.white)
    return float(np.trapezoid(np.maximum(short, 0.0), error.filtered.lag) / short[0])


@dataclass(frozen=True)
class LiveFrame:
    """What `OnlineLearner.update` takes."""

    time: float
    xy: Array
    angle: Array
    covariance: Array
    force: Array
    push_s: float
    loaded: bool
    gravity: Array


def live_frames(observations: Observations) -> list[LiveFrame]:
    """Frames for a live learner, in order of time: those under load, those at rest well away from contact, and the
    force log in the rest before and after the film. The log's zero is that of the first rest."""
    o, places, covariance = observations, push_places(observations), covariance_with_camera(observations)
    logged = o.force - ramp(o.source.clean_force, o.time)
    film = [
        LiveFrame(
            time=float(o.time[t]),
            xy=o.xy[t],
            angle=o.angle[t],
            covariance=covariance[t],
            force=logged[t],
            push_s=float(places[t]),
            loaded=bool(o.loaded[t]),
            gravity=o.gravity[t],
        )
        for t in _playable(o)
    ]
    if o.source.clean_force is None or not film:
        return film
    tags = len(o.marker_s)
    nothing = np.full((tags, 2), np.nan), np.full(tags, np.nan), np.full((tags, 3, 3), np.nan)
    time = o.source.clean_force.time
    force = o.source.clean_force.force - ramp(o.source.clean_force, time)
    known = np.all(np.isfinite(force), axis=1)
    gap = max(_REST_STEP, float(np.median(np.diff(o.time))))

    def alone(part: BoolArray, frame: LiveFrame) -> list[LiveFrame]:
        rows = np.flatnonzero(part & known)
        rows = rows[np.unique(np.floor((time[rows] - time[0]) / gap), return_index=True)[1]]
        return [LiveFrame(float(time[i]), *nothing, force[i], 1.0, False, frame.gravity) for i in rows.tolist()]

    before, after = time < o.time[0] - 0.5 * gap, time > o.time[-1] + 0.5 * gap
    first = [] if o.loaded[0] else alone(before, film[0])
    return [*first, *film, *([] if o.loaded[-1] else alone(after, film[-1]))]


def _playable(observations: Observations) -> list[int]:
    o = observations
    known = np.all(np.isfinite(o.force), axis=1)
    touched = o.time[o.loaded]
    gap = np.min(np.abs(o.time[:, None] - touched), axis=1) if len(touched) else np.full(len(o.time), np.inf)
    return np.flatnonzero(usable_frames(o) & o.loaded | known & ~o.loaded & (gap > _MARGIN)).tolist()
