"""Beams brought to rest by the software that the exports are for: each function tells where some places end up."""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.util import find_spec
from types import ModuleType
from typing import Any
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
import pytest
from scipy.optimize import root

from onebend.export.chain import Chain, chain_of
from onebend.export.export import Kind, export
from onebend.export.sample import RodSample
from onebend.records import Array

GRAVITY = (0.0, -9.81)
PLACES = np.array([1 / 3, 0.5, 1.0])
Force = tuple[float, float]
Bent = Callable[[RodSample, int, Force, float], Array]  # (3, 2) m, at PLACES, under a force [N] at s and GRAVITY


def text_of(rod: RodSample, kind: Kind, hinges: int) -> str:
    return str(export(rod, kind, hinges=hinges))


def loaded(source: str, name: str) -> ModuleType:
    module = ModuleType(name)
    exec(compile(source, name, "exec"), module.__dict__)
    return module


def numbers(source: str) -> dict[str, Any]:
    """The beam's numbers in a Python file, whose packages need not be there."""
    there: dict[str, Any] = {}
    exec(source.split("# ---")[1].split("\n", 1)[1], there)
    return there


def settled(model: Any, chain: Chain, force: Force, at_s: float) -> Array:
    """A chain of bodies `link_i` in MuJoCo, brought to rest."""
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
    return np.array([place(float(s))[0][:2] for s in PLACES])


def in_mujoco(rod: RodSample, hinges: int, force: Force, at_s: float) -> Array:
    model = mujoco.MjModel.from_xml_string(text_of(rod, "mujoco", hinges))
    return settled(model, chain_of(rod, hinges), force, at_s)


def in_mujoco_flex(rod: RodSample, hinges: int, force: Force, at_s: float) -> Array:
    """The force acts on the two vertices beside its place."""
    model = mujoco.MjModel.from_xml_string(text_of(rod, "mujoco-flex", hinges))
    model.opt.gravity[:] = (*GRAVITY, 0.0)
    data, joints = mujoco.MjData(model), chain_of(rod, hinges).joints

    def share(s: float) -> tuple[int, float]:
        i = min(int(np.searchsorted(joints, s * joints[-1], side="right")) - 1, len(joints) - 2)
        return i, (s * joints[-1] - joints[i]) / (joints[i + 1] - joints[i])

    first, part = share(at_s)
    ids = [model.body(f"vertex_{i}").id for i in range(len(joints))]
    data.xfrc_applied[ids[first], :2] = (1.0 - part) * np.array(force)
    data.xfrc_applied[ids[first + 1], :2] = part * np.array(force)
    for step in range(8000):
        mujoco.mj_step(model, data)
        if step > 100 and np.abs(data.qvel).max() < 1e-7:
            break
    at = [(ids[i], ids[i + 1], u) for i, u in (share(float(s)) for s in PLACES)]
    return np.array([(1.0 - u) * data.xpos[a, :2] + u * data.xpos[b, :2] for a, b, u in at])


def in_urdf(rod: RodSample, hinges: int, force: Force, at_s: float) -> Array:
    """MuJoCo reads URDF without its springs; they are handed to it."""
    text = text_of(rod, "urdf", hinges)
    # told so, it keeps `link_0`, which is welded to the world, as a body
    keep = '<mujoco><compiler fusestatic="false" balanceinertia="true"/></mujoco>'
    spec = mujoco.MjSpec.from_string(text.replace('<link name="clamp" />', f'{keep}<link name="clamp" />'))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for spring in Xml.fromstring(text).iter("gazebo"):
        joint = spec.joint(spring.get("reference"))
        joint.stiffness[0] = float(spring.findtext("springStiffness", "nan"))
        joint.springref = float(spring.findtext("springReference", "nan"))
    return settled(spec.compile(), chain_of(rod, hinges), force, at_s)


