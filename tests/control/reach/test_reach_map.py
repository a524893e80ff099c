"""The map of the reachable set, and what is dragged over it, against `reach` and against known loads."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Uniform
from onebend.control.loaded_beam import LoadedState, PushedBeam
from onebend.control.reach import ReachSettings, reach
from onebend.control.reach_set import DragAnswer, DraggedPoint, HeldEnd, ReachMap, reach_map, stability_margin
from onebend.errors import ControlError
from onebend.records import Array
from tests.made_up import BEAM

MOST = 1.2  # N


@cache
def pushed() -> PushedBeam:
    return PushedBeam(BEAM, 1.0, 1.0)


@cache
def whole_map() -> ReachMap:
    return reach_map(pushed(), MOST)


def dragged() -> DraggedPoint:
    one = DraggedPoint(pushed(), MOST)
    one.map = whole_map()
    return one


def away(answer: DragAnswer) -> float:
    """m, of the point from its goal."""
    return float(np.hypot(*(answer.pose[:2] - answer.goal[:2])))


def goals(count: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return rng.uniform([-0.1, -0.15], [0.16, 0.15], (count, 2))


def test_every_vertex_that_a_triangle_has_is_a_stable_equilibrium() -> None:
    found = whole_map()
    for i in np.unique(found.triangles)[::40]:
        state = LoadedState(found.q[i], np.append(found.force[i], 0.0))
        unbalanced, _, _, _ = pushed().balance(state.q, state.load)
        assert np.max(np.abs(unbalanced)) < 1e-6 * float(np.max(pushed().stiff))
        assert pushed().stable(state)
        assert np.allclose(pushed().pose(state.q)[:2], found.points[i], atol=1e-9)


def test_a_goal_of_a_known_force_gives_that_force_back() -> None:
    for turn in np.linspace(0.2, 2.0 * np.pi, 11, endpoint=False):  # along a straight beam a force does nothing
        force = 0.3 * np.array([math.cos(turn), math.sin(turn)])
        goal = BEAM.equilibrium(force).xy(1.0)
        answer = dragged().to(goal)
        assert answer.limit is None, turn
        assert away(answer) < 1e-8
        assert np.allclose(answer.state.load[:2], force, atol=2e-4 * MOST)


@pytest.mark.slow
def test_what_is_out_of_reach_is_answered_as_near_as_reach_finds() -> None:
    one, settings = dragged(), ReachSettings(max_force=MOST)
    for goal in goals(6, 1):
        answer, found = one.to(goal), reach(BEAM, goal, settings=settings)
        assert (answer.limit is None) == found.converged
        nearest = 0.0 if found.nearest is None else found.nearest.distance
        assert away(answer) < 1.05 * nearest + 5e-4
        assert np.hypot(*answer.state.load[:2]) <= MOST * (1.0 + 1e-6)
        assert answer.margin > 0.0


def test_a_refusal_starts_no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    one = dragged()
    solved: list[int] = []
    balance = PushedBeam.balance

    def counted(self: PushedBeam, q: Array, load: Array) -> tuple[Array, Array, Array, Array]:
        solved.append(1)
        return balance(self, q, load)

    monkeypatch.setattr(PushedBeam, "balance", counted)
    for goal in goals(30, 2):
        solved.clear()
        one.to(goal)
        assert len(solved) < 250


def test_a_drag_from_side_to_side_stays_stable() -> None:
    one = dragged()
    for turn in np.linspace(-2.0, 2.0, 80):
        answer = one.to((0.13 * math.cos(turn), 0.13 * math.sin(turn)))
        assert answer.margin > 0.0
        assert pushed().stable(answer.state)


def test_without_a_map_it_goes_as_far_as_newton_does() -> None:
    one = DraggedPoint(pushed(), MOST)
    one.under((0.0, 0.05))  # what is straight tells nothing of the force along it
    x, y = BEAM.equilibrium((0.0, 0.1)).xy(1.0)
    assert one.to((x, y)).limit is None
    there = one.to((0.3, 0.3))
    assert there.limit == "force"
    assert np.hypot(*there.state.load[:2]) <= MOST * (1.0 + 1e-6)


def test_the_margin_is_one_at_rest_and_falls_to_nothing_where_euler_says() -> None:
    beam = Beam(0.2, Uniform(0.03))
    column = PushedBeam(beam, 1.0, 1.0)
    assert stability_margin(column, column.start) == pytest.approx(1.0)
    critical = math.pi**2 / 4.0 * 0.03 / 0.2
    for share in (0.5, 0.999, 1.001):
        state = LoadedState(column.start.q, np.array([-share * critical, 0.0, 0.0]))
        assert stability_margin(column, state) == pytest.approx(1.0 - share, abs=2e-4)


def test_a_held_column_bears_more_than_a_free_one() -> None:
    """Clamped at both ends it buckles at 16 times the load of a free end (Euler): at 4 pi^2 k / L."""
    beam = Beam(0.2, Uniform(0.03))
    column = PushedBeam(beam, 1.0, 1.0)
    for share in (0.9, 1.1):
        load = -share * 4.0 * math.pi**2 * 0.03 / 0.2
        margin = stability_margin(column, LoadedState(column.start.q, np.array([load, 0.0, 0.0])), held=True)
        assert (margin > 0.0) == (share < 1.0)


def held(most: float = 5.0) -> HeldEnd:
    start = dragged()
    start.under((0.0, 0.2))
    return HeldEnd(pushed(), start.state, most)


def test_a_hand_holds_place_and_angle() -> None:
    hand = held(50.0)
    pose = pushed().pose(hand.state.q)
    answer = hand.to(pose + np.array([-0.004, -0.002, 0.15]))
    assert answer.limit is None
    assert np.allclose(answer.pose, pose + np.array([-0.004, -0.002, 0.15]), atol=1e-8)
    unbalanced, _, _, _ = pushed().balance(answer.state.q, answer.state.load)
    assert np.max(np.abs(unbalanced)) < 1e-7
    assert abs(answer.state.load[2]) > 1e-4


def test_a_hand_that_asks_too_much_stops_where_it_is_stable() -> None:
    hand = held()
    answer = hand.to((0.3, 0.1, 0.0))
    assert answer.limit is not None
    assert answer.margin > 0.0
    assert np.hypot(*answer.state.load[:2]) <= 5.0 * (1.0 + 1e-6)


def test_the_hands_edge_lies_around_it_and_is_reached() -> None:
    hand = held()
    here = pushed().pose(hand.state.q)
    before = hand.state
    ends = hand.edge(directions=8)
    assert hand.state is before
    assert len(ends) == 8
    for end, _ in ends[::3]:
        again = HeldEnd(pushed(), before, 5.0)
        for share in np.linspace(0.1, 1.0, 10):
            answer = again.to(np.append(here[:2] + share * (end - here[:2]), here[2]))
        assert away(answer) < 1e-6


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.inf, math.nan])
def test_a_bound_without_meaning_is_refused(wrong: float) -> None:
    with pytest.raises(ControlError, match="largest force"):
        reach_map(pushed(), wrong)


def test_goals_and_forces_without_meaning_are_refused() -> None:
    with pytest.raises(ControlError, match="goal"):
        dragged().to((math.nan, 0.0))
    with pytest.raises(ControlError, match="force"):
        dragged().under((math.nan, 0.0))
    with pytest.raises(ControlError, match="angle"):
        held().to((0.1, 0.1))
    with pytest.raises(ControlError, match="end"):
        HeldEnd(PushedBeam(BEAM, 0.5, 0.5), pushed().start, 1.0)
