"""A cache folder with a size limit. Other files in the folder are not touched."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from onebend.errors import ResultsError
from onebend.files.single_file import write_file

VARIABLE = "ONEBEND_CACHE"  # a folder, or one of OFF
OFF = ("off", "0")
MOST = 500_000_000  # bytes
_OURS = re.compile(r"[a-z]+-[0-9a-f]{40}\.kept|\.[a-z]+-[0-9a-f]+\.[0-9a-f]{8}\.kept")  # the second: unfinished


@dataclass(frozen=True)
class KeptFolder:
    """Entries by name, in a folder that is made on demand."""

    path: Path
    most: int = MOST  # bytes; the longest unused entries are dropped

    def load(self, name: str) -> bytes | None:
        """The content under `name`; None if absent."""
        path = self._file(name)
        try:
            if path.is_symlink() or not path.is_file():
                return None
            os.utime(path)
            return path.read_bytes()
        except OSError:
            return None

    def save(self, name: str, content: bytes) -> bool:
        """Stores `content` completely or not at all; whether that was possible."""
        if len(content) > self.most:
            return False
        try:
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
            write_file(self._file(name), content, overwrite=True)
        except (ResultsError, OSError):
            return False
        kept = self.entries()
        size = sum(path.stat().st_size for path in kept)
        while size > self.most:
            oldest = kept.pop(0)
            size -= oldest.stat().st_size
            oldest.unlink()
        return True

    def entries(self) -> list[Path]:
        """The longest unused first."""
        inside = self.path.iterdir() if self.path.is_dir() else ()
        ours = [one for one in inside if _OURS.fullmatch(one.name) and not one.is_symlink() and one.is_file()]
        return sorted(ours, key=lambda path: (path.stat().st_mtime, path.name))

    def _file(self, name: str) -> Path:
        return self.path / f"{name}.kept"


def users_folder(environment: Mapping[str, str] | None = None, system: str = sys.platform) -> KeptFolder | None:
    """The user's cache: ONEBEND_CACHE, else `onebend` in the system's cache folder (XDG on Linux); None if turned off
    or there is none."""
    env = os.environ if environment is None else environment
    asked = env.get(VARIABLE, "").strip()
    if asked.lower() in OFF:
        return None
    if asked:
        return KeptFolder(Path(asked).expanduser())
    variable, otherwise = {
        "win32": ("LOCALAPPDATA", "AppData/Local"),
        "darwin": ("", "Library/Caches"),
    }.get(system, ("XDG_CACHE_HOME", ".cache"))
    stated = Path(env.get(variable, ""))
    with suppress(RuntimeError):  # no home
        return KeptFolder((stated if stated.is_absolute() else Path.home() / otherwise) / "onebend")
    return None
