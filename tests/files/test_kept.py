"""What is kept from run to run: whole or not there, bounded in size, where the system says."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from onebend.files.kept import KeptFolder, users_folder

NAMES = [f"tags-{number:040x}" for number in range(6)]


def test_what_is_kept_comes_back_and_nothing_else(tmp_path: Path) -> None:
    folder = KeptFolder(tmp_path / "a" / "b")
    assert folder.load(NAMES[0]) is None
    assert folder.entries() == []
    assert folder.save(NAMES[0], b"first")
    assert folder.save(NAMES[1], b"")
    assert (folder.load(NAMES[0]), folder.load(NAMES[1]), folder.load(NAMES[2])) == (b"first", b"", None)
    assert folder.save(NAMES[0], b"second")
    assert folder.load(NAMES[0]) == b"second"
    assert sorted(path.name for path in folder.path.iterdir()) == [f"{name}.kept" for name in NAMES[:2]]


def test_the_longest_unused_are_dropped(tmp_path: Path) -> None:
    folder = KeptFolder(tmp_path, most=3 * 100)
    for i, name in enumerate(NAMES[:3]):
        assert folder.save(name, bytes(100))
        os.utime(tmp_path / f"{name}.kept", (1e9 + i, 1e9 + i))
    assert folder.load(NAMES[0]) is not None  # used just now
    assert folder.save(NAMES[3], bytes(100))
    assert {entry.stem for entry in folder.entries()} == {NAMES[0], NAMES[2], NAMES[3]}
    assert not folder.save(NAMES[4], bytes(folder.most + 1))
    assert len(folder.entries()) == 3


def test_what_was_never_finished_goes_like_an_entry(tmp_path: Path) -> None:
    folder = KeptFolder(tmp_path, most=150)
    begun = tmp_path / f".{NAMES[0]}.0123abcd.kept"
    begun.write_bytes(bytes(100))
    os.utime(begun, (1e9, 1e9))
    assert folder.entries() == [begun]
    assert folder.save(NAMES[1], bytes(100))
    assert [entry.stem for entry in folder.entries()] == [NAMES[1]]
    assert not begun.exists()


def test_names_that_are_written_are_names_that_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file that is written first, beside the entry, is one of those that a later run drops."""
    folder, seen = KeptFolder(tmp_path), []

    def killed(self: Path, *_: object) -> None:
        seen.append(self)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", killed)
        patch.setattr(Path, "unlink", lambda *_, **__: None)
        with pytest.raises(KeyboardInterrupt):
            folder.save(NAMES[0], b"whole")
    assert folder.entries() == seen


@pytest.mark.skipif(sys.platform == "win32" or os.geteuid() == 0, reason="rights do not bind this user")
def test_a_folder_that_cannot_be_written_keeps_nothing(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    assert not KeptFolder(tmp_path / "kept").save(NAMES[0], b"whole")
    tmp_path.chmod(0o700)


def test_a_file_in_its_place_keeps_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("theirs")
    folder = KeptFolder(tmp_path / "file")
    assert not folder.save(NAMES[0], b"whole")
    assert folder.load(NAMES[0]) is None
    assert folder.entries() == []
    assert (tmp_path / "file").read_text() == "theirs"


@pytest.mark.skipif(sys.platform == "win32", reason="rights of folders are others there")
def test_the_folder_is_the_users_alone(tmp_path: Path) -> None:
    folder = KeptFolder(tmp_path / "kept")
    folder.save(NAMES[0], b"whole")
    assert folder.path.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(
    ("system", "environment", "expected"),
    [
        ("linux", {"XDG_CACHE_HOME": "/x/cache"}, Path("/x/cache/onebend")),
        ("linux", {"XDG_CACHE_HOME": "not/absolute"}, Path("/home/of/.cache/onebend")),
        ("linux", {}, Path("/home/of/.cache/onebend")),
        ("darwin", {"XDG_CACHE_HOME": "/x/cache"}, Path("/home/of/Library/Caches/onebend")),
        ("win32", {"LOCALAPPDATA": "/x/local"}, Path("/x/local/onebend")),
        ("win32", {}, Path("/home/of/AppData/Local/onebend")),
        ("linux", {"ONEBEND_CACHE": "/else where", "XDG_CACHE_HOME": "/x"}, Path("/else where")),
        ("linux", {"ONEBEND_CACHE": "~/kept"}, Path("/home/of/kept")),
        ("linux", {"ONEBEND_CACHE": " "}, Path("/home/of/.cache/onebend")),
        ("linux", {"ONEBEND_CACHE": "off"}, None),
        ("linux", {"ONEBEND_CACHE": "OFF"}, None),
        ("linux", {"ONEBEND_CACHE": "0"}, None),
    ],
)
def test_where_things_are_kept(
    monkeypatch: pytest.MonkeyPatch, system: str, environment: dict[str, str], expected: Path | None
) -> None:
    monkeypatch.setenv("HOME", "/home/of")
    folder = users_folder(environment, system)
    assert (None if folder is None else folder.path) == expected
