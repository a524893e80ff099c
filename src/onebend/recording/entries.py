"""What `recording.toml` may say: one frozen record a table. The schema is documented in docs/recording.md.

In the file every key carries its unit and angles are in degrees; in these records everything is SI and radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan, pi, radians
from pathlib import Path
from typing import Any, Literal

from onebend.recording.schema import flag, key, number, one_of, several, text, whole
from onebend.records import (
    CURVATURE_SD,
    DIRECTION_SD,
    GAIN_SD,
    GRAVITY_SD,
    PLACE_SD,
    TURN_SD,
    MassAlong,
    Remark,
    Rest,
    StiffnessAlong,
)

# ruff: noqa: RUF009  (key() returns a dataclass field, which is what a default may be)

LONGEST = 50.0  # m: a beam of 150 mm that was written in millimetres is longer
HEAVIEST = 1000.0  # kg
LENGTH, MASS, MASS_SD = number(above=0, most=LONGEST), number(above=0, most=HEAVIEST), number(least=0, most=HEAVIEST)
POSITIVE, PLACE, SD, SHARE = number(above=0), number(least=0, most=1), number(least=0), number(least=0, most=2.0)
ANGLE, ANGLE_SD = number(scale=pi / 180), number(least=0, scale=pi / 180)  # degrees in the file, radians here
DOUBT = number(least=0, most=1e5)  # s: whose start is known to a day is not known
MOST_FREQUENCIES = 100
MOST_MODE = 8  # beyond, a beam is no slender one any more
FAMILY_SIZES = {"tag36h11": 587, "tag25h9": 35, "tag16h5": 30, "tagCircle21h7": 38, "tagStandard41h12": 2115}
FAMILIES = tuple(FAMILY_SIZES)
MOST_TAGS = 100  # of one recording
DEFAULT_PLACEMENT_SD = 0.0005  # m, a tag put on by hand with a ruler
Axes = Literal["beam", "room"]


@dataclass(frozen=True)
class MassEntry:
    """[[beam.masses]]: something small that rides on the beam."""

    s: float = key("s = 0.5", PLACE, "its place along the beam, 0 at the clamp, 1 at the tip")
    mass: float = key("mass_kg = 0.004", MASS, "its mass, kg")


@dataclass(frozen=True)
class BeamEntry:
    """[beam]: what is known of the beam."""

    length: float = key("length_m = 0.15", LENGTH, "the beam's length from clamp to tip, m")
    mass: float = key("mass_kg = 0.075", MASS, "the beam's mass, kg", nan)
    mass_sd: float = key("mass_sd_kg = 0.0001", MASS_SD, "how exactly that mass is known (one sd), kg; 0: exact", nan)
    mass_file: Path | None = key(
        'mass_file = "mass.csv"',
        text,
        "a table with columns s and kg_per_m: the mass per metre, where it is not even",
        None,
    )
    stiffness_along: StiffnessAlong = key(
        'stiffness_along = "even"',
        one_of("unknown", "even", "section"),
        'what is known of how k varies: "even" where it is one number (one section and material), as the "section" '
        'varies (one modulus times its I), or "unknown"',
        "unknown",
    )
    modulus_varies: float = key(
        "modulus_varies = 0.1",
        SHARE,
        "how far the modulus may vary slowly along such a beam (one sd, 0.1 = 10 %); 0: not at all",
        0.0,
    )
    mass_along: MassAlong = key(
        'mass_along = "even"',
        one_of("unknown", "even", "width", "thickness", "both", "section", "table"),
        'what is known of how the mass is spread: "even", as the beam\'s "width", "thickness" or "both" vary, as the '
        'area of its "section" (with mass_kg), as the "table" in mass_file, or "unknown"',
        "unknown",
    )
    width: float = key(
        "width_m = 0.02", LENGTH, "the beam's size across the bending axis (in the plane of bending), m", nan
    )
    thickness: float = key("thickness_m = 0.03", LENGTH, "the beam's size along the bending axis, m", nan)
    diameter: float = key("diameter_m = 0.012", LENGTH, "the diameter of a round beam, in place of the two, m", nan)
    inner_diameter: float = key(
        "inner_diameter_m = 0.010", LENGTH, "the inner diameter of a tube, beside diameter_m, m", nan
    )
    across_flats: float = key(
        "across_flats_m = 0.006",
        LENGTH,
        "the width of a hexagonal beam across its flats, in place of the others, m",
        nan,
    )
    section_file: Path | None = key(
        'section_file = "section.csv"',
        text,
        "a table with columns s and width_m, thickness_m, diameter_m, inner_diameter_m or across_flats_m: the sizes "
        "that vary along the beam; or s and I_m4, the section's second moment",
        None,
    )
    section_sd: float = key(
        "section_sd_m = 0.0001",
        number(least=0, most=LONGEST),
        "how far off these sizes may be (one sd), m; 0: exact",
        nan,
    )
    moment_sd: float = key(
        "I_sd = 0.05", SHARE, "how far off I_m4 may be, alike at all places (one sd, 0.05 = 5 %); 0: exact", nan
    )
    rest: Rest = key(
        'rest = "unknown"',
        one_of("straight", "unknown"),
        'its shape with no force on it: "unknown" where it may be curved; "straight" states that it is not',
        "unknown",
    )
    curvature_sd: float = key(
        "rest_curvature_sd_deg = 8.6",
        ANGLE_SD,
        'how far it may be turned from clamp to tip by its own curvature, where rest = "unknown" (one standard '
        "deviation), degrees; 0: straight",
        CURVATURE_SD,
    )  # rad
    rest_change_sd: float = key(
        "rest_change_sd_deg = 2.0",
        ANGLE_SD,
        "how far this turn may change from one recording of the beam to the next, "
        "as where it takes a set (one sd), degrees; 0: all have one shape at rest",
        0.0,
    )  # rad
    masses: tuple[MassEntry, ...] = ()


def load_sd() -> Any:
    """The key `load_sd_N`, where loads are weighed."""
    says = "how exactly the loads are known (one sd), N"
    return key("load_sd_N = 0.001", SD, says, 0.0)


def clamp_sd(default: float) -> Any:
    """The key `clamp_sd_deg`, kept in rad, where nothing shows the clamp's direction but the pose itself."""
    says = "how exactly the clamp's angle is known (one sd), degrees"
    return key("clamp_sd_deg = 1.0", ANGLE_SD, says, default)


