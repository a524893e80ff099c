"""What the cells of a line are: forces with their units, a time, a counter; for load cells that send lines, and for
logs that grow."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.errors import RecordingError
from onebend.records import Array

POUND, KILOPOND = 4.4482216152605, 9.80665  # N
UNITS = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "g": 1e-3 * KILOPOND, "kg": KILOPOND, "lbf": POUND}
MOMENTS = {"Nm": 1.0, "N_m": 1.0, "mNm": 1e-3, "Nmm": 1e-3}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
IGNORED, COUNTER = "_", "number"
KNOWN = (
    f"Name forces as fx_N, fy_mN, fz_kg ({', '.join(UNITS)}), moments as tz_Nm, a time as time_s or time_ms, "
    f"{COUNTER} for a counter, {IGNORED} for what is left out"
)
SEPARATORS = re.compile(r"[,;\s]+")


@dataclass(frozen=True)
class Cells:
    """How a line of numbers is read."""

    columns: tuple[str, ...]  # of the log: fx_N and so on
    place: tuple[int, ...]  # in the line, of each; -1: it is zero
    scale: tuple[float, ...]  # to SI
    time: int = -1  # the cell with the time; -1: there is none
    time_scale: float = 1.0
    counter: int = -1
    count: int = 0  # cells of a line

    def rows(self, lines: Sequence[str]) -> tuple[Array, int]:
        """(n, 2 + c) of the lines that can be read: time [s] (NaN where none), counter, forces; and how many could
        not."""
        read = [row for line in lines if (row := self._row(line)) is not None]
        return np.array(read).reshape(-1, 2 + len(self.columns)), len(lines) - len(read)

    def _row(self, line: str) -> list[float] | None:
        cells = [cell for cell in SEPARATORS.split(line.strip()) if cell]
        if len(cells) != self.count:
            return None
        try:
            forces = [0.0 if i < 0 else float(cells[i]) * k for i, k in zip(self.place, self.scale, strict=True)]
            time = math.nan if self.time < 0 else float(cells[self.time]) * self.time_scale
            number = math.nan if self.counter < 0 else float(cells[self.counter])
        except ValueError:
            return None
        named = [time] * (self.time >= 0) + [number] * (self.counter >= 0)
        return [time, number, *forces] if all(map(math.isfinite, (*named, *forces))) else None


def cells_of(names: Sequence[str], zero: Sequence[str] = (), *, where: str) -> Cells:
    """The cells of lines whose columns have these names, in order.

    `zero`: forces that cannot be (a roller, a thread), which no cell gives.

    Raises:
        RecordingError: a name without a meaning, no force, one force alone.
    """
    columns: list[tuple[str, int, float]] = []
    time, time_scale, counter = -1, 1.0, -1
    for i, name in enumerate(names):
        head, _, unit = name.partition("_")
        if name == COUNTER:
            counter = i
        elif head == "time" and unit in TIMES:
            time, time_scale = i, TIMES[unit]
        elif re.fullmatch(r"f[xyz]", head) and unit in UNITS:
            columns.append((f"{head}_N", i, UNITS[unit]))
        elif re.fullmatch(r"t[xyz]", head) and unit in MOMENTS:
            columns.append((f"{head}_Nm", i, MOMENTS[unit]))
        elif name == "push_s":
            columns.append((name, i, 1.0))
        elif name != IGNORED:
            raise RecordingError(f"{where}: the column {name!r} has no meaning here. {KNOWN}.")
    columns += [(name, -1, 0.0) for name in zero]
    given = [name for name, _, _ in columns]
    if len(set(given)) < len(given):
        raise RecordingError(f"{where}: a column is named twice in {', '.join(given)}.")
    if sum(name.endswith("_N") for name in given) < 2:
        raise RecordingError(
            f"{where}: two forces are needed, those in the plane of bending. Where one cannot be (a roller, a thread), "
            "say so: zero=fx_N."
        )
    columns.sort(key=lambda one: one[0])
    return Cells(
        columns=tuple(name for name, _, _ in columns),
        place=tuple(i for _, i, _ in columns),
        scale=tuple(scale for _, _, scale in columns),
        time=time,
        time_scale=time_scale,
        counter=counter,
        count=len(names),
    )
