"""A folder in which things are kept from run to run: what is in it, what may be dropped, how large it may grow.

An entry is one file: the SHA-256 of the rest, then the rest. What is not as it was written counts as not there and is
written anew. Nothing else in the folder is read, counted or removed.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from onebend.errors import ResultsError
from onebend.files.single_file import write_file

VARIABLE = "ONEBEND_CACHE"  # a folder, or one of OFF
OFF = ("off", "0")
MOST = 500_000_000  # bytes of a user's cache
_ENTRY = re.compile(r"[a-z]+-[0-9a-f]{40}\.kept")
_BEGUN = re.compile(r"\.[a-z]+-[0-9a-f]+\.[a-z0-9_]+\.kept")  # what a process that was killed left of one
_STALE = 3600.0  # s: no entry takes longer to write
_DIGEST = hashlib.sha256().digest_size


@dataclass(frozen=True)
class KeptEntry:
    """One thing that is kept."""

    path: Path
    size: int  # bytes
    used: float  # s since 1970: when it was last written or read


@dataclass(frozen=True)
class KeptFolder:
    """Entries by name in a folder that is made when something is to be kept."""

    path: Path
    most: int = MOST  # bytes of all entries; the ones that were not used for longest are dropped

    def load(self, name: str) -> bytes | None:
        """What is kept under `name`; None where nothing is, or it is damaged."""
        path = self._file(name)
        try:
            if path.is_symlink() or not path.is_file() or path.stat().st_size > self.most:
                return None
            written = path.read_bytes()
        except OSError:
            return None
        content = written[_DIGEST:]
        if hashlib.sha256(content).digest() != written[:_DIGEST]:
            return None
        with suppress(OSError):
            os.utime(path)
        return content

    def save(self, name: str, content: bytes) -> bool:
        """Keep `content` under `name`, whole or not at all; whether that was possible."""
        if len(content) + _DIGEST > self.most:
            return False
        try:
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
            write_file(self._file(name), hashlib.sha256(content).digest() + content, overwrite=True)
        except (ResultsError, OSError):
            return False
        self.trim()
        return True

    def entries(self) -> list[KeptEntry]:
        """All that is kept, the longest unused first."""
        found = []
        for path in self._ours(_ENTRY):
            with suppress(OSError):
                state = path.stat()
                found.append(KeptEntry(path, state.st_size, state.st_mtime))
        return sorted(found, key=lambda entry: (entry.used, entry.path.name))

    def trim(self) -> None:
        """Drop the longest unused entries until the others are small enough together, and what was never finished."""
        kept = self.entries()
        size = sum(entry.size for entry in kept)
        for entry in kept:
            if size <= self.most:
                break
            with suppress(OSError):
                entry.path.unlink()
            size -= entry.size
        for path in self._ours(_BEGUN):
            with suppress(OSError):
                if time.time() - path.stat().st_mtime > _STALE:
                    path.unlink()

    def clear(self) -> list[KeptEntry]:
        """Drop all entries, and the folder where nothing else is in it; those that were dropped.

        Raises `OSError`: one cannot be removed.
        """
        dropped = self.entries()
        for path in (*(entry.path for entry in dropped), *self._ours(_BEGUN)):
            path.unlink(missing_ok=True)
        with suppress(OSError):
            self.path.rmdir()
        return dropped

    def _file(self, name: str) -> Path:
        return self.path / f"{name}.kept"

    def _ours(self, pattern: re.Pattern[str]) -> list[Path]:
        """The plain files in the folder whose names are of this pattern."""
        try:
            inside = list(self.path.iterdir())
        except OSError:
            return []
        return [path for path in inside if pattern.fullmatch(path.name) and not path.is_symlink() and path.is_file()]


def users_folder(environment: Mapping[str, str] | None = None, system: str = sys.platform) -> KeptFolder | None:
    """The user's own: the folder that ONEBEND_CACHE names, else `onebend` in the system's place for caches (on Linux by
    the XDG specification); None where it is turned off, or there is no such place."""
    env = os.environ if environment is None else environment
    asked = env.get(VARIABLE, "").strip()
    if asked.lower() in OFF:
        return None
    if asked:
        return KeptFolder(Path(asked).expanduser())
    place = _place(env, system)
    return None if place is None else KeptFolder(place / "onebend")


def _place(env: Mapping[str, str], system: str) -> Path | None:
    """Where this system keeps caches."""
    variable, otherwise = {
        "win32": ("LOCALAPPDATA", "AppData/Local"),
        "darwin": ("", "Library/Caches"),
    }.get(system, ("XDG_CACHE_HOME", ".cache"))
    stated = Path(env.get(variable, ""))
    if stated.is_absolute():  # the XDG specification: a relative one counts as none
        return stated
    try:
        return Path.home() / otherwise
    except RuntimeError:
        return None
