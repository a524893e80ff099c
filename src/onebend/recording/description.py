"""What `recording.toml` says as a whole: its tables, what must stand together, keys that a template leaves empty."""

from __future__ import annotations

import math
import re
from typing import Any

from onebend.recording import entries
from onebend.recording.entries import (
    FAMILY_SIZES,
    MOST_FREQUENCIES,
    MOST_MODE,
    MOST_TAGS,
    BeamEntry,
    CameraEntry,
    FrequencyEntry,
    TagEntry,
    TagsEntry,
)
from onebend.recording.schema import (
    LONGEST_KEY,
    Key,
    Mistakes,
    Place,
    keys_of,
    lines_of_keys,
    place_name,
    read_rows,
    read_table,
    report_unknown,
)
from onebend.records import CURVATURE_SD, Remark
from onebend.text_files import quoted

FORMAT = 1
SECTIONS: dict[str, type] = {
    "camera": entries.CameraEntry,
    "video": entries.VideoEntry,
    "force": entries.ForceEntry,
    "push": entries.PushEntry,
    "gravity": entries.GravityEntry,
    "markers": entries.MarkersEntry,
    "poses": entries.PosesEntry,
    "photos": entries.PhotosEntry,
    "outline": entries.OutlineEntry,
}
SOURCES = ("video", "markers", "poses", "photos")  # a recording has one of them
EMPTY = re.compile(r"^[^=#]*=\s*(#.*)?$")  # a key without a value
TABLES = ("beam", "tags", *SECTIONS)
LISTED: dict[str | int, type] = {
    "on_base": entries.TagEntry,
    "on_beam": entries.TagEntry,
    "masses": entries.MassEntry,
    "points": entries.TagEntry,
}  # of [[...]]
RECORDS = {
    "beam": entries.BeamEntry,
    "tags": entries.TagsEntry,
    **SECTIONS,
    "frequencies": entries.FrequencyEntry,
}
_KEYS = {table: {key.name for key, _ in keys_of(record).values()} for table, record in RECORDS.items()}
# Which tables know a key: the message about one in the wrong table names its place.
HOMES = {name: tuple(table for table in _KEYS if name in _KEYS[table]) for names in _KEYS.values() for name in names}


def empty_values(content: str) -> list[tuple[Place, int, str]]:
    """Places and lines (from 1) of keys that have no value, as a template leaves them, and what to fill in."""
    rows = content.splitlines()
    found: list[tuple[Place, int, str]] = []
    for place, line in lines_of_keys(content).items():
        if EMPTY.match(rows[line - 1]):
            entry = key_at(place)
            says = "a value, or a # before the line" if entry is None else entry.says
            found.append((place, line, f"{place_name(place[:-1])} {place[-1]} is empty. Fill it in: {says}."))
    return sorted(found, key=lambda one: one[1:])


def key_at(place: Place) -> Key | None:
    """What is known of the key at a place in the file; None for an unknown one."""
    known = RECORDS | LISTED
    record = next((known[part] for part in reversed(place[:-1]) if part in known), None)
    keys = {} if record is None else {entry.name: entry for entry, _ in keys_of(record).values()}
    return keys.get(str(place[-1]))


def camera_record(data: dict[str, Any]) -> type:
    """What [camera] is read as: a calibration, the topic of one, or all that is known of a camera without one."""
    table = data.get("camera")
    keys = set(table) if isinstance(table, dict) else set()
    if keys == {"scale_sd"}:
        return entries.UncalibratedEntry
    return entries.CameraInfoEntry if "camera_info" in keys else CameraEntry


def is_clicked(data: dict[str, Any]) -> bool:
    """Whether a person clicked along the body in photos, which then need no tag."""
    return isinstance(data.get("photos"), dict) and "clicks" in data["photos"]


def check_top(data: dict[str, Any], mistakes: Mistakes) -> None:
    """The tables and keys at the top of the file."""
    report_unknown(data, ["format", "name", *TABLES, "frequencies", "points"], (), mistakes)
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
    if "beam" not in data:
        mistakes.add((), "The file lacks the table [beam]. Add `[beam]` with `length_m = 0.15`.")
    bare = alone or is_clicked(data) or "markers" in data or "poses" in data
    if "tags" not in data and not bare:
        other = ", or `clicks` to [photos]" if "photos" in data else ""
        mistakes.add((), f"The file lacks the table [tags]. Add `[tags]` with `size_m = 0.012`{other}.")
    for name in ("tags", "force", "push", "camera") if alone else ():
        if name in data:
            mistakes.add((name,), f"[{name}] goes with a film, tracks, poses or photos, and there is none. Remove it.")


