"""A cache folder with a size limit.

An entry is one file: the SHA-256 of the rest, then the rest. Damaged entries count as absent. Other files in the folder
are not touched.
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
MOST = 500_000_000  # bytes
_ENTRY = re.compile(r"[a-z]+-[0-9a-f]{40}\.kept")
_BEGUN = re.compile(r"\.[a-z]+-[0-9a-f]+\.[a-z0-9_]+\.kept")  # unfinished entries of a killed process
_STALE = 3600.0  # s
_DIGEST = hashlib.sha256().digest_size


@dataclass(frozen=True)
class KeptEntry:
    path: Path
    size: int  # bytes
    used: float  # s since 1970: last written or read


@dataclass(frozen=True)
class KeptFolder:
    """Entries by name, in a folder that is made on demand."""

    path: Path
    most: int = MOST  # bytes; the longest unused entries are dropped

    def load(self, name: str) -> bytes | None:
        """The content under `name`; None if absent or damaged."""
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
        """Stores `content` completely or not at all; whether that was possible."""
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
        """The longest unused first."""
        found = []
        for path in self._ours(_ENTRY):
            with suppress(OSError):
                state = path.stat()
                found.append(KeptEntry(path, state.st_size, state.st_mtime))
        return sorted(found, key=lambda entry: (entry.used, entry.path.name))

    def trim(self) -> None:
        """Drops the longest unused entries beyond the limit, and unfinished ones."""
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
        """Drops all entries, and the folder if it is then empty; returns the entries. Raises `OSError`."""
        dropped = self.entries()
        for path in (*(entry.path for entry in dropped), *self._ours(_BEGUN)):
            path.unlink(missing_ok=True)
        with suppress(OSError):
            self.path.rmdir()
        return dropped

    def _file(self, name: str) -> Path:
        return self.path / f"{name}.kept"

    def _ours(self, pattern: re.Pattern[str]) -> list[Path]:
        """Plain files whose names match."""
        try:
            inside = list(self.path.iterdir())
        except OSError:
            return []
        return [path for path in inside if pattern.fullmatch(path.name) and not path.is_symlink() and path.is_file()]


def users_folder(environment: Mapping[str, str] | None = None, system: str = sys.platform) -> KeptFolder | None:
    """The user's cache: ONEBEND_CACHE, else `onebend` in the system's cache folder (XDG on Linux); None if turned off
    or there is none."""
    env = os.environ if environment is None else environment
    asked = env.get(VARIABLE, "").strip()
    if asked.lower() in OFF:
        return None
    if asked:
        return KeptFolder(Path(asked).expanduser())
    place = _place(env, system)
    return None if place is None else KeptFolder(place / "onebend")


def _place(env: Mapping[str, str], system: str) -> Path | None:
    variable, otherwise = {
        "win32": ("LOCALAPPDATA", "AppData/Local"),
        "darwin": ("", "Library/Caches"),
    }.get(system, ("XDG_CACHE_HOME", ".cache"))
    stated = Path(env.get(variable, ""))
    if stated.is_absolute():  # XDG ignores relative paths
        return stated
    try:
        return Path.home() / otherwise
    except RuntimeError:
        return None
