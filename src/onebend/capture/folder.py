"""The folder of a recording while it is recorded: what recording.toml must say, the logs, and how much room is left."""

from __future__ import annotations

import math
import re
import shutil
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from onebend.errors import RecordingError, ResultsError
from onebend.files.growing import GrowingFile
from onebend.files.single_file import write_file
from onebend.recording.folder import FILE_NAME, folder_of, read_recording
from onebend.recording.toml.entries import Recording
from onebend.records import Array
from onebend.text_files import MOST_TOML, read_text, read_toml

STAMPS = "frames.csv"
STAMP_COLUMNS = ("time_s", "number", "stamp_s", "arrival_s")
LEAST_STEP = 1e-6  # s between rows: times of a log must rise


@dataclass(frozen=True)
class RecordingPlaces:
    """Where what is recorded goes."""

    rec: Recording
    film: Path
    log: Path | None
    stamps: Path  # of the frames, as the camera gave them and as they came
    wanted: tuple[int, int] = (0, 1)  # which columns of the sensor are the two of recording.toml
    push_column: int | None = None  # and which says where the push acts
    earlier: tuple[Path, ...] = ()  # files that are to be replaced


def places_for(
    folder: Path | str, columns: tuple[str, ...] | None, *, overwrite: bool = False, read: tuple[Path, ...] = ()
) -> RecordingPlaces:
    """Read recording.toml, and check that a camera and a sensor of these `columns` (None: no sensor) can fill it.

    The sources read the files `read`; these are not replaced, not even with `overwrite`.

    Raises:
        RecordingError: what is wrong with it, or what is there already.
    """
    rec = read_recording(folder_of(folder), filmed=False)
    where = rec.folder / FILE_NAME
    if rec.video is None or rec.video.topic:
        raise RecordingError(f'{where}: a camera records a film. Write [video] with file = "video.mp4", without topic.')
    film, log = rec.video.file, None
    if film.suffix.lower() not in (".mp4", ".m4v", ".mov"):
        raise RecordingError(
            f'{where}: the film is written as MP4, and [video] file is {film.name}. Name it "video.mp4".'
        )
    if rec.video.frame_times != "container":
        raise RecordingError(f'{where}: the film holds its times. Write frame_times = "container" in [video].')
    if (columns is None) != (rec.force is None):
        more = (
            "names a [force], and no sensor is given. Give one with --force"
            if columns is None
            else ("has no [force]. Add [force] and [push], or leave the sensor out")
        )
        raise RecordingError(f"{where} {more}.")
    named: list[int] = []
    if rec.force is not None and columns is not None:
        log, named = rec.force.file, _named(rec, columns)
    for path in (film, log):
        if path is not None and not path.parent.resolve().is_relative_to(rec.folder.resolve()):
            raise RecordingError(f"{where}: {path} is out of the recording's folder. Name a file in it, as video.mp4.")
    found = [path for path in (film, log, rec.folder / STAMPS) if path is not None and path.exists()]
    if found and (own := [path for path in found for one in read if one.exists() and path.samefile(one)]):
        raise RecordingError(
            f"{own[0]} is what the camera or the sensor reads, and would be replaced. Record into another folder."
        )
    if found and not overwrite:
        raise RecordingError(
            f"{found[0]} is there already. Record into another folder (copy {FILE_NAME}), or add --overwrite to "
            "replace it."
        )
    place = named[2] if len(named) > 2 else None
    wanted = (named[0], named[1]) if named else (0, 1)
    return RecordingPlaces(rec, film, log, rec.folder / STAMPS, wanted, place, tuple(found))


def _named(rec: Recording, columns: tuple[str, ...]) -> list[int]:
    """Which columns of the sensor recording.toml names: two forces, and perhaps the place of the push."""
    force, push, where = rec.force, rec.push, rec.folder / FILE_NAME
    assert force is not None
    if force.topic or force.time_unit != "s" or force.columns[0] != "time_s":
        raise RecordingError(
            f'{where}: the force log is written as a CSV with the column time_s in s. Write columns = ["time_s", '
            f'"{columns[0]}", "{columns[1]}"] in [force], without topic and time_unit.'
        )
    names = (*force.columns[1:], *([push.column] if push is not None and push.column else []))
    for name in names:
        if name not in columns:
            raise RecordingError(
                f"{where}: [force] and [push] name the column {name}, and the sensor gives {', '.join(columns)}. "
                "Correct columns: the two that span the plane of bending."
            )
    return [columns.index(name) for name in names]


def state_start(folder: Path, error: float) -> None:
    """Write into recording.toml that film and log are on one clock, to `error` [s]. All else stays as it is.

    Raises:
        RecordingError: the file has no line for it.
    """
    path = folder / FILE_NAME
    content = read_text(path, RecordingError, most=MOST_TOML)
    values = {"start_s": "0.0", "start_uncertainty_s": f"{error:.4g}"}
    changed = with_values(content, "video", values)
    try:
        write_file(path, changed, overwrite=True)
    except ResultsError as wrong:
        raise RecordingError(str(wrong)) from None
    said = read_toml(path, RecordingError)[1].get("video", {})
    if not all(math.isclose(said.get(name, math.nan), float(value)) for name, value in values.items()):
        write_file(path, content, overwrite=True)
        lines = ", ".join(f"{name} = {value}" for name, value in values.items())
        raise RecordingError(f"{path}: [video] cannot be edited as it is written. Write {lines} into it, as lines.")


