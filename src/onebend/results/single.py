"""One file as a result: written whole or not at all, and never over another without being told to."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from onebend.errors import ResultsError


def write_file(path: Path, data: str | bytes, *, overwrite: bool = False) -> None:
    """Write `data` to `path`; its folder is made if need be.

    Raises:
        ResultsError: the file exists and `overwrite` is False, or it cannot be written.
    """
    content = data.encode("utf-8") if isinstance(data, str) else data
    try:
        free_place(path, overwrite=overwrite)
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        beside = Path(name)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            beside.chmod(0o666 & ~_umask())
            beside.replace(path)
        except BaseException:
            beside.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise ResultsError(f"{path}: cannot be written ({error.strerror}). Choose another place") from error


def free_place(path: Path, *, overwrite: bool) -> None:
    """Raises `ResultsError` where `path` is a folder, or a file that is not to be replaced. Before long work."""
    if path.is_dir():
        raise ResultsError(f"{path}: this is a folder. Name a file in it")
    if path.exists() and not overwrite:
        raise ResultsError(f"{path}: exists already. Choose another name, or add --force to replace it")


def _umask() -> int:
    """The process's mask for new files; it can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
