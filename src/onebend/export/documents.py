"""The chain of a beam in the languages of rigid-body simulators: MJCF, SDF, URDF, USD.

Each lies along x, bends in the x-y plane, and has the clamp at the origin.
"""

from __future__ import annotations

import math
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np

from onebend.export.chain import Chain, chain_of
from onebend.export.sample import Request, RodSample

COLOUR = "0.85 0.45 0.25 1"
RADIUS = 0.02  # of the length: of the drawn links alone
SLIM = 1e-3  # a link's inertia about its own axis, of that about the others


def text_of(value: object) -> str:
    """A number with enough digits to read it back, several in turn with spaces between, or text as it is."""
    if isinstance(value, tuple):
        return " ".join(map(text_of, value))
    return value if isinstance(value, str) else repr(float(value))  # type: ignore[arg-type]


def add(parent: Xml.Element, tag: str, text: object = None, **attributes: object) -> Xml.Element:
    """A new element of XML."""
    out = Xml.SubElement(parent, tag, {name: text_of(value) for name, value in attributes.items()})
    out.text = None if text is None else text_of(text)
    return out


def fill(parent: Xml.Element, children: dict[str, Any]) -> None:
    """New elements by their tags, each with text or with children of its own."""
    for tag, inside in children.items():
        if isinstance(inside, dict):
            fill(add(parent, tag), inside)
        else:
            add(parent, tag, inside)


def _root(tag: str, notes: tuple[str, ...], **attributes: str) -> Xml.Element:
    root = Xml.Element(tag, attributes)
    for note in notes:
        root.append(Xml.Comment(f" {note} "))
    return root


def _document(root: Xml.Element) -> str:
    Xml.indent(root)
    return '<?xml version="1.0"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"


def mjcf(rod: RodSample, asked: Request) -> str:
    """An MJCF document; the beam is the body `link_0`. Where EA and kGA are known, each hinge slides as well.

    The places of the tags are sites, named `s_0.333`; the tip is the site `tip`.
    """
    chain = chain_of(rod, asked.hinges)
    places = [chain.link_of(s) for s in rod.sites]
    root = _root(
        "mujoco", (*asked.notes, "joints: stiffness N m/rad and N/m, springref rad, damping N m s/rad and N s/m")
    )
    add(root, "compiler", angle="radian", inertiafromgeom="false", balanceinertia="true")
    add(root, "option", timestep=min(0.002, rod.loss_time / 2), integrator="implicitfast")
    parent = add(root, "worldbody")
    for i in range(len(chain.link_length)):
        parent = _link(parent, chain, i, rod.loss_time)
        for s, (link, along) in zip(rod.sites, places, strict=True):
            if link == i:
                add(parent, "site", name=f"s_{s:.3f}", pos=(along, "0 0"))
    add(parent, "site", name="tip", pos=(chain.link_length[-1], "0 0"))
    return _document(root)


def _link(parent: Xml.Element, chain: Chain, i: int, damping_time: float) -> Xml.Element:
    """Link `i`, with the hinge that carries it."""
    body = add(parent, "body", name=f"link_{i}", pos="0 0 0" if i == 0 else (chain.link_length[i - 1], "0 0"))
    springs = (("stretch", chain.stretch, "slide", "1 0 0"), ("shear", chain.shear, "slide", "0 1 0"))
    if i == 0:
        half = chain.clamp_angle / 2
        body.set("quat", text_of((np.cos(half), "0 0", np.sin(half))))
    for name, stiffness, kind, axis in (*springs, ("hinge", chain.stiffness, "hinge", "0 0 1")) if i > 0 else ():
        if stiffness is not None:
            spring = {"stiffness": stiffness[i - 1], "damping": damping_time * stiffness[i - 1]}
            rest = {"springref": chain.rest[i - 1]} if kind == "hinge" else {}
            add(body, "joint", name=f"{name}_{i - 1}", type=kind, axis=axis, **spring, **rest)
    inertia = chain.link_inertia[i]
    about = (SLIM * inertia, inertia, inertia)
    add(body, "inertial", pos=(chain.link_centre[i], "0 0"), mass=chain.link_mass[i], diaginertia=about)
    untouched = {"rgba": COLOUR, "contype": "0", "conaffinity": "0"}
    add(body, "geom", type="capsule", fromto=("0 0 0", chain.link_length[i], "0 0"), size=_radius(chain), **untouched)
    return body


