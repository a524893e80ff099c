"""Files of others near a result: nothing of theirs is deleted, moved or written to, whatever it is called."""

from __future__ import annotations

import json
import os
import re
import shutil
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from onebend.cli import app
from onebend.errors import RecordingError, ResultsError
from onebend.files.kept import KeptFolder
from onebend.files.publish import (
    MARKER,
    OWN_CHECKSUM,
    abandon,
    finish,
    own_files,
    prepare,
    publish,
    seal,
    sha256_of,
    with_checksum,
    write_summary,
)
from onebend.files.single_file import write_file
from onebend.live.recording_folder import copy_description
from tests.attack.conftest import EXAMPLE
from tests.attack.killing import KIND, run, state_of, write

NAME = f"tags-{7:040x}"  # of an entry of the cache


def tree(folder: Path) -> dict[str, str]:
    """Everything below, links as where they lead."""
    return {
        str(path.relative_to(folder)): str(path.readlink()) if path.is_symlink() else path.read_text()
        for path in folder.rglob("*")
        if path.is_symlink() or path.is_file()
    }


def sealed(folder: Path, files: dict[str, Any]) -> None:
    """A summary as onebend would write it, that lists these files."""
    write_summary(folder, with_checksum({"format": KIND, "mark": "forged", "files": {**files, "summary.json": None}}))


@pytest.mark.parametrize(
    "name", ["R.partial", "R.tmp", ".R.tmp", "unfinished", "complete", "replaced", ".R.onebend-thesis", "R.onebend"]
)
def test_a_folder_of_any_name_beside_the_target_is_left_alone(tmp_path: Path, name: str) -> None:
    thesis = tmp_path / name
    (thesis / "unfinished").mkdir(parents=True)
    (thesis / "replaced").mkdir()
    for file in ("thesis.tex", "unfinished/chapter.tex", "replaced/notes.txt", "draft.tmp", "workplace.json"):
        (thesis / file).write_text("three years")
    before = tree(thesis)
    run(tmp_path / "R", "old")
    run(tmp_path / "R", "new")
    place = prepare(tmp_path / "R", kind=KIND, overwrite=True)
    abandon(place)
    assert tree(thesis) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["R", name])


@pytest.mark.parametrize("how", ["link", "folder link", "above", "absolute", "backslash", "drive"])
def test_a_manifest_cannot_reach_outside(tmp_path: Path, how: str) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    out.mkdir()
    elsewhere.mkdir()
    precious = elsewhere / "precious.txt"
    precious.write_text("precious")
    name = {
        "link": "link.txt",
        "folder link": "link/precious.txt",
        "above": "../elsewhere/precious.txt",
        "absolute": str(precious),
        "backslash": "..\\elsewhere\\precious.txt",
        "drive": "C:precious.txt",
    }[how]
    (out / "link.txt").symlink_to(precious)
    (out / "link").symlink_to(elsewhere)
    sealed(out, {name: sha256_of(precious)})
    assert own_files(out) == {"summary.json"}
    try:
        run(out, "new")
    except ResultsError:
        pass
    else:
        assert state_of(out) == "new"
    assert precious.read_text() == "precious"
    assert (out / "link").readlink() == elsewhere
    assert (out / "link.txt").readlink() == precious


