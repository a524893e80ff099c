"""What an export takes of a beam, what it leaves out, draws of the band, tables, the sheet, and the command."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
import pyarrow.csv as csv
import pyarrow.parquet as parquet
import pypdfium2
import pytest
from typer.testing import CliRunner

from onebend.beam.model import Beam
from onebend.beam.setup import SetUp
from onebend.beam.stiffness import SHAPE_LEVELS, SHAPE_PLACES, Polyline, Table, UncertainStiffness, Uniform
from onebend.cli import app
from onebend.errors import ExportError, ResultsError
from onebend.export.chain import chain_of
from onebend.export.export import KINDS, TABLES, Kind, columns, export, without
from onebend.export.sample import PARTS, Relaxing, RodSample, drawn, rod_sample
from onebend.files.single_file import write_file
from onebend.learning.instruments import PlannedPush
from onebend.records import PointMass, StatedSection
from onebend.results.model import StoredModel, model_text, sample_of_model, save_model
from tests.export.simulators import loaded, numbers
from tests.export.test_round_trip import BEAMS, SMOOTH, STEP

PAGE = Path(__file__).parents[2] / "docs" / "export.md"
S = np.linspace(0.0, 1.0, 20001)
THICK = BEAMS["thick"]


def banded(*, shape: bool = False, stepped: bool = False, doubts: tuple[str, ...] = ()) -> UncertainStiffness:
    """Some band: with a shape of its own, a known step, a gain."""
    rng = np.random.default_rng(3)
    half = rng.normal(size=(5, 5))
    widths = np.stack([np.linspace(low, 1.0, len(SHAPE_PLACES)) for low in (0.5, 0.7, 0.9)])
    step = Polyline((0.0, 0.4, 0.4, 1.0), (0.1, 0.1, -0.3, -0.2), (0.4,))
    return UncertainStiffness(
        np.r_[0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0],
        np.log([0.03, 0.02, 0.02, 0.015, 0.01]),
        0.004 * half @ half.T,
        gain_sd=0.02,
        shape=widths if shape else None,
        offset=step if stepped else None,
        doubts=doubts,
    )


def of_band(uncertain: UncertainStiffness) -> RodSample:
    return rod_sample(Beam(0.2, uncertain.profile, mass_per_length=Uniform(0.3)), uncertain=uncertain)


# the chain


@pytest.mark.parametrize("beam", [SMOOTH, STEP, THICK])
def test_a_chain_keeps_mass_moment_of_mass_compliance_and_turn(beam: Beam) -> None:
    chain = chain_of(rod_sample(beam), 7)
    mu = np.asarray(beam.mass_per_length(S))
    begins = chain.joints[:-1]
    assert chain.link_mass.sum() == pytest.approx(beam.length * np.trapezoid(mu, S), rel=1e-8)
    moment = np.sum(chain.link_mass * (begins + chain.link_centre))
    assert moment == pytest.approx(beam.length**2 * np.trapezoid(mu * S, S), rel=1e-8)
    second = np.sum(chain.link_inertia + chain.link_mass * (begins + chain.link_centre) ** 2)
    assert second == pytest.approx(beam.length**3 * np.trapezoid(mu * S**2, S), rel=1e-8)
    assert np.sum(1 / chain.stiffness) == pytest.approx(np.trapezoid(1 / beam.stiffness(S), S), rel=1e-4)
    assert chain.rest.sum() == pytest.approx(np.trapezoid(np.asarray(beam.rest_curvature(S)), S), rel=1e-6)
    assert chain.link_length.sum() == pytest.approx(beam.length)


def test_a_step_of_k_inside_a_cell_is_met_exactly() -> None:
    """The cell that holds s = 0.43 has both stiffnesses in series."""
    chain = chain_of(rod_sample(STEP), 10)
    assert 1 / chain.stiffness[4] == pytest.approx(0.03 / 0.03 + 0.07 / 0.01, rel=1e-12)


def test_a_chain_keeps_stretch_and_shear() -> None:
    rod = rod_sample(THICK)
    chain, axial = chain_of(rod, 7), rod.axial(S)
    for found, along in zip((chain.stretch, chain.shear), axial, strict=True):
        assert found is not None
        assert np.sum(1 / found) == pytest.approx(THICK.length * np.trapezoid(1 / along, S), rel=1e-6)
    assert chain_of(rod_sample(SMOOTH), 7).stretch is None


def test_a_place_lies_on_its_link() -> None:
    chain = chain_of(rod_sample(SMOOTH), 4)  # hinges at 1/8, 3/8, 5/8, 7/8
    assert chain.link_of(0.0) == (0, 0.0)
    np.testing.assert_allclose(chain.link_of(0.5), (2, 0.125 * SMOOTH.length))
    np.testing.assert_allclose(chain.link_of(1.0), (4, 0.125 * SMOOTH.length))


# EA and kGA


def stated(shape: str, thickness: float, width: float = 0.01, inner: float | None = None) -> StatedSection:
    s = np.array([0.0, 1.0])
    hole = None if inner is None else np.full(2, inner)
    return StatedSection(shape, s, np.full(2, thickness), np.full(2, width), 1e-4, hole)  # type: ignore[arg-type]


def test_a_stated_rectangle_stretches_as_a_beam_of_that_thickness() -> None:
    """EA = 12 EI / h^2 and kGA = 5/6 GA, where the width makes k vary."""
    by_section = rod_sample(SMOOTH, section=stated("rectangle", 0.012)).axial(S)
    by_beam = rod_sample(replace(SMOOTH, thickness=0.012, varies="width")).axial(S)
    np.testing.assert_allclose(by_section, by_beam, rtol=1e-12)
    np.testing.assert_allclose(by_beam[0], 12.0 * 0.15 * np.asarray(SMOOTH.stiffness(S)) / 0.012**2, rtol=1e-12)


def test_round_sections_stretch_by_their_radius_of_gyration() -> None:
    bend = 0.15 * np.asarray(SMOOTH.stiffness(S))
    for section, squared in (
        (stated("circle", 0.01), 0.01**2 / 16.0),
        (stated("tube", 0.01, inner=0.006), (0.01**2 + 0.006**2) / 16.0),
        (stated("hexagon", 0.01), 5.0 * 0.01**2 / 72.0),
    ):
        stretch, shear = rod_sample(SMOOTH, section=section).axial(S)
        np.testing.assert_allclose(stretch, bend / squared, rtol=1e-12)
        assert 0.15 < float(shear[0] / stretch[0]) < 0.32
    tube = rod_sample(SMOOTH, section=stated("tube", 0.01, inner=1e-9)).axial(S)
    np.testing.assert_allclose(tube, rod_sample(SMOOTH, section=stated("circle", 0.01)).axial(S), rtol=1e-9)


# what is left out, with the amount


def test_what_a_target_leaves_out_is_said_with_the_amount() -> None:
    rod = replace(
        rod_sample(THICK, damping_time=0.013),
        push=((0.0, 0.3), 1.0),
        relaxation=(Relaxing(0.1, 3.0), Relaxing(0.05, 9.0)),
        instantaneous=1.08,
    )
    assert without(rod, "newton") == ()
    [relaxes] = without(rod, "mujoco")
    assert "8.0 % stiffer at first, and 8.2 % softer after a long hold" in relaxes
    stretches, _ = without(rod, "sdf")
    amount = re.search(r"under 0.3 N at s = 1 they move the tip by ([\d.]+) mm", stretches)
    assert amount is not None
    apart = THICK.equilibrium((0.0, 0.3)).xy(1.0) - SMOOTH.equilibrium((0.0, 0.3)).xy(1.0)
    assert float(amount[1]) == pytest.approx(1e3 * np.linalg.norm(apart), rel=0.15)
    assert any("damping (over stiffness: 0.013 s)" in one for one in without(rod, "pyelastica"))
    [rest, *_] = without(rod, "mujoco-flex")
    assert "rest shape" in rest
    for sentence in (*without(rod, "mujoco-flex"), *without(rod, "sdf")):
        assert sentence in str(export(rod, "mujoco-flex")) + str(export(rod, "sdf"))
    assert without(rod_sample(SMOOTH), "mujoco") == ()
    laden = rod_sample(replace(SMOOTH, masses=(PointMass(0.5, 0.01), PointMass(1.0, 0.002))))
    assert without(laden, "csv") == ("Left out: riding masses (2, together 12 g).",)


def test_the_amount_of_a_stated_section_is_that_of_its_thickness() -> None:
    push = ((0.1, 0.25), 1.0)
    by_beam = replace(rod_sample(replace(SMOOTH, thickness=0.012, varies="width")), push=push)
    by_section = replace(rod_sample(SMOOTH, section=stated("rectangle", 0.012)), push=push)
    assert without(by_section, "sdf") == without(by_beam, "sdf") != ()


def test_relaxing_parts_are_parts() -> None:
    with pytest.raises(ExportError, match="relaxing shares"):
        replace(rod_sample(SMOOTH), relaxation=(Relaxing(0.6, 1.0), Relaxing(0.5, 3.0)))
    rod = replace(rod_sample(SMOOTH), relaxation=(Relaxing(0.2, 1.0),), instantaneous=1.1)
    assert rod.relaxed == pytest.approx(0.88)
    found = numbers(str(export(rod, "newton", hinges=5)))
    np.testing.assert_allclose(found["BEND_N_M"], 1.1 * chain_of(rod, 5).stiffness)
    assert found["RELAXATION"] == ((0.2, 1.0),)
    np.testing.assert_allclose(
        numbers(str(export(rod, "pyelastica")))["EI_N_M2"][0], 1.1 * 0.15 * float(SMOOTH.stiffness(0.0))
    )


def _installed(name: str) -> bool:
    try:
        return bool(version(name))
    except PackageNotFoundError:
        return False


# draws


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "stepped"), [(False, False), (True, True)])
def test_the_quantiles_of_many_draws_are_the_band(shape: bool, stepped: bool) -> None:
    uncertain = banded(shape=shape, stepped=stepped)
    s = np.array([0.0, 0.2, 0.39, 0.41, 0.7, 1.0])
    logs = np.log([one.beam.stiffness(s) for one in drawn(of_band(uncertain), 6000, seed=5)])
    for level in (0.5, 0.8, 0.9, 0.95):
        band = uncertain.band(s, level)
        wide = np.log(band.high / band.low)
        for edge, share in ((band.low, 0.5 - 0.5 * level), (band.high, 0.5 + 0.5 * level)):
            found = np.quantile(logs, share, axis=0)
            assert np.abs((found - np.log(edge)) / wide).max() < 0.03, (level, share)


def test_draws_are_those_of_the_seed_and_carry_the_rest_of_the_beam() -> None:
    rod = replace(of_band(banded(shape=True)), damping_time=0.01, sites=(0.5,))
    first, again, other = drawn(rod, 3, seed=1), drawn(rod, 3, seed=1), drawn(rod, 3, seed=2)
    assert [one.beam for one in first] == [one.beam for one in again] != [one.beam for one in other]
    assert all(one.damping_time == 0.01 and one.sites == (0.5,) and one.uncertain is None for one in first)
    plain = banded()
    assert [one.beam.stiffness for one in drawn(of_band(plain), 3, seed=1)] == list(plain.draw(3, seed=1))
    with pytest.raises(ExportError, match="no band to draw from"):
        drawn(rod_sample(SMOOTH), 3, seed=1)


def test_draws_of_a_narrower_band_keep_their_order() -> None:
    """At every place the rank of a draw is that of the normal it comes from."""
    shaped = banded(shape=True)
    normal = np.array([one(S[::100]) for one in shaped.draw(50, seed=4)])
    found = np.array([one.beam.stiffness(S[::100]) for one in drawn(of_band(shaped), 50, seed=4)])
    np.testing.assert_array_equal(np.argsort(normal, axis=0), np.argsort(found, axis=0))
    assert len(SHAPE_LEVELS) == 3


# from a model


def test_a_model_gives_all_that_it_knows(tmp_path: Path) -> None:
    uncertain = banded()
    stored = StoredModel(Beam(0.2, uncertain.profile), None, uncertain, section=stated("circle", 0.012))
    rod = sample_of_model(stored, mass=0.04, sites=(0.5,))
    assert rod.stretches
    assert rod.uncertain is uncertain
    assert rod.damping_time is None
    assert rod.push is None
    np.testing.assert_allclose(rod.mass(S), 0.2)
    (tmp_path / "model.json").write_text(model_text(stored, written_by="a test"), encoding="utf-8")
    done = CliRunner().invoke(
        app, ["export", str(tmp_path), "--to", "sdf", "--mass-kg", "0.04", "-o", str(tmp_path / "a.sdf")]
    )
    assert "Left out: stretch and shear (under" in done.stdout
    assert "Left out: stretch and shear (under" in (tmp_path / "a.sdf").read_text(encoding="utf-8")


def test_the_largest_push_of_a_model_is_the_one_that_amounts_are_said_for() -> None:
    pushes = tuple(PlannedPush(0.8, turn, largest) for turn, largest in ((0.0, 0.1), (0.5 * np.pi, 0.4), (1.0, 0.2)))
    stored: Any = SimpleNamespace(
        beam=SMOOTH,
        uncertain=None,
        setup=None,
        section=None,
        damping=SimpleNamespace(loss_time=0.03, loss_time_sd=0.006),
        bench=SimpleNamespace(pushes=pushes),
    )
    rod = sample_of_model(stored)
    assert rod.push is not None
    np.testing.assert_allclose(rod.push[0], (0.0, 0.4), atol=1e-15)
    assert rod.push[1] == 0.8
    assert rod.damping_time == 0.03
    assert rod.damping_sd == pytest.approx(0.2)
    overridden = sample_of_model(stored, damping_time=0.01)
    assert (overridden.damping_time, overridden.damping_sd) == (0.01, 0.0)


@pytest.mark.parametrize("in_setup", [False, True])
def test_damping_is_drawn_with_its_band(in_setup: bool) -> None:
    rod = sample_of_model(in_a_setup(banded())) if in_setup else of_band(banded())
    rod = replace(rod, damping_time=0.03, damping_sd=0.2)
    draws = drawn(rod, 4000, seed=3)
    times = np.array([one.damping_time for one in draws])
    assert np.quantile(times, [0.025, 0.5, 0.975]) == pytest.approx([0.03 / 1.48, 0.03, 0.03 * 1.48], rel=0.03)
    level = np.log([float(one.beam.stiffness(0.5)) for one in draws])
    assert abs(np.corrcoef(np.log(times), level)[0, 1]) < 0.05
    assert [one.damping_time for one in drawn(rod, 5, seed=3)] == times[:5].tolist()
    one = replace(draws[7], beam=replace(draws[7].beam, thickness=None), section=None)
    model = mujoco.MjModel.from_xml_string(str(export(one, "mujoco")))
    np.testing.assert_allclose(model.dof_damping, times[7] * model.jnt_stiffness.ravel())
    assert numbers(str(export(one, "newton")))["DAMPING_TIME_S"] == times[7]
    assert "damping over stiffness: 0.03 s; 95 %: 0.0203 to 0.0444 s" in text_on(bytes(export(rod, "sheet")))  # type: ignore[arg-type]
    assert any("0.03 s; 95 %: 0.0203 to 0.0444 s" in one for one in without(rod, "pyelastica"))


def in_a_setup(uncertain: UncertainStiffness) -> StoredModel:
    """A model whose set-up stretches as a thickness of 12 mm times sqrt(1.44) does, and relaxes with two of its times.

    The stretch goes with the level of log k, and all else is known.
    """
    sizes = {"section": 1, "relaxation": 3}
    slope = np.zeros((4, 5))
    slope[0] = 0.2  # of the section, per coefficient of log k
    setup = SetUp(
        push_s=1.0, force=(0.0, 0.4), tags=(0.5, 1.0), thickness=0.012, sizes=sizes,
        mean=np.array([0.44, 0.1, 0.0, 0.05]), slope=slope, covariance=np.diag([0.0, 0.01**2, 1e-12, 0.01**2]),
        prior_sd=np.array([1.0, 0.05, 0.05, 0.05]), times=(1.0, 3.0, 9.0), reached=(0.5, 0.3, 0.2),
    )  # fmt: skip
    beam = Beam(0.2, uncertain.profile, mass_per_length=Uniform(0.3))
    return StoredModel(beam, None, uncertain, setup=setup)


def test_stretch_shear_and_relaxation_are_those_of_the_setup() -> None:
    stored, s = in_a_setup(banded()), np.linspace(0.0, 1.0, 401)
    rod = sample_of_model(stored)
    k = rod.stiffness(s)
    height = 0.012 * 1.2 * np.cbrt(k / np.trapezoid(k, s))
    stretch, shear = rod.axial(s)
    np.testing.assert_allclose(stretch, 12.0 * 0.2 * k / height**2, rtol=1e-3)
    np.testing.assert_allclose(shear / stretch, shear[0] / stretch[0])
    assert [(part.share, part.time) for part in rod.relaxation] == [(0.1, 1.0), (0.0, 3.0), (0.05, 9.0)]
    assert rod.instantaneous == pytest.approx(1.0 / (1.0 - 0.1 * 0.5 - 0.05 * 0.2))
    assert without(rod, "mujoco")[0].startswith("Left out: relaxation")
    # a stated section keeps its shape: only the share is the set-up's
    sectioned = sample_of_model(replace(stored, section=stated("circle", 0.012)))
    plain = rod_sample(stored.beam, section=stated("circle", 0.012))
    np.testing.assert_allclose(sectioned.axial(s)[0], plain.axial(s)[0] / 1.44)


@pytest.mark.slow
def test_draws_of_a_setup_are_joint_and_their_quantiles_are_the_bands() -> None:
    stored = in_a_setup(banded())
    assert stored.uncertain is not None
    rod, s = sample_of_model(stored), np.array([0.5])
    draws = drawn(rod, 4000, seed=3)
    share = np.array([one.relaxation[0].share for one in draws])
    assert share.mean() == pytest.approx(0.1, abs=1e-3)
    assert share.std() == pytest.approx(0.01, rel=0.05)
    thick = np.array([one.beam.thickness for one in draws], dtype=float)
    level = np.array([np.mean(one.beam.stiffness.coefficients) for one in draws])  # type: ignore[attr-defined]
    gain = np.hypot(level.std(), 0.0)
    expected = np.sqrt(np.mean(stored.uncertain.covariance)) / gain  # the gain is no part of the set-up
    assert np.corrcoef(thick**2, level)[0, 1] == pytest.approx(expected, abs=0.05)
    k = np.array([one.beam.stiffness(0.5) for one in draws])
    band = stored.uncertain.band(s)
    assert np.quantile(k, [0.025, 0.975]) == pytest.approx([band.low[0], band.high[0]], rel=0.02)
    found, stretch = columns(rod), np.array([one.axial(s)[0][0] for one in draws])
    i = int(np.argmin(np.abs(found["s"] - 0.5)))
    ends = [found["EA_lo_N"][i], found["EA_hi_N"][i]]
    assert ends == pytest.approx(np.quantile(stretch, [0.025, 0.975]), rel=0.05)
    assert found["EA_lo_N"][i] < found["EA_N"][i] < found["EA_hi_N"][i]
    with pypdfium2.PdfDocument(export(rod, "sheet")) as page:
        text = page[0].get_textpage().get_text_bounded()
    assert "10 % within 1 s; 95 %: 8" in text
    assert np.isnan(columns(of_band(banded()))["EA_lo_N"]).all()


def test_a_setup_that_hardly_stretches_or_relaxes_has_neither() -> None:
    stored = in_a_setup(banded())
    assert stored.setup is not None
    rod = sample_of_model(replace(stored, setup=replace(stored.setup, mean=np.array([-1.2, -0.1, 1e-4, 0.0]))))
    assert not rod.stretches
    assert rod.relaxation == ()
    assert rod.instantaneous == 1.0


# tables


def test_tables_hold_the_band_where_there_is_one(tmp_path: Path) -> None:
    uncertain = banded(shape=True)
    rod = of_band(uncertain)
    draws = drawn(rod, 12, seed=0)
    found = columns(rod, draws)
    np.testing.assert_allclose(found["EI_lo_N_m2"], 0.2 * uncertain.band(found["s"]).low)
    np.testing.assert_allclose(found["k_07_N_m"], draws[6].beam.stiffness(found["s"]))
    assert [name for name in found if re.fullmatch(r"k_\d+_N_m", name)] == [f"k_{i:02d}_N_m" for i in range(1, 13)]
    assert np.isnan(columns(rod_sample(SMOOTH))["k_lo_N_m"]).all()
    assert np.isnan(found["EA_N"]).all()
    np.testing.assert_allclose(columns(rod_sample(THICK))["EA_N"], rod_sample(THICK).axial(found["s"])[0])
    doubtful = banded(doubts=("it was edited",))
    assert not columns(of_band(doubtful))["identified"].any()
    for kind in TABLES:
        (tmp_path / kind).write_bytes(export(rod, kind, samples=draws))  # type: ignore[arg-type]
    with np.load(tmp_path / "numpy") as back:
        np.testing.assert_array_equal(back["k_12_N_m"], found["k_12_N_m"])
    np.testing.assert_array_equal(parquet.read_table(tmp_path / "parquet")["k_hi_N_m"], found["k_hi_N_m"])
    np.testing.assert_array_equal(csv.read_csv(tmp_path / "csv")["k_hi_N_m"], found["k_hi_N_m"])


# files for programs


def test_mujoco_has_a_site_at_every_tag() -> None:
    model = mujoco.MjModel.from_xml_string(str(export(rod_sample(SMOOTH, sites=(0.5,)), "mujoco")))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    along = 0.075 * np.array([np.cos(0.1), np.sin(0.1), 0.0])
    np.testing.assert_allclose(data.site("s_0.500").xpos, along, atol=1e-12)
    np.testing.assert_allclose(data.site("tip").xpos, 2.0 * along, atol=1e-12)


def test_sdf_holds_the_same_chain() -> None:
    rod = rod_sample(SMOOTH, damping_time=0.05)
    chain = chain_of(rod, 20)
    model = Xml.fromstring(str(export(rod, "sdf", hinges=20))).find("model")
    assert model is not None
    damping = [float(one.text or "nan") for one in model.iter("damping")]
    masses = [float(one.text or "nan") for one in model.iter("mass")]
    np.testing.assert_allclose(damping, 0.05 * chain.stiffness)
    np.testing.assert_allclose(masses, chain.link_mass)
    joints = {one.get("name"): (one.findtext("parent"), one.findtext("child")) for one in model.iter("joint")}
    assert joints["clamp"] == ("world", "link_0")
    assert joints["hinge_19"] == ("link_19", "link_20")


def test_the_function_needs_no_package_and_names_mistakes(tmp_path: Path) -> None:
    file = tmp_path / "beam.py"
    file.write_text(str(export(SMOOTH, "python")), encoding="utf-8")
    code = "import sys, beam; beam.shape((0.0, 0.1)); print(sorted({m.split('.')[0] for m in sys.modules}))"
    done = subprocess.run([sys.executable, "-S", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "numpy" not in done.stdout
    assert "onebend" not in done.stdout
    module = loaded(str(export(SMOOTH, "python")), "alone")
    with pytest.raises(ValueError, match="between 0"):
        module.shape((0.0, 0.1), at_s=1.5)


def test_the_function_knows_the_angle_too() -> None:
    for beam in (SMOOTH, THICK):
        _, _, alpha = loaded(str(export(beam, "python")), "alone").shape((0.1, 0.3), 0.8, (0.3, 1.0), (0.0, -9.81))
        exact = beam.equilibrium((0.1, 0.3), 0.8, gravity=(0.0, -9.81)).angle(np.array([0.3, 1.0]))
        np.testing.assert_allclose(alpha, exact, atol=1e-7)


def test_the_function_knows_its_derivatives() -> None:
    """By which it finds the tip's angle, and a shape that is not stable."""
    module = loaded(str(export(THICK, "python")), "alone")
    row, pull, step = (0.7, 0.01, 1.0, 0.0, 0.0, 0.0), (0.3, -0.8, 0.0, -9.81), 1e-6
    ahead, behind = (module._slope((0.7 + way, *row[1:]), 0.4, pull) for way in (step, -step))
    assert module._slope(row, 0.4, pull)[3] == pytest.approx((ahead[1] - behind[1]) / (2.0 * step), rel=1e-7)


