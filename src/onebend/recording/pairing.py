"""Markers and force on one clock: reading the log, matching the clocks, cleaning, pairing, checking."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from onebend.errors import ObservationError
from onebend.recording.bags.force_topic import read_bag_force
from onebend.recording.beam_frame import RestShape
from onebend.recording.clock.offset import ClockFit, ClockSettings, displacements, fit_clock
from onebend.recording.clock.sensor_lag import slow_sensor, without_lag
from onebend.recording.force.cleaning import (
    ForceSettings,
    choose_cutoff,
    clean_force,
    force_at,
    gap_limit,
    to_beam,
)
from onebend.recording.force.contact import Contact
from onebend.recording.force.force_log import FEWEST_ROWS, read_force_log
from onebend.recording.force.implausible_force import refuse_other_unit, size_remarks
from onebend.recording.gravity import BaseLog, base_clock, check_overlap
from onebend.recording.implausible_axes import LOADED, axes_words, read_force, turn_beyond
from onebend.recording.signals import at_times, bandwidth, step
from onebend.recording.toml.entries import ForceEntry, Recording
from onebend.records import Array, BoolArray, CleanForce, ClockOffset, ForceLog, Markers, Remark

BENDS_BEYOND = 0.05  # of the largest turn of a tag: a heavy or a fast beam bends less than that beyond the push
LEAST_TURN = math.radians(3.0)


def read_log(rec: Recording) -> ForceLog | None:
    """The force log, where the recording has one."""
    if rec.force is None:
        return None
    if rec.force.topic:
        return read_bag_force(rec.force)
    column = rec.push.column if rec.push else ""
    return read_force_log(rec.force.file, rec.force.columns, column, time_unit=rec.force.time_unit)


def match_clocks(
    rec: Recording, markers: Markers, log: ForceLog | None, base: BaseLog | None, settings: ClockSettings
) -> ClockFit:
    """The offset from the force, else from the base's turn, else as written; 0 where there is no second clock.

    Where the start is said to be exact, it is as written, with an sd of 0.

    Raises:
        ObservationError: film and log do not overlap, or nothing says when the film starts.
    """
    stated, uncertainty = rec.start
    if log is None and base is None:
        start = stated if math.isfinite(stated) else 0.0
        return ClockFit(ClockOffset(offset=start, sd=uncertainty, stated=stated, found=False), None)
    fit = None
    if log is not None and rec.force is not None:
        check_pace(rec, markers, log)
        fit = fit_clock(
            markers, _turned(log, rec.force), stated, uncertainty, push_s=push_place(rec, log), settings=settings
        )
    exact = uncertainty == 0.0 and math.isfinite(stated)
    if exact and fit is None:
        fit = ClockFit(ClockOffset(offset=stated, sd=0.0, stated=stated, found=True), None)
    if base is not None and (fit is None or not fit.clock.found):
        base_offset = base_clock(markers, base, stated, uncertainty, margin=settings.margin)
        if base_offset.found or fit is None:
            fit = ClockFit(base_offset, None)
    assert fit is not None
    if not math.isfinite(fit.clock.offset):
        raise ObservationError(
            f"{rec.name}: nothing says when the film (or the tracks) starts on the log's clock, and the data do not "
            "show it. Write start_s in recording.toml.",
            about="clock",
        )
    times = log.time if log is not None else base.time if base is not None else markers.time
    check_overlap(markers, times, fit.clock.offset, "force log" if log is not None else "base angle log")
    return fit


def without_slow_sensor(
    rec: Recording, markers: Markers, log: ForceLog | None, fit: ClockFit, clock: ClockSettings, force: ForceSettings
) -> tuple[ForceLog | None, tuple[Remark, ...]]:
    """The log, where its sensor is slow as one that is not would have written it, with a warning; else as it is."""
    if log is None or rec.force is None:
        return log, ()
    lag = slow_sensor(markers, _turned(log, rec.force), fit.clock, push_s=push_place(rec, log), settings=clock)
    if lag is None:
        return log, ()
    text = (
        f"The force sensor is slow: its log follows the force with a time constant of about {lag.tau:.2g} s, which "
        "makes every peak too low and k(s) too small. This was undone, as well as the log allows. Switch the "
        "sensor's filter off, or push more slowly."
    )
    cutoff = choose_cutoff(bandwidth(markers.time, displacements(markers)), force)
    return without_lag(log, lag.tau, cutoff), (Remark("warning", text, about="clock"),)


def _turned(log: ForceLog, entry: ForceEntry) -> ForceLog:
    """The log in the beam's frame."""
    return replace(log, force=log.force @ to_beam(entry.rotation))


