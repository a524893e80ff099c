"""The page of the recorder: its example runs, its tables name every source and key, and no other."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from onebend.live.force_sensors import TIMES, UNITS
from onebend.live.guidance import CaptureSettings
from onebend.live.recording_folder import CRF
from onebend.live.specs import CAMERAS, FORCES
from onebend.recording.preview import SMALLEST
from onebend.report.overview import overview

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "record.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_pages_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    (tmp_path / "my-push").mkdir()
    shutil.copy(ROOT / "examples" / "linear-beam" / "train" / "recording.toml", tmp_path / "my-push")
    [example] = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.DOTALL | re.MULTILINE)
    exec(example, {})
    assert overview(tmp_path / "my-push").faults == ()


@pytest.mark.parametrize(("title", "kinds"), [("Cameras", CAMERAS), ("Force sensors", FORCES)])
def test_every_source_is_documented_with_its_keys(title: str, kinds: dict[str, object]) -> None:
    section = PAGE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `([^`]+)` \| (.*) \|$", section, flags=re.MULTILINE)
    named = {("v4l2" if spec.startswith("/dev/video") else spec.partition(":")[0]): text for spec, text in rows}
    assert set(named) == set(kinds)
    for kind, entry in kinds.items():
        for key in entry.keys:  # type: ignore[attr-defined]
            assert re.search(rf"`{key}[=`]", PAGE), f"{kind}: {key}"


def test_the_pages_numbers_are_the_codes() -> None:
    assert f"`--crf {CRF}`" in PAGE
    assert f"{SMALLEST:.0f} px or more wide" in PAGE
    assert f"stops {CaptureSettings().least_disk / 1e6:.0f} MB before" in PAGE
    for name in (*UNITS, *TIMES):
        assert re.search(rf"[_`]{name}`", PAGE), name