@pytest.mark.slow
def test_pyelastica_is_given_the_beams_bending_stretch_and_mass() -> None:
    module = loaded(str(export(THICK, "pyelastica")), "elastica_rod")
    rod = module.make_rod(24)
    give = np.sum(1.0 / rod.bend_matrix[0, 0]) * THICK.length / 24
    assert give == pytest.approx(np.trapezoid(1.0 / THICK.stiffness(S), S), rel=1e-4)
    np.testing.assert_array_equal(rod.bend_matrix[0, 0], rod.bend_matrix[1, 1])
    assert np.sum(rod.rest_kappa[0]) * THICK.length / 24 == pytest.approx(0.3, rel=1e-3)
    assert rod.mass.sum() == pytest.approx(THICK.length * 0.3, rel=1e-6)
    for row, along in zip((2, 0), rod_sample(THICK).axial(S), strict=True):
        assert np.mean(1.0 / rod.shear_matrix[row, row]) == pytest.approx(np.trapezoid(1.0 / along, S), rel=1e-4)


# the sheet


def text_on(page: bytes) -> str:
    document = pypdfium2.PdfDocument(page)
    assert len(document) == 1
    words: str = document[0].get_textpage().get_text_range()
    document.close()
    return words


def test_a_sheet_says_ei_e_verdict_and_how_it_was_measured() -> None:
    uncertain = banded(shape=True)
    rod = replace(
        of_band(uncertain),
        section=stated("circle", 0.012),
        push=((0.0, 0.2), 1.0),
        damping_time=0.012,
        told=(("measured", "a film of $10 and é中"), ("verdict", "k(s) holds")),
    )
    page = bytes(export(rod, "sheet"))  # type: ignore[arg-type]
    words = text_on(page)
    for expected in ("EI(s) [N m²], with its 95 % band", "Young's modulus", "k(s) holds", "$10", "200 mm", "0.012 s"):
        assert expected in words, expected
    assert f"{0.2 * uncertain.band(np.zeros(1)).low[0]:#.3g}" in words
    assert bytes(export(rod, "sheet")) == page  # type: ignore[arg-type]


