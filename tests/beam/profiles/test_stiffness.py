"""Profiles: values, round trips through plain data, refusals."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import (
    Gaussians,
    LogSpline,
    Polyline,
    Powers,
    Profile,
    Scaled,
    Steps,
    Table,
    Uniform,
    equidistant,
    profile_from_dict,
)
from onebend.errors import MechanicsError

S = np.linspace(0.0, 1.0, 31)
STEPPED = Polyline((0.1, 0.5, 0.5, 1.0), (1.0, 3.0, 2.0, 4.0), (0.5,))
PROFILES: list[Profile] = [
    Uniform(0.3),
    Gaussians(equidistant(4), 0.25, (1.0, 2.0, 0.5, 1.5)),
    Powers((1.0, -0.5, 0.2)),
    Table((0.0, 0.4, 1.0), (1.0, 3.0, 2.0)),
    Steps((0.0, 0.5, 1.0), (1.0, 2.0)),
    LogSpline((0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0), (0.0, 1.0, -1.0, 0.5)),
    Scaled(0.7, Steps((0.0, 0.25, 1.0), (1.0, 2.0))),
    STEPPED,
    LogSpline((0.0, 0.0, 1.0, 1.0), (0.1, -0.3), 1, STEPPED),
]


@pytest.mark.parametrize("profile", PROFILES, ids=lambda p: type(p).__name__)
def test_round_trip_through_json_is_exact(profile: Profile) -> None:
    again = profile_from_dict(json.loads(json.dumps(profile.as_dict())))
    assert again == profile
    np.testing.assert_array_equal(again(S), profile(S))
    assert again.jumps == profile.jumps


@pytest.mark.parametrize("profile", PROFILES, ids=lambda p: type(p).__name__)
def test_a_used_profile_is_still_equal_hashable_and_can_be_pickled_and_changed(profile: Profile) -> None:
    """What a profile keeps from call to call is no part of it."""
    fresh = profile_from_dict(profile.as_dict())
    profile(S)
    assert fresh == profile
    assert hash(fresh) == hash(profile)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(profile))(S), profile(S))
    table = Table((0.0, 1.0), (1.0, 2.0))
    table(S)
    np.testing.assert_allclose(replace(table, values=(1.0, 3.0))(S), 1.0 + 2.0 * S)


def test_a_polyline_goes_straight_and_steps() -> None:
    at = np.array([0.0, 0.1, 0.3, np.nextafter(0.5, 0.0), 0.5, 0.75, 1.0])
    np.testing.assert_allclose(STEPPED(at), [1.0, 1.0, 2.0, 3.0, 2.0, 3.0, 4.0], rtol=1e-12)
    assert STEPPED(0.3).shape == ()


@pytest.mark.parametrize(
    ("s", "values", "jumps"),
    [
        ((0.0, 0.5, 0.4), (1.0, 1.0, 1.0), ()),
        ((0.0, 0.0, 1.0), (1.0, 2.0, 1.0), ()),
        ((0.0, 0.5, 0.5, 0.5, 1.0), (1.0, 1.0, 1.0, 1.0, 1.0), ()),
        ((0.0,), (1.0,), ()),
        ((0.0, 1.0), (1.0, np.inf), ()),
        ((0.0, 1.0), (1.0, 1.0), (1.0,)),
    ],
)
def test_what_is_no_polyline_is_refused(
    s: tuple[float, ...], values: tuple[float, ...], jumps: tuple[float, ...]
) -> None:
    with pytest.raises(MechanicsError):
        Polyline(s, values, jumps)


def test_a_known_part_of_log_k_is_a_factor() -> None:
    plain = LogSpline((0.0, 0.0, 1.0, 1.0), (0.1, -0.3), 1)
    beside = replace(plain, offset=STEPPED)
    np.testing.assert_allclose(beside(S), plain(S) * np.exp(STEPPED(S)), rtol=1e-14)
    assert beside.jumps == (0.5,)


def test_gaussians_have_unit_area() -> None:
    """The paper's normalisation (15)."""
    x = np.linspace(-2.0, 3.0, 5001)
    assert np.trapezoid(Gaussians((0.5,), 0.2, (1.0,))(x), x) == pytest.approx(1.0, abs=1e-10)


def test_log_spline_is_positive_whatever_its_coefficients() -> None:
    knots = (0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0)
    assert np.all(LogSpline(knots, (-9.0, 5.0, -8.0, 3.0, -20.0))(S) > 0.0)


def test_beam_round_trip() -> None:
    beam = Beam(0.15, PROFILES[1], rest_curvature=PROFILES[2], clamp_angle=0.01, mass_per_length=Uniform(0.5))
    assert Beam.from_dict(json.loads(json.dumps(beam.as_dict()))) == beam


@pytest.mark.parametrize("data", [{"kind": "nonsense"}, {}, {"kind": "uniform"}, {"kind": "gaussians", "width": 1.0}])
def test_damaged_data_are_refused(data: dict[str, object]) -> None:
    with pytest.raises(MechanicsError, match="profile"):
        profile_from_dict(data)


def test_a_beam_with_a_missing_entry_is_refused() -> None:
    data = Beam(0.15, Uniform(1.0)).as_dict()
    del data["stiffness_N_m"]
    with pytest.raises(MechanicsError, match="stiffness_N_m"):
        Beam.from_dict(data)


def test_whole_numbers_are_as_good_as_decimals() -> None:
    whole = Beam(1, Steps((0, 0.5, 1), (1, 2)), rest_curvature=Uniform(1), mass_per_length=Uniform(1))
    decimal = Beam(1.0, Steps((0.0, 0.5, 1.0), (1.0, 2.0)), rest_curvature=Uniform(1.0), mass_per_length=Uniform(1.0))
    shapes = [beam.equilibrium((0, 1), gravity=(0, -1)).xy(S) for beam in (whole, decimal)]
    np.testing.assert_array_equal(shapes[0], shapes[1])
