"""Profiles of a bar against textbook formulas, and profiles in pieces."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, strategies as st

from onebend.beam.section import rectangular_bar
from onebend.beam.stiffness import Pieces, Powers, Profile, Steps, Table, Uniform, in_pieces
from onebend.errors import MechanicsError

S = np.linspace(0.0, 1.0, 41)
STEEL = {"modulus": 210e9, "density": 7850.0}
sizes = st.floats(0.1, 10.0)


@given(width=sizes, thickness=sizes)
def test_rectangle(width: float, thickness: float) -> None:
    bar = rectangular_bar(Uniform(width), Uniform(thickness), length=2.0, **STEEL)
    second = width * thickness**3 / 12.0
    np.testing.assert_allclose(bar.stiffness(S), 210e9 * second / 2.0, rtol=1e-12)
    np.testing.assert_allclose(bar.mass_per_length(S), 7850.0 * width * thickness, rtol=1e-12)
    np.testing.assert_allclose(bar.rotary_inertia(S), 7850.0 * second, rtol=1e-12)


def test_profiles_along_a_tapered_stepped_bar() -> None:
    width, thickness = Powers((0.02, -0.01)), Steps((0.0, 0.3, 1.0), (2e-3, 1e-3))
    found = rectangular_bar(width, thickness, length=0.5, **STEEL)
    np.testing.assert_allclose(found.stiffness(S), 210e9 * width(S) * thickness(S) ** 3 / 12.0 / 0.5, rtol=1e-11)
    np.testing.assert_allclose(found.mass_per_length(S), 7850.0 * width(S) * thickness(S), rtol=1e-12)
    assert found.stiffness.jumps == (0.3,)
    assert in_json(found.stiffness) == found.stiffness


def test_knots_of_a_table_are_resolved_but_are_no_jumps() -> None:
    width: Profile = Table((0.0, 0.21, 0.47, 1.0), (0.02, 0.01, 0.03, 0.02))
    found = rectangular_bar(width, Uniform(1e-3), length=1.0, **STEEL)
    np.testing.assert_allclose(found.stiffness(S), 210e9 * width(S) * 1e-9 / 12.0, rtol=1e-11)
    assert found.stiffness.jumps == ()


def in_json(profile: Pieces) -> Pieces:
    data = json.loads(json.dumps(profile.as_dict()))
    assert data.pop("kind") == "pieces"
    edges, coefficients, jumps = (tuple(data[key]) for key in ("edges", "coefficients", "jumps"))
    return Pieces(edges, data["degree"], coefficients, jumps)


def test_pieces_hold_a_function_to_rounding_and_its_jumps() -> None:
    def function(s: np.ndarray) -> np.ndarray:
        return np.where(s < 0.37, np.exp(3.0 * s), np.cos(40.0 * s))

    found = in_pieces(function, jumps=(0.37,))
    np.testing.assert_allclose(found(S), function(S), atol=1e-10)
    assert found.jumps == (0.37,)
    assert in_json(found) == found
    assert found(0.25) == pytest.approx(np.exp(0.75), rel=1e-13)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rectangular_bar(Uniform(0.0), Uniform(1.0), length=1.0, **STEEL), "positive, got 0 m at s = 0"),
        (lambda: rectangular_bar(Uniform(1.0), Uniform(1.0), length=0.0, **STEEL), "length"),
        (lambda: in_pieces(lambda s: np.sign(s - 0.3)), "jumps near s = 0.29"),
        (lambda: in_pieces(lambda s: np.where(s < 0.3, np.nan, s)), "finite"),
        (lambda: Pieces((0.0, 0.5), 0, (1.0,)), "from 0 to 1"),
        (lambda: Pieces((0.0, 1.0), 1, (1.0,)), "need 2 coefficients"),
        (lambda: Pieces((0.0, 1.0), 0, (1.0,), (0.5,)), "inner edges"),
    ],
)
def test_what_is_no_section_is_refused(make: object, words: str) -> None:
    assert callable(make)
    with pytest.raises(MechanicsError, match=words):
        make()
