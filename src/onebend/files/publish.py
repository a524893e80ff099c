"""A results folder that is complete, old or new, at every moment, and never loses files of others.

A run works in its own folder beside the target (`workplace`), and then swaps both in one step (`swap`).
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import socket
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any

from onebend.errors import ResultsError
from onebend.files.single_file import exchange, move_in, sync_file, sync_folder, sync_tree, umask
from onebend.text_files import to_json

# `summary.json` as a manifest: name and SHA-256 of each result file, and of the summary itself. Listed, unchanged files
# are ours; all others belong to someone else and are never replaced or removed.

SUMMARY = "summary.json"
OWN_CHECKSUM = "sha256"  # of the other entries
LARGEST = 64 * 2**20  # bytes


def sha256_of(path: Path) -> str:
    """64 hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def with_checksum(data: Mapping[str, Any]) -> dict[str, Any]:
    """`data` with the checksum of its content."""
    return {**data, OWN_CHECKSUM: _checksum(data)}


def is_unchanged(data: Mapping[str, Any]) -> bool:
    """Whether the checksum in `data` is right."""
    return data.get(OWN_CHECKSUM) == _checksum(data)


def _checksum(data: Mapping[str, Any]) -> str:
    rest = {key: value for key, value in data.items() if key != OWN_CHECKSUM}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """`seal` adds the files."""
    (folder / SUMMARY).write_text(to_json(summary) + "\n", encoding="utf-8")


def seal(folder: Path, more: Mapping[str, Any]) -> None:
    """Adds `more` and the manifest of all files to the summary; done last."""
    path = folder / SUMMARY
    data = json.loads(path.read_text(encoding="utf-8"))
    files = {name: sha256_of(folder / name) for name in files_in(folder) if name != SUMMARY}
    data = json.loads(to_json({**data, **more, "files": {**files, SUMMARY: None}}))
    write_summary(folder, with_checksum(data))


def read_summary(folder: Path) -> dict[str, Any] | None:
    """The summary; None if absent or changed."""
    data = read_object(folder / SUMMARY, LARGEST)
    try:
        return data if data is not None and is_unchanged(data) and isinstance(data.get("files"), dict) else None
    except (ValueError, TypeError, RecursionError):
        return None


def read_object(file: Path, most: int) -> dict[str, Any] | None:
    """A JSON object of up to `most` bytes, or None."""
    try:
        if file.is_symlink() or not file.is_file() or file.stat().st_size > most:
            return None
        data = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return data if isinstance(data, dict) else None


def own_files(folder: Path, kind: str | None = None) -> set[str]:
    """Unchanged files of a run (of this `kind`, if given)."""
    summary = read_summary(folder)
    if summary is None or (kind is not None and summary.get("format") != kind):
        return set()
    return {name for name, checksum in summary["files"].items() if _is_ours(folder, name, checksum)}


def changed_files(folder: Path) -> list[str]:
    """Listed files that differ, sorted."""
    summary = read_summary(folder)
    return [] if summary is None else sorted(set(summary["files"]) - own_files(folder))


def is_listed_otherwise(file: Path) -> bool:
    """Whether a summary beside `file` lists another content."""
    return _differs(file) and _differs(file)  # once could be a folder being replaced


def _differs(file: Path) -> bool:
    summary = read_summary(file.parent)
    listed = None if summary is None else summary["files"].get(file.name)
    return isinstance(listed, str) and listed != sha256_of(file)


def files_in(folder: Path) -> list[str]:
    """All files below `folder`, relative, sorted, without links."""
    found, _ = entries_in(folder)
    return sorted(name for name in found if not (folder / name).is_symlink())


def entries_in(folder: Path) -> tuple[set[str], set[str]]:
    """All entries that are not folders (also links), and all folders, relative. Links are not followed."""
    others: set[str] = set()
    folders: set[str] = set()
    waiting = [folder]
    while waiting:
        for path in waiting.pop().iterdir():
            name = path.relative_to(folder).as_posix()
            if path.is_dir() and not path.is_symlink():
                folders.add(name)
                waiting.append(path)
            else:
                others.add(name)
    return others, folders


def parents_of(names: set[str]) -> set[str]:
    return {parent.as_posix() for name in names for parent in PurePosixPath(name).parents} - {"."}


def _is_ours(folder: Path, name: str, checksum: object) -> bool:
    """Whether `name` is a file inside the folder, not through a link, with its written content."""
    inside = PurePosixPath(name)
    if inside.is_absolute() or ".." in inside.parts or not inside.parts or "\\" in name or ":" in name:
        return False
    if any((folder / part).is_symlink() for part in (inside, *inside.parents)):
        return False
    path = folder / name
    try:
        if not path.is_file():
            return False
        return name == SUMMARY or sha256_of(path) == checksum
    except (OSError, ValueError):
        return False


