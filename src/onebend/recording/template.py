"""The commented `recording.toml` that `onebend new` writes, made from the keys' own declarations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

from onebend.errors import RecordingError, ResultsError
from onebend.files.endings import FILMS, LOGS
from onebend.files.single_file import write_file
from onebend.recording.folder import FILE_NAME
from onebend.recording.toml.beam_entry import BeamEntry
from onebend.recording.toml.description import FORMAT
from onebend.recording.toml.entries import ForceEntry, GravityEntry, PushEntry, TagEntry, TagsEntry
from onebend.recording.toml.frequency_entry import FrequencyEntry
from onebend.recording.toml.schema import keys_of
from onebend.recording.toml.source_entries import (
    CameraEntry,
    MarkersEntry,
    PhotosEntry,
    PosesEntry,
    VideoEntry,
)
from onebend.strict_json import to_json

Kind = Literal["video", "ros", "photos", "weights", "mocap"]
INTRODUCTION = f"""\
# {{what}}, for onebend. Fill in what is empty; lines that start with # are optional and show an example.
# Units are in the names.{{hint}}

format = {FORMAT}
"""
WHAT: dict[Kind, tuple[str, str]] = {
    "video": (
        "What was filmed",
        " Film so that all tags face the camera; start and stop with nothing touching the beam.",
    ),
    "ros": ("What was filmed and logged in a bag", " Start and stop with nothing touching the beam."),
    "photos": ("What was photographed", " One picture a pose, one of them with no load."),
    "weights": ("What was measured by hand", " One pose a load, one of them with no load."),
    "mocap": ("What was tracked", " Start and stop with nothing touching the beam."),
}
EMPTY = ""  # what only the experimenter knows: no value is better than one that looks right
CAMERA = "Optional: the camera's calibration. Without it, the tags' known size gives the scale."
GRAVITY = "Optional: only where the beam's weight acts in the plane it bends in (not for a beam lying on its side)."

FREQUENCIES = "Optional: how fast it swings, clamped as here; one such table for each frequency."


def write_template(folder: Path | str, kind: Kind = "video", **filled: Mapping[str, str]) -> Path:
    """Write a `recording.toml` to fill in into `folder` (made if need be) and return its path.

    Where the folder holds one film, or one table that may be a log, it is named.

    Args:
        filled: by table, what is known already: keys with their values as TOML.

    Raises:
        RecordingError: the folder holds one already, or cannot be written.
    """
    path = Path(folder) / FILE_NAME
    if path.exists():
        raise RecordingError(f"{path} exists already. Edit it, or name another folder.")
    if kind == "video":
        filled = {**files_beside(path.parent), **filled}
    try:
        write_file(path, template(kind, **filled))
    except ResultsError as wrong:
        raise RecordingError(str(wrong)) from None
    return path


def files_beside(folder: Path) -> dict[str, dict[str, str]]:
    """What the files in a folder tell of [video] and [force]; nothing where there are several that it may be."""
    found: dict[str, dict[str, str]] = {}
    for table, endings in (("video", FILMS), ("force", LOGS)):
        names = [one.name for one in folder.glob("[!.]*") if one.suffix.lower() in endings and one.is_file()]
        if len(names) == 1 and names[0].isprintable():
            found[table] = {"file": to_json(names[0])}
    return found


def template(kind: Kind = "video", **filled: Mapping[str, str]) -> str:
    """The text of the template: it keeps the schema once what is empty is filled in."""
    what, hint = WHAT[kind]
    known = {name: dict(values) for name, values in filled.items()}
    seen_by_camera = kind in ("video", "ros", "photos")
    parts = [
        INTRODUCTION.format(what=what, hint=hint),
        table("[beam]", BeamEntry, length_m=EMPTY, **({"mass_kg": EMPTY} if kind == "weights" else {})),
        table("[tags]", TagsEntry, **({"size_m": EMPTY} if seen_by_camera else {})),
        *([tag("[[tags.on_base]]", "0.0")] if seen_by_camera else []),
        *(tag("[[tags.on_beam]]", EMPTY) for _ in range(3)),
        *_SOURCES[kind](known),
    ]
    if kind != "weights":
        parts.append(optional(GRAVITY, table("[gravity]", GravityEntry)))
    parts.append(optional(FREQUENCIES, table("[[frequencies]]", FrequencyEntry)))
    return "\n".join(parts)


def _filmed(known: dict[str, dict[str, str]]) -> list[str]:
    video = {"file": '"video.mp4"'} | known.get("video", {})
    camera = optional(CAMERA, table("[camera]", CameraEntry))
    return [table("[video]", VideoEntry, **video), *_pushed(known), camera]


def _tracked(known: dict[str, dict[str, str]]) -> list[str]:
    return [table("[markers]", MarkersEntry, file='"markers.csv"'), *_pushed(known)]


def _photographed(_: dict[str, dict[str, str]]) -> list[str]:
    photos = table("[photos]", PhotosEntry, folder='"photos"', loads='"loads.csv"', axes=EMPTY)
    return [photos, optional(CAMERA, table("[camera]", CameraEntry))]


def _weighed(_: dict[str, dict[str, str]]) -> list[str]:
    poses = table("[poses]", PosesEntry, file='"poses.csv"', loads='"loads.csv"', axes=EMPTY)
    return [poses, table("[gravity]", GravityEntry, **WEIGHT)]


def _pushed(known: dict[str, dict[str, str]]) -> list[str]:
    force = {"file": '"force.csv"', "acts_on": EMPTY, "rotation_deg": EMPTY} | known.get("force", {})
    return [table("[force]", ForceEntry, **force), table("[push]", PushEntry, at_s=EMPTY)]


WEIGHT = {"direction_deg": "-90.0", "base_angle_deg": EMPTY}
_SOURCES: dict[Kind, Callable[[dict[str, dict[str, str]]], list[str]]] = {
    "video": _filmed,
    "ros": _filmed,
    "photos": _photographed,
    "weights": _weighed,
    "mocap": _tracked,
}


def tag(header: str, s: str) -> str:
    """One tag to fill in; more of them are more such tables."""
    return table(header, TagEntry, id=EMPTY, s=s)


def table(header: str, record: type, **values: str) -> str:
    """One table with every key it may have and what each says; those without a value here are commented out."""
    lines = [header]
    for entry, _ in keys_of(record).values():
        value = values.get(entry.name)
        if value is None:
            assignment, says = f"# {entry.name} = {entry.example}", entry.says
        else:
            says = entry.says if value else f"{entry.says}; such as {entry.example}"
            assignment = f"{entry.name} = {value}"
        lines.append(f"{assignment:<40}  # {says}")
    return "\n".join(lines) + "\n"


def optional(why: str, lines: str) -> str:
    """A whole table commented out."""
    commented = [line if line.startswith("#") else f"# {line}" for line in lines.splitlines()]
    return "\n".join([f"# {why}", *commented]) + "\n"
