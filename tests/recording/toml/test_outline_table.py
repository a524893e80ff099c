"""[outline]: a film of a body without tags, or beside them."""

from __future__ import annotations

from pathlib import Path

import pytest

from onebend.errors import RecordingError
from onebend.recording.folder import read_recording

BARE = """
format = 1
[beam]
length_m = 0.15
[tags]
size_m = 0.012
[[tags.on_base]]
id = 0
s = 0
[video]
file = "video.mp4"
"""
TAGGED = BARE.replace("[video]", "[[tags.on_beam]]\nid = 1\ns = 1.0\n[video]")


def written(folder: Path, text: str) -> Path:
    (folder / "recording.toml").write_text(text)
    (folder / "video.mp4").write_bytes(b"a film")
    return folder


@pytest.mark.parametrize(
    ("text", "traces"),
    [
        (BARE, True),
        (BARE + "[outline]\n", True),
        (TAGGED, True),
        (TAGGED + "[outline]\n", True),
        (TAGGED + "[outline]\nuse = false\n", False),
    ],
)
def test_the_outline_of_a_film_is_read_unless_it_is_refused(tmp_path: Path, text: str, traces: bool) -> None:
    assert read_recording(written(tmp_path, text)).traces_outline is traces


def test_a_body_without_tags_needs_its_outline(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"needs at least one \[\[tags.on_beam\]\]"):
        read_recording(written(tmp_path, BARE + "[outline]\nuse = false\n"))


@pytest.mark.parametrize("line", ["width_m = -1.0", 'width_m = "wide"', "use = 1", "colour = 3"])
def test_mistakes_in_the_table_are_named(tmp_path: Path, line: str) -> None:
    with pytest.raises(RecordingError, match=line.split(" = ")[0]):
        read_recording(written(tmp_path, BARE + f"[outline]\n{line}\n"))
