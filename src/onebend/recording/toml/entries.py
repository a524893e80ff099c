# ruff: noqa: RUF009  (key() returns a dataclass field, which is what a default may be)
"""What `recording.toml` may say: one frozen record a table. The schema is documented in docs/recording.md.

In the file every key carries its unit and angles are in degrees; in these records everything is SI and radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from onebend.recording.toml.beam_entry import BeamEntry
from onebend.recording.toml.frequency_entry import FrequencyEntry
from onebend.recording.toml.schema import degrees, flag, key, number, one_of, several, text, whole
from onebend.recording.toml.source_entries import (
    CameraEntry,
    Damaged,
    MarkersEntry,
    PhotosEntry,
    PosesEntry,
    VideoEntry,
    damaged_bag,
    message_definitions,
)
from onebend.records import DIRECTION_SD, GAIN_SD, GRAVITY_SD, PLACE_SD, TURN_SD, Remark

FAMILY_SIZES = {"tag36h11": 587, "tag25h9": 35, "tag16h5": 30, "tagCircle21h7": 38, "tagStandard41h12": 2115}
FAMILIES = tuple(FAMILY_SIZES)
MOST_TAGS = 100  # of one recording
DEFAULT_PLACEMENT_SD = 0.0005  # m, a tag put on by hand with a ruler


@dataclass(frozen=True)
class TagEntry:
    """One tag: where it sits and how it is turned."""

    id: int = key("id", whole(least=0), "the number of the tag", example="1")
    s: float = key(
        "s", number(least=0, most=1), "its place along the beam, 0 at the clamp, 1 at the tip", example="1.0"
    )
    turn: float = key(
        "turn_deg",
        degrees(),
        "its printed right-hand side against the beam's direction, counter-clockwise as the camera sees it, degrees",
        example="0",
        default=0.0,
    )  # rad


@dataclass(frozen=True)
class TagsEntry:
    """[tags]: the printed tags and where they sit."""

    size: float = key(
        "size_m", number(above=0), "the side of the tag's black square, m", example="0.012", default=math.nan
    )
    family: str = key("family", one_of(*FAMILIES), "the AprilTag family", example='"tag36h11"', default=FAMILIES[0])
    placement_sd: float = key(
        "placement_sd_m",
        number(least=0),
        "how far off its written place a tag may sit (one standard deviation), m; 0: exact",
        example=f"{DEFAULT_PLACEMENT_SD}",
        default=DEFAULT_PLACEMENT_SD,
    )
    turn_sd: float = key(
        "turn_sd_deg",
        number(least=0, scale=math.pi / 180),
        "how far off its written turn a tag may be (one standard deviation), degrees; 0: exact",
        example="1.5",
        default=TURN_SD,
    )  # rad
    on_base: tuple[TagEntry, ...] = ()  # at least one where a camera looks; the first is the origin
    on_beam: tuple[TagEntry, ...] = ()  # at least one


@dataclass(frozen=True)
class ForceEntry:
    """[force]: the force log, and what is known of its sensor."""

    file: Path = key("file", text, "the force log, a CSV file or a bag, relative to this folder", example='"force.csv"')
    columns: tuple[str, str, str] = key(
        "columns",
        several(text, 3),
        "the columns with the time [s] and the two forces [N]",
        example='["time_s", "fx_N", "fy_N"]',
        default=("time_s", "fx_N", "fy_N"),
    )
    time_unit: Literal["s", "ms", "us", "ns"] = key(
        "time_unit", one_of("s", "ms", "us", "ns"), "the unit of the column with the time", example='"s"', default="s"
    )
    topic: str = key("topic", text, "the force's topic, where file is a bag", example='"/wrench"', default="")
    field: str = key(
        "field",
        text,
        "where the force stands in the topic's messages; known for wrenches and Franka's states",
        example='"wrench.force"',
        default="",
    )
    axes: tuple[str, str] = key(
        "axes",
        several(one_of("x", "y", "z", "-x", "-y", "-z"), 2),
        "the two axes of the bag's forces that span the plane of bending, in the order of x and y",
        example='["x", "y"]',
        default=("x", "y"),
    )
    definitions: Path | None = message_definitions()
    damaged: Damaged = damaged_bag()
    rotation: float = key(
        "rotation_deg",
        degrees(),
        "the log's x axis against the beam's, counter-clockwise as the camera sees it, degrees",
        example="0.0",
        default=0.0,
    )  # rad
    rotation_sd: float = key(
        "rotation_sd_deg",
        number(least=0, scale=math.pi / 180),
        "how far off rotation_deg may be (one standard deviation), degrees; 0: exact",
        example="1.0",
        default=DIRECTION_SD,
    )  # rad
    acts_on: Literal["beam", "robot"] = key(
        "acts_on",
        one_of("beam", "robot"),
        'whose force is logged: the one on the "beam", or the reaction on the "robot"',
        example='"beam"',
        default="beam",
    )
    sensor: str = key("sensor", text, "the sensor's name", example='"franka-estimate"', default="")
    zeroed: bool = key("zeroed", flag, "whether it was zeroed just before the push", example="false", default=False)
    gain_sd: float = key(
        "gain_sd",
        number(least=0),
        "the sensor's scale error (one sd, 0.02 = 2 %); 0: exact",
        example="0.02",
        default=GAIN_SD,
    )
    white_sd: float = key(
        "white_sd_N", number(least=0), "the sensor's noise of one sample (one sd), N", example="0.03", default=math.nan
    )
    bias_sd: float = key(
        "bias_sd_N",
        number(least=0),
        "the sensor's error under load that no rest shows (one sd), N; 0: none",
        example="0.2",
        default=math.nan,
    )


@dataclass(frozen=True)
class PushEntry:
    """[push]: where the force acts; a place, or the name of a column of the force log that gives it."""

    at: float = key(
        "at_s",
        number(above=0, least=0, most=1),
        "where the force acts, 0 at the clamp, 1 at the tip",
        example="1.0",
        default=math.nan,
    )
    column: str = key(
        "column", text, "the force log's column that gives the place of the push", example='"push_s"', default=""
    )
    at_sd: float = key(
        "at_sd_m",
        number(least=0),
        "how far off that place the force may act along the beam (one standard deviation), m; 0: exact",
        example="0.0025",
        default=PLACE_SD,
    )


@dataclass(frozen=True)
class GravityEntry:
    """[gravity]: the weight acts in the plane of the bending. Angles counter-clockwise from horizontal, as the camera
    sees it; the beam's x axis is given once, or as a log."""

    direction: float = key("direction_deg", degrees(), "where it pulls, in the room, degrees", example="-90.0")  # rad
    magnitude: float = key(
        "magnitude_m_s2", number(least=0, most=100), "the acceleration of gravity, m/s^2", example="9.81", default=9.81
    )
    base_angle: float = key(
        "base_angle_deg", degrees(), "the beam's x axis in the room, degrees", example="0.0", default=math.nan
    )  # rad
    base_angle_file: Path | None = key(
        "base_angle_file",
        text,
        "a CSV file with columns time_s (the force log's clock) and base_deg",
        example='"base_angle.csv"',
        default=None,
    )
    direction_sd: float = key(
        "direction_sd_deg",
        number(least=0, scale=math.pi / 180),
        "how far off gravity's direction against the beam's x axis may be (one standard deviation), degrees; 0: exact",
        example="2.0",
        default=GRAVITY_SD,
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
    frequencies: tuple[FrequencyEntry, ...] = ()  # beside one of these, or alone
    scale_sd: float = math.nan  # of lengths in the picture; NaN: as usual

    @property
    def only_frequencies(self) -> bool:
        """Whether nothing shows the beam but how fast it swings."""
        return all(source is None for source in (self.video, self.markers, self.poses, self.photos))

    @property
    def start(self) -> tuple[float, float]:
        """s: what the film's (or the tracker's) clock lacks to the log's as written, and its largest error."""
        source = self.video or self.markers
        return (source.start, source.start_uncertainty) if source is not None else (math.nan, math.inf)

    @property
    def clamp_sd(self) -> float:
        """rad, as stated of the clamp's direction where the beam is seen at rest; NaN: as usual."""
        source = self.video or self.markers
        return math.nan if source is None else source.clamp_sd

    @property
    def place_sd(self) -> float:
        """m, tolerance of the push's place along the beam."""
        return PLACE_SD if self.push is None else self.push.at_sd

    @property
    def direction_sd(self) -> float:
        """rad, tolerance of the force log's axes against the beam's."""
        return DIRECTION_SD if self.force is None else self.force.rotation_sd
