"""What a summary claims, and what it does not."""

from __future__ import annotations

from pathlib import Path

import pytest

from onebend.files.publish import own_files

KIND = "onebend-test-1"


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"format": "onebend-test-1", "files": 3}', "[" * 100_000, "1" * 5000]
)
def test_a_damaged_summary_claims_nothing(tmp_path: Path, text: str) -> None:
    (tmp_path / "summary.json").write_text(text)
    assert own_files(tmp_path, KIND) == set()
