"""A folder of results: the old one or the new one, whole, at every moment, and no other file is ever lost.

A run works in a folder of its own beside the target (`workplace`), finishes its files there, and then swaps the two
folders in one step (`swap`).
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from onebend.errors import ResultsError
from onebend.files.manifest import SUMMARY, own_files, read_summary, seal, write_summary
from onebend.files.renames import sync_tree
from onebend.files.swap import COMPLETE, REPLACED, recover, swap_in
from onebend.files.target import check_free, check_place
from onebend.files.workplace import Workplace, enter

UNFINISHED = "unfinished"  # in the workplace: new results that are being written


@dataclass
class OutputFolder:
    """Where a run puts its results, and where it works until then."""

    out: Path
    kind: str  # the `format` of the summary: results of one kind never replace those of another
    overwrite: bool
    workplace: Workplace
    published: bool = False  # results of this run are in place

    @property
    def work(self) -> Path:
        """Kept when a run is interrupted, so that the next one goes on from there."""
        return self.workplace.folder


def prepare(out: Path, *, kind: str, overwrite: bool) -> OutputFolder:
    """Check that results may go to `out`, lock it and make a workplace, before any heavy work.

    Raises `ResultsError` where the folder is taken, is being written by another process, is a recording, or cannot be
    made.
    """
    target = Path(os.path.realpath(out))
    check_place(target)
    try:
        workplace = enter(target, kind)
    except OSError as error:
        raise ResultsError(f"{out}: cannot be made ({error.strerror}). Choose another -o") from error
    place = OutputFolder(target, kind, overwrite, workplace)
    try:
        recover(target)
        check_free(target, kind, overwrite=overwrite)
    except BaseException:
        abandon(place)
        raise
    return place


def publish(
    place: OutputFolder, write: Callable[[Path], None], made_from: Mapping[str, Any] | None = None
) -> Path | None:
    """Let `write` fill a fresh folder, seal its summary (with `made_from` in it), and put it in place as a whole.

    It may be called again, with more; the later results replace the earlier ones.

    Returns:
        Where files of others stand that appeared under the names of results in the meantime; None as a rule.

    Raises:
        ResultsError: writing or moving fails; what was there before stands as it was.
    """
    unfinished, complete = place.work / UNFINISHED, place.work / COMPLETE
    try:
        for stale in (unfinished, complete):
            shutil.rmtree(stale, ignore_errors=True)
        unfinished.mkdir()
        write(unfinished)
        if (unfinished / SUMMARY).exists():
            seal(unfinished, made_from or {})
        sync_tree(unfinished)
        unfinished.rename(complete)
        check_free(place.out, place.kind, overwrite=place.overwrite or place.published)
        left = swap_in(complete, place.out, place.work)
    except OSError as error:
        raise ResultsError(
            f"{error.filename or place.out}: cannot write the results ({error.strerror}). "
            "Make room, or choose another -o, and run again"
        ) from error
    place.published = True
    return left


def unplaced(place: OutputFolder) -> Path | None:
    """Whole results that could not be put in place, in the workplace; None where there are none."""
    complete = place.work / COMPLETE
    return complete if complete.is_dir() and not place.published else None


def finish(place: OutputFolder) -> None:
    """After the work: the workplace goes."""
    if (place.work / REPLACED).exists():  # files of others are in it
        place.workplace.release()
    else:
        place.workplace.remove()


def abandon(place: OutputFolder) -> bool:
    """After work that ended early: keep its finished parts in the workplace, drop the rest. True if any are kept."""
    with suppress(OSError):
        recover(place.out)
    for half in (UNFINISHED, "*.tmp"):
        for path in place.work.glob(half):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    if place.published:
        shutil.rmtree(place.work / COMPLETE, ignore_errors=True)
    if not place.workplace.is_empty:
        place.workplace.release()
        return True
    place.workplace.remove()
    return False


def amend(file: Path, data: bytes) -> bool:
    """Replace one file of a results folder, whose summary then lists the new content; the folder stays whole.

    Returns:
        False where no summary beside the file lists it as it is; nothing is done then.
    """
    folder = file.parent
    summary = read_summary(folder)
    if summary is None or file.name not in own_files(folder):
        return False

    def write(fresh: Path) -> None:
        for name in own_files(folder) - {SUMMARY, file.name}:
            (fresh / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(folder / name, fresh / name)
        (fresh / file.name).write_bytes(data)
        write_summary(fresh, summary)

    place = prepare(folder, kind=str(summary["format"]), overwrite=True)
    try:
        publish(place, write)
        finish(place)
    except BaseException:
        abandon(place)
        raise
    return True
