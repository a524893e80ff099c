"""The discrepancy of every coordinate of every tag, against its functions written out."""

from __future__ import annotations

import numpy as np

from onebend.learning.allowances import PushCourse, discrepancy

BEND = np.array([0.2, 0.6, 1.0, 0.8, 0.1])
RUN = PushCourse(np.arange(5.0), BEND, np.array([0.0, 0, 0, 1, 1]), np.cumsum(BEND) / 2.7, np.zeros((5, 3)), 0.0)


def test_every_coordinate_of_every_tag_has_its_own_functions() -> None:
    side = RUN.back - 0.5
    functions = np.zeros((6, 5))  # nothing at rest, in the last frame
    functions[:5] = np.stack([BEND, BEND**2, BEND * side, BEND**2 * side, RUN.elapsed], axis=1)
    places, angles = discrepancy(RUN, ("tag 1", "tag 2", "tag 3"), 0.15, 6)
    for allowance, axes in ((places, (0, 1)), (angles, (2,))):
        numbers = np.arange(1.0, allowance.count + 1.0)
        expected = np.zeros((6, 3, 3))
        for i, axis in enumerate(axes):
            for tag in range(3):
                first = 15 * i + 5 * tag
                expected[:, tag, axis] = functions @ numbers[first : first + 5]
        np.testing.assert_allclose(allowance.basis @ numbers, expected, rtol=1e-12, atol=1e-12)