def read_beam(table: Any, mistakes: Mistakes) -> BeamEntry | None:
    """[beam] with the masses that ride on it."""
    rows = table.get("masses", []) if isinstance(table, dict) else []
    if not isinstance(rows, list):
        text = "[beam] masses must be tables: `[[beam.masses]]` with s and mass_kg, one each."
        mistakes.add(("beam", "masses"), text)
        rows = []
    masses = read_rows(entries.MassEntry, rows, ("beam", "masses"), mistakes)
    return read_table(BeamEntry, table, ("beam",), mistakes, masses=masses)


def read_frequencies(rows: Any, mistakes: Mistakes) -> tuple[FrequencyEntry, ...]:
    """The [[frequencies]] of a file."""
    if not isinstance(rows, list) or not 0 < len(rows) <= MOST_FREQUENCIES:
        text = f"Give 1 to {MOST_FREQUENCIES} tables [[frequencies]], each with hz and sd_hz."
        mistakes.add(("frequencies",), text)
        return ()
    read = [read_table(FrequencyEntry, row, ("frequencies", i), mistakes) for i, row in enumerate(rows)]
    seen: set[tuple[int, str, float]] = set()
    for i, one in enumerate(read):
        if one is None:
            continue
        place, posture = ("frequencies", i), (one.mode, f"{one.base_angle}", one.tip_mass)
        if one.mode > MOST_MODE:
            mistakes.add((*place, "mode"), f"mode is {one.mode}; modes 1 to {MOST_MODE} of a slender beam are known.")
        if one.sd >= one.hz:
            mistakes.add((*place, "sd_hz"), f"sd_hz = {one.sd:g} is no smaller than hz = {one.hz:g}. Are they swapped?")
        if posture in seen:
            text = f"mode {one.mode} is given twice for one posture and tip mass. Give their mean, with its sd."
            mistakes.add((*place, "mode"), text)
        seen.add(posture)
    return tuple(one for one in read if one is not None)


def read_tags(
    table: Any, mistakes: Mistakes, *, pictures: bool, bare: bool = False, points: Any = None
) -> TagsEntry | None:
    """[tags] with its two lists; where no camera looks (`pictures`), size and base tags may be missing, and where the
    body may be `bare` those on it. `points`: the list [[points]] in place of [[tags.on_beam]]."""
    if not isinstance(table, dict):
        mistakes.add(("tags",), f"[tags] must be a table, not {quoted(table)}.")
        return None
    lists: dict[str, tuple[TagEntry, ...]] = {}
    if points is not None and "on_beam" in table:
        mistakes.add(("points",), "The file has [[points]] and [[tags.on_beam]]. Write all of them as [[points]].")
    for group, what in (("on_base", "on the clamp, the origin of all measures"), ("on_beam", "along the beam")):
        rows = table.get(group, [])
        place: Place = ("tags", group)
        if group == "on_beam" and points is not None:
            rows, place = points, ("points",)
        may_lack = bare if group == "on_beam" else not pictures
        if not isinstance(rows, list) or not (rows or may_lack):
            mistakes.add(place, f"[tags] needs at least one [[{'.'.join(map(str, place))}]] with its id: a tag {what}.")
            rows = []
        if len(rows) > MOST_TAGS:
            mistakes.add(place, f"[[tags.{group}]] lists {len(rows)} tags; at most {MOST_TAGS} can be followed.")
            rows = []
        if group == "on_base":  # on the clamp, where s = 0, unless it is said otherwise
            rows = [{"s": 0.0} | row if isinstance(row, dict) else row for row in rows]
        lists[group] = read_rows(TagEntry, rows, place, mistakes)
    check_ids(lists, table.get("family", entries.FAMILIES[0]) if pictures else None, mistakes)
    if pictures and "size_m" not in table:
        mistakes.add(("tags",), "[tags] lacks size_m: the side of the tag's black square, m, for example 0.012.")
    return read_table(TagsEntry, table, ("tags",), mistakes, **lists)


def check_ids(lists: dict[str, tuple[TagEntry, ...]], family: object, mistakes: Mistakes) -> None:
    """Note every id that is given twice, or that the family of the tags does not have."""
    count = FAMILY_SIZES.get(family, math.inf) if isinstance(family, str) else math.inf
    known: set[int] = set()
    for group, tags in lists.items():
        for i, tag in enumerate(tags):
            place = ("tags", group, i, "id")
            if tag.id in known:
                mistakes.add(place, f"The tag id {tag.id} is given twice. Each tag needs its own id.")
            if tag.id >= count:
                text = f"There is no tag {tag.id} in {family}: it has tags 0 to {count - 1:.0f}."
                mistakes.add(place, f"{text} Correct the id or the family.")
            known.add(tag.id)


def check_together(tables: dict[str, Any], data: dict[str, Any], mistakes: Mistakes) -> None:
    """Mistakes between tables, or between keys of one table."""
    if "points" in data and "poses" not in data:
        mistakes.add(("points",), "[[points]] go with [poses]: a film, photos or tracks have [[tags.on_beam]].")
    push, gravity = tables["push"], tables["gravity"]
    if push is not None and push.column and tables["force"] is not None and tables["force"].topic:
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


