"""A beam led through settings of its loads: the way of an independent chain, falls and return included."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from onebend.beam.branches import turn_into, turned_loads
from onebend.beam.continuation import follow
from onebend.beam.statics import node_angles, potential
from onebend.records import Array, IntArray
from tests.beam.statics.test_shooting import CABLE, on_base
from tests.beam.turned_chain import Chain

ANGLES = np.array([0.0, 40.0, 60.0, 75.0, 90.0, 105.0, 109.0, 120.0, 150.0, 165.0])


@cache
def chained() -> tuple[Array, Array]:
    """(N,) rad: the tip's angle to the base on the way up and on the way back, of the chain."""
    chain, base = Chain(CABLE, 800), np.radians(ANGLES)
    up = chain.turned(ANGLES.tolist())
    back = chain.turned(ANGLES[::-1].tolist(), up[-1])[::-1]
    return up[:, -1] - base, back[:, -1] - base


@cache
def led() -> tuple[Array, Array, IntArray, IntArray]:
    """(N, Q) shapes on the way up and back, and how often each fell."""
    problem = on_base(ANGLES)
    turned = np.radians(ANGLES)
    up, well, falls = turn_into(problem, follow(turned_loads(problem, turned)).q, turned)
    back, well_back, falls_back = turn_into(problem, np.repeat(up[-1:], len(up), 0), np.radians(ANGLES - ANGLES[-1]))
    assert well.all()
    assert well_back.all()
    return up, back, falls, falls_back


def test_the_way_up_and_back_is_the_chains() -> None:
    up, back, falls, falls_back = led()
    weights = on_base(ANGLES).weights
    np.testing.assert_allclose(up @ weights, chained()[0], atol=2e-6)
    np.testing.assert_allclose(back @ weights, chained()[1], atol=2e-6)
    assert falls.tolist() == [0, 0, 0, 0, 0, 0, 0, 1, 1, 1]
    assert falls_back.tolist() == [1, 1, 1, 0, 0, 0, 0, 0, 0, 0]


def test_both_ways_agree_but_where_there_are_two_equilibria() -> None:
    up, back, _, _ = led()
    apart = np.max(np.abs(up - back), axis=1)
    two = (ANGLES > 70.0) & (ANGLES < 110.0)
    assert np.all(apart[two] > 1.0)
    assert np.all(apart[~two] < 1e-7)


def test_a_small_turn_changes_the_shape_a_little_and_a_fall_lowers_the_energy() -> None:
    fine = np.arange(100.0, 114.0, 0.5)
    problem, turned = on_base(fine), np.radians(fine)
    q, _, falls = turn_into(problem, follow(turned_loads(problem, turned)).q, turned)
    step = np.max(np.abs(np.diff(node_angles(problem, q), axis=0)), axis=1)
    fell = int(np.argmax(falls > 0))
    assert 0 < fell < len(fine)
    assert np.all(np.delete(step, fell - 1) < 0.3)
    assert step[fell - 1] > 1.0
    last = np.repeat(q[fell - 1 : fell], len(fine), 0)  # as it was just before
    assert potential(problem, q)[fell] < potential(problem, last)[fell]


def test_where_nothing_turns_nothing_moves() -> None:
    problem = on_base(np.array([30.0]))
    q = follow(problem).q
    there, well, falls = turn_into(problem, q, np.zeros(1))
    assert well.all()
    assert falls.tolist() == [0]
    assert np.max(np.abs(there - q)) == pytest.approx(0.0, abs=1e-10)
