"""One file as a result: written completely or not at all, replaced only if asked for."""

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

# Renames in one step, and data on disk before their name.

HERE = -100  # AT_FDCWD
SWAP = 2  # RENAME_EXCHANGE
CANNOT = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP}


def exchange(one: Path, other: Path) -> bool:
    """Swaps two names in one step (`renameat2`). Returns False if not supported. Raises `OSError`; then nothing is
    changed."""
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
    """The C library's function, or None."""
    try:
        return ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return None


def move_in(old: Path, new: Path) -> bool:
    """Renames without copying to `new`, which must not exist; False if it does."""
    try:
        os.link(old, new, follow_symlinks=False)
    except FileExistsError:
        return False
    except (OSError, NotImplementedError):  # no hard links
        if os.path.lexists(new):
            return False
        old.rename(new)
        return True
    old.unlink()
    return True


def link_tree(old: Path, new: Path) -> None:
    """Hard links of all files in a new folder; copies where links fail."""
    shutil.copytree(old, new, symlinks=True, copy_function=_link_or_copy)


def _link_or_copy(old: str, new: str) -> None:
    try:
        os.link(old, new, follow_symlinks=False)
    except (OSError, NotImplementedError):
        shutil.copy2(old, new, follow_symlinks=False)


def sync_file(path: Path) -> None:
    with path.open("rb+" if os.name == "nt" else "rb") as stream:
        os.fsync(stream.fileno())


def sync_folder(folder: Path) -> None:
    if os.name == "nt":  # no such call
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
    for path in folder.rglob("*"):
        if path.is_file() and not path.is_symlink():
            sync_file(path)
        elif path.is_dir() and not path.is_symlink():
            sync_folder(path)
    sync_folder(folder)


def umask() -> int:
    """The process's umask, which can be read only by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_file(path: Path, data: str | bytes, *, overwrite: bool = False) -> None:
    """Writes `data` and makes its folder. Raises `ResultsError`: the file exists without `overwrite`, or cannot be
    written."""
    with fresh_file(path, overwrite=overwrite) as beside, _as_results_error(path):
        beside.write_bytes(data.encode("utf-8") if isinstance(data, str) else data)


@contextmanager
def fresh_file(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """A temporary file beside `path` that takes its name on success. Raises `ResultsError` as `write_file`."""
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
    """Replaces a file that holds `known` in one step, keeping its permissions. Returns None, or the file's content if
    it differs, also if it changed during the swap.

    Raises `ResultsError`: no such plain file, or it cannot be read or written.
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
    """Raises `ResultsError` if `path` exists without this mark in its first bytes."""
    if path.is_file() and not overwrite:
        with path.open("rb") as stream:
            if mark.encode() in stream.read(200):
                return
    check_name_free(path, overwrite=overwrite)


def check_name_free(path: Path, *, overwrite: bool) -> None:
    """Raises `ResultsError` if `path` is no plain file or must not be replaced; before long work."""
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


class GrowingFile:
    """A file whose appended blocks are complete or absent for any reader."""

    def __init__(self, path: Path) -> None:
        """Raises `OSError` if it exists or cannot be made."""
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        self.size = 0

    def append(self, data: bytes) -> None:
        """Raises `OSError` if it does not fit; the file is then unchanged."""
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
        os.close(self._handle)


def as_parquet(table: pa.Table) -> bytes:
    """Content of a Parquet file."""
    import pyarrow.parquet as pq  # here: Arrow loads slowly

    stream = io.BytesIO()
    pq.write_table(table, stream)
    return stream.getvalue()


def as_csv(table: pa.Table) -> bytes:
    """Content of a CSV file."""
    import pyarrow.csv as pc

    stream = io.BytesIO()
    pc.write_csv(table, stream)
    return stream.getvalue()


# Endings by which film and force log are guessed.

FILMS = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mpg", ".mpeg", ".mts", ".ts", ".wmv")
LOGS = (".csv", ".parquet", ".pq")  # not .txt, which may be anything
