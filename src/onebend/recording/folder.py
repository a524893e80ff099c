"""A recording on disk: a folder with `recording.toml`, read and checked."""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from onebend.errors import LearningError, ObservationError, RecordingError
from onebend.recording import entries, schema
from onebend.recording.bag_topics import CameraInfo, bag_camera, check_bag, picture_size, with_bags
from onebend.recording.bags import is_bag
from onebend.records import CURVATURE_SD, Array, Remark
from onebend.text_files import MOST_TOML, ascii_only, quoted, read_text, read_toml, toml_data

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
_KEYS = {table: {key.name for key, _ in schema.keys_of(record).values()} for table, record in RECORDS.items()}
# Which tables know a key: the message about one in the wrong table names its place.
HOMES = {name: tuple(table for table in _KEYS if name in _KEYS[table]) for names in _KEYS.values() for name in names}


def empty_values(content: str) -> list[tuple[schema.Place, int, str]]:
    """Places and lines (from 1) of keys that have no value, as a template leaves them, and what to fill in."""
    rows = content.splitlines()
    found: list[tuple[schema.Place, int, str]] = []
    for place, line in schema.lines_of_keys(content).items():
        if EMPTY.match(rows[line - 1]):
            entry = key_at(place)
            says = "a value, or a # before the line" if entry is None else entry.says
            found.append((place, line, f"{schema.place_name(place[:-1])} {place[-1]} is empty. Fill it in: {says}."))
    return sorted(found, key=lambda one: one[1:])


def key_at(place: schema.Place) -> schema.Key | None:
    """What is known of the key at a place in the file; None for an unknown one."""
    known = RECORDS | LISTED
    record = next((known[part] for part in reversed(place[:-1]) if part in known), None)
    keys = {} if record is None else {entry.name: entry for entry, _ in schema.keys_of(record).values()}
    return keys.get(str(place[-1]))


def camera_record(data: dict[str, Any]) -> type:
    """What [camera] is read as: a calibration, the topic of one, or all that is known of a camera without one."""
    table = data.get("camera")
    keys = set(table) if isinstance(table, dict) else set()
    if keys == {"scale_sd"}:
        return entries.UncalibratedEntry
    return entries.CameraInfoEntry if "camera_info" in keys else entries.CameraEntry


def is_clicked(data: dict[str, Any]) -> bool:
    """Whether a person clicked along the body in photos, which then need no tag."""
    return isinstance(data.get("photos"), dict) and "clicks" in data["photos"]


def check_top(data: dict[str, Any], mistakes: schema.Mistakes) -> None:
    """The tables and keys at the top of the file."""
    schema.report_unknown(data, ["format", "name", *TABLES, "frequencies", "points"], (), mistakes)
    if data.get("format") != FORMAT:
        mistakes.add(("format",), f"format must be {FORMAT}. Write `format = {FORMAT}` at the top.")
    if not isinstance(data.get("name", ""), str) or len(data.get("name", "")) > schema.LONGEST_KEY:
        text = f"name must be text in quotes of at most {schema.LONGEST_KEY} characters, not {quoted(data['name'])}."
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


def read_beam(table: Any, mistakes: schema.Mistakes) -> entries.BeamEntry | None:
    """[beam] with the masses that ride on it."""
    rows = table.get("masses", []) if isinstance(table, dict) else []
    if not isinstance(rows, list):
        text = "[beam] masses must be tables: `[[beam.masses]]` with s and mass_kg, one each."
        mistakes.add(("beam", "masses"), text)
        rows = []
    masses = schema.read_rows(entries.MassEntry, rows, ("beam", "masses"), mistakes)
    return schema.read_table(entries.BeamEntry, table, ("beam",), mistakes, masses=masses)


def read_frequencies(rows: Any, mistakes: schema.Mistakes) -> tuple[entries.FrequencyEntry, ...]:
    """The [[frequencies]] of a file."""
    if not isinstance(rows, list) or not 0 < len(rows) <= entries.MOST_FREQUENCIES:
        text = f"Give 1 to {entries.MOST_FREQUENCIES} tables [[frequencies]], each with hz and sd_hz."
        mistakes.add(("frequencies",), text)
        return ()
    read = [schema.read_table(entries.FrequencyEntry, row, ("frequencies", i), mistakes) for i, row in enumerate(rows)]
    seen: set[tuple[int, str, float]] = set()
    for i, one in enumerate(read):
        if one is None:
            continue
        place, posture = ("frequencies", i), (one.mode, f"{one.base_angle}", one.tip_mass)
        if one.mode > entries.MOST_MODE:
            mistakes.add(
                (*place, "mode"), f"mode is {one.mode}; modes 1 to {entries.MOST_MODE} of a slender beam are known."
            )
        if one.sd >= one.hz:
            mistakes.add((*place, "sd_hz"), f"sd_hz = {one.sd:g} is no smaller than hz = {one.hz:g}. Are they swapped?")
        if posture in seen:
            text = f"mode {one.mode} is given twice for one posture and tip mass. Give their mean, with its sd."
            mistakes.add((*place, "mode"), text)
        seen.add(posture)
    return tuple(one for one in read if one is not None)


