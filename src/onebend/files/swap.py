"""The swap of two folders: the new results take the name of the old ones in one step, with all that is not ours.

What is in the target and not ours (`manifest`) is linked into the new folder before; nothing is copied. Where the
system has no such step, the old folder moves away and the new one in; if the process dies between the two, the next
run for that target brings the old one back.
"""

from __future__ import annotations

import json
import os
import shutil
from contextlib import suppress
from pathlib import Path

from onebend.errors import ResultsError
from onebend.files.manifest import SUMMARY, entries_in, files_in, own_files, parents_of
from onebend.files.renames import exchange, move_in, sync_file, sync_folder
from onebend.files.workplace import is_private, left_behind

COMPLETE = "complete"  # in a workplace: new results, all written; after a swap, the old ones
REPLACED = "replaced"  # the old ones
SWAPPING = "swapping.json"  # which folder is the new one, while they are swapped


def swap_in(complete: Path, out: Path, work: Path) -> Path | None:
    """Give the new folder the name of the target; what was there and not ours is in it then.

    Returns:
        A folder with what is of others and could not be brought into the new one; None as a rule.
    """
    replaced = work / REPLACED
    if not os.path.lexists(out):
        complete.rename(out)
        sync_folder(out.parent)
        return None
    _carry_over(out, complete)
    sync_folder(complete)
    (work / SWAPPING).write_text(json.dumps({"new": _identity(complete)}), encoding="utf-8")
    sync_file(work / SWAPPING)
    sync_folder(work)
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
    (work / SWAPPING).unlink()
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