def in_usd(rod: RodSample, hinges: int, force: Force, at_s: float) -> Array:
    """What usd-core reads of the file, handed to MuJoCo number by number."""
    usd, physics = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdPhysics")
    stage = usd.Stage.CreateInMemory()
    assert stage.GetRootLayer().ImportFromString(text_of(rod, "usd", hinges))
    assert stage.GetDefaultPrim().HasAPI(physics.ArticulationRootAPI)
    spec = mujoco.MjSpec()
    spec.compiler.degree, spec.compiler.balanceinertia = False, True
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    held, degree = physics.FixedJoint.Get(stage, "/onebend/clamp"), 180.0 / math.pi
    turn = held.GetLocalRot0Attr().Get()
    body = spec.worldbody.add_body(name="link_0", quat=[turn.real, *turn.imaginary])
    for i in range(hinges + 1):
        mass = physics.MassAPI.Get(stage, f"/onebend/link_{i}")
        if i > 0:
            joint = physics.Joint.Get(stage, f"/onebend/hinge_{i - 1}")
            assert [str(one) for one in joint.GetBody1Rel().GetTargets()] == [f"/onebend/link_{i}"]
            body = body.add_body(name=f"link_{i}", pos=list(joint.GetLocalPos0Attr().Get()))
            for axis, vector in (
                ("transX", [1, 0, 0]),
                ("transY", [0, 1, 0]),
                ("rotZ", [0, 0, 1]),
                ("angular", [0, 0, 1]),
            ):
                if joint.GetPrim().HasAPI(physics.DriveAPI, axis):
                    drive = physics.DriveAPI.Get(joint.GetPrim(), axis)
                    slides = axis.startswith("trans")
                    body.add_joint(
                        type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
                        axis=vector,
                        stiffness=[drive.GetStiffnessAttr().Get() * (1.0 if slides else degree), 0.0, 0.0],
                        damping=[drive.GetDampingAttr().Get() * (1.0 if slides else degree), 0.0, 0.0],
                        springref=drive.GetTargetPositionAttr().Get() / (1.0 if slides else degree),
                    )
        body.mass, body.ipos = mass.GetMassAttr().Get(), list(mass.GetCenterOfMassAttr().Get())
        body.inertia, body.explicitinertial = list(mass.GetDiagonalInertiaAttr().Get()), True
    return settled(spec.compile(), chain_of(rod, hinges), force, at_s)


def in_sdf(rod: RodSample, hinges: int, force: Force, at_s: float) -> Array:
    """Drake reads the SDF where it is installed; else its numbers are handed to MuJoCo one by one."""
    if find_spec("pydrake") is not None:
        return in_drake(rod, hinges, force, at_s)
    model = Xml.fromstring(text_of(rod, "sdf", hinges)).find("model")
    assert model is not None
    spec = mujoco.MjSpec()
    spec.compiler.degree, spec.compiler.balanceinertia = False, True
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST

    def number(of: Xml.Element, path: str) -> float:
        return float(of.findtext(path, "nan"))

    links = model.findall("link")
    joints = {joint.findtext("child"): joint for joint in model.findall("joint")}
    body, before = spec.worldbody, np.zeros(3)
    for link in links:
        pose, name = np.array(link.findtext("pose", "").split(), dtype=float), str(link.get("name"))
        joint, inertial = joints[name], link.find("inertial")
        assert inertial is not None
        turn, place = pose[5], pose[:3]  # of link_0 in the world, of the others in link_0, straight
        body = body.add_body(
            name=name, pos=list(place - before), quat=[math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2)]
        )
        if joint.get("type") == "revolute":
            assert joint.findtext("axis/xyz") == "0 0 1"
            spring = "axis/dynamics/spring_"
            body.add_joint(
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=[0, 0, 1],
                stiffness=[number(joint, f"{spring}stiffness"), 0.0, 0.0],
                damping=[number(joint, "axis/dynamics/damping"), 0.0, 0.0],
                springref=number(joint, f"{spring}reference"),
            )
        body.mass = number(inertial, "mass")
        body.ipos = [float(one) for one in inertial.findtext("pose", "").split()[:3]]
        body.inertia = [number(inertial, f"inertia/{axis}") for axis in ("ixx", "iyy", "izz")]
        body.explicitinertial, before = True, place
    return settled(spec.compile(), chain_of(rod, hinges), force, at_s)


def in_drake(rod: RodSample, hinges: int, force: Force, at_s: float) -> Array:
    """Drake reads the SDF; at rest its own springs and weights balance the force."""
    plants, parsing = pytest.importorskip("pydrake.multibody.plant"), pytest.importorskip("pydrake.multibody.parsing")
    tree = pytest.importorskip("pydrake.multibody.tree")
    plant = plants.MultibodyPlant(0.0)
    parsing.Parser(plant).AddModelsFromString(text_of(rod, "sdf", hinges), "sdf")
    plant.mutable_gravity_field().set_gravity_vector([*GRAVITY, 0.0])
    plant.Finalize()
    context, world, chain = plant.CreateDefaultContext(), plant.world_frame(), chain_of(rod, hinges)
    forces = tree.MultibodyForces(plant)

    def at(s: float) -> tuple[Any, Array]:
        link, along = chain.link_of(s)
        return plant.GetFrameByName(f"link_{link}"), np.array([along, 0.0, 0.0])

    frame, point = at(at_s)

    def left(q: Array, share: float) -> Array:
        plant.SetPositions(context, q)
        plant.CalcForceElementsContribution(context, forces)
        jacobian = plant.CalcJacobianTranslationalVelocity(
            context, tree.JacobianWrtVariable.kV, frame, point, world, world
        )
        return np.asarray(plant.CalcGeneralizedForces(context, forces) + share * jacobian.T @ [*force, 0.0])

    q = np.zeros(hinges)
    for share in (0.25, 0.5, 0.75, 1.0):
        found = root(left, q, args=(share,), tol=1e-12)
        q = found.x
    assert found.success
    plant.SetPositions(context, q)
    return np.array([plant.CalcPointsPositions(context, *at(float(s)), world)[:2, 0] for s in PLACES])


