"""The evidence for the sizes of the force's error, all else integrated out first, against that of the whole model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.inference.hyperparameters import Known
from onebend.learning.inference.linear_gaussian import FilmNoise, Scales, quadratic, rest_quadratic, rows_of, together
from onebend.learning.model.fit_data import film
from onebend.learning.model.forward import predict
from onebend.learning.model.parameters import Priors, layout
from onebend.learning.model.spline import RHO, TAU, Spline
from tests.learning.bench import SOFT, forces, observed
from tests.made_up import with_source

LEVEL = float(np.log(0.02))


def known(count: int) -> tuple[Known, Scales]:
    """What `count` recordings of one beam say, whose force logs have errors of their own; 0: one without any force."""
    spline, strength = Spline(8), forces(12) * (count > 0)
    made = observed(SOFT, strength, noise=(2e-5, 1e-3))
    recordings = [
        with_source(replace(made, time=(1.0 + 0.2 * i) * made.time), name=str(i)) for i in range(max(count, 1))
    ]
    films = [film(o, i, np.ones(len(o.time), dtype=bool), spline) for i, o in enumerate(recordings)]
    at = layout(spline, recordings, [len(f.error.knots) for f in films], Priors())
    x = np.concatenate([LEVEL + 0.3 * np.cos(np.arange(8)), 1e-3 * np.sin(np.arange(at.size - 8))])
    noise = tuple(FilmNoise(1.3, 0.003 * (i + 1)) for i in range(len(films)))
    scales = Scales(spline.variances(TAU, RHO), 1.0, 1.0, 1.0, 1.0, noise)
    rows = [rows_of(predict(f, at, x, None), n) for f, n in zip(films, noise, strict=True)]
    said = [quadratic(r, at, f.number, x, n) for f, r, n in zip(films, rows, noise, strict=True)]
    return Known(together([*said, rest_quadratic(films, at)]), films, at, LEVEL, scales), scales


@pytest.mark.parametrize("count", [0, 1, 2])
def test_what_is_integrated_out_once_leaves_the_evidence_as_it_is(count: int) -> None:
    one, scales = known(count)
    assert sum(b.name == "force" and b.start >= 0 for b in one.at.blocks) == count
    cost = one.cost(scales)
    for z in np.random.default_rng(count).standard_normal((6, 4)):
        whole = 0.5 * float(z @ z) - one.solve(one.scaled(scales, z))[1]
        assert cost(z) == pytest.approx(whole, rel=1e-8, abs=1e-5)
