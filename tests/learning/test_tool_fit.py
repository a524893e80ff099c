"""The place of the push where the film shows the tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import Posterior, fit
from onebend.records import Observations, ToolTrack
from tests.learning.bench import SOFT, forces, observed

OFF = 4e-3  # m, by which the push acts nearer to the clamp than written


def pushed(*, sd: float | None) -> Observations:
    """A push that is written at 0.9; a film shows it where it acts, to `sd` m; None: it does not."""
    force, at = forces(60), 0.9 - OFF / SOFT.length
    plain = observed(SOFT, force, at_s=at, noise=(2e-5, 2e-4))
    written = replace(plain, push_s=np.full(len(force), 0.9), stated=replace(plain.stated, place_sd=4e-3))
    if sd is None:
        return written
    count, one = 20, sd / SOFT.length
    time = np.linspace(plain.time[0], plain.time[-1], count)
    return replace(written, tool=ToolTrack(time, np.full(count, at), np.full(count, one), np.full((count, 1), one)))


def place(found: Posterior) -> tuple[float, float]:
    """m, and its sd."""
    block = found.problem.layout.index["place", 0]
    return float(found.mean[block.where][0]), float(np.sqrt(found.covariance.diagonal[block.where.start]))


@pytest.mark.slow
def test_the_tool_tells_the_place_and_narrows_the_band() -> None:
    quick = FitSettings(functions=16, most_frames=60, first_frames=30)
    alone, seen = (fit([pushed(sd=sd)], settings=quick) for sd in (None, 2e-4))
    (_, loose), (found, sd) = place(alone), place(seen)
    assert abs(found + OFF) < 3.0 * sd
    assert sd < 4e-4 < loose
    s = np.linspace(0.05, 0.8, 30)
    off = [float(np.sqrt(np.mean(np.log(one.band(s).k / SOFT.stiffness(s)) ** 2))) for one in (alone, seen)]
    assert off[1] < off[0]


def test_an_error_that_all_frames_share_does_not_average_out() -> None:
    assert place(fit([pushed(sd=1e-3)]))[1] > 0.7e-3
