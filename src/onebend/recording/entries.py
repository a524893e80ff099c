"""What `recording.toml` may say: one frozen record a table. The schema is documented in docs/recording.md.

In the file every key carries its unit and angles are in degrees; in these records everything is SI and radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan, pi, radians
from pathlib import Path
from typing import Literal

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

    s: float = key("s", PLACE)
    mass: float = key("mass_kg", MASS)


@dataclass(frozen=True)
class BeamEntry:
    """[beam]: what is known of the beam."""

    length: float = key("length_m", LENGTH)
    mass: float = key("mass_kg", MASS, nan)
    mass_sd: float = key("mass_sd_kg", MASS_SD, nan)
    mass_file: Path | None = key("mass_file", text, None)
    stiffness_along: StiffnessAlong = key("stiffness_along", one_of("unknown", "even", "section"), "unknown")
    modulus_varies: float = key("modulus_varies", SHARE, 0.0)
    mass_along: MassAlong = key(
        "mass_along", one_of("unknown", "even", "width", "thickness", "both", "section", "table"), "unknown"
    )
    width: float = key("width_m", LENGTH, nan)
    thickness: float = key("thickness_m", LENGTH, nan)
    diameter: float = key("diameter_m", LENGTH, nan)
    inner_diameter: float = key("inner_diameter_m", LENGTH, nan)
    across_flats: float = key("across_flats_m", LENGTH, nan)
    section_file: Path | None = key("section_file", text, None)
    section_sd: float = key("section_sd_m", number(least=0, most=LONGEST), nan)
    moment_sd: float = key("I_sd", SHARE, nan)
    rest: Rest = key("rest", one_of("straight", "unknown"), "unknown")
    curvature_sd: float = key("rest_curvature_sd_deg", ANGLE_SD, CURVATURE_SD)  # rad
    rest_change_sd: float = key("rest_change_sd_deg", ANGLE_SD, 0.0)  # rad
    masses: tuple[MassEntry, ...] = ()


@dataclass(frozen=True)
class CameraEntry:
    """[camera]: a pinhole camera with OpenCV's lens model, as calibrated."""

    width: int = key("width", whole(least=1))
    height: int = key("height", whole(least=1))
    fx: float = key("fx", number(least=10))
    fy: float = key("fy", number(least=10))
    cx: float = key("cx", number())
    cy: float = key("cy", number())
    dist: tuple[float, ...] = key("dist", several(number(), 4, 5))
    scale_sd: float = key("scale_sd", SD, nan)


@dataclass(frozen=True)
class UncalibratedEntry:
    """[camera] where it says of the pictures' scale alone, and holds no calibration."""

    scale_sd: float = key("scale_sd", SD, nan)


@dataclass(frozen=True)
class CameraInfoEntry:
    """[camera] where the film's bag holds the calibration."""

    topic: str = key("camera_info", text, "")
    scale_sd: float = key("scale_sd", SD, nan)


@dataclass(frozen=True)
class VideoEntry:
    """[video]: the film and its clock."""

    file: Path = key("file", text)
    fps: float = key("fps", POSITIVE, nan)
    frame_times: Path | Literal["container"] = key("frame_times", text, "container")
    topic: str = key("topic", text, "")
    start: float = key("start_s", number(), nan)
    start_uncertainty: float = key("start_uncertainty_s", DOUBT, 2.0)  # s; infinity where start_s is not given
    clamp_sd: float = key("clamp_sd_deg", ANGLE_SD, nan)  # rad


@dataclass(frozen=True)
class MarkersEntry:
    """[markers]: where a tracker saw the markers, and its clock."""

    file: Path = key("file", text)
    start: float = key("start_s", number(), nan)
    start_uncertainty: float = key("start_uncertainty_s", DOUBT, 2.0)  # s; infinity where start_s is not given
    sd: float = key("sd_m", POSITIVE, nan)
    clamp: tuple[float, ...] = key("clamp_m", several(number(), 2, 3), ())
    x_axis: tuple[float, ...] = key("x_axis", several(number(), 2, 3), ())
    seen_from: tuple[float, ...] = key("seen_from", several(number(), 3), (0.0, 0.0, 1.0))
    clamp_sd: float = key("clamp_sd_deg", ANGLE_SD, nan)  # rad


@dataclass(frozen=True)
class PosesEntry:
    """[poses]: static poses measured by hand, and what loaded the beam in each."""

    file: Path = key("file", text)
    loads: Path = key("loads", text)
    axes: Axes = key("axes", one_of("beam", "room"), "beam")
    sd: float = key("sd_m", POSITIVE, nan)
    error_length: float = key("error_length_m", SD, 0.0)
    read_at: Literal["mark", "x"] = key("read_at", one_of("mark", "x"), "mark")
    relative_to: str = key("relative_to", text, "")
    load_sd: float = key("load_sd_N", SD, 0.0)
    clamp_sd: float = key("clamp_sd_deg", ANGLE_SD, radians(0.2))  # rad


