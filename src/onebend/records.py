"""The frozen records that flow from floor to floor.

Units are SI and radians. `T` counts video frames, `m` tags on the beam, `N` rows of a force log. Unknown is NaN.
The frame ("beam's frame") has its origin at the base tag's centre, x along the undeformed beam, y to its left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from onebend.errors import section

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


def paired(x: Array, y: Array) -> Array:
    """(..., 2), faster than `numpy.stack`; x and y are broadcast."""
    shape = x.shape if x.shape == y.shape else np.broadcast_shapes(x.shape, y.shape)
    out = np.empty((*shape, 2))
    out[..., 0], out[..., 1] = x, y
    return out


def unit(angle: Array | float) -> Array:
    """(..., 2) unit vectors at an `angle` (...) [rad] from x."""
    return paired(np.cos(angle), np.sin(angle))


def left_of(vectors: Array) -> Array:
    """(..., 2) `vectors` (..., 2) turned a quarter to their left."""
    return paired(-vectors[..., 1], vectors[..., 0])


def rotated(xy: Array, angle: Array | float) -> Array:
    """Vectors `xy` (..., 2) turned counter-clockwise by `angle` (...) [rad]."""
    cos, sin, x, y = np.cos(angle), np.sin(angle), xy[..., 0], xy[..., 1]
    return paired(cos * x - sin * y, sin * x + cos * y)


Rest = Literal["straight", "unknown"]
# What of the beam its mass follows.
MassAlong = Literal["unknown", "even", "width", "thickness", "both", "section", "table"]
StiffnessAlong = Literal["unknown", "even", "section"]
SectionShapeName = Literal["rectangle", "circle", "tube", "hexagon", "second moment"]

POINT_ID = 100_000  # and a thousand times s: the ids of an outline's points, for no family has so many tags
END_ID = POINT_ID + 1000  # the body's end: of it the place along the body counts, of other points that across it
PLACE_SD = 2.5e-3  # m, along the beam, of a push placed by hand
GAIN_SD = 0.02  # of a force sensor's scale, where nobody states it
TURN_SD = math.radians(1.5)  # of a tag on the beam, put on by hand
GRAVITY_SD = math.radians(2.0)  # of the direction of gravity against the beam's axis, as a hand measures it
DIRECTION_SD = math.radians(1.0)  # of a force log's axes against the beam's, aligned by hand
CLAMP_SD = 3e-3  # rad, of the clamp's direction against the beam's own at rest
CURVATURE_SD = 0.15  # rad, Legendre states of a natural curvature
SCALE_SD = 3e-3  # of lengths in the picture of a camera that is not calibrated
UNKNOWN_ANGLE_SD = float(np.pi)  # rad, stands in a covariance for an angle that is not measured (and is NaN)


@dataclass(frozen=True)
class Remark:
    """Something a person should know about a recording or a fit, said in one sentence."""

    level: Literal["note", "warning"]
    text: str
    doubt: bool = False  # what is learned from the recording is then not to be relied on
    about: str = ""  # of a warning: a key of `sections.toml`
    share: float = 0.0  # of the force that may be wrong for it, and so of k(s)

    @property
    def docs(self) -> str:
        """Of a warning, where to read of it, as `troubleshooting.md#the-film-hung`; else ""."""
        return section(self.about) if self.level == "warning" else ""

    def as_dict(self) -> dict[str, str]:
        """For JSON: level and text, and of a warning where to read of it."""
        return {"level": self.level, "text": self.text} | ({"docs": self.docs} if self.docs else {})


@dataclass(frozen=True)
class Detections:
    """Corners of every expected tag in every video frame, in pixels.

    `corners[t, i]` runs counter-clockwise as printed on the tag, seen from the front, starting at the tag's
    bottom-left: bottom-left, bottom-right, top-right, top-left. Pixel centres are at whole numbers (OpenCV's
    convention). NaN where the tag was not seen, and in frames that were not searched.
    """

    time: Array  # (T,) s, the video's own clock, first frame at 0
    tag_id: IntArray  # (m+b,) base tags and beam tags, in the order of `recording.toml`
    corners: Array  # (T, m+b, 4, 2) px
    width: int  # px
    height: int  # px
    remarks: tuple[Remark, ...] = ()
    searched: BoolArray | None = None  # (T,) frames; None: all

    def of_searched(self) -> tuple[Detections, IntArray]:
        """The frames that were searched, and their numbers in the film."""
        if self.searched is None:
            return self, np.arange(len(self.time))
        kept = self.searched
        return replace(self, time=self.time[kept], corners=self.corners[kept], searched=None), np.flatnonzero(kept)


@dataclass(frozen=True)
class View:
    """How the camera sees the plane of the tags: a point (x, y) of the plane is at `rotation @ (x, y, 0) + translation`
    in the camera (x right, y down, z forward), and from there at a pixel through `matrix` and the lens `dist`."""

    matrix: Array  # (3, 3) px, pinhole
    dist: Array  # (5,) k1 k2 p1 p2 k3 (OpenCV)
    rotation: Array  # (3, 3)
    translation: Array  # (3,) m
    calibrated: bool  # False where focal length and lens were inferred from the tags themselves
    corner_sd: float  # px, one sd of a corner's coordinate, from the residuals
    # (m, 11) how each tag, those of the base first, is unlike a square in the plane: its height over the plane [m], its
    # slopes along its x and y axis [rad], and how far its corners are off, x and y of each [m]. Empty: like one.
    lying: Array = field(default_factory=lambda: np.zeros((0, 11)))


@dataclass(frozen=True)
class Markers:
    """Pose of every beam tag relative to the base tag, in metres and radians."""

    time: Array  # (T,) s, the video's own clock
    tag_id: IntArray  # (m,)
    s: Array  # (m,) nominal place along the beam
    xy: Array  # (T, m, 2) m, base tag's frame
    angle: Array  # (T, m) rad, continuous in time, 0 along the base tag's x axis; NaN where not measured
    covariance: Array  # (T, m, 3, 3) of (x, y, angle): m^2, m rad, rad^2
    base_angle: Array  # (T,) rad, turn of the base tag since the first frame (0 where the base stands still)
    view: View | None  # of the base tag's plane and frame (first frame, where the base moves); None for tracked markers
    remarks: tuple[Remark, ...] = ()
    by_camera: Array | None = None  # (T, m, 3, n) what one sd of each unknown of camera and plane does to all poses
    traced: BoolArray | None = None  # (m,) as `Observations.traced`
    width: Array | None = None  # (P, 2) as `Observations.width`


@dataclass(frozen=True)
class OutlineTrack:
    """Points of a body's centreline in T frames, in pixels (as `Detections`)."""

    s: Array  # (n,) places along the body, 0 at the clamp
    px: Array  # (T, n, 2) px; where the flanks were not seen, as the curve runs there
    ahead: Array  # (T, n, 2) px of a place a little farther along the curve
    sd: Array  # (T, n) px, one sd across the curve; NaN where the flanks were not seen
    remarks: tuple[Remark, ...] = ()
    width: Array | None = None  # (P, 2) as `Observations.width`


