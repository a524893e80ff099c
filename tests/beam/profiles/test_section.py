"""Cross-sections against textbook formulas, and profiles in pieces."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, strategies as st

from onebend.beam.section import (
    Circle,
    LaminateLayer,
    Material,
    Polygon,
    Rectangle,
    SectionPart,
    SectionProperties,
    Tube,
    along,
    laminate,
    polygon_moments,
    section,
)
from onebend.beam.stiffness import Pieces, Profile, Scaled, Steps, Table, Uniform, broken_line, in_pieces, taper
from onebend.errors import MechanicsError

S = np.linspace(0.0, 1.0, 41)
STEEL, BRASS = Material(210e9, 7850.0), Material(105e9, 8500.0)
ONE = np.array([0.5])
sizes = st.floats(0.1, 10.0)


def at(*parts: SectionPart) -> SectionProperties:
    return section(parts, ONE)


def ring(corners: int, turn: float) -> tuple[tuple[float, float], ...]:
    angle = turn + 2.0 * np.pi * np.arange(corners) / corners
    return tuple(zip(np.cos(angle).tolist(), np.sin(angle).tolist(), strict=True))


@given(turn=st.floats(0.0, 6.0))
def test_hexagon_is_as_stiff_in_every_direction(turn: float) -> None:
    """I = 5 sqrt(3) / 144 d^4 with d across the flats; side 1 has d = sqrt(3)."""
    area, centroid, second = polygon_moments(ring(6, turn))
    assert area == pytest.approx(1.5 * np.sqrt(3.0), rel=1e-13)
    assert centroid == pytest.approx(0.0, abs=1e-14)
    assert second == pytest.approx(5.0 * np.sqrt(3.0) / 144.0 * 9.0, rel=1e-13)


@given(base=sizes, height=sizes, lean=st.floats(-5.0, 5.0), far=st.floats(-100.0, 100.0))
def test_triangle(base: float, height: float, lean: float, far: float) -> None:
    """I = b h^3 / 36 about the centroid at a third of the height, wherever it stands and however it leans."""
    area, centroid, second = polygon_moments(((far, 0.0), (far, base), (far + height, lean)))
    assert area == pytest.approx(0.5 * base * height, rel=1e-9)
    assert centroid == pytest.approx(far + height / 3.0, rel=1e-9)
    assert second == pytest.approx(base * height**3 / 36.0, rel=1e-9)


def test_order_of_corners_does_not_matter() -> None:
    corners = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 0.5), (0.0, 1.0))
    np.testing.assert_allclose(polygon_moments(corners), polygon_moments(corners[::-1]), rtol=1e-14)


@given(width=sizes, thickness=sizes)
def test_rectangle_as_a_polygon(width: float, thickness: float) -> None:
    square = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    w, t = Uniform(width), Uniform(thickness)
    rectangle, polygon = at(SectionPart(Rectangle(w, t), STEEL)), at(SectionPart(Polygon(square, w, t), STEEL))
    assert rectangle.bending[0] == pytest.approx(210e9 * width * thickness**3 / 12.0, rel=1e-13)
    assert polygon.bending[0] == pytest.approx(rectangle.bending[0], rel=1e-13)
    assert polygon.mass[0] == pytest.approx(7850.0 * width * thickness, rel=1e-13)
    assert rectangle.rotary[0] == pytest.approx(7850.0 / 210e9 * rectangle.bending[0], rel=1e-13)


def test_many_corners_become_a_circle_at_second_order() -> None:
    exact = at(SectionPart(Circle(Uniform(2.0)), STEEL)).bending[0]
    counts = np.array([20, 40, 80])
    errors = [1.0 - at(SectionPart(Polygon(ring(int(n), 0.1)), STEEL)).bending[0] / exact for n in counts]
    assert np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(-2.0, abs=0.02)


@given(outer=sizes, share=st.floats(0.0, 0.99))
def test_tube_is_a_circle_less_a_circle(outer: float, share: float) -> None:
    tube = at(SectionPart(Tube(Uniform(outer), Uniform(share * outer)), STEEL))
    assert tube.bending[0] == pytest.approx(210e9 * np.pi / 64.0 * (outer**4 - (share * outer) ** 4), rel=1e-12)
    assert tube.mass[0] == pytest.approx(7850.0 * np.pi / 4.0 * (outer**2 - (share * outer) ** 2), rel=1e-12)


def test_wood_with_a_steel_plate() -> None:
    """Transformed section by hand: wood 100 x 150 mm (E = 10 GPa) on a steel plate 100 x 10 mm (200 GPa), n = 20.

    Areas 15000 and 20 x 1000 mm^2, centres at 85 and 5 mm: axis at (15000 x 85 + 20000 x 5) / 35000 = 39.2857 mm;
    I = 100 x 150^3 / 12 + 15000 x 45.7143^2 + 20 x (100 x 10^3 / 12 + 1000 x 34.2857^2) mm^4.
    """
    width = Uniform(0.1)
    parts = laminate(
        (
            LaminateLayer(width, Uniform(0.01), Material(200e9, 7850.0)),
            LaminateLayer(width, Uniform(0.15), Material(10e9, 500.0)),
        )
    )
    found = at(*parts)
    axis = 275.0 / 7.0
    second = 100 * 150**3 / 12 + 15000 * (85 - axis) ** 2 + 20 * (100 * 10**3 / 12 + 1000 * (axis - 5) ** 2)
    assert found.neutral_axis[0] == pytest.approx(1e-3 * axis, rel=1e-13)
    assert found.bending[0] == pytest.approx(10e9 * 1e-12 * second, rel=1e-13)
    assert found.mass[0] == pytest.approx(7850 * 1e-3 + 500 * 15e-3, rel=1e-13)


@given(m=st.floats(0.1, 10.0), n=st.floats(0.1, 10.0))
def test_bimetal_strip_curls_as_timoshenko_says(m: float, n: float) -> None:
    """1/R = 6 de (1 + m)^2 / (h (3 (1 + m)^2 + (1 + m n)(m^2 + 1 / (m n)))), m = t1 / t2, n = E1 / E2 (1925).

    The layer that lengthens is below: the strip bends up, to its left.
    """
    h, strain, width = 2e-3, 1e-3, Uniform(0.01)
    t1, t2 = h * m / (1.0 + m), h / (1.0 + m)
    low, high = Material(n * 1e11, 8000.0, strain), Material(1e11, 8000.0)
    found = at(*laminate((LaminateLayer(width, Uniform(t1), low), LaminateLayer(width, Uniform(t2), high))))
    exact = 6.0 * strain * (1.0 + m) ** 2 / (h * (3.0 * (1.0 + m) ** 2 + (1.0 + m * n) * (m**2 + 1.0 / (m * n))))
    assert found.curvature[0] == pytest.approx(exact, rel=1e-10)


def test_cutting_a_bar_into_layers_changes_nothing() -> None:
    width, quarter = taper(0.02, 0.01), Scaled(0.25, taper(0.004, 0.002))
    whole = section((SectionPart(Rectangle(width, taper(0.004, 0.002)), STEEL),), S)
    cut = section(laminate((LaminateLayer(width, quarter, STEEL),) * 4), S)
    np.testing.assert_allclose(cut.bending, whole.bending, rtol=1e-13)
    np.testing.assert_allclose(cut.rotary, whole.rotary, rtol=1e-13)
    np.testing.assert_allclose(cut.curvature, 0.0, atol=1e-15)
    np.testing.assert_allclose(cut.mass_offset, 0.0, atol=1e-15)
    np.testing.assert_allclose(cut.neutral_axis, 0.5 * taper(0.004, 0.002)(S), rtol=1e-13)


def test_heavy_side_shows_as_an_offset_of_mass() -> None:
    width, t = Uniform(0.01), Uniform(1e-3)
    found = at(
        *laminate((LaminateLayer(width, t, Material(1e9, 1000.0)), LaminateLayer(width, t, Material(1e9, 3000.0))))
    )
    assert found.mass_offset[0] == pytest.approx(0.5 * 0.5e-3, rel=1e-13)


def test_profiles_along_a_tapered_layered_beam() -> None:
    thickness: Profile = Steps((0.0, 0.3, 1.0), (2e-3, 1e-3))
    parts = laminate(
        (LaminateLayer(taper(0.02, 0.01), thickness, STEEL), LaminateLayer(Uniform(0.01), Uniform(1e-3), BRASS))
    )
    found, exact = along(parts, 0.5), section(parts, S)
    np.testing.assert_allclose(found.stiffness(S), exact.bending / 0.5, rtol=1e-11)
    np.testing.assert_allclose(found.mass_per_length(S), exact.mass, rtol=1e-12)
    np.testing.assert_allclose(found.rotary_inertia(S), exact.rotary, rtol=1e-11)
    np.testing.assert_allclose(found.rest_curvature(S), 0.0, atol=1e-15)
    assert found.stiffness.jumps == (0.3,)
    assert in_json(found.stiffness) == found.stiffness


def test_knots_of_a_table_are_resolved_but_are_no_jumps() -> None:
    width = Table((0.0, 0.21, 0.47, 1.0), (0.02, 0.01, 0.03, 0.02))
    parts = (SectionPart(Rectangle(width, Uniform(1e-3)), STEEL),)
    found = along(parts, 1.0)
    np.testing.assert_allclose(found.stiffness(S), section(parts, S).bending, rtol=1e-11)
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


def test_broken_line_with_a_kink_and_a_jump() -> None:
    line = broken_line((0.0, 0.25, 0.5, 0.5, 1.0), (1.0, 2.0, 2.0, 5.0, 4.0))
    np.testing.assert_allclose(line(np.array([0.125, 0.4, 0.5, 0.75, 1.0])), [1.5, 2.0, 5.0, 4.5, 4.0], atol=1e-14)
    assert line.jumps == (0.25, 0.5)
    np.testing.assert_allclose(taper(1.0, 3.0)(S), 1.0 + 2.0 * S, atol=1e-15)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: at(), "at least one part"),
        (lambda: at(SectionPart(Circle(Uniform(0.0)), STEEL)), "positive, got 0 m at s = 0.5"),
        (lambda: at(SectionPart(Tube(Uniform(1.0), Uniform(1.0)), STEEL)), "inner diameter"),
        (lambda: Polygon(((0.0, 0.0), (1.0, 1.0))), "three"),
        (lambda: Polygon(((0.0, 0.0), (1.0, 1.0), (2.0, 2.0))), "no area"),
        (lambda: Polygon(((0.0, 0.0), (2.0, 2.0), (2.0, 0.0), (0.0, 1.0))), "cross"),
        (lambda: Material(-1.0, 1.0), "E > 0"),
        (lambda: along((SectionPart(Circle(Uniform(1.0)), STEEL),), 0.0), "length"),
        (lambda: in_pieces(lambda s: np.sign(s - 0.3)), "jumps near s = 0.29"),
        (lambda: in_pieces(lambda s: np.where(s < 0.3, np.nan, s)), "finite"),
        (lambda: Pieces((0.0, 0.5), 0, (1.0,)), "from 0 to 1"),
        (lambda: Pieces((0.0, 1.0), 1, (1.0,)), "need 2 coefficients"),
        (lambda: Pieces((0.0, 1.0), 0, (1.0,), (0.5,)), "inner edges"),
        (lambda: broken_line((0.0, 1.0), (1.0,)), "one value a place"),
    ],
)
def test_what_is_no_section_is_refused(make: object, words: str) -> None:
    assert callable(make)
    with pytest.raises(MechanicsError, match=words):
        make()
