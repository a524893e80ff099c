"""When a contact ends: let go, so that the beam swings, or led back."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.loads import push
from onebend.learning.sensing.contacts import ModeBending, ended, find_swing, runs_of
from onebend.learning.sensing.sense import sense
from onebend.records import Array
from tests.learning.sensing.drawn import BAND, BEAM, drawn, place_off
from tests.learning.sensing.let_go import moved, release

NOISE, FPS, END = 1e-3, 60.0, 1.207
HERTZ, RATIO = 4.0, 0.1  # of the swing


def bent(value: Array, seed: int = 0) -> ModeBending:
    """Seen with noise, from 0 s on."""
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(value))
    return ModeBending(np.arange(len(value)) / FPS, value + noise, np.full(len(value), NOISE))


def held(time: Array) -> Array:
    """Pushed from 0.5 s on, and let go at once at END."""
    on = np.clip((time - 0.5) / 0.1, 0.0, 1.0)
    since, omega, root = time - END, 2.0 * np.pi * HERTZ, np.sqrt(1.0 - RATIO**2)
    swing = np.cos(root * omega * since) + RATIO / root * np.sin(root * omega * since)
    return np.where(time < END, on, np.exp(-RATIO * omega * np.maximum(since, 0.0)) * swing)


def test_a_swing_ends_a_contact_where_the_beam_was_let_go() -> None:
    time = np.arange(150) / FPS
    seen = bent(held(time))
    touched = np.abs(seen.value) > 3.0 * NOISE
    (one,) = ended(seen, runs_of(touched))
    assert one.end is not None
    assert abs(one.end.time - END) < 2.0 * one.end.sd < 0.12
    assert time[one.last] < one.end.time <= time[one.last + 1]
    assert one.moves >= np.flatnonzero(touched)[-1] - 3


def test_the_next_contact_is_another_one() -> None:
    time = np.arange(300) / FPS
    again = np.where((time > 4.0) & (time < 4.5), np.sin(2.0 * np.pi * (time - 4.0)), 0.0)
    seen = bent(held(time) + again)
    one, other = ended(seen, runs_of(np.abs(seen.value) > 3.0 * NOISE))
    assert one.end is not None
    assert abs(one.end.time - END) < 2.0 * one.end.sd
    assert abs(time[other.last] - 4.5) < 0.05
    assert other.end is None  # it does not swing after it


def test_a_hand_that_moves_the_beam_to_and_fro_has_not_let_go() -> None:
    time = np.arange(150) / FPS
    value = np.where((time > 0.5) & (time < 1.5), np.sin(4.0 * np.pi * (time - 0.5)), 0.0)
    seen = bent(value)
    (one,) = ended(seen, runs_of(np.abs(value) > 3.0 * NOISE))
    assert find_swing(time, seen.value, NOISE, 30, 90) is not None  # it looks like one
    assert one.end is None
    assert abs(time[one.last] - 1.5) < 0.05  # and not where it goes through rest, at 0.75, 1 and 1.25 s


def test_a_beam_that_is_let_go_shows_one_contact_until_then() -> None:
    one = release(26)  # 30 frames a second; damping ratio 0.04: it swings for seconds
    found = sense(BEAM, moved(26, one)[0], stiffness=BAND)
    (contact,) = found.contacts
    assert abs(contact.end.time - one.end) < 2.0 * contact.end.sd < 0.2
    assert contact.last < contact.end.time


@pytest.mark.slow
def test_ends_of_releases_hold_the_truth() -> None:
    away = []
    for seed in range(300, 360):
        one = release(seed)
        (contact,) = sense(BEAM, moved(seed, one)[0], stiffness=BAND).contacts
        away.append((contact.end.time - one.end) / contact.end.sd)
    assert 0.3 < np.sqrt(np.mean(np.square(away))) < 1.3
    assert np.mean(np.abs(away) > 2.0) <= 0.1


@pytest.mark.slow
def test_ends_of_slow_pushes_hold_the_truth() -> None:
    away, time = [], np.arange(60) / 30.0
    for seed in range(400, 430):
        end = 1.5 + 0.001 * (seed % 30)
        force = 0.2 * np.sin(np.pi * np.clip((time - 0.5) / (end - 0.5), 0.0, 1.0)) ** 2
        o, _ = drawn(seed, push(np.outer(force, [0.2, 1.0]), 0.9 + place_off(seed)))
        (contact,) = sense(BEAM, o, stiffness=BAND).contacts
        away.append((contact.end.time - end) / contact.end.sd)
    assert np.mean(np.abs(away) < 1.96) > 0.9
