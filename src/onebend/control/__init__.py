"""Forces that bend a beam where it is wanted."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.control.goals.moving_goals import Goals as Goals
    from onebend.control.goals.target_files import read_goals as read_goals
    from onebend.control.goals.target_files import read_targets as read_targets
    from onebend.control.goals.targets import Targets as Targets
    from onebend.control.goals.targets import angles as angles
    from onebend.control.goals.targets import curve as curve
    from onebend.control.goals.targets import curve_of_length as curve_of_length
    from onebend.control.goals.targets import points as points
    from onebend.control.loop.controller import Controller as Controller
    from onebend.control.loop.controller import ControllerSettings as ControllerSettings
    from onebend.control.loop.controller import ControllerState as ControllerState
    from onebend.control.loop.controller import Reference as Reference
    from onebend.control.loop.felt import Exposure as Exposure
    from onebend.control.loop.felt import Felt as Felt
    from onebend.control.loop.felt import FeltForce as FeltForce
    from onebend.control.loop.felt import ForceSense as ForceSense
    from onebend.control.loop.felt import LoggedForce as LoggedForce
    from onebend.control.loop.felt import Offset as Offset
    from onebend.control.loop.margins import Gains as Gains
    from onebend.control.loop.margins import Margins as Margins
    from onebend.control.loop.margins import Timing as Timing
    from onebend.control.loop.plant import Plant as Plant
    from onebend.control.loop.robustness import LoopTrial as LoopTrial
    from onebend.control.loop.robustness import TrialBeam as TrialBeam
    from onebend.control.loop.robustness import drawn_beams as drawn_beams
    from onebend.control.loop.robustness import simulate_range as simulate_range
    from onebend.control.loop.robustness import simulate_trials as simulate_trials
    from onebend.control.loop.robustness import trial_settings as trial_settings
    from onebend.control.loop.robustness import wrong_beams as wrong_beams
    from onebend.control.loop.simulation import Actuator as Actuator
    from onebend.control.loop.simulation import LoopCamera as LoopCamera
    from onebend.control.loop.simulation import LoopSimulation as LoopSimulation
    from onebend.control.loop.simulation import TrueSystem as TrueSystem
    from onebend.control.loop.simulation import simulate_loop as simulate_loop
    from onebend.control.loop.tuning import RequiredMargins as RequiredMargins
    from onebend.control.path.follow import FollowedPath as FollowedPath
    from onebend.control.path.follow import PathSettings as PathSettings
    from onebend.control.path.force_interpolation import by_force as by_force
    from onebend.control.path.path_spread import PathSpread as PathSpread
    from onebend.control.path.path_spread import path_spread as path_spread
    from onebend.control.path.timing import RateLimits as RateLimits
    from onebend.control.reach.loaded_beam import LoadedState as LoadedState
    from onebend.control.reach.loaded_beam import PushedBeam as PushedBeam
    from onebend.control.reach.paper_iteration import PaperSettings as PaperSettings
    from onebend.control.reach.reach import Reach as Reach
    from onebend.control.reach.reachable import NearestPoint as NearestPoint
    from onebend.control.reach.reachable import ReachableSet as ReachableSet
    from onebend.control.reach.reachable import reachable as reachable
    from onebend.control.reach.settings import ReachSettings as ReachSettings
    from onebend.control.reach.tracking import HoldingLoad as HoldingLoad
    from onebend.control.reach.tracking import WarmReach as WarmReach
    from onebend.control.reach.uncertainty import ErrorEllipse as ErrorEllipse
    from onebend.control.reach.uncertainty import PredictedError as PredictedError
    from onebend.control.reach.uncertainty import predicted_error as predicted_error
    from onebend.control.shape.actuators import Actuators as Actuators
    from onebend.control.shape.actuators import BeamState as BeamState
    from onebend.control.shape.actuators import Grip as Grip
    from onebend.control.shape.actuators import LoadBound as LoadBound
    from onebend.control.shape.actuators import Pusher as Pusher
    from onebend.control.shape.descent import DescentSettings as DescentSettings
    from onebend.control.shape.shape import ShapeResult as ShapeResult
    from onebend.control.shape.shape import ShapeSettings as ShapeSettings
    from onebend.control.shape.spread import ShapeSpread as ShapeSpread
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.control.goals.moving_goals": "Goals",
            "onebend.control.goals.target_files": "read_goals read_targets",
            "onebend.control.goals.targets": "Targets angles curve curve_of_length points",
            "onebend.control.loop.controller": "Controller ControllerSettings ControllerState Reference",
            "onebend.control.loop.felt": "Exposure Felt FeltForce ForceSense LoggedForce Offset",
            "onebend.control.loop.margins": "Gains Margins Timing",
            "onebend.control.loop.plant": "Plant",
            "onebend.control.loop.robustness": "LoopTrial TrialBeam drawn_beams simulate_range simulate_trials "
            "trial_settings wrong_beams",
            "onebend.control.loop.simulation": "Actuator LoopCamera LoopSimulation TrueSystem simulate_loop",
            "onebend.control.loop.tuning": "RequiredMargins",
            "onebend.control.path.follow": "FollowedPath PathSettings",
            "onebend.control.path.force_interpolation": "by_force",
            "onebend.control.path.path_spread": "PathSpread path_spread",
            "onebend.control.path.timing": "RateLimits",
            "onebend.control.reach.loaded_beam": "LoadedState PushedBeam",
            "onebend.control.reach.paper_iteration": "PaperSettings",
            "onebend.control.reach.reach": "Reach",
            "onebend.control.reach.reachable": "NearestPoint ReachableSet reachable",
            "onebend.control.reach.settings": "ReachSettings",
            "onebend.control.reach.tracking": "HoldingLoad WarmReach",
            "onebend.control.reach.uncertainty": "ErrorEllipse PredictedError predicted_error",
            "onebend.control.shape.actuators": "Actuators BeamState Grip LoadBound Pusher",
            "onebend.control.shape.descent": "DescentSettings",
            "onebend.control.shape.shape": "ShapeResult ShapeSettings",
            "onebend.control.shape.spread": "ShapeSpread",
        },
    )
