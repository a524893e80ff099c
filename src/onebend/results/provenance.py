"""Provenance: SHA-256 of every file read, versions, settings, command."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from onebend.errors import OnebendError
from onebend.files.publish import sha256_of
from onebend.recording.entries import Recording
from onebend.recording.folder import FILE_NAME, read_recording

LIBRARIES = ("onebend", "numpy", "scipy", "av", "pyapriltags", "pyarrow", "rosbags", "matplotlib")


@dataclass(frozen=True)
class InputFile:
    """At the beginning of the work."""

    path: Path
    size: int
    changed_ns: int

    def is_still_there(self) -> bool:
        """Same size and time of change."""
        try:
            now = self.path.stat()
        except OSError:
            return False
        return (now.st_size, now.st_mtime_ns) == (self.size, self.changed_ns)


def inputs_of(paths: Iterable[Path]) -> tuple[InputFile, ...]:
    """Each file once; folders stand for their files; missing ones are left out."""
    files = [file for path in paths for file in (sorted(path.iterdir()) if path.is_dir() else [path])]
    found = []
    for file in dict.fromkeys(one for one in files if one.is_file()):
        state = file.stat()
        found.append(InputFile(file, state.st_size, state.st_mtime_ns))
    return tuple(found)


def provenance(
    inputs: Sequence[InputFile], options: Mapping[str, Any], settings: Mapping[str, Any] = {}
) -> dict[str, Any]:
    """`provenance` of `summary.json`; `options` and `settings` by name."""
    return {
        "provenance": {
            "command": ["onebend", *sys.argv[1:]],
            "options": {name: as_data(value) for name, value in options.items()},
            "settings": {name: as_data(value) for name, value in settings.items()},
            "versions": {**{name: _version(name) for name in LIBRARIES}, "python": platform.python_version()},
            "system": platform.platform(),
            "written": datetime.now(UTC).isoformat(timespec="seconds"),
            "inputs": [{"file": str(one.path), "sha256": checksum_of(one), "bytes": one.size} for one in inputs],
            "changed_meanwhile": [str(one.path) for one in inputs if not one.is_still_there()],
        }
    }


def as_data(value: Any) -> Any:
    """For JSON; other types by name."""
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: as_data(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): as_data(item) for key, item in value.items()}
    if isinstance(value, set | frozenset):
        return sorted(as_data(item) for item in value)
    if isinstance(value, list | tuple):
        return [as_data(item) for item in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)


@cache
def checksum_of(one: InputFile) -> str | None:
    """SHA-256, computed once on demand; None if unreadable."""
    try:
        return sha256_of(one.path)
    except OSError:
        return None


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def recording_files(folders: Iterable[Path]) -> list[Path]:
    """Every file of the recordings; none of unreadable ones."""
    found: list[Path] = []
    for folder in folders:
        try:
            recording = read_recording(folder)
        except (OnebendError, OSError):
            continue
        found += files_of(recording)
    return found


def files_of(description: Recording) -> list[Path]:
    """`recording.toml` and the files that it names."""
    return [description.folder / FILE_NAME, *_named(description)]


def _named(record: Any) -> list[Path]:
    if isinstance(record, Path):
        return [record]
    if isinstance(record, tuple):
        return [path for item in record for path in _named(item)]
    if not is_dataclass(record):
        return []
    names = [item.name for item in fields(record) if not (isinstance(record, Recording) and item.name == "folder")]
    return [path for name in names for path in _named(getattr(record, name))]
