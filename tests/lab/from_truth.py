"""Observations of a virtual recording without searches: clock and contact are the true ones."""

from __future__ import annotations

from math import inf

import numpy as np

from onebend.errors import RecordingError
from onebend.lab.virtual import VirtualRecording
from onebend.progress import one_blas_thread
from onebend.recording.beam_frame import to_beam_frame
from onebend.recording.force import clean_force, force_at
from onebend.recording.observe import observations_of
from onebend.records import Array, BoolArray, CleanForce, ClockOffset, Observations, Source

MARGIN = 0.1  # s between a rest and contact


@one_blas_thread
def observe_from_truth(
    virtual: VirtualRecording,
    *,
    error: Array | None = None,
    clock_error: float = 0.0,
    clock_sd: float = 0.0,
    cutoff: float = 4.0,
) -> Observations:
    """Observations on a clock that is `clock_error` [s] off, stated to `clock_sd` [s] (0: known).

    With an `error` (T, 2) [N] the force is the true one plus this; otherwise the log, zeroed in the true rests and
    low-passed at `cutoff` [Hz]. Raises `RecordingError`: an error whose shape is not that of the force at the frames.
    """
    bench, rec, markers = virtual.bench, virtual.recording, virtual.markers
    time = markers.time + bench.clock.offset + clock_error
    begin, end = bench.push.contact
    still: BoolArray = (markers.time < begin) | (markers.time > end)  # unloaded
    offset = ClockOffset(bench.clock.offset + clock_error, clock_sd, bench.clock.declared, True)
    in_frame, rest, _ = to_beam_frame(markers, still, rec.tags.placement_sd, np.zeros_like(virtual.force))
    clean, force, noise = _force_seen(virtual, error, time, cutoff)
    source = Source(rec.name, clock=offset if clock_sd > 0.0 else None, clean_force=clean)
    push_s = np.full(len(time), rec.push.at if rec.push else np.nan)
    loads = {"time": time, "gravity": np.zeros_like(force), "force": force, "push_s": push_s, "loaded": ~still}
    return observations_of(rec, source, in_frame, rest, noise, np.all(np.isfinite(force), axis=1), **loads)


def _force_seen(
    virtual: VirtualRecording, error: Array | None, at: Array, cutoff: float
) -> tuple[CleanForce | None, Array, Array]:
    """The cleaned log if used, the force (T, 2) N at the frames `at` (T,) [s] of its clock, and its sd."""
    if error is not None:
        if error.shape != virtual.force.shape:
            raise RecordingError(f"the force at the frames is {virtual.force.shape}, its error is {error.shape}")
        return None, virtual.force + error, np.sqrt(np.mean(error**2, axis=0))
    begin, end = (moment + virtual.bench.clock.offset for moment in virtual.bench.push.contact)
    rests = [(-inf, begin - MARGIN)]
    if virtual.bench.push.after > 2.0 * MARGIN:
        rests.append((end + MARGIN, inf))
    clean = clean_force(virtual.log, rests, cutoff=cutoff)
    return clean, force_at(clean, at)[0], clean.noise_sd
