"""The fit's derivatives of the tags with all allowances at work, against central differences."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.learning.allowances import OF_ONE
from onebend.learning.prediction import predict
from tests.learning.allowances.allowed_bench import with_everything

_STEP = 1e-3  # of a prior sd


def worst(share: float) -> dict[str, float]:
    """By block: the largest difference of a derivative from the central difference, over the largest of these."""
    one, layout, x = with_everything(share=share)
    first = predict(one, layout, x, None)
    now = predict(one, layout, x, first.solved.q)
    assert np.all(now.solved.converged)
    jacobian, mine, out = now.slopes.written, layout.known_to(0).tolist(), {}
    for block in layout.blocks:
        if block.start < 0:
            continue
        off = []
        for i, sd in enumerate(block.prior_sd):
            step = np.zeros(len(x))
            step[block.start + i] = h = _STEP * (0.01 if block.name == "force" else float(sd))
            up, down = (predict(one, layout, x + sign * step, now.solved.q).pose for sign in (1.0, -1.0))
            numeric = (up - down) / (2.0 * h)
            size = max(float(np.max(np.abs(numeric))), 1e-12)
            off.append(float(np.max(np.abs(numeric - jacobian[..., mine.index(block.start + i)]))) / size)
        out[block.name] = max(off)
    return out


def test_of_a_beam_that_does_not_relax() -> None:
    found = worst(share=0.0)
    assert set(found) >= OF_ONE - {
        "gravity direction",
        "outline",
        "outline height",
        "light",
    }  # nothing weighs or is traced here
    assert {name: off for name, off in found.items() if not off < 1e-6} == {}


def test_of_a_beam_that_relaxes() -> None:
    """A clamp that gives turns the beam by another angle in each frame: its memory is that of a steady turn."""
    found = worst(share=0.06)
    assert found.pop("clamp gives") < 0.02
    assert found.pop("force") < 0.03  # in the first frame the force has acted for long
    assert {name: off for name, off in found.items() if not off < 1e-3} == {}


@pytest.mark.parametrize("share", [0.0, 1e-3])
def test_of_the_share_that_relaxes(share: float) -> None:
    one, layout, x = with_everything(share=share)
    now = predict(one, layout, x, predict(one, layout, x, None).solved.q)
    at, h = layout.index["relaxation", -1].start + 1, 1e-3
    step = h * (np.arange(len(x)) == at)
    up, down = (predict(one, layout, x + sign * step, now.solved.q).pose for sign in (1.0, -1.0))
    numeric = (up - down) / (2.0 * h)
    column = now.slopes.written[..., layout.known_to(0).tolist().index(at)]
    np.testing.assert_allclose(column, numeric, atol=1e-3 * float(np.max(np.abs(numeric))))
