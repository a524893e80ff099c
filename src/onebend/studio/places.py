"""The folder that the studio works in: what lies there, and nothing from outside."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from onebend.errors import StudioError
from onebend.files.endings import FILMS, LOGS

RECORDING, RESULT_SUMMARY, MODEL = "recording.toml", "summary.json", "model.json"
_DEEPEST, _MOST_FOLDERS = 5, 5000  # of the search for recordings and results
_LEFT_OUT = frozenset({"node_modules", "__pycache__", "site-packages"})
_LONGEST_PART = 255  # bytes, of what stands between two /: no common file system takes more
_LARGEST_SUMMARY = 16 * 2**20  # bytes


@dataclass(frozen=True)
class Found:
    """A recording or a result below the studio's folder, or a film with a log that nothing describes yet."""

    name: str  # relative, with /; "." is the folder itself
    kind: Literal["recording", "result", "film"]
    changed: float  # s since 1970
    about: dict[str, Any]  # of a result: recordings, grade, known


@dataclass(frozen=True)
class StudioFolder:
    """A folder, and the names below it."""

    root: Path

    @staticmethod
    def of(folder: Path) -> StudioFolder:
        """Raises `StudioError` where there is no such folder."""
        if not folder.is_dir():
            raise StudioError(f"{folder} is not a folder. Give the one that holds your recordings and results")
        return StudioFolder(folder.resolve())

    def path(self, name: str) -> Path:
        """The place of this name below the folder.

        Raises `StudioError` where the name leads out of it, by dots, a root or a link.
        """
        parts = PurePosixPath(name).parts
        odd = not name or any(part in name for part in ("\0", "\\", ":")) or len(name) > 1000
        if odd or not _is_text(name) or PurePosixPath(name).is_absolute() or ".." in parts:
            raise StudioError(f"{name[:100]!r} is no name in this folder")
        if any(len(part.encode()) > _LONGEST_PART for part in parts):
            raise StudioError(f"{name[:30]!r}... is too long a name: a folder's has at most {_LONGEST_PART} bytes")
        try:
            path = (self.root / name).resolve()
        except (OSError, RuntimeError) as error:
            raise StudioError(f"{name[:100]!r} cannot be read") from error
        if not path.is_relative_to(self.root):
            raise StudioError(f"{name[:100]!r} leads out of {self.root}")
        return path

    def beside(self, name: str, file: str) -> Path:
        """A file that is named in the folder `name`, as it leads on from there.

        Raises `StudioError` where it lies outside of the studio's folder, or names nothing.
        """
        if not file or "\0" in file or len(file) > 1000 or not _is_text(file):
            raise StudioError("no file is named")
        try:
            path = (self.path(name) / file).resolve()
        except (OSError, RuntimeError) as error:
            raise StudioError(f"{file[:100]!r} cannot be read") from error
        if not path.is_relative_to(self.root):
            raise StudioError(f"{file[:100]!r} leads out of {self.root}: the page does not look there. A check does")
        return path

    def recording(self, name: str) -> Path:
        """The folder of a recording. Raises `StudioError` where there is none."""
        path = self.path(name)
        if not is_file(path / RECORDING):
            raise StudioError(f"{name} holds no {RECORDING}")
        self.path(f"{name}/{RECORDING}")  # no link to elsewhere
        return path

    def result(self, name: str) -> Path:
        """The folder of a learned beam. Raises `StudioError` where there is none."""
        path = self.path(name)
        if not is_file(path / MODEL):
            raise StudioError(f"{name} holds no {MODEL}: learn a recording first")
        self.path(f"{name}/{MODEL}")
        return path

    def found(self) -> list[Found]:
        """All recordings and results, by name; hidden folders, links and names that are no text are left out."""
        rows, waiting, seen = [], [(self.root, 0)], 0
        while waiting and seen < _MOST_FOLDERS:
            folder, depth = waiting.pop()
            seen += 1
            try:
                with os.scandir(folder) as entries:
                    inside = [
                        one
                        for one in entries
                        if not one.name.startswith(".") and _is_text(one.name) and not one.is_symlink()
                    ]
                    files = {one.name for one in inside if one.is_file(follow_symlinks=False)}
                    below = [Path(one.path) for one in inside if one.is_dir(follow_symlinks=False)]
            except OSError:
                continue
            name = folder.relative_to(self.root).as_posix()
            if RECORDING in files:
                rows.append(Found(name, "recording", _changed(folder / RECORDING), {}))
            elif MODEL not in files and _with_ending(files, FILMS) and _with_ending(files, LOGS):
                rows.append(Found(name, "film", 0.0, {}))
            if {MODEL, RESULT_SUMMARY} <= files:
                rows.append(Found(name, "result", _changed(folder / MODEL), _about(folder / RESULT_SUMMARY)))
            if depth < _DEEPEST:
                waiting += [(one, depth + 1) for one in below if one.name not in _LEFT_OUT]
        return sorted(rows, key=lambda one: (one.name, one.kind))


def _is_text(name: str) -> bool:
    """Whether a name has characters alone: one of other bytes cannot be said to a page, or by it."""
    return not any("\ud800" <= one <= "\udfff" for one in name)


def is_file(path: Path) -> bool:
    """Whether there is such a file; where its name is too long, there is none."""
    try:
        return path.is_file()
    except OSError:
        return False


def _with_ending(names: set[str], endings: tuple[str, ...]) -> bool:
    return any(name.lower().endswith(endings) for name in names)


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _about(path: Path) -> dict[str, Any]:
    """What a list says of a result."""
    try:
        if path.stat().st_size > _LARGEST_SUMMARY:
            return {}
        data = json.loads(path.read_text(encoding="utf-8"))
        verdict = data["verdict"]
        return {
            "recordings": data["recordings"],
            "grade": verdict["grade"],
            "known": verdict["known"],
            "length_m": data["length_m"],
        }
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}