def read_tags(
    table: Any, mistakes: schema.Mistakes, *, pictures: bool, bare: bool = False, points: Any = None
) -> entries.TagsEntry | None:
    """[tags] with its two lists; where no camera looks (`pictures`), size and base tags may be missing, and where the
    body may be `bare` those on it. `points`: the list [[points]] in place of [[tags.on_beam]]."""
    if not isinstance(table, dict):
        mistakes.add(("tags",), f"[tags] must be a table, not {quoted(table)}.")
        return None
    lists: dict[str, tuple[entries.TagEntry, ...]] = {}
    if points is not None and "on_beam" in table:
        mistakes.add(("points",), "The file has [[points]] and [[tags.on_beam]]. Write all of them as [[points]].")
    for group, what in (("on_base", "on the clamp, the origin of all measures"), ("on_beam", "along the beam")):
        rows = table.get(group, [])
        place: schema.Place = ("tags", group)
        if group == "on_beam" and points is not None:
            rows, place = points, ("points",)
        may_lack = bare if group == "on_beam" else not pictures
        if not isinstance(rows, list) or not (rows or may_lack):
            mistakes.add(place, f"[tags] needs at least one [[{'.'.join(map(str, place))}]] with its id: a tag {what}.")
            rows = []
        if len(rows) > entries.MOST_TAGS:
            mistakes.add(
                place, f"[[tags.{group}]] lists {len(rows)} tags; at most {entries.MOST_TAGS} can be followed."
            )
            rows = []
        if group == "on_base":  # on the clamp, where s = 0, unless it is said otherwise
            rows = [{"s": 0.0} | row if isinstance(row, dict) else row for row in rows]
        lists[group] = schema.read_rows(entries.TagEntry, rows, place, mistakes)
    check_ids(lists, table.get("family", entries.FAMILIES[0]) if pictures else None, mistakes)
    if pictures and "size_m" not in table:
        mistakes.add(("tags",), "[tags] lacks size_m: the side of the tag's black square, m, for example 0.012.")
    return schema.read_table(entries.TagsEntry, table, ("tags",), mistakes, **lists)


def check_ids(lists: dict[str, tuple[entries.TagEntry, ...]], family: object, mistakes: schema.Mistakes) -> None:
    """Note every id that is given twice, or that the family of the tags does not have."""
    count = entries.FAMILY_SIZES.get(family, math.inf) if isinstance(family, str) else math.inf
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


def check_together(tables: dict[str, Any], data: dict[str, Any], mistakes: schema.Mistakes) -> None:
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


def remarks_on(tags: entries.TagsEntry, data: dict[str, Any]) -> tuple[Remark, ...]:
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


def implausible(
    beam: entries.BeamEntry, tags: entries.TagsEntry, tables: dict[str, Any], scale_sd: float
) -> tuple[Remark, ...]:
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


def camera_remarks(camera: entries.CameraEntry) -> list[Remark]:
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


def check_same_beam(wanted: Sequence[entries.Recording], *, jointly: bool) -> None:
    """`LearningError` where the recordings cannot be learned from together; `jointly`: by a method that takes
    several."""
    first = wanted[0]
    if not jointly and len(wanted) > 1:
        raise LearningError("the regression learns from one recording; give one, or learn from all with the fit")
    for i, one in enumerate(wanted[1:], start=1):
        if any(one.folder.resolve() == other.folder.resolve() for other in wanted[:i]):
            raise LearningError(f"{one.folder} is given twice: the same data would count as two pushes. Give it once")
        if abs(one.beam.length - first.beam.length) > 1e-9 or _ids(one) != _ids(first):
            raise LearningError(
                f"{one.folder} is not of the beam of {first.folder}: {1000 * one.beam.length:.4g} mm with tags "
                f"{_ids(one)}, against {1000 * first.beam.length:.4g} mm with tags {_ids(first)}. Learn from "
                "recordings of one beam, or correct length_m and the tags"
            )
        for tag, same in zip(one.tags.on_beam, first.tags.on_beam, strict=True):
            away = abs(tag.s - same.s) * first.beam.length
            # Placement tolerances: written places of one tag that differ by more are a mistake.
            if away > 4.0 * max(one.tags.placement_sd, first.tags.placement_sd, 1e-6):
                raise LearningError(
                    f"tag {tag.id} is at s = {tag.s:.4g} in {one.folder} and at s = {same.s:.4g} in {first.folder}. "
                    "Recordings that are learned from together need the same tags in the same places"
                )


