from .dynamics import Body as Body
from .grid import Grid as Grid
from .loads import Loads as Loads, push as push, twist as twist, weight as weight
from .problem import (
    GridMemory as GridMemory,
    MomentBasis as MomentBasis,
    NodalBeam as NodalBeam,
    Problem as Problem,
    Resolution as Resolution,
    Rod as Rod,
)
from .section import (
    ModulusBand as ModulusBand,
    SectionProfiles as SectionProfiles,
    modulus_band as modulus_band,
    one_modulus as one_modulus,
)
from .sensitivity import Perturbation as Perturbation
from .setup import Bent as Bent, SetUp as SetUp
from .statics import Equilibrium as Equilibrium, NodalForces as NodalForces
from .stiffness import (
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
from .vibration import Vibration as Vibration, natural_frequencies as natural_frequencies
