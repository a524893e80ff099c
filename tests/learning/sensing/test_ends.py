"""When a contact ends: let go, so that the beam swings, or led back."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.loads import push
from onebend.learning.sensing.contacts import runs_of
from onebend.learning.sensing.endings import (
    FALLS,
    PIECES,
    SWING,
    Mode,
    ModeBending,
    columns,
    ended,
    find_swing,
    straight,
)
from onebend.learning.sensing.sense import sense
from onebend.records import Array
from tests.learning.sensing.drawn import BAND, BEAM, drawn, place_off
from tests.learning.sensing.let_go import moved, release

NOISE, FPS, END = 1e-3, 60.0, 1.207
MODE = Mode(2.0 * np.pi * 4.0, 0.1, 0.0, 0.0, 0.0)


def bent(value: Array, seed: int = 0) -> ModeBending:
    """Seen with noise, from 0 s on."""
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(value))
    return ModeBending(np.arange(len(value)) / FPS, value + noise, np.full(len(value), NOISE))


def held(time: Array) -> Array:
    """Pushed from 0.5 s on, and let go at once at END."""
    on = np.clip((time - 0.5) / 0.1, 0.0, 1.0)
    return np.where(time < END, on, MODE.free(time - END)[0])


def test_what_a_mode_does_under_a_force_obeys_its_equation() -> None:
    left, step = np.linspace(0.01, 0.8, 40), 1e-5
    now, before, after = (MODE.of_powers(left + by, 3) for by in (0.0, step, -step))  # after: less is left
    rate, bend = (after - before) / (2.0 * step), (after - 2.0 * now + before) / step**2
    force = now + 2.0 * MODE.damping / MODE.rate * rate + bend / MODE.rate**2
    expected = np.stack([np.ones_like(left), left, left**2 / 2.0, left**3 / 6.0], axis=-1)
    np.testing.assert_allclose(force, expected, atol=1e-4)
    assert np.all(MODE.of_powers(np.array([-0.1, 0.0]), 3) == 0.0)
    assert np.max(np.abs(MODE.of_powers(np.array([1e-4]), 3))) < 1e-5  # nothing at the end, nor a rate


def test_a_fall_has_its_force_before_it() -> None:
    fall, lasts = SWING + 3 + 24 + PIECES * 4, FALLS[4]
    long_before = columns(MODE, np.array([0.0, 1.0 / FPS]), np.array([3.0]), 1.0)[0, :, fall]
    kinked = MODE.of_powers(np.array([[3.0, 3.0 - lasts]]), 1)[0, :, 1]
    assert long_before[0] == pytest.approx((kinked[0] - kinked[1]) / lasts)


def test_a_swing_ends_a_contact_where_the_beam_was_let_go() -> None:
    time = np.arange(150) / FPS
    seen = bent(held(time))
    touched = np.abs(seen.value) > 3.0 * NOISE
    (one,) = ended(seen, runs_of(touched), 1.0)
    assert one.end is not None
    assert abs(one.end.time - END) < 3.0 * one.end.sd < 0.03
    assert time[one.last] < one.end.time <= time[one.last + 1]
    assert one.moves >= np.flatnonzero(touched)[-1] - 3


def test_the_next_contact_is_another_one() -> None:
    time = np.arange(300) / FPS
    again = np.where((time > 4.0) & (time < 4.5), np.sin(2.0 * np.pi * (time - 4.0)), 0.0)
    seen = bent(held(time) + again)
    one, other = ended(seen, runs_of(np.abs(seen.value) > 3.0 * NOISE), 1.0)
    assert one.end is not None
    assert other.end is not None
    assert abs(one.end.time - END) < 3.0 * one.end.sd
    assert abs(other.end.time - 4.5) < 3.0 * other.end.sd < 0.05


def test_a_hand_that_moves_the_beam_to_and_fro_has_not_let_go() -> None:
    time = np.arange(150) / FPS
    value = np.where((time > 0.5) & (time < 1.5), np.sin(4.0 * np.pi * (time - 0.5)), 0.0)
    seen = bent(value)
    (one,) = ended(seen, runs_of(np.abs(value) > 3.0 * NOISE), 1.0)
    assert find_swing(time, seen.value, NOISE, 30, 90) is not None  # it looks like one
    assert one.end is not None
    assert abs(one.end.time - 1.5) < 0.03  # and not where it goes through rest, at 0.75, 1 and 1.25 s


@pytest.mark.parametrize("power", [1, 2, 3])
def test_an_end_without_a_swing_is_that_of_a_power_of_time(power: int) -> None:
    time = np.arange(150) / FPS
    left = np.clip((END - time) / 0.8, 0.0, 1.0)
    away = []
    for seed in range(8):
        seen = bent(left**power * (1.0 - 0.4 * left), seed)
        last = int(np.flatnonzero(seen.value > 3.0 * NOISE)[-1])
        end = straight(time, seen.value, NOISE, 24, last)
        assert end is not None
        assert end.sd < (0.003, 0.08, 0.08)[power - 1]
        away.append((end.time - END) / end.sd)
    assert np.sqrt(np.mean(np.square(away))) < 1.7


def test_a_beam_that_is_let_go_shows_one_contact_until_then() -> None:
    one = release(26)  # 30 frames a second; damping ratio 0.04: it swings for seconds
    found = sense(BEAM, moved(26, one)[0], stiffness=BAND)
    (contact,) = found.contacts
    assert abs(contact.end.time - one.end) < 2.5 * contact.end.sd < 0.03
    assert contact.last < contact.end.time


@pytest.mark.slow
def test_ends_of_releases_hold_the_truth() -> None:
    away = []
    for seed in range(300, 360):
        one = release(seed)
        (contact,) = sense(BEAM, moved(seed, one)[0], stiffness=BAND).contacts
        away.append((contact.end.time - one.end) / contact.end.sd)
    assert 0.5 < np.sqrt(np.mean(np.square(away))) < 1.2
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