def _ids(one: entries.Recording) -> list[int]:
    return [tag.id for tag in one.tags.on_beam]


def check_same_length(length: float, description: entries.Recording) -> None:
    """Raises `ObservationError` where the recording is not of a beam of that length [m]."""
    # Of the length: a larger difference is another beam, or a wrong length_m.
    if abs(description.beam.length - length) > 0.01 * length:
        raise ObservationError(
            f"{description.folder}: its beam is {1000 * description.beam.length:.4g} mm long, the learned one "
            f"{1000 * length:.4g} mm. Validate on recordings of the same beam, or correct length_m"
        )


RECTIFIED = "image_rect"  # how the name of a topic of rectified pictures begins
POLYNOMIAL, RATIONAL = "plumb_bob", "rational_polynomial"
OTHERWISE = "Calibrate with `onebend calibrate`, or remove camera_info: then the camera is inferred from the tags."


def known_camera(
    camera: entries.CameraEntry | entries.CameraInfoEntry | None,
    video: entries.VideoEntry | None,
    mistakes: schema.Mistakes,
) -> tuple[entries.CameraEntry | None, tuple[Remark, ...]]:
    """The camera of `recording.toml`, or of a topic of the film's bag; what is wrong goes to `mistakes`."""
    if not isinstance(camera, entries.CameraInfoEntry):
        return camera, ()
    if mistakes.found:
        return None, ()
    try:
        return camera_in_bag(camera, video)
    except RecordingError as wrong:
        mistakes.add(("camera", "camera_info"), str(wrong))
        return None, ()


def camera_in_bag(
    entry: entries.CameraInfoEntry, video: entries.VideoEntry | None
) -> tuple[entries.CameraEntry, tuple[Remark, ...]]:
    """The calibration that `entry` names, for the pictures of `video`, and what is to be said of it."""
    if video is None or not video.topic:
        raise RecordingError(
            "[camera] camera_info names a topic, and the film is in no bag. Write width, height, fx, fy, cx, cy, dist."
        )
    info = bag_camera(video, entry.topic)
    rectified = video.topic.removesuffix("/compressed").rpartition("/")[2].startswith(RECTIFIED)
    matrix = checked_matrix(info, video, info.rectified if rectified else info.matrix)
    if rectified:
        dist, words = np.zeros(5), f"{video.topic} is taken as rectified: its matrix P, and no lens"
    else:
        dist, words = lens_of(info, video)
    shown = picture_size(video)
    if shown != (info.width, info.height):
        raise RecordingError(
            f"[camera] camera_info: {info.topic} is of pictures of {info.width} x {info.height}, {video.topic} of "
            f"{video.file} has {shown[0]} x {shown[1]}. Record the picture that was calibrated. {OTHERWISE}"
        )
    remark = Remark("note", f"The camera is that of {info.topic}: {words}.")
    (fx, fy), (cx, cy) = np.diag(matrix)[:2].tolist(), matrix[:2, 2].tolist()
    return entries.CameraEntry(info.width, info.height, fx, fy, cx, cy, tuple(dist.tolist()), entry.scale_sd), (remark,)


def checked_matrix(info: CameraInfo, video: entries.VideoEntry, matrix: Array) -> Array:
    """The matrix, if it is one of a camera."""
    place = f"[camera] camera_info: {info.topic} of {video.file}"
    if not matrix[0, 0] > 0.0 or not matrix[1, 1] > 0.0 or info.width < 1 or info.height < 1:
        raise RecordingError(f"{place} is not calibrated: its focal length or size is zero. {OTHERWISE}")
    if abs(matrix[0, 1]) > 1e-6 * matrix[0, 0]:
        raise RecordingError(f"{place} has oblique axes (K[1] = {matrix[0, 1]:g}), which are not modelled. {OTHERWISE}")
    return matrix


