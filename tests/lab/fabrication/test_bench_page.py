"""docs/lab.md and the example of making a beam say what the code does."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from examples import make_a_beam
from onebend.lab.designs import DESIGNS, MaterialEntry, SizeEntry, WidthEntry
from onebend.recording.schema import keys_of
from tests.lab.printed import page_image, tags_in

PAGE = (Path(__file__).parents[3] / "docs" / "lab.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_pages_first_example_runs() -> None:
    there: dict[str, Any] = {}
    exec(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[0], there)
    assert there["force"] == pytest.approx(0.227, abs=5e-4)  # N, what `onebend design quadratic` prints
    assert there["beam"].length == 0.15


@pytest.mark.parametrize(("table", "record"), [("beam", SizeEntry), ("width", WidthEntry), ("material", MaterialEntry)])
def test_every_key_of_a_design_is_documented(table: str, record: type) -> None:
    rows = [row for row in PAGE.splitlines() if row.startswith(f"| `[{table}] ")]
    for key, _ in keys_of(record).values():
        assert any(re.search(rf"[`\s]{key.name}`", row) for row in rows), key.name


def test_named_designs_are_documented() -> None:
    assert all(f"| `{name}` |" in PAGE for name in DESIGNS)


def test_the_example_makes_a_beam(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    expected = make_a_beam.main(tmp_path / "made")
    assert sorted(tags_in(page_image((tmp_path / "made" / "tags.pdf").read_bytes()))) == [0, 1, 2, 3]
    said = capsys.readouterr().out
    assert f"{expected.bends[0].force:.3f} N" in said
