"""[[frequencies]] in `recording.toml`: natural frequencies that were measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from onebend.recording.toml.schema import Mistakes, degrees, key, number, read_table, whole

MOST_FREQUENCIES = 100
MOST_MODE = 8  # beyond, a beam is no slender one any more


@dataclass(frozen=True)
class FrequencyEntry:
    """One natural frequency of the clamped beam, its other end free."""

    hz: float = key("hz", number(above=0), "the frequency of the free swing, Hz", example="3.21")
    sd: float = key("sd_hz", number(above=0), "how exactly it is known (one sd), Hz", example="0.01")
    mode: int = key(
        "mode", whole(least=1), "which of the beam's frequencies it is, 1 the slowest", example="1", default=0
    )
    base_angle: float = key(
        "base_angle_deg",
        degrees(),
        "the beam's x axis in the room, degrees: -90 hangs, 90 stands, 0 lies; none: it swings across gravity",
        example="-90.0",
        default=math.nan,
    )  # rad
    damping_ratio: float = key(
        "damping_ratio",
        number(least=0, most=0.7),
        "of this swing, which makes it slower by sqrt(1 - ratio^2)",
        example="0.02",
        default=0.0,
    )
    tip_mass: float = key(
        "tip_mass_kg", number(least=0), "a small mass fixed to the tip, kg", example="0.010", default=0.0
    )


def read_frequencies(rows: Any, mistakes: Mistakes) -> tuple[FrequencyEntry, ...]:
    """The [[frequencies]] of a file; what is wrong with them goes to `mistakes`."""
    if not isinstance(rows, list) or not 0 < len(rows) <= MOST_FREQUENCIES:
        text = f"Give 1 to {MOST_FREQUENCIES} tables [[frequencies]], each with hz and sd_hz."
        mistakes.add(("frequencies",), text)
        return ()
    read = [read_table(FrequencyEntry, row, ("frequencies", i), mistakes) for i, row in enumerate(rows)]
    seen: set[tuple[int, str, float]] = set()
    for i, one in enumerate(read):
        if one is None:
            continue
        place, posture = ("frequencies", i), (one.mode, f"{one.base_angle}", one.tip_mass)
        if one.mode > MOST_MODE:
            mistakes.add((*place, "mode"), f"mode is {one.mode}; modes 1 to {MOST_MODE} of a slender beam are known.")
        if one.sd >= one.hz:
            mistakes.add((*place, "sd_hz"), f"sd_hz = {one.sd:g} is no smaller than hz = {one.hz:g}. Are they swapped?")
        if one.mode > 0 and posture in seen:
            text = f"mode {one.mode} is given twice for one posture and tip mass. Give their mean, with its sd."
            mistakes.add((*place, "mode"), text)
        seen.add(posture)
    return tuple(one for one in read if one is not None)
