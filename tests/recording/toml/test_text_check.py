"""The text of a recording.toml, checked before it is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from onebend.errors import RecordingError
from onebend.recording.folder import TextCheck, check_text, read_recording
from onebend.recording.template import template

TRAIN = Path(__file__).parents[3] / "examples" / "linear-beam" / "train"
TEXT = (TRAIN / "recording.toml").read_text(encoding="utf-8")


def checked(old: str, new: str) -> TextCheck:
    assert old in TEXT
    return check_text(TRAIN, TEXT.replace(old, new, 1))


def line_of(words: str) -> int:
    return next(i for i, row in enumerate(TEXT.splitlines(), start=1) if row.startswith(words))


def test_a_good_text_has_the_remarks_of_its_file() -> None:
    found = check_text(TRAIN, TEXT)
    assert found.mistakes == ()
    assert found.remarks == read_recording(TRAIN).remarks
    assert found.data["video"]["file"] == "video.mp4"


@pytest.mark.parametrize(
    ("old", "new", "at", "words"),
    [
        ("length_m = ", "length_m = -", "length_m", "[beam] length_m must be a number above 0"),
        ("length_m", "lenght_m", "length_m", "Did you mean length_m?"),
        ('file = "video.mp4"', 'file = "vido.mp4"', "file", "Did you mean video.mp4?"),
        ("length_m = ", "length_m = x", "length_m", "not valid TOML"),
        ("[push]", "[poke]", "[push]", "does not know the key poke"),
    ],
)
def test_a_mistake_is_told_with_its_key_and_line(old: str, new: str, at: str, words: str) -> None:
    found = checked(old, new)
    assert any(line == line_of(at) and words in said for line, said in found.mistakes), found.mistakes
    assert found.remarks == ()


def test_it_says_what_reading_the_written_file_says(tmp_path: Path) -> None:
    """Every mistake, and no other."""
    text = template().replace("length_m =", "length_m = 0.15 #").replace("size_m =", "size_m = -1 #")
    text = "\n".join(row for row in text.splitlines() if not row.startswith(("id =", "s =", "at_s =", "acts_on =")))
    text = text.replace("rotation_deg =", "rotation_deg = 0 #")
    (tmp_path / "recording.toml").write_text(text)
    with pytest.raises(RecordingError) as wrong:
        read_recording(tmp_path)
    said = [f"{tmp_path / 'recording.toml'}:{line}: {words}" for line, words in check_text(tmp_path, text).mistakes]
    assert str(wrong.value).splitlines() == said


def test_empty_keys_are_told_once_and_keep_no_other_from_being_checked() -> None:
    found = check_text(TRAIN, template().replace("size_m =", 'size_m = "wide" #'))
    words = [said for _, said in found.mistakes]
    assert sum("length_m is empty" in one for one in words) == 1
    assert any("size_m must be a number" in one for one in words)
    assert not any("lacks length_m" in one or "needs either at_s" in one for one in words)


@pytest.mark.parametrize(
    "text", ["", "\0", "[" * 5000, "a." * 500 + "b = 1", "x = " + "9" * 9000, "beam = 3\ntags = []"]
)
def test_whatever_is_typed_ends_in_mistakes(text: str, tmp_path: Path) -> None:
    found = check_text(tmp_path, text)
    assert found.mistakes
    assert all(line >= 1 and words for line, words in found.mistakes)
    assert list(tmp_path.iterdir()) == []