@dataclass(frozen=True)
class ForceLog:
    """A force log as it stands in its file: own clock, own axes, own sign."""

    time: Array  # (N,) s, rising
    force: Array  # (N, 2) N
    push_s: Array | None = None  # (N,) place of the push, where the log has such a column
    remarks: tuple[Remark, ...] = ()

    def rows(self, kept: BoolArray) -> ForceLog:
        """The log of some of its rows, `kept` (N,)."""
        push_s = None if self.push_s is None else self.push_s[kept]
        return replace(self, time=self.time[kept], force=self.force[kept], push_s=push_s)


@dataclass(frozen=True)
class ForceNoise:
    """The error of a force log: one sd of each of its independent parts, both axes alike. `recording.force_noise` has
    the covariance."""

    white: float  # N, of one sample: a row, or a frame
    coloured: float  # N, of an Ornstein-Uhlenbeck process
    tau: float  # s, its correlation time
    walk: float  # N / sqrt(s), of a random walk
    spacing: float = 0.0  # s, of the samples that `white` is one of (it averages down with wider ones)
    level: float = 0.0  # N, constant
    load: float = 0.0  # N, of what comes with the load: a constant of this sd, and as much that varies

    def passed(self, cutoff: float) -> float:
        """N, sd of the coloured part that an ideal low-pass at `cutoff` [Hz] lets through (its Lorentz spectrum)."""
        share = 1.0 if not np.isfinite(cutoff) else 2 / np.pi * np.arctan(2 * np.pi * cutoff * self.tau)
        return float(self.coloured * np.sqrt(share))