def lens_of(info: CameraInfo, video: entries.VideoEntry) -> tuple[Array, str]:
    """k1, k2, p1, p2, k3, and words on where they come from."""
    place, count = f"[camera] camera_info: {info.topic} of {video.file}", len(info.lens)
    if info.model in (POLYNOMIAL, "") and count == 0:
        return np.zeros(5), "it says nothing of a lens, and none is assumed"
    counts = {POLYNOMIAL: (4, 5), RATIONAL: (8,)}
    if info.model not in counts:
        raise RecordingError(
            f"{place}: the lens model {quoted(info.model)} is not known; {', '.join(counts)} are. Record rectified "
            f"pictures (image_rect). {OTHERWISE}"
        )
    if count not in counts[info.model]:
        wanted = " or ".join(map(str, counts[info.model]))
        raise RecordingError(f"{place}: D has {count} numbers; {info.model} has {wanted}. {OTHERWISE}")
    if info.lens[5:].any():
        raise RecordingError(f"{place}: its lens has k4 to k6, which are not modelled. Record image_rect. {OTHERWISE}")
    return np.append(info.lens, 0.0)[:5], f"lens {info.model}"


FILE_NAME = "recording.toml"
BAGS = ("video", "force")  # whose file may be a bag
PATHS = ("file", "frame_times", "base_angle_file", "mass_file", "section_file", "loads", "clicks", "folder")
CLAMP_ALONE = entries.TagsEntry(on_beam=(entries.TagEntry(id=0, s=0.0),))  # what is known where nothing is looked at
LINE_NAMED = re.compile(r"\bline (\d+)\b")  # in what is said of text that is no TOML


@dataclass(frozen=True)
class TextCheck:
    """What is wrong with the text of a `recording.toml`, and what could be read of it."""

    mistakes: tuple[tuple[int, str], ...]  # line (from 1) and what is wrong there, by lines
    remarks: tuple[Remark, ...]  # none where there are mistakes
    data: Mapping[str, Any]  # as TOML has it; empty where the text is none


def folder_of(path: Path | str) -> Path:
    """The folder of a recording that is named by its `recording.toml` or by itself."""
    path = Path(path)
    return path.parent if path.name == FILE_NAME and not path.is_dir() else path


def read_recording(
    folder: Path | str, stated: Mapping[tuple[str, str], Any] = MappingProxyType({}), *, filmed: bool = True
) -> entries.Recording:
    """Read and check `recording.toml` of `folder` (or that file itself), and that the files it names exist.

    `stated` are values by table and key, in the file's units, that replace those in the file. With `filmed` False the
    film and the force log need not be there yet.

    Raises:
        RecordingError: everything that is wrong, each with its line and what to do.
    """
    folder = folder_of(folder)
    content, data = load(folder)
    for (table, name), value in stated.items():
        if isinstance(data.setdefault(table, {}), dict):  # what is no table is a mistake, which is told below
            data[table][name] = value
    mistakes = schema.Mistakes(str(folder / FILE_NAME), content, HOMES)
    rec = _described(folder, data, mistakes, filmed=filmed, bags=filmed)
    if rec is None:
        raise RecordingError(str(mistakes))
    return with_bags(rec, data) if filmed else rec


def check_text(folder: Path, content: str) -> TextCheck:
    """Check a `recording.toml` without writing it, quickly; bags are not opened. Empty keys do not stop the check."""
    empty = empty_values(content)
    rows = content.splitlines()
    for _, line, _ in empty:
        rows[line - 1] = ""
    mistakes = schema.Mistakes(FILE_NAME, content, HOMES)
    rec, data = None, {}
    try:
        data = toml_data("\n".join(rows), Path(FILE_NAME), RecordingError)
        rec = _described(folder, data, mistakes, filmed=True, bags=False)
    except RecordingError as wrong:
        named = LINE_NAMED.search(str(wrong))
        mistakes.found.append((int(named[1]) if named else max(1, len(rows)), str(wrong)))
    told = [(line, words) for _, line, words in empty]
    told += [one for one in mistakes.found if not _follows(one[1], empty)]
    remarks = rec.remarks if rec is not None and not told else ()
    return TextCheck(tuple(sorted(told)), remarks, MappingProxyType(data))


def _follows(words: str, empty: list[tuple[schema.Place, int, str]]) -> bool:
    """Whether this mistake only says again that a key is empty."""
    tables = [(schema.place_name(place[:-1]), place[-1]) for place, _, _ in empty]
    return any(words.startswith((f"{table} lacks {key}:", f"{table} needs either ")) for table, key in tables)


