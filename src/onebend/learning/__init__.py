"""k(s) from observations, and how good it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.learning.allowances.allowance import Allowance as Allowance
    from onebend.learning.attribution import Attribution as Attribution
    from onebend.learning.criticism.alternatives import Suspect as Suspect
    from onebend.learning.criticism.criticism import Criticism as Criticism
    from onebend.learning.criticism.criticism import Finding as Finding
    from onebend.learning.criticism.push_place import PlaceSearch as PlaceSearch
    from onebend.learning.criticism.score_tests import Score as Score
    from onebend.learning.endings.edge import Edge as Edge
    from onebend.learning.frequencies.frequency_data import FrequencyData as FrequencyData
    from onebend.learning.frequencies.frequency_data import Posture as Posture
    from onebend.learning.frequencies.predicted import PredictedFrequencies as PredictedFrequencies
    from onebend.learning.inference.fit_problem import FitProblem as FitProblem
    from onebend.learning.inference.fit_problem import Hyperparameters as Hyperparameters
    from onebend.learning.inference.fit_problem import RecordingNoise as RecordingNoise
    from onebend.learning.inference.joint_covariance import Conditioning as Conditioning
    from onebend.learning.inference.joint_covariance import JointCovariance as JointCovariance
    from onebend.learning.inference.misfit import Miss as Miss
    from onebend.learning.inference.optimizer import OptimizerSettings as OptimizerSettings
    from onebend.learning.inference.optimizer import Optimum as Optimum
    from onebend.learning.inference.stages import FitSettings as FitSettings
    from onebend.learning.known_shape import KnownShape as KnownShape
    from onebend.learning.live.key_frame_posterior import LiveHyperparameters as LiveHyperparameters
    from onebend.learning.live.online_learner import Update as Update
    from onebend.learning.live.session import SmootherSettings as SmootherSettings
    from onebend.learning.live.settings import OnlineSettings as OnlineSettings
    from onebend.learning.model.fit_data import FitData as FitData
    from onebend.learning.model.force_error import Filtered as Filtered
    from onebend.learning.model.force_error import ForceError as ForceError
    from onebend.learning.model.forward import Prediction as Prediction
    from onebend.learning.model.forward import Slopes as Slopes
    from onebend.learning.model.held_ends import HeldEnds as HeldEnds
    from onebend.learning.model.mass import LearnedMass as LearnedMass
    from onebend.learning.model.own_weight import OwnWeight as OwnWeight
    from onebend.learning.model.parameters import Block as Block
    from onebend.learning.model.parameters import Layout as Layout
    from onebend.learning.model.parameters import Priors as Priors
    from onebend.learning.model.rest import AtRest as AtRest
    from onebend.learning.model.spline import Spline as Spline
    from onebend.learning.pose_equilibria import SeenPoses as SeenPoses
    from onebend.learning.posterior import Nuisance as Nuisance
    from onebend.learning.sensing.joint import Misfit as Misfit
    from onebend.learning.sensing.online import LiveForce as LiveForce
    from onebend.learning.sensing.online import OnlineSense as OnlineSense
    from onebend.learning.sensing.sensed import SecondForce as SecondForce
    from onebend.learning.sensing.sensed import Sensed as Sensed
    from onebend.learning.sensing.sensed import SenseSettings as SenseSettings
    from onebend.learning.sensing.sensed import ToldMoment as ToldMoment
    from onebend.learning.sensing.sensed import Touch as Touch
    from onebend.learning.sensing.sensor import SensorCheck as SensorCheck
    from onebend.learning.sensing.smooth import Smoothed as Smoothed
    from onebend.learning.sensing.two import TwoContacts as TwoContacts
    from onebend.learning.start import start_of as start_of
    from onebend.learning.start import with_mass as with_mass
    from onebend.learning.swing.damping import Damping as Damping
    from onebend.learning.swing.damping import DampingSettings as DampingSettings
    from onebend.learning.swing.damping import SwingFit as SwingFit
    from onebend.learning.swing.free_swing import FilmPart as FilmPart
    from onebend.learning.swing.free_swing import Swing as Swing
    from onebend.learning.swing.swing_frequencies import FoundFrequencies as FoundFrequencies
    from onebend.learning.swing.swing_frequencies import SwingFrequency as SwingFrequency
    from onebend.learning.swing.swing_frequencies import frequencies_of as frequencies_of
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.learning.allowances.allowance": "Allowance",
            "onebend.learning.attribution": "Attribution",
            "onebend.learning.criticism.alternatives": "Suspect",
            "onebend.learning.criticism.criticism": "Criticism Finding",
            "onebend.learning.criticism.push_place": "PlaceSearch",
            "onebend.learning.criticism.score_tests": "Score",
            "onebend.learning.frequencies.frequency_data": "FrequencyData Posture",
            "onebend.learning.frequencies.predicted": "PredictedFrequencies",
            "onebend.learning.inference.fit_problem": "FitProblem Hyperparameters RecordingNoise",
            "onebend.learning.inference.misfit": "Miss",
            "onebend.learning.inference.joint_covariance": "Conditioning JointCovariance",
            "onebend.learning.inference.optimizer": "OptimizerSettings Optimum",
            "onebend.learning.known_shape": "KnownShape",
            "onebend.learning.live.key_frame_posterior": "LiveHyperparameters",
            "onebend.learning.live.online_learner": "Update",
            "onebend.learning.live.session": "SmootherSettings",
            "onebend.learning.live.settings": "OnlineSettings",
            "onebend.learning.model.fit_data": "FitData",
            "onebend.learning.model.force_error": "Filtered ForceError",
            "onebend.learning.model.forward": "Prediction Slopes",
            "onebend.learning.model.held_ends": "HeldEnds",
            "onebend.learning.model.mass": "LearnedMass",
            "onebend.learning.model.own_weight": "OwnWeight",
            "onebend.learning.model.parameters": "Block Layout Priors",
            "onebend.learning.model.rest": "AtRest",
            "onebend.learning.model.spline": "Spline",
            "onebend.learning.pose_equilibria": "SeenPoses",
            "onebend.learning.posterior": "FitSettings Nuisance",
            "onebend.learning.sensing.edges": "Edge",
            "onebend.learning.sensing.joint": "Misfit",
            "onebend.learning.sensing.online": "LiveForce OnlineSense",
            "onebend.learning.sensing.sensed": "SecondForce Sensed SenseSettings ToldMoment Touch",
            "onebend.learning.sensing.sensor": "SensorCheck",
            "onebend.learning.sensing.smooth": "Smoothed",
            "onebend.learning.sensing.two": "TwoContacts",
            "onebend.learning.start": "start_of with_mass",
            "onebend.learning.swing.damping": "Damping DampingSettings SwingFit",
            "onebend.learning.swing.free_swing": "FilmPart Swing",
            "onebend.learning.swing.swing_frequencies": "FoundFrequencies SwingFrequency frequencies_of",
        },
    )
