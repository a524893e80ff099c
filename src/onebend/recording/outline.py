"""The outline of the body in a film: both flanks of its top face, to parts of a pixel, as points of its centreline.

The body begins at the clamp, whose place and direction the base tag says. In the first picture it is followed from
there to its tip; each later picture is searched near where the ones before predict it. Along normals of the predicted
curve, the flanks are the places where the body's own colour ends. Its width is the same in all pictures, so what
contradicts it (a tool, a shadow, a thing of the same colour, a wall of the body) is left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from onebend.errors import ObservationError
from onebend.progress import Progress, Silent, track
from onebend.recording.camera import measure_markers, project
from onebend.recording.entries import Recording
from onebend.recording.signals import MAD_TO_SD, correlation_time
from onebend.recording.video import picture_in, timed, upright
from onebend.records import Array, BoolArray, Detections, IntArray, Markers, OutlineTrack, Remark, View


@dataclass(frozen=True)
class Planes:
    """One picture as its encoder keeps it: brightness of every pixel, colour of every or every second one."""

    luma: NDArray[np.uint8]  # (H, W)
    chroma: NDArray[np.uint8]  # (2, h, w)
    left: bool = True  # where chroma has half the columns: its samples stand on the left of two pixels, not between

    def at(self, px: Array) -> NDArray[np.float32]:
        """(..., 3) luma and both chromas at pixels (..., 2), in proportion between neighbours; NaN outside."""
        height, width = self.luma.shape
        x, y = px[..., 0], px[..., 1]
        inside = (x >= 0.0) & (y >= 0.0) & (x <= width - 1.0) & (y <= height - 1.0)
        x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
        across, down = width // self.chroma.shape[2], height // self.chroma.shape[1]
        shift = 0.0 if self.left else 0.5 * (across - 1)
        out: NDArray[np.float32] = np.empty((*x.shape, 3), dtype=np.float32)
        out[..., :1] = _between(self.luma[None], x, y)
        out[..., 1:] = _between(self.chroma, (x - shift) / across, (y - 0.5 * (down - 1)) / down)
        out[~inside] = np.nan
        return out


def _between(planes: NDArray[np.uint8], x: Array, y: Array) -> NDArray[np.float32]:
    """(..., n) linear interpolation in planes (n, h, w); beyond their edge as on it."""
    n, h, w = planes.shape
    x, y = np.clip(x, 0.0, w - 1.001), np.clip(y, 0.0, h - 1.001)
    i, j = y.astype(np.int64), x.astype(np.int64)
    fy, fx = (y - i).astype(np.float32), (x - j).astype(np.float32)
    at = i * w + j
    out: NDArray[np.float32] = np.empty((*x.shape, n), dtype=np.float32)
    for k in range(n):
        flat = planes[k].reshape(-1)
        top, low = flat[at].astype(np.float32), flat[at + w].astype(np.float32)
        top += fx * (flat[at + 1] - top)
        low += fx * (flat[at + w + 1] - low)
        out[..., k] = top + fy * (low - top)
    return out


def planes_of(rec: Recording, index: int, raw: Any) -> Planes:
    """The planes of what `video.timed` gives."""
    assert rec.video is not None
    if rec.video.topic:
        red, green, blue = np.moveaxis(picture_in(rec.video, index, raw, colour=True).astype(np.float32), 2, 0)
        luma = 0.299 * red + 0.587 * green + 0.114 * blue
        chroma = np.stack([128.0 + 0.564 * (blue - luma), 128.0 + 0.713 * (red - luma)])
        return Planes(np.rint(luma).astype(np.uint8), np.rint(np.clip(chroma, 0.0, 255.0)).astype(np.uint8))
    known = raw.format.name in ("yuv420p", "yuvj420p", "yuv422p", "yuv444p")
    frame = raw if known and raw.width % 2 == 0 and raw.height % 2 == 0 else raw.reformat(format="yuv444p")
    luma, blue, red = (_plane(one, raw.rotation) for one in frame.planes)
    turned = raw.rotation % 360 != 0  # then chroma's samples stand on another side: between is nearest to all
    return Planes(luma, np.stack([blue, red]), left=not turned and not raw.format.name.startswith("yuvj"))


def _plane(plane: Any, rotation: int) -> NDArray[np.uint8]:
    rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)[: plane.height, : plane.width]
    return np.ascontiguousarray(upright(rows, rotation))


STATES = 12  # Legendre polynomials of the curve's angle
CLAMP_OFF = 2e-3  # m: one sd of the curve's begin across the clamp's direction


@dataclass(frozen=True)
class Curve:
    """A curve through M stations."""

    xy: Array  # (M, 2) m
    angle: Array  # (M,) rad

    @cached_property
    def normal(self) -> Array:
        """(M, 2) to its left."""
        return np.stack([-np.sin(self.angle), np.cos(self.angle)], axis=1)


@dataclass(frozen=True)
class Stations:
    """Places along the body at which its flanks are looked for, and the curves through them."""

    length: float  # m
    count: int

    @cached_property
    def s(self) -> Array:
        """(M,) from 0 to 1."""
        return np.linspace(0.0, 1.0, self.count)

    @cached_property
    def functions(self) -> Array:
        """(M, K) Legendre polynomials."""
        return np.asarray(np.polynomial.legendre.legvander(2.0 * self.s - 1.0, STATES - 1))

    @cached_property
    def prior(self) -> Array:
        """(1 + K,) one sd of a curve's numbers: where it begins [m], and its angle's coefficients [rad]."""
        return np.append(CLAMP_OFF, 3.0 / (1.0 + np.arange(STATES)) ** 2.0)

    def along(self, values: Array) -> Array:
        """(M, ...) integrals of values (M, ...) over the length so far [m]."""
        step = 0.5 * (values[1:] + values[:-1]) * (self.length / (self.count - 1))
        return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(step, axis=0)])

    def curve(self, state: Array) -> Curve:
        """The curve with these numbers (1 + K,)."""
        angle = self.functions @ state[1:]
        tangent = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return Curve(self.along(tangent) + np.array([0.0, state[0]]), angle)

    def across(self, curve: Curve) -> Array:
        """(M, 1 + K) m per unit of the curve's numbers: how far each station moves along its normal."""
        n = curve.normal
        turned = self.along(n[:, :, None] * self.functions[:, None, :])  # (M, 2, K)
        return np.column_stack([n[:, 1], np.einsum("mc,mck->mk", n, turned)])

    def fitted(self, state: Array, away: Array, sd: float, stiffness: float = 1.0) -> Array:
        """(1 + K,) numbers of the curve that runs `away` (..., M) m, NaN where unknown, from that of `state`: robust
        least squares (Tukey) with one `sd` [m] each. A `stiffness` above one keeps the curve straight where nothing is
        seen."""
        known = np.isfinite(away)
        if not known.any():
            return state
        rows = np.broadcast_to(self.across(self.curve(state)), (*away.shape, len(state)))[known]
        right = away[known]
        prior = self.prior / np.append(1.0, stiffness * np.sqrt(1.0 + np.arange(STATES)) ** (stiffness > 1.0))
        weight, step = np.ones(len(right)), np.zeros(len(state))
        for _ in range(5):
            root = np.sqrt(weight) / sd
            whole = np.concatenate([rows * root[:, None], np.diag(1.0 / prior)])
            step = np.linalg.lstsq(whole, np.concatenate([right * root, -state / prior]), rcond=None)[0]
            left = np.abs(right - rows @ step)
            spread = max(MAD_TO_SD * float(np.median(left)), sd)
            weight = np.maximum(1.0 - (left / (5.0 * spread)) ** 2, 0.0) ** 2 + 1e-9
        return np.asarray(state + step)


