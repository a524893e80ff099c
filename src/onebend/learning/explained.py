"""A recording as the marker-space fit explains it: every nuisance applied, the force log's slow error taken off."""

from __future__ import annotations

import numpy as np

from onebend.blas import one_blas_thread
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.forward import Prediction
from onebend.learning.model.parameters import Layout
from onebend.learning.model.readings import zeroed_coordinates
from onebend.learning.outcome import Comparison, Explained
from onebend.learning.posterior import Posterior
from onebend.learning.verdict import fitted_rms
from onebend.records import Array

PLACES = np.linspace(0.0, 1.0, 121)  # of the centre line


@one_blas_thread
def explained(posterior: Posterior) -> tuple[Explained, ...]:
    """Every recording of a fit, in the frames that it used."""
    parts = zip(posterior.recordings, posterior.slow, fitted_rms(posterior), strict=True)
    return tuple(_one(posterior, recording, prediction, rms) for recording, prediction, rms in parts)


def _one(posterior: Posterior, recording: FitData, prediction: Prediction, rms: Array) -> Explained:
    observations, x, layout = recording.observations, posterior.mean, posterior.layout
    used = slice(0, int(np.sum(recording.frames)))  # beyond them stands the beam at rest
    scale, origin = 1.0 + layout.get(x, "scale", recording.number), layout.get(x, "origin", recording.number)
    comparison = Comparison(
        name=observations.source.name,
        frame=observations.frame[recording.frames],
        time=observations.time[recording.frames],
        tag_id=observations.tag_id,
        marker_s=observations.marker_s,
        measured=_points(recording, layout, x, recording.measured)[used],
        predicted=_points(recording, layout, x, prediction.pose)[used],
        force=prediction.force[used],
        push_s=recording.push_s[used],
        stable=prediction.solved.stable[used],
        rms=rms,
        sensor_rms=np.full(len(observations.tag_id), np.nan),
        likely_rms=np.full(len(observations.tag_id), np.nan),
        static=observations.static,
    )
    return Explained(comparison, scale * prediction.solved.xy(PLACES)[used] + origin, recording.force[used])


def _points(recording: FitData, layout: Layout, x: Array, poses: Array) -> Array:
    """(F, m, 2) m, poses (F, m, 3) counted from the clamp, and at their rulers."""
    points, zeros = poses[..., :2].copy(), layout.get(x, "zero", recording.number)
    for (i, c), zero in zip(zeroed_coordinates(recording.observations), zeros, strict=True):
        points[:, i, c] += zero
    if recording.rulers is not None:
        points[..., 0] = np.where(np.isfinite(points[..., 1]), recording.rulers, np.nan)
    return points
