"""Frames solved without steps of the load: against continuation by steps, and against all equilibria there are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from onebend.beam.continuation import ContinuationSettings, at_once, equilibrium, follow, on_one_side, stable_equilibria
from onebend.beam.loads import Loads, push, twist, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.statics import node_angles
from onebend.beam.stiffness import Gaussians, Steps, Table, Uniform
from onebend.records import Array

IN_STEPS = ContinuationSettings(at_once=False)
S = np.array([0.5, 1.0])
BEAMS = {
    "uniform": Beam(1.0, Uniform(1.0)),
    "dip": Beam(1.0, Gaussians((0.0, 0.5, 1.0), 0.2, (0.6, 0.1, 0.6))),
    "soft joint": Beam(1.0, Steps((0.0, 0.4, 0.42, 1.0), (1.0, 0.05, 1.0))),
    "curved": Beam(1.0, Uniform(1.0), rest_curvature=Uniform(0.6)),
    "turned and heavy": Beam(1.0, Uniform(1.0), clamp_angle=0.5, mass_per_length=Uniform(0.3)),
    "thick": Beam(1.0, Uniform(1.0), thickness=0.08),
}
SLOW = ("soft joint", "curved", "turned and heavy")
beams = pytest.mark.parametrize(
    "beam",
    [pytest.param(one, id=name, marks=pytest.mark.slow if name in SLOW else ()) for name, one in BEAMS.items()],
)


def drawn(seed: int, count: int, largest: float = 30.0) -> Array:
    """Forces in all directions, some along the beam but for a millionth, in any order."""
    rng = np.random.default_rng(seed)
    size, angle = largest * rng.uniform(0.0, 1.0, count) ** 2, rng.uniform(-np.pi, np.pi, count)
    angle[::7] = np.pi - 10.0 ** rng.uniform(-6.0, -1.0, len(angle[::7]))
    return np.stack([size * np.cos(angle), size * np.sin(angle)], axis=1)


def loaded(beam: Beam, force: Array) -> Loads:
    return push(force) + weight((0.0, -9.81)) if np.any(beam.mass_per_length(S)) else push(force)


@beams
def test_they_are_where_steps_of_the_load_lead(beam: Beam) -> None:
    problem = make_problem(beam, loaded(beam, drawn(1, 120)), Resolution(16, 0.3))
    frames, q, _ = at_once(problem, 1e-13, 8)
    slow = follow(problem.take(frames), settings=IN_STEPS)
    assert len(frames) > 40
    assert np.all(slow.stable)
    assert np.all(np.isnan(slow.buckled_at))
    np.testing.assert_allclose(node_angles(problem.take(frames), q), node_angles(slow.problem, slow.q), atol=1e-9)
    together, stepped = follow(problem), follow(problem, settings=IN_STEPS)
    np.testing.assert_array_equal(together.converged, stepped.converged)
    np.testing.assert_array_equal(together.stable, stepped.stable)


@beams
def test_of_all_stable_equilibria_one_is_between_rest_and_the_forces(beam: Beam) -> None:
    problem = make_problem(beam, loaded(beam, drawn(2, 30)), Resolution(16, 0.3))
    chosen, phi, _ = on_one_side(problem)
    reached, q, _ = at_once(problem, 1e-13, 8)
    every, frame = stable_equilibria(problem)
    for i, angles in zip(chosen, phi, strict=True):
        turned = np.sign(angles[0]) * (every[frame == i] - problem.q0) @ problem.to_nodes.T
        inside = np.all((turned > -1e-9) & (turned < np.max(np.abs(angles)) + 1e-9), axis=1)
        assert np.sum(inside) == 1
        if i in reached:
            np.testing.assert_allclose(q[reached == i], every[frame == i][inside], atol=1e-8)


@pytest.mark.parametrize(
    "loads",
    [
        push((0.0, 1.0)) + twist(0.1, 0.5),
        push((0.0, 1.0)) + push((0.0, -2.0), 0.5),
        push((-3.0, 0.0)),
        push((-3.0, 1e-12)),
        push((3.0 * np.cos(np.pi), 3.0 * np.sin(np.pi))),
        Loads(),
    ],
    ids=["moment", "two sides", "axial", "axial but for rounding", "axial by its angle", "nothing"],
)
def test_of_other_loads_nothing_is_said(loads: Loads) -> None:
    assert on_one_side(make_problem(BEAMS["uniform"], loads))[0].size == 0


def test_a_beam_that_may_snap_through_is_left_to_steps() -> None:
    """Its rest shape winds so far that the force points to both of its sides."""
    problem = make_problem(Beam(1.0, Uniform(1.0), rest_curvature=Uniform(4.0)), push((5.49, -2.88)))
    assert on_one_side(problem)[0].size == 0


@given(phi=st.floats(1e-3, np.pi), share=st.floats(0.0, 1.0), eps=st.floats(-0.2, 0.2), d=st.floats(0.0, 1.5))
def test_the_load_falls_beside_the_angle(phi: float, share: float, eps: float, d: float) -> None:
    """f / gamma falls with gamma up to phi; and up to phi + d, where the bound says so."""

    def rise(gamma: float) -> float:  # gamma^2 times minus the derivative of f / gamma
        psi = phi - gamma
        return float(gamma * (np.cos(psi) + eps * np.cos(2.0 * psi)) + np.sin(psi) * (1.0 + eps * np.cos(psi)))

    assert rise(share * phi) > -1e-15
    if (phi + d) * (np.cos(d) - abs(eps)) > np.sin(d) * (1.0 + abs(eps)):
        assert rise(phi + share * d) > 0.0


stiffnesses = st.one_of(
    st.lists(st.floats(0.2, 2.0), min_size=3, max_size=3).map(lambda h: Gaussians((0.0, 0.5, 1.0), 0.3, tuple(h))),
    st.floats(0.1, 2.0).map(lambda dip: Steps((0.0, 0.4, 0.6, 1.0), (1.0, dip, 1.0))),
    st.lists(st.floats(0.5, 2.0), min_size=4, max_size=4).map(lambda k: Table((0.0, 0.3, 0.7, 1.0), tuple(k))),
)


@settings(max_examples=15, deadline=None)
@given(
    stiffness=stiffnesses,
    rest=st.floats(-0.8, 0.8),
    mass=st.sampled_from([0.0, 0.1]),
    seed=st.integers(0, 2**16),
    largest=st.floats(0.5, 20.0),
)
def test_a_batch_in_any_order_is_its_frames_one_by_one(
    stiffness: Steps, rest: float, mass: float, seed: int, largest: float
) -> None:
    """Of forces up to where the branch from rest ends, and beyond."""
    beam = Beam(1.0, stiffness, rest_curvature=Uniform(rest), mass_per_length=Uniform(mass))
    loads, order = loaded(beam, drawn(seed, 12, largest)), np.random.default_rng(seed).permutation(12)
    together, mixed = equilibrium(beam, loads), equilibrium(beam, loads.take(order))
    assert together.problem.grid.edges.tolist() == mixed.problem.grid.edges.tolist()
    np.testing.assert_array_equal(together.stable[order], mixed.stable)
    np.testing.assert_array_equal(together.converged[order], mixed.converged)
    good = together.stable & np.isnan(together.buckled_at)
    np.testing.assert_allclose(together.q[order][good[order]], mixed.q[good[order]], atol=1e-9)
    for i in np.flatnonzero(good):
        alone = equilibrium(beam, loads.take(slice(i, i + 1)))
        np.testing.assert_allclose(together.xy(S)[i], alone.xy(S)[0], atol=1e-7)


def test_a_fine_grid_begins_where_a_coarse_one_ended() -> None:
    """Forces at which the tip turns by up to 90 degrees: as by steps on the same fine grid."""
    beam = Beam(0.15, Gaussians((0.0, 0.5, 1.0), 0.5, (0.02, 0.03, 0.015)))
    size, angle = np.linspace(0.01, 3.5, 200), 1.57 + 0.1 * np.sin(np.arange(200))
    loads = push(np.stack([size * np.cos(angle), size * np.sin(angle)], axis=1))
    solved = equilibrium(beam, loads)
    assert solved.problem.grid.edges.size > 2
    assert np.max(solved.angle(S)) > 1.5
    slow = follow(solved.problem, settings=IN_STEPS)
    np.testing.assert_allclose(solved.angle(S), slow.angle(S), atol=1e-11)
