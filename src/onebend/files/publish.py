"""A results folder: written whole beside its target, then moved in; files of others stay as they are.

A run works in a folder of its own beside the target, `.OUT.onebend-XXXXXXXX`, locked while its process lives. Complete
results move from there into the target file by file, the summary last. If that is interrupted, the next run ends it.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import socket
import stat
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any

from onebend.errors import ResultsError
from onebend.files.single_file import sync_file, write_file
from onebend.text_files import to_json

try:
    import fcntl
except ImportError:  # Windows: two runs do not see each other
    fcntl = None  # type: ignore[assignment]

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


def this_onebend() -> str:
    """What writes, with its version."""
    return f"onebend {version('onebend')}"


def headed(kind: str, **more: Any) -> dict[str, Any]:
    """The first entries of a summary: its format, who wrote it, and `more`."""
    return {"format": kind, "written_by": this_onebend(), **more}


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """`seal` adds the files."""
    write_file(folder / SUMMARY, to_json(summary) + "\n", overwrite=True)


def seal(folder: Path, more: Mapping[str, Any]) -> None:
    """Adds `more` and the manifest of all files to the summary; done last."""
    data = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    files = {name: sha256_of(folder / name) for name in files_in(folder) if name != SUMMARY}
    data = json.loads(to_json({**data, **more, "files": {**files, SUMMARY: None}}))
    write_summary(folder, with_checksum(data))


def read_summary(folder: Path) -> dict[str, Any] | None:
    """The summary; None if absent or changed."""
    data = read_object(folder / SUMMARY, LARGEST)
    return data if data is not None and is_unchanged(data) and isinstance(data.get("files"), dict) else None


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
    return _differs(file) and _differs(file)  # once could be while results move in


def _differs(file: Path) -> bool:
    summary = read_summary(file.parent)
    listed = None if summary is None else summary["files"].get(file.name)
    return isinstance(listed, str) and listed != sha256_of(file)


def files_in(folder: Path) -> list[str]:
    """All files below `folder`, relative, sorted; links are neither listed nor followed."""
    found = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return sorted(path.relative_to(folder).as_posix() for path in found)


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
    if out.exists() and not out.is_dir():
        raise ResultsError(f"{out}: this is a file, not a folder. Choose another -o")


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


def _check_names(complete: Path, out: Path) -> None:
    """Raises `ResultsError` where something of others has the name of a result."""
    ours = own_files(out)
    for name in files_in(complete):
        above = [out / part for part in PurePosixPath(name).parents][:-1]
        taken = any(one.is_symlink() or (one.exists() and not one.is_dir()) for one in above)
        if taken or (name not in ours and os.path.lexists(out / name)):
            raise ResultsError(
                f"{out / name}: did not come from an earlier run, so it is not replaced. Choose another -o"
            )


def _move_in(complete: Path, out: Path) -> None:
    """Replaces what is ours in `out` by the complete results. Goes on from where an earlier call ended."""
    _check_names(complete, out)
    if not os.path.lexists(out):
        complete.rename(out)
        return
    summary = read_summary(complete)
    for name in own_files(out) - set(summary["files"]) if summary else ():
        (out / name).unlink()
        with suppress(OSError):  # only folders that are empty now
            for part in PurePosixPath(name).parents:
                (out / part).rmdir()
    for name in sorted(files_in(complete), key=lambda one: one == SUMMARY):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (complete / name).replace(out / name)
    shutil.rmtree(complete)


# A working folder beside the target, which locks the target. A locked one says who is writing.

MARKER = "workplace.json"
LONGEST = 40  # characters of the target's name
LARGEST_MARKER = 10_000  # bytes
UNFINISHED, COMPLETE, MOVING = "unfinished", "complete", "moving"  # results in a workplace


@dataclass
class OutputFolder:
    """A run's target and workplace."""

    out: Path
    kind: str  # the summary's `format`: results replace only their own kind
    work: Path
    lock: int  # number of the open marker
    overwrite: bool = False
    published: bool = False


def enter(target: Path, kind: str) -> OutputFolder:
    """A locked workplace for `target`. What an interrupted run has begun to move in is moved in.

    Raises `ResultsError`: another process writes to the target, or the workplace is not ours. Raises `OSError`: the
    folder cannot be made.
    """
    named = hashlib.sha256(os.fsencode(target.name)).hexdigest()[:8]
    work = target.parent / f".{target.name[:LONGEST]}.onebend-{named}"
    number = _locked(work, target)
    try:
        if (work / MOVING).is_dir():
            _move_in(work / MOVING, target)
        since = datetime.now().astimezone().isoformat(timespec="seconds")
        who = {"process": os.getpid(), "host": socket.gethostname(), "since": since}
        os.ftruncate(number, 0)
        os.write(number, json.dumps(who).encode())
    except BaseException:
        os.close(number)
        raise
    return OutputFolder(target, kind, work, number)