def clamp_turn_sd() -> Any:
    """The key `clamp_sd_deg`, kept in rad, where the beam is seen at rest; NaN: as usual."""
    says = "how far the clamp may be turned against the beam at rest (one sd), degrees; 0: not at all"
    return key("clamp_sd_deg = 0.17", ANGLE_SD, says, nan)


def scale_sd() -> Any:
    """The key `scale_sd`; NaN: as usual."""
    says = "how far off lengths in the picture may be (one sd, 0.003 = 0.3 %); 0: exact"
    return key("scale_sd = 0.003", SD, says, nan)


@dataclass(frozen=True)
class CameraEntry:
    """[camera]: a pinhole camera with OpenCV's lens model, as calibrated."""

    width: int = key("width = 1280", whole(least=1), "the picture's width in the calibration, px")
    height: int = key("height = 720", whole(least=1), "the picture's height in the calibration, px")
    fx: float = key("fx = 1200.0", number(least=10), "the focal length along x, px")
    fy: float = key("fy = 1200.0", number(least=10), "the focal length along y, px")
    cx: float = key("cx = 639.5", number(), "the principal point's x, px (pixel centres at whole numbers)")
    cy: float = key("cy = 359.5", number(), "the principal point's y, px (pixel centres at whole numbers)")
    dist: tuple[float, ...] = key(
        "dist = [0.0, 0.0, 0.0, 0.0]",
        several(number(), 4, 5),
        "the lens: k1, k2, p1, p2 and, if known, k3, as OpenCV calibrates it",
    )
    scale_sd: float = scale_sd()


@dataclass(frozen=True)
class UncalibratedEntry:
    """[camera] where it says of the pictures' scale alone, and holds no calibration."""

    scale_sd: float = scale_sd()


@dataclass(frozen=True)
class CameraInfoEntry:
    """[camera] where the film's bag holds the calibration."""

    topic: str = key(
        'camera_info = "/camera/camera_info"',
        text,
        "instead of all these but scale_sd: the topic of the calibration in the bag of [video]",
        "",
    )
    scale_sd: float = scale_sd()


@dataclass(frozen=True)
class VideoEntry:
    """[video]: the film and its clock."""

    file: Path = key('file = "video.mp4"', text, "the video file or a bag, relative to this folder")
    fps: float = key("fps = 30", POSITIVE, "the frame rate, only checked against the file's own", nan)
    frame_times: Path | Literal["container"] = key(
        'frame_times = "container"',
        text,
        '"container" for the times in the video file, or a CSV file with a column time_s, one row a frame',
        "container",
    )
    topic: str = key('topic = "/camera/image_raw"', text, "the image topic, where file is a bag", "")
    start: float = key("start_s = 0.0", number(), "the time of the first frame on the force log's clock, s", nan)
    start_uncertainty: float = key(
        "start_uncertainty_s = 2.0",
        DOUBT,
        "how far off start_s may be (its largest error), s; 0: exact, nothing is looked for",
        2.0,
    )  # s; infinity where start_s is not given
    clamp_sd: float = clamp_turn_sd()  # rad


