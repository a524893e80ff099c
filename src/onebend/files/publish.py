"""A folder of results: the old one or the new one, whole, at every moment, and no other file is ever lost.

A run works in a folder of its own beside the target (`workplace`), finishes its files there, and then swaps the two
folders in one step (`swap`).
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

# `summary.json` as a manifest: the files of a result by name and SHA-256, and a SHA-256 of the summary itself.
#
# What it lists, unchanged since, is ours. All else in a folder is somebody's, and is neither replaced nor removed.

SUMMARY = "summary.json"
OWN_CHECKSUM = "sha256"  # of everything else in the same object
LARGEST = 64 * 2**20  # bytes: no summary is longer


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file's content, as 64 hexadecimal digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def with_checksum(data: Mapping[str, Any]) -> dict[str, Any]:
    """`data` and the checksum of its content. The text that it is written as does not matter."""
    return {**data, OWN_CHECKSUM: _checksum(data)}


def is_unchanged(data: Mapping[str, Any]) -> bool:
    """Whether the checksum that stands in `data` is that of the rest."""
    return data.get(OWN_CHECKSUM) == _checksum(data)


def _checksum(data: Mapping[str, Any]) -> str:
    rest = {key: value for key, value in data.items() if key != OWN_CHECKSUM}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write `summary` into `folder`; `seal` adds the files to it."""
    (folder / SUMMARY).write_text(to_json(summary) + "\n", encoding="utf-8")


def seal(folder: Path, more: Mapping[str, Any]) -> None:
    """Put `more` and the manifest of all files into the summary in `folder`; to be done last."""
    path = folder / SUMMARY
    data = json.loads(path.read_text(encoding="utf-8"))
    files = {name: sha256_of(folder / name) for name in files_in(folder) if name != SUMMARY}
    data = json.loads(to_json({**data, **more, "files": {**files, SUMMARY: None}}))
    write_summary(folder, with_checksum(data))


def read_summary(folder: Path) -> dict[str, Any] | None:
    """The summary in `folder`, as onebend wrote it; None where there is none, or it was changed since."""
    data = read_object(folder / SUMMARY, LARGEST)
    try:
        return data if data is not None and is_unchanged(data) and isinstance(data.get("files"), dict) else None
    except (ValueError, TypeError, RecursionError):
        return None


def read_object(file: Path, most: int) -> dict[str, Any] | None:
    """The object in a JSON file of up to `most` bytes; None where there is none."""
    try:
        if file.is_symlink() or not file.is_file() or file.stat().st_size > most:
            return None
        data = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return data if isinstance(data, dict) else None


def own_files(folder: Path, kind: str | None = None) -> set[str]:
    """The files in `folder` that a run wrote (one of this `kind`, where one is named) and nobody changed since."""
    summary = read_summary(folder)
    if summary is None or (kind is not None and summary.get("format") != kind):
        return set()
    return {name for name, checksum in summary["files"].items() if _is_ours(folder, name, checksum)}


def changed_files(folder: Path) -> list[str]:
    """The files that the summary of `folder` lists and that are not as it lists them, sorted."""
    summary = read_summary(folder)
    return [] if summary is None else sorted(set(summary["files"]) - own_files(folder))


def is_listed_otherwise(file: Path) -> bool:
    """Whether a summary beside `file` lists it with another content."""
    return _differs(file) and _differs(file)  # once may be a folder that was just being replaced


def _differs(file: Path) -> bool:
    summary = read_summary(file.parent)
    listed = None if summary is None else summary["files"].get(file.name)
    return isinstance(listed, str) and listed != sha256_of(file)


def files_in(folder: Path) -> list[str]:
    """Every file below `folder`, relative to it, sorted; links do not count."""
    found, _ = entries_in(folder)
    return sorted(name for name in found if not (folder / name).is_symlink())


def entries_in(folder: Path) -> tuple[set[str], set[str]]:
    """All that is not a folder (links too) and all folders below `folder`, relative to it. Links are not followed."""
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
    """The folders that these files lie in, relative as they are."""
    return {parent.as_posix() for name in names for parent in PurePosixPath(name).parents} - {"."}


def _is_ours(folder: Path, name: str, checksum: object) -> bool:
    """Whether `name` is a file inside the folder, by no link, with the content that was written."""
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


