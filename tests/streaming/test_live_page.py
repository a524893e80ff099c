"""The example of docs/live.md runs as it is printed, and its tables say what there is."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onebend.recording.video import Picture
from onebend.records import Array
from tests.recording.filmed import HEIGHT, LENGTH, SIZE, WIDTH, view
from tests.streaming.streamed import OFFSET, frames, log

PAGE = (Path(__file__).parents[2] / "docs" / "live.md").read_text(encoding="utf-8")


def toml() -> str:
    """A recording.toml of the made-up push."""
    seen = view()
    numbers = {"fx": seen.matrix[0, 0], "fy": seen.matrix[1, 1], "cx": seen.matrix[0, 2], "cy": seen.matrix[1, 2]}
    camera = "\n".join(f"{name} = {float(value)}" for name, value in numbers.items())
    beam = ", ".join(f"{{ id = {i}, s = {i / 3:.6f} }}" for i in (1, 2, 3))
    return f"""format = 1
[beam]
length_m = {LENGTH}
[tags]
size_m = {SIZE}
on_base = [{{ id = 0, s = 0.0 }}]
on_beam = [{beam}]
[camera]
width = {WIDTH}
height = {HEIGHT}
{camera}
dist = {seen.dist.tolist()}
[video]
file = "video.mp4"
start_s = {OFFSET}
start_uncertainty_s = 0.3
[force]
file = "force.csv"
[push]
at_s = 1.0
"""


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

    [example] = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.DOTALL | re.MULTILINE)
    there: dict[str, Any] = {"camera": camera(), "sensor": sensor}
    exec(example, there)
    assert there["run"].posterior.grade != "not to be trusted"
    assert there["band"].low < 0.02 < there["band"].high
    assert there["state"].counts.frames == len(frames())
