"""Steps and bumps that are chosen by evidence: the right ones, none where there is none, and k(s) across a step."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Gaussians, Steps, equidistant
from onebend.learning.normal import InformationForm, part_variances, stand_at
from onebend.learning.parameters import Spline
from onebend.learning.posterior import fit
from onebend.learning.sharp_steps import chosen
from onebend.records import Array
from tests.learning.bench import IDEAL, forces, observed

SPLINE = Spline(45)
S = np.linspace(0.05, 0.9, 60)


def seen(log_k: Array, sd: float = 0.01) -> InformationForm:
    """Means of log k over twelve parts of the beam."""
    s = np.linspace(0.0, 1.0, 241)
    rows = np.array([SPLINE.basis(part).mean(axis=0) for part in np.array_split(s, 12)]) / sd
    return InformationForm(rows.T @ rows, rows.T @ (rows @ log_k))


@pytest.mark.parametrize("place", [10, 17, 30])
def test_a_step_is_found_where_it_is(place: int) -> None:
    log_k = np.where(np.arange(SPLINE.count) > place, 0.8, 0.0) - 4.0
    found = chosen(seen(log_k), SPLINE, -4.0)
    steps = np.flatnonzero(found.variances[SPLINE.count : 2 * SPLINE.count - 1])
    assert found.count >= 1
    assert np.min(np.abs(steps - place)) <= 1


def test_a_smooth_course_needs_none() -> None:
    log_k = SPLINE.nearest(lambda s: 0.4 * np.cos(2.0 * s) - 4.0)
    assert chosen(seen(log_k), SPLINE, -4.0).count == 0


def test_a_chain_begins_with_the_variances_that_were_chosen() -> None:
    variances = np.maximum(SPLINE.variances(1.0, 0.0), 1e-8)
    variances[SPLINE.count + 5] = 0.01
    stand = stand_at(SPLINE, variances)[None]
    again, _ = part_variances(SPLINE, stand[:, :2], stand[:, 2:])
    np.testing.assert_allclose(again[0], variances, rtol=0.02)


@pytest.mark.parametrize(("at", "parts"), [(0.5, (0.01, 0.04)), (0.17, (0.04, 0.012))])
def test_k_changes_at_once_across_a_step(at: float, parts: tuple[float, float]) -> None:
    """A search that begins even ends in a ramp, up to 20 % off beside the step."""
    beam = Beam(0.15, Steps((0.0, at, 1.0), parts))
    post = fit([observed(beam, forces(60, most=0.25), noise=(1e-5, 4e-4))], settings=IDEAL)
    beside = S[np.abs(S - at) > 0.05]
    np.testing.assert_allclose(post.band(beside).k, beam.stiffness(beside), rtol=0.1)


def test_a_smooth_beam_has_no_steps() -> None:
    beam = Beam(0.15, Gaussians(equidistant(3), 0.5, (0.02, 0.03, 0.015)))
    post = fit([observed(beam, forces(60), noise=(1e-5, 4e-4))], settings=IDEAL)
    assert np.max(np.abs(post.optimum.jumps)) < 0.02
