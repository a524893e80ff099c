"""The documentation agrees with the code: links lead somewhere, options and columns are the real ones."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from onebend.cli import COMMANDS, app
from onebend.learning.live.settings import OnlineSettings
from onebend.recording.toml.beam_entry import BeamEntry
from onebend.recording.toml.entries import ForceEntry, GravityEntry, PushEntry, TagEntry, TagsEntry
from onebend.recording.toml.schema import keys_of
from onebend.recording.toml.source_entries import (
    CameraEntry,
    CameraInfoEntry,
    MarkersEntry,
    PhotosEntry,
    PosesEntry,
    VideoEntry,
)
from onebend.records import StatedSection
from onebend.results.observations_file import save_observations
from onebend.results.tables import write_markers, write_nuisances, write_selection, write_stiffness, write_validation
from tests import made_up

OPTION = re.compile(r"--[a-z][a-z-]*")
ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_option_is_documented_and_no_other() -> None:
    text = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    there = set(OPTION.findall(CliRunner().invoke(app, ["--help"], env={"COLUMNS": "200"}).stdout)) - {"--version"}
    for command in COMMANDS:
        assert f"`onebend {command}" in text
        there |= set(OPTION.findall(CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "200"}).stdout))
    assert {option for quoted in re.findall(r"`([^`]*)`", text) for option in OPTION.findall(quoted)} == there


def test_columns_are_the_documented_ones(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    one, learned = made_up.comparison(), made_up.learned()
    bar = StatedSection("rectangle", np.array([0.0, 1.0]), np.full(2, 0.012), np.full(2, 0.03))
    write_stiffness(tmp_path / "a.csv", made_up.BEAM, None, bar)
    write_nuisances(tmp_path / "e.csv", made_up.posterior().nuisances())
    write_selection(tmp_path / "b.csv", learned)
    write_markers(tmp_path / "c.csv", [one])
    write_validation(tmp_path / "d.csv", [one])
    for file in tmp_path.glob("*.csv"):
        header = file.read_text(encoding="utf-8").splitlines()[0]
        for column in header.split(","):
            assert f"`{re.sub(r'^rms_[0-9]+_m$', 'rms_TAG_m', column)}`" in text, column
    save_observations(tmp_path / "o.parquet", made_up.observations())
    assert all(name in text for name in ("`time_s`", "`loaded`", "`tag_ID_covariance`"))


@pytest.mark.parametrize(
    "record",
    [
        BeamEntry,
        TagsEntry,
        TagEntry,
        CameraEntry,
        CameraInfoEntry,
        VideoEntry,
        ForceEntry,
        PushEntry,
        GravityEntry,
        MarkersEntry,
        PosesEntry,
        PhotosEntry,
    ],
)
def test_every_key_of_a_recording_is_documented_as_the_schema_says(record: type) -> None:
    text = (ROOT / "docs" / "recording.md").read_text(encoding="utf-8")
    for key, _ in keys_of(record).values():
        assert f"| `{key.name}` | {key.says} |" in text, key.name


def test_every_setting_of_the_live_learner_is_documented_and_no_other() -> None:
    _, _, table = (ROOT / "docs" / "streaming.md").read_text(encoding="utf-8").partition("\n## Settings\n")
    assert re.findall(r"(?m)^\| `(\w+)`", table) == [one.name for one in fields(OnlineSettings)]
