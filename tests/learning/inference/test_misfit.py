"""What counts as a miss: distances against the tags' noise and their motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.inference.misfit import Miss, misses
from onebend.learning.model.fit_data import fit_data
from onebend.learning.model.forward import Prediction, predict
from onebend.learning.model.parameters import Priors, make_layout
from onebend.learning.model.spline import Spline
from onebend.records import Array
from tests.learning.bench import SOFT, forces, observed

SD = 1e-4  # m, of each coordinate of a tag


@pytest.fixture(scope="module")
def exact() -> Prediction:
    """A fit that sits on the tags."""
    made = observed(SOFT, forces(10), noise=(SD, 1e-3))
    spline = Spline(8)
    data = fit_data(made, 0, np.ones(len(made.time), dtype=bool), spline)
    layout = make_layout(spline, [made], [len(data.error.knots)], Priors())
    x = np.zeros(layout.size)
    x[: spline.count] = np.log(0.02)
    now = predict(data, layout, x, None)
    return replace(now, pose=data.measured)


def missed(exact: Prediction, by: float, motion: float | None = None) -> Miss | None:
    """What is said of a fit that is `by` [m] off its middle tag in every frame; the tag moves by `motion` [m]."""
    data, off = exact.recording, np.zeros_like(exact.pose)
    off[:, 1, 1] = by
    if motion is not None:
        measured = data.measured.copy()
        measured[:, 1, :2] = data.measured[0, 1, :2]
        measured[0, 1, 0] += motion
        data = replace(data, measured=measured)
    now = replace(exact, recording=data, pose=data.measured + off)
    found = misses([data], [now])
    return found[0] if found else None


def motion_of(exact: Prediction) -> Array:
    """(m,) m."""
    return np.asarray(np.linalg.norm(np.ptp(exact.recording.measured[..., :2], axis=0), axis=1))


@pytest.mark.parametrize(("times", "is_miss"), [(1.0, False), (2.5, False), (3.5, True), (10.0, True)])
def test_a_miss_of_a_few_times_the_tags_noise_is_none(exact: Prediction, times: float, is_miss: bool) -> None:
    noise = np.sqrt(2.0) * SD  # of both coordinates
    miss = missed(exact, times * noise, motion=noise)
    assert (miss is not None) == is_miss
    if miss is not None:
        assert miss.tag == 2
        assert miss.rms == pytest.approx(times * noise)
        assert miss.motion == pytest.approx(noise)


@pytest.mark.parametrize(("share", "is_miss"), [(0.045, False), (0.055, True)])
def test_a_miss_is_a_twentieth_of_the_tags_motion(exact: Prediction, share: float, is_miss: bool) -> None:
    motion = float(motion_of(exact)[1])
    assert share * motion > 5.0 * SD
    assert (missed(exact, share * motion) is not None) == is_miss


def test_a_fit_is_hopeless_by_the_motion_of_all_tags_together(exact: Prediction) -> None:
    motion = float(np.linalg.norm(motion_of(exact)))
    few, many = missed(exact, 0.18 * motion), missed(exact, 0.22 * motion)
    assert few is not None
    assert many is not None
    assert few.share == pytest.approx(0.18, rel=1e-6)
    assert not few.hopeless
    assert many.hopeless


def test_a_fit_on_the_tags_misses_none(exact: Prediction) -> None:
    assert misses([exact.recording], [exact]) == ()
