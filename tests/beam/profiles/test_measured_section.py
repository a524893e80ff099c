"""A section as measured: its second moment against the figures themselves, its errors against differences."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.section import (
    mean_moment,
    moment_errors,
    one_modulus,
    relative_moment,
    second_moment,
    section_as_dict,
    section_from_dict,
)
from onebend.beam.stiffness import UncertainStiffness, Uniform
from onebend.errors import MechanicsError
from onebend.records import Array, StatedSection

PLACES = np.array([0.0, 0.4, 0.4, 1.0])
SIZE, OTHER = np.array([0.012, 0.009, 0.007, 0.004]), np.array([0.006, 0.005, 0.005, 0.002])
NONE = np.full(4, np.nan)
SECTIONS = {
    "rectangle": StatedSection("rectangle", PLACES, SIZE, 2.0 * OTHER, 1e-4),
    "circle": StatedSection("circle", PLACES, SIZE, SIZE, 1e-4),
    "tube": StatedSection("tube", PLACES, SIZE, SIZE, 1e-4, OTHER),
    "hexagon": StatedSection("hexagon", PLACES, SIZE, SIZE, 1e-4),
    "second moment": StatedSection("second moment", PLACES, NONE, NONE, moment=SIZE**4 / 12.0, moment_sd=0.05),
}
AT, HERE, THERE = np.array([0.2, 0.7]), np.array([0.0105, 0.0055]), np.array([0.0055, 0.0035])  # halfway


def second_moment_of(corners: Array) -> float:
    """m^4 about the centroid, of a polygon around the origin with corners (N, 2) (y, z), by Green's theorem."""
    (y, z), (y1, z1) = corners.T, np.roll(corners, -1, axis=0).T
    return float(abs(np.sum((y * z1 - y1 * z) * (y**2 + y * y1 + y1**2)) / 12.0))


def by_hand(name: str) -> Array:
    """m^4, at AT."""
    if name == "hexagon":  # as the integral over its area, flats up
        turns = np.pi / 3.0 * np.arange(6)
        corners = [[(d / np.sqrt(3) * np.sin(t), d / np.sqrt(3) * np.cos(t)) for t in turns] for d in HERE]
        return np.array([second_moment_of(np.array(each)) for each in corners])
    moments: dict[str, Array] = {
        "rectangle": 2.0 * THERE * HERE**3 / 12.0,
        "circle": np.pi / 64.0 * HERE**4,
        "tube": np.pi / 64.0 * (HERE**4 - THERE**4),
        "second moment": HERE**4 / 12.0,
    }
    return moments[name]


@pytest.mark.parametrize("name", SECTIONS)
def test_the_second_moment_is_that_of_the_figure_between_the_places_too(name: str) -> None:
    np.testing.assert_allclose(second_moment(SECTIONS[name], AT)[0], by_hand(name), rtol=1e-12)
    if name == "hexagon":
        np.testing.assert_allclose(by_hand(name), 5.0 * np.sqrt(3.0) / 144.0 * HERE**4, rtol=1e-12)


@pytest.mark.parametrize("name", ["rectangle", "circle", "tube", "hexagon"])
def test_errors_of_the_sizes_are_those_of_differences(name: str) -> None:
    one, h = SECTIONS[name], 1e-7
    alone = one.shape in ("circle", "hexagon")
    sizes = ["thickness"] if alone else ["thickness", "inner" if one.inner is not None else "width"]
    together = {"thickness": ["thickness", "width"]} if one.shape != "rectangle" else {}
    for i, name_of_size in enumerate(sizes):
        more, less = (
            replace(one, **{each: getattr(one, each) + sign * h for each in together.get(name_of_size, [name_of_size])})
            for sign in (1.0, -1.0)
        )
        slope = (np.log(second_moment(more, AT)[0]) - np.log(second_moment(less, AT)[0])) / (2.0 * h)
        np.testing.assert_allclose(moment_errors(one, AT)[:, i], one.sd * slope, rtol=1e-6)
    assert moment_errors(one, AT).shape == (2, len(sizes))
    assert moment_errors(replace(one, sd=np.nan), AT).shape == (2, 0)


def test_sizes_that_make_no_section_are_refused() -> None:
    with pytest.raises(MechanicsError, match="inner diameter"):
        second_moment(replace(SECTIONS["tube"], inner=1.1 * SIZE), AT)
    with pytest.raises(MechanicsError, match=r"positive, got 0 m at s = 0\.2"):
        second_moment(replace(SECTIONS["circle"], sd=0.0, thickness=0.0 * SIZE), AT)


def test_the_shape_is_i_over_its_mean_with_its_steps() -> None:
    for one in SECTIONS.values():
        shape, s = relative_moment(one), np.linspace(0.0, 1.0, 101)
        expected = np.log(second_moment(one, s)[0] / mean_moment(one))
        np.testing.assert_allclose(shape(s), expected, atol=2e-4)
        assert shape.jumps == (0.4,)
        assert np.trapezoid(shape.values, shape.s) == pytest.approx(0.0, abs=1e-12)
        before = second_moment(one, np.array([np.nextafter(0.4, 0.0)]))[0]
        assert shape(np.nextafter(0.4, 0.0)) == pytest.approx(np.log(before[0] / mean_moment(one)), abs=1e-9)


def test_a_steep_cone_counts_as_a_jump_and_a_slender_one_does_not() -> None:
    s, d = np.array([0.0, 0.5, 0.52, 1.0]), np.array([0.010, 0.009, 0.005, 0.004])
    assert relative_moment(StatedSection("circle", s, d, d)).jumps == (0.5, 0.52)
    slow = StatedSection("circle", s[[0, 1, 3]], d[[0, 1, 3]], d[[0, 1, 3]])
    assert relative_moment(slow).jumps == ()


@pytest.mark.parametrize("name", SECTIONS)
def test_a_section_comes_back_from_json(name: str) -> None:
    data = json.loads(json.dumps(section_as_dict(SECTIONS[name]), allow_nan=False))
    assert section_as_dict(section_from_dict(data)) == section_as_dict(SECTIONS[name])
    np.testing.assert_array_equal(second_moment(section_from_dict(data), AT)[0], second_moment(SECTIONS[name], AT)[0])


def test_one_modulus_is_the_mean_of_the_nominal_beam() -> None:
    one, knots = SECTIONS["circle"], np.array([0.0, 0.0, 1.0, 1.0])
    e, length = 2.1e9, 0.3
    logs = np.log(e * mean_moment(one) / length) + np.array([-0.1, 0.1])
    offset = relative_moment(one)
    nominal = UncertainStiffness(knots, logs, 1e-4 * np.eye(2), 0.02, 1, offset=offset)
    k = UncertainStiffness(knots, logs + 0.3, 4e-4 * np.eye(2), 0.02, 1, offset=offset, nominal=nominal)
    found = one_modulus(k, length, one)
    assert found is not None
    assert found[0] == pytest.approx(e, rel=1e-9)
    assert np.log(found[2] / found[0]) == pytest.approx(1.96 * np.hypot(0.01 / np.sqrt(2.0), 0.02), rel=1e-3)
    assert one_modulus(nominal, length, one) is None
    assert one_modulus(Uniform(1.0), length, one) is None
    assert one_modulus(k, length, None) is None
