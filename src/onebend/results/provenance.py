"""Where results come from: every file that was read by its SHA-256, the versions, the settings, the command."""

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
    """A file as it was when the work began."""

    path: Path
    size: int  # bytes
    changed_ns: int

    def is_still_there(self) -> bool:
        """Whether it is as it was, by size and time of change."""
        try:
            now = self.path.stat()
        except OSError:
            return False
        return (now.st_size, now.st_mtime_ns) == (self.size, self.changed_ns)


def inputs_of(paths: Iterable[Path]) -> tuple[InputFile, ...]:
    """The files as they are now, each once; a folder stands for the files in it. What is not there is left out."""
    files = [file for path in paths for file in (sorted(path.iterdir()) if path.is_dir() else [path])]
    found = []
    for file in dict.fromkeys(one for one in files if one.is_file()):
        state = file.stat()
        found.append(InputFile(file, state.st_size, state.st_mtime_ns))
    return tuple(found)


def provenance(
    inputs: Sequence[InputFile], options: Mapping[str, Any], settings: Mapping[str, Any] = {}
) -> dict[str, Any]:
    """The entry `provenance` of `summary.json`. `options`: of the command, by name; `settings`: records, by name."""
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
    """A setting as JSON knows it; what has no such form by its name."""
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
    """SHA-256, computed when it is wanted, and once: a film is long. None where the file cannot be read."""
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
    """Every file of the recordings. One that cannot be read has none: to say why is its reader's part."""
    found: list[Path] = []
    for folder in folders:
        try:
            recording = read_recording(folder)
        except (OnebendError, OSError):
            continue
        found += files_of(recording)
    return found


def files_of(description: Recording) -> list[Path]:
    """Every file of a recording that was read: its `recording.toml`, and those that it names."""
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
