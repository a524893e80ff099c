"""The beam as a chain in the two robot descriptions: URDF and SDF. Both lie along x and bend in the x-y plane."""

from __future__ import annotations

from xml.etree import ElementTree as Xml

from onebend.export.chain import Chain
from onebend.export.checks import checked_damping, plain


def sdf(chain: Chain, *, damping_time: float = 0.02, radius: float | None = None) -> str:
    """An SDF 1.9 document; the hinges' springs stand in the joints' axes.

    Args:
        damping_time: s, every hinge's damping over its stiffness.
        radius: m, of the drawn cylinders alone.

    Raises:
        ExportError: the damping time is not positive.
    """
    checked_damping(damping_time)
    root = Xml.Element("sdf", version="1.9")
    model = Xml.SubElement(root, "model", name="onebend")
    begins = 0.0
    for i, length in enumerate(chain.link_length):
        link = Xml.SubElement(model, "link", name=f"link_{i}")
        pose = Xml.SubElement(link, "pose")
        if i == 0:
            pose.text = f"0 0 0 0 0 {plain(chain.clamp_angle)}"
        else:
            pose.set("relative_to", "link_0")
            pose.text = f"{plain(begins)} 0 0 0 0 0"
        inertial = Xml.SubElement(link, "inertial")
        Xml.SubElement(inertial, "pose").text = f"{plain(chain.link_centre[i])} 0 0 0 0 0"
        Xml.SubElement(inertial, "mass").text = plain(chain.link_mass[i])
        inertia = Xml.SubElement(inertial, "inertia")
        for name, value in _inertia(chain, i).items():
            Xml.SubElement(inertia, name).text = value
        visual = Xml.SubElement(link, "visual", name="visual")
        Xml.SubElement(visual, "pose").text = f"{plain(length / 2)} 0 0 0 1.5707963267948966 0"
        _cylinder(Xml.SubElement(visual, "geometry"), chain, i, radius)
        begins += float(length)
    clamp = Xml.SubElement(model, "joint", name="clamp", type="fixed")
    Xml.SubElement(clamp, "parent").text = "world"
    Xml.SubElement(clamp, "child").text = "link_0"
    for i, stiffness in enumerate(chain.stiffness):
        joint = Xml.SubElement(model, "joint", name=f"hinge_{i}", type="revolute")
        Xml.SubElement(joint, "parent").text = f"link_{i}"
        Xml.SubElement(joint, "child").text = f"link_{i + 1}"
        axis = Xml.SubElement(joint, "axis")
        Xml.SubElement(axis, "xyz").text = "0 0 1"
        dynamics = Xml.SubElement(axis, "dynamics")
        Xml.SubElement(dynamics, "damping").text = plain(damping_time * stiffness)
        Xml.SubElement(dynamics, "spring_reference").text = plain(chain.rest[i])
        Xml.SubElement(dynamics, "spring_stiffness").text = plain(stiffness)
    return _document(root)


def urdf(chain: Chain, *, damping_time: float = 0.02, radius: float | None = None) -> str:
    """A URDF document. URDF itself knows no springs: they stand in `<gazebo>` elements, one a joint.

    A program that reads plain URDF must take `springStiffness` and `springReference` from there, or the chain is limp.
    Arguments and errors as for `sdf`.
    """
    checked_damping(damping_time)
    robot = Xml.Element("robot", name="onebend")
    robot.append(Xml.Comment(" N m / rad and rad of every hinge's spring: springStiffness, springReference below "))
    Xml.SubElement(robot, "link", name="clamp")
    for i in range(len(chain.link_length)):
        link = Xml.SubElement(robot, "link", name=f"link_{i}")
        inertial = Xml.SubElement(link, "inertial")
        Xml.SubElement(inertial, "origin", xyz=f"{plain(chain.link_centre[i])} 0 0")
        Xml.SubElement(inertial, "mass", value=plain(chain.link_mass[i]))
        Xml.SubElement(inertial, "inertia", _inertia(chain, i))
        visual = Xml.SubElement(link, "visual")
        half = plain(chain.link_length[i] / 2)
        Xml.SubElement(visual, "origin", xyz=f"{half} 0 0", rpy="0 1.5707963267948966 0")
        geometry = Xml.SubElement(visual, "geometry")
        Xml.SubElement(geometry, "cylinder", radius=plain(_radius(chain, radius)), length=plain(chain.link_length[i]))
    held = Xml.SubElement(robot, "joint", name="clamp_joint", type="fixed")
    Xml.SubElement(held, "parent", link="clamp")
    Xml.SubElement(held, "child", link="link_0")
    Xml.SubElement(held, "origin", xyz="0 0 0", rpy=f"0 0 {plain(chain.clamp_angle)}")
    for i, stiffness in enumerate(chain.stiffness):
        joint = Xml.SubElement(robot, "joint", name=f"hinge_{i}", type="revolute")
        Xml.SubElement(joint, "parent", link=f"link_{i}")
        Xml.SubElement(joint, "child", link=f"link_{i + 1}")
        Xml.SubElement(joint, "origin", xyz=f"{plain(chain.link_length[i])} 0 0")
        Xml.SubElement(joint, "axis", xyz="0 0 1")
        Xml.SubElement(joint, "limit", lower="-3.14159", upper="3.14159", effort="1000", velocity="1000")
        Xml.SubElement(joint, "dynamics", damping=plain(damping_time * stiffness), friction="0")
    for i, stiffness in enumerate(chain.stiffness):
        spring = Xml.SubElement(robot, "gazebo", reference=f"hinge_{i}")
        Xml.SubElement(spring, "springStiffness").text = plain(stiffness)
        Xml.SubElement(spring, "springReference").text = plain(chain.rest[i])
    return _document(robot)


def _inertia(chain: Chain, i: int) -> dict[str, str]:
    """Of a slim link: about its own axis a thousandth of that about the others."""
    across, along = plain(chain.link_inertia[i]), plain(1e-3 * chain.link_inertia[i])
    return {"ixx": along, "ixy": "0", "ixz": "0", "iyy": across, "iyz": "0", "izz": across}


def _cylinder(geometry: Xml.Element, chain: Chain, i: int, radius: float | None) -> None:
    cylinder = Xml.SubElement(geometry, "cylinder")
    Xml.SubElement(cylinder, "radius").text = plain(_radius(chain, radius))
    Xml.SubElement(cylinder, "length").text = plain(chain.link_length[i])


def _radius(chain: Chain, radius: float | None) -> float:
    return radius or 0.02 * float(chain.link_length.sum())


def _document(root: Xml.Element) -> str:
    Xml.indent(root)
    return '<?xml version="1.0"?>\n' + Xml.tostring(root, encoding="unicode") + "\n"
