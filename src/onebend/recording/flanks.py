"""A body in one picture: both flanks of its top face, to parts of a pixel, along normals of a curve.

A flank is the place where the body's own colour ends. Seen for the first time, the body is followed from the clamp,
whose place and direction the base tag says, to its tip.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from onebend.errors import ObservationError
from onebend.recording.entries import Recording
from onebend.recording.plane import project, scale_of
from onebend.recording.signals import MAD_TO_SD, nan_mean, nan_median, running_median
from onebend.recording.video import picture_in, samples, upright
from onebend.records import Array, BoolArray, IntArray, View, left_of, unit


@dataclass(frozen=True)
class Planes:
    """One picture as its encoder keeps it: brightness of every pixel, colour of every or every second one."""

    luma: NDArray[np.uint8]  # (H, W)
    chroma: NDArray[np.uint8]  # (2, h, w)
    left: bool = True  # where chroma has half the columns: its samples stand on the left of two pixels, not between

    def at(self, px: Array) -> NDArray[np.float32]:
        """(..., 3) luma and both chromas at pixels (..., 2), in proportion between neighbours; NaN outside."""
        height, width = self.luma.shape
        x, y = np.moveaxis(px.astype(np.float32), -1, 0)
        across, down = width // self.chroma.shape[2], height // self.chroma.shape[1]
        shift = 0.0 if self.left else 0.5 * (across - 1)
        out: NDArray[np.float32] = np.empty((*x.shape, 3), dtype=np.float32)
        _between(self.luma[None], x, y, out[..., :1])
        _between(self.chroma, (x - shift) / across, (y - 0.5 * (down - 1)) / down, out[..., 1:])
        inside = (x >= 0.0) & (y >= 0.0) & (x <= width - 1.0) & (y <= height - 1.0)
        if not inside.all():
            out[~inside] = np.nan
        return out


def _between(
    planes: NDArray[np.uint8], x: NDArray[np.float32], y: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    """Puts the linear interpolation in planes (n, h, w) into `out` (..., n); beyond their edge as on it."""
    n, h, w = planes.shape
    x, y = (np.fmax(np.fmin(one, size - 1.001), 0.0) for one, size in ((x, w), (y, h)))  # NaN too
    i, j = y.astype(np.int32), x.astype(np.int32)
    fy, fx = y - i.astype(np.float32), x - j.astype(np.float32)
    at = i * w + j
    for k in range(n):
        flat = planes[k].reshape(-1)
        corners = [flat[first:].take(at).astype(np.float32) for first in (0, 1, w, w + 1)]
        top = corners[0] + fx * (corners[1] - corners[0])
        low = corners[2] + fx * (corners[3] - corners[2])
        out[..., k] = top + fy * (low - top)


def grey(luma: NDArray[np.uint8]) -> Planes:
    """The planes of a picture without colour."""
    return Planes(luma, np.full((2, 2, 2), 128, np.uint8))


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
    luma, blue, red = (np.ascontiguousarray(upright(samples(one), raw.rotation)) for one in frame.planes)
    turned = raw.rotation % 360 != 0  # then chroma's samples stand on another side: between is nearest to all
    return Planes(luma, np.stack([blue, red]), left=not turned and not raw.format.name.startswith("yuvj"))


STATES = 12  # Legendre polynomials of the curve's angle
SETTLED = 0.05  # by which no weight of a robust fit changes any more
CLAMP_OFF = 2e-3  # m: one sd of the curve's begin across the clamp's direction


@dataclass(frozen=True)
class Curve:
    """A curve through M stations."""

    xy: Array  # (M, 2) m
    angle: Array  # (M,) rad

    @cached_property
    def normal(self) -> Array:
        """(M, 2) to its left."""
        return left_of(unit(self.angle))


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
        tangent = unit(angle)
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
            before, weight = weight, np.maximum(1.0 - (left / (5.0 * spread)) ** 2, 0.0) ** 2 + 1e-9
            if np.max(np.abs(weight - before)) < SETTLED:
                break
        return np.asarray(state + step)


# Flanks. A step of colour counts as the body's own end where the means over `SIDE` inside it are like the body, and
# those outside are not; more than `MOST` sds of a difference count as so many, so that the first clear step is taken
# and not the strongest, which may be the far edge of a wall or of a shadow.

STEP = 0.5  # px: of the samples along a normal
SIDE = 3.0  # px: means over so much to either side of an edge tell how large its step is
REACH = 6.0  # px: an edge is looked for so far from where it is expected
MOST = 8.0  # sds of the body's colour
LEAST = 4.0  # of them: a smaller step is no edge
NEAR = 2.0  # px: one sd of where an edge is expected in a straightened picture
NEIGHBOURS = 15  # stations, whose median a place is compared with
SIDES: Array = np.array([1.0, -1.0])  # left and right of the body's direction
OUT = np.arange(-REACH - 2.0 * SIDE, REACH + 2.0 * SIDE + 0.5 * STEP, STEP)  # (J,) px outward from an expected flank
SAMPLES_ASIDE = round(SIDE / STEP)
MIDDLE = np.flatnonzero(np.abs(OUT) <= REACH + 0.5 * STEP)  # where an edge may be
_INNER = np.array([0.35, 0.5, 0.65])  # of the half width: the colour there is the body's
_LEVEL = (round(1.5 / STEP), round(3.5 / STEP))  # samples from an edge between which its two levels are taken
_HALF = round(2.5 / STEP)  # samples to either side over which it is integrated


@dataclass(frozen=True)
class Look:
    """How the body's colour varies within itself."""

    sd: Array  # (3,) of the mean over `SIDE`
    pixel_sd: Array  # (3,) of one sample
    rim: Array = field(default_factory=lambda: np.zeros(3))  # (2, 1, 3) colour just inside a flank, less the middle's


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
    places = np.concatenate([np.broadcast_to(OUT, (len(half), len(OUT))), inner], axis=1)
    seen = sight.planes.at(expected[:, :, None] + places[..., None] * outward[:, :, None])
    colour, within = seen[:, :, : len(OUT)], np.median(seen[:, :, len(OUT) :], axis=2)
    body = np.swapaxes(running_median(np.swapaxes(within, 0, 1), NEIGHBOURS), 0, 1)  # a dot on it is not
    inside, outside = sides_of(colour, MIDDLE)
    step = unlike(outside, body, look) - unlike(inside, body, look)
    likely = step * np.exp(-0.5 * (2.0 * OUT[MIDDLE] / REACH) ** 2)
    best = np.argmax(np.nan_to_num(likely, nan=-np.inf), axis=2)
    size = np.take_along_axis(step, best[..., None], axis=2)[..., 0]
    place = edge_place(colour, MIDDLE[best], look.pixel_sd)
    clear = (size >= LEAST) & (np.abs(place) < REACH)
    return np.asarray(np.where(clear, away + SIDES[:, None] * place / scale, np.nan))