# Whether results may go to a folder; asked before the work and again at its end.


def check_place(out: Path) -> None:
    """Raises `ResultsError` where results can never go to `out`."""
    if (out / "recording.toml").exists():
        raise ResultsError(f"{out}: this is a recording. Results do not go among its files; choose another -o")
    try:
        mode = out.stat().st_mode  # once: another process may make the folder at any moment
    except OSError:  # absent, or cannot be made (reported later)
        return
    if not stat.S_ISDIR(mode):
        raise ResultsError(f"{out}: this is a file, not a folder. Choose another -o")
    if out.is_mount():
        raise ResultsError(f"{out}: this is where a disk is mounted. Name a folder in it as -o")
    if _stands_in(out):
        raise ResultsError(f"{out}: you stand in this folder, and it is replaced as a whole. Choose another -o")


def check_free(out: Path, kind: str, *, overwrite: bool) -> None:
    """Raises `ResultsError` where results of this kind may not go to `out`, which must be locked."""
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
            f"{out}: {', '.join(changed[:3])} there is not as the earlier run left it (edited by hand?), so it "
            "is not replaced. Move it away, or choose another -o"
        )
    if not ours:
        raise ResultsError(
            f"{out}: its files did not come from an earlier run of this command, or {SUMMARY} was changed since, so "
            "they are not replaced. Choose another -o"
        )
    _check_reach(out)


def _check_reach(out: Path) -> None:
    """Raises `ResultsError` where something in `out` could not be carried over."""
    try:
        _, folders = entries_in(out)
        mounted = [name for name in sorted(folders) if _device(out / name) != _device(out)]
    except OSError as error:
        raise ResultsError(
            f"{error.filename}: cannot be looked into ({error.strerror}), so the results around it are not replaced. "
            "Choose another -o"
        ) from error
    if mounted:
        raise ResultsError(f"{out / mounted[0]}: here a disk is mounted, so {out} is not replaced. Choose another -o")


def _device(folder: Path) -> int:
    return folder.lstat().st_dev


def _stands_in(out: Path) -> bool:
    """Whether the process works in `out`; its shell would stand in a removed folder."""
    try:
        return Path.cwd().is_relative_to(out)
    except OSError:
        return False


# A working folder beside the target, which locks the target. Each run makes `.OUT.onebend-XXXXXXXX` with a marker
# naming its target, and locks that marker until the process ends. A locked workplace of another run says who is
# writing; an unlocked one was left behind, and is continued.

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
        fcntl.flock(number, fcntl.LOCK_SH | fcntl.LOCK_NB)  # works on a read-only folder


MARKER = "workplace.json"
FORMAT = "onebend-workplace-1"
LONGEST = 40  # characters of the target's name
LARGEST_MARKER = 10_000  # bytes


@dataclass
class Workplace:
    """A run's own folder, and its lock."""

    folder: Path
    number: int  # of the locked marker; -1: released

    def release(self) -> None:
        """The folder stays."""
        if self.number >= 0:
            os.close(self.number)
            self.number = -1

    def remove(self) -> None:
        """Deletes the folder, its marker last, and releases the lock."""
        for path in self.folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != MARKER:
                path.unlink(missing_ok=True)
        with _one_at_a_time(self.folder.parent):  # nobody continues a folder that is being removed
            shutil.rmtree(self.folder, ignore_errors=True)
            self.release()

    @property
    def is_empty(self) -> bool:
        """Except for the marker."""
        return all(path.name.startswith(MARKER) for path in self.folder.iterdir())


def enter(target: Path, kind: str) -> Workplace:
    """A locked workplace for `target`, left behind by a run of this kind or new.

    Raises `ResultsError`: another process writes to the target. Raises `OSError`: the folder cannot be made.
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
    """Workplaces for `target`, with their markers."""
    found = []
    for folder in sorted(target.parent.glob(f"{_literal(_prefix(target))}*")):
        marker = _marker(folder)
        if marker is not None and marker.get("target") == target.name:
            found.append((folder, marker))
    return found


def _drop_unmarked(target: Path) -> None:
    """Deletes workplaces of runs that ended before they had a marker."""
    for folder in target.parent.glob(f"{_literal(_prefix(target))}*"):
        if not folder.is_symlink() and not (folder / MARKER).exists():
            with suppress(OSError):
                for begun in folder.glob(f"{MARKER}.*"):
                    begun.unlink()
                folder.rmdir()  # only if empty


def _prefix(target: Path) -> str:
    return f".{target.name[:LONGEST]}.onebend-"


def _literal(text: str) -> str:
    """As a glob pattern."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in text)


def _marker(folder: Path) -> dict[str, Any] | None:
    """Its content, or None."""
    data = None if folder.is_symlink() else read_object(folder / MARKER, LARGEST_MARKER)
    return data if data is not None and data.get("format") == FORMAT else None


