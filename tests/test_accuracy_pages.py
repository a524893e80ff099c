"""The measured accuracy: one note per benchmark, renewed without losing its remarks, under one page of headlines."""

from __future__ import annotations

import re
from pathlib import Path

from benchmarks.__main__ import NOTES, benchmarks, write_page

HEADLINES = Path(__file__).parents[1] / "docs" / "accuracy.md"
MOST_WORDS = 1800


def test_headlines_are_short_and_lead_to_every_note() -> None:
    text = HEADLINES.read_text(encoding="utf-8")
    assert len(re.findall(r"\S*\w\S*", text)) <= MOST_WORDS
    linked = set(re.findall(r"\]\(\.\./benchmarks/notes/(\w+)\.md\)", text))
    assert linked == {note.stem for note in NOTES.glob("*.md")}
    assert linked <= set(benchmarks())


def test_new_tables_replace_the_old_and_remarks_stay(tmp_path: Path) -> None:
    page = tmp_path / "one.md"
    write_page(page, "# One\n\nold\n")
    assert page.read_text(encoding="utf-8") == "# One\n\nold\n"
    page.write_text("# One\n\nold\n\n## Remarks\n\nBy hand.\n", encoding="utf-8")
    write_page(page, "# One\n\nnew\n")
    assert page.read_text(encoding="utf-8") == "# One\n\nnew\n\n## Remarks\n\nBy hand.\n"