class Node:
    """A stand-in for SOFA's node: it writes down which objects a scene adds."""

    def __init__(self) -> None:
        self.objects: dict[str, dict[str, Any]] = {}
        self.children: dict[str, Node] = {}

    def addObject(self, kind: str, **settings: Any) -> None:  # noqa: N802
        self.objects[f"{kind} {settings.get('name', '')}".strip()] = settings

    def addChild(self, child: str | Node) -> Node:  # noqa: N802
        if isinstance(child, Node):
            return child
        return self.children.setdefault(child, Node())


def in_sofa(rod: RodSample, hinges: int, force: Force, at_s: float) -> Array:
    """The scene's numbers by the equations of the plugin: sections of constant curvature, masses at the frames."""
    scene = Node()
    loaded(text_of(rod, "sofa", hinges), "sofa").createScene(scene)
    bending, frames = scene.children["bending"].objects, scene.children["clamp"].children["frames"].objects
    law, mapping = bending["BeamHookeLawForceField"], frames["DiscreteCosseratMapping"]
    rest = np.array(bending["MechanicalObject strain"]["rest_position"])[:, 2]
    second = 0.25 * math.pi * law["radius"] ** 4
    bend, h = np.array(law["youngModulusList"]) * second, np.array(law["length"])
    masses = np.array([float(frames[f"UniformMass mass_{i}"]["vertexMass"].split()[0]) for i in range(hinges + 1)])
    z, w = np.array(scene.children["clamp"].objects["MechanicalObject base"]["position"][0])[5:]
    places = np.array(mapping["curv_abs_input"])
    spans = np.append(0.0, h).cumsum()
    np.testing.assert_allclose(spans, places)

    def shape(curvature: Any, s: float | None = None) -> Any:
        """(..., n + 1, 2) of the frames, or (..., 2) of a place."""
        angle = 2.0 * math.atan2(z, w) + np.cumsum(curvature * h, axis=-1) - 0.5 * curvature * h
        chord = h * (1.0 - (curvature * h) ** 2 / 24.0 + (curvature * h) ** 4 / 1920.0)
        if s is not None:
            part = np.clip((s * spans[-1] - spans[:-1]) / h, 0.0, 1.0)
            cut = np.where((part > 0.0) & (part < 1.0))[0]
            angle = angle + 0.0
            angle[..., cut] -= 0.5 * (1.0 - part[cut]) * curvature[..., cut] * h[cut]
            chord = part * chord
            return np.stack([np.sum(chord * np.cos(angle), -1), np.sum(chord * np.sin(angle), -1)], -1)
        steps = np.stack([chord * np.cos(angle), chord * np.sin(angle)], -1)
        return np.concatenate([np.zeros_like(steps[..., :1, :]), np.cumsum(steps, axis=-2)], axis=-2)

    def slope(curvature: Array, share: float) -> Array:
        """By the complex step."""
        many = curvature + 1e-20j * np.eye(len(curvature))
        energy = 0.5 * np.sum(bend * h * (many - rest) ** 2, axis=-1) - share * shape(many, at_s) @ np.array(force)
        return np.asarray((energy - shape(many) @ np.array(GRAVITY) @ masses).imag / 1e-20)

    found = rest
    for share in (0.25, 0.5, 0.75, 1.0):
        solved = root(slope, found, args=(share,), tol=1e-12)
        found = solved.x
    assert np.abs(slope(found, 1.0)).max() < 1e-9
    return np.array([shape(found[None], float(s))[0] for s in PLACES])


def in_python(rod: RodSample, hinges: int, force: Force, at_s: float) -> Array:
    x, y, _ = loaded(text_of(rod, "python", hinges), "alone").shape(force, at_s, PLACES.tolist(), GRAVITY)
    return np.column_stack([x, y])


