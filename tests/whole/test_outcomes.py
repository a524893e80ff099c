"""No change makes what users end up with worse unnoticed: `benchmarks.outcomes`."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from benchmarks import outcomes


@pytest.mark.parametrize("benches", [[("all", 1)], pytest.param(outcomes.BENCHES, marks=pytest.mark.slow)])
def test_virtual_benches_are_learned_and_bent_as_well_as_before(benches: tuple[tuple[str, int], ...]) -> None:
    rows = [asdict(outcomes.row(*bench)) for bench in benches]
    assert outcomes.worse(outcomes.means(rows), outcomes.stored(benches)) == []


def test_what_is_worse_is_named() -> None:
    before = outcomes.stored()
    for name, margin in outcomes.MARGINS.items():
        change = 1.5 * margin
        down = name == "identified" or before[name] < outcomes.LEVELS.get(name, -1.0)
        now = before | {name: before[name] + (-change if down else change)}
        assert [one.split(":")[0] for one in outcomes.worse(now, before)] == [name]
    assert outcomes.worse(before, before) == []