def test_a_sheet_of_a_beam_without_a_band_says_so() -> None:
    words = text_on(bytes(export(SMOOTH, "sheet")))  # type: ignore[arg-type]
    assert "no band was learned" in words
    assert "Young" not in words


# the command, and its page


def test_what_cannot_be_exported_says_so() -> None:
    light = Beam(0.15, Uniform(0.02))
    with pytest.raises(ExportError, match="mass_kg"):
        export(light, "mujoco")
    assert "link_40" in str(export(rod_sample(light, mass=0.03), "mujoco"))
    with pytest.raises(ExportError, match="positive number of kg"):
        rod_sample(light, mass=-1.0)
    with pytest.raises(ExportError, match="2 hinges"):
        export(SMOOTH, "urdf", hinges=1)
    with pytest.raises(ExportError, match="damping time"):
        rod_sample(SMOOTH, damping_time=0.0)
    with pytest.raises(ExportError, match="not positive at s = 1"):
        export(Beam(0.15, Table((0.0, 1.0), (1.0, 0.0)), mass_per_length=Uniform(0.1)), "python")
    with pytest.raises(ExportError, match="1 masses ride on this beam; export a chain"):
        export(replace(SMOOTH, masses=(PointMass(0.5, 0.01),)), "pyelastica")
    with pytest.raises(ExportError, match="no export to 'blender'"):
        export(SMOOTH, "blender")  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", list(KINDS))
