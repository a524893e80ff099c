"""onebend: learn how stiff a soft slender object is along its length from one push, then bend it where you want."""

from onebend.beam.model import Beam, Shape
from onebend.beam.profiles.stiffness import Gaussians, LogSpline, Powers, Steps, Table, Uniform
from onebend.beam.profiles.uncertain import Band, UncertainStiffness
from onebend.control.loop.controller import controller
from onebend.control.loop.simulation import simulate_loop
from onebend.control.path.follow import follow_goals
from onebend.control.reach.reach import Reach, ReachSettings, reach
from onebend.control.reach.reachable import reachable
from onebend.control.reach.uncertainty import predicted_error
from onebend.control.shape.shape import shape
from onebend.errors import (
    ControlError,
    ExportError,
    LearningError,
    MechanicsError,
    ObservationError,
    OnebendError,
    RecordingError,
    ResultsError,
)
from onebend.lab.design_file import read_design
from onebend.lab.designs import DESIGNS, Design
from onebend.learning.design.identifiability import information, information_along
from onebend.learning.design.instruments import Instruments, PlannedPush, instruments_of
from onebend.learning.design.planning import PlanSettings, plan
from onebend.learning.live.online_learner import OnlineLearner, Update
from onebend.learning.live.settings import OnlineSettings
from onebend.learning.outcome import Comparison, Learned
from onebend.learning.paper.learn import learn
from onebend.learning.paper.selection import RegressionSettings
from onebend.learning.posterior import FitSettings, Posterior, fit
from onebend.learning.replay import replay
from onebend.learning.swing.damping import Damping, DampingSettings, SwingFit, learn_damping
from onebend.learning.validation import validate
from onebend.pipeline import learn_recording
from onebend.recording.folder import read_recording
from onebend.recording.observe import observe
from onebend.records import Observations
from onebend.results.model import load_model, load_uncertain, save_model
from onebend.results.observations_file import load_observations, save_observations

__version__ = "0.1.0"

__all__ = [
    "DESIGNS",
    "Band",
    "Beam",
    "Comparison",
    "ControlError",
    "Damping",
    "DampingSettings",
    "Design",
    "ExportError",
    "FitSettings",
    "Gaussians",
    "Instruments",
    "Learned",
    "LearningError",
    "LogSpline",
    "MechanicsError",
    "ObservationError",
    "Observations",
    "OnebendError",
    "OnlineLearner",
    "OnlineSettings",
    "PlanSettings",
    "PlannedPush",
    "Posterior",
    "Powers",
    "Reach",
    "ReachSettings",
    "RecordingError",
    "RegressionSettings",
    "ResultsError",
    "Shape",
    "Steps",
    "SwingFit",
    "Table",
    "UncertainStiffness",
    "Uniform",
    "Update",
    "controller",
    "fit",
    "follow_goals",
    "information",
    "information_along",
    "instruments_of",
    "learn",
    "learn_damping",
    "learn_recording",
    "load_model",
    "load_observations",
    "load_uncertain",
    "observe",
    "plan",
    "predicted_error",
    "reach",
    "reachable",
    "read_design",
    "read_recording",
    "replay",
    "save_model",
    "save_observations",
    "shape",
    "simulate_loop",
    "validate",
]