@dataclass(frozen=True)
class MarkersEntry:
    """[markers]: where a tracker saw the markers, and its clock."""

    file: Path = key(
        'file = "markers.csv"',
        text,
        "a CSV table with columns time_s, id (of a curve order), x_m, y_m and, where known, z_m, angle_rad, sd_m",
    )
    start: float = key("start_s = 0.0", number(), "what to add to the tracker's time to get the force log's, s", nan)
    start_uncertainty: float = key(
        "start_uncertainty_s = 0.0",
        DOUBT,
        "how far off start_s may be (its largest error), s; 0: one clock for both",
        2.0,
    )  # s; infinity where start_s is not given
    sd: float = key(
        "sd_m = 0.0001",
        POSITIVE,
        "the noise of a coordinate (one sd) where the table has no column sd_m, m; else taken from the tracks",
        nan,
    )
    clamp: tuple[float, ...] = key(
        "clamp_m = [0.0, 0.0]",
        several(number(), 2, 3),
        "the clamp's place in the tracker's axes, m; else from the base markers or the beam at rest",
        (),
    )
    x_axis: tuple[float, ...] = key(
        "x_axis = [1.0, 0.0]",
        several(number(), 2, 3),
        "the beam's direction at the clamp in the tracker's axes; else from the base markers' angle or the rest",
        (),
    )
    seen_from: tuple[float, ...] = key(
        "seen_from = [0.0, 0.0, 1.0]",
        several(number(), 3),
        "from which side one looks at the plane of bending, in the tracker's axes (3-D tracks)",
        (0.0, 0.0, 1.0),
    )
    clamp_sd: float = clamp_turn_sd()  # rad


@dataclass(frozen=True)
class PosesEntry:
    """[poses]: static poses measured by hand, and what loaded the beam in each."""

    file: Path = key(
        'file = "poses.csv"',
        text,
        "a CSV table with columns pose, id (of a curve order), y_m and, where known, x_m, angle_deg, sd_m; "
        "one row a point",
    )
    loads: Path = key(
        'loads = "loads.csv"',
        text,
        "a table with columns pose, s and any of weight_N, mass_kg, fx_N, fy_N, moment_N_m, clamp_deg; one row a load",
    )
    axes: Axes = key(
        'axes = "room"',
        one_of("beam", "room"),
        'the axes of points and forces: "beam" (x along it at the clamp) or "room" (x horizontal, y up); both from '
        "the clamp",
        "beam",
    )
    sd: float = key(
        "sd_m = 0.001", POSITIVE, "how exactly a point was measured (one sd), m; else estimated from the fit", nan
    )
    error_length: float = key(
        "error_length_m = 0.1",
        SD,
        "the way along the beam over which the points' errors are alike (half of their correlation is left), m; "
        "0: each point has its own",
        0.0,
    )
    read_at: Literal["mark", "x"] = key(
        'read_at = "x"',
        one_of("mark", "x"),
        'where y_m is read: at the "mark" on the beam, wherever it goes, or "x": a ruler or gauge stands at x_m, and '
        "the beam slides along beneath it",
        "mark",
    )
    relative_to: str = key(
        'relative_to = "bare"',
        text,
        "the pose in which the gauges were zeroed, by its name in the table of loads: all readings count from there",
        "",
    )
    load_sd: float = load_sd()
    clamp_sd: float = clamp_sd(radians(0.2))  # rad


@dataclass(frozen=True)
class PhotosEntry:
    """[photos]: stills of the body or of tags on it, one a static pose, and what loaded the beam in each."""

    folder: Path = key('folder = "photos"', text, "the folder with the pictures, relative to this one")
    loads: Path = key(
        'loads = "loads.csv"', text, "a table as for [poses], whose column pose holds the pictures' file names"
    )
    axes: Axes = key(
        'axes = "room"',
        one_of("beam", "room"),
        'the axes of the forces: "beam" (x along it at the clamp) or "room" (x horizontal, y up)',
        "beam",
    )
    clicks: Path | None = key(
        'clicks = "clicks.csv"',
        text,
        "without tags on the body: a table with columns pose, x_px, y_px of two or more points along the middle of the "
        "body in each picture, from the clamp to the tip; and s of the last, where it is not the tip",
        None,
    )
    camera_moves: bool = key("camera_moves = false", flag, "whether the camera was moved between the pictures", False)
    load_sd: float = load_sd()
    clamp_sd: float = clamp_sd(nan)  # rad


