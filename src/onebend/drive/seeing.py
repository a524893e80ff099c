"""From pictures to the beam's point, and from its motion to the loop's delay.

At rest the tags are seen where the model has the unloaded beam; what they are off there is how they sit on it, and is
taken off from then on. Between tags the point is where the model has it, plus what the tags are off, by a cubic with
their angles: a point that has no tag is seen by those beside it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from onebend.beam.model import Beam
from onebend.beam.problem import Resolution
from onebend.control.loaded_beam import prepared, trace
from onebend.control.reach_set import stability_margin
from onebend.errors import ObservationError
from onebend.live.history import FrameReader
from onebend.recording import beam_frame, camera, entries
from onebend.records import Array, Detections, rotated, unit


class BentModel:
    """A beam under a force at one place: shape follows shape, and each is stable. Not for two threads at once."""

    def __init__(self, beam: Beam, push_s: float, s: Array, gravity: tuple[float, float] = (0.0, 0.0)) -> None:
        """`s` (S,): places that are asked for."""
        self.pushed = prepared(beam, push_s, push_s, gravity, Resolution())
        self._integral = self.pushed.problem.grid.integral_to(s)
        self._length, self.state = float(self.pushed.problem.length), self.pushed.start

    def bend(self, force: Array) -> bool:
        """Go to the shape under `force` (2,) N; False, and nothing changes, where no stable shapes lead there."""
        way = trace(self.pushed, np.append(force, 0.0), start=self.state)
        if way.arrived:
            self.state = way.states[-1]
        return way.arrived

    def poses(self) -> Array:
        """(S, 3) m, m, rad: the beam at `s`."""
        q, alpha = self.pushed.whole(self.state.q), self.pushed.angles(self.state.q)
        xy = self._length * self._integral @ unit(alpha)
        turn = float(np.ravel(self.pushed.problem.alpha0)[0]) + self._integral @ q
        return np.column_stack([xy, turn])

    @property
    def margin(self) -> float:
        """The smallest eigenvalue of the scaled tangent: 1 without a force, 0 where the beam buckles."""
        return stability_margin(self.pushed, self.state)

    @property
    def curvature(self) -> float:
        """1/m, the largest beyond that at rest."""
        return self.pushed.bend(self.state.q)


@dataclass(frozen=True)
class SeenBeam:
    """The beam at its tags, as one picture shows it."""

    arrival: float  # s, this machine's clock
    xy: Array  # (m, 2) m, beam's frame; NaN where a tag is hidden
    angle: Array  # (m,) rad
    covariance: Array  # (m, 3, 3)

    @property
    def shown(self) -> Array:
        """(m,) whether each tag is seen."""
        return np.asarray(np.isfinite(self.xy).all(axis=1) & np.isfinite(self.angle))


class Eye:
    """Reads pictures' corners: first those of the rest, then the beam."""

    def __init__(self, rec: entries.Recording, model_rest: Array) -> None:
        """`model_rest` (m, 3) m, m, rad: the tags' places on the unloaded beam, by the model."""
        self.reader: FrameReader | None = None
        self.rest_noise = self.camera_sd = math.nan  # m: of a tag in one picture; what the camera adds to all
        self._rec, self._model = rec, model_rest
        self._rest: list[tuple[float, Array]] = []
        self._offset, self._turn = np.zeros((len(model_rest), 2)), np.zeros(len(model_rest))

    @property
    def rested(self) -> int:
        """Pictures of the rest with all of the base and a tag of the beam."""
        return len(self._rest)

    def add_rest(self, time: float, corners: Array) -> None:
        """One more picture of the rest, corners (b + m, 4, 2) px."""
        if np.isfinite(corners).all():
            self._rest.append((time, corners))

    def settle(self, shape: tuple[int, int], gravity: tuple[float, float]) -> None:
        """Where the beam's frame is, from the pictures of the rest, of (height, width) px.

        Raises:
            ObservationError: as `measure_markers`; the tags are not where the beam is at rest.
        """
        rec = self._rec
        time, corners = np.array([one for one, _ in self._rest]), np.stack([one for _, one in self._rest])
        tags = np.array([tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)], dtype=np.int64)
        found = camera.measure_markers(Detections(time, tags, corners, shape[1], shape[0]), rec)
        pull = np.broadcast_to(np.asarray(gravity), (len(time), 2))
        markers, _, _ = beam_frame.to_beam_frame(found, np.ones(len(time), dtype=bool), rec.tags.placement_sd, pull)
        assert markers.view is not None
        by_camera = np.zeros((1, len(self._model), 3, 1)) if markers.by_camera is None else markers.by_camera
        shared = by_camera[:1] @ np.swapaxes(by_camera[:1], -1, -2)
        self.rest_noise = float(np.sqrt(np.mean(np.var(markers.xy, axis=0))))
        self.camera_sd = float(np.sqrt(np.max(np.trace(shared[0, :, :2, :2], axis1=1, axis2=2))))
        xy, angle = markers.xy.mean(axis=0), markers.angle.mean(axis=0)
        self._turn = angle - self._model[:, 2]
        self._offset = rotated(xy - self._model[:, :2], -self._model[:, 2])
        most = 5.0 * rec.tags.placement_sd + 0.01 * rec.beam.length
        if float(np.abs(self._offset).max()) > most:
            worst = int(np.argmax(np.abs(self._offset).max(axis=1)))
            away = 1e3 * float(np.linalg.norm(self._offset[worst]))
            raise ObservationError(
                f"at rest tag {rec.tags.on_beam[worst].id} is {away:.3g} mm from where the unloaded beam has it. "
                "Take the force off the beam, and check the tags' s and length_m."
            )
        self.reader = FrameReader(
            rec, offset=0.0, offset_sd=0.0, view=markers.view, follows_base=False, known_xy=markers.xy[:1],
            camera_part=np.asarray(shared), rest_xy=xy, rest_sd=self.rest_noise, tare=np.zeros(2),
            gravity=np.asarray(gravity), largest=0.0, traced=np.zeros(len(xy), dtype=bool),
        )  # fmt: skip

    def beam(self, arrival: float, corners: Array) -> SeenBeam:
        """The beam in a picture after the rest."""
        assert self.reader is not None
        xy, angle, covariance = self.reader.poses(corners)
        angle = angle - self._turn
        return SeenBeam(arrival, xy - rotated(self._offset, angle), angle, covariance)


