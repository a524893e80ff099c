"""Does the force look as if it bent this beam? Flipped signs and swapped axes are the commonest mistakes.

The moment of the force about any place turns the beam there in its own sense, more where it is larger. That holds for
every beam that is clamped and passive, so a log that contradicts it clearly was written down with another sign or
other axes. Nothing is corrected here: a person must say which it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from onebend.recording.beam_frame import RestShape
from onebend.recording.force.cleaning import to_beam
from onebend.records import Array, BoolArray, Markers

TURNS: dict[str, Array] = {
    "as it is": np.array([[1.0, 0.0], [0.0, 1.0]]),
    "opposite": np.array([[-1.0, 0.0], [0.0, -1.0]]),
    "x and y swapped": np.array([[0.0, 1.0], [1.0, 0.0]]),
    "x and y swapped and both of opposite sign": np.array([[0.0, -1.0], [-1.0, 0.0]]),
    "x of opposite sign": np.array([[-1.0, 0.0], [0.0, 1.0]]),
    "y of opposite sign": np.array([[1.0, 0.0], [0.0, -1.0]]),
    "turned by +90 deg": np.array([[0.0, -1.0], [1.0, 0.0]]),
    "turned by -90 deg": np.array([[0.0, 1.0], [-1.0, 0.0]]),
}
TINY = 1e-300  # of a force that is zero throughout
CERTAIN = 0.5  # unexplained share of the moments above which the log as it is contradicts the film
BETTER = 0.1  # share of that which another reading may leave to be named
DOUBT = 0.015  # unexplained share of the moments above which a turn is looked for: simulated clean logs leave 0.008
SHARPER = 0.25  # share of that which the turned log may leave to be named


@dataclass(frozen=True)
class Reading:
    """How well each reading of the force's axes explains the bending."""

    unexplained: dict[str, float]  # share of the moments' squares, 0 to 1, by name of TURNS
    turn: float = 0.0  # rad, by which the log explains the bending best
    turned: float = 1.0  # share that is unexplained then

    @property
    def impossible(self) -> bool:
        """The log as it is contradicts the film."""
        return self.unexplained["as it is"] > CERTAIN

    @property
    def hopeless(self) -> bool:
        """No reading explains the bending."""
        return min(self.unexplained.values()) > CERTAIN

    @property
    def better(self) -> str:
        """The reading that fits far better than the log as it is, or nothing."""
        best = min(self.unexplained, key=lambda name: self.unexplained[name])
        left = self.unexplained["as it is"]
        return best if self.unexplained[best] < BETTER * left and left > 0.2 else ""

    @property
    def askew(self) -> bool:
        """The log explains the bending far better when its axes are turned by `turn`."""
        left = self.unexplained["as it is"]
        return left > DOUBT and self.turned < SHARPER * left


def read_force(
    markers: Markers, rest: RestShape, force: Array, push_s: Array, loaded: BoolArray, *, rotation: float = 0.0
) -> Reading | None:
    """Compare the readings over the `loaded` of T frames; None where the film cannot tell.

    For each span between neighbouring tags up to the push, the moment of the force about the span's middle is
    explained by the span's turn since rest times one stiffness that is not negative. The readings are of the log's own
    axes, whose x stands at `rotation` [rad] in the beam's frame.
    """
    if not np.isfinite(push_s[loaded]).any():
        return None
    turns, levers = spans(markers, rest, push_s)
    good = (
        loaded & np.isfinite(turns).all(axis=1) & np.isfinite(levers).all(axis=(1, 2)) & np.isfinite(force).all(axis=1)
    )
    if good.sum() < 10 or not turns.shape[1] or float(np.ptp(turns[good], axis=0).max()) < 0.05:
        return None
    turns, levers = turns[good], levers[good]
    axes = to_beam(rotation)
    left = {n: _unexplained(force[good] @ axes.T @ turn.T @ axes, turns, levers) for n, turn in TURNS.items()}
    angles = np.arange(-math.pi, math.pi, math.radians(2.0))
    by_angle = [_unexplained(force[good] @ to_beam(float(a)), turns, levers) for a in angles]
    best = int(np.argmin(by_angle))
    return Reading(left, float(angles[best]), by_angle[best])


def _unexplained(force: Array, turns: Array, levers: Array) -> float:
    """Share of the squares of the moments that spans of one stiffness each leave."""
    moment = levers[..., 0] * force[:, None, 1] - levers[..., 1] * force[:, None, 0]
    stiffness = np.maximum(np.sum(moment * turns, axis=0) / np.maximum(np.sum(turns**2, axis=0), 1e-12), 0.0)
    return float(np.sum((moment - stiffness * turns) ** 2) / max(float(np.sum(moment**2)), TINY))


def spans(markers: Markers, rest: RestShape, push_s: Array) -> tuple[Array, Array]:
    """(T, k) rad turn since rest, and (T, k, 2) m lever from its middle to the push, of each span between tags."""
    count = len(markers.time)
    s = np.concatenate([[0.0], markers.s])
    order = np.argsort(s, kind="stable")
    xy = np.concatenate([np.zeros((count, 1, 2)), markers.xy], axis=1)[:, order]
    bend = np.concatenate([np.zeros((count, 1)), markers.angle - rest.angle], axis=1)[:, order]
    s = s[order]
    push = np.stack([[np.interp(at, s, row[:, k]) for at, row in zip(push_s, xy, strict=True)] for k in (0, 1)], axis=1)
    before = np.flatnonzero(s[1:] <= np.nanmin(push_s) + 1e-9)
    middle = 0.5 * (xy[:, before] + xy[:, before + 1])
    return bend[:, before + 1] - bend[:, before], push[:, None] - middle
