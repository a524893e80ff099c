"""A beam as a chain of rigid links with springs between them, the common tongue of simulators.

The beam is cut into `hinges` cells of equal length. The bending of a cell is gathered in one hinge at its middle
(springs in series: `1 / stiffness = int ds / k`), and the stretch and shear of a link in the hinge at its end, along
and across the link. The chain's shape is off by the square of a cell's length; a place inside a link also lacks that
link's own stretch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss

from onebend.errors import ExportError
from onebend.export.sample import RodSample
from onebend.records import Array, IntArray

HINGES = 40
_NODES, _WEIGHTS = leggauss(8)  # of each panel


@dataclass(frozen=True)
class Chain:
    """Links 0 to n: link 0 is fixed to the clamp, link i hangs on hinge i - 1. All straight."""

    hinge_s: Array  # (n,) place of each hinge along the beam
    stiffness: Array  # (n,) N m / rad
    rest: Array  # (n,) rad, turn of each hinge where the beam carries nothing
    stretch: Array | None  # (n,) N / m, along the link before; None: it does not stretch
    shear: Array | None  # (n,) N / m, across it
    link_length: Array  # (n + 1,) m
    link_mass: Array  # (n + 1,) kg
    link_centre: Array  # (n + 1,) m, centre of mass from the link's beginning
    link_inertia: Array  # (n + 1,) kg m^2 about that centre, of a thin rod
    clamp_angle: float  # rad, of link 0 against the clamp's x axis

    @property
    def joints(self) -> Array:
        """(n + 2,) m, where the links begin and the last one ends, along the straight chain."""
        return np.concatenate([[0.0], np.cumsum(self.link_length)])

    def link_of(self, s: float) -> tuple[int, float]:
        """The link that holds the place `s`, and how far along it [m]."""
        link = int(np.searchsorted(self.hinge_s, s, side="left"))
        begins = 0.0 if link == 0 else float(self.hinge_s[link - 1])
        return link, (s - begins) * float(self.link_length.sum())


def chain_of(rod: RodSample, hinges: int = HINGES) -> Chain:
    """The chain that bends as the beam does; more `hinges` bend more finely and simulate more slowly.

    Raises `ExportError`: fewer than 2 hinges, k(s) not positive, or no mass (a simulator in time cannot do without).
    """
    if hinges < 2:
        raise ExportError(f"a chain needs 2 hinges or more, got {hinges}")
    beam = rod.beam
    halves = np.linspace(0.0, 1.0, 2 * hinges + 1)  # of the cells: links begin and end in their middles
    jumps = (*beam.stiffness.jumps, *beam.rest_curvature.jumps, *beam.mass_per_length.jumps)
    edges = np.union1d(halves, jumps)
    places = 0.5 * (edges[:-1] + edges[1:])[:, None] + 0.5 * np.diff(edges)[:, None] * _NODES
    weights = 0.5 * np.diff(edges)[:, None] * _WEIGHTS
    half = np.searchsorted(halves, places[:, 0]) - 1
    cell, link = half // 2, (half + 1) // 2
    begins = np.concatenate([[0.0], halves[1::2]])

    def gathered(values: Array, into: IntArray) -> Array:
        """Integrals along s over cells or links."""
        return np.asarray(np.bincount(into, np.sum(weights * values, axis=1)), dtype=float)

    per_metre, away = rod.mass(places), beam.length * (places - begins[link][:, None])
    link_mass, first, second = (beam.length * gathered(per_metre * away**i, link) for i in range(3))
    for one in beam.masses:
        on = int(np.searchsorted(halves[1::2], one.s, side="left"))
        lever = beam.length * (one.s - begins[on])
        for moments, part in zip((link_mass, first, second), (1.0, lever, lever**2), strict=True):
            moments[on] += one.mass * part
    stretch = shear = None
    if rod.stretches:  # the last link's share goes to the hinge at its beginning
        before = np.minimum(link, hinges - 1)
        stretch, shear = (1.0 / (beam.length * gathered(1.0 / one, before)) for one in rod.axial(places))
    centre = first / link_mass
    return Chain(
        hinge_s=halves[1::2],
        stiffness=1.0 / gathered(1.0 / rod.stiffness(places), cell),
        rest=gathered(np.asarray(beam.rest_curvature(places)), cell),
        stretch=stretch,
        shear=shear,
        link_length=beam.length * np.diff([*begins, 1.0]),
        link_mass=link_mass,
        link_centre=centre,
        link_inertia=second - link_mass * centre**2,
        clamp_angle=beam.clamp_angle,
    )