@dataclass(frozen=True)
class CleanForce:
    """The force on the beam after tare, outliers, filter and rotation; on the log's clock."""

    time: Array  # (N,) s
    force: Array  # (N, 2) N, on the beam, beam's frame
    push_s: Array | None  # (N,)
    noise_sd: Array  # (2,) N, sd of what the filter left in, per axis
    tare: Array  # (2,) N, what was taken off at the first contact (beam's frame)
    drift: Array  # (2,) N/s, slope of the tare between the rests before and after contact; NaN if only one rest exists
    cutoff: float  # Hz, of the zero-phase low-pass; infinity if none
    outliers: int  # rows replaced
    noise: ForceNoise | None = None  # of the log before the filter, where the clock search found it
    zero_time: Array = field(default_factory=lambda: np.zeros(0))  # (r,) s, of each rest's zero
    zero: Array = field(default_factory=lambda: np.zeros((0, 2)))  # (r, 2) N, taken off: straight in time between them
    remarks: tuple[Remark, ...] = ()


@dataclass(frozen=True)
class ClockOffset:
    """`log time = video time + offset`. A constant lag of the sensor cannot be separated from it and is part of it.

    An `sd` of 0: the offset was stated to be exact and was not searched.
    """

    offset: float  # s
    sd: float  # s
    stated: float  # s, as in `recording.toml`; NaN where it is not stated
    found: bool  # False where the data did not determine it, and `offset` is the stated one


@dataclass(frozen=True)
class KnownLoads:
    """What acts on the beam besides `Observations.force` and its own weight, known as well as that is."""

    force: Array  # (T, a, 2) N, beam's frame
    force_s: Array  # (T, a)
    moment: Array  # (T, b) N m, counter-clockwise
    moment_s: Array  # (T, b)


@dataclass(frozen=True)
class Readings:
    """How the points of static poses were read, where not each by itself, from the clamp and at a mark on the beam."""

    at: Literal["mark", "x"] = "mark"  # "x": a ruler stands where `Observations.xy` says, and y is of what passes there
    bare: int = -1  # the frame in which the readings were zeroed; -1: they count from the clamp
    error_length: float = 0.0  # m along the beam, over which errors of a pose are alike; 0: each point has its own


@dataclass(frozen=True)
class PointMass:
    """Something small that rides on the beam: a clip, a sensor."""

    s: float
    mass: float  # kg


@dataclass(frozen=True)
class MeasuredFrequency:
    """A natural frequency of the beam, clamped at its base and free otherwise, as it swings a little about rest."""

    frequency: float  # Hz, undamped
    sd: float  # Hz
    mode: int  # 1 is the slowest
    gravity: tuple[float, ...]  # (2,) m/s^2 in the beam's frame; zeros where it swings across gravity
    tip_mass: float = 0.0  # kg, fixed to the tip


@dataclass(frozen=True)
class MassLine:
    """Mass per metre, where it is known along the beam."""

    s: Array  # (P,) rising
    value: Array  # (P,) kg/m


@dataclass(frozen=True)
class StatedSection:
    """The beam's cross-section as measured, of one material. Between its places the sizes go straight, a place that
    stands twice is a step; beyond the first and the last of them nothing is known."""

    shape: SectionShapeName
    s: Array  # (P,) rising
    # (P,) m, in the plane of bending; of a circle or tube the outer diameter, of a hexagon the width across its flats;
    # NaN where only the second moment is known
    thickness: Array
    width: Array  # (P,) m, across that plane; where the shape is the same in all directions as `thickness`
    sd: float = math.nan  # m, one sd that all places of a size have in common; NaN: nobody says it
    inner: Array | None = None  # (P,) m, of a tube the inner diameter
    moment: Array | None = None  # (P,) m^4, where only the second moment is known
    moment_sd: float = math.nan  # one sd of its log, alike at all places; NaN: nobody says it


