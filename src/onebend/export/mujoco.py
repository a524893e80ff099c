"""The beam as a MuJoCo model (MJCF): a chain of hinges with springs, in the plane z = 0."""

from __future__ import annotations

from xml.etree import ElementTree as Xml

import numpy as np

from onebend.export.chain import Chain
from onebend.export.checks import checked_damping, plain

COLOUR = "0.85 0.45 0.25 1"


def mjcf(
    chain: Chain, *, damping_time: float = 0.02, sites: tuple[float, ...] = (), radius: float | None = None
) -> str:
    """An MJCF document; the beam is the body `link_0` and lies along x, bending in the x-y plane.

    Args:
        damping_time: s, `d / k` of Kelvin-Voigt damping: every hinge's damping over its stiffness.
        sites: places along the beam that get a site, named `s_0.333`; the tip has one, `tip`.
        radius: m, of the drawn capsules alone; None draws a slim beam.

    Raises:
        ExportError: the damping time is not positive (the integrator needs it: the links are light, the hinges stiff).
    """
    checked_damping(damping_time)
    places = [chain.link_of(s) for s in sites]
    root = Xml.Element("mujoco", model="onebend")
    root.append(Xml.Comment(" x along the clamp, y to its left; the spring of a hinge rests at its springref "))
    Xml.SubElement(root, "compiler", angle="radian", inertiafromgeom="false", balanceinertia="true")
    Xml.SubElement(root, "option", timestep=plain(min(0.002, damping_time / 2)), integrator="implicitfast")
    parent = Xml.SubElement(root, "worldbody")
    for i in range(len(chain.link_length)):
        parent = _link(parent, chain, i, damping_time, radius or 0.02 * float(chain.link_length.sum()))
        for s, (link, along) in zip(sites, places, strict=True):
            if link == i:
                Xml.SubElement(parent, "site", name=f"s_{s:.3f}", pos=f"{plain(along)} 0 0")
    Xml.SubElement(parent, "site", name="tip", pos=f"{plain(chain.link_length[-1])} 0 0")
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode") + "\n"


def _link(parent: Xml.Element, chain: Chain, i: int, damping_time: float, radius: float) -> Xml.Element:
    """Link `i`, with the hinge that carries it."""
    place = "0 0 0" if i == 0 else f"{plain(chain.link_length[i - 1])} 0 0"
    body = Xml.SubElement(parent, "body", name=f"link_{i}", pos=place)
    if i == 0:
        half = chain.clamp_angle / 2
        body.set("quat", f"{plain(np.cos(half))} 0 0 {plain(np.sin(half))}")
    else:
        stiffness = float(chain.stiffness[i - 1])
        Xml.SubElement(
            body,
            "joint",
            name=f"hinge_{i - 1}",
            type="hinge",
            axis="0 0 1",
            stiffness=plain(stiffness),
            springref=plain(chain.rest[i - 1]),
            damping=plain(damping_time * stiffness),
        )
    inertia = plain(chain.link_inertia[i])
    Xml.SubElement(
        body,
        "inertial",
        pos=f"{plain(chain.link_centre[i])} 0 0",
        mass=plain(chain.link_mass[i]),
        diaginertia=f"{plain(1e-3 * chain.link_inertia[i])} {inertia} {inertia}",
    )
    Xml.SubElement(
        body,
        "geom",
        type="capsule",
        fromto=f"0 0 0 {plain(chain.link_length[i])} 0 0",
        size=plain(radius),
        rgba=COLOUR,
        contype="0",
        conaffinity="0",
    )
    return body
