"""The documentation agrees with the code: links lead somewhere, options and columns are the real ones."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.pages import INHERITED, TABLES, pages, renewed
from onebend.cli import all_commands, app
from onebend.live.hyperparameters import OnlineSettings
from onebend.recording.schema import keys_of
from onebend.records import StatedSection
from onebend.results.observations_file import save_observations
from onebend.results.tables import write_markers, write_nuisances, write_selection, write_stiffness, write_validation
from tests import made_up

COMMANDS = all_commands()

OPTION = re.compile(r"--[a-z][a-z-]*")
ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def anchors(page: Path) -> list[str]:
    """Of the sections of a page, as Markdown viewers make them of their titles."""
    titles = re.findall(r"(?m)^#+ (.+)$", page.read_text(encoding="utf-8"))
    return [re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_and_sections_that_there_are(page: Path) -> None:
    for target, anchor in re.findall(r"\]\(([^)#]*)#?([^)]*)\)", page.read_text(encoding="utf-8")):
        there = page.parent / target if target else page
        assert there.exists(), f"{page.name}: {target}"
        assert not anchor or anchor in anchors(there), f"{page.name}: {target}#{anchor}"


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_generated_parts_are_those_of_the_code(page: Path) -> None:
    """`make docs` (python -m benchmarks.pages) writes them anew."""
    text, parts = page.read_text(encoding="utf-8"), pages()[page]
    assert set(re.findall(r"<!-- generated: (.+) -->", text)) == set(parts)
    assert renewed(text, parts) == text


def test_a_stale_part_is_written_anew_and_a_part_without_a_place_is_named() -> None:
    text = "A\n<!-- generated: x -->\nold\n<!-- end -->\nB\n"
    assert renewed(text, {"x": "new"}) == "A\n<!-- generated: x -->\n\nnew\n\n<!-- end -->\nB\n"
    with pytest.raises(ValueError, match="no <!-- generated: y -->"):
        renewed(text, {"y": "new"})


def test_every_option_is_in_its_command_s_part_and_every_key_in_its_table_s() -> None:
    """Asked of Typer's own help and of the schema, beside the generator."""
    (cli, commands_said), (_, tables) = pages().items()
    assert cli.name == "cli.md"
    for command in COMMANDS:
        asked = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "200"}).stdout
        there = set(OPTION.findall(asked.rpartition("Example:")[0])) - {"--help"}
        own = set(OPTION.findall(commands_said[command]))
        assert own <= there <= own | set(OPTION.findall(commands_said["common options"])), command
    for name, record in TABLES.items():
        shared = {key.name for key, _ in keys_of(TABLES[INHERITED[name]]).values()} if name in INHERITED else set()
        for key in {key.name for key, _ in keys_of(record).values()} - shared:
            assert f"- `{key}` (" in tables[name]


def test_defaults_stand_in_the_unit_of_the_key() -> None:
    tables = pages()[ROOT / "docs" / "recording.md"]
    assert "`at_sd_m` (`0.0025`):" in tables["push"]
    assert "`rest_curvature_sd_deg` (`8.59`):" in tables["beam"]
    assert "`length_m` (required, such as `0.15`):" in tables["beam"]


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


def test_every_setting_of_the_live_learner_is_documented_and_no_other() -> None:
    _, _, table = (ROOT / "docs" / "live.md").read_text(encoding="utf-8").partition("\n### Settings\n")
    assert re.findall(r"(?m)^\| `(\w+)`", table) == [one.name for one in fields(OnlineSettings)]
