"""One file as a result: written completely or not at all; another file is replaced only if asked for."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from onebend.errors import ResultsError
from onebend.files.renames import exchange, move_in, sync_file, sync_folder, umask


def write_file(path: Path, data: str | bytes, *, overwrite: bool = False) -> None:
    """Write `data` to `path`; its folder is made if need be.

    Raises:
        ResultsError: the file exists and `overwrite` is False, or it cannot be written.
    """
    with fresh_file(path, overwrite=overwrite) as beside, _as_results_error(path):
        beside.write_bytes(data.encode("utf-8") if isinstance(data, str) else data)


@contextmanager
def fresh_file(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """An empty file beside `path` to write into; it takes that name when all went well, and is gone otherwise.

    Raises:
        ResultsError: as `write_file`.
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

    Raises:
        ResultsError: there is no such plain file, or it cannot be read or written.
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
