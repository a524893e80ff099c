"""Designs: what a width and a silicone make, against closed forms, an independent integration, and makers' figures."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from typer.testing import CliRunner

from onebend.beam.stiffness import Powers, Uniform
from onebend.cli import app
from onebend.errors import MechanicsError
from onebend.lab.designs import (
    DESIGNS,
    GRAVITY,
    Design,
    across_depth,
    bend,
    buckling_force,
    expect,
    find_design,
    from_shore_a,
    read_design,
    template,
    write_design_template,
)
from onebend.report.sentences import words
from onebend.results.model import read_model

S = np.linspace(0.0, 1.0, 1001)


@settings(max_examples=20, deadline=None)
@given(
    start=st.floats(0.008, 0.02),
    slope=st.floats(-0.004, 0.01),
    bow=st.floats(-0.003, 0.01),
    length=st.floats(0.1, 0.4),
)
def test_bending_stiffness_and_mass_are_those_of_the_width(
    start: float, slope: float, bow: float, length: float
) -> None:
    design = Design("any", length, 0.03, Powers((start, slope, bow)), 0.7e6, 0.1, 1100.0)
    w = start + slope * S + bow * S**2
    np.testing.assert_allclose(design.bending(S), 0.7e6 * 0.03 * w**3 / 12.0, rtol=1e-12)
    np.testing.assert_allclose(design.beam().stiffness(S), 0.7e6 * 0.03 * w**3 / 12.0 / length, rtol=1e-9)
    assert design.mass == pytest.approx(1100.0 * 0.03 * length * (start + slope / 2.0 + bow / 3.0), rel=1e-10)
    assert float(np.max(np.abs(np.log(design.uncertain().profile(S) / design.beam().stiffness(S))))) < 1e-4


def test_named_designs_are_weakest_where_the_paper_has_them_so() -> None:
    weakest = {name: float(S[np.argmin(design.bending(S))]) for name, design in DESIGNS.items()}
    assert weakest["linear"] == 0.0
    assert weakest["quadratic"] == pytest.approx(0.5)
    assert weakest["cubic"] == pytest.approx(0.9)
    assert float(S[np.argmax(DESIGNS["cubic"].bending(S))]) == pytest.approx(0.25)
    orders = {name: len(d.width.coefficients) - 1 for name, d in DESIGNS.items() if isinstance(d.width, Powers)}
    assert orders == {"uniform": 0, "linear": 1, "quadratic": 2, "cubic": 3}


def test_the_band_is_the_modulus_alone() -> None:
    design = DESIGNS["cubic"]
    band = design.uncertain().band(S)
    np.testing.assert_allclose(np.log(band.high / band.low), 2 * 1.959964 * design.modulus_log_sd, rtol=1e-6)
    assert replace(design, modulus_log_sd=0.0).uncertain().gain_sd == 0.0


def test_the_relation_of_hardness_is_gents() -> None:
    assert from_shore_a(30.0).modulus == pytest.approx(1.142e6, rel=1e-3)
    assert from_shore_a(10.0).log_sd > 1.5 * from_shore_a(25.0).log_sd  # outside the relation's range
    rising = [from_shore_a(shore).modulus for shore in range(5, 96)]
    assert np.all(np.diff(rising) > 0.0)


def test_uniform_beam_has_the_textbook_figures() -> None:
    design = replace(DESIGNS["uniform"], length=0.5, modulus=1e10)  # slender and stiff: the weight hardly bends it
    found, EI, L = expect(design, (1.0,)), float(design.bending(0.0)), design.length
    mu = design.mass / L
    assert found.compliance == pytest.approx(L**3 / (3.0 * EI), rel=1e-12)
    assert found.buckling == pytest.approx(math.pi**2 * EI / (4.0 * L**2), rel=1e-9)
    for got, root in zip(found.frequency, (1.875104, 4.694091), strict=True):
        assert got == pytest.approx(root**2 / L**2 * math.sqrt(EI / mu) / (2.0 * math.pi), rel=5e-3)  # rotary inertia
    assert found.droop == pytest.approx(mu * GRAVITY * L**4 / (8.0 * EI), rel=1e-3)
    assert found.sag == pytest.approx(found.droop * (0.014 / 0.03) ** 2, rel=1e-3)
    assert found.bends[0].force == pytest.approx(2.0 * EI * math.radians(1.0) / L**2, rel=1e-3)
    assert found.bends[0].strain == pytest.approx(0.007 * found.bends[0].force * L / EI, rel=1e-2)


@pytest.mark.parametrize("name", ["linear", "cubic"])
def test_bends_agree_with_an_integration_from_the_tip(name: str) -> None:
    design, turn = DESIGNS[name], math.radians(60.0)
    L = design.length

    def shape(force: float) -> np.ndarray:
        """From the tip, where the tangent is x: angle, x, y and moment; the force is along y there."""

        def rate(s: float, state: np.ndarray) -> list[float]:
            angle, _, _, moment = state
            k = float(design.bending(s)) / L
            return [moment / k, L * math.cos(angle), L * math.sin(angle), -L * math.cos(angle) * force]

        return np.asarray(solve_ivp(rate, (1.0, 0.0), [0.0, 0.0, 0.0, 0.0], rtol=1e-10, atol=1e-13).y[:, -1])

    found = bend(design, turn)
    force = float(brentq(lambda f: shape(f)[0] + turn, 0.5 * found.force, 2.0 * found.force, rtol=1e-12))
    assert found.force == pytest.approx(force, rel=1e-7)
    angle, x, y, _ = shape(force)  # the clamp's pose seen from the tip
    tip = [-x * math.cos(angle) - y * math.sin(angle), x * math.sin(angle) - y * math.cos(angle)]
    np.testing.assert_allclose(found.tip, tip, atol=1e-8)


def test_the_buckling_force_is_where_the_straight_beam_stops_being_stable() -> None:
    beam = DESIGNS["quadratic"].beam()
    least = buckling_force(beam)
    assert beam.equilibrium((-0.999 * least, 0.0)).stable
    assert not beam.equilibrium((-1.001 * least, 0.0)).stable


def test_forces_scale_with_the_modulus_and_shapes_do_not() -> None:
    soft = DESIGNS["linear"]
    stiff = replace(soft, modulus=3.0 * soft.modulus)
    one, other = bend(soft, 1.2), bend(stiff, 1.2)
    assert other.force == pytest.approx(3.0 * one.force, rel=1e-8)
    np.testing.assert_allclose(one.tip, other.tip, atol=1e-9)
    assert across_depth(soft).stiffness(0.5) == pytest.approx(soft.modulus * 0.015 * 0.03**3 / 12.0 / 0.15)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"length": 0.0}, "length must be a positive number"),
        ({"depth": math.nan}, "depth must be a positive number"),
        ({"modulus_log_sd": -0.1}, "sd of log E must be at least 0"),
        ({"width": Powers((0.01, -0.02))}, r"width must be positive all along, but is .* at s = 0\.5"),
    ],
)
def test_a_design_without_meaning_is_refused(change: dict[str, object], says: str) -> None:
    with pytest.raises(MechanicsError, match=says):
        replace(DESIGNS["linear"], **change)  # type: ignore[arg-type]


def test_a_stout_beam_is_remarked() -> None:
    assert not DESIGNS["linear"].remarks
    assert "shears" in words(*replace(DESIGNS["linear"], width=Uniform(0.04)).remarks)


def test_the_template_is_a_design_and_keeps_its_numbers(tmp_path: Path) -> None:
    path = write_design_template(tmp_path / "mine.toml")
    design = read_design(path)
    assert (design.name, design.length, design.depth) == ("mine", 0.15, 0.03)
    np.testing.assert_allclose(design.width(np.array([0.0, 0.5, 1.0])), [0.02, 0.01, 0.02])
    assert design.modulus == from_shore_a(30.0).modulus
    with pytest.raises(MechanicsError, match="exists already"):
        write_design_template(path)


def test_every_way_to_say_a_width_or_a_material(tmp_path: Path) -> None:
    path = tmp_path / "d.toml"
    text = template().replace('"smooth"', '"straight"')
    path.write_text(text, encoding="utf-8")
    straight = read_design(path)
    np.testing.assert_allclose(straight.width(S), 0.01 + 0.02 * np.abs(S - 0.5), atol=1e-15)
    assert np.max(np.abs(np.log(straight.uncertain().profile(S) / straight.beam().stiffness(S)))) < 1e-6
    path.write_text(text.replace("shore_a = 30", "shore_a = 10\nmodulus_log_sd = 0.05"), encoding="utf-8")
    soft = read_design(path)
    assert (soft.modulus, soft.density) == (from_shore_a(10.0).modulus, 1080.0)
    assert soft.modulus_log_sd == 0.05
    path.write_text(text.replace("shore_a = 30", "modulus_Pa = 7e5\ndensity_kg_m3 = 1200"), encoding="utf-8")
    assert (read_design(path).modulus, read_design(path).density) == (7e5, 1200.0)
    assert find_design("linear") is DESIGNS["linear"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("format = 1", "format = 2", r"d\.toml:4: format must be 1"),
        ("depth_m", "dept_m", r"Did you mean depth_m\?"),
        ("shore_a = 30", "shore_a = 300", r"\[material\] Shore A 300: the relation"),
        ("[0.0, 0.5, 1.0]", "[0.0, 0.5, 0.9]", "must run from 0 to 1"),
        ("[0.0, 0.5, 1.0]", "[0.0, 1.0]", "one width_m a place"),
        ("[0.0, 0.5, 1.0]", "[0.0, 0.0, 1.0]", "must rise"),
        ("0.01, 0.02]", "-0.01, 0.02]", "each entry is a number above 0"),
        ("# polynomial_m", "polynomial_m", "not both"),
        ("# modulus_Pa", "modulus_Pa", "shore_a or modulus_Pa, not both"),
        ("shore_a = 30", "", "and has none"),
        ("[material]", "[materials]", r"lacks the table \[material\]"),
        ("length_m = 0.15", "length_m = 0.15.2", "not valid TOML"),
        ("length_m = 0.15", "length_m = nan", "must be a number above 0"),
    ],
)
def test_mistakes_in_a_design_are_said_with_their_place(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = tmp_path / "d.toml"
    assert old in template()
    path.write_text(template().replace(old, new), encoding="utf-8")
    with pytest.raises(MechanicsError, match=says):
        read_design(path)


@pytest.mark.slow
def test_the_command_says_what_the_functions_find(tmp_path: Path) -> None:
    model = tmp_path / "model.json"
    done = CliRunner().invoke(app, ["design", "quadratic", "--model", str(model), "--json"])
    assert done.exit_code == 0, done.output
    design = DESIGNS["quadratic"]
    said, expected = json.loads(done.stdout), expect(design)
    assert said["mass_kg"] == pytest.approx(design.mass)
    assert [one["force_N"] for one in said["bends"]] == pytest.approx([one.force for one in expected.bends])
    np.testing.assert_allclose(read_model(model).beam.stiffness(S), design.beam().stiffness(S), rtol=1e-9)
    shown = CliRunner().invoke(app, ["design", "quadratic"], env={"COLUMNS": "120"}).stdout
    assert "buckles at" in shown
    assert "0.227" in shown  # N, for 30 degrees, Shore A 30


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (["design"], "name a design"),
        (["design", "cubik"], "Did you mean 'cubic'"),
        (["design", "none.toml"], "does not exist"),
    ],
)
def test_the_command_refuses_in_one_message(asked: list[str], says: str) -> None:
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == 2
    assert says in done.stderr
    assert "Traceback" not in done.output
