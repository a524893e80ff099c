"""When the beam is touched: found from markers and force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.recording.force import Contact, find_contact
from onebend.records import ForceLog, Markers
from tests.recording.pushed import Pushed, force_at, push


def touched(markers: Markers, contact: Contact) -> tuple[float, float]:
    """s, the first and the last frame of the film in which the beam is touched."""
    first, last = markers.time[contact.loaded][[0, -1]].tolist()
    return first, last


def level(pushed: Pushed, begin: float) -> float:
    """Part of the largest force at `begin`."""
    size = np.linalg.norm(force_at(push(np.array([begin]), rise=pushed.rise, hold=pushed.hold)))
    return float(size / np.linalg.norm(force_at(np.ones(1))))


@pytest.mark.parametrize("fps", [25.0, 60.0])
def test_contact_and_both_rests(fps: float) -> None:
    pushed = Pushed(fps=fps)
    contact = find_contact(pushed.markers(), pushed.log(), offset=pushed.offset)
    begin, end = touched(pushed.markers(), contact)
    assert 1.5 < begin < 1.8
    assert level(pushed, begin) < 0.02
    assert 6.2 < end < 6.6
    assert len(contact.rests) == 2
    for low, high in contact.rests:  # nothing of the push is in the zero
        inside = np.clip(np.linspace(max(low, 0.0), min(high, 8.0), 50), 0.0, 8.0)
        assert max(level(pushed, t) for t in inside) < 0.01
    assert not np.any(contact.loaded & contact.still)
    assert contact.remarks == ()


def test_held_to_the_end() -> None:
    pushed = Pushed(film=4.2)
    contact = find_contact(pushed.markers(), pushed.log(), offset=pushed.offset)
    assert len(contact.rests) == 1
    assert contact.loaded[-1]


def swinging(pushed: Pushed) -> tuple[Markers, ForceLog]:
    """Let go at 4.0 s: the force is gone at once, the beam swings to the end."""
    markers, log = pushed.markers(), pushed.log()
    after = markers.time > 4.0
    rest, held = markers.xy[:20].mean(axis=0), markers.xy[~after][-1]
    wave = np.exp(-0.4 * (markers.time - 4.0)) * np.cos(2 * np.pi * 3.0 * (markers.time - 4.0))
    xy = np.where(after[:, None, None], rest + wave[:, None, None] * (held - rest), markers.xy)
    gone = log.time - pushed.offset > 4.0
    force = log.force - np.where(gone[:, None], pushed.true_force(log.time - pushed.offset), 0.0)
    return replace(markers, xy=xy), ForceLog(log.time, force)


def test_released_and_swinging_is_free() -> None:
    pushed = Pushed(hold=3.0)
    markers, log = swinging(pushed)
    contact = find_contact(markers, log, offset=pushed.offset)
    assert touched(markers, contact)[1] == pytest.approx(4.0, abs=0.15)
    assert not contact.loaded[markers.time > 4.2].any()
    assert not contact.still[markers.time > 4.2].any()
    assert any("swings" in remark.text for remark in contact.remarks)
    assert len(contact.rests) == 2


def test_moving_from_the_first_frame() -> None:
    pushed = Pushed(film=6.0)
    markers = pushed.markers()
    late = markers.time > 2.0
    cut = replace(
        markers,
        time=markers.time[late],
        xy=markers.xy[late],
        angle=markers.angle[late],
        covariance=markers.covariance[late],
        base_angle=markers.base_angle[late],
    )
    contact = find_contact(cut, pushed.log(), offset=pushed.offset)
    assert contact.rests == ()
    assert contact.loaded.all()
    assert contact.remarks[0].level == "warning"


def test_nothing_happens() -> None:
    markers = Pushed(film=1.4).markers()
    contact = find_contact(markers)
    assert not contact.loaded.any()


def test_two_pushes_have_three_rests() -> None:
    first, second = Pushed(film=8.0, seed=1).markers(), Pushed(film=8.0, seed=2).markers()
    both = replace(
        first,
        time=np.concatenate([first.time, 8.0 + second.time]),
        xy=np.concatenate([first.xy, second.xy]),
        angle=np.concatenate([first.angle, second.angle]),
        covariance=np.concatenate([first.covariance, second.covariance]),
        base_angle=np.concatenate([first.base_angle, second.base_angle]),
    )
    contact = find_contact(both)
    assert len(contact.rests) == 3
    begin, end = touched(both, contact)
    assert begin < 1.8
    assert 14.2 < end < 14.6


def test_a_hidden_tag_is_no_contact() -> None:
    markers = Pushed().markers()
    xy, angle = markers.xy.copy(), markers.angle.copy()
    xy[5:25, 2], angle[5:25, 2] = np.nan, np.nan
    contact = find_contact(replace(markers, xy=xy, angle=angle))
    assert 1.5 < touched(markers, contact)[0] < 1.8
