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
from onebend.recording.bag_topics import CameraInfo, bag_camera, check_bag, picture_size, with_bags
from onebend.recording.bags import is_bag
from onebend.recording.camera import equidistant, nearest_lens, rational
from onebend.recording.description import (
    HOMES,
    SECTIONS,
    SOURCES,
    camera_record,
    check_together,
    check_top,
    empty_values,
    implausible,
    read_beam,
    read_frequencies,
    read_tags,
    remarks_on,
)
from onebend.recording.entries import (
    CameraEntry,
    CameraInfoEntry,
    MarkersEntry,
    Recording,
    TagEntry,
    TagsEntry,
    UncalibratedEntry,
    VideoEntry,
)
from onebend.recording.schema import Mistakes, Place, place_name, read_table
from onebend.records import Array, Remark
from onebend.text_files import MOST_TOML, ascii_only, quoted, read_text, read_toml, toml_data


def check_same_beam(wanted: Sequence[Recording], *, jointly: bool) -> None:
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


def _ids(one: Recording) -> list[int]:
    return [tag.id for tag in one.tags.on_beam]


def check_same_length(length: float, description: Recording) -> None:
    """Raises `ObservationError` where the recording is not of a beam of that length [m]."""
    # Of the length: a larger difference is another beam, or a wrong length_m.
    if abs(description.beam.length - length) > 0.01 * length:
        raise ObservationError(
            f"{description.folder}: its beam is {1000 * description.beam.length:.4g} mm long, the learned one "
            f"{1000 * length:.4g} mm. Validate on recordings of the same beam, or correct length_m"
        )


RECTIFIED = "image_rect"  # how the name of a topic of rectified pictures begins
POLYNOMIAL, RATIONAL, FISHEYE = "plumb_bob", "rational_polynomial", ("equidistant", "fisheye")
OTHERWISE = "Calibrate with `onebend calibrate`, or remove camera_info: then the camera is inferred from the tags."


def known_camera(
    camera: CameraEntry | CameraInfoEntry | None, video: VideoEntry | None, mistakes: Mistakes
) -> tuple[CameraEntry | None, tuple[Remark, ...]]:
    """The camera of `recording.toml`, or of a topic of the film's bag; what is wrong goes to `mistakes`."""
    if not isinstance(camera, CameraInfoEntry):
        return camera, ()
    if mistakes.found:
        return None, ()
    try:
        return camera_in_bag(camera, video)
    except RecordingError as wrong:
        mistakes.add(("camera", "camera_info"), str(wrong))
        return None, ()


def camera_in_bag(entry: CameraInfoEntry, video: VideoEntry | None) -> tuple[CameraEntry, tuple[Remark, ...]]:
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
    matrix, changed = of_part(info, matrix)
    width, height = (info.part[0] // info.binning[0], info.part[1] // info.binning[1])
    shown = picture_size(video)
    if shown != (width, height):
        raise RecordingError(
            f"[camera] camera_info: {info.topic} is of pictures of {width} x {height}, {video.topic} of {video.file} "
            f"has {shown[0]} x {shown[1]}. Record the picture that was calibrated. {OTHERWISE}"
        )
    remark = Remark("note", f"The camera is that of {info.topic}: {words}{changed}.")
    (fx, fy), (cx, cy) = np.diag(matrix)[:2].tolist(), matrix[:2, 2].tolist()
    return CameraEntry(width, height, fx, fy, cx, cy, tuple(dist.tolist()), entry.scale_sd), (remark,)


def checked_matrix(info: CameraInfo, video: VideoEntry, matrix: Array) -> Array:
    """The matrix, if it is one of a camera."""
    place = f"[camera] camera_info: {info.topic} of {video.file}"
    if not matrix[0, 0] > 0.0 or not matrix[1, 1] > 0.0 or info.width < 1 or info.height < 1:
        raise RecordingError(f"{place} is not calibrated: its focal length or size is zero. {OTHERWISE}")
    if abs(matrix[0, 1]) > 1e-6 * matrix[0, 0]:
        raise RecordingError(f"{place} has oblique axes (K[1] = {matrix[0, 1]:g}), which are not modelled. {OTHERWISE}")
    return matrix


def lens_of(info: CameraInfo, video: VideoEntry) -> tuple[Array, str]:
    """k1, k2, p1, p2, k3, and words on where they come from."""
    place, count = f"[camera] camera_info: {info.topic} of {video.file}", len(info.lens)
    if info.model in (POLYNOMIAL, "") and count == 0:
        return np.zeros(5), "it says nothing of a lens, and none is assumed"
    counts = {POLYNOMIAL: (4, 5), RATIONAL: (8,)} | dict.fromkeys(FISHEYE, (4,))
    if info.model not in counts:
        raise RecordingError(
            f"{place}: the lens model {quoted(info.model)} is not known; {', '.join(counts)} are. {OTHERWISE}"
        )
    if count not in counts[info.model]:
        wanted = " or ".join(map(str, counts[info.model]))
        raise RecordingError(f"{place}: D has {count} numbers; {info.model} has {wanted}. {OTHERWISE}")
    if info.model == POLYNOMIAL:
        return np.append(info.lens, 0.0)[:5], f"lens {info.model}"
    if info.model == RATIONAL and not info.lens[5:].any():
        return info.lens[:5], f"lens {info.model}, without k4 to k6"
    lens = rational(info.lens) if info.model == RATIONAL else equidistant(info.lens)
    dist, worst = nearest_lens(lens, info.matrix, (info.width, info.height))
    if not worst <= 0.1:  # px: a lens of another model that ours meets so nearly is taken as ours
        how = f"miss it by up to {worst:.2g} px" if np.isfinite(worst) else "cannot follow it to the picture's edges"
        raise RecordingError(
            f"{place}: its lens is {info.model}, and k1, k2, p1, p2, k3 {how}. Record rectified pictures (image_rect), "
            f"or take a lens that bends less. {OTHERWISE}"
        )
    return dist, f"lens {info.model} as k1, k2, p1, p2, k3, which meet it to {worst:.2g} px"


def of_part(info: CameraInfo, matrix: Array) -> tuple[Array, str]:
    """The matrix for the part of the sensor that was recorded and its binning, and words on both."""
    bins, corner = np.array(info.binning, dtype=float), np.array(info.corner, dtype=float)
    made = matrix.copy()
    made[:2, 2] = (matrix[:2, 2] - corner + 0.5) / bins - 0.5
    made[[0, 1], [0, 1]] = np.diag(matrix)[:2] / bins
    words = ""
    if info.part != (info.width, info.height) or corner.any():
        words += f"; the part of {info.part[0]} x {info.part[1]} px from {info.corner[0]}, {info.corner[1]} on"
    if info.binning != (1, 1):
        words += f"; {info.binning[0]} x {info.binning[1]} pixels binned"
    return made, words


FILE_NAME = "recording.toml"
BAGS = ("video", "force")  # whose file may be a bag
FOLDERS = ("folder", "definitions")  # keys that name folders
PATHS = ("file", "frame_times", "base_angle_file", "mass_file", "section_file", "loads", "clicks", *FOLDERS)
CLAMP_ALONE = TagsEntry(on_beam=(TagEntry(id=0, s=0.0),))  # what is known where nothing is looked at
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
) -> Recording:
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
    mistakes = Mistakes(str(folder / FILE_NAME), content, HOMES)
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
    mistakes = Mistakes(FILE_NAME, content, HOMES)
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