@dataclass(frozen=True)
class Stated:
    """What the experimenter states of the beam and the bench, and how exactly: the priors of what the fit may move.

    An `sd` is one standard deviation. NaN: nothing is stated, and the fit takes its usual value.
    """

    rest: Rest
    mass: float  # kg, NaN where unknown
    placement_sd: float  # m, tolerance of the tags' places
    mass_sd: float = math.nan  # one sd of a mass that was guessed, over itself
    weighed_sd: float = math.nan  # one sd of the mass that is written, over itself
    mass_line: MassLine | None = None  # None: the mass is evenly spread
    mass_along: MassAlong = "unknown"  # how it is spread, where somebody knows it
    # "even": somebody knows that k is one number; "section": that it goes with the second moment of `section`
    stiffness_along: StiffnessAlong = "unknown"
    modulus_varies: float = 0.0  # one sd of the slow variation of log k beside that
    turn_sd: float = TURN_SD  # rad, tolerance of the tags' turns
    place_sd: float = PLACE_SD  # m, tolerance of the push's place along the beam
    direction_sd: float = DIRECTION_SD  # rad, tolerance of the force log's axes against the beam's
    gravity_sd: float = GRAVITY_SD  # rad, tolerance of gravity's direction against the beam's x axis
    clamp_sd: float = math.nan  # rad, one sd of the clamp's direction (static: against x)
    curvature_sd: float = CURVATURE_SD  # rad, one sd of the Legendre states of q0; only where rest is "unknown"
    scale_sd: float = math.nan  # one sd of lengths in the picture
    gain_sd: float = 0.0  # of the force sensor's scale (0.02: 2 %); 0 without a force
    thickness: float = math.nan  # m, of the section in the plane of bending, mean along the beam
    tag_size: float = math.nan  # m, side of a tag's black square; NaN for markers that are no tags
    load_error_sd: float = math.nan  # N, of a force error that comes with the load; NaN: found by the fit
    section: StatedSection | None = None  # None: not measured, or not whole
    friction_sd: float = 0.0  # of the tool's coefficient of friction, where the log lacks the force along the beam
    rest_change_sd: float = 0.0  # rad, one sd of the Legendre states of q0 from recording to recording of one beam
    masses: tuple[PointMass, ...] = ()  # that ride on the beam, besides `mass`


@dataclass(frozen=True)
class Source:
    """Where observations come from: their files, and how camera, clock and force log were read."""

    name: str
    video: Path | None = None
    video_topic: str = ""  # where `video` is a bag
    view: View | None = None  # of the beam's plane and frame
    clock: ClockOffset | None = None  # between the force log and the video; None for static poses
    clean_force: CleanForce | None = None  # the log that `Observations.force` was read from
    remarks: tuple[Remark, ...] = ()
    place_seen: bool = False  # the film shows the tool where the push is said to act


@dataclass(frozen=True)
class FrameMeans:
    """What means of neighbouring frames no longer show of these."""

    count: IntArray  # (T,) frames of the film
    acceleration: Array | None  # (T, m, 2) m/s^2 of the tags; None where the film does not show it


@dataclass(frozen=True)
class ToolTrack:
    """Where the film shows the tool against the beam, in P frames."""

    time: Array  # (P,) s, as `Observations.time`
    s: Array  # (P,)
    sd: Array  # (P,) of s, of each frame by itself
    effects: Array  # (P, n) of s: what one sd of each of n errors that all frames share does

    @cached_property
    def root(self) -> Array:
        """(P, P) lower triangular factor of the covariance of `s`."""
        return np.asarray(np.linalg.cholesky(np.diag(self.sd**2) + self.effects @ self.effects.T))


