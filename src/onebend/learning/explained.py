"""A recording as the marker-space fit explains it: every nuisance applied, the force log's slow error taken off."""

from __future__ import annotations

import numpy as np

from onebend.learning.model.fit_data import FitData
from onebend.learning.model.forward import Prediction
from onebend.learning.outcome import Comparison, Explained
from onebend.learning.posterior import Posterior
from onebend.learning.verdict import fitted_rms
from onebend.records import Array

PLACES = np.linspace(0.0, 1.0, 121)  # of the centre line


def explained(posterior: Posterior) -> tuple[Explained, ...]:
    """Every recording of a fit, in the frames that it used."""
    parts = zip(posterior.recordings, posterior.slow, fitted_rms(posterior), strict=True)
    return tuple(_one(posterior, film, prediction, rms) for film, prediction, rms in parts)


def _one(posterior: Posterior, film: FitData, found: Prediction, rms: Array) -> Explained:
    seen, x, at = film.observations, posterior.mean, posterior.layout
    used = slice(0, int(np.sum(film.frames)))  # beyond them stands the beam at rest
    scale, origin = 1.0 + at.get(x, "scale", film.number), at.get(x, "origin", film.number)
    comparison = Comparison(
        name=seen.source.name,
        frame=seen.frame[film.frames],
        time=seen.time[film.frames],
        tag_id=seen.tag_id,
        marker_s=seen.marker_s,
        measured=film.measured[used, :, :2],
        predicted=found.pose[used, :, :2],
        force=found.force[used],
        push_s=film.push_s[used],
        stable=found.solved.stable[used],
        rms=rms,
        sensor_rms=np.full(len(seen.tag_id), np.nan),
        static=seen.static,
    )
    return Explained(comparison, scale * found.solved.xy(PLACES)[used] + origin, film.force[used])
