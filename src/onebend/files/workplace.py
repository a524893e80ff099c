"""A folder to work in, beside the target, of a name that nobody has; while it is in use, it locks the target.

Each run makes its own (`.OUT.onebend-XXXXXXXX`) with a marker that says for which target, and holds a lock on that
marker for as long as it lives: the system lets go of it when the process ends, however it ends. Who starts looks for
the workplaces of others: one that is locked says who is writing; one that is not was left behind, and is gone on with.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from onebend.errors import ResultsError
from onebend.files.renames import umask

if sys.platform == "win32":
    import msvcrt

    def _lock(number: int) -> None:
        os.lseek(number, 2**30, os.SEEK_SET)
        msvcrt.locking(number, msvcrt.LK_NBLCK, 1)

    _probe = _lock
else:
    import fcntl

    def _lock(number: int) -> None:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _probe(number: int) -> None:
        fcntl.flock(number, fcntl.LOCK_SH | fcntl.LOCK_NB)  # a folder that may only be read is enough


MARKER = "workplace.json"
FORMAT = "onebend-workplace-1"
LONGEST = 40  # characters of the target's name in the workplace's
LARGEST = 10_000  # bytes of a marker


@dataclass
class Workplace:
    """A folder of one run's own, and its lock."""

    folder: Path
    number: int  # of the marker that is open and locked; -1: let go

    def release(self) -> None:
        """Let go of the lock; the folder stays."""
        if self.number >= 0:
            os.close(self.number)
            self.number = -1

    def remove(self) -> None:
        """Delete the folder, its marker last, and let go of the lock."""
        for path in self.folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != MARKER:
                path.unlink(missing_ok=True)
        with _one_at_a_time(self.folder.parent):  # nobody goes on with a folder that is just going
            shutil.rmtree(self.folder, ignore_errors=True)
            self.release()

    @property
    def is_empty(self) -> bool:
        """Whether nothing but the marker is in it."""
        return all(path.name.startswith(MARKER) for path in self.folder.iterdir())


def enter(target: Path, kind: str) -> Workplace:
    """A workplace for `target`: one that an earlier run of this kind left behind, or a new one; locked.

    Raises:
        ResultsError: another process is writing to the target now.
        OSError: the folder cannot be made.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    with _one_at_a_time(target.parent):
        _drop_unmarked(target)
        left = None
        for folder, marker in left_behind(target):
            _refuse_if_locked(folder, marker, target)
            if left is None and marker.get("kind") == kind and marker.get("locked") and is_private(folder):
                left = folder
        if left is None:
            left = Path(tempfile.mkdtemp(prefix=_prefix(target), dir=target.parent))
            left.chmod(0o777 & ~umask())
        return _locked(left, target, kind)


def left_behind(target: Path) -> list[tuple[Path, dict[str, Any]]]:
    """All workplaces for `target`, with what their markers say."""
    found = []
    for folder in sorted(target.parent.glob(f"{_literal(_prefix(target))}*")):
        marker = _marker(folder)
        if marker is not None and marker.get("target") == target.name:
            found.append((folder, marker))
    return found


def _drop_unmarked(target: Path) -> None:
    """Delete workplaces of runs that ended before they had a marker. (Who makes one now waits: `_one_at_a_time`.)"""
    for folder in target.parent.glob(f"{_literal(_prefix(target))}*"):
        if not folder.is_symlink() and not (folder / MARKER).exists():
            with suppress(OSError):
                for begun in folder.glob(f"{MARKER}.*"):
                    begun.unlink()
                folder.rmdir()  # only where nothing else is in it


def _prefix(target: Path) -> str:
    return f".{target.name[:LONGEST]}.onebend-"


def _literal(text: str) -> str:
    """As a pattern that stands for the text alone."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in text)


def _marker(folder: Path) -> dict[str, Any] | None:
    """What the marker of a workplace says; None where the folder is no workplace."""
    try:
        file = folder / MARKER
        if folder.is_symlink() or file.is_symlink() or not file.is_file() or file.stat().st_size > LARGEST:
            return None
        data = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return data if isinstance(data, dict) and data.get("format") == FORMAT else None


def _refuse_if_locked(folder: Path, marker: dict[str, Any], target: Path) -> None:
    """Raises `ResultsError` where another process holds the lock of the workplace."""
    try:
        number = os.open(folder / MARKER, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0))
    except OSError:  # gone since
        return
    try:
        _probe(number)
    except (BlockingIOError, PermissionError) as error:
        who = f"process {marker.get('process')} on {marker.get('host')}"
        raise ResultsError(
            f"{target}: is being written by {who} since {marker.get('since')}. Wait for it, or choose another -o"
        ) from error
    except OSError:  # a file system without locks
        return
    finally:
        os.close(number)


def is_private(folder: Path) -> bool:
    """Whether the folder is the user's own, not everybody can write to it, and nothing in it is a link elsewhere."""
    if any(path.is_symlink() for path in folder.iterdir()):
        return False
    if sys.platform == "win32":
        return True
    found = folder.lstat()
    return found.st_uid == os.getuid() and not found.st_mode & stat.S_IWOTH


def _locked(folder: Path, target: Path, kind: str) -> Workplace:
    """The folder with a marker of this process, locked; it takes the place of an earlier one as a whole."""
    number, name = tempfile.mkstemp(prefix=f"{MARKER}.", dir=folder)
    try:
        locked = True
        try:
            _lock(number)
        except OSError:  # a file system without locks: nothing is gone on with there
            locked = False
        data = {
            "format": FORMAT,
            "target": target.name,
            "kind": kind,
            "locked": locked,
            "process": os.getpid(),
            "host": socket.gethostname(),
            "since": datetime.now(UTC).astimezone().isoformat(timespec="seconds"),
        }
        os.write(number, (json.dumps(data, indent=2) + "\n").encode())
        Path(name).chmod(0o666 & ~umask())
        Path(name).replace(folder / MARKER)
    except BaseException:
        os.close(number)
        raise
    return Workplace(folder, number)


@contextmanager
def _one_at_a_time(parent: Path) -> Iterator[None]:
    """While two look for each other's workplaces, one of them waits (where the file system locks folders)."""
    if sys.platform == "win32":
        yield
        return
    number = os.open(parent, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(number, fcntl.LOCK_EX)
        yield
    finally:
        os.close(number)
