"""What `recording.toml` says as a whole: its tables, what must stand together, keys that a template leaves empty."""

from __future__ import annotations

import math
import re
from typing import Any

from onebend.recording.toml.beam_entry import BeamEntry, MassEntry
from onebend.recording.toml.entries import (
    FAMILIES,
    FAMILY_SIZES,
    MOST_TAGS,
    ForceEntry,
    GravityEntry,
    PushEntry,
    TagEntry,
    TagsEntry,
)
from onebend.recording.toml.frequency_entry import FrequencyEntry
from onebend.recording.toml.schema import (
    LONGEST_KEY,
    Mistakes,
    Place,
    keys_of,
    lines_of_keys,
    place_name,
    read_table,
    report_unknown,
)
from onebend.recording.toml.source_entries import (
    CameraEntry,
    CameraInfoEntry,
    MarkersEntry,
    PhotosEntry,
    PosesEntry,
    UncalibratedEntry,
    VideoEntry,
)
from onebend.records import Remark
from onebend.text_files import quoted

FORMAT = 1
SECTIONS: dict[str, type] = {
    "camera": CameraEntry,
    "video": VideoEntry,
    "force": ForceEntry,
    "push": PushEntry,
    "gravity": GravityEntry,
    "markers": MarkersEntry,
    "poses": PosesEntry,
    "photos": PhotosEntry,
}
SOURCES = ("video", "markers", "poses", "photos")  # a recording has one of them
EMPTY = re.compile(r"^[^=#]*=\s*(#.*)?$")  # a key without a value
TABLES = ("beam", "tags", *SECTIONS)
LISTED: dict[str | int, type] = {"on_base": TagEntry, "on_beam": TagEntry, "masses": MassEntry}  # of [[...]]
RECORDS = {"beam": BeamEntry, "tags": TagsEntry, **SECTIONS, "frequencies": FrequencyEntry}
# Which tables know a key: what stands in the wrong one is told its place.
HOMES: dict[str, tuple[str, ...]] = {
    name: tuple(table for table, one in RECORDS.items() if name in {key.name for key, _ in keys_of(one).values()})
    for record in RECORDS.values()
    for name in {key.name for key, _ in keys_of(record).values()}
}


def empty_values(content: str) -> list[tuple[Place, int, str]]:
    """Places and lines (from 1) of keys that have no value, as a template leaves them, and what to fill in."""
    rows = content.splitlines()
    found: list[tuple[Place, int, str]] = []
    for place, line in lines_of_keys(content).items():
        if EMPTY.match(rows[line - 1]):
            record = LISTED.get(place[1] if len(place) > 1 else "", RECORDS.get(str(place[0])))
            keys = {} if record is None else {entry.name: entry for entry, _ in keys_of(record).values()}
            says = keys[str(place[-1])].says if place[-1] in keys else "a value, or a # before the line"
            found.append((place, line, f"{place_name(place[:-1])} {place[-1]} is empty. Fill it in: {says}."))
    return sorted(found, key=lambda one: one[1:])


def camera_record(data: dict[str, Any]) -> type:
    """What [camera] is read as: a calibration, the topic of one, or all that is known of a camera without one."""
    table = data.get("camera")
    keys = set(table) if isinstance(table, dict) else set()
    return UncalibratedEntry if keys == {"scale_sd"} else CameraInfoEntry if "camera_info" in keys else CameraEntry


def check_top(data: dict[str, Any], mistakes: Mistakes) -> None:
    """The tables and keys at the top of the file."""
    report_unknown(data, ["format", "name", *TABLES, "frequencies"], (), mistakes)
    if data.get("format") != FORMAT:
        mistakes.add(("format",), f"format must be {FORMAT}. Write `format = {FORMAT}` at the top.")
    if not isinstance(data.get("name", ""), str) or len(data.get("name", "")) > LONGEST_KEY:
        text = f"name must be text in quotes of at most {LONGEST_KEY} characters, not {quoted(data['name'])}."
        mistakes.add(("name",), text)
    sources = [name for name in SOURCES if name in data]
    alone = not sources and "frequencies" in data  # they need no tag, and no force
    if not sources and not alone:
        mistakes.add((), 'The file lacks the table [video]. Add `[video]` with `file = "video.mp4"`.')
    if len(sources) > 1:
        names = " and ".join(f"[{name}]" for name in sources)
        mistakes.add((sources[1],), f"The file has {names}: a recording has one of them. Make a folder of each.")
    camera = data.get("camera")
    if isinstance(camera, dict) and "camera_info" in camera and (more := set(camera) - {"camera_info", "scale_sd"}):
        text = f"[camera] camera_info stands for the whole calibration. Remove it, or {', '.join(sorted(more))}."
        mistakes.add(("camera", "camera_info"), text)
    for name, example in (("beam", "length_m = 0.15"), ("tags", "size_m = 0.012")):
        if name not in data and not (alone and name == "tags"):
            mistakes.add((), f"The file lacks the table [{name}]. Add `[{name}]` with `{example}`.")
    for name in ("tags", "force", "push", "camera") if alone else ():
        if name in data:
            mistakes.add((name,), f"[{name}] goes with a film, tracks, poses or photos, and there is none. Remove it.")


