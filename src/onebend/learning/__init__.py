"""k(s) from observations, and how good it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.learning.allowances import Allowance as Allowance
    from onebend.learning.attribution import Attribution as Attribution
    from onebend.learning.criticism import (
        Criticism as Criticism,
        Finding as Finding,
        Score as Score,
        Suspect as Suspect,
    )
    from onebend.learning.design import (
        Limits as Limits,
        Plan as Plan,
        PlanSettings as PlanSettings,
        Proposal as Proposal,
        Quality as Quality,
        after_push as after_push,
        information as information,
        information_along as information_along,
        plan as plan,
    )
    from onebend.learning.endings import Edge as Edge
    from onebend.learning.fit_data import AtRest as AtRest, FitData as FitData, OwnWeight as OwnWeight
    from onebend.learning.force_error import Filtered as Filtered, ForceError as ForceError
    from onebend.learning.frequencies import (
        FrequencyData as FrequencyData,
        Posture as Posture,
        PredictedFrequencies as PredictedFrequencies,
    )
    from onebend.learning.instruments import (
        ForceDoubt as ForceDoubt,
        Instruments as Instruments,
        PlannedPush as PlannedPush,
        instruments_of as instruments_of,
    )
    from onebend.learning.linear import (
        FitProblem as FitProblem,
        Hyperparameters as Hyperparameters,
        RecordingNoise as RecordingNoise,
    )
    from onebend.learning.normal import Conditioning as Conditioning, JointCovariance as JointCovariance
    from onebend.learning.optimizer import (
        FitSettings as FitSettings,
        Miss as Miss,
        OptimizerSettings as OptimizerSettings,
        Optimum as Optimum,
    )
    from onebend.learning.outcome import Learned as Learned, Notice as Notice, Trial as Trial
    from onebend.learning.paper import RegressionSettings as RegressionSettings, regress as regress
    from onebend.learning.parameters import (
        Block as Block,
        KnownShape as KnownShape,
        Layout as Layout,
        LearnedMass as LearnedMass,
        Priors as Priors,
        Spline as Spline,
    )
    from onebend.learning.posterior import Nuisance as Nuisance
    from onebend.learning.prediction import Prediction as Prediction, Slopes as Slopes
    from onebend.learning.push_place import PlaceSearch as PlaceSearch
    from onebend.learning.sensing.contacts import Smoothed as Smoothed, TwoContacts as TwoContacts
    from onebend.learning.sensing.forces import Misfit as Misfit
    from onebend.learning.sensing.sense import (
        LiveForce as LiveForce,
        OnlineSense as OnlineSense,
        SecondForce as SecondForce,
        Sensed as Sensed,
        SenseSettings as SenseSettings,
        ToldMoment as ToldMoment,
        Touch as Touch,
    )
    from onebend.learning.sensing.sensor import SensorCheck as SensorCheck
    from onebend.learning.start import start_of as start_of, with_mass as with_mass
    from onebend.learning.static_poses import HeldEnds as HeldEnds, SeenPoses as SeenPoses
    from onebend.learning.swing import (
        Damping as Damping,
        DampingSettings as DampingSettings,
        FilmPart as FilmPart,
        Swing as Swing,
        SwingFit as SwingFit,
    )
    from onebend.learning.swing_frequencies import (
        FoundFrequencies as FoundFrequencies,
        SwingFrequency as SwingFrequency,
        frequencies_of as frequencies_of,
    )
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.learning.allowances": "Allowance",
            "onebend.learning.attribution": "Attribution",
            "onebend.learning.criticism": "Criticism Finding Score Suspect",
            "onebend.learning.design": (
                "Limits Plan PlanSettings Proposal Quality after_push information information_along plan"
            ),
            "onebend.learning.endings": "Edge",
            "onebend.learning.fit_data": "AtRest FitData OwnWeight",
            "onebend.learning.force_error": "Filtered ForceError",
            "onebend.learning.frequencies": "FrequencyData Posture PredictedFrequencies",
            "onebend.learning.instruments": "ForceDoubt Instruments PlannedPush instruments_of",
            "onebend.learning.linear": "FitProblem Hyperparameters RecordingNoise",
            "onebend.learning.normal": "Conditioning JointCovariance",
            "onebend.learning.optimizer": "FitSettings Miss OptimizerSettings Optimum",
            "onebend.learning.outcome": "Learned Notice Trial",
            "onebend.learning.paper": "RegressionSettings regress",
            "onebend.learning.parameters": "Block KnownShape Layout LearnedMass Priors Spline",
            "onebend.learning.posterior": "Nuisance",
            "onebend.learning.prediction": "Prediction Slopes",
            "onebend.learning.push_place": "PlaceSearch",
            "onebend.learning.sensing.contacts": "Smoothed TwoContacts",
            "onebend.learning.sensing.forces": "Misfit",
            "onebend.learning.sensing.sense": (
                "LiveForce OnlineSense SecondForce SenseSettings Sensed ToldMoment Touch"
            ),
            "onebend.learning.sensing.sensor": "SensorCheck",
            "onebend.learning.start": "start_of with_mass",
            "onebend.learning.static_poses": "HeldEnds SeenPoses",
            "onebend.learning.swing": "Damping DampingSettings FilmPart Swing SwingFit",
            "onebend.learning.swing_frequencies": "FoundFrequencies SwingFrequency frequencies_of",
        },
    )
