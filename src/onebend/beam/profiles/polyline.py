"""Values that go straight from place to place, as a drawing or a table of measured sizes gives them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from onebend.errors import MechanicsError
from onebend.records import Array


@dataclass(frozen=True)
class Polyline:
    """Straight between places, constant beyond the first and the last. A place that stands twice is a step: there the
    second value holds."""

    s: tuple[float, ...]
    values: tuple[float, ...]
    jumps: tuple[float, ...] = ()  # steps, and corners so sharp that a grid needs an edge there

    def __post_init__(self) -> None:
        if len(self.s) != len(self.values) or len(self.s) < 2:
            raise MechanicsError("a polyline needs at least two places, and one value a place")
        apart = np.diff(self.s)
        if np.any(apart < 0.0) or apart[0] == 0.0 or apart[-1] == 0.0 or np.any((apart[1:] + apart[:-1]) == 0.0):
            raise MechanicsError("a polyline's places must rise; one inside may stand twice, as a step")
        if not np.all(np.isfinite([*self.s, *self.values])) or not all(0.0 < jump < 1.0 for jump in self.jumps):
            raise MechanicsError("a polyline's numbers must be finite, and its jumps inside the beam")

    def __call__(self, s: Array | float) -> Array:
        places, values = np.asarray(self.s), np.asarray(self.values)
        inside = np.clip(np.asarray(s, dtype=float), places[0], places[-1])
        i = np.clip(np.searchsorted(places, inside, side="right") - 1, 0, len(places) - 2)
        share = (inside - places[i]) / (places[i + 1] - places[i])
        return np.asarray(values[i] + share * (values[i + 1] - values[i]))

    def as_dict(self) -> dict[str, Any]:
        return {"kind": "polyline", "s": list(self.s), "values": list(self.values), "jumps": list(self.jumps)}
