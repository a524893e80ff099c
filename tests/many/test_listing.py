"""Folders and lists of recordings, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import pytest

from onebend.errors import RecordingError
from onebend.many.tasks import items_of


def listed(tmp_path: Path, text: str) -> Path:
    (tmp_path / "list.csv").write_text(text)
    return tmp_path / "list.csv"


def test_recordings_at_any_depth_but_not_in_the_results(tmp_path: Path) -> None:
    for place in ("a", "dry/b", "dry/deep/c", "out/recordings/d"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "recording.toml").touch()
    items = items_of(tmp_path, tmp_path / "out")
    assert [(one.name, one.group) for one in items] == [("a", ""), ("dry/b", "dry"), ("dry/deep/c", "dry")]


def test_columns_state_keys_or_are_labels(tmp_path: Path) -> None:
    [one] = items_of(
        listed(tmp_path, "path,group,length_m,markers.sd_m,rest,variety\nstem/recording.toml,g,0.2,1e-4,curved,rye\n"),
        tmp_path / "out",
    )
    assert one.folder == tmp_path / "stem"
    assert one.stated == (("beam", "length_m", 0.2), ("markers", "sd_m", 1e-4), ("beam", "rest", "curved"))
    assert dict(one.labels)["variety"] == "rye"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name\na\n", "no column path"),
        ("path\n", "no rows"),
        ("path,path\na,b\n", "'path' is there twice"),
        ("path,name\n,b\n", "line 2: the path is empty"),
        ("path\na\na\n", "two recordings are called 'a'"),
        ("path,sd_m\na,1\n", r"a key of \[markers\] and \[poses\]"),
        ("path\na,b\n", "line 2: 2 cells under 1 columns"),
    ],
)
def test_mistakes_in_a_list_are_named(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(RecordingError, match=said):
        items_of(listed(tmp_path, text), tmp_path / "out")


def test_nothing_to_learn_from(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="holds no recording"):
        items_of(tmp_path, tmp_path / "out")
    with pytest.raises(RecordingError, match="neither a folder nor a file"):
        items_of(tmp_path / "absent", tmp_path / "out")
