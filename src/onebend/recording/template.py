"""The commented `recording.toml` that `onebend new` writes, made from the keys' own declarations."""

from __future__ import annotations

from pathlib import Path

from onebend.errors import RecordingError
from onebend.recording.folder import FILE_NAME, FORMAT
from onebend.recording.toml.beam_entry import BeamEntry
from onebend.recording.toml.entries import ForceEntry, GravityEntry, PushEntry, TagEntry, TagsEntry
from onebend.recording.toml.schema import keys_of
from onebend.recording.toml.source_entries import CameraEntry, MarkersEntry, PhotosEntry, PosesEntry, VideoEntry

INTRODUCTION = f"""\
# What was filmed, for onebend. Fill in your own values; lines that start with # are optional and show an example.
# Units are in the names. Film so that all tags face the camera; start and stop with nothing touching the beam.

format = {FORMAT}
"""
# Written out though they are optional:
WRITTEN = {"start_s", "start_uncertainty_s", "rest", "family", "turn_deg", "rotation_deg", "acts_on", "at_s", "size_m"}
CAMERA = "Optional: the camera's calibration. Without it, the tags' known size gives the scale."
MARKERS = "In place of [video]: tracks from a motion capture or any tracker."
POSES = "In place of [video], [force] and [push]: static poses measured by hand, with weighed loads."
PHOTOS = "In place of [video], [force] and [push]: stills of the tags, with weighed loads."
GRAVITY = "Optional: only where the beam's weight acts in the plane it bends in (not for a beam lying on its side)."


def write_template(folder: Path | str) -> Path:
    """Write a commented `recording.toml` into `folder` (made if need be) and return its path.

    Raises:
        RecordingError: the folder holds one already, or cannot be written.
    """
    path = Path(folder) / FILE_NAME
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            file.write(template())
    except FileExistsError:
        raise RecordingError(f"{path} exists already. Edit it, or name another folder.") from None
    except OSError as wrong:
        raise RecordingError(f"{path} cannot be written: {wrong.strerror}. Name another folder.") from None
    return path


def template() -> str:
    """The text of the template; it is valid TOML and keeps the schema."""
    parts = [
        INTRODUCTION,
        table("[beam]", BeamEntry),
        table("[tags]", TagsEntry),
        table("[[tags.on_base]]", TagEntry, id="0", s="0.0"),
        *(
            table("[[tags.on_beam]]", TagEntry, id=str(i), s=s)
            for i, s in ((1, "0.333333"), (2, "0.666667"), (3, "1.0"))
        ),
        table("[video]", VideoEntry),
        table("[force]", ForceEntry),
        table("[push]", PushEntry),
        optional(CAMERA, table("[camera]", CameraEntry)),
        optional(GRAVITY, table("[gravity]", GravityEntry)),
        optional(MARKERS, table("[markers]", MarkersEntry)),
        optional(POSES, table("[poses]", PosesEntry)),
        optional(PHOTOS, table("[photos]", PhotosEntry)),
    ]
    return "\n".join(parts)


def table(header: str, record: type, **values: str) -> str:
    """One table with every key it may have and what each says; optional keys are commented out."""
    lines = [header]
    for entry, required in keys_of(record).values():
        mark = "" if required or entry.name in WRITTEN else "# "
        assignment = f"{mark}{entry.name} = {values.get(entry.name, entry.example)}"
        lines.append(f"{assignment:<40}  # {entry.says}")
    return "\n".join(lines) + "\n"


def optional(why: str, lines: str) -> str:
    """A whole table commented out."""
    commented = [line if line.startswith("#") else f"# {line}" for line in lines.splitlines()]
    return "\n".join([f"# {why}", *commented]) + "\n"
