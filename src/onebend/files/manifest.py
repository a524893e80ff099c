"""`summary.json` as a manifest: the files of a result by name and SHA-256, and a SHA-256 of the summary itself.

What it lists, unchanged since, is ours. All else in a folder is somebody's, and is neither replaced nor removed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from onebend.strict_json import to_json

SUMMARY = "summary.json"
OWN_CHECKSUM = "sha256"  # of everything else in the same object
LARGEST = 64 * 2**20  # bytes: no summary is longer


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file's content, as 64 hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def with_checksum(data: Mapping[str, Any]) -> dict[str, Any]:
    """`data` and the checksum of its content. The text that it is written as does not matter."""
    return {**data, OWN_CHECKSUM: _checksum(data)}


def is_unchanged(data: Mapping[str, Any]) -> bool:
    """Whether the checksum that stands in `data` is that of the rest."""
    return data.get(OWN_CHECKSUM) == _checksum(data)


def _checksum(data: Mapping[str, Any]) -> str:
    rest = {key: value for key, value in data.items() if key != OWN_CHECKSUM}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write `summary` into `folder`; `seal` adds the files to it."""
    (folder / SUMMARY).write_text(to_json(summary) + "\n", encoding="utf-8")


def seal(folder: Path, more: Mapping[str, Any]) -> None:
    """Put `more` and the manifest of all files into the summary in `folder`; to be done last."""
    path = folder / SUMMARY
    data = json.loads(path.read_text(encoding="utf-8"))
    files = {name: sha256_of(folder / name) for name in files_in(folder) if name != SUMMARY}
    data = json.loads(to_json({**data, **more, "files": {**files, SUMMARY: None}}))
    write_summary(folder, with_checksum(data))


def read_summary(folder: Path) -> dict[str, Any] | None:
    """The summary in `folder`, as onebend wrote it; None where there is none, or it was changed since."""
    path = folder / SUMMARY
    try:
        if path.is_symlink() or not path.is_file() or path.stat().st_size > LARGEST:
            return None
        data = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(data, dict) or not is_unchanged(data) or not isinstance(data.get("files"), dict):
            return None
    except (OSError, ValueError, TypeError, RecursionError):
        return None
    return data


def own_files(folder: Path, kind: str | None = None) -> set[str]:
    """The files in `folder` that a run wrote (one of this `kind`, where one is named) and nobody changed since."""
    summary = read_summary(folder)
    if summary is None or (kind is not None and summary.get("format") != kind):
        return set()
    return {name for name, checksum in summary["files"].items() if _is_ours(folder, name, checksum)}


def changed_files(folder: Path) -> list[str]:
    """The files that the summary of `folder` lists and that are not as it lists them, sorted."""
    summary = read_summary(folder)
    return [] if summary is None else sorted(set(summary["files"]) - own_files(folder))


def is_listed_otherwise(file: Path) -> bool:
    """Whether a summary beside `file` lists it with another content."""
    return _differs(file) and _differs(file)  # once may be a folder that was just being replaced


def _differs(file: Path) -> bool:
    summary = read_summary(file.parent)
    listed = None if summary is None else summary["files"].get(file.name)
    return isinstance(listed, str) and listed != sha256_of(file)


def files_in(folder: Path) -> list[str]:
    """Every file below `folder`, relative to it, sorted; links do not count."""
    found, _ = entries_in(folder)
    return sorted(name for name in found if not (folder / name).is_symlink())


def entries_in(folder: Path) -> tuple[set[str], set[str]]:
    """All that is not a folder (links too) and all folders below `folder`, relative to it. Links are not followed."""
    others: set[str] = set()
    folders: set[str] = set()
    waiting = [folder]
    while waiting:
        for path in waiting.pop().iterdir():
            name = path.relative_to(folder).as_posix()
            if path.is_dir() and not path.is_symlink():
                folders.add(name)
                waiting.append(path)
            else:
                others.add(name)
    return others, folders


def parents_of(names: set[str]) -> set[str]:
    """The folders that these files lie in, relative as they are."""
    return {parent.as_posix() for name in names for parent in PurePosixPath(name).parents} - {"."}


def _is_ours(folder: Path, name: str, checksum: object) -> bool:
    """Whether `name` is a file inside the folder, by no link, with the content that was written."""
    inside = PurePosixPath(name)
    if inside.is_absolute() or ".." in inside.parts or not inside.parts or "\\" in name or ":" in name:
        return False
    if any((folder / part).is_symlink() for part in (inside, *inside.parents)):
        return False
    path = folder / name
    try:
        if not path.is_file():
            return False
        return name == SUMMARY or sha256_of(path) == checksum
    except (OSError, ValueError):
        return False
