"""The place where the tool touches the beam slides as the beam turns under it."""

from __future__ import annotations

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.course import PushCourse, with_rest
from onebend.records import Array

SLIDE_SD = 2.5e-3  # m per rad that the beam turns at the push: the radius of a finger or a rod


def sliding(marker_s: Array, run: PushCourse, push_s: Array) -> Allowance:
    """`s_a(t) = s_0 + b (a(s_0, t) - a(s_0, 0))` with b in m per rad; `push_s` (F,)."""
    basis = with_rest(turn_at_push(marker_s, run.turn, push_s)[:, None], len(push_s))
    return Allowance("slide", "place", "m/rad", ("contact slides",), np.array([SLIDE_SD]), basis)


def turn_at_push(marker_s: Array, turn: Array, push_s: Array) -> Array:
    """(T,) rad since rest of the beam at `push_s`, of which there are at least T; `turn` (T, m) of the tags."""
    places = np.append(0.0, marker_s)
    turns = np.concatenate([np.zeros((len(turn), 1)), turn], axis=1)
    return np.array([float(np.interp(s, places, turn)) for s, turn in zip(push_s, turns, strict=False)])