def check_pace(rec: Recording, markers: Markers, log: ForceLog) -> None:
    """Raise where the log has too few rows during the film: its times are in another unit, or it is too sparse."""
    film, spacing = float(np.ptp(markers.time)), step(log.time)
    if spacing * FEWEST_ROWS > film:
        raise ObservationError(
            f"{rec.name}: the force log has a row every {spacing:.3g} s, fewer than {FEWEST_ROWS} during the film of "
            f"{film:.3g} s. Times must be in seconds: for milliseconds write "
            'time_unit = "ms" in [force]. Or log more often.',
            about="unit",
        )


def push_place(rec: Recording, log: ForceLog) -> float | None:
    """Where the force acts, if that stays the same to 2 % of the beam and no weight bends it too; else None."""
    if rec.gravity is not None:
        return None
    if log.push_s is None:
        return rec.push.at if rec.push else None
    return float(np.median(log.push_s)) if float(np.ptp(log.push_s)) < 0.02 else None


def cleaned(
    rec: Recording, markers: Markers, log: ForceLog, contact: Contact, fit: ClockFit, settings: ForceSettings
) -> CleanForce:
    """The force on the beam, its cut-off from the markers' motion and its zero from the rests."""
    assert rec.force is not None
    offset = fit.clock.offset
    clean = clean_force(
        log,
        [(low + offset, high + offset) for low, high in contact.rests],
        rotation=rec.force.rotation,
        acts_on=rec.force.acts_on,
        cutoff=choose_cutoff(bandwidth(markers.time, displacements(markers)), settings),
        noise=fit.noise,
        settings=settings,
    )
    refuse_other_unit(clean.force, rec.beam.mass, rec.name)
    implausible = size_remarks(clean.force, rec.beam.mass)
    return replace(clean, remarks=(*clean.remarks, *implausible)) if implausible else clean


def pair(
    rec: Recording,
    clean: CleanForce | None,
    time: Array,
    *,
    pairing: Literal["interpolate", "nearest"],
    epsilon: float,
    settings: ForceSettings,
) -> tuple[Array, Array]:
    """(T, 2) N force and (T,) place of the push at the times `time` [s, log's clock]; NaN where the log is silent.

    "nearest" is the paper's way: the nearest row of the log, if within `epsilon` [s]. Without a log the force is
    zero and its place unknown.
    """
    count = len(time)
    if clean is None:
        return np.zeros((count, 2)), np.full(count, np.nan)
    if pairing == "nearest":
        after = np.clip(np.searchsorted(clean.time, time), 1, len(clean.time) - 1)
        row = np.where(time - clean.time[after - 1] < clean.time[after] - time, after - 1, after)
        close = np.abs(clean.time[row] - time) <= epsilon
        force = np.where(close[:, None], clean.force[row], np.nan)
        place = clean.push_s[row] if clean.push_s is not None else None
    else:
        force = force_at(clean, time, settings=settings)
        limit = gap_limit(clean.time, clean.cutoff, settings)
        place = (
            None if clean.push_s is None else at_times(clean.time, clean.push_s[:, None], time, longest_gap=limit)[:, 0]
        )
    if place is None:
        place = np.full(count, rec.push.at if rec.push else math.nan)
    return force, place


