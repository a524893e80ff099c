"""The example of docs/lab.md runs, and the band that it ends with holds the truth."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np


def test_the_pages_example_runs() -> None:
    page = (Path(__file__).parents[3] / "docs" / "lab.md").read_text(encoding="utf-8")
    there: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(block, there)
    band, truth = there["band"], there["truth"]
    assert np.all((band.low < truth) & (truth < band.high))
    assert np.all(band.high < 1.6 * band.low)