def _described(
    folder: Path, data: dict[str, Any], mistakes: schema.Mistakes, *, filmed: bool, bags: bool
) -> entries.Recording | None:
    """The recording that `data` describes, or None with the reasons in `mistakes`; `bags`: look into them too."""
    check_top(data, mistakes)
    swung = read_frequencies(data["frequencies"], mistakes) if "frequencies" in data else ()
    tags: entries.TagsEntry | None = entries.TagsEntry() if any(name in data for name in SOURCES) else CLAMP_ALONE
    if "tags" in data or "points" in data:
        outline, pictures = data.get("outline"), "video" in data or "photos" in data
        bare = not (isinstance(outline, dict) and outline.get("use") is False)
        tags = read_tags(data.get("tags", {}), mistakes, pictures=pictures, bare=bare, points=data.get("points"))
    beam = read_beam(data["beam"], mistakes) if "beam" in data else None
    sections = {
        name: schema.read_table(record, data[name], (name,), mistakes) if name in data else None
        for name, record in (SECTIONS | {"camera": camera_record(data)}).items()
    }
    scale_sd = math.nan if sections["camera"] is None else sections["camera"].scale_sd
    if isinstance(sections["camera"], entries.UncalibratedEntry):
        sections["camera"] = None
    beam = with_paths(beam, "beam", folder, mistakes)
    to_come = () if filmed else BAGS
    tables = {name: with_paths(entry, name, folder, mistakes, name in to_come) for name, entry in sections.items()}
    check_together(tables, data, mistakes)
    if not mistakes.found and bags:
        for name in BAGS:
            if tables[name] is not None:
                check_bag(name, tables[name], data[name], mistakes)
    if isinstance(tables["camera"], entries.CameraInfoEntry) and not bags and filmed:
        tables["camera"] = None
    tables["camera"], camera_remarks = known_camera(tables["camera"], tables["video"], mistakes)
    if mistakes.found or beam is None or tags is None:
        return None
    return entries.Recording(
        folder=folder,
        name=data.get("name", folder.resolve().name),
        beam=beam,
        tags=tags,
        remarks=(
            *(remarks_on(tags, data) if "tags" in data else ()),
            *camera_remarks,
            *implausible(beam, tags, tables, scale_sd),
        ),
        scale_sd=scale_sd,
        frequencies=swung,
        **tables,
    )


def load(folder: Path) -> tuple[str, dict[str, Any]]:
    """Text and data of the folder's `recording.toml`."""
    path = folder / FILE_NAME
    if not folder.is_dir():
        raise RecordingError(f"{folder} is not a folder. Give the folder that holds {FILE_NAME}.")
    if not path.is_file():
        raise RecordingError(f"{folder} holds no {FILE_NAME}. Write one with `onebend new {folder}` and fill it in.")
    try:
        return read_toml(path, RecordingError)
    except RecordingError:
        if empty := empty_values(read_text(path, RecordingError, most=MOST_TOML)):
            raise RecordingError("\n".join(f"{path}:{line}: {words}" for _, line, words in empty)) from None
        raise


def with_paths(entry: Any, name: str, folder: Path, mistakes: schema.Mistakes, to_come: bool = False) -> Any:
    """`entry` with the files it names made whole paths; each must exist, but for those `to_come`."""
    if entry is None:
        return None
    for field_name in PATHS:
        written = getattr(entry, field_name, None)
        if written is None or (field_name == "frame_times" and written == "container"):
            continue
        path = folder / written
        wants_folder = field_name == "folder"
        exists = path.is_dir() if wants_folder else path.is_file() or (name in BAGS and is_bag(path))
        if not exists and not to_come:
            what, other = "folder" if wants_folder else "file", "" if wants_folder else _no_file(path)
            names = [item.name for item in folder.iterdir() if item.name != path.name]
            similar = difflib.get_close_matches(str(written), names, n=1)
            hint = f"Did you mean {similar[0]}?" if similar else "Put it there, or correct the name."
            shown = ascii_only(str(path))
            said = f"{shown} is {other}, and no file." if other else f"there is no {what} {shown}."
            mistakes.add((name, field_name), f"[{name}] {field_name}: {said} {hint}")
        entry = replace(entry, **{field_name: path})
    if isinstance(entry, entries.VideoEntry | entries.MarkersEntry) and math.isnan(entry.start):
        entry = replace(entry, start_uncertainty=math.inf)
    return entry


def _no_file(path: Path) -> str:
    """The kind of thing that is there in place of a file; empty where nothing is."""
    if path.is_symlink() and not os.path.exists(path):  # noqa: PTH110  (`Path.exists` raises on a circle of links)
        return "a link that leads nowhere"
    kinds = {"folder": path.is_dir, "pipe": path.is_fifo, "device": path.is_char_device, "socket": path.is_socket}
    return next((f"a {kind}" for kind, stands in kinds.items() if stands()), "")