# Flanks. A step of colour counts as the body's own end where the means over `SIDE` inside it are like the body, and
# those outside are not; more than `MOST` sds of a difference count as so many, so that the first clear step is taken
# and not the strongest, which may be the far edge of a wall or of a shadow.

STEP = 0.5  # px: of the samples along a normal
SIDE = 3.0  # px: means over so much to either side of an edge tell how large its step is
REACH = 6.0  # px: an edge is looked for so far from where it is expected
MOST = 8.0  # sds of the body's colour
LEAST = 4.0  # of them: a smaller step is no edge
SIDES: Array = np.array([1.0, -1.0])  # left and right of the body's direction
_OUT = np.arange(-REACH - 2.0 * SIDE, REACH + 2.0 * SIDE + 0.5 * STEP, STEP)  # (J,) px outward from an expected flank
_SIDE = round(SIDE / STEP)
_MIDDLE = np.flatnonzero(np.abs(_OUT) <= REACH + 0.5 * STEP)  # where an edge may be
_INNER = np.array([0.35, 0.5, 0.65])  # of the half width: the colour there is the body's
_LEVEL = (round(1.5 / STEP), round(3.5 / STEP))  # samples from an edge between which its two levels are taken
_HALF = round(2.5 / STEP)  # samples to either side over which it is integrated


@dataclass(frozen=True)
class Look:
    """How much the body's colour varies within itself."""

    sd: Array  # (3,) of the mean over `SIDE`
    pixel_sd: Array  # (3,) of one sample


@dataclass(frozen=True)
class Sight:
    """How one picture shows the plane: pixels of points (..., 2) [m]."""

    planes: Planes
    view: View
    shift: Array  # (2,) px, of this picture against that of the view

    def pixels(self, xy: Array) -> Array:
        """(..., 2) px."""
        return project(self.view, xy) + self.shift

    def outward(self, curve: Curve) -> tuple[Array, Array]:
        """(M, 2) unit normals of a curve in the picture, and pixels per metre (M,) along them."""
        small = 1e-4  # m
        ends = self.pixels(np.stack([curve.xy - small * curve.normal, curve.xy + small * curve.normal]))
        along = (ends[1] - ends[0]) / (2.0 * small)
        scale = np.linalg.norm(along, axis=1)
        return along / scale[:, None], scale


def find_flanks(sight: Sight, curve: Curve, half: Array, look: Look) -> Array:
    """(2, M) m from the curve to its left, of the left and the right flank near the expected ones, `half` (M,) m from
    the curve; NaN where the body's colour does not clearly end."""
    normal, scale = sight.outward(curve)
    away = SIDES[:, None] * half  # (2, M)
    expected = sight.pixels(curve.xy + away[..., None] * curve.normal)
    outward = SIDES[:, None, None] * normal  # (2, M, 2)
    inner = -(1.0 - _INNER) * (half * scale)[:, None]  # (M, 3) px
    places = np.concatenate([np.broadcast_to(_OUT, (len(half), len(_OUT))), inner], axis=1)
    seen = sight.planes.at(expected[:, :, None] + places[..., None] * outward[:, :, None])
    colour, body = seen[:, :, : len(_OUT)], running_mean(np.median(seen[:, :, len(_OUT) :], axis=2), 5)
    inside, outside = sides_of(colour)
    step = unlike(outside, body, look) - unlike(inside, body, look)
    likely = step * np.exp(-0.5 * (2.0 * _OUT[_MIDDLE] / REACH) ** 2)
    best = np.argmax(np.nan_to_num(likely, nan=-np.inf), axis=2)
    size = np.take_along_axis(step, best[..., None], axis=2)[..., 0]
    place = edge_place(colour, _MIDDLE[best], look.pixel_sd)
    clear = (size >= LEAST) & (np.abs(place) < REACH)
    return np.asarray(np.where(clear, away + SIDES[:, None] * place / scale, np.nan))


