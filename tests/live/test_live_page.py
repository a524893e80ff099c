"""The first example of docs/live.md runs as it is printed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "live.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_pages_example_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    example, *_ = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.DOTALL | re.MULTILINE)
    there: dict[str, Any] = {}
    exec(example, there)
    assert there["run"].posterior.grade != "not to be trusted"
    assert there["state"].counts.frames > 500
    learned, live = there["band"], there["state"].stiffness.band(0.5)
    assert live.low < learned.k < live.high
    assert learned.identified
