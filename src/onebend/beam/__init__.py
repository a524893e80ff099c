"""Pure mechanics of a planar slender beam, on arrays: no file, no camera, no estimation."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.beam.dynamics import Body as Body
    from onebend.beam.grid import Grid as Grid
    from onebend.beam.loads import Loads as Loads, push as push, twist as twist, weight as weight
    from onebend.beam.problem import (
        GridMemory as GridMemory,
        MomentBasis as MomentBasis,
        NodalBeam as NodalBeam,
        Problem as Problem,
        Resolution as Resolution,
        Rod as Rod,
    )
    from onebend.beam.section import (
        ModulusBand as ModulusBand,
        SectionProfiles as SectionProfiles,
        modulus_band as modulus_band,
        one_modulus as one_modulus,
    )
    from onebend.beam.sensitivity import Perturbation as Perturbation
    from onebend.beam.statics import Equilibrium as Equilibrium, NodalForces as NodalForces
    from onebend.beam.stiffness import (
        Gaussians as Gaussians,
        LogSpline as LogSpline,
        Pieces as Pieces,
        Polyline as Polyline,
        Powers as Powers,
        Profile as Profile,
        RectangularSection as RectangularSection,
        Scaled as Scaled,
        Table as Table,
    )
    from onebend.beam.vibration import Vibration as Vibration, natural_frequencies as natural_frequencies
    from onebend.records import PointMass as PointMass
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.beam.dynamics": "Body",
            "onebend.beam.grid": "Grid",
            "onebend.beam.loads": "Loads push twist weight",
            "onebend.beam.problem": "GridMemory MomentBasis NodalBeam Problem Resolution Rod",
            "onebend.beam.section": "ModulusBand SectionProfiles modulus_band one_modulus",
            "onebend.beam.sensitivity": "Perturbation",
            "onebend.beam.statics": "Equilibrium NodalForces",
            "onebend.beam.stiffness": (
                "Gaussians LogSpline Pieces Polyline Powers Profile RectangularSection Scaled Table"
            ),
            "onebend.beam.vibration": "Vibration natural_frequencies",
            "onebend.records": "PointMass",
        },
    )
