"""Whether the force log's axes and place are those that recording.toml says, by how the beam bends under it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from onebend.errors import ObservationError
from onebend.recording.beam_frame import RestShape
from onebend.recording.entries import Recording
from onebend.recording.force import to_beam
from onebend.recording.signals import from_clamp
from onebend.records import Array, BoolArray, Markers, Remark, left_of

# Flipped signs and swapped axes are the commonest mistakes. The moment of the force about a place turns a clamped
# passive beam there in the sense of the moment, and a larger moment turns it more. A log that contradicts this has
# another sign or other axes than recording.toml says. Nothing is corrected: the experimenter must say which it is.

_OTHER = "give acts_on the other value, beam or robot"
_EXCHANGE = "exchange the two forces in {key}"
_NEGATE = "give the {axis} force the opposite sign, or exchange both in {{key}} and set rotation_deg to {{fits:.0f}}"
_TURN = "correct rotation_deg (about {fits:.0f} would fit)"
# Each reading's axes, what then has to be added to rotation_deg [rad], and what to do.
_READINGS: dict[str, tuple[list[list[float]], float, str]] = {
    "as it is": ([[1.0, 0.0], [0.0, 1.0]], 0.0, ""),
    "opposite": ([[-1.0, 0.0], [0.0, -1.0]], 0.0, _OTHER),
    "x and y swapped": ([[0.0, 1.0], [1.0, 0.0]], 0.0, _EXCHANGE),
    "x and y swapped and both of opposite sign": ([[0.0, -1.0], [-1.0, 0.0]], 0.0, f"{_EXCHANGE}, and {_OTHER}"),
    "x of opposite sign": ([[-1.0, 0.0], [0.0, 1.0]], math.pi / 2.0, _NEGATE.format(axis="x")),
    "y of opposite sign": ([[1.0, 0.0], [0.0, -1.0]], -math.pi / 2.0, _NEGATE.format(axis="y")),
    "turned by +90 deg": ([[0.0, -1.0], [1.0, 0.0]], math.pi / 2.0, _TURN),
    "turned by -90 deg": ([[0.0, 1.0], [-1.0, 0.0]], -math.pi / 2.0, _TURN),
}
READINGS: dict[str, Array] = {name: np.array(axes) for name, (axes, _, _) in _READINGS.items()}
TINY = 1e-300  # of a force that is zero throughout
CERTAIN = 0.5  # unexplained share of the moments above which the log as it is contradicts the film
CLEARLY = 0.003  # by which it must leave less: a right log whose axes are off by 5 deg leaves 0.0003 more
SHIFTS = np.arange(-10, 11) * 0.05  # s: clocks that were matched by wrong axes are off by a few tenths
MOST = 95.0  # percentile over the frames that stands for the largest
# Unexplained share after the correction. Axes that were merely turned leave less than a tenth of it. An error that
# changes with the load, as of a robot's own estimate of the force, leaves 0.003 and more.
EXACT = 0.002
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
        # Of that share: another reading leaves less only where the log as it is is not the right one.
        clearly = left < min(0.25 * as_written, as_written - CLEARLY)
        # Times what the best turn leaves: up to this a reading of `READINGS` is named, and not the turn.
        return best if clearly and left < max(3.0 * self.turned, CLEARLY) else ""

    @property
    def rotated(self) -> bool:
        """The log explains the bending far better when its axes are turned by `turn`, and no reading does as well."""
        if self.better:
            return False
        as_written = self.unexplained["as it is"]
        # Unexplained share above which a turn is searched; simulated clean logs leave 0.008.
        # Of that share: a turned log that leaves less is named in the message.
        return as_written > 0.015 and self.turned < 0.25 * as_written

    @property
    def exact(self) -> bool:
        """Whether other axes explain the bending as nothing but other axes would."""
        return min(self.turned, min(self.unexplained.values())) < EXACT


def read_force(
    markers: Markers, rest: RestShape, force: Array, push_s: Array, loaded: BoolArray, *, rotation: float = 0.0
) -> Reading | None:
    """Compare the readings over the `loaded` of T frames; None where the film cannot tell.

    The moment of the force about the middle of each span between tags up to the push is explained by the span's turn
    since rest times one stiffness that is not negative. The readings are of the log's own axes, whose x stands at
    `rotation` [rad] in the beam's frame. Each may have the clock that suits it best, as the clocks were matched by the
    log as it is."""
    if not np.isfinite(push_s[loaded]).any():
        return None
    turns, levers = spans(markers, rest, push_s)
    good = loaded & np.isfinite(np.column_stack([turns, levers.reshape(len(turns), -1), force])).all(axis=1)
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
    across = left_of(levers)  # (T, k, 2): moment = across . force
    one = np.einsum("dti,tkj->dktij", force, across).reshape(len(force), turns.shape[1], len(turns), 4)
    squares = np.swapaxes(one, 2, 3) @ one  # (D, k, 4, 4)
    with_turn = np.einsum("dktn,tk->dkn", one, turns)
    a = axes.reshape(-1, 4)
    moments = np.einsum("an,dknm,am->adk", a, squares, a, optimize=True)
    explained = np.maximum(np.einsum("an,dkn->adk", a, with_turn), 0.0) ** 2
    explained /= np.maximum(np.sum(turns**2, axis=0), 1e-12)
    return np.asarray(np.min(1.0 - explained.sum(axis=2) / np.maximum(moments.sum(axis=2), TINY), axis=1))


def axes_words(reading: Reading, rotation: float, *, key: str = "columns") -> str:
    """How the log's axes look, and the line of [force] to correct, of which `key` names its axes; `rotation` [rad]."""
    if reading.better or reading.rotated:
        turn, line = _READINGS[reading.better][1:] if reading.better else (reading.turn, _TURN)
        fits = math.degrees(math.remainder(rotation + turn, 2.0 * math.pi))
        how = reading.better or f"turned by {math.degrees(reading.turn):.0f} deg"
        how = "both axes of opposite sign" if how == "opposite" else how
        how = how if how.startswith("turned") else f"with {how}"
        return f"The force fits the bending far better {how}. In [force], {line.format(key=key, fits=fits)}."
    if reading.inexplicable:
        return "The force does not follow the bending, however its axes are read. Check that the log is of this push."
    return f"The force contradicts the bending. In [force], check {key}, rotation_deg and acts_on."


