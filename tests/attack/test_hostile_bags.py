"""Robot logs of any content: never run, one message each."""

from __future__ import annotations

from pathlib import Path

import pytest

from onebend.recording.bags import files_of
from tests.attack.family import Case, params, withstood
from tests.attack.hostile_bags import BAG, CASES
from tests.attack.victim import Victim

QUICK = {
    "a type that holds itself", "an array of texts", "a list of nothing", "a type's name that is code",
    "a constant that is code", "a view without end", "columns that are computed",
}  # fmt: skip


@pytest.mark.parametrize("case", params(CASES, QUICK))
def test_a_bag(victim: Victim, tracks: Path, case: Case) -> None:
    case.harm(tracks)
    bag = next(name for name in BAG.values() if (tracks / name).exists())
    file = tracks / "recording.toml"
    named = file.read_text(encoding="utf-8").replace('file = "force.csv"', f'file = "{bag}"\ntopic = "/wrench"')
    file.write_text(named.replace("[force]\n", '[force]\nfield = "x"\n') if "IDL" in case.name else named)
    withstood(victim.attack(["check", "rec"], tracks.parent, most_MB=3000), case)
    listed = victim.attack(["topics", f"rec/{bag}"], tracks.parent, most_MB=3000)
    assert listed.verdict in ("done", "refused"), listed.err
    assert listed.work_s < 40.0
    assert not list(tracks.parent.rglob("pwned"))


def test_names_of_files_with_raised_digits(tmp_path: Path) -> None:
    """A ² is a digit that is no number."""
    for name in ("run_².mcap", "run_10.mcap", "run_٢.mcap", "run_3.mcap"):
        (tmp_path / name).touch()
    assert [file.name for file in files_of(tmp_path)] == ["run_٢.mcap", "run_3.mcap", "run_10.mcap", "run_².mcap"]
