"""Integration on Gauss panels against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from onebend.beam.grid import Grid, make_grid
from onebend.errors import MechanicsError

PLACES = np.array([0.0, 0.1, 0.25, 0.5, 0.61, 0.999, 1.0])


@given(degree=st.integers(0, 15), cut=st.floats(0.05, 0.95))
def test_polynomials_are_integrated_exactly_to_any_place(degree: int, cut: float) -> None:
    grid = make_grid((cut,), order=16)
    found = grid.integral_to(PLACES) @ grid.nodes**degree
    np.testing.assert_allclose(found, PLACES ** (degree + 1) / (degree + 1), atol=1e-14)


def test_a_jump_at_an_edge_is_integrated_exactly() -> None:
    grid = make_grid((0.3,), order=4)
    step = np.where(grid.nodes < 0.3, 2.0, -1.0)
    np.testing.assert_allclose(
        grid.integral_to(PLACES) @ step, np.minimum(PLACES, 0.3) * 2.0 - np.maximum(PLACES - 0.3, 0.0), atol=1e-14
    )


def test_weights_sum_to_the_length_of_the_beam() -> None:
    assert make_grid((0.2, 0.7), order=5, widest=0.1).weights.sum() == pytest.approx(1.0, abs=1e-15)


def test_batched_edges_agree_with_single_grids() -> None:
    edges = np.array([[0.0, 0.3, 1.0], [0.0, 0.8, 1.0]])
    batch = Grid(edges, 6)
    for i in range(2):
        single = Grid(edges[i], 6)
        np.testing.assert_allclose(batch.integral_to_nodes[i], single.integral_to_nodes, atol=1e-15)
        np.testing.assert_allclose(batch.integral_to(PLACES)[i], single.integral_to(PLACES), atol=1e-15)
        np.testing.assert_allclose(batch.value_at(PLACES)[i], single.value_at(PLACES), atol=1e-15)


def test_legendre_tail_tells_resolved_from_unresolved() -> None:
    grid = make_grid(order=12)
    assert grid.legendre_tail(grid.nodes**3) < 1e-14
    assert grid.legendre_tail(np.abs(grid.nodes - 0.4)) > 1e-3


def test_panels_are_no_wider_than_asked_and_end_at_every_break() -> None:
    grid = make_grid((0.15, 0.15, 1.0, 0.0), widest=0.3)
    assert np.max(np.diff(grid.edges)) <= 0.3 + 1e-12
    assert 0.15 in grid.edges
    assert grid.edges[[0, -1]].tolist() == [0.0, 1.0]


@pytest.mark.parametrize("edges", [[0.0, 0.5], [0.1, 1.0], [0.0, 0.6, 0.4, 1.0]])
def test_edges_that_are_not_a_beam_are_refused(edges: list[float]) -> None:
    with pytest.raises(MechanicsError, match="from 0 to 1"):
        Grid(np.array(edges), 4)
