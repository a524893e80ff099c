"""What README and docs show of the commands is not older than the code that words it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import shown
from benchmarks.shown import ROOT, SHOWN, checksum, older, put_in, sources


def test_what_is_shown_is_worded_as_the_code_words_it_now() -> None:
    assert older("words") == [], "make it again: `python -m benchmarks.shown NAME` (docs/contributing.md)"


def test_numbers_of_older_code_are_listed() -> None:
    if names := older("numbers"):
        pytest.skip(
            f"what is shown comes from older code: {', '.join(names)}; `python -m benchmarks.shown NAME` renews them"
        )


@pytest.mark.parametrize("name", SHOWN)
def test_every_screen_has_its_place_and_its_sources(name: str) -> None:
    one = SHOWN[name]
    assert all(path.is_file() for path in sources((*one.words, *one.numbers)))
    assert sources(one.words)
    if one.page:
        page = (ROOT / one.page).read_text(encoding="utf-8")
        assert page.count(f"<!-- shown: {name} -->") == page.count(f"<!-- end of {name} -->") == 1
        assert "    a screen\n" in put_in(page, name, "a screen\n")
    assert all((ROOT / kept).is_file() for _, kept in one.pictures)


def test_a_comment_changes_no_checksum_and_a_word_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shown, "ROOT", tmp_path)
    file = tmp_path / "one.py"
    file.write_text('# what for\nsaid = "k(s)"\n', encoding="utf-8")
    first = checksum([file])
    file.write_text('# why\n\nsaid = "k(s)"\n', encoding="utf-8")
    assert checksum([file]) == first
    file.write_text('# why\n\nsaid = "EI"\n', encoding="utf-8")
    assert checksum([file]) != first


def test_a_renewed_screen_stands_in_its_page_with_its_stamp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "src/onebend/terminal").mkdir(parents=True)
    (tmp_path / "src/onebend/terminal/one.py").write_text("a = 1\n", encoding="utf-8")
    (tmp_path / "page.md").write_text("A\n<!-- shown: x -->\nold\n<!-- end of x -->\nB\n", encoding="utf-8")
    one = shown.Shown("page.md", ("show",), ("terminal/one.py",), ("terminal",))
    monkeypatch.setattr(shown, "ROOT", tmp_path)
    monkeypatch.setattr(shown, "STAMPS", tmp_path / "shown.json")
    monkeypatch.setattr(shown, "SHOWN", {"x": one})
    shown.renew("x", run=lambda _: "k(s)\n\n  0.1\n")
    wanted = "A\n<!-- shown: x -->\n\n    k(s)\n\n      0.1\n\n<!-- end of x -->\nB\n"
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == wanted
    assert shown.older("words") == shown.older("numbers") == []
    (tmp_path / "src/onebend/terminal/two.py").write_text("b = 1\n", encoding="utf-8")
    assert (shown.older("words"), shown.older("numbers")) == ([], ["x"])
    assert set(json.loads((tmp_path / "shown.json").read_text(encoding="utf-8"))) == {"x"}
    with pytest.raises(ValueError, match="has no <!-- shown: y -->"):
        put_in("A", "y", "k")