def _refuse_if_locked(folder: Path, marker: dict[str, Any], target: Path) -> None:
    """Raises `ResultsError` if another process holds the lock."""
    try:
        number = os.open(folder / MARKER, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0))
    except OSError:  # gone
        return
    try:
        _probe(number)
    except (BlockingIOError, PermissionError) as error:
        who = f"process {marker.get('process')} on {marker.get('host')}"
        raise ResultsError(
            f"{target}: is being written by {who} since {marker.get('since')}. Wait for it, or choose another -o"
        ) from error
    except OSError:  # no locks on this file system
        return
    finally:
        os.close(number)


def is_private(folder: Path) -> bool:
    """Whether only the user can write to the folder, and it contains no links elsewhere."""
    if any(path.is_symlink() for path in folder.iterdir()):
        return False
    if sys.platform == "win32":
        return True
    found = folder.lstat()
    return found.st_uid == os.getuid() and not found.st_mode & stat.S_IWOTH


def _locked(folder: Path, target: Path, kind: str) -> Workplace:
    """The folder with a marker of this process, locked, in place of an earlier one."""
    number, name = tempfile.mkstemp(prefix=f"{MARKER}.", dir=folder)
    try:
        locked = True
        try:
            _lock(number)
        except OSError:  # no locks: nothing is continued
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
    """Serialises the search for workplaces (where folders can be locked)."""
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


# The swap: new results take the target's name in one step, with all files that are not ours, which are linked into the
# new folder before. Without such a system call the old folder moves away and the new one in; after a crash in between,
# the next run restores the old one.

COMPLETE = "complete"  # in a workplace: complete new results; after a swap the old ones
REPLACED = "replaced"
SWAPPING = "swapping.json"  # names the new folder during a swap


def swap_in(complete: Path, out: Path, work: Path) -> Path | None:
    """Gives the new folder the target's name, with the other files of the target. Returns a folder with files of others
    that could not be moved, or None."""
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
    """Completes or reverts an interrupted swap."""
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
    """Links all in `old` that is not ours into `new`; the rest is moved after the swap. Raises `ResultsError` on a name
    conflict."""
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
    """Deletes our files in `old` and moves the rest to `new`. Returns `old` if files of others remain, else None."""
    ours = own_files(old)
    others, folders = entries_in(old)
    made = parents_of(ours)
    for name in folders:
        with suppress(OSError):  # a write-protected folder could not be emptied
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
    if SUMMARY in ours:  # last: it lists ours
        (old / SUMMARY).unlink()
    with suppress(OSError):
        old.rmdir()
    return old if old.exists() else None


def _hand_over(before: Path, after: Path, new: Path) -> None:
    """Ensures that a file of others is in `new` as `after`, and drops its name `before`, unless the name is taken."""
    if not after.parent.resolve().is_relative_to(new):
        return
    if not os.path.lexists(after):
        after.parent.mkdir(parents=True, exist_ok=True)
        move_in(before, after)
    elif _identity(after) == _identity(before):
        before.unlink()


UNFINISHED = "unfinished"  # in the workplace


@dataclass
class OutputFolder:
    """A run's target and workplace."""

    out: Path
    kind: str  # the summary's `format`: results replace only their own kind
    overwrite: bool
    workplace: Workplace
    published: bool = False

    @property
    def work(self) -> Path:
        """Kept on interruption; the next run continues."""
        return self.workplace.folder


def prepare(out: Path, *, kind: str, overwrite: bool) -> OutputFolder:
    """Checks and locks `out` and makes a workplace, before heavy work.

    Raises `ResultsError`: the folder is taken, locked, a recording, or cannot be made.
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
    """Lets `write` fill a new folder, seals its summary (with `made_from`), and puts it in place; may be called again
    with later results.

    Returns a folder with files of others that took names of results meanwhile, or None. Raises `ResultsError`: writing
    or moving failed; the target is unchanged.
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
        left = swap_in(complete, place.out, place.work)
    except OSError as error:
        raise ResultsError(
            f"{error.filename or place.out}: cannot write the results ({error.strerror}). "
            "Make room, or choose another -o, and run again"
        ) from error
    place.published = True
    return left


def unplaced(place: OutputFolder) -> Path | None:
    """Complete results in the workplace that could not be put in place, or None."""
    complete = place.work / COMPLETE
    return complete if complete.is_dir() and not place.published else None


def finish(place: OutputFolder) -> None:
    """Removes the workplace."""
    if (place.work / REPLACED).exists():  # contains files of others
        place.workplace.release()
    else:
        place.workplace.remove()


def abandon(place: OutputFolder) -> bool:
    """After an early end: keeps finished parts in the workplace; whether there are any."""
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
    """Replaces a file of a results folder and its entry in the summary. Returns False if no summary lists the file as
    it is."""
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
