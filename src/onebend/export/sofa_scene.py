"""A slender beam as a SOFA scene with the plugin Cosserat: runSofa THIS_FILE.

The beam is cut into sections of constant curvature. It lies along x, bends in the x-y plane and is clamped at the
origin; `add_beam` puts it into a scene of your own, which needs a solver. It neither stretches nor shears.
"""

import math
from typing import Any

# --- the beam -------------------------------------------------------------------------------------------------------
LENGTH_M = 1.0
CLAMP_ANGLE_RAD = 0.0
EI_N_M2: tuple[float, ...] = (1.0, 1.0)  # of each section
CURVATURE_1_M: tuple[float, ...] = (0.0, 0.0)  # at rest
FRAME_MASS_KG: tuple[float, ...] = (0.25, 0.5, 0.25)  # where sections meet, and at both ends
FRAME_INERTIA_KG_M2: tuple[float, ...] = (1e-3, 1e-2, 1e-3)
DAMPING_TIME_S = 0.02  # damping over stiffness
# --------------------------------------------------------------------------------------------------------------------

RADIUS_M = 0.02 * LENGTH_M  # of the round section that the plugin takes its second moment from
PLUGINS = (
    *("Cosserat", "Sofa.Component.AnimationLoop", "Sofa.Component.LinearSolver.Direct", "Sofa.Component.Mass"),
    *("Sofa.Component.ODESolver.Backward", "Sofa.Component.SolidMechanics.Spring", "Sofa.Component.StateContainer"),
)


def add_beam(parent: Any) -> Any:
    """The node with the frames, whose MechanicalObject is `frames`: the first at the clamp, the last at the tip."""
    count = len(EI_N_M2)
    places = [LENGTH_M * i / count for i in range(count + 1)]
    half = 0.5 * CLAMP_ANGLE_RAD
    clamp = [0.0, 0.0, 0.0, 0.0, 0.0, math.sin(half), math.cos(half)]
    base = parent.addChild("clamp")
    base.addObject("MechanicalObject", template="Rigid3d", name="base", position=[clamp])
    base.addObject("RestShapeSpringsForceField", stiffness=1e8, angularStiffness=1e8, points=[0], external_points=[0])
    bending = parent.addChild("bending")
    strain = [[0.0, 0.0, curvature] for curvature in CURVATURE_1_M]  # twist, bending about y, about z
    bending.addObject("MechanicalObject", template="Vec3d", name="strain", position=strain, rest_position=strain)
    second = 0.25 * math.pi * RADIUS_M**4
    bending.addObject(
        "BeamHookeLawForceField",
        crossSectionShape="circular",
        radius=RADIUS_M,
        length=[LENGTH_M / count] * count,
        variantSections=True,
        youngModulusList=[one / second for one in EI_N_M2],
        poissonRatioList=[0.48] * count,
        rayleighStiffness=DAMPING_TIME_S,
    )
    frames = base.addChild("frames")
    bending.addChild(frames)
    straight = [[s * math.cos(CLAMP_ANGLE_RAD), s * math.sin(CLAMP_ANGLE_RAD), *clamp[2:]] for s in places]
    frames.addObject("MechanicalObject", template="Rigid3d", name="frames", position=straight)
    for i, (mass, inertia) in enumerate(zip(FRAME_MASS_KG, FRAME_INERTIA_KG_M2, strict=True)):
        r = inertia / mass
        frames.addObject("UniformMass", name=f"mass_{i}", indices=[i], vertexMass=f"{mass} 1 {r} 0 0 0 {r} 0 0 0 {r}")
    frames.addObject(
        "DiscreteCosseratMapping",
        curv_abs_input=places,
        curv_abs_output=places,
        input1="@../../bending/strain",
        input2="@../base",
        output="@frames",
        radius=RADIUS_M,
    )
    return frames


def createScene(root: Any) -> Any:  # noqa: N802
    """The beam alone, under gravity along -z."""
    for plugin in PLUGINS:
        root.addObject("RequiredPlugin", name=plugin)
    root.gravity = [0.0, 0.0, -9.81]
    root.dt = 0.01
    root.addObject("DefaultAnimationLoop")
    root.addObject("EulerImplicitSolver", rayleighStiffness=0.0, rayleighMass=0.0)
    root.addObject("SparseLDLSolver", template="CompressedRowSparseMatrixd")
    add_beam(root)
    return root