@dataclass(frozen=True)
class FrequencyEntry:
    """One natural frequency of the clamped beam, its other end free."""

    hz: float = key("hz = 3.21", POSITIVE, "the frequency of the free swing, Hz")
    sd: float = key("sd_hz = 0.01", POSITIVE, "how exactly it is known (one sd), Hz")
    mode: int = key("mode = 1", whole(least=1), "which of the beam's frequencies it is, 1 the slowest")
    base_angle: float = key(
        "base_angle_deg = -90.0",
        ANGLE,
        "the beam's x axis in the room, degrees: -90 hangs, 90 stands, 0 lies; none: it swings across gravity",
        nan,
    )  # rad
    damping_ratio: float = key(
        "damping_ratio = 0.02",
        number(least=0, most=0.7),
        "of this swing, which makes it slower by sqrt(1 - ratio^2)",
        0.0,
    )
    tip_mass: float = key("tip_mass_kg = 0.010", SD, "a small mass fixed to the tip, kg", 0.0)


@dataclass(frozen=True)
class TagEntry:
    """One tag: where it sits and how it is turned."""

    id: int = key("id = 1", whole(least=0), "the number of the tag")
    s: float = key(
        "s = 1.0", PLACE, "its place along the beam, 0 at the clamp, 1 at the tip; on the base 0 if left out"
    )
    turn: float = key(
        "turn_deg = 0",
        ANGLE,
        "its printed right-hand side against the beam's direction, counter-clockwise as the camera sees it, degrees",
        0.0,
    )  # rad


@dataclass(frozen=True)
class TagsEntry:
    """[tags]: the printed tags and where they sit."""

    size: float = key("size_m = 0.012", POSITIVE, "the side of the tag's black square, m", nan)
    family: str = key('family = "tag36h11"', one_of(*FAMILIES), "the AprilTag family", FAMILIES[0])
    placement_sd: float = key(
        f"placement_sd_m = {DEFAULT_PLACEMENT_SD}",
        SD,
        "how far off its written place a tag may sit (one sd), m; 0: exact",
        DEFAULT_PLACEMENT_SD,
    )
    turn_sd: float = key(
        "turn_sd_deg = 1.5", ANGLE_SD, "how far off its written turn a tag may be (one sd), degrees; 0: exact", TURN_SD
    )  # rad
    on_base: tuple[TagEntry, ...] = ()  # at least one where a camera looks; the first is the origin
    on_beam: tuple[TagEntry, ...] = ()  # at least one, but in a film that shows the body's outline


@dataclass(frozen=True)
class OutlineEntry:
    """[outline]: the body's own edges in the film, beside its tags or without any; the table may be missing."""

    use: bool = key("use = true", flag, "whether the edges are looked for", True)
    width: float = key(
        "width_m = 0.015", POSITIVE, "the body's width in the picture near the clamp, m; else found", nan
    )


@dataclass(frozen=True)
class ForceEntry:
    """[force]: the force log, and what is known of its sensor."""

    file: Path = key('file = "force.csv"', text, "the force log, a CSV file or a bag, relative to this folder")
    columns: tuple[str, str, str] = key(
        'columns = ["time_s", "fx_N", "fy_N"]',
        several(text, 3),
        "the columns with the time [s] and the two forces [N]",
        ("time_s", "fx_N", "fy_N"),
    )
    time_unit: Literal["s", "ms", "us", "ns"] = key(
        'time_unit = "s"', one_of("s", "ms", "us", "ns"), "the unit of the column with the time", "s"
    )
    topic: str = key('topic = "/wrench"', text, "the force's topic, where file is a bag", "")
    field: str = key(
        'field = "wrench.force"',
        text,
        "where the force stands in the topic's messages; known for wrenches and Franka's states",
        "",
    )
    axes: tuple[str, str] = key(
        'axes = ["x", "y"]',
        several(one_of("x", "y", "z", "-x", "-y", "-z"), 2),
        "the two axes of the bag's forces that span the plane of bending, in the order of x and y",
        ("x", "y"),
    )
    rotation: float = key(
        "rotation_deg = 0.0",
        ANGLE,
        "the log's x axis against the beam's, counter-clockwise as the camera sees it, degrees",
        0.0,
    )  # rad
    rotation_sd: float = key(
        "rotation_sd_deg = 1.0", ANGLE_SD, "how far off rotation_deg may be (one sd), degrees; 0: exact", DIRECTION_SD
    )  # rad
    acts_on: Literal["beam", "robot"] = key(
        'acts_on = "beam"',
        one_of("beam", "robot"),
        'whose force is logged: the one on the "beam", or the reaction on the "robot"',
        "beam",
    )
    sensor: str = key('sensor = "franka-estimate"', text, "the sensor's name", "")
    zeroed: bool = key("zeroed = false", flag, "whether it was zeroed just before the push", False)
    gain_sd: float = key("gain_sd = 0.02", SD, "the sensor's scale error (one sd, 0.02 = 2 %); 0: exact", GAIN_SD)
    white_sd: float = key(
        "white_sd_N = 0.03", SD, "the sensor's noise at rest (one sd), N; compared with the log's own", nan
    )
    bias_sd: float = key(
        "bias_sd_N = 0.2", SD, "the sensor's error under load that no rest shows (one sd), N; 0: none", nan
    )


