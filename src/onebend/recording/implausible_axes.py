"""Whether the force can have bent this beam. Flipped signs and swapped axes are the commonest mistakes.

The moment of the force about a place turns the beam there in the sense of the moment, and a larger moment turns it
more. This holds for every clamped passive beam. A log that clearly contradicts it has another sign or other axes than
recording.toml says. Nothing is corrected here: the experimenter must say which it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from onebend.recording.beam_frame import RestShape
from onebend.recording.force.cleaning import to_beam
from onebend.records import Array, BoolArray, Markers

READINGS: dict[str, Array] = {
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
BETTER = 0.1  # of that share: a reading that leaves less is named in the message
DOUBT = 0.015  # unexplained share above which a turn is searched; simulated clean logs leave 0.008
MOST = 95.0  # percentile over the frames that stands for the largest
SHARPER = 0.25  # of that share: a turned log that leaves less is named in the message


@dataclass(frozen=True)
class Reading:
    """How well each reading of the force's axes explains the bending."""

    unexplained: dict[str, float]  # share of the moments' squares, 0 to 1, by name of READINGS
    turn: float = 0.0  # rad, of the log's axes, at which the log explains the bending best
    turned: float = 1.0  # share that is unexplained then

    @property
    def impossible(self) -> bool:
        """The log as it is contradicts the film."""
        return self.unexplained["as it is"] > CERTAIN

    @property
    def inexplicable(self) -> bool:
        """No reading explains the bending."""
        return min(self.unexplained.values()) > CERTAIN

    @property
    def better(self) -> str:
        """The reading that fits far better than the log as it is, or nothing."""
        best = min(self.unexplained, key=lambda name: self.unexplained[name])
        as_written = self.unexplained["as it is"]
        return best if self.unexplained[best] < BETTER * as_written and as_written > 0.2 else ""

    @property
    def rotated(self) -> bool:
        """The log explains the bending far better when its axes are turned by `turn`."""
        as_written = self.unexplained["as it is"]
        return as_written > DOUBT and self.turned < SHARPER * as_written


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
    unexplained = {n: _unexplained(force[good] @ axes.T @ turn.T @ axes, turns, levers) for n, turn in READINGS.items()}
    angles = np.arange(-math.pi, math.pi, math.radians(2.0))
    by_angle = [_unexplained(force[good] @ to_beam(float(a)), turns, levers) for a in angles]
    best = int(np.argmin(by_angle))
    return Reading(unexplained, float(angles[best]), by_angle[best])


def turn_beyond(markers: Markers, rest: RestShape, push_s: Array, loaded: BoolArray) -> tuple[float, float]:
    """rad: the largest turn against each other of two tags that both sit beyond the push, and of any tag, since rest.

    Where nothing else acts the beam beyond a push is as it was at rest. Zeros where no two tags sit there.
    """
    beyond = np.flatnonzero(markers.s >= np.nanmax(push_s, initial=0.0))
    if len(beyond) < 2 or not np.isfinite(push_s[loaded]).any():
        return 0.0, 0.0
    bend = (markers.angle - rest.angle)[loaded]
    first, last = beyond[np.argmin(markers.s[beyond])], beyond[np.argmax(markers.s[beyond])]
    between = np.abs(bend[:, last] - bend[:, first])
    if not np.isfinite(between).any():
        return 0.0, 0.0
    return float(np.nanpercentile(between, MOST)), float(np.nanpercentile(np.nanmax(np.abs(bend), axis=1), MOST))


def _unexplained(force: Array, turns: Array, levers: Array) -> float:
    """Share of the moments' squares that is left when each span has one stiffness."""
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
    push = np.stack(
        [[np.interp(place, s, row[:, k]) for place, row in zip(push_s, xy, strict=True)] for k in (0, 1)], axis=1
    )
    inner = np.flatnonzero(s[1:] <= np.nanmin(push_s) + 1e-9)
    middle = 0.5 * (xy[:, inner] + xy[:, inner + 1])
    return bend[:, inner + 1] - bend[:, inner], push[:, None] - middle
