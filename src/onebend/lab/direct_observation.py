"""From a virtual recording to observations without the searches: clock and contact are taken from the truth.

For studies of many runs, and for those that need the force's error to be exactly as given.
"""

from __future__ import annotations

from math import inf

import numpy as np

from onebend.blas import one_blas_thread
from onebend.errors import RecordingError
from onebend.lab.virtual import VirtualBench, VirtualRecording
from onebend.recording.beam_frame import to_beam_frame
from onebend.recording.force.cleaning import clean_force, force_at
from onebend.records import Array, BoolArray, CleanForce, ClockOffset, Observations, Source, Stated

MARGIN = 0.1  # s, kept away from contact when a rest is read


@one_blas_thread
def observe_from_truth(
    virtual: VirtualRecording,
    *,
    error: Array | None = None,
    clock_error: float = 0.0,
    clock_sd: float = 0.0,
    cutoff: float = 4.0,
) -> Observations:
    """Observations on a clock that is `clock_error` [s] off, stated as good to `clock_sd` [s] (0: known).

    With an `error` (T, 2) [N] the force is the true one plus this, and the log is not used; without it the log is
    zeroed in the true rests and low-passed at `cutoff` [Hz].

    Raises:
        RecordingError: an error whose shape is not that of the force at the frames.
    """
    bench, rec, markers = virtual.bench, virtual.recording, virtual.markers
    time = markers.time + bench.clock.offset + clock_error
    still = _untouched(bench, markers.time)
    in_frame, rest, _ = to_beam_frame(markers, still, rec.tags.placement_sd, np.zeros_like(virtual.force))
    clean, force, noise = _force_seen(virtual, error, time, cutoff)
    known = np.all(np.isfinite(force), axis=1)
    return Observations(
        source=Source(rec.name, clock=_clock(bench, clock_error, clock_sd), clean_force=clean),
        stated=Stated(
            rest=rec.beam.rest,
            mass=rec.beam.mass,
            placement_sd=rec.tags.placement_sd,
            turn_sd=rec.tags.turn_sd,
            place_sd=rec.place_sd,
            direction_sd=rec.direction_sd,
            clamp_sd=rec.clamp_sd,
            curvature_sd=rec.beam.curvature_sd,
            scale_sd=rec.scale_sd,
        ),
        length=rec.beam.length,
        time=time[known],
        frame=np.flatnonzero(known).astype(np.int64),
        tag_id=markers.tag_id,
        marker_s=markers.s,
        xy=in_frame.xy[known],
        angle=in_frame.angle[known],
        covariance=in_frame.covariance[known],
        force=force[known],
        force_sd=noise,
        push_s=np.full(int(np.sum(known)), rec.push.at if rec.push else np.nan),
        loaded=~still[known],
        rest_xy=rest.xy,
        rest_angle=rest.angle,
        rest_covariance=rest.covariance,
        gravity=np.zeros_like(force)[known],
    )


def _untouched(bench: VirtualBench, time: Array) -> BoolArray:
    """(T,) film times [s] at which nothing pushes."""
    begin, end = bench.push.contact
    return np.asarray((time < begin) | (time > end))


def _clock(bench: VirtualBench, error: float, sd: float) -> ClockOffset | None:
    """What is found of the clocks where they are not known."""
    return ClockOffset(bench.clock.offset + error, sd, bench.clock.declared, True) if sd > 0.0 else None


def _force_seen(
    virtual: VirtualRecording, error: Array | None, at: Array, cutoff: float
) -> tuple[CleanForce | None, Array, Array]:
    """The cleaned log if it is used, the force (T, 2) N that frames at `at` (T,) [s] of its clock are given, its sd."""
    if error is not None:
        if error.shape != virtual.force.shape:
            raise RecordingError(f"the force at the frames is {virtual.force.shape}, its error is {error.shape}")
        return None, virtual.force + error, np.sqrt(np.mean(error**2, axis=0))
    begin, end = (moment + virtual.bench.clock.offset for moment in virtual.bench.push.contact)
    rests = [(-inf, begin - MARGIN)]
    if virtual.bench.push.after > 2.0 * MARGIN:
        rests.append((end + MARGIN, inf))
    clean = clean_force(virtual.log, rests, cutoff=cutoff)
    return clean, force_at(clean, at), clean.noise_sd
