"""Stage tables of collocation."""

from __future__ import annotations

import numpy as np
import pytest

from onebend.beam.integration import Method, tableau


@pytest.mark.parametrize("family", ["gauss", "radau"])
@pytest.mark.parametrize("stages", [1, 2, 3, 6])
def test_stages_integrate_polynomials_exactly(stages: int, family: str) -> None:
    numbers, power = tableau(Method(stages, family)), np.arange(1, stages + 1)  # type: ignore[arg-type]
    values = numbers.c[:, None] ** (power - 1)
    np.testing.assert_allclose(numbers.a @ values, numbers.c[:, None] ** power / power, atol=1e-13)
    np.testing.assert_allclose(numbers.b @ values, 1.0 / power, atol=1e-13)