def usable(markers: Markers, force: Array) -> tuple[BoolArray, tuple[Remark, ...]]:
    """(T,) frames with a force and at least one marker, and remarks on the others.

    Raises:
        ObservationError: no frame is left.
    """
    has_force: BoolArray = np.isfinite(force).min(axis=1)
    has_marker: BoolArray = np.isfinite(markers.xy).min(axis=-1).max(axis=1)
    remarks = []
    if not has_force.all():
        text = (
            f"{int(np.sum(~has_force))} of {len(has_force)} frames lie outside the force log or in its gaps; left out."
        )
        remarks.append(Remark("note", text))
    if not has_marker.all():
        remarks.append(
            Remark("note", f"{int(np.sum(~has_marker))} of {len(has_marker)} frames show no marker; left out.")
        )
    good: BoolArray = np.asarray(has_force & has_marker)
    if not good.any():
        raise ObservationError(
            "No frame has both a marker and a force. Check the film, the log and start_s.", about="no overlap"
        )
    return good, tuple(remarks)


def check_direction(
    rec: Recording, markers: Markers, rest: RestShape, force: Array, push_s: Array, loaded: BoolArray, *, refuse: bool
) -> tuple[Remark, ...]:
    """A remark where another reading of the force's axes explains the bending far better; k(s) is in doubt where it
    does so exactly. Where something is left, a sensor whose error changes with the load can have done it, which the fit
    allows for.

    Raises:
        ObservationError: where `refuse`, if the force as it is contradicts the bending.
    """
    rotation = rec.force.rotation if rec.force else 0.0
    reading = read_force(markers, rest, force, push_s, loaded, rotation=rotation)
    if reading is None or not (reading.impossible or reading.better or reading.rotated):
        return ()
    text = axes_words(reading, rotation, key="axes" if rec.force and rec.force.topic else "columns")
    if not reading.exact and not reading.inexplicable:
        text += f" {LOADED}"
    if rec.markers is not None:
        text += f" Or the axes of {rec.markers.file.name} are not those of the log: x_m, y_m and angle_rad."
    if refuse and reading.impossible:
        text = f"{text} {_or_the_clocks(rec, markers)}".rstrip()
        raise ObservationError(f"{rec.name}: {text}", about="axes")
    return (Remark("warning", text, doubt=reading.impossible or reading.exact, about="axes"),)


def check_place(
    rec: Recording, markers: Markers, rest: RestShape, push_s: Array, loaded: BoolArray
) -> tuple[Remark, ...]:
    """A warning where the beam bends between tags (with angles of their own) that both sit beyond the push."""
    if rec.gravity is not None or rec.push is None or not loaded.any():
        return ()
    beyond, largest = turn_beyond(markers, rest, push_s, loaded)
    if beyond < max(BENDS_BEYOND * largest, LEAST_TURN):
        return ()
    text = (
        f"The beam bends by {math.degrees(beyond):.2g} deg between tags beyond the push, where nothing acts on it. "
        "Check at_s in [push] (a share of the length, 1 at the tip), and the tags' s."
    )
    return (Remark("warning", text, doubt=True, about="push place"),)


def _or_the_clocks(rec: Recording, markers: Markers) -> str:
    """Other mistakes that look like a force that contradicts the bending: a sentence, or nothing."""
    seconds = float(markers.time[-1] - markers.time[0])
    rate = (len(markers.time) - 1) / seconds
    of_film = f"the film's frame rate is wrong (with {rate:.3g} a second it lasts {seconds:.3g} s)"
    table = "video" if rec.video is not None else "markers"
    of_start = f"start_s in [{table}] is farther off than start_uncertainty_s: without it the whole log is searched"
    possible = [of_film] if rec.video is not None else []
    possible += [of_start] if math.isfinite(rec.start[0]) else []
    return f"Or {', or '.join(possible)}." if possible else ""