def point_between(seen: SeenBeam, s: Array, modelled: Array, length: float) -> tuple[Array, float]:
    """(2,) m of a point and its sd [m], NaN where nothing near it is seen.

    `s` (m + 1,): the tags' places, then the point's; `modelled` (m + 1, 3): the beam there, by the model.
    """
    shown, at = seen.shown, float(s[-1])
    if not shown.any() or float(np.max(s[:-1][shown])) < at - _BEYOND:
        return np.full(2, np.nan), math.nan
    places, order = np.append(0.0, s[:-1][shown]), np.argsort(np.append(0.0, s[:-1][shown]), kind="stable")
    off = np.vstack([np.zeros(2), seen.xy[shown] - modelled[:-1][shown, :2]])
    slope = unit(seen.angle[shown]) - unit(modelled[:-1][shown, 2])
    slopes = length * np.vstack([np.zeros(2), slope])
    between = CubicHermiteSpline(places[order], off[order], slopes[order])
    inside = min(at, float(places.max()))
    value = between(inside) + (at - inside) * slopes[order][-1]
    nearest = int(np.flatnonzero(shown)[np.argmin(np.abs(s[:-1][shown] - at))])
    return modelled[-1, :2] + value, math.sqrt(0.5 * float(np.trace(seen.covariance[nearest, :2, :2])))


