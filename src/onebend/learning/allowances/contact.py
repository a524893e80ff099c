"""The place where the tool touches the beam slides as the beam turns under it."""

from __future__ import annotations

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.course import PushCourse, with_rest
from onebend.records import Array, Observations

SLIDE_SD = 2.5e-3  # m per rad that the beam turns at the push: the radius of a finger or a rod


def sliding(observations: Observations, run: PushCourse, push_s: Array) -> Allowance:
    """`s_a(t) = s_0 + b (a(s_0, t) - a(s_0, 0))` with b in m per rad; `push_s` (F,)."""
    places = np.append(0.0, observations.marker_s)
    turns = np.concatenate([np.zeros((len(run.turn), 1)), run.turn], axis=1)
    at_push = [float(np.interp(s, places, turn)) for s, turn in zip(push_s, turns, strict=False)]
    basis = with_rest(np.array(at_push)[:, None], len(push_s))
    return Allowance("slide", "place", "m/rad", ("contact slides",), np.array([SLIDE_SD]), basis)
