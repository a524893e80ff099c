"""Every export is loaded back by the software that it is for, and bends there as the beam does here."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
import pyarrow.parquet as parquet
import pytest
from typer.testing import CliRunner

from onebend.beam.model import Beam
from onebend.beam.stiffness import Table, UncertainStiffness, Uniform
from onebend.cli import app
from onebend.errors import ExportError, ResultsError
from onebend.export.export import KINDS, chain_of, columns, export, function, mjcf, pyelastica, sdf, urdf
from onebend.files.single_file import write_file
from onebend.records import Array
from onebend.results.model import save_model

GRAVITY = (0.0, -9.81)
PLACES = (1 / 3, 2 / 3, 1.0)
PUSHES = (((0.0, 0.3), 1.0), ((0.1, 0.4), 0.6), ((-0.2, 0.2), 1.0))  # N, s
BEAM = Beam(
    0.15,
    Table((0.0, 0.5, 1.0), (0.03, 0.015, 0.005)),
    rest_curvature=Table((0.0, 1.0), (0.1, 0.5)),
    clamp_angle=0.1,
    mass_per_length=Table((0.0, 1.0), (0.4, 0.2)),
)


def test_a_chain_keeps_mass_moment_of_mass_compliance_and_turn() -> None:
    chain = chain_of(BEAM, 7)
    s = np.linspace(0.0, 1.0, 20001)
    mu = np.asarray(BEAM.mass_per_length(s))
    begins = np.concatenate([[0.0], BEAM.length * chain.hinge_s])
    assert chain.link_mass.sum() == pytest.approx(BEAM.length * np.trapezoid(mu, s), rel=1e-8)
    moment = np.sum(chain.link_mass * (begins + chain.link_centre))
    assert moment == pytest.approx(BEAM.length**2 * np.trapezoid(mu * s, s), rel=1e-8)
    second = np.sum(chain.link_inertia + chain.link_mass * (begins + chain.link_centre) ** 2)
    assert second == pytest.approx(BEAM.length**3 * np.trapezoid(mu * s**2, s), rel=1e-8)
    assert np.sum(1 / chain.stiffness) == pytest.approx(np.trapezoid(1 / BEAM.stiffness(s), s), rel=1e-6)
    assert chain.rest.sum() == pytest.approx(0.3, rel=1e-9)
    assert chain.link_length.sum() == pytest.approx(BEAM.length)


def test_a_place_lies_on_its_link() -> None:
    chain = chain_of(BEAM, 4)  # hinges at 1/8, 3/8, 5/8, 7/8
    assert chain.link_of(0.0) == (0, 0.0)
    np.testing.assert_allclose(chain.link_of(0.5), (2, 0.125 * BEAM.length))
    np.testing.assert_allclose(chain.link_of(1.0), (4, 0.125 * BEAM.length))


def bent_by_mujoco(model: Any, hinges: int, force: tuple[float, float], at_s: float) -> Array:
    """(3, 2) m, places of the chain brought to rest, from the bodies' poses alone."""
    chain = chain_of(BEAM, hinges)
    model.opt.gravity[:] = (*GRAVITY, 0.0)
    data = mujoco.MjData(model)

    def place(s: float) -> tuple[Array, int]:
        link, along = chain.link_of(s)
        body = model.body(f"link_{link}").id
        return data.xpos[body] + data.xmat[body].reshape(3, 3) @ [along, 0.0, 0.0], body

    for step in range(6000):
        point, body = place(at_s)
        data.qfrc_applied[:] = 0.0
        mujoco.mj_applyFT(model, data, np.array([*force, 0.0]), np.zeros(3), point, body, data.qfrc_applied)
        mujoco.mj_step(model, data)
        if step > 100 and np.abs(data.qvel).max() < 1e-6:
            break
    return np.array([place(s)[0][:2] for s in PLACES])


def off(found: Array, force: tuple[float, float], at_s: float) -> float:
    """Largest distance from the exact beam, in lengths."""
    exact = BEAM.equilibrium(force, at_s, gravity=GRAVITY).xy(np.array(PLACES))
    return float(np.linalg.norm(found - exact, axis=1).max() / BEAM.length)


@pytest.mark.parametrize(("force", "at_s"), PUSHES)
def test_mujoco_bends_as_the_beam_does(force: tuple[float, float], at_s: float) -> None:
    model = mujoco.MjModel.from_xml_string(mjcf(chain_of(BEAM, 40), sites=(0.5,)))
    assert off(bent_by_mujoco(model, 40, force, at_s), force, at_s) < 2e-4
    assert model.site("s_0.500").id >= 0