_BEYOND = 0.1  # of the length, by which the point may be beyond the last tag that is seen


class DelayMeter:
    """The time from a command to the picture that shows it, measured while the beam moves.

    The point is seen at `o + g c(t - d)`, c the tool's commanded place, both along the direction in which they go most:
    for each delay d the offset o and the gain g are fitted (a wrong k changes g, not d), and the best d is that with
    the least rest.
    """

    def __init__(self, first: float) -> None:
        """`first` [s]: what is taken until it is known."""
        self.delay, self.sd = first, math.inf
        self._told: deque[tuple[float, float, float]] = deque()
        self._shown: deque[tuple[float, float, float]] = deque()

    def told(self, now: float, place: Array) -> None:
        """The commanded place (2,) m of the tool, from `now` on."""
        self._told.append((now, float(place[0]), float(place[1])))
        while self._told[0][0] < now - _SPAN - _LONGEST:
            self._told.popleft()

    def shown(self, now: float, place: Array, noise: float) -> None:
        """The point's place (2,) m in a picture that is used now; measures anew where there was motion enough."""
        self._shown.append((now, float(place[0]), float(place[1])))
        while self._shown[0][0] < now - _SPAN:
            self._shown.popleft()
        if len(self._shown) >= _FEWEST and len(self._shown) % _EVERY == 0:
            self._measure(noise)

    def newest(self, span: float, since: float) -> tuple[Array, Array]:
        """(n,) s and (n, 2) m: where the point was seen in the last `span` [s], later than `since`."""
        shown = np.array(self._shown).reshape(-1, 3)
        shown = shown[(shown[:, 0] >= shown[-1:, 0] - span) & (shown[:, 0] > since)]
        return shown[:, 0], shown[:, 1:]

    def _measure(self, noise: float) -> None:
        told, shown = np.array(self._told), np.array(self._shown)
        shown = shown[shown[:, 0] > told[0, 0] + _LONGEST]
        if len(shown) < _FEWEST:
            return
        along, y = _main_way(told[:, 1:]), _main_way(shown[:, 1:])
        if min(np.ptp(along), np.ptp(y)) < _LEAST_WAY:
            return
        tries = np.arange(0.0, _LONGEST, _STEP)
        rest = np.array([_rest_of(y, np.interp(shown[:, 0] - delay, told[:, 0], along)) for delay in tries])
        best = int(np.argmin(rest))
        if not 0 < best < len(tries) - 1:
            return
        curve = (rest[best - 1] - 2.0 * rest[best] + rest[best + 1]) / _STEP**2
        if not curve > 0.0:
            return
        variance = max(noise**2, float(rest[best]) / max(len(y) - 3, 1))
        sd = math.sqrt(2.0 * variance / curve)
        if sd < 2.0 * self.sd:  # the newest counts, unless it is much vaguer
            slope = (rest[best + 1] - rest[best - 1]) / (2.0 * _STEP)
            self.delay, self.sd = float(tries[best] - slope / curve), max(sd, _LEAST_SD)


_LONGEST, _SPAN = 0.4, 2.5  # s: nothing beyond is looked for; of the motion that tells
_FEWEST, _EVERY = 15, 3  # pictures; how often it is measured
_LEAST_WAY = 0.004  # m
_STEP, _LEAST_SD = 0.004, 5e-4  # s


def _main_way(places: Array) -> Array:
    """(n,) m, places (n, 2) along the direction in which they go most."""
    spread = places - places.mean(axis=0)
    return np.asarray(spread @ np.linalg.svd(spread, full_matrices=False)[2][0])


def _rest_of(y: Array, x: Array) -> float:
    """Sum of squares that a line leaves of y (n,) over x (n,)."""
    x, y = x - x.mean(), y - y.mean()
    square = float(x @ x)
    gain = float(x @ y) / square if square > 0.0 else 0.0
    return float(np.sum((y - gain * x) ** 2))
