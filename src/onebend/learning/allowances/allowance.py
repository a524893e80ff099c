"""An allowance: a few parameters for something that a real bench does and the ideal beam does not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from onebend.records import Array

# Where an allowance enters the model, and what its `basis` is there. F frames, Q nodes, m tags, n parameters:
#   "log k"       (Q, n) or (F, Q, n): added to log k at the nodes
#   "force"       (F, 2, n): added to the force on the beam, per N
#   "place"       (F, n) 1: added to the place of the push [m]
#   "load"        (F, Q, 2, n): added to the force beyond each node [N]
#   "clamp"       (F, n) 1: added to the clamp's angle [rad]
#   "poses"       (F, m, 3, n): added to the tags' poses
#   "section", "relaxation", "length": the model's own; no basis, or the frames' times
Entry = Literal["log k", "force", "place", "load", "clamp", "poses", "section", "relaxation", "length"]


@dataclass(frozen=True)
class Allowance:
    """n parameters, zero for the ideal beam on the ideal bench, with one sd each before the data."""

    name: str
    enters: Entry
    unit: str
    labels: tuple[str, ...]  # (n,)
    prior_sd: Array  # (n,)
    basis: Array  # see `Entry`
    shared: bool = False  # by all recordings of the beam; else each recording has its own
    sized: bool = False  # the evidence chooses one factor on all of `prior_sd`

    @property
    def count(self) -> int:
        return len(self.labels)


Sizes = Mapping[str, float]  # factors on the `prior_sd` of the allowances that are `sized`, by their names
