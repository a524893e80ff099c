"""A beam as a chain of rigid links with springs at the hinges, the common tongue of rigid-body simulators.

The beam is cut into `hinges` cells of equal length. The bending of a cell is gathered in one hinge at its middle
(springs in series: `1 / stiffness = int ds / k`), so that the chain's shape is off by the square of a cell's length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss

from onebend.beam.model import Beam
from onebend.errors import ExportError
from onebend.export.checks import checked_mass, checked_stiffness
from onebend.records import Array

_NODES, _WEIGHTS = leggauss(8)  # of each half of a cell


@dataclass(frozen=True)
class Chain:
    """Links 0 to n: link 0 is fixed to the clamp, link i hangs on hinge i - 1. All straight."""

    hinge_s: Array  # (n,) place of each hinge along the beam
    stiffness: Array  # (n,) N m / rad
    rest: Array  # (n,) rad, turn of each hinge where the beam carries nothing
    link_length: Array  # (n + 1,) m
    link_mass: Array  # (n + 1,) kg
    link_centre: Array  # (n + 1,) m, centre of mass from the link's beginning
    link_inertia: Array  # (n + 1,) kg m^2 about that centre, of a thin rod
    clamp_angle: float  # rad, of link 0 against the clamp's x axis

    def link_of(self, s: float) -> tuple[int, float]:
        """The link that holds the place `s`, and how far along it [m]."""
        link = int(np.searchsorted(self.hinge_s, s, side="left"))
        begins = 0.0 if link == 0 else float(self.hinge_s[link - 1])
        return link, (s - begins) * float(self.link_length.sum())


def chain_of(beam: Beam, hinges: int = 40, *, mass: float | None = None) -> Chain:
    """The chain that bends as `beam` does.

    Args:
        hinges: more bend more finely and simulate more slowly.
        mass: kg, spread evenly along the beam; None takes the beam's own. What rides on it comes on top.

    Raises:
        ExportError: fewer than 2 hinges, k(s) not positive, or no mass (a simulator in time cannot do without).
    """
    if hinges < 2:
        raise ExportError(f"a chain needs 2 hinges or more, got {hinges}")
    edges = np.linspace(0.0, 1.0, 2 * hinges + 1)  # halves of the cells: links begin and end in their middles
    places = 0.5 * (edges[:-1] + edges[1:])[:, None] + 0.5 * np.diff(edges)[:, None] * _NODES
    weights = 0.5 * np.diff(edges)[:, None] * _WEIGHTS
    k = checked_stiffness(beam, places)
    compliance = np.sum(weights / k, axis=1).reshape(-1, 2).sum(axis=1)
    rest = np.sum(weights * beam.rest_curvature(places), axis=1).reshape(-1, 2).sum(axis=1)
    starts = np.concatenate([[0], np.arange(1, 2 * hinges, 2)])  # first half-cell of every link
    begins = np.concatenate([edges[starts], [1.0]])
    per_metre = checked_mass(beam, mass, places)
    halves = beam.length * weights * per_metre  # kg at every node
    away = beam.length * (places - np.repeat(begins[:-1], np.diff([*starts, 2 * hinges]))[:, None])
    link_mass, first, second = (np.add.reduceat((halves * away**i).sum(axis=1), starts) for i in range(3))
    for one in beam.masses:
        link = int(np.searchsorted(edges[1::2], one.s, side="left"))
        lever = beam.length * (one.s - begins[link])
        link_mass[link] += one.mass
        first[link] += one.mass * lever
        second[link] += one.mass * lever**2
    centre = first / link_mass
    return Chain(
        hinge_s=edges[1::2],
        stiffness=1.0 / compliance,
        rest=rest,
        link_length=beam.length * np.diff(begins),
        link_mass=link_mass,
        link_centre=centre,
        link_inertia=second - link_mass * centre**2,
        clamp_angle=beam.clamp_angle,
    )
