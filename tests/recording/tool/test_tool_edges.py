"""The middle of a tool's end by its edges, where a shadow lies beside it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from onebend.recording.plane import to_plane
from onebend.recording.tool_edges import ToolStrip, contacts
from onebend.records import Array
from tests.recording.filmed import HEIGHT, LENGTH, WIDTH, view

FLANK = 0.008  # m, of a straight body along x
TOOL = 0.007  # m, its width


def table() -> Array:
    rng = np.random.default_rng(3)
    return np.asarray(130.0 + 150.0 * gaussian_filter(rng.standard_normal((HEIGHT, WIDTH)), 4.0), dtype=float)


def picture(x: float, slope: float, shadow: float) -> Array:
    """A dark tool from below whose end's middle touches at `x` m, and its soft shadow beside it."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    at = to_plane(view(), np.stack([columns, rows], axis=-1))
    out = -at[..., 1] - FLANK  # m beyond the flank
    aside = at[..., 0] - x - slope * out
    shade = gaussian_filter(((np.abs(aside - 0.008) < 0.5 * TOOL) & (out > 0.0)).astype(float), 5.0)
    drawn = table() * (1.0 - shadow * shade)
    drawn[(np.abs(aside) < 0.5 * TOOL) & (out > 0.0)] = 75.0
    drawn[np.abs(at[..., 1]) < FLANK] = 200.0
    return np.asarray(gaussian_filter(drawn, 0.7) + np.random.default_rng(5).normal(size=drawn.shape))


@pytest.mark.parametrize("shadow", [0.0, 0.35])
def test_the_middle_of_the_tool_is_found_and_not_that_of_its_shadow(shadow: float) -> None:
    places, rough = 0.5 * LENGTH + np.array([-1e-3, 0.0, 2e-3]), 0.5 * LENGTH
    strips = [
        ToolStrip(
            picture(float(x), 0.25, shadow).astype(np.float32), view(), np.array([rough, 0.0]),
            np.array([1.0, 0.0]), np.array([0.0, -1.0]), FLANK + 1e-3, 0.2, 0.0,
        )
        for x in places
    ]  # fmt: skip
    found = contacts(strips, table().astype(np.float32), LENGTH, 0.011)
    assert found.clear.all()
    assert found.width == pytest.approx(TOOL, abs=0.6e-3)
    np.testing.assert_allclose(rough + found.along, places, atol=0.3e-3)
