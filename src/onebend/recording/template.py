"""A `recording.toml` to fill in, with all that the files beside it tell already."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from onebend.errors import OnebendError, RecordingError, ResultsError
from onebend.files.single_file import FILMS, LOGS, write_file
from onebend.recording import entries
from onebend.recording.folder import FILE_NAME, FORMAT, SECTIONS
from onebend.recording.force_log import OTHER_TIME, TIMES, likely_forces, unit_in_name
from onebend.recording.schema import keys_of
from onebend.text_files import csv_rows, to_json

if TYPE_CHECKING:
    from onebend.recording.tag_finder import Sighting
    from onebend.recording.video import FilmFrame

Kind = Literal["video", "ros", "photo", "photos", "weights", "mocap"]
TO_FILL_IN = ""  # what only the experimenter knows
CAMERA = "Optional: the camera's calibration. Without it, the tags' known size gives the scale."
GRAVITY = "Optional: only where the beam's weight acts in the plane it bends in (not for a beam lying on its side)."
FREQUENCIES = "Optional: how fast it swings, clamped as here; one such table for each frequency."
PICTURES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp")
STUBS = {"poses.csv": "pose,id,x_m,y_m\n", "loads.csv": "pose,s,mass_kg\n", "clicks.csv": "pose,x_px,y_px\n"}
TIME_NAME = re.compile(r"^(time|timestamp|stamp|t)([_ \[(/].*)?$", re.IGNORECASE)
FIRST_ROWS = 1000  # of tracks, in which every marker is
STILL, STILL_TIMES = 1.0, 2.0  # px RMS, besides so many times the stillest tag's motion: camera and clamp may shake


@dataclass(frozen=True)
class FoundInFiles:
    """What files tell of a recording: keys with their values as TOML by table, ids of tags, whether there are none on
    the beam, and what to know of it."""

    values: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    base: tuple[int, ...] = ()
    beam: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    bare: bool = False

    def __add__(self, other: FoundInFiles) -> FoundInFiles:
        values = {name: {**self.values.get(name, {}), **table} for name, table in other.values.items()}
        ids = self.base or other.base, self.beam or other.beam
        return FoundInFiles({**self.values, **values}, *ids, (*self.notes, *other.notes), self.bare or other.bare)


def write_template(
    folder: Path | str, kind: Kind = "video", found: FoundInFiles = FoundInFiles(), *, everything: bool = False
) -> Path:
    """Write a `recording.toml` to fill in into `folder` (made if need be), and for hand readings and photos tables to
    fill in; return its path. `everything`: with all optional keys, commented out.

    Raises:
        RecordingError: the folder holds one already, or cannot be written.
    """
    path = Path(folder) / FILE_NAME
    if path.exists():
        raise RecordingError(f"{path} exists already. Edit it, or name another folder.")
    found = found_in_folder(path.parent, kind) + found
    try:
        write_file(path, template(kind, found, everything=everything))
        for name, content in _stubs(path.parent, kind).items():
            if not (path.parent / name).exists():
                write_file(path.parent / name, content)
    except ResultsError as wrong:
        raise RecordingError(str(wrong)) from None
    return path


def _stubs(folder: Path, kind: Kind) -> dict[str, str]:
    if kind == "weights":
        return {"poses.csv": f"{STUBS['poses.csv']}bare,1,,\n", "loads.csv": f"{STUBS['loads.csv']}bare,,\n"}
    if kind not in ("photo", "photos"):
        return {}
    photos = sorted(one.name for one in folder.glob("photos/*") if one.suffix.lower() in PICTURES)
    rows = "".join(f"{name},,\n" for name in photos if "," not in name)
    return {name: STUBS[name] + rows for name in ("loads.csv", *(["clicks.csv"] if kind == "photo" else []))}


def found_in_folder(folder: Path, kind: Kind) -> FoundInFiles:
    """What the film, the force log or the tracks in a folder tell; nothing where there are several that it may be."""
    found = FoundInFiles()
    tables = {"video": (("video", FILMS), ("force", LOGS)), "mocap": (("markers", LOGS), ("force", LOGS))}
    for table, endings in tables.get(kind, ()):
        names = [one for one in sorted(folder.glob("[!.]*")) if one.suffix.lower() in endings and one.is_file()]
        if kind == "mocap":
            names = [one for one in names if one.stem == table]
        if len(names) != 1 or not names[0].name.isprintable():
            continue
        read = {"video": found_in_film, "force": found_in_log, "markers": found_in_tracks}[table]
        found += FoundInFiles({table: {"file": to_json(names[0].name)}})
        try:
            found += read(names[0])
        except OnebendError as wrong:
            found += FoundInFiles(notes=(str(wrong),))
    return found


def found_in_film(path: Path) -> FoundInFiles:
    """Frame rate, date and tags. Those that stand still are on the base, the others follow by their distance."""
    from onebend.recording.preview import LOOKS, spread_frames  # here: without a film nothing decodes one
    from onebend.recording.video import opened

    frames, _, whole = spread_frames(entries.VideoEntry(file=path), LOOKS)
    height, width = frames[0].luma.shape
    with opened(path) as container:
        made = str(container.metadata.get("creation_time", ""))[:10]
    date = made or datetime.fromtimestamp(path.stat().st_mtime, UTC).strftime("%Y-%m-%d")
    rate = frames[-1].index / frames[-1].time if frames[-1].time > 0.0 else float("nan")
    seconds = f"{'' if whole else 'more than '}{frames[-1].time:.3g} s"
    note = f"{path.name}: {date}, {seconds}, {rate:.4g} frames a second, {width} x {height}"
    family, sightings = _tags_in(frames)
    places: dict[int, list[np.ndarray]] = {}
    for tag in (tag for seen in sightings for tag in seen):
        places.setdefault(tag.tag_id, []).append(tag.corners.mean(axis=0))
    middle = {tag: np.mean(where, axis=0) for tag, where in places.items() if 2 * len(where) >= len(frames)}
    if not middle:
        return FoundInFiles(notes=(f"{note}; no tag in it",))
    motion = {tag: float(np.std(places[tag], axis=0).sum()) for tag in middle}
    base = sorted(tag for tag in middle if motion[tag] < STILL + STILL_TIMES * min(motion.values()))
    beam = sorted(middle.keys() - {*base}, key=lambda tag: float(np.linalg.norm(middle[tag] - middle[base[0]])))
    values = {} if family == entries.FAMILIES[0] else {"tags": {"family": to_json(family)}}
    still, moving = (", ".join(map(str, sorted(tags))) or "none" for tags in (base, beam))
    known = f"tags that stand still: {still}; that move: {moving}"
    return FoundInFiles(values, tuple(base), tuple(beam), (f"{note}; {known}",), bare=not beam)


def _tags_in(frames: list[FilmFrame]) -> tuple[str, tuple[tuple[Sighting, ...], ...]]:
    from onebend.recording.preview import search  # here, as above

    for family in entries.FAMILIES:
        found = search(frames, family, ())
        if any(found):
            return family, found
    return entries.FAMILIES[0], ()


def found_in_log(path: Path) -> FoundInFiles:
    """The columns of time and forces and their units, where the header is not the usual one."""
    header = next(_rows(path), [])
    forces = likely_forces(header)
    time = next((name for name in header if name.lower() in TIMES or TIME_NAME.match(name)), None)
    if forces is None or time is None or (time, *forces) == ("time_s", "fx_N", "fy_N"):
        return FoundInFiles()
    unit = match[1] if (match := OTHER_TIME.search(time)) else TIMES.get(time.lower(), "s") or "s"
    values = {"columns": to_json([time, *forces])} | ({} if unit == "s" else {"time_unit": to_json(unit)})
    wrong = unit_in_name((time, *forces), unit)
    return FoundInFiles({"force": values}, notes=(f"{path.name}: {wrong}",) if wrong else ())


def found_in_tracks(path: Path) -> FoundInFiles:
    """The markers' ids."""
    rows = islice(_rows(path), FIRST_ROWS)
    header = next(rows, [])
    if "order" in header and "id" not in header:
        return FoundInFiles(bare=True, notes=(f"{path.name}: curves, whose points need no id",))
    if "id" not in header:
        return FoundInFiles()
    ids = {row[header.index("id")].strip() for row in rows if len(row) == len(header)}
    return FoundInFiles(beam=tuple(sorted(int(one) for one in ids if one.isdigit())))


