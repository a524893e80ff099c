"""The unit of a log, by what its sensor's noise must be."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.recording.force_log import SENSOR_NOISE, noise_remarks
from onebend.records import Array, ForceLog

USUAL = SENSOR_NOISE["franka-estimate"]


def log(sd: float, *, width: int = 1) -> ForceLog:
    """Ten seconds at 500 Hz with a push of five; `width` rows are averaged as a filter does."""
    time = np.arange(5000) / 500.0
    push = 2.0 * np.clip(np.minimum(time - 2.0, 7.0 - time), 0.0, None)
    noise: Array = np.random.default_rng(1).normal(size=(len(time) + width - 1, 2))
    kernel = np.full(width, 1.0 / width)
    smooth = np.stack([np.convolve(column, kernel, "valid") for column in noise.T], axis=1)
    return ForceLog(time=time, force=np.stack([push, -push], axis=1) + sd * smooth, push_s=None)


@pytest.mark.parametrize(
    ("factor", "words"),
    [(1.0, ""), (0.4, ""), (2.5, ""), (1.0 / 9.81, "in kilograms"), (102.0, "in grams or millinewtons")],
)
def test_a_log_far_quieter_or_louder_than_its_sensor_is_in_another_unit(factor: float, words: str) -> None:
    remarks = noise_remarks(log(factor * USUAL), "franka-estimate", np.nan)
    assert [words in one.text and one.doubt and one.about == "force unit" for one in remarks] == [True] * bool(words)


def test_a_filtered_log_is_quiet_without_a_doubt() -> None:
    assert noise_remarks(log(USUAL, width=100), "franka-estimate", np.nan) == ()


def test_the_stated_noise_replaces_that_of_the_name_and_nothing_is_said_without_either() -> None:
    quiet = log(0.003)
    assert noise_remarks(quiet, "franka-estimate", 0.003) == ()
    assert noise_remarks(quiet, "mine", np.nan) == ()
    assert "white_sd_N" in noise_remarks(quiet, "mine", 0.05)[0].text
