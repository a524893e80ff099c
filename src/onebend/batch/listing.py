"""Which recordings are learned: those in a folder, or the rows of a CSV, which may state what differs between them."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from onebend.errors import RecordingError
from onebend.recording.folder import FILE_NAME, folder_of
from onebend.recording.toml.description import HOMES
from onebend.text_files import csv_rows, quoted

OWN = ("path", "name", "group")  # columns of a list with a meaning of their own
MOST = 1_000_000  # recordings


@dataclass(frozen=True)
class Item:
    """One recording that is asked for."""

    name: str  # of its own in the batch
    folder: Path  # absolute
    group: str = ""
    stated: tuple[tuple[str, str, Any], ...] = ()  # table, key, value in place of recording.toml's
    labels: tuple[tuple[str, str], ...] = ()  # the list's other columns, carried through: column, cell


def items_of(source: Path, out: Path) -> tuple[Item, ...]:
    """The recordings of `source`: a CSV with a column `path`, or a folder with recordings in it at any depth, without
    those in `out`.

    Raises:
        RecordingError: there is none, two have one name, or a column or a cell of the list cannot be used.
    """
    if source.is_dir():
        found = _in_folder(source.resolve(), out.resolve())
        if not found:
            raise RecordingError(f"{source} holds no recording, no folder with {FILE_NAME}. Name another.")
    elif source.suffix.lower() == ".csv" or source.is_file():
        found = _in_list(source)
    else:
        raise RecordingError(f"{source} is neither a folder nor a file. Give a folder of recordings, or a CSV of them.")
    twice = [name for name, count in Counter(one.name.casefold() for one in found).items() if count > 1]
    if twice:
        raise RecordingError(f"{source}: two recordings are called {quoted(twice[0])}. Give each a name of its own.")
    if len(found) > MOST:
        raise RecordingError(f"{source}: {len(found)} recordings; at most {MOST} are learned at once. Part them.")
    return found


def _in_folder(source: Path, out: Path) -> tuple[Item, ...]:
    """Recordings by their path in the folder; the first part of a longer path is the group."""
    found = []
    for file in sorted(source.rglob(FILE_NAME)):
        folder = file.parent
        if folder == out or out in folder.parents:
            continue
        inside = folder.relative_to(source)
        group = inside.parts[0] if len(inside.parts) > 1 else ""
        found.append(Item(inside.as_posix() if inside.parts else folder.name, folder, group))
    return tuple(found)


def _in_list(path: Path) -> tuple[Item, ...]:
    rows = list(csv_rows(path, RecordingError))
    header = [name.strip() for name in rows[0][1]] if rows else []
    if "path" not in header:
        raise RecordingError(f"{path} has no column path, which names the folder of each recording. Add it.")
    twice = [name for name, count in Counter(header).items() if name and count > 1]
    if twice:
        raise RecordingError(f"{path}: the column {quoted(twice[0])} is there twice. Remove one.")
    keys = {name: key for name in header if name not in OWN and (key := _key(name, path)) is not None}
    if len(rows) == 1:
        raise RecordingError(f"{path} has no rows. Write one for each recording.")
    return tuple(_item(path, line, header, cells, keys) for line, cells in rows[1:])


def _item(
    path: Path, line: int, header: Sequence[str], cells: Sequence[str], keys: Mapping[str, tuple[str, str]]
) -> Item:
    if len(cells) > len(header):
        raise RecordingError(f"{path}, line {line}: {len(cells)} cells under {len(header)} columns. Quote the commas.")
    by_name = {name: cell.strip() for name, cell in zip(header, cells, strict=False) if name}
    if not by_name.get("path"):
        raise RecordingError(f"{path}, line {line}: the path is empty. Name the recording's folder.")
    if "\0" in by_name["path"]:
        raise RecordingError(f"{path}, line {line}: the path is no path.")
    folder = folder_of(path.resolve().parent / by_name["path"])
    stated = tuple((*key, _value(by_name[name])) for name, key in keys.items() if by_name.get(name))
    labels = tuple((name, by_name.get(name, "")) for name in header if name and name not in OWN)
    return Item(by_name.get("name") or by_name["path"], folder, by_name.get("group", ""), stated, labels)


def _key(column: str, path: Path) -> tuple[str, str] | None:
    """Table and key of recording.toml that a column states, as `length_m` or `beam.length_m`; None: it is a label.

    Raises:
        RecordingError: several tables know the key.
    """
    table, dot, name = column.partition(".")
    if dot:
        return (table, name) if table in HOMES.get(name, ()) else None
    homes = HOMES.get(column, ())
    if len(homes) > 1:
        raise RecordingError(
            f"{path}: the column {column} is a key of {' and '.join(f'[{home}]' for home in homes)} in {FILE_NAME}. "
            f"Write {homes[0]}.{column} for one of them, or rename a label."
        )
    return (homes[0], column) if homes else None


def _value(cell: str) -> Any:
    """A cell as TOML knows it: a number, true or false, a list; else the text."""
    if cell in ("true", "false") or cell.startswith("["):
        try:
            return tomllib.loads(f"value = {cell}")["value"]
        except (tomllib.TOMLDecodeError, RecursionError):
            return cell
    for kind in (int, float):
        try:
            return kind(cell)
        except ValueError:
            continue
    return cell