def test_a_name_alone_does_not_make_a_file_ours(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.tex").write_text("three years")
    sealed(out, {"thesis.tex": "0" * 64})
    with pytest.raises(ResultsError, match="not replaced"):
        run(out, "new")
    write_summary(out, {"format": KIND, "files": ["thesis.tex"]})  # as an earlier onebend listed files
    with pytest.raises(ResultsError, match="not replaced"):
        run(out, "new")
    assert (out / "thesis.tex").read_text() == "three years"


@pytest.mark.parametrize("what", ["figures", "figures/k.png", "model.json", "summary.json", "only-new.txt"])
def test_a_link_where_results_go_is_not_followed(tmp_path: Path, what: str) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    run(out, "old")
    elsewhere.mkdir()
    for name in ("k.png", "model.json"):
        (elsewhere / name).write_text("precious")
    place = out / what
    if place.is_dir():
        for file in place.iterdir():
            file.unlink()
        place.rmdir()
    else:
        place.unlink(missing_ok=True)
    place.symlink_to(elsewhere if what == "figures" else elsewhere / "k.png")
    before, mine = tree(elsewhere), tree(out)
    with pytest.raises(ResultsError):
        run(out, "new")
    assert tree(elsewhere) == before
    assert tree(out) == mine


def workplace_of(out: Path) -> Path:
    """Where a run for `out` works."""
    place = prepare(out, kind=KIND, overwrite=True)
    abandon(place)
    return place.work


@pytest.mark.parametrize("inside", ["moving", "complete", "notes.txt", "workplace.json", "whole"])
def test_a_planted_workplace_leads_nowhere(tmp_path: Path, inside: str) -> None:
    """One that claims to be ours, with links in it, or is a link itself."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "precious.txt").write_text("precious")
    run(tmp_path / "out", "old")
    planted = workplace_of(tmp_path / "out")
    if inside == "whole":
        (elsewhere / MARKER).write_text(json.dumps({"kind": KIND}))
        planted.symlink_to(elsewhere)
    else:
        planted.mkdir()
        (planted / MARKER).write_text(json.dumps({"kind": KIND}))
        (planted / inside).unlink(missing_ok=True)
        (planted / inside).symlink_to(elsewhere)
    before = tree(elsewhere)
    with pytest.raises(ResultsError, match="is in the way of a run's own folder"):
        run(tmp_path / "out", "new")
    assert state_of(tmp_path / "out") == "old"
    assert tree(elsewhere) == before


def test_the_cache_writes_through_no_link(tmp_path: Path) -> None:
    precious = tmp_path / "precious.txt"
    precious.write_text("precious")
    folder = KeptFolder(tmp_path / "work", most=100)
    folder.path.mkdir()
    link = folder.path / f"{NAME}.kept"
    link.symlink_to(precious)
    assert folder.load(NAME) is None
    assert not folder.save(NAME, b"new")
    assert folder.entries() == []
    assert link.is_symlink()
    assert precious.read_text() == "precious"


def test_a_full_cache_drops_only_what_is_of_the_cache(tmp_path: Path) -> None:
    folder = KeptFolder(tmp_path / "work", most=10)
    assert folder.save(NAME, b"whole")
    theirs = [folder.path / name for name in ("notes.txt", "tags-short.kept", f"{NAME}.kept.bak")]
    for path in theirs:
        path.write_text("theirs, and large")
        os.utime(path, (1e9, 1e9))
    (folder.path / f"{NAME[:-1]}0.kept").mkdir()
    assert folder.save(f"{NAME[:-1]}1", b"as large")
    assert [path.name for path in folder.entries()] == [f"{NAME[:-1]}1.kept"]
    assert all(path.read_text() == "theirs, and large" for path in theirs)


def test_a_single_file_replaces_plain_files_only(tmp_path: Path) -> None:
    precious, link, pipe = tmp_path / "precious.txt", tmp_path / "link.json", tmp_path / "pipe"
    precious.write_text("precious")
    link.symlink_to(precious)
    os.mkfifo(pipe)
    for path in (link, pipe, tmp_path, Path("/dev/null")):
        with pytest.raises(ResultsError):
            write_file(path, "new", overwrite=True)
    with pytest.raises(ResultsError, match="exists already"):
        write_file(precious, "new")
    assert precious.read_text() == "precious"
    assert link.is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.json", "pipe", "precious.txt"]


def test_a_forged_summary_is_known_by_its_own_checksum(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("a")
    write_summary(tmp_path, {"format": KIND})
    seal(tmp_path, {})
    assert own_files(tmp_path) == {"a.txt", "summary.json"}
    data = json.loads((tmp_path / "summary.json").read_text())
    (tmp_path / "mine.txt").write_text("mine")
    data["files"]["mine.txt"] = sha256_of(tmp_path / "mine.txt")
    assert len(data[OWN_CHECKSUM]) == 64
    write_summary(tmp_path, data)
    assert own_files(tmp_path) == set()


@pytest.mark.parametrize(
    "name", ["a[b]*?", "x" * 240, "é\n\x1b[31m", "-o", ".hidden", "a b'\"$", "梁" * 80, "[!a]", "R.onebend-", "\udcff"]
)
def test_a_target_of_any_name(tmp_path: Path, name: str) -> None:
    (tmp_path / "ab").mkdir()
    out = tmp_path / name
    run(out, "old")
    (out / "notes.txt").write_text("mine")
    place = prepare(out, kind=KIND, overwrite=True)
    with pytest.raises(ResultsError, match="is being written by process"):
        prepare(out, kind=KIND, overwrite=True)
    abandon(place)
    run(out, "new")
    assert state_of(out) == "new"
    assert (out / "notes.txt").read_text() == "mine"
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["ab", name])


def test_targets_with_the_same_beginning_do_not_hinder_each_other(tmp_path: Path) -> None:
    one, other = tmp_path / ("x" * 100 + "1"), tmp_path / ("x" * 100 + "2")
    first = prepare(one, kind=KIND, overwrite=True)
    run(other, "new")
    publish(first, partial(write, mark="first"))
    run(other, "newer")
    abandon(first)
    assert (state_of(one), state_of(other)) == ("first", "newer")


@pytest.mark.parametrize("kind", ["pipe", "huge", "nested", "text"])
def test_a_marker_of_others_hangs_nobody(tmp_path: Path, kind: str) -> None:
    planted = workplace_of(tmp_path / "out")
    planted.mkdir()
    if kind == "pipe":
        os.mkfifo(planted / MARKER)
    else:
        (planted / MARKER).write_text({"huge": " " * 10_000_000, "nested": "[" * 9_000, "text": "thesis"}[kind])
    with suppress(ResultsError):
        run(tmp_path / "out", "new")
        assert state_of(tmp_path / "out") == "new"


def test_what_a_marker_says_is_text(tmp_path: Path) -> None:
    place = prepare(tmp_path / "out", kind=KIND, overwrite=True)
    said = {"process": "\x1b[2J", "host": "\x1b[31m", "since": "x" * 900}
    (place.work / MARKER).write_text(json.dumps(said))
    result = CliRunner().invoke(app, ["learn", "REC", "-o", str(tmp_path / "out")])
    finish(place)
    assert result.exit_code == 2
    assert "is being written by process \\x1b[2J on \\x1b[31m" in result.stderr


def test_a_recording_that_is_like_another_is_written_into_its_own_folder_alone(tmp_path: Path) -> None:
    """A description that names a table out of its folder would choose where `record --like` writes what."""
    like, out = tmp_path / "deep" / "like", tmp_path / "out"
    shutil.copytree(EXAMPLE, like)
    (like.parent / "evil.csv").write_text("s,kg_per_m\n0,0.5\n1,0.5\n", encoding="utf-8")
    text = (like / "recording.toml").read_text(encoding="utf-8")
    text = text.replace("[beam]\n", '[beam]\nmass_along = "table"\nmass_file = "../evil.csv"\n', 1)
    (like / "recording.toml").write_text(re.sub("mass_kg = .*", "", text), encoding="utf-8")
    with pytest.raises(RecordingError, match=r"out of its folder: .*evil.csv is not written"):
        copy_description(like, out)
    assert not (tmp_path / "evil.csv").exists()
    copy_description(like, like.parent / "beside")  # the table is there already: it is named, not written
