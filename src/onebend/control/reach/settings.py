"""Settings and bounds of a reach, and checks against them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from onebend.control.goals.targets import numbers
from onebend.control.reach.loaded_beam import LoadedState, PushedBeam
from onebend.control.reach.paper_iteration import PaperSettings
from onebend.errors import ControlError
from onebend.records import Array

FARTHEST_GOAL = 1e9  # m or rad


@dataclass(frozen=True)
class ReachSettings:
    """How a force is sought, and within which bounds."""

    method: Literal["newton", "paper"] = "newton"
    max_force: float | None = None  # N; infinite is none, as it is below
    max_curvature: float | None = None  # 1/m beyond that at rest, anywhere along the beam
    direction: float | None = None  # rad: the force can only push this way
    moment: bool = False  # whether the gripper gives a moment too
    gravity: tuple[float, float] = (0.0, 0.0)  # m/s^2, beam's frame
    tolerance: float = 1e-6  # m: a point this near to its goal is there
    steps: int = 20  # of the path of forces; fewer only where a growing load does not connect the shapes
    paper: PaperSettings = field(default_factory=PaperSettings)

    def __post_init__(self) -> None:
        if self.direction is not None and (self.moment or not math.isfinite(self.direction)):
            raise ControlError("a force in one direction is one finite angle [rad], and goes without a moment")
        for name, words in (("max_force", "the largest force"), ("max_curvature", "the largest curvature")):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise ControlError(f"{words} must be positive, got {value:g}")
            if value == math.inf:
                object.__setattr__(self, name, None)
        if not self.tolerance > 0.0 or self.steps < 1:
            raise ControlError("the tolerance must be positive, and the path needs at least one step")
        bound = self.max_force is not None or self.max_curvature is not None or self.direction is not None
        if self.method == "paper" and (bound or self.moment or any(self.gravity)):
            raise ControlError("the paper's iteration knows no bounds, moment or weight; take the method newton")

    @property
    def loads(self) -> int:
        """How many of the two components of the force and the moment may be given."""
        return 3 if self.moment else 2


def checked_goal(goal: ArrayLike, settings: ReachSettings) -> Array:
    """The goal as an array (2,) or (3,). Raises `ControlError` where it has no meaning."""
    wanted = np.asarray(goal, dtype=float)
    if wanted.shape not in ((2,), (3,)) or not np.all(np.abs(wanted) < FARTHEST_GOAL):
        raise ControlError(f"a goal is a place (x, y) [m], or with an angle (x, y, angle [rad]); got {numbers(wanted)}")
    if len(wanted) == 3 and not settings.moment:
        raise ControlError("a force alone cannot hold a point at an angle: allow a moment, or leave the angle out")
    return wanted


def broken_bound(pushed: PushedBeam, state: LoadedState, settings: ReachSettings) -> str:
    """The bound that the state breaks, in words; empty where it breaks none."""
    size = math.hypot(state.load[0], state.load[1])
    if settings.max_force is not None and size > settings.max_force * (1.0 + 1e-9):
        return f"it needs {size:.3g} N, and {settings.max_force:.3g} N are allowed"
    if settings.max_curvature is not None:
        bend = pushed.bend(state.q)
        if bend > settings.max_curvature * (1.0 + 1e-9):
            return f"it bends the beam by {bend:.3g} 1/m, and {settings.max_curvature:.3g} 1/m are allowed"
    return ""