@dataclass(frozen=True)
class Observations:
    """What a recording says, on one clock and in one frame: all that learning and validation need.

    Here stands what was measured; `stated` holds what the experimenter adds to it, `source` where it comes from.
    """

    source: Source
    stated: Stated
    length: float  # L, m
    time: Array  # (T,) s, the force log's clock
    frame: IntArray  # (T,) index in the video
    tag_id: IntArray  # (m,)
    marker_s: Array  # (m,) place along the beam
    xy: Array  # (T, m, 2) m, beam's frame
    angle: Array  # (T, m) rad, of the tag against the beam's x axis; NaN where not measured, as may be one coordinate
    covariance: Array  # (T, m, 3, 3)
    force: Array  # (T, 2) N, on the beam, beam's frame
    force_sd: Array  # (2,) N, one sd of the noise left in `force`
    push_s: Array  # (T,) place where the force acts
    loaded: BoolArray  # (T,) the beam is being pushed (contact found in the data)
    rest_xy: Array  # (m, 2) m, markers with no force on the beam
    rest_angle: Array  # (m,) rad
    rest_covariance: Array  # (m, 3, 3)
    gravity: Array  # (T, 2) m/s^2 in the beam's frame; zeros where it acts across the plane
    held: BoolArray | None = None  # (T,) the end s = 1 is held by an unknown force and moment; None: never
    known_loads: KnownLoads | None = None
    sd_known: bool = True  # the covariance is what was said or seen; False where it is a guess, to be estimated
    readings: Readings = Readings()
    static: bool = False  # bench poses: no order in time; loads that were weighed, known to `force_sd`, not logged
    pose_names: tuple[str, ...] | None = None  # (T,) where static
    # (T, m, 3, n) m, m, rad: what one sd of each of n unknowns of the camera and of the tags' plane does to the poses
    # of all frames together; not in `covariance`. None where there is no camera, or where it is in `covariance`.
    by_camera: Array | None = None
    frequencies: tuple[MeasuredFrequency, ...] = ()
    means: FrameMeans | None = None  # where the frames are means of several frames of the film
    # (m,) which are points of the body's outline and no tags: measured across the curve alone, whose direction there is
    # `angle`; their place along it is free. None: none
    traced: BoolArray | None = None
    tool: ToolTrack | None = None  # None: the film does not show it reliably
    width: Array | None = None  # (P, 2) places s and the body's width there [m], by its outline; None: not seen


def tags_among(seen: Markers | Observations) -> BoolArray:
    """(m,) which of the markers are tags, and no points of an outline."""
    return np.ones(seen.xy.shape[1], dtype=bool) if seen.traced is None else ~seen.traced


def marker_words(number: int, s: float) -> str:
    """A tag by its id in `recording.toml`, a point of the outline by its place."""
    if number == END_ID:
        return "the body's end"
    return f"tag {number}" if number < POINT_ID else f"the outline at s = {s:.2g}"


FEW = 6  # points of an outline that are read where there are no tags


def read_before_fit(seen: Markers | Observations) -> IntArray:
    """The markers that everything but the fit reads: the tags, or some points of the outline where there are none."""
    tags, m = np.flatnonzero(tags_among(seen)), int(np.sum(seen.tag_id != END_ID))  # which is the last
    if len(tags) or m <= FEW:
        return tags if len(tags) else np.arange(m)
    return np.linspace(0, m - 1, FEW + 1).round().astype(np.int64)[1:]


def of_markers(markers: Markers, kept: IntArray) -> Markers:
    """Some of the markers, in this order."""
    if np.array_equal(kept, np.arange(len(markers.s))):
        return markers
    every = {name: getattr(markers, name)[:, kept] for name in ("xy", "angle", "covariance")}
    by_camera = None if markers.by_camera is None else markers.by_camera[:, kept]
    traced = None if markers.traced is None else markers.traced[kept]
    return replace(markers, tag_id=markers.tag_id[kept], s=markers.s[kept], by_camera=by_camera, traced=traced, **every)


def covariance_with_camera(seen: Markers | Observations) -> Array:
    """(T, m, 3, 3) of the poses, what all frames share by the camera counted as noise of each."""
    if seen.by_camera is None:
        return seen.covariance
    return np.asarray(seen.covariance + seen.by_camera @ np.swapaxes(seen.by_camera, -1, -2))
