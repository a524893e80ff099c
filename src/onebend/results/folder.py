"""The results folder: either complete or absent, and no other file is ever lost.

Work in progress is in the folder `OUT.partial` beside it. A run finishes its files there and then moves them into place
all at once. `summary.json` lists the files that a run wrote; all other files are foreign and are never touched.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from onebend.errors import ResultsError
from onebend.strict_json import to_json

SUMMARY = "summary.json"
COMPLETE = "results"  # in the workplace: new results, all written, not yet in place
FIXED_NAMES = (
    "model.json",
    "stiffness.csv",
    "nuisances.csv",
    "selection.csv",
    "markers.csv",
    "validation.csv",
    "report.html",
)


@dataclass(frozen=True)
class OutputFolder:
    """Where a run puts its results, and where it works until then."""

    out: Path
    kind: str  # the `format` of the summary: results of one kind never replace those of another
    overwrite: bool

    @property
    def partial(self) -> Path:
        """Kept when a run is interrupted, so that the next one goes on from there."""
        return self.out.with_name(self.out.name + ".partial")


def prepare(out: Path, *, kind: str, overwrite: bool) -> OutputFolder:
    """Check that results may go to `out` and make its workplace, before any heavy work.

    Raises `ResultsError` where the folder is taken, is a recording, or cannot be made.
    """
    place = OutputFolder(Path(os.path.abspath(out)), kind, overwrite)  # noqa: PTH100 (links in the path are kept)
    _check_free(place)
    try:
        place.partial.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultsError(f"{place.partial}: cannot make this folder ({error.strerror}). Choose another -o") from error
    return place


def publish(place: OutputFolder, write: Callable[[Path], None]) -> None:
    """Let `write` fill a fresh folder, then put it in place as a whole and remove the workplace.

    Raises `ResultsError` where writing or moving fails; what was there before stands as it was.
    """
    unfinished, fresh = place.partial / "unfinished", place.partial / COMPLETE
    try:
        for stale in (unfinished, fresh):
            shutil.rmtree(stale, ignore_errors=True)
        unfinished.mkdir()
        write(unfinished)
        unfinished.rename(fresh)
        _check_free(place)
        if not place.out.exists():
            fresh.rename(place.out)
        elif foreign_files(place.out, place.kind):
            _replace_files(fresh, place)
        else:
            _swap(fresh, place)
    except OSError as error:
        raise ResultsError(
            f"{error.filename or place.out}: cannot write the results ({error.strerror}). "
            "Make room, or choose another -o, and run again"
        ) from error
    shutil.rmtree(place.partial, ignore_errors=True)


def abandon(place: OutputFolder) -> bool:
    """After work that ended early: keep its finished parts in `OUT.partial`, drop the rest. True if any are kept."""
    for half in ("unfinished", "*.tmp"):
        for path in place.partial.glob(half):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    if any(place.partial.iterdir()):
        return True
    place.partial.rmdir()
    return False


def own_files(folder: Path, kind: str) -> set[str]:
    """The files in `folder` that its summary says a run of this kind wrote; empty where there is no such summary."""
    try:
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        if summary["format"] != kind:
            return set()
        names = {str(name) for name in summary["files"]}
    except (OSError, ValueError, KeyError, TypeError):
        return set()
    return {name for name in names if _is_inside(name) and (folder / name).is_file()}


def foreign_files(folder: Path, kind: str) -> set[str]:
    """The files in `folder` that no run of this kind wrote."""
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()}
    return there - own_files(folder, kind)


def files_in(folder: Path) -> list[str]:
    """Every file below `folder`, relative to it, sorted."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def _is_inside(name: str) -> bool:
    """Whether a name in a summary stays within the folder: it is deleted by that name."""
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and "\\" not in name and ":" not in name


def _check_free(place: OutputFolder) -> None:
    out = place.out
    if (out / "recording.toml").exists():
        raise ResultsError(f"{out}: this is a recording. Results do not go among its files; choose another -o")
    if out.is_dir():
        _check_folder(place)
    elif out.exists() or out.is_symlink():
        raise ResultsError(f"{out}: this is a file, not a folder. Choose another -o")


def _check_folder(place: OutputFolder) -> None:
    out = place.out
    if not any(out.iterdir()):
        return
    ours = own_files(out, place.kind)
    if not place.overwrite:
        what = "already holds results" if ours else "is not empty"
        raise ResultsError(f"{out}: this folder {what}. Choose another -o, or add --force to replace earlier results")
    taken = sorted(name for name in (SUMMARY, *FIXED_NAMES) if (out / name).exists() and name not in ours)
    if taken:
        raise ResultsError(
            f"{out}: {', '.join(taken)} there did not come from an earlier run of this command, so --force does not "
            "replace it. Choose another -o"
        )


def _swap(fresh: Path, place: OutputFolder) -> None:
    """Old results out, new ones in; the old ones are deleted only when the new ones stand."""
    old = place.partial / "replaced"
    shutil.rmtree(old, ignore_errors=True)
    place.out.rename(old)
    try:
        fresh.rename(place.out)
    except OSError:
        old.rename(place.out)
        raise


def _replace_files(fresh: Path, place: OutputFolder) -> None:
    """File by file, where the folder also holds foreign files. The summary goes in last: it lists what is complete."""
    out = place.out
    new, old = files_in(fresh), own_files(out, place.kind)
    clash = sorted(set(new) & foreign_files(out, place.kind))
    if clash:
        raise ResultsError(
            f"{out / clash[0]}: did not come from an earlier run, so it is not replaced. Choose another -o"
        )
    for name in sorted(new, key=lambda name: name == SUMMARY):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (fresh / name).replace(out / name)
    for name in old - set(new):
        (out / name).unlink(missing_ok=True)


def write_summary(path: Path, summary: Mapping[str, Any], files: Sequence[str]) -> None:
    """Write `summary` with the list of all files of the results; it must be the last file written."""
    path.write_text(to_json({**summary, "files": sorted({*files, path.name})}) + "\n", encoding="utf-8")
