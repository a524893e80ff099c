"""When a contact ends: let go, so that the beam swings, or led back."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.loads import push
from onebend.learning.sensing.contacts import ContactFrames, Excursion, contacts_of, runs_of
from onebend.learning.sensing.sense import sense
from onebend.records import Array
from tests.learning.sensing.drawn import BAND, BEAM, drawn, place_off
from tests.learning.sensing.let_go import moved, release

NOISE, FPS, END, HALF = 1e-3, 60.0, 1.207, 0.125  # HALF: s, of half a swing


def bent(value: Array, seed: int = 0) -> Excursion:
    """Seen with noise, from 0 s on."""
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(value))
    return Excursion(np.arange(len(value)) / FPS, value + noise, NOISE)


def held(time: Array) -> Array:
    """Pushed from 0.5 s on, and let go at once at END."""
    on, since = np.clip((time - 0.5) / 0.1, 0.0, 1.0), np.maximum(time - END, 0.0)
    return np.where(time < END, on, np.exp(-2.5 * since) * np.cos(np.pi * since / HALF))


def told(seen: Excursion, clear: float = 3.0) -> list[ContactFrames]:
    return contacts_of(seen, runs_of(np.abs(seen.value) > clear * NOISE))


def test_a_swing_ends_a_contact_where_the_beam_was_let_go() -> None:
    seen = bent(held(np.arange(150) / FPS))
    (one,) = told(seen)
    assert abs(one.end.time - END) < 1.5 * one.end.sd < 0.6 * HALF
    assert seen.time[one.last] < one.end.time <= seen.time[one.last + 1]
    assert one.moves >= np.flatnonzero(np.abs(seen.value) > 3.0 * NOISE)[-1] - 3
    assert abs(one.begin.time - 0.5) < 3.0 * one.begin.sd < 0.03


def test_the_next_contact_is_another_one() -> None:
    time = np.arange(300) / FPS
    again = np.where((time > 4.0) & (time < 4.5), np.sin(2.0 * np.pi * (time - 4.0)), 0.0)
    one, other = told(bent(held(time) + again))
    assert abs(one.end.time - END) < 1.5 * one.end.sd
    assert abs(other.begin.time - 4.0) < 3.0 * other.begin.sd < 0.05
    assert abs(other.end.time - 4.5) < 3.0 * other.end.sd < 0.05


def test_a_hand_that_moves_the_beam_to_and_fro_has_not_let_go() -> None:
    time = np.arange(150) / FPS
    (one,) = told(bent(np.where((time > 0.5) & (time < 1.5), np.sin(4.0 * np.pi * (time - 0.5)), 0.0)))
    assert abs(one.end.time - 1.5) < 0.03  # and not where it goes through rest, at 0.75, 1 and 1.25 s


@pytest.mark.slow
@pytest.mark.parametrize("power", [1, 2, 3])
def test_an_end_without_a_swing_is_that_of_a_power_of_time(power: int) -> None:
    time = np.arange(150) / FPS
    left = np.clip((END - time) / 0.8, 0.0, 1.0)
    away = []
    for seed in range(4):
        (one,) = told(bent(left**power * (1.0 - 0.4 * left) * (time > 0.4), seed), clear=4.0)
        assert one.end.sd < (0.003, 0.08, 0.08)[power - 1]
        away.append((one.end.time - END) / one.end.sd)
    assert np.sqrt(np.mean(np.square(away))) < 1.7


def test_a_beam_that_is_let_go_shows_one_contact_until_then() -> None:
    one = release(26)  # 30 frames a second; damping ratio 0.04: it swings for seconds
    found = sense(BEAM, moved(26, one)[0], stiffness=BAND)
    (contact,) = found.contacts
    assert abs(contact.end.time - one.end) < 2.0 * contact.end.sd < 0.12
    assert contact.last < contact.end.time


@pytest.mark.slow
def test_ends_of_releases_hold_the_truth() -> None:
    away = []
    for seed in range(300, 360):
        one = release(seed)
        (contact,) = sense(BEAM, moved(seed, one)[0], stiffness=BAND).contacts
        away.append((contact.end.time - one.end) / contact.end.sd)
    assert 0.3 < np.sqrt(np.mean(np.square(away))) < 1.2
    assert np.mean(np.abs(away) > 1.96) <= 0.05


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
