"""A file that grows: what is appended is there whole or not at all, whoever reads it meanwhile."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


class GrowingFile:
    """A new file, and its size in bytes."""

    def __init__(self, path: Path) -> None:
        """Raises `OSError` where it is there, or cannot be made."""
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        self.size = 0

    def append(self, data: bytes) -> None:
        """Put all of it at the end.

        Raises:
            OSError: it does not fit, or the disk is gone; the file is then as before.
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