def test_the_chain_converges_with_the_square_of_its_hinges() -> None:
    errors = []
    for hinges in (5, 10, 20):
        model = mujoco.MjModel.from_xml_string(mjcf(chain_of(BEAM, hinges)))
        errors.append(off(bent_by_mujoco(model, hinges, *PUSHES[2]), *PUSHES[2]))
    slope = np.polyfit(np.log([5, 10, 20]), np.log(errors), 1)[0]
    assert -2.4 < slope < -1.7


@pytest.mark.parametrize(("force", "at_s"), PUSHES)
def test_urdf_bends_as_the_beam_does_with_its_springs(force: tuple[float, float], at_s: float) -> None:
    text = urdf(chain_of(BEAM, 20))
    # MuJoCo reads URDF without its springs; told so, it keeps `link_0`, which is welded to the world, as a body
    keep = '<mujoco><compiler fusestatic="false" balanceinertia="true"/></mujoco>'
    spec = mujoco.MjSpec.from_string(text.replace('<link name="clamp" />', f'{keep}<link name="clamp" />'))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for spring in Xml.fromstring(text).iter("gazebo"):
        joint = spec.joint(spring.get("reference"))
        joint.stiffness[0] = float(spring.findtext("springStiffness", "nan"))
        joint.springref = float(spring.findtext("springReference", "nan"))
    assert off(bent_by_mujoco(spec.compile(), 20, force, at_s), force, at_s) < 1e-3


def test_sdf_holds_the_same_chain() -> None:
    chain = chain_of(BEAM, 20)
    model = Xml.fromstring(sdf(chain, damping_time=0.05)).find("model")
    assert model is not None
    springs = [float(one.text or "nan") for one in model.iter("spring_stiffness")]
    turns = [float(one.text or "nan") for one in model.iter("spring_reference")]
    damping = [float(one.text or "nan") for one in model.iter("damping")]
    masses = [float(one.text or "nan") for one in model.iter("mass")]
    np.testing.assert_allclose(springs, chain.stiffness)
    np.testing.assert_allclose(turns, chain.rest)
    np.testing.assert_allclose(damping, 0.05 * chain.stiffness)
    np.testing.assert_allclose(masses, chain.link_mass)
    joints = {one.get("name"): (one.findtext("parent"), one.findtext("child")) for one in model.iter("joint")}
    assert joints["clamp"] == ("world", "link_0")
    assert joints["hinge_19"] == ("link_19", "link_20")


def loaded(source: str, name: str) -> ModuleType:
    module = ModuleType(name)
    exec(compile(source, name, "exec"), module.__dict__)
    return module


@pytest.mark.parametrize(("force", "at_s"), PUSHES)
def test_the_function_bends_as_the_beam_does(force: tuple[float, float], at_s: float) -> None:
    x, y, alpha = loaded(function(BEAM), "alone").shape(force, at_s, PLACES, GRAVITY)
    assert off(np.column_stack([x, y]), force, at_s) < 1e-8
    exact = BEAM.equilibrium(force, at_s, gravity=GRAVITY).angle(np.array(PLACES))
    np.testing.assert_allclose(alpha, exact, atol=1e-7)


