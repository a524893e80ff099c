"""The tags of a recording whose material remembers earlier frames, against dense algebra with every column written."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from onebend.learning.linear import RecordingNoise, ResidualRows, tag_information, tag_score
from onebend.learning.parameters import Layout
from onebend.learning.prediction import Slopes
from onebend.records import Array

FRAMES, NUMBERS, OTHERS, KNOTS = 7, 6, 4, 5
NOISE = RecordingNoise(0.7, 0.4)


def rows_of(keys: tuple[int, ...]) -> tuple[ResidualRows, Array]:
    """Rows of any numbers, with `keys` of the frames remembered, and (F, R, C) their derivatives, column by column."""
    rng = np.random.default_rng(3)
    axes = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    j = rng.standard_normal((FRAMES, NUMBERS, OTHERS + 2 * len(keys)))
    a, added = rng.standard_normal((2, FRAMES, NUMBERS, 2))
    weights, root = rng.standard_normal((FRAMES, KNOTS)), rng.uniform(0.5, 1.5, (FRAMES, NUMBERS))
    index = np.array(keys, dtype=np.int64)
    slopes = Slopes(j, a, axes, weights, added if keys else None, index) if keys else Slopes(j, a, axes, weights)
    lasting, columns = a + added if keys else a, [j[..., i] for i in range(OTHERS)]
    for knot in range(KNOTS):
        for axis in axes.T:
            column = -(lasting @ axis) * weights[:, knot, None]
            for n, key in enumerate(keys):
                column = column - (j[..., OTHERS + 2 * n : OTHERS + 2 * n + 2] @ axis) * weights[key, knot]
            columns.append(column)
    written = np.stack(columns, axis=-1)
    np.testing.assert_allclose(slopes.written, written, atol=1e-12)
    return ResidualRows(rng.standard_normal((FRAMES, NUMBERS)), slopes, np.ones_like(root), root), written


@pytest.mark.parametrize("keys", [(), (0, 2, 5)])
def test_what_tags_say_is_that_of_every_column_written(keys: tuple[int, ...]) -> None:
    rows, written = rows_of(keys)
    j, rng = rows.root_weight[..., None] * written, np.random.default_rng(4)
    x, v = rng.standard_normal((j.shape[-1],)), rng.standard_normal((FRAMES, NUMBERS, 3))
    np.testing.assert_allclose(rows.moved_by(x), j @ x)
    np.testing.assert_allclose(rows.onto_parameters(v), np.einsum("frn,frc->nc", v, j), atol=1e-12)
    s = NOISE.marker**2 * np.eye(NUMBERS) + NOISE.force**2 * rows.a @ np.swapaxes(rows.a, 1, 2)
    weighted = np.swapaxes(np.linalg.solve(s, j), 1, 2)  # (F, C, R)
    known_to = SimpleNamespace(known_to=lambda _: np.arange(len(x)))
    form, y = tag_information(rows, cast(Layout, known_to), 0, x, NOISE), rows.r + j @ x
    np.testing.assert_allclose(form.matrix, np.sum(weighted @ j, axis=0), atol=1e-10)
    np.testing.assert_allclose(form.vector, np.einsum("fcr,fr->c", weighted, y), atol=1e-10)
    np.testing.assert_allclose(tag_score(rows, rows.r, NOISE), np.einsum("fcr,fr->c", weighted, rows.r), atol=1e-10)
    assert form.constant == pytest.approx(float(np.sum(y * np.linalg.solve(s, y[..., None])[..., 0])))
