"""The examples of docs/lab.md on virtual recordings run, and the band that it ends with holds the truth."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest


@pytest.mark.slow
@pytest.mark.usefixtures("no_other_places")
def test_the_pages_example_runs() -> None:
    page = (Path(__file__).parents[3] / "docs" / "lab.md").read_text(encoding="utf-8")
    there: dict[str, Any] = {}
    examples = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    for block in (one for one in examples if "virtual_recording" in one):
        exec(block, there)
    assert "k_true" in there
    band, truth = there["band"], there["truth"]
    assert np.all((band.low < truth) & (truth < band.high))
    assert np.all(band.high < 1.6 * band.low)