def _locked(work: Path, target: Path) -> int:
    """The number of the marker, locked until it is closed or the process ends."""
    while True:
        work.mkdir(parents=True, exist_ok=True)
        try:
            _check_private(work)
            number = os.open(work / MARKER, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        except FileNotFoundError:  # the run before removes it in this moment
            continue
        try:
            if fcntl is not None:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(number)
            said = read_object(work / MARKER, LARGEST_MARKER) or {}
            who = "process {process} on {host} since {since}".format_map(defaultdict(lambda: "?", said))
            raise ResultsError(f"{target}: is being written by {who}. Wait for it, or choose another -o") from None
        except OSError:  # no locks on this file system
            return number
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(number), (work / MARKER).lstat()):
                return number
        os.close(number)


def _check_private(work: Path) -> None:
    """Raises `ResultsError` for a folder that is a link, holds links or no marker, or that others own or write to."""
    found = work.lstat()
    inside = list(work.iterdir()) if stat.S_ISDIR(found.st_mode) else [work]
    others = os.name == "posix" and (found.st_uid != os.getuid() or found.st_mode & stat.S_IWOTH)
    unmarked = bool(inside) and MARKER not in (path.name for path in inside)
    if others or unmarked or any(path.is_symlink() for path in inside):
        raise ResultsError(f"{work}: is in the way of a run's own folder, and not of onebend. Move it away")


def prepare(out: Path, *, kind: str, overwrite: bool) -> OutputFolder:
    """Checks and locks `out` and makes a workplace, before heavy work.

    Raises `ResultsError`: the folder is taken, locked, a recording, or cannot be made.
    """
    target = Path(os.path.realpath(out))
    check_place(target)
    try:
        place = enter(target, kind)
    except OSError as error:
        raise ResultsError(f"{out}: cannot be made ({error.strerror}). Choose another -o") from error
    place.overwrite = overwrite
    try:
        check_free(target, kind, overwrite=overwrite)
    except BaseException:
        abandon(place)
        raise
    return place


@contextmanager
def workplace(out: Path, kind: str, overwrite: bool) -> Iterator[OutputFolder]:
    """For results in `out`; an early end says what is there."""
    place = prepare(out, kind=kind, overwrite=overwrite)
    try:
        yield place
    except BaseException as error:
        abandon(place)
        if place.published:
            error.add_note(f"The results are in {out}, but for the pictures.")
        elif (whole := unplaced(place)) is not None:
            error.add_note(f"The results themselves are in {whole}.")
        elif isinstance(error, KeyboardInterrupt):
            error.add_note("Nothing was written.")
        raise
    finish(place)


def publish(place: OutputFolder, write: Callable[[Path], None], made_from: Mapping[str, Any] | None = None) -> None:
    """Lets `write` fill a new folder, seals its summary (with `made_from`), and moves it in place; may be called again
    with later results.

    Raises `ResultsError`: writing or moving failed, or what is in the target is not ours.
    """
    unfinished, complete = place.work / UNFINISHED, place.work / COMPLETE
    try:
        for stale in (unfinished, complete):
            shutil.rmtree(stale, ignore_errors=True)
        unfinished.mkdir()
        write(unfinished)
        if (unfinished / SUMMARY).exists():
            seal(unfinished, made_from or {})
        for name in files_in(unfinished):
            sync_file(unfinished / name)
        unfinished.rename(complete)
        check_free(place.out, place.kind, overwrite=place.overwrite or place.published)
        _check_names(complete, place.out)
        complete.rename(place.work / MOVING)
        _move_in(place.work / MOVING, place.out)
    except OSError as error:
        raise ResultsError(
            f"{error.filename or place.out}: cannot write the results ({error.strerror}). "
            "Make room, or choose another -o, and run again"
        ) from error
    place.published = True


def unplaced(place: OutputFolder) -> Path | None:
    """Complete results in the workplace that could not be put in place, or None."""
    complete = place.work / COMPLETE
    return complete if complete.is_dir() and not place.published else None


def finish(place: OutputFolder) -> None:
    """Removes the workplace, its marker last, and releases the lock."""
    for path in place.work.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        elif path.name != MARKER:
            path.unlink(missing_ok=True)
    (place.work / MARKER).unlink(missing_ok=True)
    with suppress(OSError):  # the next run is in it
        place.work.rmdir()
    os.close(place.lock)


def abandon(place: OutputFolder) -> None:
    """After an early end: keeps results that are complete, if they are not in place."""
    if unplaced(place) is None and not (place.work / MOVING).is_dir():
        finish(place)
    else:
        os.close(place.lock)


def amend(file: Path, data: bytes) -> bool:
    """Replaces a file of a results folder and its entry in the summary. Returns False if no summary lists the file as
    it is."""
    folder = Path(os.path.realpath(file.parent))
    summary = read_summary(folder)
    if summary is None or file.name not in own_files(folder):
        return False
    place = enter(folder, str(summary["format"]))
    try:
        write_file(folder / file.name, data, overwrite=True)
        files = {**summary["files"], file.name: hashlib.sha256(data).hexdigest()}
        write_summary(folder, with_checksum({**summary, "files": files}))
    finally:
        finish(place)
    return True
