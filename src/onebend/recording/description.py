"""What `recording.toml` says as a whole: its tables, what must stand together, keys that a template leaves empty."""

from __future__ import annotations

import math
import re
from typing import Any

from onebend.recording.entries import (
    FAMILIES,
    FAMILY_SIZES,
    MOST_TAGS,
    BeamEntry,
    CameraEntry,
    CameraInfoEntry,
    ForceEntry,
    FrequencyEntry,
    GravityEntry,
    MarkersEntry,
    MassEntry,
    PhotosEntry,
    PosesEntry,
    PushEntry,
    TagEntry,
    TagsEntry,
    UncalibratedEntry,
    VideoEntry,
)
from onebend.recording.schema import (
    LONGEST_KEY,
    Mistakes,
    Place,
    keys_of,
    lines_of_keys,
    place_name,
    read_table,
    report_unknown,
)
from onebend.records import CURVATURE_SD, Remark
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


# Implausible numbers in recording.toml, possible but probably wrong: of the camera, the mass, an sd.

PIXELS = 0.05  # by which fx and fy may differ: pixels are square
MIDDLE = 0.2  # of the picture, that the principal point may be away from its middle
SHORTEST, LONGEST = 0.3, 10.0  # focal length over the picture's longer side: 118 deg to 6 deg of view
HEAVIEST = 50.0  # kg/m, a steel bar of 90 mm
RIDERS = 20.0  # masses of the beam, of all that rides on it
LOOSEST = math.radians(15.0)  # sd of a clamp's direction
ROUNDEST = 2.0  # rad, sd of what a beam turns by its own curvature
ROUGHEST = 0.1  # sd of a picture's scale
LONG = 10.0  # m, of a beam
NOWHERE = 0.2  # of the length, sd of a place
TURNED = math.radians(45.0)  # sd of a direction
SCALED = 0.5  # sd of the force's scale


def entry_remarks(beam: BeamEntry, camera: CameraEntry | None) -> tuple[Remark, ...]:
    """A warning for each number that is probably wrong, a note on two that are easily swapped."""
    remarks = [] if camera is None else [Remark("warning", text, about="camera") for text in camera_doubts(camera)]
    if beam.mass / beam.length > HEAVIEST:
        text = f"mass_kg makes the beam weigh {beam.mass / beam.length:.3g} kg a metre: is it in kilograms?"
        remarks.append(Remark("warning", text, about="unit"))
    riding = sum(one.mass for one in beam.masses)
    if riding > RIDERS * beam.mass:
        text = f"what rides on the beam weighs {riding:.3g} kg, {riding / beam.mass:.2g} times the beam: in kilograms?"
        remarks.append(Remark("warning", text, about="unit"))
    if beam.width > beam.thickness:
        text = (
            f"width_m = {beam.width:g} is larger than thickness_m = {beam.thickness:g}, so the beam bends over its "
            "thicker side: width_m lies in the plane of bending. Are the two swapped?"
        )
        remarks.append(Remark("note", text))
    return tuple(remarks)


def spread_remarks(beam: BeamEntry, entries: dict[str, Any], scale_sd: float) -> tuple[Remark, ...]:
    """A warning for each stated sd (clamp, rest shape, scale) that is too large, a note on one that is not used."""
    warnings = []
    clamp = max((entries[name].clamp_sd for name in SOURCES if entries[name] is not None), default=math.nan)
    if clamp > LOOSEST:
        warnings.append(
            f"clamp_sd_deg = {math.degrees(clamp):g} lets the clamp turn freely: k near it cannot be known then. "
            "Write how firm it is."
        )
    if beam.rest == "unknown" and beam.curvature_sd > ROUNDEST:
        warnings.append(
            f"rest_curvature_sd_deg = {math.degrees(beam.curvature_sd):.3g} is a beam that may be rolled up: is it in "
            "degrees?"
        )
    if scale_sd > ROUGHEST:
        warnings.append(f"scale_sd = {scale_sd:g} is {100.0 * scale_sd:g} %: is it a share (0.003 = 0.3 %)?")
    remarks = [Remark("warning", text, about="wide tolerance") for text in warnings]
    if beam.rest == "straight" and beam.curvature_sd not in (0.0, CURVATURE_SD):
        remarks.append(Remark("note", 'rest_curvature_sd_deg is used only with rest = "unknown".'))
    return tuple(remarks)


def unit_remarks(beam: BeamEntry, tags: TagsEntry, entries: dict[str, Any]) -> tuple[Remark, ...]:
    """A warning for each size that looks written in another unit, or says nothing."""
    length, warnings = beam.length, []
    if length > LONG:
        warnings.append(f"length_m = {length:g} is a beam longer than {LONG:g} m: is it in metres?")
    if tags.size > length:
        warnings.append(f"size_m = {tags.size:g} is a tag wider than the beam is long: are both in metres?")
    sizes = (("width_m", beam.width), ("thickness_m", beam.thickness), ("diameter_m", beam.diameter))
    warnings += [
        f"{name} = {size:g} is a section larger than the beam is long: are both in metres?"
        for name, size in sizes
        if size > length
    ]
    push, force, gravity = entries["push"], entries["force"], entries["gravity"]
    sds = [("placement_sd_m", tags.placement_sd), ("at_sd_m", math.nan if push is None else push.at_sd)]
    for name, sd in sds:
        if sd > NOWHERE * length:
            warnings.append(f"{name} = {sd:g} is more than a fifth of the beam's length: is it in metres?")
    turns = [
        ("turn_sd_deg", tags.turn_sd),
        ("rotation_sd_deg", math.nan if force is None else force.rotation_sd),
        ("direction_sd_deg", math.nan if gravity is None else gravity.direction_sd),
    ]
    open_turns = [
        f"{name} = {math.degrees(sd):g} leaves the direction open: is it right?" for name, sd in turns if sd > TURNED
    ]
    if force is not None and force.gain_sd > SCALED:
        warnings.append(f"gain_sd = {force.gain_sd:g} is {100.0 * force.gain_sd:g} %: is it a share (0.02 = 2 %)?")
    return (
        *(Remark("warning", text, about="unit") for text in warnings),
        *(Remark("warning", text, about="wide tolerance") for text in open_turns),
    )


def camera_doubts(camera: CameraEntry) -> list[str]:
    """What is unlikely of a calibration."""
    warnings = []
    if abs(camera.fx / camera.fy - 1.0) > PIXELS:
        warnings.append(f"[camera] fx = {camera.fx:g} and fy = {camera.fy:g} differ by more than 5 %: check them.")
    longer = max(camera.width, camera.height)
    if not SHORTEST * longer < camera.fx < LONGEST * longer:
        warnings.append(f"[camera] fx = {camera.fx:g} is unlikely for a picture {longer} px wide: is it in pixels?")
    off = max(abs((camera.cx + 0.5) / camera.width - 0.5), abs((camera.cy + 0.5) / camera.height - 0.5))
    if off > MIDDLE:
        warnings.append(
            f"[camera] the principal point ({camera.cx:g}, {camera.cy:g}) is far from the picture's middle "
            f"({0.5 * (camera.width - 1):g}, {0.5 * (camera.height - 1):g}): check cx and cy."
        )
    return warnings
