"""Where a report comes from, for people: when, by which command, from which files, with which settings and versions."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import PurePath
from typing import Any

from onebend.escaping import one_line
from onebend.report.wording import UNKNOWN

_MOST_NAMED = 4  # files in a sentence
_UNITS = ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"))


@dataclass(frozen=True)
class ReadFile:
    """A file that was read."""

    path: str
    name: str
    size: str
    checksum: str


@dataclass(frozen=True)
class MadeFrom:
    """Where a report comes from."""

    written: str  # date and time
    command: str
    names: str  # of the files, the first ones
    files: tuple[ReadFile, ...]
    changed: tuple[str, ...]  # files that were changed while they were read
    settings: tuple[tuple[str, str], ...]
    versions: str


def shown_made_from(provenance: Mapping[str, Any]) -> MadeFrom | None:
    """From what `summary.json` holds under `provenance`; None where nothing is known."""
    found = provenance.get("provenance")
    if found is None:
        return None
    when = datetime.fromisoformat(found["written"])
    versions = [f"{name} {value}" for name, value in found["versions"].items() if value]
    files = tuple(_file(one) for one in found["inputs"])
    more = f" and {len(files) - _MOST_NAMED} more files" if len(files) > _MOST_NAMED else ""
    return MadeFrom(
        written=f"{when:%Y-%m-%d %H:%M} UTC",
        command=one_line(shlex.join(found["command"])),
        names=", ".join(dict.fromkeys(one.name for one in files[:_MOST_NAMED])) + more,
        files=files,
        changed=tuple(one_line(path) for path in found["changed_meanwhile"]),
        settings=tuple(_flat({**found["settings"], "options": found["options"]})),
        versions=one_line(", ".join([*versions, found["system"]])),
    )


def _file(one: Mapping[str, Any]) -> ReadFile:
    path = one_line(one["file"])
    return ReadFile(path, PurePath(path).name, size_words(one["bytes"]), one["sha256"] or UNKNOWN)


def size_words(count: int) -> str:
    """A number of bytes, with three digits."""
    for size, unit in _UNITS:
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count} bytes"


def _flat(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    """Every setting by its full name; what was left at "not given" is left out."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{before}{name}: ")
        elif value is not None and value != []:
            words = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
            yield one_line(before + name), one_line(words)
