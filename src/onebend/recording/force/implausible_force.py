"""Mistakes that a force log shows by itself: a channel not connected, a sensor at its limit, another unit."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from onebend.errors import ObservationError
from onebend.recording.signals import within_noise
from onebend.records import Array, Remark

AXES = ("first", "second")
AT_END, MORE_THAN_NEXT, FEWEST = 0.01, 3.0, 5  # share of rows at an extreme value; times those at the next; rows
LARGEST, SMALLEST = (
    100.0,
    5e-3,
)  # N: less than the first bends a soft beam, and sensors for it do not resolve the second
TOO_LARGE = 500.0  # N: what a person could not hold bends no soft beam
TOO_MANY_WEIGHTS, TOO_FEW_WEIGHTS = 700.0, 0.01  # a rod of carbon fibre bends under some hundred times its weight
OF_WEIGHT = 50.0  # times the beam's weight; the force that bends a soft beam is near its weight
OTHER_UNIT = re.compile(r"[_\s\[(/](mN|kN|uN|g|gf|kg|kgf|lbf?|ozf?|counts|V|mV)[\])]?$")
OTHER_TIME = re.compile(r"[_\s\[(/](ms|us|ns)[\])]?$")


def still_columns(force: Array) -> tuple[Remark, ...]:
    """A warning for each column of the forces (N, 2) that never changes."""
    sentence = "force of the log never changes ({:g} N): is its channel connected? Check columns."
    constant = np.ptp(force, axis=0) == 0.0
    return tuple(
        Remark("warning", f"The {axis} {sentence.format(value)}", about="constant force")
        for axis, value, unchanged in zip(AXES, force[0], constant, strict=True)
        if unchanged
    )


def at_its_end(force: Array) -> tuple[Remark, ...]:
    """A warning for each column of the forces (N, 2) that often takes its own largest or smallest value.

    A sensor at the end of its range repeats one number; a measured force scatters about its largest one. Columns
    without visible noise, or written with few digits, repeat numbers anyway and are not judged.
    """
    remarks = []
    for axis, column in zip(AXES, force.T, strict=True):
        values, counts = np.unique(column, return_counts=True)
        for end, index, inward in (("largest", -1, -2), ("smallest", 0, 1)):
            if len(values) < 3 or counts[index] < max(AT_END * len(column), MORE_THAN_NEXT * counts[inward], FEWEST):
                continue
            at_extreme = column == values[index]
            after, before = np.append(False, at_extreme[:-1]), np.append(at_extreme[1:], False)
            alone = at_extreme & ~after & ~before
            if 2 * alone.sum() < counts[index] and within_noise(column[~at_extreme]):  # spikes are alone
                share = 100 * counts[index] / len(column)
                text = (
                    f"The {axis} force of the log stands at exactly its {end} value, {values[index]:g} N, in "
                    f"{share:.0f} % of its rows: the sensor is at the end of its range, and the force was larger. k(s) "
                    "comes out wrong; push less, or take a wider range."
                )
                remarks.append(Remark("warning", text, doubt=True, about="sensor's end"))
    return tuple(remarks)


def refuse_other_unit(force: Array, mass: float, where: str) -> None:
    """Raise where the forces (N, 2) [N] on a beam of `mass` [kg; NaN: unknown] are a thousand times off: no soft
    beam bends under as much, or under as little, of what its weight is.

    Raises:
        ObservationError: with the unit that would fit.
    """
    largest = float(np.max(np.linalg.norm(force, axis=1), initial=0.0))
    weights = largest / (9.81 * mass) if mass > 0 else math.nan
    times = f", {weights:.3g} times its weight" if mass > 0 else ""
    if largest > TOO_LARGE or weights > TOO_MANY_WEIGHTS:
        said, units = "is", "millinewtons, grams or counts"
    elif 0.0 < largest < SMALLEST and weights < TOO_FEW_WEIGHTS:
        said, units = "is only", "kilonewtons"
    else:
        return
    raise ObservationError(
        f"{where}: the largest force on the beam {said} {largest:.3g} N{times}. Is the log in {units}? Convert it to "
        "newtons; else all of k(s) is wrong by the same factor. If it is right, correct mass_kg.",
        about="force unit",
    )


def size_remarks(force: Array, mass: float) -> tuple[Remark, ...]:
    """A warning where the forces (N, 2) [N] on a beam of `mass` [kg; NaN: unknown] are as large, or as small, as if
    they stood in another unit."""
    largest = float(np.max(np.linalg.norm(force, axis=1), initial=0.0))
    heavy = largest / (9.81 * mass) if mass > 0 else 0.0
    if largest > LARGEST or heavy > OF_WEIGHT:
        times = f", {heavy:.0f} times its weight" if heavy > OF_WEIGHT else ""
        text = f"The largest force on the beam is {largest:.3g} N{times}"
    elif 0.0 < largest < SMALLEST:
        text = f"The largest force on the beam is only {largest:.2g} N"
    else:
        return ()
    text += ": is the log in newtons (not mN, grams)? All of k(s) is wrong by the same factor."
    return (Remark("warning", text, about="force unit"),)


def unit_in_name(columns: Sequence[str], time_unit: str) -> str:
    """What to do about columns (time, two forces) whose own names give another unit; "" where none does."""
    time, *forces = columns
    if (match := OTHER_TIME.search(time)) and match[1] != time_unit:
        return f'the column {time} is in {match[1]} by its name: write time_unit = "{match[1]}" in [force]'
    for name in forces:
        if match := OTHER_UNIT.search(name):
            return f"the column {name} is in {match[1]} by its name: convert it to newtons, and name it so"
    return ""
