"""One file as a result: written completely or not at all, replaced only if asked for."""

from __future__ import annotations

import io
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from onebend.errors import ResultsError

if TYPE_CHECKING:
    import pyarrow as pa


def sync_file(path: Path) -> None:
    with path.open("rb+" if os.name == "nt" else "rb") as stream:
        os.fsync(stream.fileno())


def write_file(path: Path, data: str | bytes, *, overwrite: bool = False) -> None:
    """Writes `data` and makes its folder. Raises `ResultsError`: the file exists without `overwrite`, or cannot be
    written."""
    with fresh_file(path, overwrite=overwrite) as beside, _as_results_error(path):
        beside.write_bytes(data.encode("utf-8") if isinstance(data, str) else data)


def write_files(files: Mapping[Path, str | bytes], *, overwrite: bool = False) -> None:
    """Writes all, or none where one of them must not be replaced. Raises `ResultsError` as `write_file`."""
    for path in files:
        check_name_free(path, overwrite=overwrite)
    for path, data in files.items():
        write_file(path, data, overwrite=overwrite)


@contextmanager
def fresh_file(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """The name of a temporary file beside `path` that takes its name on success. Raises `ResultsError` as
    `write_file`."""
    check_name_free(path, overwrite=overwrite)
    with _as_results_error(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.stem[:40]}.{secrets.token_hex(4)}{path.suffix}")
    try:
        yield beside
        with _as_results_error(path):
            sync_file(beside)
            if overwrite and path.exists():
                shutil.copymode(path, beside)
            check_name_free(path, overwrite=overwrite)
            if not overwrite:
                path.touch(exist_ok=False)  # the name is ours from here
            beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


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
LOGS = (".csv",)  # not .txt, which may be anything