def with_values(content: str, table: str, values: dict[str, str]) -> str:
    """TOML text with these keys of a table set: in the place of the line that has them, even commented out, else below
    the table's header; what a line says behind its value stays."""
    lines = content.splitlines(keepends=True)
    header = next((i for i, line in enumerate(lines) if re.match(rf"^\s*\[\s*{table}\s*\]", line)), None)
    if header is None:
        return content
    end = next((i for i in range(header + 1, len(lines)) if re.match(r"^\s*\[", lines[i])), len(lines))
    for name, value in reversed(values.items()):
        at = [i for i in range(header + 1, end) if re.match(rf"^\s*#?\s*{name}\s*=", lines[i])]
        live = [i for i in at if not lines[i].lstrip().startswith("#")]
        if at:
            place = (live or at)[0]
            rest = lines[place].partition("=")[2]
            said = rest[rest.index("#") :].rstrip("\r\n") if "#" in rest else ""
            lines[place] = f"{f'{name} = {value}':<40}  {said}".rstrip() + "\n"
        else:
            lines.insert(header + 1, f"{name} = {value}\n")
            end += 1
    return "".join(lines)


class GrowingTable:
    """A CSV file that grows: rows are put into it together, whole or not at all."""

    def __init__(self, path: Path, columns: tuple[str, ...]) -> None:
        """Raises `OSError` where it is there, or cannot be made."""
        self.path, self.rows = path, 0
        self._file = GrowingFile(path)
        self._waiting: list[str] = [",".join(columns)]
        self.flush()

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._file.size

    def add(self, rows: Array, formats: tuple[str, ...]) -> None:
        """Rows (n, c), each number as its format says; NaN is an empty cell."""
        for row in rows.tolist():
            cells = ("" if math.isnan(value) else how % value for value, how in zip(row, formats, strict=True))
            self._waiting.append(",".join(cells))
        self.rows += len(rows)

    def flush(self) -> None:
        """Put what waits into the file.

        Raises:
            OSError: the disk is full, or gone; the file then ends with a whole row.
        """
        if not self._waiting:
            return
        self._file.append(("\n".join(self._waiting) + "\n").encode())
        self._waiting.clear()

    def close(self) -> None:
        """The end. Raises `OSError` as `flush`."""
        try:
            self.flush()
        finally:
            self._file.close()


def retimed(path: Path, time: Array) -> None:
    """Write the log anew with times (N,) in its first column, in order of time; the old one stays until it is whole.

    Raises:
        OSError: there is no room for it.
    """
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    lines, time = lines[: len(time)], time[: len(lines)]
    order = np.argsort(time, kind="stable")
    rising = np.maximum.accumulate(time[order] - LEAST_STEP * np.arange(len(order))) + LEAST_STEP * np.arange(
        len(order)
    )
    rows = (
        f"{moment:.6f},{lines[i].partition(',')[2]}" for moment, i in zip(rising.tolist(), order.tolist(), strict=True)
    )
    beside = path.with_name(f".{path.name}.new")
    try:
        beside.write_text("\n".join((header, *rows)) + "\n", encoding="utf-8")
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def room_left(folder: Path) -> float:
    """Bytes left on the disk; NaN where nobody says it."""
    try:
        return float(shutil.disk_usage(folder).free)
    except OSError:
        return math.nan


def copy_description(like: Path, folder: Path) -> None:
    """Begin a recording of the beam of another one: its recording.toml without its name, so that it is called as its
    folder, and the tables of the beam that it names.

    Files that are there already and the same, of a start that failed, are left as they are.

    Raises:
        RecordingError: others are in `folder`, it is no folder, or `like` cannot be read.
    """
    source = folder_of(like)
    rec = read_recording(source, filmed=False)
    if folder.exists() and not folder.is_dir():
        raise RecordingError(f"{folder} is not a folder. Name the folder to record into.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in (source / FILE_NAME, rec.beam.mass_file, rec.beam.section_file):
            if path is not None:
                target, content = folder / path.relative_to(source), path.read_bytes()
                copied = _unnamed(content) if path.name == FILE_NAME else content
                if not target.exists():
                    if ".." in target.relative_to(folder).parts:
                        raise RecordingError(
                            f"{source / FILE_NAME} names {path}, out of its folder: {target} is not written. Put the "
                            "table into the folder, and name it there."
                        )
                    target.parent.mkdir(parents=True, exist_ok=True)
                    target.write_bytes(copied)
                elif target.read_bytes() not in (copied, content):
                    raise RecordingError(f"{target} exists already. Leave out --like, or name another folder.")
    except (OSError, ValueError) as wrong:
        raise RecordingError(f"{folder}: {source} cannot be copied ({wrong}). Copy {FILE_NAME} by hand.") from None


def _unnamed(content: bytes) -> bytes:
    """recording.toml without the line `name = ...` above its tables; as it is where that is no line of its own."""
    found = re.search(rb"^[ \t]*(name|\"name\"|'name')[ \t]*=.*(\n|\Z)", content, re.MULTILINE)
    table = re.search(rb"^[ \t]*\[", content, re.MULTILINE)
    if found is None or (table is not None and table.start() < found.start()):
        return content
    left = content[: found.start()] + content[found.end() :]
    try:
        before, after = (tomllib.loads(one.decode("utf-8-sig")) for one in (content, left))
    except ValueError:
        return content
    before.pop("name", None)
    return left if before == after else content