def sides_of(colour: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean colours inside and outside each place in the middle of profiles (2, M, J, 3) about `_OUT`."""
    total = np.cumsum(np.concatenate([np.zeros_like(colour[:, :, :1]), colour], axis=2), axis=2)
    inside = (total[:, :, _MIDDLE] - total[:, :, _MIDDLE - _SIDE]) / _SIDE
    return inside, (total[:, :, _MIDDLE + 1 + _SIDE] - total[:, :, _MIDDLE + 1]) / _SIDE


def unlike(colour: NDArray[np.float32], body: Array, look: Look) -> Array:
    """(2, M, J) sds, up to `MOST`, between colours (2, M, J, 3) and the body's (2, M, 3)."""
    squares = np.sum(((colour - body[:, :, None]) / look.sd) ** 2, axis=-1)
    return np.asarray(np.minimum(np.sqrt(squares), MOST))


def edge_place(colour: NDArray[np.float32], first: IntArray, pixel_sd: Array) -> Array:
    """(2, M) px outward from the expected flanks: where a sharp step between the two levels about sample `first` (2, M)
    of the profiles (2, M, J, 3) would have the same integral."""
    centre, off = first, np.zeros(first.shape)
    for _ in range(2):  # the first sample stands where the colour begins to change, not in the middle of the step
        centre = np.clip(centre + np.rint(off / STEP).astype(np.int64), _LEVEL[1], len(_OUT) - 1 - _LEVEL[1])
        off = np.nan_to_num(_fraction(colour, centre, pixel_sd))
    return np.asarray(_OUT[centre] + _fraction(colour, centre, pixel_sd))


def _fraction(colour: NDArray[np.float32], centre: IntArray, pixel_sd: Array) -> Array:
    """(2, M) px from sample `centre` (2, M) outward to the edge."""
    window = np.arange(-_LEVEL[1], _LEVEL[1] + 1)
    near = np.take_along_axis(colour, (centre[..., None] + window)[..., None], axis=2)  # (2, M, W, 3)
    inside = near[:, :, window <= -_LEVEL[0]].mean(axis=2)
    difference = near[:, :, window >= _LEVEL[0]].mean(axis=2) - inside
    weight = difference / pixel_sd**2
    size = np.maximum(np.sum(weight * difference, axis=-1), 1e-9)
    middle = near[:, :, np.abs(window) <= _HALF] - inside[:, :, None]
    share = np.clip(np.einsum("smwc,smc->smw", middle, weight) / size[..., None], -0.25, 1.25)
    trapezoid = np.ones(2 * _HALF + 1)
    trapezoid[[0, -1]] = 0.5
    return np.asarray(STEP * ((1.0 - share) @ trapezoid - _HALF))


def running_mean(values: Array, count: int) -> Array:
    """Means over `count` neighbours along the second axis of values (2, M, n); the ends repeat."""
    padded = np.pad(values, ((0, 0), (count // 2, count // 2), (0, 0)), mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, count, axis=1).mean(axis=-1))


def running_median(values: Array, count: int) -> Array:
    """Median over `count` neighbours of values (M,), NaN left out; NaN where there are none."""
    padded = np.pad(values, count // 2, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, count)
    return nan_median(windows, axis=1)


def nan_median(values: Array, axis: int = 0) -> Array:
    """Median of what is there; NaN where nothing is."""
    known = np.isfinite(values).any(axis=axis)
    return np.where(known, np.nanmedian(np.where(np.expand_dims(known, axis), values, 0.0), axis=axis), np.nan)


def nan_mean(values: Array) -> Array:
    """Mean over the first axis of what is there; NaN where nothing is."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.asarray(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))


# The first picture: the body is followed from the clamp to its tip.

GROWS = 0.04  # of the length: how far ahead in one go
FIRST = 0.10  # of the length: there the body's colour and width are taken
WIDEST = 0.15  # of the length: half of the widest body
PAPER = 0.75  # of a tag's side: from its middle to where its paper ends, along the beam
STEP_SHARE = 1.0 / 16.0  # of the step at the flanks: sd of the body's colour, at least
_BESIDE = 4.0  # px to either side of a flank, where its step is measured
MEASURED = 0.1  # px: sd of a flank's place, for the curve that carries the search
STIFF = 10.0  # times stiffer than a bent beam: the curve whose far end nothing holds yet


@dataclass(frozen=True)
class OutlinedBody:
    """The body in one picture."""

    state: Array  # (1 + K,) of its curve
    half: Array  # (M,) m, half its width
    look: Look


def first_width(sight: Sight, curve: Curve, part: BoolArray, length: float) -> Array:
    """(2,) m from the axis to the left and to the right flank along `part` (M,) of the curve: the innermost clear steps
    of the mean colour; NaN where there is none."""
    normal, scale = (one[part] for one in sight.outward(curve))
    out = np.arange(0.0, WIDEST * length * float(np.median(scale)), STEP)
    middle = sight.pixels(curve.xy[part])
    colour = sight.planes.at(middle[:, None] + SIDES[:, None, None, None] * out[:, None] * normal[:, None])
    out = out[: int(np.sum(np.isfinite(colour).all(axis=(0, 1, 3))))]
    colour = colour[:, :, : len(out)]  # (2, m, J, 3)
    if len(out) <= 4 * _SIDE:
        return np.full(2, np.nan)
    noise = MAD_TO_SD / math.sqrt(2.0) * np.median(np.abs(np.diff(colour[:, :, : 2 * _SIDE], axis=1)), axis=(0, 1, 2))
    mean = colour.mean(axis=1)
    both = np.concatenate([mean[::-1, :0:-1], mean], axis=1)  # from the other side's far end on
    total = np.cumsum(np.concatenate([np.zeros((2, 1, 3)), both], axis=1), axis=1)
    at = np.arange(_SIDE, both.shape[1] - _SIDE)
    step = (total[:, at + 1 + _SIDE] - total[:, at + 1] - total[:, at] + total[:, at - _SIDE]) / _SIDE
    strength = np.sqrt(np.sum((step / np.maximum(noise, 0.5)) ** 2, axis=2))
    away, scale_there = np.full(2, np.nan), float(np.median(scale))
    for side in range(2):
        own = strength[side, len(out) - 1 - _SIDE :]
        peaks = np.flatnonzero((own[1:-1] >= own[:-2]) & (own[1:-1] > own[2:])) + 1
        clear = peaks[own[peaks] > max(2.0, 0.25 * float(own.max()))]  # sds of a pixel's noise; of the largest step
        if len(clear):
            away[side] = out[clear[0]] / scale_there
    return away


def edge_size(sight: Sight, curve: Curve, half: Array, part: BoolArray) -> float:
    """How large the smaller of the steps at both flanks is along `part` (M,) of the curve, of 255."""
    normal, scale = (one[part] for one in sight.outward(curve))
    away = (half[part] * scale)[:, None] + np.array([-_BESIDE, _BESIDE])  # px
    middle = sight.pixels(curve.xy[part])[:, None]
    sides = [
        nan_mean(np.asarray(sight.planes.at(middle + side * away[..., None] * normal[:, None]), float))
        for side in SIDES
    ]
    return float(np.nanmin([np.linalg.norm(one[1] - one[0]) for one in sides]))


def pixel_noise(colour: NDArray[np.floating[Any]], axis: int) -> Array:
    """(3,) sd of each colour (..., 3) by the differences of neighbours along an axis."""
    away = np.abs(np.diff(colour, axis=axis))
    return np.asarray(MAD_TO_SD / math.sqrt(2.0) * np.nanmedian(away, axis=tuple(range(colour.ndim - 1))))


def appearance(sight: Sight, curve: Curve, half: Array, part: BoolArray, step: float) -> Look:
    """How much the body's colour varies across it along `part` (M,) of the curve, at least a share of the `step` at its
    flanks: less is shade on the body."""
    normal, scale = (one[part] for one in sight.outward(curve))
    width = float(np.median(half[part] * scale))  # px
    across = np.arange(-0.6 * width, 0.6 * width + STEP, STEP)
    colour = sight.planes.at(sight.pixels(curve.xy[part])[:, None] + across[:, None] * normal[:, None])
    pixel = pixel_noise(colour, axis=0)
    smooth = np.lib.stride_tricks.sliding_window_view(colour, min(_SIDE, len(across)), axis=1).mean(axis=-1)
    spread = MAD_TO_SD * np.nanmedian(np.abs(smooth - nan_median(smooth, axis=1)[:, None]), axis=(0, 1))
    least = max(1.0, STEP_SHARE * step)  # of 255: no encoder keeps less
    return Look(np.maximum(spread, least), np.maximum(pixel, 1.0))


def grown(sight: Sight, stations: Stations, hidden: BoolArray, name: str, width: float) -> OutlinedBody:
    """The body in its first picture; `hidden` (M,) stations lie under tags, `width` m is what is known of the body's
    near the clamp (NaN: nothing).

    Raises:
        ObservationError: no body is seen beside the clamp.
    """
    s, state = stations.s, np.zeros(1 + STATES)
    begin = float(s[np.argmin(hidden)])
    part = (s >= begin) & (s <= begin + FIRST) & ~hidden
    sides: Array = np.full(2, 0.5 * width)
    if math.isnan(width):
        sides = first_width(sight, stations.curve(state), part, stations.length)
    half, state[0] = np.full(stations.count, sides.mean()), 0.5 * (sides[0] - sides[1])
    step = edge_size(sight, stations.curve(state), half, part) if np.isfinite(half).all() else 0.0
    front = begin + FIRST
    while True:
        part = (s <= front) & ~hidden
        body = refined(sight, stations, state, half, part, step, STIFF if front < 1.0 else 1.0)
        if body is None:
            raise ObservationError(
                f"{name}: no body is seen beside the clamp: no two edges run along the base tag's direction. Check "
                "length_m, size_m and the base tag's turn_deg, and that the body stands out from its background.",
                about="outline",
            )
        if front >= 1.0:
            return body
        state, half, front = body.state, body.half, min(front + GROWS, 1.0)


def refined(
    sight: Sight, stations: Stations, state: Array, half: Array, part: BoolArray, step: float, stiffness: float = 1.0
) -> OutlinedBody | None:
    """The body by the flanks near the curve of `state`, `half` (M,) m from it, along `part` (M,) of it; None where they
    are not seen. `step` as of `appearance`, `stiffness` as of `Stations.fitted`."""
    if not np.isfinite(half).all():
        return None
    s, curve = stations.s, stations.curve(state)
    look = appearance(sight, curve, half, part, step)
    away = np.where(part, find_flanks(sight, curve, half, look), np.nan)
    wide = running_median(away[0] - away[1], 9)
    known = np.isfinite(wide)
    if known.sum() < 5:
        return None
    half = 0.5 * np.interp(s, s[known], wide[known])
    sd = MEASURED / float(np.median(sight.outward(curve)[1]))
    return OutlinedBody(stations.fitted(state, nan_mean(away - SIDES[:, None] * half), sd, stiffness), half, look)


# The film: each picture is searched near where the two before predict the body.

STATION, STATIONS = 4.0, 240  # px: distance of the normals; at most so many
POINTS = 30  # of the curve that are kept, evenly along the body
PLACES = (np.arange(POINTS) + 0.5) / POINTS  # (n,) their s
FAR = 0.4  # of `REACH`: a curve that is farther from its prediction is searched again
WIDE = 2.0  # px: so far off may the width at one station be
LOST = 0.75  # of the share of stations that usually show the body: with fewer it is elsewhere
USUAL = 60  # pictures, of which the usual share is taken


@dataclass(frozen=True)
class OutlineSearch:
    """What was found in T pictures."""

    state: Array  # (T, 1 + K) of the curves that were predicted
    away: Array  # (T, 2, M) m, from these curves to the flanks; NaN where not seen


def follow(
    sights: Iterable[Sight], stations: Stations, hidden: BoolArray, name: str, width: float = math.nan
) -> tuple[OutlineSearch, Array]:
    """The flanks in consecutive pictures, and half the width (M,) m in the first of them. A picture in which the body
    is lost has none; the next is searched near where the body was last, and near where it was first."""
    states: list[Array] = []
    found: list[Array] = []
    seen: list[float] = []
    body: OutlinedBody | None = None
    before: tuple[Array, Array] | None = None
    for sight in sights:
        if body is None:
            body = grown(sight, stations, hidden, name, width)
        last, one_more = (body.state, body.state) if before is None else before
        best: tuple[float, Array, Array, Array] | None = None
        for start in (2.0 * last - one_more, last, body.state):
            tried = _near(sight, stations, hidden, body, start)
            best = tried if best is None or tried[0] > best[0] else best
            if best[0] > LOST * (np.median(seen[-USUAL:]) if seen else 0.0):
                break
        assert best is not None
        share, state, away, new = best
        there = share > LOST * (np.median(seen[-USUAL:]) if seen else 0.0)
        before = (new, last) if there and before is not None else (new, new) if there else (last, last)
        seen += [share] if there else []
        states.append(state)
        found.append(away if there else np.full_like(away, np.nan))
    assert body is not None
    return OutlineSearch(np.stack(states), np.stack(found)), body.half


def each_alone(
    sights: Iterable[Sight], stations: Stations, hidden: BoolArray, name: str, width: float = math.nan
) -> tuple[OutlineSearch, Array]:
    """As `follow`, of pictures that have nothing to do with each other."""
    tried = [_alone(one, stations, hidden, name, width) for one in sights]
    half = np.median([body.half for body, _ in tried], axis=0)
    return OutlineSearch(np.stack([body.state for body, _ in tried]), np.stack([away for _, away in tried])), half


def _alone(sight: Sight, stations: Stations, hidden: BoolArray, name: str, width: float) -> tuple[OutlinedBody, Array]:
    body = grown(sight, stations, hidden, name, width)
    return body, np.where(hidden, np.nan, find_flanks(sight, stations.curve(body.state), body.half, body.look))


def _near(
    sight: Sight, stations: Stations, hidden: BoolArray, body: OutlinedBody, state: Array
) -> tuple[float, Array, Array, Array]:
    """Near the curve of `state`: the share of the stations that show both flanks as wide apart as the body is, the
    curve (1 + K,) that the flanks were looked for along, they (2, M) m from it, and the curve between them."""
    sd = MEASURED / float(np.median(sight.outward(stations.curve(state))[1]))
    for _ in range(3):
        curve = stations.curve(state)
        away = np.where(hidden, np.nan, find_flanks(sight, curve, body.half, body.look))
        new = stations.fitted(state, nan_mean(away - SIDES[:, None] * body.half), sd)
        if np.max(np.abs(stations.across(curve) @ (new - state))) < FAR * REACH * sd / MEASURED:
            break
        state = new
    wide = np.abs(away[0] - away[1] - 2.0 * body.half) < WIDE * sd / MEASURED
    return float(np.mean(wide[~hidden])), state, away, new


# Beside tags: what moves with the tags is the body. Their places and directions say where its middle runs in each
# picture. Along normals of that curve the body's edges stay, while what lies behind it passes by.

TAG_PLACE, TAG_TURN, CLAMP_TURN = 3e-4, 0.03, 0.02  # m, rad, rad: one sd of a tag, and of the clamp's direction
STEPS = 4  # of Gauss and Newton's method from the curve of the picture before
FINEST = 300  # samples of a profile, at most
LOOKED_AT = 40  # pictures, spread evenly, in which an edge must stay
STEEP = 8  # samples by which a lasting edge may step from station to station
BEND_COST = 0.04  # of a clear edge: what a step by one sample costs
STAYS = 0.4  # of its usual size, at least, that a lasting edge has in one picture
NEAR = 2.0  # px: one sd of where it is expected there
PASSES = 3  # over the edges of a picture
_NO_EDGES = "no two edges of a body move with the tags"


@dataclass(frozen=True)
class Straightened:
    """T pictures of the body, straightened along curves: J colours outward from each of M stations, to both sides."""

    state: Array  # (T, 1 + K) of the curves; NaN where a picture shows none
    colour: NDArray[np.uint8]  # (T, 2, M, J, 3)
    sample: Array  # (T, M) m from one colour to the next


def through_tags(stations: Stations, tags: Markers) -> Array:
    """(T, 1 + K) numbers of smooth curves from the clamp through the tags, along their directions; NaN without tags."""
    state, out = np.zeros(1 + STATES), np.full((len(tags.xy), 1 + STATES), np.nan)
    at = np.array([int(np.argmin(np.abs(stations.s - s))) for s in tags.s])
    turns = np.column_stack([np.zeros(stations.count), stations.functions])
    for t, seen in enumerate(np.isfinite(tags.xy).all(axis=2) & np.isfinite(tags.angle)):
        here = at[seen]
        for _ in range(STEPS if seen.any() else 0):
            curve = stations.curve(state)
            away = np.sum((tags.xy[t, seen] - curve.xy[here]) * curve.normal[here], axis=1)
            whole = np.concatenate(
                [
                    stations.across(curve)[here] / TAG_PLACE,
                    turns[here] / TAG_TURN,
                    turns[:1] / CLAMP_TURN,
                    np.diag(1.0 / stations.prior),
                ]
            )
            right = np.concatenate(
                [
                    away / TAG_PLACE,
                    (tags.angle[t, seen] - curve.angle[here]) / TAG_TURN,
                    -curve.angle[:1] / CLAMP_TURN,
                    -state / stations.prior,
                ]
            )
            state = state + np.linalg.lstsq(whole, right, rcond=None)[0]
            out[t] = state
    return out


def straightened(sights: Iterable[Sight], stations: Stations, state: Array) -> Straightened:
    """The pictures along the curves of these numbers (T, 1 + K)."""
    colours: list[NDArray[np.uint8]] = []
    samples: list[Array] = []
    for sight, one in zip(sights, state, strict=True):
        curve = stations.curve(np.nan_to_num(one))
        normal, scale = sight.outward(curve)
        if not colours:
            widest = WIDEST * stations.length * float(np.max(scale))  # px
            out = np.arange(0.0, widest, max(STEP, widest / FINEST))
        places = sight.pixels(curve.xy)[:, None] + SIDES[:, None, None, None] * out[:, None] * normal[:, None]
        colours.append(np.rint(np.nan_to_num(sight.planes.at(places))).astype(np.uint8))
        samples.append(out[1] / scale)
    return Straightened(state, np.stack(colours), np.stack(samples))


def lasting_edges(seen: Straightened, hidden: BoolArray, pixel_sd: Array) -> tuple[IntArray, Array]:
    """(2, M) the sample at which each side's edge stays in all pictures: the line along the body whose steps of colour
    are the largest; and their size, in sds of a colour. Raises `ObservationError` where nothing of the body is seen."""
    known = np.flatnonzero(np.isfinite(seen.state[:, 0]))
    if hidden.all() or not len(known) or seen.colour.shape[3] <= 4 * _SIDE:
        raise ObservationError(_NO_EDGES, about="outline")
    chosen = known[np.unique(np.linspace(0, len(known) - 1, LOOKED_AT).astype(int))]
    colour = seen.colour[chosen].astype(np.float32)
    total = np.cumsum(np.concatenate([np.zeros_like(colour[..., :1, :]), colour], axis=-2), axis=-2)
    at = np.arange(_SIDE, colour.shape[-2] - _SIDE)
    step = (
        total[..., at + 1 + _SIDE, :] - total[..., at + 1, :] - total[..., at, :] + total[..., at - _SIDE, :]
    ) / _SIDE
    size = np.median(np.linalg.norm(step / pixel_sd, axis=-1), axis=0)  # (2, M, J)
    place: IntArray = np.empty(size.shape[:2], dtype=np.int64)
    for side in range(2):
        shown = np.where(hidden[:, None], 0.0, size[side])
        place[side] = best_line(np.minimum(shown / max(float(np.median(shown[~hidden].max(axis=1))), 1.0), 1.5))
    return at[place], np.take_along_axis(size, place[..., None], axis=2)[..., 0]


def best_line(worth: Array) -> IntArray:
    """(M,) the places in the rows of `worth` (M, J) with the largest sum, steps from row to row paid for (Viterbi)."""
    best, came = worth[0], np.zeros(worth.shape, dtype=np.int64)
    shifts = np.arange(-STEEP, STEEP + 1)
    for row in range(1, len(worth)):
        padded = np.pad(best, STEEP, constant_values=-np.inf)
        before = np.lib.stride_tricks.sliding_window_view(padded, len(shifts)) - BEND_COST * np.abs(shifts)
        came[row] = np.argmax(before, axis=1)
        best = worth[row] + before.max(axis=1)
    line = [int(np.argmax(best))]
    for row in range(len(worth) - 1, 0, -1):
        line.append(line[-1] + int(shifts[came[row, line[-1]]]))
    return np.array(line[::-1])


def edges_near(colour: NDArray[np.uint8], expected: Array, least: Array, pixel_sd: Array) -> Array:
    """(2, M) samples outward of the edges near the `expected` (2, M) in one straightened picture (2, M, J, 3); NaN
    where none is as large as `least` (2, M), in sds of a colour."""
    first = np.rint(expected).astype(np.int64)
    window = np.clip(first[..., None] + np.arange(len(_OUT)) - len(_OUT) // 2, 0, colour.shape[2] - 1)
    near = np.take_along_axis(colour, window[..., None], axis=2).astype(np.float32)
    inside, outside = sides_of(near)
    size = np.linalg.norm((outside - inside) / pixel_sd, axis=-1)
    best = np.argmax(size * np.exp(-0.5 * ((_OUT[_MIDDLE] - STEP * (expected - first)[..., None]) / NEAR) ** 2), axis=2)
    place = edge_place(near, _MIDDLE[best], pixel_sd)
    clear = (np.take_along_axis(size, best[..., None], axis=2)[..., 0] >= least) & (np.abs(place) < REACH)
    return np.asarray(np.where(clear, first + place / STEP, np.nan))


def with_tags(
    sights: Iterable[Sight], stations: Stations, hidden: BoolArray, tags: Markers
) -> tuple[OutlineSearch, Array]:
    """The flanks in pictures whose `tags` are known, and half the body's width (M,) m."""
    seen = straightened(sights, stations, through_tags(stations, tags))
    some = seen.colour[:: max(1, len(seen.colour) // LOOKED_AT)].astype(np.float32)
    pixel_sd = np.maximum(pixel_noise(some, axis=3), 1.0)
    place, size = lasting_edges(seen, hidden, pixel_sd)
    least = np.maximum(STAYS * size, LEAST)
    found = []
    for state, colour, sample in zip(seen.state, seen.colour, seen.sample, strict=True):
        if np.isnan(state[0]):
            found.append(np.full(place.shape, np.nan))
            continue
        expected, sd = place.astype(float), MEASURED * float(np.median(sample)) / STEP
        for _ in range(PASSES):
            away = np.where(hidden, np.nan, edges_near(colour, expected, least, pixel_sd))
            smooth = stations.fitted(state, SIDES[:, None] * (away - place) * sample, sd)
            expected = place + SIDES[:, None] * (stations.across(stations.curve(state)) @ (smooth - state)) / sample
        away = np.where(np.abs(away - expected) * STEP < NEAR, away, np.nan)
        found.append(SIDES[:, None] * away * sample)
    flanks, half = np.stack(found), 0.5 * place.sum(axis=0) * np.median(seen.sample, axis=0)
    if np.isfinite(flanks[:, :, ~hidden]).mean() < LEAST_SEEN:
        raise ObservationError(_NO_EDGES, about="outline")
    known = np.flatnonzero(np.isfinite(seen.state[:, 0]))
    every = np.stack([np.interp(np.arange(len(seen.state)), known, one[known]) for one in seen.state.T], axis=1)
    return OutlineSearch(every, flanks), half


# The centreline: the width is the same in all pictures; flanks that contradict it, or their neighbours, are left out.

OUTLIER = 4.0  # sds
NEIGHBOURS = 15  # stations, whose median a place is compared with
LEAST_SHARE = 0.4  # of the stations that a point stands for, and of the frames in which it is seen
LEAST_SEEN = 0.5  # of all places in all frames: with fewer the curve is not that of a body
MOST_OFF = 0.1  # of its width, by which one body may seem to change it


def body_width(away: Array, half: Array) -> tuple[Array, float]:
    """(M,) m, the body's width by its flanks (T, 2, M) in all pictures, and one sd [m] of it in a single one; `half`
    (M,) is what the first picture shows of it."""
    width = away[:, 0] - away[:, 1]
    often = np.isfinite(width).sum(axis=0) > 0.1 * len(width)
    usual = np.where(often, nan_median(width), 2.0 * half)
    if len(width) == 1:  # a picture alone: by its neighbours along the body
        usual = np.where(often, running_median(usual, NEIGHBOURS), usual)
    return usual, MAD_TO_SD * float(np.nanmedian(np.abs(width - usual)))


def middles(each: Array, smooth: Array, spread: float) -> Array:
    """(T, M) m, the middles of both flanks by each of them (T, 2, M); where they contradict each other that of the one
    nearer to the `smooth` (T, M) curve. `spread` m: one sd of their difference."""
    apart = np.abs(each[:, 0] - each[:, 1]) > OUTLIER * spread
    off = np.abs(each - smooth[:, None])
    farther = np.stack([off[:, 0] > off[:, 1], off[:, 1] >= off[:, 0]], axis=1)
    kept = np.where(apart[:, None] & farther, np.nan, each)
    return nan_mean(np.moveaxis(kept, 1, 0))


@dataclass(frozen=True)
class Middle:
    """The centreline through M stations in T pictures."""

    state: Array  # (T, 1 + K) of smooth curves
    away: Array  # (T, M) m from them; NaN where not seen
    apart: Array  # (T, M) m, by how much the flanks are farther apart than the body is wide; NaN where one is not seen
    sd: float  # m, white, of one station
    alike: float  # correlation of neighbouring stations
    width: Array  # (M,) m


def centreline(found: OutlineSearch, stations: Stations, half: Array, sd: float) -> Middle:
    """The middle between the flanks; `sd` m is that of the fits of smooth curves."""
    width, spread = body_width(found.away, half)
    each = found.away - 0.5 * SIDES[:, None] * width
    states = np.stack([stations.fitted(*one, sd) for one in zip(found.state, each, strict=True)])
    smooth = np.stack([stations.across(stations.curve(a)) @ (b - a) for a, b in zip(found.state, states, strict=True)])
    away = middles(each, smooth, spread) - smooth
    apart = each[:, 0] - each[:, 1]
    apart = np.where(np.abs(apart) <= OUTLIER * spread, apart, np.nan)
    local = away - np.stack([running_median(one, NEIGHBOURS) for one in away])
    white = MAD_TO_SD * float(np.nanmedian(np.abs(local)))
    away = np.where(np.abs(local) <= OUTLIER * white, away, np.nan)
    local = np.clip(local / max(white, 1e-12), -OUTLIER, OUTLIER)
    alike = float(np.nanmean(local[:, 1:] * local[:, :-1]) / max(float(np.nanmean(local**2)), 1e-12))
    return Middle(states, away, apart, white, min(max(alike, 0.0), 0.9), width)


def outline_track(
    rec: Recording,
    view: View,
    corners: Array,
    frames: IntArray,
    *,
    tags: Markers | None = None,
    apart: bool = False,
    progress: Progress = Silent(),
) -> OutlineTrack:
    """The body's centreline in the `frames` (T,) of the film of `rec`, in which the base tags' corners (T, b, 4, 2)
    [px] are known; `view` is that of the base tag's plane and frame. Frames that are far `apart` are searched each by
    itself, from the clamp on.

    Raises:
        RecordingError: the film cannot be read.
        ObservationError: no body is seen beside the clamp, or it is lost.
    """
    ends = project(view, np.array([[0.0, 0.0], [rec.beam.length, 0.0]]))
    scale = float(np.linalg.norm(ends[1] - ends[0])) / rec.beam.length  # px/m
    stations = Stations(rec.beam.length, min(max(2 * POINTS, math.ceil(rec.beam.length * scale / STATION)), STATIONS))
    base = rec.tags.on_base[0].s
    paper = PAPER * rec.tags.size / rec.beam.length
    hidden = np.min([np.abs(stations.s - s) for s in (base, *(tag.s for tag in rec.tags.on_beam))], axis=0) < paper
    hidden |= stations.s < base
    shift = corners.mean(axis=2) - nan_median(corners.mean(axis=2))
    shift = nan_mean(np.moveaxis(shift, 1, 0))
    known = np.isfinite(shift[:, 0])
    shift = np.stack([np.interp(np.arange(len(shift)), np.flatnonzero(known), one[known]) for one in shift.T], axis=1)
    wanted = {int(frame): row for row, frame in enumerate(frames)}

    def sights() -> Iterator[Sight]:
        assert rec.video is not None
        for index, _, raw in track(progress, "Following the outline", timed(rec.video), len(frames)):
            if index in wanted:
                yield Sight(planes_of(rec, index, raw), view, shift[wanted[index]])

    width = math.nan if rec.outline is None else rec.outline.width
    if tags is not None:
        found, half = with_tags(sights(), stations, hidden, tags)
    else:
        seek = each_alone if apart else follow
        found, half = seek(sights(), stations, hidden, rec.name, width)
    middle = centreline(found, stations, half, MEASURED / scale)
    refuse_lost(middle, found, ~hidden, rec.name)
    out = points_of(middle, found, stations, [Sight(_NO_PLANES, view, one) for one in shift], scale)
    return replace(often_seen(out), remarks=lost_remarks(found))


# Beside tags the outline is used only where it agrees with them. A tag may sit beside the middle of the body, by its
# placement; as the body bends, it stays there.

EVERY, MOST_READ = 0.1, 240  # s, pictures: so often, and in so many, is the outline read beside tags
BESIDE = 3e-4  # m: one sd of where a tag's middle seems to lie, besides its placement
MOVED = 5e-3  # of the length: a line that moves more against a tag is not the body's
TURNED = 0.03  # rad, likewise by its direction there
APART = 1.5  # times its own sds: tags curl and lie at heights of their own, so that both agree less


def with_outline(
    rec: Recording,
    markers: Markers,
    detections: Detections,
    number: IntArray,
    *,
    apart: bool = False,
    progress: Progress = Silent(),
) -> Markers:
    """The `markers` of these detections, in frames of this `number`, with points of the body's outline; a note where
    there are tags that the outline does not agree with, and it is left out.

    Raises:
        RecordingError, ObservationError: as `outline_track`, the second without tags on the body.
    """
    assert markers.view is not None
    base = detections.corners[:, : len(rec.tags.on_base)]
    if rec.tags.on_beam and np.max(np.abs(markers.base_angle)) > TURNED:
        return replace(markers, remarks=(*markers.remarks, left_out("the clamp turns in the picture")))
    try:
        each = 1
        if rec.tags.on_beam and not apart:
            each = max(round(EVERY / float(np.median(np.diff(detections.time)))), math.ceil(len(number) / MOST_READ), 1)
        kept = np.arange(0, len(number), each)
        of_kept = replace(markers, xy=markers.xy[kept], angle=markers.angle[kept]) if rec.tags.on_beam else None
        outline = outline_track(
            rec, markers.view, base[kept], number[kept], tags=of_kept, apart=apart, progress=progress
        )
        outline = spread_over(outline, kept, len(number))
        hung: BoolArray = ~np.asarray(np.isfinite(detections.corners).any(axis=(1, 2, 3)))
        outline = replace(
            outline, sd=np.where(hung[:, None], np.nan, (APART if rec.tags.on_beam else 1.0) * outline.sd)
        )
        both = measure_markers(detections, rec, outline)
        doubt = contradicted(both, rec)
    except ObservationError as wrong:
        if not rec.tags.on_beam:
            raise
        doubt = str(wrong).split(". ")[0].removeprefix(f"{rec.name}: ")
    return replace(markers, remarks=(*markers.remarks, left_out(doubt))) if doubt else both


def spread_over(outline: OutlineTrack, kept: IntArray, count: int) -> OutlineTrack:
    """The outline of the frames `kept` among `count`: not seen in the others, where its curve runs between those."""
    every = np.arange(count)
    after = np.clip(np.searchsorted(kept, every), 1, len(kept) - 1) if len(kept) > 1 else np.zeros(count, dtype=int)
    before = np.maximum(after - 1, 0)
    share = np.clip((every - kept[before]) / np.maximum(kept[after] - kept[before], 1), 0.0, 1.0)[:, None, None]
    px, ahead = ((1.0 - share) * one[before] + share * one[after] for one in (outline.px, outline.ahead))
    sd = np.full((count, outline.sd.shape[1]), np.nan)
    sd[kept] = outline.sd
    return replace(outline, px=px, ahead=ahead, sd=sd)


def left_out(why: str) -> Remark:
    """That the tags alone are used."""
    return Remark("note", f"The body's outline is not used beside the tags: {why}.")


def contradicted(both: Markers, rec: Recording) -> str:
    """Where the outline contradicts the tags, in words; "" where it does not, or there are none between its points."""
    assert both.traced is not None
    points = np.flatnonzero(both.traced)
    for tag in np.flatnonzero(~both.traced).tolist():
        before, after = points[both.s[points] < both.s[tag]], points[both.s[points] > both.s[tag]]
        if not len(before) or not len(after):
            continue
        away = _from_line(both, tag, before[-1], after[0], rec.beam.length)
        chord = both.xy[:, after[0]] - both.xy[:, before[-1]]
        turn = np.angle(np.exp(1j * (np.arctan2(chord[:, 1], chord[:, 0]) - both.angle[:, tag])))
        seen = np.isfinite(away) & np.isfinite(turn)
        if not seen.any():
            continue
        beside, aside = float(np.median(away[seen])), float(np.median(turn[seen]))
        moved, turned = float(np.max(np.abs(away[seen] - beside))), float(np.max(np.abs(turn[seen] - aside)))
        name, most = f"tag {both.tag_id[tag]}", 3.0 * math.hypot(rec.tags.placement_sd, BESIDE)
        if abs(beside) > most:
            return f"it passes {1e3 * abs(beside):.2g} mm beside the middle of {name}"
        if moved > MOVED * rec.beam.length:
            return f"it moves by up to {1e3 * moved:.2g} mm against {name}"
        if turned > TURNED:
            return f"it turns by up to {math.degrees(turned):.2g} degrees against {name}"
    return ""


def _from_line(both: Markers, tag: int, before: int, after: int, length: float) -> Array:
    """(T,) m of a tag to the left of the curve through two points of the outline with their directions (Hermite)."""
    span = float(both.s[after] - both.s[before])
    u = float(both.s[tag] - both.s[before]) / span
    ends = [both.xy[:, before], both.xy[:, after]]
    slopes = [
        span * length * np.stack([np.cos(both.angle[:, i]), np.sin(both.angle[:, i])], axis=1) for i in (before, after)
    ]
    rise = u * u * (3.0 - 2.0 * u)
    line = (1.0 - rise) * ends[0] + rise * ends[1] + u * (1.0 - u) * ((1.0 - u) * slopes[0] - u * slopes[1])
    chord = ends[1] - ends[0]
    left = np.stack([-chord[:, 1], chord[:, 0]], axis=1) / np.linalg.norm(chord, axis=1)[:, None]
    return np.asarray(np.sum((both.xy[:, tag] - line) * left, axis=1))


def refuse_lost(middle: Middle, found: OutlineSearch, shown: BoolArray, name: str) -> None:
    """Raises `ObservationError` where what was followed is no body of one width from clamp to tip; `shown` (M,)
    stations do not lie under tags."""
    seen = np.isfinite(middle.away[:, shown])
    share = seen.mean()
    hint = (
        "Look at the curve that `onebend check` draws. Light the body so that it stands out from its background, clear "
        "away what lies beside it, state its width near the clamp (width_m in [outline]), or put tags on it."
    )
    if share < LEAST_SEEN:
        raise ObservationError(
            f"{name}: the body's outline is lost: both edges of one body are seen at {100 * share:.0f} % of its places "
            f"only. {hint}",
            about="outline",
        )
    width = (found.away[:, 0] - found.away[:, 1])[:, shown]
    off = MAD_TO_SD * float(np.nanmedian(np.abs(width - middle.width[shown]))) / float(np.median(middle.width[shown]))
    if off > MOST_OFF:
        raise ObservationError(
            f"{name}: the curve that was followed leaves the body: its width changes by {100 * off:.0f} % from picture "
            f"to picture. {hint}",
            about="outline",
        )
    tip = seen[:, -max(1, len(shown) // 20) :].mean()
    if tip < LEAST_SHARE:
        raise ObservationError(
            f"{name}: the body's edges end before its tip (seen there in {100 * tip:.0f} % of the frames). Is length_m "
            f"too long, or the tip out of the picture? {hint}",
            about="outline",
        )


def lost_remarks(found: OutlineSearch) -> tuple[Remark, ...]:
    """A note where some frames do not show the body."""
    lost = int(np.sum(~np.isfinite(found.away).any(axis=(1, 2))))
    text = f"The body's outline was lost in {lost} of {len(found.away)} frames; they are left out of it."
    return (Remark("note", text),) if lost else ()


_NO_PLANES = Planes(np.zeros((2, 2), dtype=np.uint8), np.zeros((2, 2, 2), dtype=np.uint8))


SHARED = 2.0  # sds of what both flanks show: light, walls and blur shift both alike, which their distance hides


def lasting_sd(apart: Array) -> Array:
    """(n,) m, one sd of points in the middle of two flanks, as if their errors were new in each picture and alike
    nowhere; `apart` (T, n) m: by how much the flanks are farther apart than the body is wide, both errors being
    independent."""
    alike = np.nan_to_num(apart)
    times = correlation_time(alike) * correlation_time(alike.T, longest=2)
    return np.asarray(0.5 * SHARED * np.sqrt(times) * np.sqrt(np.nan_to_num(nan_mean(apart**2))))


def points_of(
    middle: Middle, found: OutlineSearch, stations: Stations, sights: Sequence[Sight], scale: float
) -> OutlineTrack:
    """Points of the centreline, each the mean of the stations about it; `scale` px/m."""
    s = PLACES
    group = np.minimum((stations.s * POINTS).astype(int), POINTS - 1)
    means = np.eye(POINTS)[group]  # (M, n)
    seen = np.isfinite(middle.away)
    count = seen @ means
    shown = count >= LEAST_SHARE * means.sum(axis=0)
    away = np.divide(np.where(seen, middle.away, 0.0) @ means, count, out=np.zeros(count.shape), where=count > 0)
    few = count * (1.0 - middle.alike) / (1.0 + middle.alike)
    apart = np.stack([nan_mean(middle.apart[:, group == i].T) for i in range(POINTS)], axis=1)
    sd = np.where(shown, scale * np.maximum(middle.sd / np.sqrt(np.maximum(few, 1.0)), lasting_sd(apart)), np.nan)
    px, ahead = np.empty((*away.shape, 2)), np.empty((*away.shape, 2))
    for t, sight in enumerate(sights):
        predicted, smooth = stations.curve(found.state[t]), stations.curve(middle.state[t])
        off = stations.across(predicted) @ (middle.state[t] - found.state[t])
        xy = predicted.xy + off[:, None] * predicted.normal
        at = [np.interp(s, stations.s, values) for values in (*xy.T, smooth.angle)]
        tangent = np.stack([np.cos(at[2]), np.sin(at[2])], axis=1)
        there = np.stack(at[:2], axis=1) + away[t][:, None] * np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        px[t], ahead[t] = sight.pixels(there), sight.pixels(there + 0.5 / POINTS * stations.length * tangent)
    width = np.array([np.median(middle.width[group == i]) for i in range(POINTS)])
    return OutlineTrack(s, px, ahead, sd, width)


def often_seen(outline: OutlineTrack) -> OutlineTrack:
    """Without the points that most frames do not show."""
    kept = np.isfinite(outline.sd).mean(axis=0) >= LEAST_SHARE
    px, ahead, sd = (one[:, kept] for one in (outline.px, outline.ahead, outline.sd))
    return replace(outline, s=outline.s[kept], px=px, ahead=ahead, sd=sd, width=outline.width[kept])
