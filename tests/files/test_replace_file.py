"""A file that a person edits: replaced in one step, and only where it is as it was known."""

from __future__ import annotations

from pathlib import Path

import pytest

from onebend.errors import ResultsError
from onebend.files.single_file import exchange, replace_file


def test_it_is_replaced_where_it_is_as_known_and_keeps_its_permissions(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(b"old")
    path.chmod(0o640)
    assert replace_file(path, b"new", b"old") is None
    assert path.read_bytes() == b"new"
    assert path.stat().st_mode & 0o777 == 0o640
    assert replace_file(path, b"newer", b"old") == b"new"
    assert path.read_bytes() == b"new"
    assert [one.name for one in tmp_path.iterdir()] == ["a.toml"]


def test_what_was_written_in_that_very_moment_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(b"old")
    seen: list[Path] = []

    def late(one: Path, other: Path) -> bool:
        if not seen:  # an editor saves after the file was compared, and before it is replaced
            other.write_bytes(b"theirs")
        seen.append(other)
        return exchange(one, other)

    monkeypatch.setattr("onebend.files.single_file.exchange", late)
    if not exchange(path, path):
        pytest.skip("this file system cannot swap two names")
    assert replace_file(path, b"new", b"old") == b"theirs"
    assert path.read_bytes() == b"theirs"
    assert [one.name for one in tmp_path.iterdir()] == ["a.toml"]


def test_a_link_a_folder_or_nothing_is_refused(tmp_path: Path) -> None:
    (tmp_path / "there").write_bytes(b"old")
    (tmp_path / "link").symlink_to(tmp_path / "there")
    for name in ("link", "", "nowhere"):
        with pytest.raises(ResultsError):
            replace_file(tmp_path / name, b"new", b"old")
    assert (tmp_path / "there").read_bytes() == b"old"