def _follows(words: str, empty: list[tuple[Place, int, str]]) -> bool:
    """Whether this mistake only says again that a key is empty."""
    tables = [(place_name(place[:-1]), place[-1]) for place, _, _ in empty]
    return any(words.startswith((f"{table} lacks {key}:", f"{table} needs either ")) for table, key in tables)


def _described(folder: Path, data: dict[str, Any], mistakes: Mistakes, *, filmed: bool, bags: bool) -> Recording | None:
    """The recording that `data` describes, or None with the reasons in `mistakes`; `bags`: look into them too."""
    check_top(data, mistakes)
    swung = read_frequencies(data["frequencies"], mistakes) if "frequencies" in data else ()
    tags: TagsEntry | None = TagsEntry() if any(name in data for name in SOURCES) else CLAMP_ALONE
    if "tags" in data or "points" in data:
        outline, pictures = data.get("outline"), "video" in data or "photos" in data
        bare = not (isinstance(outline, dict) and outline.get("use") is False)
        tags = read_tags(data.get("tags", {}), mistakes, pictures=pictures, bare=bare, points=data.get("points"))
    beam = read_beam(data["beam"], mistakes) if "beam" in data else None
    sections = {
        name: read_table(record, data[name], (name,), mistakes) if name in data else None
        for name, record in (SECTIONS | {"camera": camera_record(data)}).items()
    }
    scale_sd = math.nan if sections["camera"] is None else sections["camera"].scale_sd
    if isinstance(sections["camera"], UncalibratedEntry):
        sections["camera"] = None
    beam = with_paths(beam, "beam", folder, mistakes)
    to_come = () if filmed else BAGS
    entries = {name: with_paths(entry, name, folder, mistakes, name in to_come) for name, entry in sections.items()}
    check_together(entries, data, mistakes)
    if not mistakes.found and bags:
        for name in BAGS:
            if entries[name] is not None:
                check_bag(name, entries[name], data[name], mistakes)
    if isinstance(entries["camera"], CameraInfoEntry) and not bags and filmed:
        entries["camera"] = None
    entries["camera"], camera_remarks = known_camera(entries["camera"], entries["video"], mistakes)
    if mistakes.found or beam is None or tags is None:
        return None
    return Recording(
        folder=folder,
        name=data.get("name", folder.resolve().name),
        beam=beam,
        tags=tags,
        remarks=(
            *(remarks_on(tags, data) if "tags" in data else ()),
            *camera_remarks,
            *implausible(beam, tags, entries, scale_sd),
        ),
        scale_sd=scale_sd,
        frequencies=swung,
        **entries,
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


def with_paths(entry: Any, name: str, folder: Path, mistakes: Mistakes, to_come: bool = False) -> Any:
    """`entry` with the files it names made whole paths; each must exist, but for those `to_come`."""
    if entry is None:
        return None
    for field_name in PATHS:
        written = getattr(entry, field_name, None)
        if written is None or (field_name == "frame_times" and written == "container"):
            continue
        path = folder / written
        wants_folder = field_name in FOLDERS
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
    if isinstance(entry, VideoEntry | MarkersEntry) and math.isnan(entry.start):
        entry = replace(entry, start_uncertainty=math.inf)
    return entry


def _no_file(path: Path) -> str:
    """The kind of thing that is there in place of a file; empty where nothing is."""
    if path.is_symlink() and not os.path.exists(path):  # noqa: PTH110  (`Path.exists` raises on a circle of links)
        return "a link that leads nowhere"
    kinds = {"folder": path.is_dir, "pipe": path.is_fifo, "device": path.is_char_device, "socket": path.is_socket}
    return next((f"a {kind}" for kind, stands in kinds.items() if stands()), "")
