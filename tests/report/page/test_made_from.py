"""Who reads a report sees when it was written, from which files, and with which settings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from onebend import cli
from onebend.cli import learning as learning_commands
from onebend.files.publish import sha256_of
from onebend.learning.optimizer import FitSettings
from onebend.learning.run import Run
from onebend.report.page import page
from onebend.results.provenance import inputs_of, provenance
from tests import made_up
from tests.report.page.test_page import Links

pytestmark = pytest.mark.usefixtures("no_other_places")

EXAMPLE = Path(__file__).parents[3] / "examples" / "hung-weights"


def test_files_checksums_command_and_settings_are_shown(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("recording.toml", "<b>film\u202e.mp4")]
    for i, file in enumerate(files):
        file.write_bytes(b"x" * 1500 * (i + 1))
    made_from = provenance(inputs_of(files), {"n": None, "m": 3}, {"fit": FitSettings(most_frames=123)})
    html = page(made_up.findings(0), {}, made_from=made_from["provenance"])
    text = Links(html).text
    for file in files:
        assert sha256_of(file) in text
    assert "1500" in text
    assert '"most_frames": 123' in text
    assert '"m": 3' in text
    assert f"Written on {made_from['provenance']['written'][:10]}" in text
    assert "<b>film" not in html
    assert "<b>film\\u202e.mp4" in text
    assert '"numpy": ' in text


def test_without_provenance_there_is_no_such_section() -> None:
    assert "Provenance" not in Links(page(made_up.findings(0), {})).text


@pytest.mark.slow
def test_the_report_and_the_summary_say_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def found(*_: Any, **__: Any) -> Run:
        return made_up.findings(0)

    monkeypatch.setattr(learning_commands, "learn_from", found)
    out = tmp_path / "out"
    result = CliRunner().invoke(cli.app, ["learn", str(EXAMPLE), "-o", str(out), "--clamp-sd-deg", "0.7", "-q"])
    assert result.exit_code == 0, result.output
    source = json.loads((out / "summary.json").read_text(encoding="utf-8"))["provenance"]
    text = Links((out / "report.html").read_text(encoding="utf-8")).text
    assert source["written"][:16].replace("T", " ") in text
    assert len(source["inputs"]) == 3
    for one in source["inputs"]:
        assert one["sha256"] in text
        assert one["file"] in text
    assert '"clamp_sd_deg": 0.7' in text
    assert '"rounds"' in text
