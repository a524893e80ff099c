"""Frequencies found in made signals: in their band over many seeds, modes told from noise and from multiples."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest

from onebend.errors import LearningError
from onebend.learning.swing import FilmPart, frequencies_of, swing_frequencies
from onebend.records import Array
from onebend.report.sentences import worded

RATE, SECONDS = 60.0, 6.0
TIME = np.arange(round(RATE * SECONDS)) / RATE
MODES = ((2.3, 0.02, 10.0), (14.4, 0.01, 1.0))  # Hz, damping ratio, size
SHAPES = np.array([[1.0, 0.1], [0.3, -0.9], [0.02, 0.0]])  # signals, modes


def swing(seed: int, noise: float, alike: float = 0.0, time: Array = TIME) -> Array:
    """Three signals; the noise of neighbouring samples is `alike` (correlation)."""
    rng = np.random.default_rng(seed)
    clean = np.zeros((len(time), len(SHAPES)))
    for (hz, ratio, size), shape in zip(MODES, SHAPES.T, strict=True):
        omega = 2.0 * np.pi * hz
        decay = ratio * omega / np.sqrt(1.0 - ratio**2)
        clean += size * np.outer(np.exp(-decay * time) * np.cos(omega * time + 0.7), shape)
    white = rng.standard_normal(clean.shape)
    for i in range(1, len(white) if alike else 0):
        white[i] = alike * white[i - 1] + np.sqrt(1.0 - alike**2) * white[i]
    return np.asarray(clean + np.array([3.0, -5.0, 0.1]) + noise * white)


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "alike"), [(0.05, 0.0), (0.05, 0.9)])
def test_frequencies_and_damping_are_within_their_sd(noise: float, alike: float) -> None:
    z = []
    for seed in range(20):
        found = swing_frequencies(TIME, swing(seed, noise, alike)).modes
        assert len(found) == 2
        for one, (hz, ratio, _) in zip(found, MODES, strict=True):
            z.append([(one.frequency - hz) / one.sd, (one.damping_ratio - ratio) / one.damping_ratio_sd])
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all((rms > 0.6) & (rms < 1.5))


def test_one_signal_with_gaps_at_uneven_times_is_enough() -> None:
    rng = np.random.default_rng(3)
    time = np.sort(TIME + 0.2 / RATE * rng.uniform(-1.0, 1.0, len(TIME)))
    seen = swing(0, 0.02, time=time)[:, :1]
    seen[100:110] = np.nan
    found = swing_frequencies(time, seen).modes
    assert [one.frequency for one in found] == pytest.approx([2.3, 14.4], rel=1e-3)
    assert found[1].share < 0.2


def test_a_multiple_of_a_mode_is_no_mode() -> None:
    """The place along the beam goes with the square of the one across it."""
    across = swing(0, 0.0)[:, 0] - 3.0
    noise = 1e-3 * np.random.default_rng(0).standard_normal((len(TIME), 2))
    found = swing_frequencies(TIME, np.stack([across, -0.02 * across**2], axis=1) + noise)
    double = [one for one in found.modes if one.multiple_of]
    assert double
    assert double[0].frequency == pytest.approx(4.6, rel=5e-3)
    assert any("not a mode" in remark.text for remark in worded(found.remarks))


def test_a_part_is_found_and_slow_motion_is_sped_up() -> None:
    """Bent, held and let go after a second: from then on it swings."""
    held = np.full((60, 3), swing(0, 0.0)[0])
    seen = np.concatenate([held, swing(0, 0.0)]) + 1e-3 * np.random.default_rng(0).standard_normal((420, 3))
    found = frequencies_of(np.arange(420) / RATE, seen)
    assert 1.0 < found.begin < 1.2
    assert found.modes[0].frequency == pytest.approx(2.3, rel=1e-4)
    assert found.sped_up(8.0).modes[0].frequency == pytest.approx(8.0 * found.modes[0].frequency)
    assert frequencies_of(np.arange(420) / RATE, seen, FilmPart(2.0, 5.0)).begin == pytest.approx(2.0)


def test_in_a_long_record_noise_is_no_mode() -> None:
    """But for one record in twenty."""

    def swings(seed: int) -> bool:
        noise = np.random.default_rng(seed).standard_normal((6_000, 1))
        with suppress(LearningError):
            return len(swing_frequencies(np.arange(6_000) / RATE, noise).modes) > 0
        return False

    assert sum(swings(seed) for seed in range(12)) <= 2


def test_of_a_record_too_long_the_first_part_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("onebend.learning.swing._MOST", 600)
    found = frequencies_of(TIME, swing(0, 0.02))
    assert found.samples == 200
    assert found.end < 4.0
    [note] = [remark.text for remark in worded(found.remarks) if "too many" in remark.text]
    assert "first 200" in note
    assert found.modes[0].frequency == pytest.approx(2.3, rel=1e-3)


@pytest.mark.parametrize(
    ("time", "signals", "says"),
    [
        (TIME[:20], np.ones((20, 1)), "20 samples; 30 or more"),
        (TIME[::-1], np.ones((len(TIME), 1)), "rise"),
        (TIME, np.ones((len(TIME), 1)), "moves"),
        (TIME, np.random.default_rng(0).standard_normal((len(TIME), 2)), "swings"),
    ],
)
def test_what_shows_no_swing_is_refused(time: Array, signals: Array, says: str) -> None:
    with pytest.raises(LearningError, match=says):
        swing_frequencies(time, signals)


def test_a_signal_that_is_lost_where_it_is_fast_does_not_hide_another() -> None:
    """A tag near the tip blurs; one near the clamp is always seen."""
    time = np.arange(115) / 30.0
    omega = 2.0 * np.pi * 2.175
    one = np.exp(-0.04 * omega * time) * np.cos(omega * time + 2.6)
    slow = np.abs(np.gradient(one, time)) < 3.0
    slow[:42] = False
    slow[1] = True  # alone
    tip = np.where(slow, 75.0 * one, np.nan)
    clamp = 9.0 * one + 0.03 * np.random.default_rng(0).standard_normal(len(time))
    found = swing_frequencies(time, np.stack([clamp, tip, tip], axis=1)).modes
    assert [mode.frequency for mode in found] == pytest.approx([2.175], rel=5e-3)