def test_the_command_writes_every_kind_and_replaces_none_unasked(kind: str, tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", SMOOTH, written_by="a test")
    out = tmp_path / "deep" / f"out{KINDS[kind].suffix}"  # type: ignore[index]
    arguments = ["export", str(tmp_path), "--to", kind, "-o", str(out)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    first = out.read_bytes()
    refused = CliRunner().invoke(app, arguments)
    assert refused.exit_code == 2
    assert "--force" in refused.stderr
    assert CliRunner().invoke(app, [*arguments, "--force"]).exit_code == 0
    assert kind == "parquet" or out.read_bytes() == first
    beside = [out.with_suffix(".csv").name] if kind == "sheet" else []
    assert sorted(path.name for path in out.parent.iterdir()) == sorted([out.name, *beside])


def test_the_command_draws_files_or_columns(tmp_path: Path) -> None:
    uncertain = banded(shape=True)
    stored = StoredModel(of_band(uncertain).beam, None, uncertain)
    (tmp_path / "model.json").write_text(model_text(stored, written_by="a test"), encoding="utf-8")

    def run(*arguments: str) -> str:
        done = CliRunner().invoke(app, ["export", str(tmp_path), *arguments])
        return done.stdout if done.exit_code == 0 else done.stderr

    out = tmp_path / "many" / "b.xml"
    said = run("--to", "mujoco", "--samples", "12", "--seed", "7", "-o", str(out))
    assert "b-01.xml and 11 more" in said
    names = sorted(path.name for path in out.parent.iterdir())
    assert names == [f"b-{i:02d}.xml" for i in range(1, 13)]
    mine = drawn(sample_of_model(stored), 12, seed=7)
    for name, one in zip(names, mine, strict=True):
        model = mujoco.MjModel.from_xml_path(str(out.parent / name))
        np.testing.assert_allclose(model.jnt_stiffness.ravel(), chain_of(one).stiffness)
    (out.parent / "b-05.xml").unlink()
    (out.parent / "b-01.xml").unlink()
    assert "exists already" in run("--to", "mujoco", "--samples", "12", "--seed", "8", "-o", str(out))
    assert not (out.parent / "b-01.xml").exists()  # all or none
    run("--to", "csv", "--samples", "3", "-o", str(tmp_path / "t.csv"))
    assert "k_3_N_m" in csv.read_csv(tmp_path / "t.csv").column_names
    assert "a sheet shows the band" in run("--to", "sheet", "--samples", "3", "-o", str(tmp_path / "t.pdf"))
    save_model(tmp_path / "model.json", SMOOTH, written_by="a test")
    assert "no band to draw from" in run("--to", "urdf", "--samples", "3", "-o", str(tmp_path / "t.urdf"))


def test_the_sheet_quotes_the_verdict_of_its_folder(tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", SMOOTH, written_by="a test")
    (tmp_path / "summary.json").write_text(json.dumps({"verdict": {"headline": "k(s) holds here"}}), encoding="utf-8")
    arguments = ["export", str(tmp_path), "--to", "sheet", "-o", str(tmp_path / "a.pdf")]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert "k(s) holds here" in text_on((tmp_path / "a.pdf").read_bytes())
    edited = (tmp_path / "model.json").read_text(encoding="utf-8").replace("0.03", "0.04", 1)
    (tmp_path / "model.json").write_text(edited, encoding="utf-8")
    assert CliRunner().invoke(app, [*arguments, "--force"]).exit_code == 0
    words = text_on((tmp_path / "a.pdf").read_bytes())
    assert "NOT TO BE TRUSTED" in words
    assert "holds here" not in words


READ_BACK: dict[Kind, tuple[str, str]] = {  # error of the shape in these tests; package and version that read it
    "mujoco": ("0.02 % L", "mujoco 4.0"),
    "mujoco-flex": ("0.02 % L", "mujoco 4.0"),
    "newton": ("0.3 % L", "newton 1.8"),
    "pyelastica": ("0.1 % L", "pyelastica 1.0"),
    "sofa": ("0.05 % L", "its equations, not SOFA"),
    "usd": ("0.02 % L", "usd-core 26.11"),
    "urdf": ("0.02 % L", "mujoco 4.0"),
    "sdf": ("0.02 % L", "mujoco 4.0; drake 1.51"),
    "python": ("1e-9 L; 0.04 % L where k(s) steps", "-"),
}


def kinds_table() -> str:
    """The table of the page."""
    heads = ("`--to`", "content", *PARTS, "band", "error of the shape", "tested with")
    rows = [heads, ("---",) * len(heads)]
    for name, one in KINDS.items():
        band = "yes, and draws" if name in TABLES else "yes" if name == "sheet" else "draws"
        parts = ("yes" if part in one.carries else "no" for part in PARTS)
        rows.append((f"`{name}`", one.says, *parts, band, *READ_BACK.get(name, ("-", "-"))))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def test_the_page_has_the_table_of_the_kinds() -> None:
    assert kinds_table() in PAGE.read_text(encoding="utf-8"), kinds_table()


def test_the_page_names_the_versions_that_are_tested_here() -> None:
    for one in (tested for _, packages in READ_BACK.values() for tested in packages.split("; ")):
        name, _, number = one.partition(" ")
        if re.fullmatch(r"[\d.]+", number) and _installed(name):
            assert version(name).startswith(f"{number}."[: len(number)]), one


def test_a_file_is_not_written_where_a_folder_stands(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="is a folder"):
        write_file(tmp_path, "text")
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match="cannot be written"):
        write_file(tmp_path / "file" / "inside", "text")
