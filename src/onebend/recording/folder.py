"""A recording on disk: a folder with `recording.toml`, read and checked."""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from onebend.errors import RecordingError
from onebend.recording.bags.reader import is_bag
from onebend.recording.bags.recorded_topics import check_bag, with_bags
from onebend.recording.camera.bag_calibration import known_camera
from onebend.recording.toml.description import (
    HOMES,
    SECTIONS,
    camera_record,
    check_together,
    check_top,
    empty_values,
    read_beam,
    read_tags,
    remarks_on,
)
from onebend.recording.toml.entries import Recording, TagEntry, TagsEntry
from onebend.recording.toml.frequency_entry import read_frequencies
from onebend.recording.toml.implausible_entries import entry_remarks, spread_remarks, unit_remarks
from onebend.recording.toml.schema import Mistakes, Place, place_name, read_table
from onebend.recording.toml.source_entries import CameraInfoEntry, MarkersEntry, UncalibratedEntry, VideoEntry
from onebend.records import Remark
from onebend.text_files import MOST_TOML, ascii_only, read_text, read_toml, toml_data

FILE_NAME = "recording.toml"
BAGS = ("video", "force")  # whose file may be a bag
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

    Args:
        stated: values by table and key, in the file's units, that take the place of those in the file.
        filmed: False: film and force log are still to be made, so that their files need not be there.

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
    """Check the text of a `recording.toml` for this folder, without writing it; quick enough for every key pressed.

    The files that it names must exist. What stands in bags is not looked at. Keys that are still empty do not keep the
    others from being checked.
    """
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
    tags: TagsEntry | None = CLAMP_ALONE
    if "tags" in data:
        tags = read_tags(data["tags"], mistakes, pictures="video" in data or "photos" in data)
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
            *entry_remarks(beam, entries["camera"]),
            *spread_remarks(beam, entries, scale_sd),
            *unit_remarks(beam, tags, entries),
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
    for field_name in (
        "file",
        "frame_times",
        "base_angle_file",
        "mass_file",
        "section_file",
        "loads",
        "folder",
        "definitions",
    ):
        written = getattr(entry, field_name, None)
        if written is None or (field_name == "frame_times" and written == "container"):
            continue
        path = folder / written
        wants_folder = field_name in ("folder", "definitions")
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
    """What stands there in place of a file; empty where nothing does."""
    if path.is_symlink() and not os.path.exists(path):  # noqa: PTH110  (`Path.exists` raises on a circle of links)
        return "a link that leads nowhere"
    kinds = {
        "a folder": path.is_dir,
        "a pipe": path.is_fifo,
        "a device": path.is_char_device,
        "a socket": path.is_socket,
    }
    return next((kind for kind, stands in kinds.items() if stands()), "")