def flex(rod: RodSample, asked: Request) -> str:
    """An MJCF document with MuJoCo's own rod: point masses at the hinges that a one-dimensional flex bends, in all
    directions alike. A flex has one modulus, so each hinge has its own, of two edges.

    The modulus that MuJoCo divides by the edges' mean length is `k_i l_i / (pi r^4 / 4)`; constraints keep the edges'
    lengths. Vertices 0 and 1 are the clamp, the last one is the tip. A flex is straight at rest.
    """
    chain = chain_of(rod, asked.hinges)
    root = _root("mujoco", (*asked.notes, "a flex's young in Pa, its damping in s; masses in kg"))
    add(root, "option", timestep=min(0.002, rod.loss_time / 2), integrator="discrete")
    world, deformable, equality = (add(root, tag) for tag in ("worldbody", "deformable", "equality"))
    joints, share = chain.joints, chain.link_centre / chain.link_length
    masses = np.append(chain.link_mass * (1.0 - share), 0.0) + np.append(0.0, chain.link_mass * share)
    radius = 0.25 * _radius(chain)
    for i, (along, mass) in enumerate(zip(joints, masses, strict=True)):
        pos = (along * math.cos(chain.clamp_angle), along * math.sin(chain.clamp_angle), "0")
        body = add(world, "body", name=f"vertex_{i}", pos=pos)
        for axis in ("1 0 0", "0 1 0", "0 0 1") if i > 1 else ():
            add(body, "joint", type="slide", axis=axis)
        add(body, "inertial", pos="0 0 0", mass=mass, diaginertia=(mass * radius**2,) * 3)
    for i, stiffness in enumerate(chain.stiffness):
        bodies = f"vertex_{i} vertex_{i + 1} vertex_{i + 2}"
        one = add(deformable, "flex", name=f"flex_{i}", dim="1", radius=radius, body=bodies, element="0 1 1 2")
        young = stiffness * 0.5 * (joints[i + 2] - joints[i]) / (0.25 * math.pi * radius**4)
        add(one, "elasticity", young=young, poisson="0.3", damping=rod.loss_time, section="circle")
        add(one, "contact", contype="0", conaffinity="0", selfcollide="none")
        add(equality, "flex", flex=f"flex_{i}", solref="0.004 1", solimp="0.9999 0.9999 0.001")
    return _document(root)


def sdf(rod: RodSample, asked: Request) -> str:
    """An SDF 1.9 document; the hinges' springs stand in the joints' axes."""
    chain = chain_of(rod, asked.hinges)
    root = _root(
        "sdf", (*asked.notes, "axes: spring_stiffness N m/rad, spring_reference rad, damping N m s/rad"), version="1.9"
    )
    model = add(root, "model", name="onebend")
    for i, (begins, length) in enumerate(zip(chain.joints, chain.link_length, strict=False)):
        link = add(model, "link", name=f"link_{i}")
        if i == 0:
            add(link, "pose", ("0 0 0 0 0", chain.clamp_angle))
        else:
            add(link, "pose", (begins, "0 0 0 0 0"), relative_to="link_0")
        centre = (chain.link_centre[i], "0 0 0 0 0")
        fill(link, {"inertial": {"pose": centre, "mass": chain.link_mass[i], "inertia": _inertia(chain, i)}})
        cylinder = {"radius": _radius(chain), "length": length}
        along = (length / 2, "0 0 0 1.5707963267948966 0")
        fill(add(link, "visual", name="visual"), {"pose": along, "geometry": {"cylinder": cylinder}})
    fill(add(model, "joint", name="clamp", type="fixed"), {"parent": "world", "child": "link_0"})
    for i, stiffness in enumerate(chain.stiffness):
        dynamics = {
            "damping": rod.loss_time * stiffness,
            "spring_reference": chain.rest[i],
            "spring_stiffness": stiffness,
        }
        joint = {"parent": f"link_{i}", "child": f"link_{i + 1}", "axis": {"xyz": "0 0 1", "dynamics": dynamics}}
        fill(add(model, "joint", name=f"hinge_{i}", type="revolute"), joint)
    return _document(root)


