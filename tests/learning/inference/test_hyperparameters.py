"""The evidence for the sizes of the force's error, all else integrated out first, against that of the whole model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from onebend.learning.inference.fit_problem import FitProblem, Hyperparameters, RecordingNoise
from onebend.learning.inference.hyperparameters import Evidence
from onebend.learning.inference.linear_gaussian import data_information, residual_rows
from onebend.learning.model.fit_data import fit_data
from onebend.learning.model.forward import predict
from onebend.learning.model.parameters import Priors, make_layout
from onebend.learning.model.spline import RHO, TAU, Spline
from tests.learning.bench import SOFT, forces, observed
from tests.made_up import with_source

LEVEL = float(np.log(0.02))


def evidence_of(count: int) -> tuple[Evidence, Hyperparameters]:
    """The evidence of `count` recordings of one beam, whose force logs have errors of their own; 0: of one without any
    force."""
    spline, strength = Spline(8), forces(12) * (count > 0)
    made = observed(SOFT, strength, noise=(2e-5, 1e-3))
    stretched = [replace(made, time=(1.0 + 0.2 * i) * made.time) for i in range(max(count, 1))]
    observations = [with_source(o, name=str(i)) for i, o in enumerate(stretched)]
    data = tuple(fit_data(o, i, np.ones(len(o.time), dtype=bool), spline) for i, o in enumerate(observations))
    layout = make_layout(spline, observations, [len(d.error.knots) for d in data], Priors())
    x = np.concatenate([LEVEL + 0.3 * np.cos(np.arange(8)), 1e-3 * np.sin(np.arange(layout.size - 8))])
    noise = tuple(RecordingNoise(1.3, 0.003 * (i + 1)) for i in range(len(data)))
    expected = Hyperparameters(spline.variances(TAU, RHO), 1.0, 1.0, 1.0, 1.0, noise)
    problem = FitProblem(data, layout, LEVEL, expected)
    rows = [residual_rows(predict(d, layout, x, None), n) for d, n in zip(data, noise, strict=True)]
    return Evidence(problem, data_information(problem, rows, x, expected)), expected


@pytest.mark.parametrize("count", [0, 1, 2])
def test_what_is_integrated_out_once_leaves_the_evidence_as_it_is(count: int) -> None:
    evidence, expected = evidence_of(count)
    blocks = evidence.problem.layout.blocks
    assert sum(b.name == "force" and b.start >= 0 for b in blocks) == count
    cost = evidence.cost(expected)
    for z in np.random.default_rng(count).standard_normal((6, 4)):
        whole = 0.5 * float(z @ z) - evidence.posterior(evidence.hyperparameters_at(expected, z)).log_evidence
        assert cost(z) == pytest.approx(whole, rel=1e-8, abs=1e-5)