def read_beam(table: Any, mistakes: Mistakes) -> BeamEntry | None:
    """[beam] with what rides on it."""
    rows = table.get("masses", []) if isinstance(table, dict) else []
    if not isinstance(rows, list):
        mistakes.add(
            ("beam", "masses"), "[beam] masses must be tables: `[[beam.masses]]` with s and mass_kg, one each."
        )
        rows = []
    read = [read_table(MassEntry, row, ("beam", "masses", i), mistakes) for i, row in enumerate(rows)]
    masses = tuple(one for one in read if one is not None)
    return read_table(BeamEntry, table, ("beam",), mistakes, masses=masses)


def read_tags(table: Any, mistakes: Mistakes, *, pictures: bool) -> TagsEntry | None:
    """[tags] with its two lists; where no camera looks (`pictures`), size and base tags may be missing."""
    if not isinstance(table, dict):
        mistakes.add(("tags",), f"[tags] must be a table, not {quoted(table)}.")
        return None
    lists: dict[str, tuple[TagEntry, ...]] = {}
    for group, what in (("on_base", "on the clamp, the origin of all measures"), ("on_beam", "along the beam")):
        rows = table.get(group, [])
        if not isinstance(rows, list) or not (rows or (group == "on_base" and not pictures)):
            mistakes.add(("tags", group), f"[tags] needs at least one [[tags.{group}]] with its id: a tag {what}.")
            rows = []
        if len(rows) > MOST_TAGS:
            mistakes.add(
                ("tags", group), f"[[tags.{group}]] lists {len(rows)} tags; at most {MOST_TAGS} can be followed."
            )
            rows = []
        read = [read_table(TagEntry, row, ("tags", group, i), mistakes) for i, row in enumerate(rows)]
        lists[group] = tuple(tag for tag in read if tag is not None)
    known_ids: set[int] = set()
    for group, tags in lists.items():
        for i, tag in enumerate(tags):
            if tag.id in known_ids:
                mistakes.add(
                    ("tags", group, i, "id"), f"The tag id {tag.id} is given twice. Each tag needs its own id."
                )
            known_ids.add(tag.id)
    if pictures:
        refuse_unprinted(table.get("family", FAMILIES[0]), lists, mistakes)
    if pictures and "size_m" not in table:
        mistakes.add(("tags",), "[tags] lacks size_m: the side of the tag's black square, m, for example 0.012.")
    return read_table(TagsEntry, table, ("tags",), mistakes, **lists)


def refuse_unprinted(family: object, lists: dict[str, tuple[TagEntry, ...]], mistakes: Mistakes) -> None:
    """Note every id that the family of tags does not have."""
    count = FAMILY_SIZES.get(family, math.inf) if isinstance(family, str) else math.inf
    for group, tags in lists.items():
        for i, tag in enumerate(tags):
            if tag.id >= count:
                text = f"There is no tag {tag.id} in {family}: it has tags 0 to {count - 1:.0f}."
                mistakes.add(("tags", group, i, "id"), f"{text} Correct the id or the family.")


def check_together(entries: dict[str, Any], data: dict[str, Any], mistakes: Mistakes) -> None:
    """Mistakes between tables, or between keys of one table."""
    push, gravity = entries["push"], entries["gravity"]
    if push is not None and push.column and entries["force"] is not None and entries["force"].topic:
        mistakes.add(("push", "column"), "[push] column: the force is in a bag, which has no columns. Give at_s.")
    if push is not None and math.isnan(push.at) == (push.column == ""):
        mistakes.add(("push",), "[push] needs either at_s (a place) or column (a column of the force log), not both.")
    if "force" in data and "push" not in data:
        mistakes.add(("force",), "There is a [force] but no [push]: say where it acts. Add `[push]` with `at_s = 1.0`.")
    if "push" in data and "force" not in data:
        mistakes.add(("push",), "There is a [push] but no [force]: add the force log, or remove [push].")
    if gravity is None:
        return
    if "poses" in data or "photos" in data:  # the table of loads may say it in every pose
        if gravity.base_angle_file is not None:
            text = "[gravity] base_angle_file: poses have no clock. Give base_angle_deg, or clamp_deg with the loads."
            mistakes.add(("gravity", "base_angle_file"), text)
    elif math.isnan(gravity.base_angle) == (gravity.base_angle_file is None):
        mistakes.add(("gravity",), "[gravity] needs either base_angle_deg or base_angle_file, not both.")


def remarks_on(tags: TagsEntry, data: dict[str, Any]) -> tuple[Remark, ...]:
    """Remarks on values that are assumed because the file does not state them."""
    remarks = []
    if "placement_sd_m" not in data["tags"] and "poses" not in data:
        assumed = f"{1000 * tags.placement_sd:g} mm"
        remarks.append(
            Remark("note", f"recording.toml does not say how exactly the tags were placed: {assumed} assumed.")
        )
    film = data.get("video", data.get("markers"))
    if film is not None and "start_s" not in film and "force" in data:
        what = "the video starts" if "video" in data else "the tracks start"
        text = f"recording.toml does not say when {what} on the force log's clock."
        if "start_uncertainty_s" in film:
            text = f"{text[:-1]}: start_uncertainty_s says nothing without start_s."
        remarks.append(Remark("note", text))
    return tuple(remarks)