# Whether results may go to a folder, asked before the work and again before they are put there.


def check_place(out: Path) -> None:
    """Raises `ResultsError` where no results may go to `out`, whatever it holds."""
    if (out / "recording.toml").exists():
        raise ResultsError(f"{out}: this is a recording. Results do not go among its files; choose another -o")
    try:
        mode = out.stat().st_mode  # asked once: another process may make the folder at any moment
    except OSError:  # there is none, or it cannot be made, which is said when it is
        return
    if not stat.S_ISDIR(mode):
        raise ResultsError(f"{out}: this is a file, not a folder. Choose another -o")
    if out.is_mount():
        raise ResultsError(f"{out}: this is where a disk is mounted. Name a folder in it as -o")
    if _stands_in(out):
        raise ResultsError(f"{out}: you stand in this folder, and it is replaced as a whole. Choose another -o")


def check_free(out: Path, kind: str, *, overwrite: bool) -> None:
    """Raises `ResultsError` where results of this kind may not go to `out`.

    To be asked while `out` is locked: it could be replaced meanwhile.
    """
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
    """Raises `ResultsError` where something in `out` could not be carried over to a new folder."""
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
    """Whether the process works in `out` or below; a shell that does would stand in a folder that is gone."""
    try:
        return Path.cwd().is_relative_to(out)
    except OSError:
        return False


# A folder to work in, beside the target, of a name that nobody has; while it is in use, it locks the target.
#
# Each run makes its own (`.OUT.onebend-XXXXXXXX`) with a marker that says for which target, and holds a lock on that
# marker for as long as it lives: the system lets go of it when the process ends, however it ends. Who starts looks
# for the workplaces of others: one that is locked says who is writing; one that is not was left behind, and is gone
# on with.

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
LARGEST_MARKER = 10_000  # bytes of a marker


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

    Raises `ResultsError`: another process is writing to the target now; `OSError`: the folder cannot be made.
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
    """As a pattern for this text alone."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in text)


def _marker(folder: Path) -> dict[str, Any] | None:
    """The content of a workplace's marker; None where the folder is no workplace."""
    data = None if folder.is_symlink() else read_object(folder / MARKER, LARGEST_MARKER)
    return data if data is not None and data.get("format") == FORMAT else None


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


# The swap of two folders: the new results take the name of the old ones in one step, with all that is not ours.
#
# What is in the target and not ours (`manifest`) is linked into the new folder before; nothing is copied. Where the
# system has no such step, the old folder moves away and the new one in; if the process dies between the two, the next
# run for that target brings the old one back.

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


UNFINISHED = "unfinished"  # in the workplace: new results that are being written


@dataclass
class OutputFolder:
    """Where a run puts its results, and where it works until then."""

    out: Path
    kind: str  # the `format` of the summary: results of one kind never replace those of another
    overwrite: bool
    workplace: Workplace
    published: bool = False  # results of this run are in place

    @property
    def work(self) -> Path:
        """Kept when a run is interrupted, so that the next one goes on from there."""
        return self.workplace.folder


def prepare(out: Path, *, kind: str, overwrite: bool) -> OutputFolder:
    """Check that results may go to `out`, lock it and make a workplace, before any heavy work.

    Raises `ResultsError` where the folder is taken, is being written by another process, is a recording, or cannot be
    made.
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
    """Let `write` fill a fresh folder, seal its summary (with `made_from` in it), and put it in place as a whole.

    It may be called again, with more; the later results replace the earlier ones.

    Returns:
        Where files of others stand that appeared under the names of results in the meantime; None as a rule.

    Raises `ResultsError`: writing or moving fails; what was there before stands as it was.
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
    """Whole results that could not be put in place, in the workplace; None where there are none."""
    complete = place.work / COMPLETE
    return complete if complete.is_dir() and not place.published else None


def finish(place: OutputFolder) -> None:
    """After the work: the workplace goes."""
    if (place.work / REPLACED).exists():  # files of others are in it
        place.workplace.release()
    else:
        place.workplace.remove()


def abandon(place: OutputFolder) -> bool:
    """After work that ended early: keep its finished parts in the workplace, drop the rest. True if any are kept."""
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
    """Replace one file of a results folder, whose summary then lists the new content; the folder stays whole.

    Returns:
        False where no summary beside the file lists it as it is; nothing is done then.
    """
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
