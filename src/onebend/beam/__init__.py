"""Pure mechanics of a planar slender beam, on arrays: no file, no camera, no estimation."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.beam.grid import Grid as Grid
    from onebend.beam.loads import Loads as Loads
    from onebend.beam.loads import push as push
    from onebend.beam.loads import twist as twist
    from onebend.beam.loads import weight as weight
    from onebend.beam.motion.dynamics import Body as Body
    from onebend.beam.motion.frequencies import natural_frequencies as natural_frequencies
    from onebend.beam.motion.vibration import Vibration as Vibration
    from onebend.beam.profiles.modulus import ModulusBand as ModulusBand
    from onebend.beam.profiles.modulus import modulus_band as modulus_band
    from onebend.beam.profiles.modulus import one_modulus as one_modulus
    from onebend.beam.profiles.piecewise import Pieces as Pieces
    from onebend.beam.profiles.polyline import Polyline as Polyline
    from onebend.beam.profiles.rectangular import RectangularSection as RectangularSection
    from onebend.beam.profiles.section import SectionProfiles as SectionProfiles
    from onebend.beam.profiles.stiffness import Gaussians as Gaussians
    from onebend.beam.profiles.stiffness import LogSpline as LogSpline
    from onebend.beam.profiles.stiffness import Powers as Powers
    from onebend.beam.profiles.stiffness import Profile as Profile
    from onebend.beam.profiles.stiffness import Scaled as Scaled
    from onebend.beam.profiles.stiffness import Table as Table
    from onebend.beam.statics.equilibrium import Equilibrium as Equilibrium
    from onebend.beam.statics.nodal_beam import FirstGrid as FirstGrid
    from onebend.beam.statics.nodal_beam import GridMemory as GridMemory
    from onebend.beam.statics.nodal_beam import MomentBasis as MomentBasis
    from onebend.beam.statics.nodal_beam import NodalBeam as NodalBeam
    from onebend.beam.statics.nodal_forces import NodalForces as NodalForces
    from onebend.beam.statics.perturbation import Perturbation as Perturbation
    from onebend.beam.statics.problem import Problem as Problem
    from onebend.beam.statics.problem import Resolution as Resolution
    from onebend.beam.statics.rod import Rod as Rod
    from onebend.records import PointMass as PointMass
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.beam.grid": "Grid",
            "onebend.beam.loads": "Loads push twist weight",
            "onebend.beam.motion.dynamics": "Body",
            "onebend.records": "PointMass",
            "onebend.beam.motion.frequencies": "natural_frequencies",
            "onebend.beam.motion.vibration": "Vibration",
            "onebend.beam.profiles.modulus": "ModulusBand modulus_band one_modulus",
            "onebend.beam.profiles.piecewise": "Pieces",
            "onebend.beam.profiles.polyline": "Polyline",
            "onebend.beam.profiles.rectangular": "RectangularSection",
            "onebend.beam.profiles.section": "SectionProfiles",
            "onebend.beam.profiles.stiffness": "Gaussians LogSpline Powers Profile Scaled Table",
            "onebend.beam.statics.equilibrium": "Equilibrium",
            "onebend.beam.statics.nodal_beam": "FirstGrid GridMemory MomentBasis NodalBeam",
            "onebend.beam.statics.nodal_forces": "NodalForces",
            "onebend.beam.statics.perturbation": "Perturbation",
            "onebend.beam.statics.problem": "Problem Resolution Rod",
        },
    )