@dataclass(frozen=True)
class PushEntry:
    """[push]: where the force acts; a place, or the name of a column of the force log that gives it."""

    at: float = key("at_s = 1.0", number(above=0, most=1), "where the force acts, 0 at the clamp, 1 at the tip", nan)
    column: str = key('column = "push_s"', text, "the force log's column that gives the place of the push", "")
    at_sd: float = key(
        "at_sd_m = 0.0025",
        SD,
        "how far off that place the force may act along the beam (one sd), m; 0: exact",
        PLACE_SD,
    )
    friction_sd: float = key(
        "friction_sd = 0.3",
        SD,
        "the tool rubs and the log lacks the force along the beam, as of a sensor with one axis: coefficient of "
        "friction (one sd); 0: no such force",
        0.0,
    )


@dataclass(frozen=True)
class GravityEntry:
    """[gravity]: the weight acts in the plane of bending; angles counter-clockwise from horizontal, as the camera
    sees."""

    direction: float = key("direction_deg = -90.0", ANGLE, "where it pulls, in the room, degrees")  # rad
    magnitude: float = key(
        "magnitude_m_s2 = 9.81", number(least=0, most=100), "the acceleration of gravity, m/s^2", 9.81
    )
    base_angle: float = key("base_angle_deg = 0.0", ANGLE, "the beam's x axis in the room, degrees", nan)  # rad
    base_angle_file: Path | None = key(
        'base_angle_file = "base_angle.csv"',
        text,
        "a CSV file with columns time_s (the force log's clock) and base_deg",
        None,
    )
    direction_sd: float = key(
        "direction_sd_deg = 2.0",
        ANGLE_SD,
        "how far off gravity's direction against the beam's x axis may be (one sd), degrees; 0: exact",
        GRAVITY_SD,
    )  # rad


@dataclass(frozen=True)
class Recording:
    """A recording as it stands on disk: checked, in SI and radians, with every path made whole."""

    folder: Path
    name: str
    beam: BeamEntry
    tags: TagsEntry
    camera: CameraEntry | None
    video: VideoEntry | None  # one of this and the three sources at the end
    force: ForceEntry | None
    push: PushEntry | None
    gravity: GravityEntry | None
    remarks: tuple[Remark, ...] = ()
    markers: MarkersEntry | None = None
    poses: PosesEntry | None = None
    photos: PhotosEntry | None = None
    outline: OutlineEntry | None = None
    frequencies: tuple[FrequencyEntry, ...] = ()  # beside one of these, or alone
    scale_sd: float = nan  # of lengths in the picture; NaN: as usual

    @property
    def only_frequencies(self) -> bool:
        """Whether nothing shows the beam but how fast it swings."""
        return all(source is None for source in (self.video, self.markers, self.poses, self.photos))

    @property
    def traces_outline(self) -> bool:
        """Whether the body's outline is to be read from the film or the photos."""
        if self.photos is not None:
            return not self.tags.on_beam
        if self.video is None:
            return False
        return self.outline is None or self.outline.use

    @property
    def start(self) -> tuple[float, float]:
        """s: what the film's (or the tracker's) clock lacks to the log's as written, and its largest error."""
        source = self.video or self.markers
        return (source.start, source.start_uncertainty) if source is not None else (nan, inf)

    @property
    def clamp_sd(self) -> float:
        """rad, as stated of the clamp's direction where the beam is seen at rest; NaN: as usual."""
        source = self.video or self.markers
        return nan if source is None else source.clamp_sd

    @property
    def place_sd(self) -> float:
        """m, tolerance of the push's place along the beam."""
        return PLACE_SD if self.push is None else self.push.at_sd

    @property
    def direction_sd(self) -> float:
        """rad, tolerance of the force log's axes against the beam's."""
        return DIRECTION_SD if self.force is None else self.force.rotation_sd