def in_pyelastica(rod: RodSample, elements: int, force: Force, at_s: float) -> Array:
    elastica: Any = pytest.importorskip("elastica")

    class Simulator(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping):  # type: ignore[misc]
        pass

    class Push(elastica.NoForces):  # type: ignore[misc]
        def apply_forces(self, system: Any, time: float = 0.0) -> None:  # noqa: ARG002
            node, part = min(int(elements * at_s), elements - 1), elements * at_s
            part -= node
            system.external_forces[:2, node] += (1.0 - part) * np.array(force)
            system.external_forces[:2, node + 1] += part * np.array(force)

    module = loaded(text_of(rod, "pyelastica", 2), "elastica_rod")
    one, step = module.make_rod(elements, 0.003), module.time_step(elements, 0.003)
    simulator = Simulator()
    simulator.append(one)
    simulator.constrain(one).using(elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    simulator.add_forcing_to(one).using(Push)
    simulator.add_forcing_to(one).using(elastica.GravityForces, acc_gravity=np.array([*GRAVITY, 0.0]))
    simulator.dampen(one).using(elastica.AnalyticalLinearDamper, uniform_damping_constant=20.0, time_step=step)
    simulator.finalize()
    elastica.integrate(elastica.PositionVerlet(), simulator, 1.2, int(1.2 / step), progress_bar=False)
    s = np.linspace(0.0, 1.0, elements + 1)
    return np.stack([np.interp(PLACES, s, row) for row in one.position_collection[:2]], axis=-1)


class InNewton:
    """A beam in SolverVBD on the CPU, its steps in one captured graph."""

    def __init__(self, rod: RodSample, hinges: int, iterations: int = 100, steps: int = 10) -> None:
        newton, warp = pytest.importorskip("newton"), pytest.importorskip("warp")
        warp.config.quiet = True
        self.module, self.chain = loaded(text_of(rod, "newton", hinges), "newton_rod"), chain_of(rod, hinges)
        builder = newton.ModelBuilder(gravity=(*GRAVITY, 0.0))
        _, self.joints = self.module.add_beam(builder)
        builder.color()
        self.warp, self.model = warp, builder.finalize(device="cpu")
        self.solver = newton.solvers.SolverVBD(self.model, iterations=iterations)
        self.state, other, self.control = self.model.state(), self.model.state(), self.model.control()
        other.body_f = self.state.body_f
        self.seconds = steps * self.module.TIME_STEP_S

        def twice() -> None:
            for one, next_one in ((self.state, other), (other, self.state)):
                self.solver.step(one, next_one, self.control, None, self.module.TIME_STEP_S)

        twice()
        with warp.ScopedCapture(device="cpu") as capture:
            for _ in range(steps // 2):
                twice()
        self.graph = capture.graph

    def place(self, s: float) -> tuple[int, Array, Array]:
        """The body at `s`, where the place is, and where the body's centre is."""
        link, along = self.chain.link_of(s)
        x, y, z, *turn = self.state.body_q.numpy()[link - 1]
        axis = np.array(self.warp.quat_rotate(self.warp.quat(*turn), self.warp.vec3(0.0, 0.0, 1.0)))
        begins = np.array([x, y, z])
        return link - 1, begins + along * axis, begins + self.chain.link_centre[link] * axis

    def move(self, force: Force, at_s: float, seconds: float, then: Callable[[], None] | None = None) -> None:
        """Under a force, and a drag that brings it to rest; `then` is called after every captured graph."""
        drag = 20.0  # 1/s, per mass
        for _ in range(math.ceil(seconds / self.seconds)):
            body, point, centre = self.place(at_s)
            forces = np.zeros((len(self.joints), 6), dtype=np.float32)
            forces[:, :3] = -drag * self.chain.link_mass[1:, None] * self.state.body_qd.numpy()[:, :3]
            forces[body, :3] += (*force, 0.0)
            forces[body, 3:] += np.cross(point - centre, (*force, 0.0))
            self.state.body_f.assign(forces)
            self.warp.capture_launch(self.graph)
            if then is not None:
                then()


def in_newton(rod: RodSample, hinges: int, force: Force, at_s: float) -> Array:
    there = InNewton(rod, hinges)
    there.move(force, at_s, 0.7)
    return np.array([there.place(float(s))[1][:2] for s in PLACES])


SIMULATORS: dict[Kind, Bent] = {
    "mujoco": in_mujoco,
    "mujoco-flex": in_mujoco_flex,
    "newton": in_newton,
    "pyelastica": in_pyelastica,
    "sofa": in_sofa,
    "usd": in_usd,
    "urdf": in_urdf,
    "sdf": in_sdf,
    "python": in_python,
}