def urdf(rod: RodSample, asked: Request) -> str:
    """A URDF document. URDF itself knows no springs: they stand in `<gazebo>` elements, one a joint.

    A program that reads plain URDF must take `springStiffness` and `springReference` from there, or the chain is limp.
    """
    chain = chain_of(rod, asked.hinges)
    robot = _root(
        "robot",
        (*asked.notes, "gazebo: springStiffness N m/rad, springReference rad; damping N m s/rad"),
        name="onebend",
    )
    add(robot, "link", name="clamp")
    for i, length in enumerate(chain.link_length):
        link = add(robot, "link", name=f"link_{i}")
        inertial = add(link, "inertial")
        add(inertial, "origin", xyz=(chain.link_centre[i], "0 0"))
        add(inertial, "mass", value=chain.link_mass[i])
        add(inertial, "inertia", **_inertia(chain, i))
        visual = add(link, "visual")
        add(visual, "origin", xyz=(length / 2, "0 0"), rpy="0 1.5707963267948966 0")
        add(add(visual, "geometry"), "cylinder", radius=_radius(chain), length=length)
    held = add(robot, "joint", name="clamp_joint", type="fixed")
    add(held, "parent", link="clamp")
    add(held, "child", link="link_0")
    add(held, "origin", xyz="0 0 0", rpy=("0 0", chain.clamp_angle))
    for i, stiffness in enumerate(chain.stiffness):
        joint = add(robot, "joint", name=f"hinge_{i}", type="revolute")
        add(joint, "parent", link=f"link_{i}")
        add(joint, "child", link=f"link_{i + 1}")
        add(joint, "origin", xyz=(chain.link_length[i], "0 0"))
        add(joint, "axis", xyz="0 0 1")
        add(joint, "limit", lower="-3.14159", upper="3.14159", effort="1000", velocity="1000")
        add(joint, "dynamics", damping=rod.loss_time * stiffness, friction="0")
    for i, stiffness in enumerate(chain.stiffness):
        spring = {"springStiffness": stiffness, "springReference": chain.rest[i]}
        fill(add(robot, "gazebo", reference=f"hinge_{i}"), spring)
    return _document(robot)


