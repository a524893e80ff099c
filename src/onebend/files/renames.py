"""Renames in one step, and data that is on the disk before its name is."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
from functools import cache
from pathlib import Path
from typing import Any

HERE = -100  # AT_FDCWD: paths as the process sees them
SWAP = 2  # RENAME_EXCHANGE
CANNOT = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP}


def exchange(one: Path, other: Path) -> bool:
    """Swap the names of two folders, or of two files, in one step (`renameat2`).

    Returns:
        False where this system or file system has no such step; nothing is changed then.

    Raises:
        OSError: it has, and it failed; nothing is changed.
    """
    call = _renameat2()
    if call is None:
        return False
    if call(HERE, os.fsencode(one), HERE, os.fsencode(other), SWAP) == 0:
        return True
    number = ctypes.get_errno()
    if number in CANNOT:
        return False
    raise OSError(number, os.strerror(number), str(other))


@cache
def _renameat2() -> Any:
    """The C library's function; None where it has none."""
    try:
        return ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return None


def move_in(old: Path, new: Path) -> bool:
    """Give a file the name `new`, which must not exist; no data are copied. False where that name is taken."""
    try:
        os.link(old, new, follow_symlinks=False)
    except FileExistsError:
        return False
    except (OSError, NotImplementedError):  # no hard links here
        if os.path.lexists(new):
            return False
        old.rename(new)
        return True
    old.unlink()
    return True


def link_tree(old: Path, new: Path) -> None:
    """The files of the folder `old` in a new folder too; their data are copied only where nothing can be linked."""
    shutil.copytree(old, new, symlinks=True, copy_function=_link_or_copy)


def _link_or_copy(old: str, new: str) -> None:
    try:
        os.link(old, new, follow_symlinks=False)
    except (OSError, NotImplementedError):
        shutil.copy2(old, new, follow_symlinks=False)


def sync_file(path: Path) -> None:
    """Return when the file's data are on the disk."""
    with path.open("rb+" if os.name == "nt" else "rb") as stream:
        os.fsync(stream.fileno())


def sync_folder(folder: Path) -> None:
    """Return when the folder's names are on the disk."""
    if os.name == "nt":  # has no such call for folders
        return
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    except OSError as error:
        if error.errno not in CANNOT:
            raise
    finally:
        os.close(number)


def sync_tree(folder: Path) -> None:
    """Return when every file below `folder` and every name is on the disk."""
    for path in folder.rglob("*"):
        if path.is_file() and not path.is_symlink():
            sync_file(path)
        elif path.is_dir() and not path.is_symlink():
            sync_folder(path)
    sync_folder(folder)


def umask() -> int:
    """The process's mask for new files; it can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
