"""From rest to push to rest, by where the tags are."""

from __future__ import annotations

import math

import numpy as np

from onebend.live.guidance import CaptureSettings, Stages, stage_advice
from onebend.records import Array
from tests.recording.filmed import corners_of, poses, recording, view

FPS = 20.0
SETTINGS = CaptureSettings(rest=2.0, tare=0.5)
NOISE = 0.05  # px


def bent(amount: float) -> Array:
    """(4, 4, 2) px corners of the tags when the tip is somewhere on its way, 0 to 1."""
    way = poses(41)[:21]  # from rest to the largest bend
    at = np.clip(amount, 0.0, 1.0) * 20.0
    low = min(int(at), 19)
    return corners_of(way[low] + (at - low) * (way[low + 1] - way[low]), view())


class Push:
    """Time that goes on, with a sensor of 100 Hz."""

    def __init__(self, settings: CaptureSettings = SETTINGS, *, forced: bool = True) -> None:
        self.stages = Stages(recording(), settings, forced=forced)
        self.settings, self.forced, self.now = settings, forced, 0.0
        self._rng = np.random.default_rng(0)

    def go(self, seconds: float, begin: float, end: float | None = None) -> list[str]:
        """Move the tip from `begin` to `end`, of 1; every advice that was given."""
        said: list[str] = []
        count = round(seconds * FPS)
        for amount in np.linspace(begin, begin if end is None else end, count).tolist():
            corners = bent(amount) + NOISE * self._rng.standard_normal((4, 4, 2))
            self.stages.update(self.now, corners)
            if self.forced:
                times = self.now + np.arange(5) / 100.0
                self.stages.force(times, np.array([0.2, -0.1]) + 0.01 * self._rng.standard_normal((5, 2)))
            said += stage_advice(self.stages, self.settings, math.nan)
            self.now += 1.0 / FPS
        return said


def test_a_push_goes_through_all_stages() -> None:
    push = Push()
    seen = []
    for seconds, begin, end in ((0.3, 0, 0), (0.8, 0, 0), (2, 0, 0), (4, 0, 1), (4, 1, 0), (1, 0, 0)):
        push.go(seconds, begin, end)
        seen.append(push.stages.stage)
    assert seen == ["tare", "first rest", "push", "push", "push", "last rest"]
    push.go(2.0, 0.0)
    assert push.stages.stage == "last rest"
    assert push.stages.rested >= SETTINGS.rest
    assert np.abs(push.stages.tare - [0.2, -0.1]).max() < 0.01
    assert push.stages.largest > 0.5


def test_without_samples_of_the_force_the_tare_waits_and_says_so() -> None:
    push = Push(forced=False)
    push.stages = Stages(recording(), SETTINGS, forced=True)
    said = push.go(5.0, 0.0)
    assert push.stages.stage == "tare"
    assert said[-1].startswith("no sample of the force has come yet")


def test_without_a_sensor_the_rest_begins_at_once() -> None:
    push = Push(forced=False)
    push.go(2.2, 0.0)
    assert push.stages.stage == "push"


def test_a_beam_that_moves_too_early_begins_the_rest_anew() -> None:
    push = Push()
    push.go(0.5, 0.0)
    said = push.go(0.6, 0.0, 0.5)
    assert any("begins anew" in one for one in said)
    push.go(0.4, 0.5, 0.5)
    assert push.stages.stage in ("tare", "first rest")


def test_a_push_after_a_short_rest_counts_and_is_told() -> None:
    push = Push()
    push.go(1.2, 0.0)
    push.go(2.0, 0.0, 0.8)
    assert push.stages.stage == "push"
    assert push.stages.short_rest


def test_the_push_is_told_how_far_and_when_to_go_back() -> None:
    push = Push()
    push.go(2.5, 0.0)
    assert push.go(0.3, 0.0)[-1] == "push now, slowly: the tip should move by half the length"
    assert push.go(3.0, 0.0, 0.4)[-1].startswith("further: the tip has moved by ")
    assert push.go(3.0, 0.4, 1.0)[-1] == "far enough: go back slowly, let go, and touch nothing"


def test_a_fast_push_is_told_to_slow_down() -> None:
    push = Push()
    push.go(2.5, 0.0)
    assert any(one.startswith("more slowly") for one in push.go(0.5, 0.0, 0.9))


def test_a_beam_held_bent_is_no_last_rest() -> None:
    push = Push()
    push.go(2.5, 0.0)
    push.go(3.0, 0.0, 1.0)
    push.go(3.0, 1.0)
    assert push.stages.stage == "push"


def test_a_second_push_follows_a_last_rest() -> None:
    push = Push()
    for seconds, begin, end in ((2.5, 0, 0), (3, 0, 1), (3, 1, 0), (1, 0, 0)):
        push.go(seconds, begin, end)
    seen: list[str] = [push.stages.stage]
    push.go(1.0, 0.0, 0.4)
    assert [*seen, push.stages.stage] == ["last rest", "push"]


def test_hidden_tags_change_nothing() -> None:
    push = Push()
    push.go(2.5, 0.0)
    before = push.stages.stage
    push.stages.update(push.now, np.full((4, 4, 2), np.nan))
    assert push.stages.stage == before


def test_what_is_asked_for_ends_the_push() -> None:
    push = Push(CaptureSettings(rest=2.0, tare=0.5, until=0.1))
    push.go(2.5, 0.0)
    push.go(1.0, 0.0, 0.3)
    [said] = stage_advice(push.stages, push.settings, 0.08)
    assert said == "the band is ± 8 %, as wanted: let go slowly, and touch nothing"
