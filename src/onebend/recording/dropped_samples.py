"""Samples that a logger lost: missing rows, zeros in place of measured forces, and rows that repeat."""

from __future__ import annotations

import numpy as np

from onebend.recording.signals import MAD_TO_SD, runs, step, within_noise
from onebend.records import Array, BoolArray, Remark

EVEN = 0.1  # of the samples: with more at uneven spacings the log has no rate, and missing ones cannot be counted
JUMP = 5.0  # noise sd: a run of zeros between smaller jumps may be a true zero force
HELD, SLOW = 0.5, 20.0  # s, and usual run lengths: forces that repeat for longer were not measured
OFTEN = 3  # runs of zeros that are certainly false; with so many, other runs as short count as false too
NOTICED = 0.01  # of the samples: if more are missing, it is a warning


def missing(time: Array) -> int:
    """How many samples are missing between those at `time` [s, rising]; 0 where the spacing is uneven."""
    if len(time) < 3:
        return 0
    steps, spacing = np.diff(time), step(time)
    if not spacing > 0 or np.mean(np.abs(steps - spacing) > spacing / 2) > EVEN:
        return 0
    return int(np.sum(np.maximum(np.rint(steps / spacing) - 1, 0)))


def missing_remarks(time: Array, what: str) -> tuple[Remark, ...]:
    """A remark on missing samples at `time` [s, rising]; `what` names them, as "rows of the force log"."""
    count = missing(time)
    if not count:
        return ()
    longest = float(np.diff(time).max())
    text = f"About {count} {what} are missing, {len(time)} are there; the longest gap is {longest:.3g} s."
    if count <= NOTICED * len(time):
        return (Remark("note", text, about="bad rows"),)
    return (Remark("warning", f"{text} Look at what drops them, and record again.", about="bad rows"),)


def false_zeros(force: Array) -> BoolArray:
    """(N,) rows in which `force` (N, c) is exactly zero between other values: the robot did not stream, or was near a
    singularity.

    A run of zeros between two jumps is false. A run without jumps may be a true zero force; it counts as false only
    where several false runs exist and it is no longer than the longest of them.
    """
    zero = np.asarray(np.all(force == 0.0, axis=1))
    if not zero.any() or zero.all():
        return np.zeros(len(force), dtype=bool)
    size = np.linalg.norm(force, axis=1)
    pairs = ~zero[1:] & ~zero[:-1]
    noise = MAD_TO_SD * float(np.median(np.linalg.norm(np.diff(force, axis=0), axis=1)[pairs])) if pairs.any() else 0.0
    false = np.zeros(len(force), dtype=bool)
    spans = runs(zero).tolist()
    sure = []
    for begin, end in spans:
        beside = [size[i] for i in (begin - 1, end) if 0 <= i < len(size)]
        if noise > 0 and min(beside) > JUMP * noise:
            sure.append((begin, end))
    if len(sure) >= OFTEN:
        longest = max(end - begin for begin, end in sure)
        sure += [(begin, end) for begin, end in spans if end - begin <= longest]
    for begin, end in sure:
        false[begin:end] = True
    return false


def held(time: Array, force: Array) -> BoolArray:
    """(N,) rows that repeat the forces (N, c) of the row before exactly, and for so long that they cannot have been
    measured: the sensor or the logger hung.

    No row counts where the log shows no noise, or where every force is repeated for long. Rows of zeros do not count,
    as they may be true, nor do the largest and smallest forces, where the sensor is at its limit.
    """
    hung = np.zeros(len(force), dtype=bool)
    if not len(force):
        return hung
    same = np.concatenate([[False], np.all(np.diff(force, axis=0) == 0.0, axis=1)])
    fresh = force[~same]
    if len(fresh) < 10 or not any(within_noise(column) for column in fresh.T):
        return hung
    run = float(np.median(np.diff(np.flatnonzero(~same))))
    extreme = np.all((force == force.max(axis=0)) | (force == force.min(axis=0)), axis=1)
    same &= ~extreme & np.any(force != 0.0, axis=1)
    for begin, end in runs(same):
        if end - begin > SLOW * run and time[end - 1] - time[begin] > HELD:
            hung[begin:end] = True
    return hung
