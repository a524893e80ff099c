"""Every file that a recording is read from."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from onebend.errors import OnebendError
from onebend.recording.folder import FILE_NAME, read_recording
from onebend.recording.toml.entries import Recording


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


def files_of(recording: Recording) -> list[Path]:
    """Every file of a recording that was read: its `recording.toml`, and those that it names."""
    return [recording.folder / FILE_NAME, *_named(recording)]


def _named(record: Any) -> list[Path]:
    """Every path in a record of a recording, but for its folder."""
    if isinstance(record, Path):
        return [record]
    if isinstance(record, tuple):
        return [path for item in record for path in _named(item)]
    if not is_dataclass(record):
        return []
    names = [item.name for item in fields(record) if not (isinstance(record, Recording) and item.name == "folder")]
    return [path for name in names for path in _named(getattr(record, name))]