def _rows(path: Path) -> Iterator[list[str]]:
    if path.suffix.lower() == ".csv":
        yield from (row for _, row in csv_rows(path, RecordingError))


def template(kind: Kind = "video", found: FoundInFiles = FoundInFiles(), *, everything: bool = False) -> str:
    """The text of the template: it keeps the schema once what is empty is filled in."""
    camera = kind in ("video", "ros", "photos")
    kinds = tomllib.loads(Path(__file__).with_name("templates.toml").read_text(encoding="utf-8"))
    values = {name: {**own, **found.values.get(name, {})} for name, own in kinds[kind]["tables"].items()}
    tags = {**({"size_m": TO_FILL_IN} if camera else {}), **found.values.get("tags", {})}
    places = [{"id": str(one), "s": TO_FILL_IN} for one in found.beam or ((1, 2, 3) if kind == "weights" else ())]
    places = [] if kind == "photo" or found.bare else places or [{"id": TO_FILL_IN, "s": TO_FILL_IN}] * 3
    base = (found.base or (TO_FILL_IN,)) if camera else ()
    listed = "[[points]]" if kind == "weights" else "[[tags.on_beam]]"

    def table(header: str, record: type, values: Mapping[str, str]) -> str:
        return table_of(header, record, values, everything=everything)

    parts = [
        f"# {kinds[kind]['what']}, for onebend. Fill in what is empty. Units are in the names.",
        *(f"# {note}" for note in found.notes),
        f"\nformat = {FORMAT}\n",
        table("[beam]", entries.BeamEntry, kinds[kind]["beam"]),
        *([table("[tags]", entries.TagsEntry, tags)] if everything or camera else []),
        *(table("[[tags.on_base]]", entries.TagEntry, {"id": str(one)}) for one in base),
        *(table(listed, entries.TagEntry, one) for one in places),
        *(table(f"[{name}]", SECTIONS[name], keys) for name, keys in values.items()),
    ]
    if everything:
        parts += [optional(CAMERA, table("[camera]", entries.CameraEntry, {}))] if camera else []
        parts += [optional(GRAVITY, table("[gravity]", entries.GravityEntry, {}))] if "gravity" not in values else []
        parts += [optional(FREQUENCIES, table("[[frequencies]]", entries.FrequencyEntry, {}))]
    return "\n".join(parts)


def table_of(header: str, record: type, values: Mapping[str, str], *, everything: bool) -> str:
    """One table with its values and what each key says; with `everything` its other keys are commented out."""
    lines = [header]
    for entry, _ in keys_of(record).values():
        value = values.get(entry.name)
        if value is not None:
            says = entry.says if value else f"{entry.says}; such as {entry.example}"
            lines.append(f"{f'{entry.name} = {value}':<40}  # {says}")
        elif everything:
            lines.append(f"{f'# {entry.name} = {entry.example}':<40}  # {entry.says}")
    return "\n".join(lines) + "\n"


def optional(why: str, lines: str) -> str:
    """A whole table commented out."""
    commented = [line if line.startswith("#") else f"# {line}" for line in lines.splitlines()]
    return "\n".join([f"# {why}", *commented]) + "\n"
