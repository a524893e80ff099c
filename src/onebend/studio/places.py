"""The studio's folder."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from onebend.errors import StudioError
from onebend.files.publish import read_object
from onebend.files.single_file import FILMS, LOGS
from onebend.studio.words import Asked

RECORDING, RESULT_SUMMARY, MODEL = "recording.toml", "summary.json", "model.json"
_DEEPEST, _MOST_FOLDERS = 5, 5000  # of the search
_LEFT_OUT = frozenset({"node_modules", "__pycache__", "site-packages"})
_LONGEST_PART = 255  # bytes between two /
_LARGEST_SUMMARY = 16 * 2**20  # bytes


@dataclass(frozen=True)
class Found:
    """A recording, a result, or an undescribed film with a log."""

    name: str  # relative, with /; "." is the folder itself
    kind: Literal["recording", "result", "film"]
    changed: float  # s since 1970
    about: dict[str, Any]  # of a result: recordings, grade, known


def places_data(places: StudioFolder, _asked: Asked) -> dict[str, Any]:
    """What the folder holds."""
    rows = [{"name": one.name, "kind": one.kind, "changed": one.changed, **one.about} for one in places.found()]
    return {"folder": str(places.root), "found": rows}


@dataclass(frozen=True)
class StudioFolder:
    root: Path

    @staticmethod
    def of(folder: Path) -> StudioFolder:
        """Raises `StudioError` if there is no such folder."""
        if not folder.is_dir():
            raise StudioError(f"{folder} is not a folder. Give the one that holds your recordings and results")
        return StudioFolder(folder.resolve())

    def path(self, name: str) -> Path:
        """The path of this name. Raises `StudioError` if it leads out of the folder, by dots, a root or a link."""
        parts = PurePosixPath(name).parts
        odd = not name or any(part in name for part in ("\0", "\\", ":")) or len(name) > 1000
        if odd or not _is_text(name) or PurePosixPath(name).is_absolute() or ".." in parts:
            raise StudioError(f"{name[:100]!r} is no name in this folder")
        if any(len(part.encode()) > _LONGEST_PART for part in parts):
            raise StudioError(f"{name[:30]!r}... is too long a name: a folder's has at most {_LONGEST_PART} bytes")
        return self.inside(self.root / name, name)

    def beside(self, name: str, file: str) -> Path:
        """A file named in folder `name`. Raises `StudioError` if it is outside or missing."""
        if not file or "\0" in file or len(file) > 1000 or not _is_text(file):
            raise StudioError("no file is named")
        return self.inside(self.path(name) / file, file, ": the page does not look there. A check does")

    def inside(self, path: Path, name: str, advice: str = "") -> Path:
        """The path without links. Raises `StudioError`, which says `name`, where it leads out of the folder."""
        try:
            path = path.resolve()
        except (OSError, RuntimeError) as error:
            raise StudioError(f"{name[:100]!r} cannot be read") from error
        if not path.is_relative_to(self.root):
            raise StudioError(f"{name[:100]!r} leads out of {self.root}{advice}")
        return path

    def recording(self, name: str) -> Path:
        """Raises `StudioError` if there is none."""
        return self._holding(name, RECORDING, "")

    def result(self, name: str) -> Path:
        """Raises `StudioError` if there is none."""
        return self._holding(name, MODEL, ": learn a recording first")

    def _holding(self, name: str, file: str, advice: str) -> Path:
        path = self.path(name)
        if not is_file(path / file):
            raise StudioError(f"{name} holds no {file}{advice}")
        self.path(f"{name}/{file}")  # no link to elsewhere
        return path

    def found(self) -> list[Found]:
        """All recordings and results by name, without hidden folders, links and undecodable names."""
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
    return not any("\ud800" <= one <= "\udfff" for one in name)


def is_file(path: Path) -> bool:
    """False also for too long names."""
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
    data = read_object(path, _LARGEST_SUMMARY) or {}
    try:
        verdict = data["verdict"]
        return {
            "recordings": data["recordings"],
            "grade": verdict["grade"],
            "known": verdict["known"],
            "length_m": data["length_m"],
        }
    except (KeyError, TypeError):
        return {}
