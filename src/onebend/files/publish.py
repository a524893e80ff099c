"""A folder of results: the old one or the new one, whole, at every moment, and no other file is ever lost.

A run works in a folder of its own beside the target (`workplace`), finishes its files there, and then swaps the two
folders in one step. What is in the target and not ours (`manifest`) is linked into the new folder before; nothing is
copied. Where the system has no such step, the old folder moves away and the new one in; if the process dies between
the two, the next run for that target brings the old one back.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from onebend.errors import ResultsError
from onebend.files.manifest import (
    SUMMARY,
    changed_files,
    entries_in,
    files_in,
    own_files,
    parents_of,
    read_summary,
    seal,
    write_summary,
)
from onebend.files.renames import exchange, move_in, sync_file, sync_folder, sync_tree
from onebend.files.workplace import Workplace, enter, is_private, left_behind

UNFINISHED = "unfinished"  # in the workplace: new results that are being written
COMPLETE = "complete"  # new results, all written; after a swap, the old ones
REPLACED = "replaced"  # the old ones
SWAPPING = "swapping.json"  # which folder is the new one, while they are swapped


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
        left = _put_in_place(complete, place)
    except OSError as error:
        raise ResultsError(
            f"{error.filename or place.out}: cannot write the results ({error.strerror}). "
            "Make room, or choose another -o, and run again"
        ) from error
    place.published = True
    return left


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


def check_place(out: Path) -> None:
    """Raises `ResultsError` where no results may go to `out`, whatever it holds."""
    if (out / "recording.toml").exists():
        raise ResultsError(f"{out}: this is a recording. Results do not go among its files; choose another -o")
    if not out.is_dir():
        if os.path.lexists(out):
            raise ResultsError(f"{out}: this is a file, not a folder. Choose another -o")
    elif out.is_mount():
        raise ResultsError(f"{out}: this is where a disk is mounted. Name a folder in it as -o")
    elif _stands_in(out):
        raise ResultsError(f"{out}: you stand in this folder, and it is replaced as a whole. Choose another -o")


def check_free(out: Path, kind: str, *, overwrite: bool) -> None:
    """Raises `ResultsError` where results of this kind may not go to `out`.

    To be asked while `out` is locked: it could be replaced meanwhile.
    """
    check_place(out)
    if not out.is_dir() or not any(out.iterdir()):
        return
    ours = own_files(out, kind)
    if not overwrite:
        what = "already holds results" if ours else "is not empty"
        raise ResultsError(f"{out}: this folder {what}. Choose another -o, or add --force to replace earlier results")
    changed = [name for name in changed_files(out) if os.path.lexists(out / name)] if ours else []
    if changed:
        raise ResultsError(
            f"{out}: {', '.join(changed[:3])} there is not as the earlier run left it (edited by hand?), so --force "
            "does not replace it. Move it away, or choose another -o"
        )
    if not ours:
        raise ResultsError(
            f"{out}: its files did not come from an earlier run of this command, or {SUMMARY} was changed since, so "
            "--force does not replace them. Choose another -o"
        )


def _stands_in(out: Path) -> bool:
    """Whether the process works in `out` or below; a shell that does would stand in a folder that is gone."""
    try:
        return Path.cwd().is_relative_to(out)
    except OSError:
        return False


def _put_in_place(complete: Path, place: OutputFolder) -> Path | None:
    """The new folder takes the name of the target; what was there and not ours is in it."""
    out, replaced = place.out, place.work / REPLACED
    if not os.path.lexists(out):
        complete.rename(out)
        sync_folder(out.parent)
        return None
    _carry_over(out, complete)
    sync_folder(complete)
    (place.work / SWAPPING).write_text(json.dumps({"new": _identity(complete)}), encoding="utf-8")
    sync_file(place.work / SWAPPING)
    sync_folder(place.work)
    if exchange(complete, out):
        complete.rename(replaced)
    else:
        out.rename(replaced)
        try:
            complete.rename(out)
        except OSError:
            replaced.rename(out)
            raise
    sync_folder(out.parent)
    (place.work / SWAPPING).unlink()
    return _clear(replaced, out)


def recover(target: Path) -> None:
    """Bring the workplaces for `target` to a rest where a process died while it swapped folders there."""
    for work, _ in left_behind(target):
        swapping, complete, replaced = work / SWAPPING, work / COMPLETE, work / REPLACED
        if not is_private(work):
            continue
        if swapping.exists():
            with suppress(OSError, ValueError, KeyError, TypeError):
                new = json.loads(swapping.read_text(encoding="utf-8"))["new"]
                if complete.is_dir() and _identity(complete) != new:
                    complete.rename(replaced)
            if replaced.is_dir() and not os.path.lexists(target):
                replaced.rename(target)
            swapping.unlink()
        if replaced.is_dir() and target.is_dir():
            _clear(replaced, target)


def _identity(folder: Path) -> list[int]:
    found = folder.lstat()
    return [found.st_dev, found.st_ino]


def _carry_over(old: Path, new: Path) -> None:
    """Link all that is in `old` and not ours into `new`. What cannot be linked is moved after the swap.

    Raises `ResultsError` where results would take the name of something of others.
    """
    ours = own_files(old)
    others, folders = entries_in(old)
    others -= ours
    theirs = (folders - parents_of(ours)) | (folders & parents_of(others))
    fresh = set(files_in(new))
    taken = sorted((fresh & (others | theirs)) | (parents_of(fresh) & others))
    if taken:
        raise ResultsError(
            f"{old / taken[0]}: did not come from an earlier run, so it is not replaced. Choose another -o"
        )
    for name in sorted(theirs):
        (new / name).mkdir(exist_ok=True)
    for name in sorted(others):
        with suppress(OSError, NotImplementedError):
            os.link(old / name, new / name, follow_symlinks=False)
    for name in sorted(theirs, reverse=True):
        shutil.copystat(old / name, new / name)
    new.chmod(old.stat().st_mode & 0o7777)


def _clear(old: Path, new: Path) -> Path | None:
    """Delete our files in `old`; what else is there, is in `new` too, or goes there.

    Returns:
        `old`, where something of others can neither go nor be left out; else None.
    """
    ours = own_files(old)
    others, folders = entries_in(old)
    made = parents_of(ours)
    for name in folders:
        with suppress(OSError):  # one that may not be written to could not be emptied
            (old / name).chmod(0o700)
    for name in sorted(others - ours):
        with suppress(OSError):
            _hand_over(old / name, new / name, new)
    for name in sorted(ours - {SUMMARY}):
        (old / name).unlink(missing_ok=True)
    for name in sorted(folders, reverse=True):
        with suppress(OSError):
            if name not in made and not os.path.lexists(new / name):
                (new / name).mkdir(parents=True)
            (old / name).rmdir()
    if SUMMARY in ours:  # last: it says which are ours
        (old / SUMMARY).unlink()
    with suppress(OSError):
        old.rmdir()
    return old if old.exists() else None


def _hand_over(before: Path, after: Path, new: Path) -> None:
    """See that a file of others is in the folder `new` as `after`, and drop its name `before`; unless that is taken."""
    if not after.parent.resolve().is_relative_to(new):
        return
    if not os.path.lexists(after):
        after.parent.mkdir(parents=True, exist_ok=True)
        move_in(before, after)
    elif _identity(after) == _identity(before):
        before.unlink()
