"""The discrepancy of every coordinate of every tag, against its functions written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.learning.allowances import angle_discrepancy, discrepancy
from tests.learning.allowances.allowed_bench import course

BEND = np.array([0.2, 0.6, 1.0, 0.8, 0.1, 0.0])  # nothing at rest, in the last frame
ELAPSED = np.append(np.cumsum(BEND[:5]) / 2.7, 0.0)
RUN = replace(course(5), bend=BEND, back=np.array([0.0, 0, 0, 1, 1, 0]), elapsed=ELAPSED)


def test_every_coordinate_of_every_tag_has_its_own_functions() -> None:
    side = RUN.back - 0.5
    functions = np.stack([BEND, BEND**2, BEND * side, BEND**2 * side, RUN.elapsed], axis=1)
    for allowance, axes in ((discrepancy(RUN), (0, 1)), (angle_discrepancy(RUN), (2,))):
        assert allowance is not None
        numbers = np.arange(1.0, allowance.count + 1.0)
        expected = np.zeros((6, 3, 3))
        for i, axis in enumerate(axes):
            for tag in range(3):
                first = 15 * i + 5 * tag
                expected[:, tag, axis] = functions @ numbers[first : first + 5]
        np.testing.assert_allclose(allowance.basis @ numbers, expected, rtol=1e-12, atol=1e-12)
