"""Who reads a report sees when it was written, from which files, and with which settings."""

from __future__ import annotations

import json
import webbrowser
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from onebend import cli
from onebend.cli import learning as learning_commands
from onebend.files.publish import sha256_of
from onebend.learning.optimizer import FitSettings
from onebend.learning.run import Run
from onebend.report.page import page, shown_made_from, size_words
from onebend.report.pictures import Pictures
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
    html = page(made_up.findings(0), {}, version="1", made_from=shown_made_from(made_from))
    text = Links(html).text
    for file in files:
        assert sha256_of(file) in text
    assert "1.5 kB" in text
    assert "fit: most_frames123" in text
    assert "options: m3" in text
    assert "options: n" not in text  # not given
    assert f"Written on {made_from['provenance']['written'][:10]}" in text
    assert "<b>film" not in html
    assert "<b>film\\u202e.mp4" in text
    assert "numpy " in text


def test_without_provenance_there_is_no_such_section() -> None:
    assert shown_made_from({}) is None
    assert "Provenance" not in Links(page(made_up.findings(0), {}, version="1")).text


def test_many_files_are_counted_in_the_lead(tmp_path: Path) -> None:
    files = [tmp_path / f"photo-{i}.jpg" for i in range(9)]
    for file in files:
        file.write_bytes(b"x")
    found = shown_made_from(provenance(inputs_of([*files, tmp_path / "missing"]), {}))
    assert found is not None
    assert found.names == "photo-0.jpg, photo-1.jpg, photo-2.jpg, photo-3.jpg and 5 more files"
    assert len(found.files) == 9


@pytest.mark.parametrize("there", ["yes", "no", "broken"])
def test_open_shows_the_report_in_the_browser(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: str) -> None:
    asked: list[str] = []

    def browser(address: str) -> bool:
        asked.append(address)
        if there == "broken":
            raise webbrowser.Error("could not locate runnable browser")
        return there == "yes"

    monkeypatch.setattr(learning_commands, "learn_from", lambda *_, **__: made_up.findings(0))
    monkeypatch.setattr(learning_commands, "draw_all", lambda *_, **__: Pictures())
    monkeypatch.setattr(webbrowser, "open", browser)
    out = tmp_path / "a folder"
    result = CliRunner().invoke(cli.app, ["learn", str(EXAMPLE), "-o", str(out), "-q", "--open"])
    assert result.exit_code == 0, result.output
    assert asked == [(out / "report.html").as_uri()]
    assert ("no browser was found" in result.stderr) == (there != "yes")


@pytest.mark.parametrize(
    ("count", "words"), [(0, "0 bytes"), (1234, "1.23 kB"), (25_000_000, "25 MB"), (3 * 10**9, "3 GB")]
)
def test_sizes_are_words(count: int, words: str) -> None:
    assert size_words(count) == words


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
    assert "options: clamp_sd_deg0.7" in text
    assert "fit: optimizer: rounds" in text