def test_the_function_needs_no_package_and_names_mistakes(tmp_path: Path) -> None:
    file = tmp_path / "beam.py"
    file.write_text(function(BEAM), encoding="utf-8")
    code = "import sys, beam; beam.shape((0.0, 0.1)); print(sorted({m.split('.')[0] for m in sys.modules}))"
    done = subprocess.run([sys.executable, "-S", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "numpy" not in done.stdout
    assert "onebend" not in done.stdout
    module = loaded(function(BEAM), "alone")
    with pytest.raises(ValueError, match="between 0"):
        module.shape((0.0, 0.1), at_s=1.5)


def test_pyelastica_is_given_the_beams_bending_and_mass() -> None:
    module = loaded(pyelastica(BEAM), "rod")
    rod = module.make_rod(24)
    s = np.linspace(0.0, 1.0, 20001)
    give = np.sum(1.0 / rod.bend_matrix[0, 0]) * BEAM.length / 24
    assert give == pytest.approx(np.trapezoid(1.0 / BEAM.stiffness(s), s), rel=1e-4)
    np.testing.assert_array_equal(rod.bend_matrix[0, 0], rod.bend_matrix[1, 1])
    assert np.sum(rod.rest_kappa[0]) * BEAM.length / 24 == pytest.approx(0.3, rel=1e-3)
    assert rod.mass.sum() == pytest.approx(BEAM.length * 0.3, rel=1e-6)


@pytest.mark.slow  # PyElastica compiles itself first, for a minute
@pytest.mark.parametrize(("force", "at_s"), PUSHES)
def test_pyelastica_bends_as_the_beam_does(force: tuple[float, float], at_s: float) -> None:
    import elastica

    class Simulator(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping):  # type: ignore[misc]
        pass

    class Push(elastica.NoForces):  # type: ignore[misc]
        def apply_forces(self, system: Any, time: float = 0.0) -> None:  # noqa: ARG002
            system.external_forces[:, round(20 * at_s)] += [*force, 0.0]

    module = loaded(pyelastica(BEAM), "rod")
    rod, step = module.make_rod(20, 0.003), module.time_step(20, 0.003)
    simulator = Simulator()
    simulator.append(rod)
    simulator.constrain(rod).using(elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    simulator.add_forcing_to(rod).using(Push)
    simulator.add_forcing_to(rod).using(elastica.GravityForces, acc_gravity=np.array([*GRAVITY, 0.0]))
    simulator.dampen(rod).using(elastica.AnalyticalLinearDamper, uniform_damping_constant=20.0, time_step=step)
    simulator.finalize()
    elastica.integrate(elastica.PositionVerlet(), simulator, 1.2, int(1.2 / step), progress_bar=False)
    exact = BEAM.equilibrium(force, at_s, gravity=GRAVITY).xy(np.linspace(0.0, 1.0, 21))
    assert np.linalg.norm(rod.position_collection[:2].T - exact, axis=1).max() < 0.005 * BEAM.length


def test_tables_hold_the_band_where_there_is_one(tmp_path: Path) -> None:
    knots = np.r_[0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]
    uncertain = UncertainStiffness(knots, np.log([0.02] * 4), np.diag([0.01, 0.01, 0.01, 1.0]))
    beam = Beam(0.2, uncertain.profile)
    found = columns(beam, uncertain)
    np.testing.assert_allclose(found["EI_lo_N_m2"], 0.2 * uncertain.band(found["s"]).low)
    assert found["identified"][0] == 1.0
    assert found["identified"][-1] == 0.0
    assert np.isnan(columns(beam)["k_lo_N_m"]).all()
    with np.load(io.BytesIO(bytes(export(beam, "numpy", uncertain=uncertain)))) as back:  # type: ignore[arg-type]
        np.testing.assert_array_equal(back["k_N_m"], found["k_N_m"])
    (tmp_path / "b.parquet").write_bytes(export(beam, "parquet", uncertain=uncertain))  # type: ignore[arg-type]
    np.testing.assert_array_equal(parquet.read_table(tmp_path / "b.parquet")["k_hi_N_m"], found["k_hi_N_m"])


def test_what_cannot_be_exported_says_so() -> None:
    light = Beam(0.15, Uniform(0.02))
    with pytest.raises(ExportError, match="mass_kg"):
        export(light, "mujoco")
    assert "link_40" in str(export(light, "mujoco", mass=0.03))
    with pytest.raises(ExportError, match="positive number of kg"):
        export(light, "sdf", mass=-1.0)
    with pytest.raises(ExportError, match="2 hinges"):
        export(BEAM, "urdf", hinges=1)
    with pytest.raises(ExportError, match="damping time"):
        export(BEAM, "mujoco", damping_time=0.0)
    with pytest.raises(ExportError, match="not positive at s = 1"):
        export(Beam(0.15, Table((0.0, 1.0), (1.0, 0.0)), mass_per_length=Uniform(0.1)), "python")
    with pytest.raises(ExportError, match="no export to 'blender'"):
        export(BEAM, "blender")  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", list(KINDS))
def test_the_command_writes_every_kind_and_replaces_none_unasked(kind: str, tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", BEAM, written_by="a test")
    out = tmp_path / "deep" / f"out{KINDS[kind].suffix}"  # type: ignore[index]
    arguments = ["export", str(tmp_path), "--to", kind, "-o", str(out)]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    first = out.read_bytes()
    refused = CliRunner().invoke(app, arguments)
    assert refused.exit_code == 2
    assert "--force" in refused.stderr
    assert CliRunner().invoke(app, [*arguments, "--force"]).exit_code == 0
    assert kind == "parquet" or out.read_bytes() == first
    assert [path.name for path in out.parent.iterdir()] == [out.name]


def test_a_file_is_not_written_where_a_folder_stands(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="is a folder"):
        write_file(tmp_path, "text")
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match="cannot be written"):
        write_file(tmp_path / "file" / "inside", "text")
