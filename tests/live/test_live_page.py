"""The first example of docs/live.md runs as it is printed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onebend.recording.video import Picture
from onebend.records import Array
from tests.live.streamed import OFFSET, frames, log, toml

PAGE = (Path(__file__).parents[2] / "docs" / "live.md").read_text(encoding="utf-8")


class Sensor:
    """What came since the last picture."""

    def __init__(self) -> None:
        self.until, self.read_until = -np.inf, -np.inf

    def read(self) -> tuple[Array, Array]:
        new = (log().time > self.read_until) & (log().time <= self.until)
        self.read_until = self.until
        return log().time[new], log().force[new]


@pytest.mark.slow
def test_the_pages_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "push").mkdir()
    (tmp_path / "push" / "recording.toml").write_text(toml(), encoding="utf-8")
    sensor = Sensor()

    def camera() -> Iterator[tuple[Picture, float]]:
        for frame in frames():
            sensor.until = frame.time + OFFSET
            yield frame.luma, frame.time

    example, *_ = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.DOTALL | re.MULTILINE)
    there: dict[str, Any] = {"camera": camera(), "sensor": sensor}
    exec(example, there)
    assert there["run"].posterior.grade != "not to be trusted"
    assert there["band"].low < 0.02 < there["band"].high
    assert there["state"].counts.frames == len(frames())
