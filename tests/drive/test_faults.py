"""Faults on a bench: it holds in time, keeps the force, says why, and leaves a whole recording."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from onebend.drive.plan import Hand
from onebend.drive.robots import Skill
from onebend.errors import ObservationError
from onebend.recording.folder import read_recording
from onebend.recording.observe import observe
from onebend.recording.video import read_frames
from tests.drive.faults import PASSES, SAYS, Injected, suffer

QUICKLY = ("no pictures",)  # the others with `make test-all`


def suffered_well(folder: Path, fault: Injected) -> None:
    one = suffer(folder, fault)
    assert re.search(SAYS[fault.kind], one.message), one.message
    assert one.message.startswith("holds: ")
    assert one.hold_after <= 0.1 + 1e-9
    assert one.cell.largest <= 1.05 * one.limit
    assert one.ended
    assert one.outcome.good == (fault.kind in PASSES)
    assert one.outcome.recorded.film is not None
    rec = read_recording(folder)
    assert rec.video is not None
    frames = sum(1 for _ in read_frames(rec.video))
    assert frames == len((folder / "frames.csv").read_text(encoding="utf-8").splitlines()) - 1
    if fault.kind in ("swapped", "flipped"):  # what is wrong to the end contradicts itself, and learning says so
        with pytest.raises(ObservationError, match=r"apart|turned by|opposite sign"):
            observe(rec)
    else:
        assert len(observe(rec).time) > 30  # those after the last good row of the force are left out


@pytest.mark.parametrize("kind", [pytest.param(one, marks=() if one in QUICKLY else pytest.mark.slow) for one in SAYS])
def test_a_fault_holds_the_push(kind: str, tmp_path: Path) -> None:
    suffered_well(tmp_path, Injected(kind, 0.9, seed=list(SAYS).index(kind), hand="push"))


@pytest.mark.slow
@pytest.mark.parametrize(("hand", "by"), [("hold", "pose"), ("push", "force")])
@pytest.mark.parametrize("kind", SAYS)
def test_a_fault_holds_every_hand(kind: str, hand: Hand, by: Skill, tmp_path: Path) -> None:
    suffered_well(tmp_path, Injected(kind, 0.7, seed=list(SAYS).index(kind) + 20, hand=hand, by=by))