def usda(rod: RodSample, asked: Request) -> str:
    """A USD file as text, of the schema UsdPhysics: rigid bodies, and joints whose drives are the springs.

    A drive's stiffness and damping count by degrees, as the schema has them. Where EA and kGA are known, the joints
    are generic ones that also stretch and shear; else they turn about z alone.
    """
    chain = chain_of(rod, asked.hinges)
    units = "drives: stiffness N m/deg and N/m, damping N m s/deg and N s/m, targetPosition deg"
    lines = ["#usda 1.0", "(", '    defaultPrim = "onebend"', "    kilogramsPerUnit = 1", "    metersPerUnit = 1"]
    lines += ['    upAxis = "Z"', ")", *(f"# {note}" for note in (*asked.notes, units)), 'def Xform "onebend" (']
    lines += ['    prepend apiSchemas = ["PhysicsArticulationRootAPI"]', ")", "{"]
    cos, sin = math.cos(chain.clamp_angle), math.sin(chain.clamp_angle)
    turned = _usd((math.cos(chain.clamp_angle / 2), 0.0, 0.0, math.sin(chain.clamp_angle / 2)))
    for i, (begins, length) in enumerate(zip(chain.joints, chain.link_length, strict=False)):
        inertia = chain.link_inertia[i]
        lines += [
            f'    def Xform "link_{i}" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])',
            "    {",
            f"        double3 xformOp:translate = {_usd((begins * cos, begins * sin, 0.0))}",
            f"        quatd xformOp:orient = {turned}",
            '        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]',
            f"        float physics:mass = {_usd(chain.link_mass[i])}",
            f"        point3f physics:centerOfMass = {_usd((chain.link_centre[i], 0.0, 0.0))}",
            f"        float3 physics:diagonalInertia = {_usd((SLIM * inertia, inertia, inertia))}",
            '        def Capsule "drawn"',
            "        {",
            f'            uniform token axis = "X"\n            double height = {_usd(length)}',
            f"            double radius = {_usd(_radius(chain))}",
            f"            double3 xformOp:translate = {_usd((length / 2, 0.0, 0.0))}",
            '            uniform token[] xformOpOrder = ["xformOp:translate"]',
            "        }",
            "    }",
        ]
    lines += ['    def PhysicsFixedJoint "clamp"', "    {", "        rel physics:body1 = </onebend/link_0>"]
    lines += [f"        quatf physics:localRot0 = {turned}", "    }"]
    for i in range(asked.hinges):
        lines += _usd_joint(chain, i, rod.loss_time)
    return "\n".join([*lines, "}"]) + "\n"


def _usd_joint(chain: Chain, i: int, damping_time: float) -> list[str]:
    """Between links `i` and `i + 1`."""
    degree = math.pi / 180.0
    name = "angular" if chain.stretch is None else "rotZ"
    drives = {name: (chain.stiffness[i] * degree, chain.rest[i] / degree)}
    if chain.stretch is not None and chain.shear is not None:
        drives |= {"transX": (chain.stretch[i], 0.0), "transY": (chain.shear[i], 0.0)}
    locked = () if chain.stretch is None else ("transZ", "rotX", "rotY")
    apis = [f'"PhysicsDriveAPI:{drive}"' for drive in drives] + [f'"PhysicsLimitAPI:{axis}"' for axis in locked]
    kind = "PhysicsRevoluteJoint" if chain.stretch is None else "PhysicsJoint"
    lines = [f'    def {kind} "hinge_{i}" (prepend apiSchemas = [{", ".join(apis)}])', "    {"]
    lines += [f"        rel physics:body{end} = </onebend/link_{i + end}>" for end in (0, 1)]
    lines += [f"        point3f physics:localPos0 = {_usd((chain.link_length[i], 0.0, 0.0))}"]
    lines += ['        uniform token physics:axis = "Z"'] if chain.stretch is None else []
    for drive, (stiffness, rest) in drives.items():
        values = {"stiffness": stiffness, "damping": damping_time * stiffness, "targetPosition": rest}
        lines += [f"        float drive:{drive}:physics:{key} = {_usd(value)}" for key, value in values.items()]
    for axis in locked:  # low above high: the axis does not move
        lines += [f"        float limit:{axis}:physics:{end} = {way}" for end, way in (("low", 1), ("high", -1))]
    return [*lines, "    }"]


def _usd(value: object) -> str:
    return f"({', '.join(map(_usd, value))})" if isinstance(value, tuple) else f"{float(value):.9g}"  # type: ignore[arg-type]


def _inertia(chain: Chain, i: int) -> dict[str, object]:
    across, along = chain.link_inertia[i], SLIM * chain.link_inertia[i]
    return {"ixx": along, "ixy": "0", "ixz": "0", "iyy": across, "iyz": "0", "izz": across}


def _radius(chain: Chain) -> float:
    return RADIUS * float(chain.link_length.sum())
