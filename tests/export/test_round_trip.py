"""Every export is loaded back by the software that it is for, and hangs there under loads as the exact beam does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from onebend.beam.model import Beam
from onebend.beam.stiffness import Steps, Table, Uniform
from onebend.export.export import KINDS, Kind, export
from onebend.export.sample import Relaxing, rod_sample
from onebend.records import Array
from tests.export.simulators import GRAVITY, PLACES, SIMULATORS, Force, InNewton, Node, loaded, numbers, text_of

PUSHES: tuple[tuple[Force, float], ...] = (((0.0, 0.3), 1.0), ((0.1, 0.4), 0.6), ((-0.2, 0.2), 1.0))  # N, s
SMOOTH = Beam(
    0.15,
    Table((0.0, 0.5, 1.0), (0.03, 0.015, 0.005)),
    rest_curvature=Table((0.0, 1.0), (0.1, 0.5)),
    clamp_angle=0.1,
    mass_per_length=Table((0.0, 1.0), (0.4, 0.2)),
)
STEP = Beam(0.15, Steps((0.0, 0.43, 1.0), (0.03, 0.01)), rest_curvature=Uniform(-0.4), mass_per_length=Uniform(0.3))
BEAMS = {"smooth": SMOOTH, "step": STEP, "thick": replace(SMOOTH, thickness=0.012)}
# of the length, at the default number of segments
MOST: dict[Kind, float] = {
    "mujoco": 2e-4,
    "mujoco-flex": 2e-4,
    "newton": 5e-3,
    "pyelastica": 1e-3,
    "sofa": 5e-4,
    "usd": 2e-4,
    "urdf": 2e-4,
    "sdf": 2e-4,
    "python": 4e-4,
}
SLOW: tuple[Kind, ...] = ("pyelastica", "newton")  # minutes; each compiles itself first


def error(kind: Kind, beam: Beam, segments: int, push: tuple[Force, float]) -> float:
    """Largest distance from the exact beam at a third, the middle and the tip, in lengths."""
    rod = rod_sample(beam, damping_time=0.002 if kind == "newton" else None)
    exact = beam.equilibrium(*push, gravity=GRAVITY).xy(PLACES)
    return float(np.linalg.norm(SIMULATORS[kind](rod, segments, *push) - exact, axis=1).max() / beam.length)


def as_carried(kind: Kind, name: str) -> Beam:
    """The beam without what this kind says that it leaves out."""
    beam = BEAMS[name]
    return beam if "rest shape" in KINDS[kind].carries else replace(beam, rest_curvature=Uniform(0.0))


@pytest.mark.parametrize("push", PUSHES)
@pytest.mark.parametrize("name", BEAMS)
@pytest.mark.parametrize("kind", [pytest.param(k, marks=pytest.mark.slow) if k in SLOW else k for k in SIMULATORS])
def test_it_hangs_there_as_the_beam_does(kind: Kind, name: str, push: tuple[Force, float]) -> None:
    if name == "thick" and "stretch and shear" not in KINDS[kind].carries:
        pytest.skip("it does not stretch there")
    if kind in SLOW and name == "thick" and push != PUSHES[1]:
        pytest.skip("one load is enough")
    segments = 50 if kind == "pyelastica" else KINDS[kind].hinges
    assert error(kind, as_carried(kind, name), segments, push) < MOST[kind]


@pytest.mark.parametrize(
    ("kind", "name"),
    [(k, "smooth") for k in SIMULATORS if k not in (*SLOW, "python")] + [("mujoco", "thick"), ("usd", "thick")],
)
def test_it_converges_with_the_square_of_the_segments(kind: Kind, name: str) -> None:
    counts = (5, 10, 20)
    errors = [error(kind, as_carried(kind, name), n, PUSHES[2]) for n in counts]
    assert -2.4 < np.polyfit(np.log(counts), np.log(errors), 1)[0] < -1.7


@pytest.mark.slow
def test_pyelastica_converges_too() -> None:
    counts = (8, 16, 32)
    errors = [error("pyelastica", BEAMS["thick"], n, PUSHES[2]) for n in counts]
    assert np.polyfit(np.log(counts), np.log(errors), 1)[0] < -1.3


@pytest.mark.slow
def test_newton_converges_too() -> None:
    assert error("newton", BEAMS["thick"], 4, PUSHES[1]) > 4.0 * error("newton", BEAMS["thick"], 12, PUSHES[1])


def test_the_function_is_exact() -> None:
    for name in ("smooth", "thick"):
        assert error("python", BEAMS[name], 2, PUSHES[1]) < 1e-8


@pytest.mark.slow
def test_what_newton_reads_of_usd_are_the_springs() -> None:
    newton, usd = pytest.importorskip("newton"), pytest.importorskip("pxr.Usd")
    stage = usd.Stage.CreateInMemory()
    text = text_of(rod_sample(SMOOTH), "usd", 6)
    assert stage.GetRootLayer().ImportFromString(text)
    builder = newton.ModelBuilder()
    builder.add_usd(stage)
    turns = [i for i, kind in enumerate(builder.joint_type) if kind == newton.JointType.REVOLUTE]
    chain = numbers(text_of(rod_sample(SMOOTH), "newton", 6))
    dofs = [builder.joint_qd_start[i] for i in turns]
    np.testing.assert_allclose([builder.joint_target_ke[i] for i in dofs], chain["BEND_N_M"], rtol=1e-5)
    np.testing.assert_allclose(builder.body_mass[-6:], chain["LINK_MASS_KG"][1:], rtol=1e-5)


# A beam that relaxes: under a load from t = 0 the bending grows as
# `F (1 + a / (1 - a) (1 - exp(-(1 - a) t / tau))) / EI`, as long as it is small.

SHARE, TAU = 0.3, 0.5
RELAXING = replace(
    rod_sample(Beam(0.15, Uniform(0.02), mass_per_length=Uniform(0.3), thickness=0.012), damping_time=0.002),
    relaxation=(Relaxing(SHARE, TAU),),
    instantaneous=1.1,
)


def crept(seconds: float) -> float:
    """Over the deflection at once."""
    return 1.0 + SHARE / (1.0 - SHARE) * (1.0 - float(np.exp(-(1.0 - SHARE) * seconds / TAU)))


def at_once(load: float) -> float:
    """m, deflection of the tip."""
    stiff = replace(RELAXING.beam, stiffness=Uniform(1.1 * 0.02))
    return float(stiff.equilibrium((0.0, load)).xy(1.0)[1])


@pytest.mark.slow
def test_pyelastica_relaxes() -> None:
    elastica: Any = pytest.importorskip("elastica")

    class Simulator(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping):  # type: ignore[misc]
        pass

    module = loaded(str(export(RELAXING, "pyelastica")), "elastica_rod")
    rod, step = module.make_rod(20), module.time_step(20)
    simulator = Simulator()
    simulator.append(rod)
    simulator.constrain(rod).using(elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    load = np.array([0.0, 0.02, 0.0])
    simulator.add_forcing_to(rod).using(elastica.EndpointForces, 0.0 * load, load, ramp_up_time=1e-3)
    simulator.add_forcing_to(rod).using(module.RodRelaxation, rod=rod, time_step=step)
    simulator.dampen(rod).using(elastica.AnalyticalLinearDamper, uniform_damping_constant=10.0, time_step=step)
    simulator.finalize()
    for seconds, until, near in ((1.0, 1.0, 0.03), (3.0, 4.0, 0.02)):
        elastica.integrate(elastica.PositionVerlet(), simulator, seconds, int(seconds / step), progress_bar=False)
        assert rod.position_collection[1, -1] == pytest.approx(at_once(0.02) * crept(until), rel=near)


@pytest.mark.slow
def test_newton_relaxes() -> None:
    there = InNewton(RELAXING, 6, iterations=30)
    relaxation = there.module.JointRelaxation(there.model, there.solver, there.joints)
    there.move((0.0, 0.02), 1.0, 2.5, lambda: relaxation.step(there.state, there.seconds))
    exact = replace(RELAXING.beam, stiffness=Uniform(RELAXING.relaxed * 0.02)).equilibrium((0.0, 0.02), gravity=GRAVITY)
    assert there.place(1.0)[1][1] == pytest.approx(float(exact.xy(1.0)[1]), rel=0.05)


def test_a_sofa_scene_names_what_it_needs() -> None:
    scene = Node()
    loaded(text_of(rod_sample(SMOOTH), "sofa", 5), "sofa").createScene(scene)
    law = scene.children["bending"].objects["BeamHookeLawForceField"]
    assert law["variantSections"]
    assert len(law["youngModulusList"]) == len(law["poissonRatioList"]) == len(law["length"]) == 5
    assert "RequiredPlugin Cosserat" in scene.objects


def test_sofa_bends_it() -> None:
    sofa, simulation = pytest.importorskip("Sofa"), pytest.importorskip("Sofa.Simulation")
    root = sofa.Core.Node("root")
    loaded(text_of(rod_sample(STEP), "sofa", 40), "sofa").createScene(root)
    root.gravity = [*GRAVITY, 0.0]
    simulation.init(root)
    for _ in range(500):
        simulation.animate(root, 0.01)
    tip: Array = np.array(root.clamp.frames.frames.position.value)[-1, :2]
    assert np.linalg.norm(tip - STEP.equilibrium((0.0, 0.0), gravity=GRAVITY).xy(1.0)) < 0.005 * STEP.length
