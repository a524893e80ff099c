"""What a logger lost: samples that are missing between others, and forces of exactly zero in place of measured ones."""

from __future__ import annotations

import numpy as np

from onebend.recording.signals import MAD_TO_SD, runs, step, within_noise
from onebend.records import Array, BoolArray, Remark

EVEN = 0.1  # of the samples: more that are off their place mean that the log has no rate to miss samples of
JUMP = 5.0  # noise sd: a zero that is entered or left by less may be a force that was zero
HELD, SLOW = 0.5, 20.0  # s, and usual runs: forces that stand still for longer are not measured
OFTEN = 3  # runs of zeros that are surely false: then runs as short as these are false as well
NOTICED = 0.01  # of the samples: more that are missing are a warning


def missing(time: Array) -> int:
    """How many samples lack among those at `time` [s, rising]; 0 where they do not come evenly."""
    if len(time) < 3:
        return 0
    steps, usual = np.diff(time), step(time)
    if not usual > 0 or np.mean(np.abs(steps - usual) > usual / 2) > EVEN:
        return 0
    return int(np.sum(np.maximum(np.rint(steps / usual) - 1, 0)))


def missing_remarks(time: Array, what: str) -> tuple[Remark, ...]:
    """What is missing among the `what` ("rows of the force log") at `time` [s, rising], in words."""
    lost = missing(time)
    if not lost:
        return ()
    longest = float(np.diff(time).max())
    text = f"About {lost} {what} are missing, {len(time)} are there; the longest gap is {longest:.3g} s."
    return (Remark("warning" if lost > NOTICED * len(time) else "note", text),)


def false_zeros(force: Array) -> BoolArray:
    """(N,) rows in which all of `force` (N, c) is exactly zero though it is not just before or after: a robot that was
    not streaming, or near a singularity.

    A run that is entered and left gently may be true: it is not among them, unless it is no longer than the runs that
    are entered and left by a jump, and there are several of these.
    """
    zero = np.asarray(np.all(force == 0.0, axis=1))
    if not zero.any() or zero.all():
        return np.zeros(len(force), dtype=bool)
    size = np.linalg.norm(force, axis=1)
    pairs = ~zero[1:] & ~zero[:-1]
    noise = MAD_TO_SD * float(np.median(np.linalg.norm(np.diff(force, axis=0), axis=1)[pairs])) if pairs.any() else 0.0
    found = np.zeros(len(force), dtype=bool)
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
        found[begin:end] = True
    return found


def held(time: Array, force: Array) -> BoolArray:
    """(N,) rows that repeat the forces (N, c) of the row before to the last digit, for so long that they cannot have
    been measured: a sensor or a logger that hung. None where the log shows no noise, or repeats every force for long;
    and neither zeros, which may be true, nor the log's own extremes, where a sensor is at its end.
    """
    found = np.zeros(len(force), dtype=bool)
    if not len(force):
        return found
    same = np.concatenate([[False], np.all(np.diff(force, axis=0) == 0.0, axis=1)])
    fresh = force[~same]
    if len(fresh) < 10 or not any(within_noise(column) for column in fresh.T):
        return found
    usual = float(np.median(np.diff(np.flatnonzero(~same))))
    extreme = np.all((force == force.max(axis=0)) | (force == force.min(axis=0)), axis=1)
    same &= ~extreme & np.any(force != 0.0, axis=1)
    for begin, end in runs(same):
        if end - begin > SLOW * usual and time[end - 1] - time[begin] > HELD:
            found[begin:end] = True
    return found
