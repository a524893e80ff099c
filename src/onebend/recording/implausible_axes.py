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
_OTHER = "give acts_on the other value, beam or robot"
_EXCHANGE = "exchange the two forces in {key}"
_NEGATE = "give the {axis} force the opposite sign, or exchange both in {{key}} and set rotation_deg to {{fits:.0f}}"
_TURN = "correct rotation_deg (about {fits:.0f} would fit)"
_MENDED: dict[str, tuple[float, str]] = {  # what then has to be added to rotation_deg, in rad, and what to do
    "opposite": (0.0, _OTHER),
    "x and y swapped": (0.0, _EXCHANGE),
    "x and y swapped and both of opposite sign": (0.0, f"{_EXCHANGE}, and {_OTHER}"),
    "x of opposite sign": (math.pi / 2.0, _NEGATE.format(axis="x")),
    "y of opposite sign": (-math.pi / 2.0, _NEGATE.format(axis="y")),
    "turned by +90 deg": (math.pi / 2.0, _TURN),
    "turned by -90 deg": (-math.pi / 2.0, _TURN),
}
TINY = 1e-300  # of a force that is zero throughout
CERTAIN = 0.5  # unexplained share of the moments above which the log as it is contradicts the film
BETTER = 0.25  # of that share: another reading leaves less only where the log as it is is not the right one
CLEARLY = 0.003  # by which it must leave less: a right log whose axes are off by 5 deg leaves 0.0003 more
AS_SIMPLE = 3.0  # times what the best turn leaves: up to this a reading of `READINGS` is named, and not the turn
DOUBT = 0.015  # unexplained share above which a turn is searched; simulated clean logs leave 0.008
SHIFTS = np.arange(-10, 11) * 0.05  # s: clocks that were matched by wrong axes are off by a few tenths
MOST = 95.0  # percentile over the frames that stands for the largest
SHARPER = 0.25  # of that share: a turned log that leaves less is named in the message
EXACT = (
    0.002  # unexplained share after the mending: axes that were merely turned leave less than a tenth of it. What is
)
# left by an error that changes with the load, as of a robot's own estimate of the force, is 0.003 and more
LOADED = (
    "Or it is the sensor's own error, which changes with the load as that of a robot's estimate of the force does: "
    "push harder, or take a force sensor."
)


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
        """The reading that fits better than the log as it is by more than errors of a log can do, or nothing."""
        best = min(self.unexplained, key=lambda name: self.unexplained[name])
        as_written, left = self.unexplained["as it is"], self.unexplained[best]
        clearly = left < min(BETTER * as_written, as_written - CLEARLY)
        return best if clearly and left < max(AS_SIMPLE * self.turned, CLEARLY) else ""

    @property
    def rotated(self) -> bool:
        """The log explains the bending far better when its axes are turned by `turn`, and no reading does as well."""
        if self.better:
            return False
        as_written = self.unexplained["as it is"]
        return as_written > DOUBT and self.turned < SHARPER * as_written

    @property
    def exact(self) -> bool:
        """Whether other axes explain the bending as nothing but other axes would."""
        return min(self.turned, min(self.unexplained.values())) < EXACT


def read_force(
    markers: Markers, rest: RestShape, force: Array, push_s: Array, loaded: BoolArray, *, rotation: float = 0.0
) -> Reading | None:
    """Compare the readings over the `loaded` of T frames; None where the film cannot tell.

    For each span between neighbouring tags up to the push, the moment of the force about the span's middle is
    explained by the span's turn since rest times one stiffness that is not negative. The readings are of the log's own
    axes, whose x stands at `rotation` [rad] in the beam's frame. Where the log as it is leaves something, each reading
    may have the clock that suits it best: the clocks were matched by the log as it is.
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
    now = _unexplained(np.eye(2)[None], force[None, good], turns, levers)
    shifts = SHIFTS if float(now[0]) > CLEARLY else np.zeros(1)
    moved = np.stack([_later(force, markers.time, float(shift))[good] for shift in shifts])
    axes = to_beam(rotation)
    readings = np.stack([axes.T @ turn.T @ axes for turn in READINGS.values()])
    angles = np.arange(-math.pi, math.pi, math.radians(2.0))
    by_angle = _unexplained(np.stack([to_beam(float(a)) for a in angles]), moved, turns, levers)
    best = int(np.argmin(by_angle))
    left = _unexplained(readings, moved, turns, levers)
    return Reading(dict(zip(READINGS, left.tolist(), strict=True)), float(angles[best]), float(by_angle[best]))


def _later(force: Array, time: Array, shift: float) -> Array:
    """(T, 2) N of the log `shift` [s] later; frames without a force are stepped over."""
    if shift == 0.0:
        return force
    known = np.isfinite(force).all(axis=1)
    return np.stack([np.interp(time + shift, time[known], column[known]) for column in force.T], axis=1)


def _unexplained(axes: Array, force: Array, turns: Array, levers: Array) -> Array:
    """(A,) share of the moments' squares that is left when each span has one stiffness, the force being F @ axes
    (A, 2, 2): the least of those of the forces F (D, T, 2)."""
    across = np.stack([-levers[..., 1], levers[..., 0]], axis=-1)  # (T, k, 2): moment = across . force
    one = np.einsum("dti,tkj->dktij", force, across).reshape(len(force), turns.shape[1], len(turns), 4)
    squares = np.swapaxes(one, 2, 3) @ one  # (D, k, 4, 4)
    with_turn = np.einsum("dktn,tk->dkn", one, turns)
    a = axes.reshape(-1, 4)
    moments = np.einsum("an,dknm,am->adk", a, squares, a, optimize=True)
    explained = np.maximum(np.einsum("an,dkn->adk", a, with_turn), 0.0) ** 2
    explained /= np.maximum(np.sum(turns**2, axis=0), 1e-12)
    return np.asarray(np.min(1.0 - explained.sum(axis=2) / np.maximum(moments.sum(axis=2), TINY), axis=1))


def axes_words(reading: Reading, rotation: float, *, key: str = "columns") -> str:
    """What the log's axes look like, and the line of [force] to mend; `rotation` [rad] is what is written there, `key`
    the line that names its two axes."""
    if reading.better:
        turn, line = _MENDED[reading.better]
        fits = math.degrees(math.remainder(rotation + turn, 2.0 * math.pi))
        how = reading.better if reading.better.startswith("turned") else f"with {reading.better}"
        how = "with both axes of opposite sign" if reading.better == "opposite" else how
        return f"The force fits the bending far better {how}. In [force], {line.format(key=key, fits=fits)}."
    if reading.rotated:
        fits = math.degrees(math.remainder(rotation + reading.turn, 2.0 * math.pi))
        return (
            f"The force fits the bending far better turned by {math.degrees(reading.turn):.0f} deg. In [force], "
            f"{_TURN.format(fits=fits)}."
        )
    if reading.inexplicable:
        return "The force does not follow the bending, however its axes are read. Check that the log is of this push."
    return f"The force contradicts the bending. In [force], check {key}, rotation_deg and acts_on."


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
