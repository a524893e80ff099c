"""model.json: exact round trips, and clear words on every damaged file."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, strategies as st

from onebend.beam.model import Beam
from onebend.beam.section import modulus_band, one_modulus, relative_moment
from onebend.beam.stiffness import (
    Gaussians,
    LogSpline,
    Powers,
    Profile,
    Scaled,
    Steps,
    Table,
    UncertainStiffness,
    Uniform,
)
from onebend.errors import ResultsError
from onebend.files.publish import with_checksum
from onebend.records import StatedSection
from onebend.results.model import (
    StoredModel,
    load_model,
    load_modulus,
    load_uncertain,
    model_text,
    origin_of,
    read_model,
    save_model,
)
from tests import made_up
from tests.made_up import same

ORIGIN = origin_of(made_up.learned(), None, [made_up.learned().training])
THICK = np.array([0.008, 0.012, 1 / 90])
NUMBERS = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e6, max_value=1e6)
POSITIVE = st.floats(min_value=1e-6, max_value=1e6)


@given(length=POSITIVE, coefficients=st.lists(NUMBERS, min_size=1, max_size=6), width=POSITIVE, angle=NUMBERS)
def test_round_trip_is_exact(
    tmp_path_factory: pytest.TempPathFactory, length: float, coefficients: list[float], width: float, angle: float
) -> None:
    file = tmp_path_factory.mktemp("model") / "model.json"
    centres = tuple(float(c) for c in np.linspace(0.0, 1.0, len(coefficients)))
    beam = Beam(length, Gaussians(centres, width, tuple(coefficients)), Powers(tuple(coefficients)), angle)
    save_model(file, beam, written_by="a test")
    assert load_model(file) == beam


@pytest.mark.parametrize(
    "profile",
    [
        Uniform(0.1),
        Powers((0.1, 1 / 3)),
        Table((0.0, 0.1, 1.0), (1 / 7, 0.2, 0.3)),
        Steps((0.0, 0.3, 1.0), (0.1, 1 / 9)),
        LogSpline((0.0, 0.0, 1.0, 1.0), (-1.0, -2 / 3), 1),
        Scaled(0.7, Scaled(1 / 3, Uniform(0.2))),
    ],
)
def test_every_family_comes_back(tmp_path: Path, profile: Profile) -> None:
    beam = Beam(0.15, profile, mass_per_length=profile)
    save_model(tmp_path / "model.json", beam, written_by="a test", origin=ORIGIN)
    stored = read_model(tmp_path)  # the folder will do
    assert stored.beam == beam
    assert stored.origin == ORIGIN
    assert stored.uncertain is None


def test_origin_says_what_was_not_simulated() -> None:
    assert (ORIGIN.method, ORIGIN.n, ORIGIN.m, ORIGIN.push_s) == ("regression", 4, 3, 1.0)
    assert ORIGIN.training_rms_m == pytest.approx(tuple(made_up.learned().training.rms))
    trainings = [made_up.comparison("a", error_m=0.003), made_up.comparison("b", error_m=0.004)]
    both = origin_of(None, made_up.posterior(), trainings)
    assert (both.recording, both.method, both.n, both.m) == ("a + b", "fit", None, 8)
    expected = np.sqrt((trainings[0].rms ** 2 + trainings[1].rms ** 2) / 2)
    assert both.training_rms_m == pytest.approx(tuple(expected))


def test_the_band_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    fit = made_up.posterior()
    save_model(tmp_path / "model.json", fit.beam, written_by="a test", uncertain=fit.stiffness)
    s = np.linspace(0.0, 1.0, 33)
    again, before = load_uncertain(tmp_path).band(s, 0.8), fit.band(s, 0.8)
    for name in ("k", "low", "high", "identified"):
        np.testing.assert_array_equal(getattr(again, name), getattr(before, name))
    assert load_model(tmp_path) == fit.beam


def stored_with(section: StatedSection | None, *, banded: bool = True) -> str:
    fit = made_up.posterior()
    uncertain = fit.stiffness if banded else None
    return model_text(StoredModel(fit.beam, None, uncertain, section=section), written_by="a test")


@pytest.mark.parametrize("sd", [1e-4, 0.0, float("nan")])
@pytest.mark.parametrize("shape", ["rectangle", "circle"])
def test_the_section_comes_back_and_with_it_the_modulus(
    tmp_path: Path, shape: Literal["rectangle", "circle"], sd: float
) -> None:
    wide = THICK if shape == "circle" else 2.5 * THICK
    section = StatedSection(shape, np.array([0.0, 0.5, 1.0]), THICK, wide, sd)
    (tmp_path / "model.json").write_text(stored_with(section), encoding="utf-8")
    stored = read_model(tmp_path).section
    assert stored is not None
    assert all(same(getattr(stored, field.name), getattr(section, field.name)) for field in fields(StatedSection))
    s, fit = np.linspace(0.0, 1.0, 11), made_up.posterior()
    found, expected = load_modulus(tmp_path, s, 0.8), modulus_band(fit.stiffness, fit.beam.length, section, s, 0.8)
    assert found is not None
    for name in ("modulus", "low", "high", "identified"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    (tmp_path / "model.json").write_text(stored_with(section, banded=False), encoding="utf-8")
    bare = load_modulus(tmp_path, s)
    assert bare is not None
    np.testing.assert_allclose(bare.modulus, expected.modulus)
    assert np.isnan(bare.low).all()
    (tmp_path / "model.json").write_text(stored_with(None), encoding="utf-8")
    assert load_modulus(tmp_path, s) is None


SECTION: dict[str, Any] = {"shape": "circle", "s": [0, 1], "in_plane_m": [1, 1], "across_m": [1, 1], "sd_m": None}


@pytest.mark.parametrize(
    "change",
    [
        {"shape": "star"}, {"s": [0, 0.5, 1]}, {"s": [1, 0]}, {"s": [0]}, {"s": 0}, {"in_plane_m": [0, 1]},
        {"in_plane_m": ["wide", 1]}, {"in_plane_m": [None, 1]}, {"across_m": None}, {"sd_m": -1}, {"sd_m": []},
    ],
)  # fmt: skip
def test_a_section_that_is_none_is_named(tmp_path: Path, change: dict[str, Any]) -> None:
    made = {"format": "onebend-model", "version": 9, "written_by": "x", "beam": made_up.BEAM.as_dict()}
    for section in (SECTION, SECTION | change):
        content = with_checksum({**made, "section": section})
        (tmp_path / "model.json").write_text(json.dumps(content), encoding="utf-8")
        if section is SECTION:
            assert read_model(tmp_path).section is not None
        else:
            with pytest.raises(ResultsError, match="key 'section'"):
                read_model(tmp_path)


def test_what_speaks_against_a_band_comes_back_and_may_be_missing_in_old_files(tmp_path: Path) -> None:
    fit = made_up.posterior()
    doubted = replace(fit.stiffness, doubts=("the fit did not converge", "the force contradicts the bending"))
    save_model(tmp_path / "model.json", fit.beam, written_by="a test", uncertain=doubted)
    assert load_uncertain(tmp_path).doubts == doubted.doubts
    data = json.loads((tmp_path / "model.json").read_text(encoding="utf-8"))
    del data["uncertain"]["doubts"]
    (tmp_path / "model.json").write_text(json.dumps(data), encoding="utf-8")
    with pytest.warns(UserWarning, match=r"model\.json: was changed after onebend wrote it"):
        assert len(load_uncertain(tmp_path).doubts) == 1  # that it was changed
    del data["sha256"]
    (tmp_path / "model.json").write_text(json.dumps(data | {"version": 3}), encoding="utf-8")
    assert load_uncertain(tmp_path).doubts == ()


def test_a_model_of_the_first_version_still_loads(tmp_path: Path) -> None:
    (tmp_path / "model.json").write_text(change(GOOD, version=1), encoding="utf-8")
    assert load_model(tmp_path) == made_up.BEAM
    with pytest.raises(ResultsError, match="has no band"):
        load_uncertain(tmp_path)


def test_a_beam_that_is_not_finite_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="not finite"):
        save_model(tmp_path / "model.json", Beam(0.15, Uniform(float("nan"))), written_by="a test")
    assert not (tmp_path / "model.json").exists()


def change(data: dict[str, Any], **changes: Any) -> str:
    return json.dumps(data | changes)


GOOD: dict[str, Any] = {"format": "onebend-model", "version": 3, "written_by": "x", "beam": made_up.BEAM.as_dict()}
BAND = UncertainStiffness(np.array([0.0, 0.0, 1.0, 1.0]), np.zeros(2), np.eye(2), degree=1).as_dict()
UNIFORM = {"kind": "uniform", "value": 0.1}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ('{"format": "onebend-model",\n "version": 1', "line 2: not valid JSON"),
        ("[1, 2]", "a JSON list, not an object"),
        ("[" * 100_000, "nested too deeply"),
        ("{}", "not a onebend model"),
        (change(GOOD, format="other"), "not a onebend model"),
        (change(GOOD, version=11), "version 11, but this onebend reads versions 1, 2, 3, 4, 5, 6, 7, 8, 9 and 10"),
        (change(GOOD, extra=1), "key 'extra'"),
        (change(GOOD, beam=3), "key 'beam'"),
        (change(GOOD, beam={}), "lack 'length_m'"),
        (change(GOOD, beam=GOOD["beam"] | {"length_m": -1.0}), "length must be positive"),
        (change(GOOD, beam=GOOD["beam"] | {"length_m": float("inf")}), "holds Infinity"),
        (change(GOOD, beam=GOOD["beam"] | {"stiffness_N_m": 3}), "describes no beam"),
        (change(GOOD, beam=GOOD["beam"] | {"stiffness_N_m": {"kind": "magic"}}), "magic"),
        (change(GOOD, beam=GOOD["beam"] | {"stiffness_N_m": UNIFORM | {"value": "soft"}}), "beam"),
        (change(GOOD, beam=GOOD["beam"] | {"stiffness_N_m": UNIFORM | {"value": [1.0, 2.0]}}), "beam"),
        (change(GOOD, beam=GOOD["beam"] | {"stiffness_N_m": UNIFORM | {"value": float("nan")}}), "holds NaN"),
        (change(GOOD, origin={"recording": 3}), "key 'origin"),
        (change(GOOD, uncertain=3), "key 'uncertain'"),
        (change(GOOD, uncertain={"knots": [0, 1]}), "key 'uncertain'"),
        (change(GOOD, uncertain=BAND | {"covariance": [[1.0]]}), "key 'uncertain'"),
        (change(GOOD, uncertain=BAND | {"covariance": [[-1.0, 0.0], [0.0, -1.0]]}), "key 'uncertain'"),
        (change(GOOD, uncertain=BAND | {"gain_sd": float("nan")}), "holds NaN"),
        (change(GOOD, uncertain=BAND), "not the band of the beam's stiffness"),
    ],
)
def test_a_damaged_file_is_named_with_what_to_do(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "model.json"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ResultsError) as caught:
        load_model(file)
    assert words in str(caught.value)
    assert str(file) in str(caught.value)


def test_a_missing_or_binary_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="no such file"):
        load_model(tmp_path)
    (tmp_path / "model.json").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(ResultsError, match="it is UTF-16"):
        load_model(tmp_path)


def test_a_beam_that_goes_with_its_section_comes_back_with_its_modulus(tmp_path: Path) -> None:
    size = np.array([0.01, 0.009, 0.006, 0.004])
    section = StatedSection("circle", np.array([0.0, 0.4, 0.4, 1.0]), size, size, 1e-4)
    fit, shape = made_up.posterior(), relative_moment(section)
    plain = fit.stiffness
    nominal = replace(plain, mean=plain.mean + 0.01, shape=None, offset=shape)
    uncertain = replace(plain, offset=shape, nominal=nominal)
    beam = replace(fit.beam, stiffness=uncertain.profile)
    text = model_text(StoredModel(beam, None, uncertain, section=section), written_by="a test")
    (tmp_path / "model.json").write_text(text, encoding="utf-8")
    stored, s = read_model(tmp_path), np.linspace(0.0, 1.0, 11)
    assert stored.uncertain is not None
    assert stored.uncertain.nominal is not None
    assert stored.beam == beam
    np.testing.assert_array_equal(stored.uncertain.band(s).k, uncertain.band(s).k)
    assert one_modulus(stored.uncertain, beam.length, stored.section) == one_modulus(uncertain, beam.length, section)
    found, own = load_modulus(tmp_path, s), modulus_band(nominal, beam.length, replace(section, sd=0.0), s)
    assert found is not None
    for name in ("modulus", "low", "high"):
        np.testing.assert_allclose(getattr(found, name), getattr(own, name), rtol=1e-12)
    damaged = json.loads(text)
    damaged["uncertain"]["offset"]["kind"] = "uniform"
    (tmp_path / "model.json").write_text(json.dumps(damaged), encoding="utf-8")
    with pytest.raises(ResultsError, match="key 'uncertain' describes no stiffness"):
        read_model(tmp_path)


def test_a_set_up_of_before_is_not_read(tmp_path: Path) -> None:
    """Its force error was one of the tags' displacement."""
    data = {**GOOD, "version": 8, "setup": {"sizes": {"force error": 4}}}
    (tmp_path / "model.json").write_text(json.dumps(with_checksum(data)), encoding="utf-8")
    found = read_model(tmp_path)
    assert found.setup is None
    assert "set-up of an older version" in found.left_out
    with pytest.warns(UserWarning, match="set-up of an older version"):
        load_model(tmp_path)
