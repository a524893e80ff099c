"""The process that reviews a stream beside the one that records it."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np

from onebend.live.hyperparameters import OnlineSettings
from onebend.live.review import Reviewed, ReviewerBeside, Seen
from onebend.recording.observe import ObserveSettings


def reviewed(reviewer: ReviewerBeside, seen: Seen) -> Reviewed:
    reviewer.begin(seen)
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        if (made := reviewer.result()) is not None:
            return made
        time.sleep(0.02)
    raise AssertionError("nothing came")


def test_a_review_that_fails_is_said_and_the_next_one_is_made(capfd: Any) -> None:
    nothing: Any = None
    reviewer = ReviewerBeside(ObserveSettings(), OnlineSettings())
    for until in (2.0, 3.0):
        tracks: Any = SimpleNamespace(time=np.array([until]))
        made = reviewed(reviewer, Seen(nothing, tracks, np.empty((0, 3))))
        assert made.until == until
        assert made.why.startswith("this review could not be made (AttributeError")
    reviewer.close()
    assert "Traceback" not in capfd.readouterr().err
