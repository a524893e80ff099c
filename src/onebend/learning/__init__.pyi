from .allowances import Allowance as Allowance, MaterialMemory as MaterialMemory
from .attribution import Attribution as Attribution, Contradiction as Contradiction
from .criticism import Criticism as Criticism, Finding as Finding, Score as Score, Suspect as Suspect
from .design import (
    Limits as Limits,
    Plan as Plan,
    PlanSettings as PlanSettings,
    Proposal as Proposal,
    Quality as Quality,
    after_push as after_push,
    information as information,
    plan as plan,
)
from .fit_data import AtRest as AtRest, FitData as FitData, OwnWeight as OwnWeight
from .force_error import Filtered as Filtered, ForceError as ForceError
from .frequencies import (
    FrequencyData as FrequencyData,
    Posture as Posture,
    PredictedFrequencies as PredictedFrequencies,
)
from .instruments import (
    ForceDoubt as ForceDoubt,
    Instruments as Instruments,
    PlannedPush as PlannedPush,
    instruments_of as instruments_of,
)
from .linear import FitProblem as FitProblem, Hyperparameters as Hyperparameters, RecordingNoise as RecordingNoise
from .normal import Conditioning as Conditioning, JointCovariance as JointCovariance
from .optimizer import (
    FitSettings as FitSettings,
    Miss as Miss,
    OptimizerSettings as OptimizerSettings,
    Optimum as Optimum,
)
from .outcome import Learned as Learned, Notice as Notice, Trial as Trial
from .paper import RegressionSettings as RegressionSettings, regress as regress
from .parameters import (
    Block as Block,
    KnownShape as KnownShape,
    Layout as Layout,
    LearnedMass as LearnedMass,
    Spline as Spline,
)
from .posterior import Nuisance as Nuisance, Quantities as Quantities
from .prediction import Prediction as Prediction, Slopes as Slopes, TagMotion as TagMotion, TagRide as TagRide
from .push_place import PlaceSearch as PlaceSearch
from .sensing.contacts import Edge as Edge
from .sensing.forces import Misfit as Misfit
from .sensing.sense import (
    ContactMoment as ContactMoment,
    LiveForce as LiveForce,
    OnlineSense as OnlineSense,
    Sensed as Sensed,
    SenseSettings as SenseSettings,
    Touch as Touch,
)
from .sensing.sensor import SensorCheck as SensorCheck
from .start import start_of as start_of, with_mass as with_mass
from .static_poses import HeldEnds as HeldEnds, SeenPoses as SeenPoses
from .swing import (
    Damping as Damping,
    DampingSettings as DampingSettings,
    FilmPart as FilmPart,
    FoundFrequencies as FoundFrequencies,
    Swing as Swing,
    SwingFit as SwingFit,
    SwingFrequency as SwingFrequency,
    frequencies_of as frequencies_of,
)