def sides_of(colour: NDArray[np.float32], at: IntArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean colours inside and outside the consecutive samples `at` (j,) of profiles (..., J, 3)."""
    total = np.cumsum(np.concatenate([np.zeros_like(colour[..., :1, :]), colour], axis=-2), axis=-2)
    total /= SAMPLES_ASIDE
    first, last = int(at[0]), int(at[-1]) + 1
    before, here, beyond, after = (
        total[..., first + shift : last + shift, :] for shift in (-SAMPLES_ASIDE, 0, 1, 1 + SAMPLES_ASIDE)
    )
    return here - before, after - beyond


def step_size(colour: NDArray[np.float32], at: IntArray, pixel_sd: Array) -> NDArray[np.float32]:
    """(..., j) sds by which colours (..., J, 3) differ on both sides of the samples `at` (j,)."""
    inside, outside = sides_of(colour, at)
    step = (outside - inside) / pixel_sd.astype(np.float32)
    return np.asarray(np.sqrt(np.einsum("...c,...c->...", step, step)))


def edges_near(colour: NDArray[Any], expected: Array, least: Array, pixel_sd: Array, *, fine: bool = True) -> Array:
    """(2, M) samples outward of the edges near the `expected` (2, M) in one straightened picture (2, M, J, 3); NaN
    where none is as large as `least` (2, M), in sds of a colour. Not `fine`: to a sample."""
    first = np.rint(expected).astype(np.int64)
    window = np.clip(first[..., None] + np.arange(len(OUT)) - len(OUT) // 2, 0, colour.shape[2] - 1)
    rows = np.arange(first.size).reshape(*first.shape, 1) * colour.shape[2]
    near = colour.reshape(-1, 3).take(rows + window, axis=0).astype(np.float32)
    size = step_size(near, MIDDLE, pixel_sd)
    off = (OUT[MIDDLE] - STEP * (expected - first)[..., None]).astype(np.float32) / NEAR
    best = np.argmax(size * np.exp(-0.5 * off**2), axis=2)
    place = edge_place(near, MIDDLE[best], pixel_sd) if fine else OUT[MIDDLE[best]]
    clear = (np.take_along_axis(size, best[..., None], axis=2)[..., 0] >= least) & (np.abs(place) < REACH)
    return np.asarray(np.where(clear, first + place / STEP, np.nan))


def unlike(colour: NDArray[np.float32], body: Array, look: Look) -> Array:
    """(2, M, J) sds, up to `MOST`, between colours (2, M, J, 3) and the body's (2, M, 3), in its middle or at its rim:
    the nearer of them."""
    squares = [np.sum(((colour - one[:, :, None]) / look.sd) ** 2, axis=-1) for one in (body, body + look.rim)]
    return np.asarray(np.minimum(np.sqrt(np.minimum(*squares)), MOST))


def edge_place(colour: NDArray[np.float32], first: IntArray, pixel_sd: Array) -> Array:
    """(2, M) px outward from the expected flanks: where a sharp step between the two levels about sample `first` (2, M)
    of the profiles (2, M, J, 3) would have the same integral."""
    centre, off = first, np.zeros(first.shape)
    for _ in range(2):  # the first sample stands where the colour begins to change, not in the middle of the step
        centre = np.clip(centre + np.rint(off / STEP).astype(np.int64), _LEVEL[1], len(OUT) - 1 - _LEVEL[1])
        off = np.nan_to_num(_fraction(colour, centre, pixel_sd))
    return np.asarray(OUT[centre] + _fraction(colour, centre, pixel_sd))


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


@dataclass(frozen=True)
class BodyPlace:
    """Where the body is looked for: a plane, and places along the body."""

    name: str  # of the recording
    view: View  # of the base tag's plane and frame
    stations: Stations
    hidden: BoolArray  # (M,) stations that lie under tags
    width: float  # m, near the clamp; NaN where it is not known

    @property
    def scale(self) -> float:
        """px/m along the body as it would lie straight."""
        return scale_of(self.view, self.stations.length)


# The first picture: the body is followed from the clamp to its tip.

GROWS = 0.04  # of the length: how far ahead in one go
FIRST = 0.10  # of the length: there the body's colour and width are taken
WIDEST = 0.15  # of the length: half of the widest body
WIDTH_OFF = 0.15  # of the width near the clamp: two edges that differ more from what is stated are not those meant
PAPER = 0.75  # of a tag's side: from its middle to where its paper ends, along the beam
STEP_SHARE = 1.0 / 16.0  # of the step at the flanks: sd of the body's colour, at least
RIM_SHARE = 0.5  # of this step: by so much, at most, its rim may differ from its middle
_BESIDE = 4.0  # px to either side of a flank, where its step is measured
MEASURED = 0.1  # px: sd of a flank's place, for the curve that carries the search
STIFF = 10.0  # times stiffer than a bent beam: the curve whose far end nothing holds yet


@dataclass(frozen=True)
class OutlinedBody:
    """The body in one picture."""

    state: Array  # (1 + K,) of its curve
    half: Array  # (M,) m, half its width
    look: Look


def first_width(sight: Sight, curve: Curve, part: BoolArray, length: float, width: float = math.nan) -> Array:
    """(2,) m from the axis to the left and to the right flank along `part` (M,) of the curve: of the clear steps of the
    mean colour those that are `width` [m] apart, where two nearly are, else the innermost; NaN where there is none."""
    normal, scale = (one[part] for one in sight.outward(curve))
    out = np.arange(0.0, WIDEST * length * float(np.median(scale)), STEP)
    middle = sight.pixels(curve.xy[part])
    colour = sight.planes.at(middle[:, None] + SIDES[:, None, None, None] * out[:, None] * normal[:, None])
    out = out[: int(np.sum(np.isfinite(colour).all(axis=(0, 1, 3))))]
    colour = colour[:, :, : len(out)]  # (2, m, J, 3)
    if len(out) <= 4 * SAMPLES_ASIDE:
        return np.full(2, np.nan)
    noise = pixel_noise(colour[:, :, : 2 * SAMPLES_ASIDE], axis=1)
    mean = colour.mean(axis=1)
    both = np.concatenate([mean[::-1, :0:-1], mean], axis=1)  # from the other side's far end on
    inside, outside = sides_of(both, np.arange(SAMPLES_ASIDE, both.shape[1] - SAMPLES_ASIDE))
    strength = np.linalg.norm((outside - inside) / np.maximum(noise, 0.5), axis=2)
    edges = []
    for side in range(2):
        own = strength[side, len(out) - 1 - SAMPLES_ASIDE :]
        peaks = np.flatnonzero((own[1:-1] >= own[:-2]) & (own[1:-1] > own[2:])) + 1
        clear = own[peaks] > max(2.0, 0.25 * float(own.max()))  # sds of a pixel's noise; of the largest step
        edges.append(out[peaks[clear]] / float(np.median(scale)))
    if not len(edges[0]) or not len(edges[1]):
        return np.full(2, np.nan)
    off = np.abs(np.add.outer(*edges) - width)
    best = np.unravel_index(int(np.argmin(off)), off.shape) if np.any(off < WIDTH_OFF * width) else (0, 0)
    return np.array([one[i] for one, i in zip(edges, best, strict=True)])


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
    """How the body's colour varies across it along `part` (M,) of the curve: its sd is at least a share of the `step`
    at its flanks, as less is shade on the body. The rim of a round or bevelled body has a colour of its own, which
    differs from that of the middle by less than from what lies beside the body."""
    normal, scale = (one[part] for one in sight.outward(curve))
    width = float(np.median(half[part] * scale))  # px
    across = np.arange(-0.6 * width, 0.6 * width + STEP, STEP)
    colour = sight.planes.at(sight.pixels(curve.xy[part])[:, None] + across[:, None] * normal[:, None])
    pixel = pixel_noise(colour, axis=0)
    smooth = np.lib.stride_tricks.sliding_window_view(colour, min(SAMPLES_ASIDE, len(across)), axis=1).mean(axis=-1)
    spread = MAD_TO_SD * np.nanmedian(np.abs(smooth - nan_median(smooth, axis=1)[:, None]), axis=(0, 1))
    least = max(1.0, STEP_SHARE * step)  # of 255: no encoder keeps less
    near = SIDES[:, None] * (half[part] * scale - SIDE)  # (2, m) px
    inside = sight.planes.at(sight.pixels(curve.xy[part]) + near[..., None] * normal)
    rim = nan_median(inside - np.median(colour, axis=1), axis=1)
    rim[~(np.linalg.norm(rim, axis=1) < RIM_SHARE * step)] = 0.0
    return Look(np.maximum(spread, least), np.maximum(pixel, 1.0), rim[:, None])


def grown(sight: Sight, place: BodyPlace, before: OutlinedBody | None = None) -> OutlinedBody:
    """The body in a picture, followed from the clamp on: in its first one, or as it was `before`.

    Raises:
        ObservationError: no body is seen beside the clamp; not where it was seen `before`.
    """
    stations, hidden, width = place.stations, place.hidden, place.width
    s, state = stations.s, np.zeros(1 + STATES)
    begin = float(s[np.argmin(hidden)])
    part = (s >= begin) & (s <= begin + FIRST) & ~hidden
    if before is not None:
        half, state[0] = before.half, before.state[0]
    else:
        sides = first_width(sight, stations.curve(state), part, stations.length, width)
        sides = np.where(np.isnan(sides), 0.5 * width, sides)
        half, state[0] = np.full(stations.count, sides.mean()), 0.5 * (sides[0] - sides[1])
    step = edge_size(sight, stations.curve(state), half, part) if np.isfinite(half).all() else 0.0
    front = begin + FIRST
    while True:
        part = (s <= front) & ~hidden
        body = refined(sight, stations, state, half, part, step, STIFF if front < 1.0 else 1.0)
        if body is None and before is not None:
            return before
        if body is None and not math.isnan(width):  # what is as wide is too faint
            return grown(sight, replace(place, width=math.nan))
        if body is None:
            raise ObservationError(
                f"{place.name}: no body is seen beside the clamp: no two edges run along the base tag's direction. "
                "Check length_m, size_m and the base tag's turn_deg, and that the body stands out from its background.",
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
