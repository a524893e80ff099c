"""How far a marker-space fit stays from the tags, and whether that is too far to explain the recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.errors import LearningError
from onebend.learning.inference.descent import MapEstimate
from onebend.learning.inference.fit_problem import FitProblem
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.forward import Prediction
from onebend.learning.model.frames import distances, marker_rms
from onebend.records import Array, Observations, covariance_with_camera

MISS = 0.05  # of a tag's own motion: a fit that is farther off does not explain the recording
HOPELESS = 0.2  # of the motion of all tags together: nothing that was fitted means anything
DOUBTS = {  # by what a remark on the recording is about
    "tool place": "the film shows the tool elsewhere",
    "drift": "the force's zero drifted by more than half of the push",
}
CONTRADICTED = "the force contradicts the bending"  # what all others say
_LEAST_MISS = 3.0  # times a tag's own noise: a smaller distance is no miss, however little the tag moves


@dataclass(frozen=True)
class Miss:
    """A recording that the fit cannot explain."""

    name: str
    tag: int  # the worst
    rms: float  # m
    motion: float  # m, of the tag
    share: float  # of the motion of all tags together, missed

    @property
    def hopeless(self) -> bool:
        """Whether nothing that was fitted means anything."""
        return self.share > HOPELESS

    @property
    def words(self) -> str:
        """What is wrong."""
        return (
            f"the fit misses tag {self.tag} by {1000 * self.rms:.3g} mm RMS where it moves by "
            f"{1000 * self.motion:.3g} mm"
        )


def recording_rms(recording: FitData, fitted: Prediction) -> Array:
    """(m,) m: distance of the tags from the fit; NaN for a tag that was never seen."""
    return marker_rms((recording.measured - fitted.pose)[..., :2])


def misses(recordings: Sequence[FitData], fitted: Sequence[Prediction]) -> tuple[Miss, ...]:
    """The recordings that the fit cannot explain, its nuisances applied in `fitted`; empty as a rule."""
    pairs = zip(recordings, fitted, strict=True)
    every = [_miss(recording, recording_rms(recording, prediction)) for recording, prediction in pairs]
    return tuple(miss for miss in every if miss is not None)


def _miss(recording: FitData, rms: Array) -> Miss | None:
    o, xy = recording.observations, recording.measured[..., :2]
    motion = distances(np.fmax.reduce(xy) - np.fmin.reduce(xy))
    if o.static:  # points near the clamp hardly move, and a ruler reads them no better
        zeroed = o.readings.bare >= 0
        straight = np.zeros(2) if zeroed else o.length * o.marker_s[:, None] * np.array([1.0, 0.0])
        motion = np.full_like(motion, np.nanmax(distances(xy - straight)))
    variance = np.trace(covariance_with_camera(o)[..., :2, :2], axis1=2, axis2=3)
    off = rms > _LEAST_MISS * np.sqrt(np.fmin.reduce(variance))
    missing = np.divide(rms, motion, out=np.zeros_like(rms), where=off & (motion > 0.0))
    worst = int(np.argmax(missing))
    if not missing[worst] > MISS:
        return None
    share = float(np.sqrt(np.nansum(rms**2) / np.nansum(motion**2)))
    return Miss(o.source.name, int(o.tag_id[worst]), float(rms[worst]), float(motion[worst]), share)


def refuse_lost_force(problem: FitProblem, estimate: MapEstimate) -> None:
    """Where every log's error, as fitted, changes by more than the force that it leaves, nothing tells the force: the
    fit can take all of the log for error, and k(s) for zero. A zero that is off does not count.

    Raises:
        LearningError: it is so; it says how large both are.
    """
    lost = []
    for recording in problem.recordings:
        loaded = np.any(recording.force != 0.0, axis=1)
        if not len(recording.error.knots) or not np.any(loaded):
            return
        values = problem.layout.get(estimate.x, "force", recording.number).reshape(-1, 2)
        error = (recording.error_weights @ values)[loaded]
        of_error, of_force = _rms_change(error), _rms_change(recording.force[loaded] - error)
        if of_error <= of_force:
            return
        name = recording.observations.source.name
        lost.append(f"{name}: the error of the force log changes by {of_error:.2g} N, the force by {of_force:.2g} N")
    if lost:
        raise LearningError(
            f"{'; '.join(lost)} (RMS, as tags and log say together): the log does not tell the force, and so not k(s). "
            "Push harder, or take a force sensor that is exact to a tenth of the push; zero it just before, and let go "
            "before the log ends, so that its drift shows"
        )


def _rms_change(force: Array) -> float:
    """N, root mean square of (T, 2) about its mean."""
    return float(np.sqrt(np.mean(np.sum((force - np.mean(force, axis=0)) ** 2, axis=1))))


def doubts_of(observations: Observations) -> tuple[str, ...]:
    """What the recording itself says against what is learned from it; empty as a rule."""
    said = (DOUBTS.get(one.about, CONTRADICTED) for one in observations.source.remarks if one.doubt)
    return tuple(dict.fromkeys(said))
