"""Numbers as options that no one means: a limit that says itself, before memory goes."""

from __future__ import annotations

from pathlib import Path

import pytest

from onebend.results.model import save_model
from tests.attack.family import Case, params, withstood
from tests.attack.victim import Victim
from tests.made_up import BEAM

HUGE = 10**400
REQUESTS: dict[str, list[object]] = {
    "hinges by the billion": ["export", "model.json", "--to", "urdf", "-o", "x.urdf", "--hinges", 10**9],
    "hinges of 400 digits": ["export", "model.json", "--to", "urdf", "-o", "x.urdf", "--hinges", HUGE],
    "a film of 30 years": ["film", "linear", "-o", "f", "-q", "--seconds", 1e9],
    "an endless film": ["film", "linear", "-o", "f", "-q", "--seconds", "inf"],
    "a film of no number": ["film", "linear", "-o", "f", "-q", "--seconds", "nan"],
    "a rate of 1e9": ["film", "linear", "-o", "f", "-q", "--fps", 1e9],
    "a rehearsal of 30 years": ["rehearse", "linear", "-o", "r", "-q", "--seconds", 1e9],
    "rehearsals by the billion": ["rehearse", "linear", "-o", "r", "-q", "--runs", 10**9],
    "processes by the billion": ["rehearse", "linear", "-o", "r", "-q", "--jobs", 10**9],
    "a push at the clamp": ["rehearse", "linear", "-o", "r", "-q", "--push-at", 1e-308],
    "tags by the billion": ["tags", "-o", "t.pdf", "--ids", "0-999999999"],
    "tags of a million kilometres": ["tags", "-o", "t.pdf", "--ids", "0-2", "--size-mm", 1e12],
    "a goal beyond all numbers": ["reach", "model.json", "--goal", 1e308, 1e308],
    "a goal that is no number": ["reach", "model.json", "--goal", "nan", 0.1],
    "a loop for that goal": ["loop", "model.json", "--goal", 1e308, 1e308],
}
QUICK = {"hinges by the billion", "a film of 30 years", "a goal beyond all numbers"}


@pytest.mark.parametrize("case", params([Case(name, lambda _: None) for name in REQUESTS], QUICK))
def test_a_request(victim: Victim, tmp_path: Path, case: Case) -> None:
    save_model(tmp_path / "model.json", BEAM, written_by="a test")
    withstood(victim.attack(REQUESTS[case.name], tmp_path), case)