def implausible(beam: BeamEntry, tags: TagsEntry, tables: dict[str, Any], scale_sd: float) -> tuple[Remark, ...]:
    """A warning for each number that is possible but probably wrong, and notes on those without effect."""
    remarks = camera_remarks(tables["camera"]) if tables["camera"] is not None else []

    def warn(wrong: bool, text: str, about: str = "unit") -> None:
        if wrong:
            remarks.append(Remark("warning", text, about=about))

    length = beam.length
    push, force, gravity = tables["push"], tables["force"], tables["gravity"]
    text = f"mass_kg makes the beam weigh {beam.mass / length:.3g} kg a metre: is it in kilograms?"
    warn(beam.mass / length > 50.0, text)  # a steel bar of 90 mm
    riding = sum(one.mass for one in beam.masses)
    text = f"what rides on the beam weighs {riding:.3g} kg, {riding / beam.mass:.2g} times the beam: in kilograms?"
    warn(riding > 20.0 * beam.mass, text)
    if beam.width > beam.thickness:
        text = (
            f"width_m = {beam.width:g} is larger than thickness_m = {beam.thickness:g}, so the beam bends over its "
            "thicker side: width_m lies in the plane of bending. Are the two swapped?"
        )
        remarks.append(Remark("note", text))
    clamp = math.degrees(max((tables[name].clamp_sd for name in SOURCES if tables[name] is not None), default=math.nan))
    text = f"clamp_sd_deg = {clamp:g} lets the clamp turn freely: k near it cannot be known then. Write how firm it is."
    warn(clamp > 15.0, text, about="wide tolerance")
    curvature = math.degrees(beam.curvature_sd)
    text = f"rest_curvature_sd_deg = {curvature:.3g} is a beam that may be rolled up: is it in degrees?"
    warn(beam.rest == "unknown" and beam.curvature_sd > 2.0, text, about="wide tolerance")
    text = f"scale_sd = {scale_sd:g} is {100.0 * scale_sd:g} %: is it a share (0.003 = 0.3 %)?"
    warn(scale_sd > 0.1, text, about="wide tolerance")
    if beam.rest == "straight" and beam.curvature_sd not in (0.0, CURVATURE_SD):
        remarks.append(Remark("note", 'rest_curvature_sd_deg is used only with rest = "unknown".'))
    warn(length > 10.0, f"length_m = {length:g} is a beam longer than 10 m: is it in metres?")
    warn(tags.size > length, f"size_m = {tags.size:g} is a tag wider than the beam is long: are both in metres?")
    for name, size in (("width_m", beam.width), ("thickness_m", beam.thickness), ("diameter_m", beam.diameter)):
        warn(size > length, f"{name} = {size:g} is a section larger than the beam is long: are both in metres?")
    for name, sd in (("placement_sd_m", tags.placement_sd), ("at_sd_m", math.nan if push is None else push.at_sd)):
        warn(sd > 0.2 * length, f"{name} = {sd:g} is more than a fifth of the beam's length: is it in metres?")
    gain = math.nan if force is None else force.gain_sd
    warn(gain > 0.5, f"gain_sd = {gain:g} is {100.0 * gain:g} %: is it a share (0.02 = 2 %)?")
    turns = {
        "turn_sd_deg": tags.turn_sd,
        "rotation_sd_deg": math.nan if force is None else force.rotation_sd,
        "direction_sd_deg": math.nan if gravity is None else gravity.direction_sd,
    }
    for name, sd in turns.items():
        text = f"{name} = {math.degrees(sd):g} leaves the direction open: is it right?"
        warn(sd > math.radians(45.0), text, about="wide tolerance")
    return tuple(remarks)


def camera_remarks(camera: CameraEntry) -> list[Remark]:
    """A warning for each number of a calibration that is unlikely."""
    warnings = []
    if abs(camera.fx / camera.fy - 1.0) > 0.05:  # pixels are square
        warnings.append(f"[camera] fx = {camera.fx:g} and fy = {camera.fy:g} differ by more than 5 %: check them.")
    longer = max(camera.width, camera.height)
    if not 0.3 * longer < camera.fx < 10.0 * longer:  # 118 deg to 6 deg of view
        warnings.append(f"[camera] fx = {camera.fx:g} is unlikely for a picture {longer} px wide: is it in pixels?")
    if max(abs((camera.cx + 0.5) / camera.width - 0.5), abs((camera.cy + 0.5) / camera.height - 0.5)) > 0.2:
        warnings.append(
            f"[camera] the principal point ({camera.cx:g}, {camera.cy:g}) is far from the picture's middle "
            f"({0.5 * (camera.width - 1):g}, {0.5 * (camera.height - 1):g}): check cx and cy."
        )
    return [Remark("warning", text, about="camera") for text in warnings]