def spans(markers: Markers, rest: RestShape, push_s: Array) -> tuple[Array, Array]:
    """(T, k) rad turn since rest, and (T, k, 2) m lever from its middle to the push, of each span between tags."""
    s, xy, bend = from_clamp(markers.s, markers.xy, markers.angle - rest.angle)
    push = np.stack(
        [[np.interp(place, s, row[:, k]) for place, row in zip(push_s, xy, strict=True)] for k in (0, 1)], axis=1
    )
    inner = np.flatnonzero(s[1:] <= np.nanmin(push_s) + 1e-9)
    middle = 0.5 * (xy[:, inner] + xy[:, inner + 1])
    return bend[:, inner + 1] - bend[:, inner], push[:, None] - middle


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
    shown = bend[np.isfinite(bend).any(axis=1)]
    return float(np.nanpercentile(between, MOST)), float(np.percentile(np.nanmax(np.abs(shown), axis=1), MOST))


def check_direction(
    rec: Recording, markers: Markers, rest: RestShape, force: Array, push_s: Array, loaded: BoolArray, *, refuse: bool
) -> tuple[Remark, ...]:
    """A remark where another reading of the force's axes explains the bending far better, with doubt where it does so
    exactly; `ObservationError` where `refuse` and the force contradicts the bending."""
    rotation = rec.force.rotation if rec.force else 0.0
    reading = read_force(markers, rest, force, push_s, loaded, rotation=rotation)
    if reading is None or not (reading.impossible or reading.better or reading.rotated):
        return ()
    text = axes_words(reading, rotation, key="axes" if rec.force and rec.force.topic else "columns")
    if not reading.exact and not reading.inexplicable:
        text += f" {LOADED}"
    if rec.markers is not None:
        text += f" Or the axes of {rec.markers.file.name} are not those of the log: x_m, y_m and angle_rad."
    if rec.video is not None:
        seconds = float(markers.time[-1] - markers.time[0])
        text += f" Or the film's frame rate is wrong (by it the film lasts {seconds:.3g} s), or frames are missing."
    if refuse and reading.impossible:
        raise ObservationError(f"{rec.name}: {text}", about="axes")
    share = math.sqrt(reading.unexplained["as it is"])
    return (Remark("warning", text, doubt=reading.impossible or reading.exact, about="axes", share=share),)


def check_place(
    rec: Recording, markers: Markers, rest: RestShape, push_s: Array, loaded: BoolArray
) -> tuple[Remark, ...]:
    """A warning where the beam bends between tags (with angles of their own) that both sit beyond the push."""
    if rec.gravity is not None or rec.push is None or not loaded.any():
        return ()
    beyond, largest = turn_beyond(markers, rest, push_s, loaded)
    # Of the largest turn of a tag: a heavy or a fast beam bends less than that beyond the push.
    if beyond < max(0.05 * largest, math.radians(3.0)):
        return ()
    text = (
        f"The beam bends by {math.degrees(beyond):.2g} deg between tags beyond the push, where nothing acts on it. "
        "Check at_s in [push] (a share of the length, 1 at the tip), and the tags' s."
    )
    return (Remark("warning", text, doubt=True, about="push place"),)