@dataclass(frozen=True)
class PhotosEntry:
    """[photos]: stills of the body or of tags on it, one a static pose, and what loaded the beam in each."""

    folder: Path = key("folder", text)
    loads: Path = key("loads", text)
    axes: Axes = key("axes", one_of("beam", "room"), "beam")
    clicks: Path | None = key("clicks", text, None)
    camera_moves: bool = key("camera_moves", flag, False)
    load_sd: float = key("load_sd_N", SD, 0.0)
    clamp_sd: float = key("clamp_sd_deg", ANGLE_SD, nan)  # rad


@dataclass(frozen=True)
class FrequencyEntry:
    """One natural frequency of the clamped beam, its other end free."""

    hz: float = key("hz", POSITIVE)
    sd: float = key("sd_hz", POSITIVE)
    mode: int = key("mode", whole(least=1))
    base_angle: float = key("base_angle_deg", ANGLE, nan)  # rad
    damping_ratio: float = key("damping_ratio", number(least=0, most=0.7), 0.0)
    tip_mass: float = key("tip_mass_kg", SD, 0.0)


@dataclass(frozen=True)
class TagEntry:
    """One tag: where it sits and how it is turned."""

    id: int = key("id", whole(least=0))
    s: float = key("s", PLACE)
    turn: float = key("turn_deg", ANGLE, 0.0)  # rad


@dataclass(frozen=True)
class TagsEntry:
    """[tags]: the printed tags and where they sit."""

    size: float = key("size_m", POSITIVE, nan)
    family: str = key("family", one_of(*FAMILIES), FAMILIES[0])
    placement_sd: float = key("placement_sd_m", SD, DEFAULT_PLACEMENT_SD)
    turn_sd: float = key("turn_sd_deg", ANGLE_SD, TURN_SD)  # rad
    on_base: tuple[TagEntry, ...] = ()  # at least one where a camera looks; the first is the origin
    on_beam: tuple[TagEntry, ...] = ()  # at least one, but in a film that shows the body's outline


@dataclass(frozen=True)
class OutlineEntry:
    """[outline]: the body's own edges in the film, beside its tags or without any; the table may be missing."""

    use: bool = key("use", flag, True)
    width: float = key("width_m", POSITIVE, nan)


@dataclass(frozen=True)
class ForceEntry:
    """[force]: the force log, and what is known of its sensor."""

    file: Path = key("file", text)
    columns: tuple[str, str, str] = key("columns", several(text, 3), ("time_s", "fx_N", "fy_N"))
    time_unit: Literal["s", "ms", "us", "ns"] = key("time_unit", one_of("s", "ms", "us", "ns"), "s")
    topic: str = key("topic", text, "")
    field: str = key("field", text, "")
    axes: tuple[str, str] = key("axes", several(one_of("x", "y", "z", "-x", "-y", "-z"), 2), ("x", "y"))
    rotation: float = key("rotation_deg", ANGLE, 0.0)  # rad
    rotation_sd: float = key("rotation_sd_deg", ANGLE_SD, DIRECTION_SD)  # rad
    acts_on: Literal["beam", "robot"] = key("acts_on", one_of("beam", "robot"), "beam")
    sensor: str = key("sensor", text, "")
    zeroed: bool = key("zeroed", flag, False)
    gain_sd: float = key("gain_sd", SD, GAIN_SD)
    white_sd: float = key("white_sd_N", SD, nan)
    bias_sd: float = key("bias_sd_N", SD, nan)


@dataclass(frozen=True)
class PushEntry:
    """[push]: where the force acts; a place, or the name of a column of the force log that gives it."""

    at: float = key("at_s", number(above=0, most=1), nan)
    column: str = key("column", text, "")
    at_sd: float = key("at_sd_m", SD, PLACE_SD)
    friction_sd: float = key("friction_sd", SD, 0.0)


@dataclass(frozen=True)
class GravityEntry:
    """[gravity]: the weight acts in the plane of bending; angles counter-clockwise from horizontal, as the camera
    sees."""

    direction: float = key("direction_deg", ANGLE)  # rad
    magnitude: float = key("magnitude_m_s2", number(least=0, most=100), 9.81)
    base_angle: float = key("base_angle_deg", ANGLE, nan)  # rad
    base_angle_file: Path | None = key("base_angle_file", text, None)
    direction_sd: float = key("direction_sd_deg", ANGLE_SD, GRAVITY_SD)  # rad


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
