"""One file as a result: written completely or not at all; another file is replaced only if asked for."""

from __future__ import annotations

import ctypes
import errno
import io
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from onebend.errors import ResultsError

if TYPE_CHECKING:
    import pyarrow as pa

# Renames in one step, and data that is on the disk before its name is.

HERE = -100  # AT_FDCWD: paths as the process sees them
SWAP = 2  # RENAME_EXCHANGE
CANNOT = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP}


def exchange(one: Path, other: Path) -> bool:
    """Swap the names of two folders, or of two files, in one step (`renameat2`).

    Returns:
        False where this system or file system has no such step; nothing is changed then.

    Raises `OSError`: it has, and it failed; nothing is changed.
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


def write_file(path: Path, data: str | bytes, *, overwrite: bool = False) -> None:
    """Write `data` to `path`; its folder is made if need be.

    Raises `ResultsError`: the file exists and `overwrite` is False, or it cannot be written.
    """
    with fresh_file(path, overwrite=overwrite) as beside, _as_results_error(path):
        beside.write_bytes(data.encode("utf-8") if isinstance(data, str) else data)


@contextmanager
def fresh_file(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """An empty file beside `path` to write into; it takes that name when all went well, and is gone otherwise.

    Raises `ResultsError`: as `write_file`.
    """
    check_name_free(path, overwrite=overwrite)
    with _as_results_error(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem[:40]}.", suffix=path.suffix, dir=path.parent)
        os.close(handle)
    beside = Path(name)
    try:
        yield beside
        with _as_results_error(path):
            beside.chmod(0o666 & ~umask())
            sync_file(beside)
            check_name_free(path, overwrite=overwrite)
            if overwrite:
                beside.replace(path)
            elif not move_in(beside, path):
                check_name_free(path, overwrite=False)
            sync_folder(path.parent)
    finally:
        beside.unlink(missing_ok=True)


def replace_file(path: Path, data: bytes, known: bytes) -> bytes | None:
    """Put `data` in the place of a file that holds `known`, in one step; its permissions stay.

    Returns:
        None where it was done; what the file holds where that is not `known`: then it is left as it is, also where it
        changed in the moment of the replacement (on systems that can swap two names).

    Raises `ResultsError`: there is no such plain file, or it cannot be read or written.
    """
    check_name_free(path, overwrite=True)
    with _as_results_error(path):
        found = path.read_bytes()
        if found != known:
            return found
        handle, name = tempfile.mkstemp(prefix=f".{path.stem[:40]}.", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        beside = Path(name)
        try:
            beside.write_bytes(data)
            shutil.copymode(path, beside)
            sync_file(beside)
            if not exchange(beside, path):
                beside.replace(path)
            elif (found := beside.read_bytes()) != known:
                exchange(beside, path)
                return found
            sync_folder(path.parent)
        finally:
            beside.unlink(missing_ok=True)
    return None


def check_replaceable(path: Path, mark: str, *, overwrite: bool) -> None:
    """Raises `ResultsError` where `path` exists and is not a file that begins with this mark in its first bytes."""
    if path.is_file() and not overwrite:
        with path.open("rb") as stream:
            if mark.encode() in stream.read(200):
                return
    check_name_free(path, overwrite=overwrite)


def check_name_free(path: Path, *, overwrite: bool) -> None:
    """Raises `ResultsError` where `path` is not a plain file, or one that is not to be replaced. Before long work."""
    if path.is_dir():
        raise ResultsError(f"{path}: this is a folder. Name a file in it")
    if path.is_symlink():
        raise ResultsError(f"{path}: this is a link. Name the file that it leads to, or another one")
    if path.exists() and not path.is_file():
        raise ResultsError(f"{path}: this is no plain file, so it is not replaced. Name another one")
    if path.exists() and not overwrite:
        raise ResultsError(f"{path}: exists already. Choose another name, or add --force to replace it")


@contextmanager
def _as_results_error(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ResultsError(f"{path}: cannot be written ({error.strerror or error}). Choose another place") from error


# A file that grows: what is appended is there whole or not at all, whoever reads it meanwhile.


class GrowingFile:
    """A new file, and its size in bytes."""

    def __init__(self, path: Path) -> None:
        """Raises `OSError` where it is there, or cannot be made."""
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        self.size = 0

    def append(self, data: bytes) -> None:
        """Put all of it at the end.

        Raises `OSError`: it does not fit, or the disk is gone; the file is then as before.
        """
        left = memoryview(data)
        try:
            while left:
                left = left[os.write(self._handle, left) :]
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._handle, self.size)
            raise
        self.size += len(data)

    def close(self) -> None:
        """Nothing more is appended."""
        os.close(self._handle)


def as_parquet(table: pa.Table) -> bytes:
    """The content of the table's Parquet file."""
    import pyarrow.parquet as pq  # here: Arrow takes a tenth of a second to load

    stream = io.BytesIO()
    pq.write_table(table, stream)
    return stream.getvalue()


def as_csv(table: pa.Table) -> bytes:
    """The content of the table's CSV file."""
    import pyarrow.csv as pc

    stream = io.BytesIO()
    pc.write_csv(table, stream)
    return stream.getvalue()


# Endings of file names by which a folder's film and force log are guessed.

FILMS = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mpg", ".mpeg", ".mts", ".ts", ".wmv")
LOGS = (".csv", ".parquet", ".pq")  # text of other endings may be anything
