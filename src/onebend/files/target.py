"""Whether results may go to a folder, asked before the work and again before they are put there."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from onebend.errors import ResultsError
from onebend.files.manifest import SUMMARY, changed_files, entries_in, own_files


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
