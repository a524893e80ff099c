"""Which mode a measured frequency is of, where nobody says it: as the frequencies lie to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from onebend.errors import LearningError
from onebend.learning.frequencies.frequency_data import MOST_MODES
from onebend.learning.frequencies.level import uniform_stiffness
from onebend.records import MeasuredFrequency, Observations

_ALIKE = 0.25  # of log k, RMS: as far as the modes of one beam may disagree on the k of a uniform one
_CLEARER = 0.25  # by which the second best numbering must disagree more
_SAY = "Write `mode` in each [[frequencies]]: 1 is the slowest"


def with_modes(recordings: Sequence[Observations]) -> tuple[Observations, ...]:
    """The recordings with the mode of every frequency.

    Each posture's are numbered, in rising order, so that a uniform beam with the mass as it is spread would come
    nearest to all of them; the slowest of all is taken to be mode 1.

    Raises:
        LearningError: a frequency by itself, no numbering that comes near, or several that come about as near.
    """
    return tuple(_numbered(o) if any(one.mode == 0 for one in o.frequencies) else o for o in recordings)


def _numbered(o: Observations) -> Observations:
    if len(o.frequencies) < 2:
        only = o.frequencies[0].frequency
        raise LearningError(f"{o.source.name}: nothing says which mode {only:.4g} Hz is. {_SAY}")
    levels = [
        [np.log(uniform_stiffness(o, one, mode)) for mode in range(1, MOST_MODES + 1)] for one in o.frequencies
    ]  # (N, modes)
    middle = sorted({level for each in levels for level in each})
    tried: dict[tuple[int, ...], float] = {}
    for level in middle:
        modes = _nearest(o.frequencies, levels, level)
        if modes is not None and min(modes) == 1:
            found = [levels[i][mode - 1] for i, mode in enumerate(modes)]
            tried[modes] = float(np.std(found))
    best = sorted(tried.items(), key=lambda pair: pair[1])
    if not best or best[0][1] > _ALIKE or (len(best) > 1 and best[1][1] < best[0][1] + _CLEARER):
        said = ", ".join(f"{one.frequency:.4g}" for one in o.frequencies)
        raise LearningError(f"{o.source.name}: nothing says which modes {said} Hz are. {_SAY}")
    pairs = zip(o.frequencies, best[0][0], strict=True)
    return replace(o, frequencies=tuple(replace(one, mode=mode) for one, mode in pairs))


def _nearest(
    frequencies: Sequence[MeasuredFrequency], levels: Sequence[Sequence[float]], level: float
) -> tuple[int, ...] | None:
    """Modes that fit a uniform beam of this log k best; in each posture they rise with the frequency."""
    out = [one.mode for one in frequencies]
    for posture in {(one.gravity, one.tip_mass) for one in frequencies}:
        rows = [i for i, one in enumerate(frequencies) if (one.gravity, one.tip_mass) == posture]
        rows.sort(key=lambda i: frequencies[i].frequency)
        ways = [
            modes
            for modes in combinations(range(1, MOST_MODES + 1), len(rows))
            if all(frequencies[i].mode in (0, mode) for i, mode in zip(rows, modes, strict=True))
        ]
        if not ways:
            return None
        away = [sum((levels[i][m - 1] - level) ** 2 for i, m in zip(rows, modes, strict=True)) for modes in ways]
        for i, mode in zip(rows, ways[int(np.argmin(away))], strict=True):
            out[i] = mode
    return tuple(out)
