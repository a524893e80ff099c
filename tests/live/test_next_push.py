"""What the next push should be, asked of another process."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest

from onebend.errors import ObservationError
from onebend.live import session
from onebend.live.session import NextPush, next_push_words
from onebend.recording.observe import ObserveSettings
from tests.live.played_push import SETTINGS, recorded


def seen_nothing(*_: object) -> None:
    raise ObservationError("no tag of recording.toml is in the picture")


def test_what_stands_in_the_way_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "observed_in", seen_nothing)
    said = next_push_words(None)  # type: ignore[arg-type]
    assert said == "what the next push should be is not known: no tag of recording.toml is in the picture"
    asked = NextPush(beside=False)
    assert asked.words == ""
    asked.ask(None, ObserveSettings())  # type: ignore[arg-type]
    assert asked.words == said
    asked.close()


@pytest.mark.slow
def test_a_process_beside_answers() -> None:
    asked = NextPush()
    asked.ask(None, ObserveSettings())  # type: ignore[arg-type]
    end = time.monotonic() + 60.0
    while not asked.words and time.monotonic() < end:
        time.sleep(0.05)
    assert asked.words.startswith("what the next push should be is not known: AttributeError")
    asked.close()


@pytest.mark.slow
def test_a_band_that_is_too_wide_is_answered_with_the_next_push(tmp_path: Path) -> None:
    _, states = recorded(tmp_path / "push", replace(SETTINGS, follow=True, until=0.001))
    assert states[-1].next_push.startswith(("push at s = ", "once more: push at s = "))
    assert states[-1].advice[-1] == states[-1].next_push
