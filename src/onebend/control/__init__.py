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
    from onebend.control.loop.feedback import Controller as Controller
    from onebend.control.loop.feedback import ControllerSettings as ControllerSettings
    from onebend.control.loop.feedback import ControllerState as ControllerState
    from onebend.control.loop.feedback import Reference as Reference
    from onebend.control.loop.loop import Eye as Eye
    from onebend.control.loop.loop import Hand as Hand
    from onebend.control.loop.loop import LoopRun as LoopRun
    from onebend.control.loop.loop import Truth as Truth
    from onebend.control.loop.loop import run_loop as run_loop
    from onebend.control.loop.margins import Gains as Gains
    from onebend.control.loop.margins import Margins as Margins
    from onebend.control.loop.margins import Timing as Timing
    from onebend.control.loop.plant import Plant as Plant
    from onebend.control.loop.prospect import Trial as Trial
    from onebend.control.loop.prospect import prospect as prospect
    from onebend.control.loop.tuning import Wanted as Wanted
    from onebend.control.path.force_way import by_force as by_force
    from onebend.control.path.path import Path as Path
    from onebend.control.path.path import PathSettings as PathSettings
    from onebend.control.path.path_spread import PathSpread as PathSpread
    from onebend.control.path.path_spread import path_spread as path_spread
    from onebend.control.path.timing import Rates as Rates
    from onebend.control.reach.loaded_beam import PushedBeam as PushedBeam
    from onebend.control.reach.loaded_beam import State as State
    from onebend.control.reach.paper_iteration import PaperSettings as PaperSettings
    from onebend.control.reach.reach import Reach as Reach
    from onebend.control.reach.reachable import Nearest as Nearest
    from onebend.control.reach.reachable import ReachableSet as ReachableSet
    from onebend.control.reach.reachable import reachable as reachable
    from onebend.control.reach.settings import ReachSettings as ReachSettings
    from onebend.control.reach.tracking import Hold as Hold
    from onebend.control.reach.tracking import WarmReach as WarmReach
    from onebend.control.reach.uncertainty import Ellipse as Ellipse
    from onebend.control.reach.uncertainty import PredictedError as PredictedError
    from onebend.control.reach.uncertainty import predicted_error as predicted_error
    from onebend.control.shape.descent import Descent as Descent
    from onebend.control.shape.grip import Bound as Bound
    from onebend.control.shape.grip import Grip as Grip
    from onebend.control.shape.grip import Hands as Hands
    from onebend.control.shape.grip import Push as Push
    from onebend.control.shape.grip import Stand as Stand
    from onebend.control.shape.shape import Shaped as Shaped
    from onebend.control.shape.shape import ShapeSettings as ShapeSettings
    from onebend.control.shape.spread import Spread as Spread
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.control.goals.moving_goals": "Goals",
            "onebend.control.goals.target_files": "read_goals read_targets",
            "onebend.control.goals.targets": "Targets angles curve curve_of_length points",
            "onebend.control.loop.feedback": "Controller ControllerSettings ControllerState Reference",
            "onebend.control.loop.loop": "Eye Hand LoopRun Truth run_loop",
            "onebend.control.loop.margins": "Gains Margins Timing",
            "onebend.control.loop.plant": "Plant",
            "onebend.control.loop.prospect": "Trial prospect",
            "onebend.control.loop.tuning": "Wanted",
            "onebend.control.path.force_way": "by_force",
            "onebend.control.path.path": "Path PathSettings",
            "onebend.control.path.path_spread": "PathSpread path_spread",
            "onebend.control.path.timing": "Rates",
            "onebend.control.reach.loaded_beam": "PushedBeam State",
            "onebend.control.reach.paper_iteration": "PaperSettings",
            "onebend.control.reach.reach": "Reach",
            "onebend.control.reach.reachable": "Nearest ReachableSet reachable",
            "onebend.control.reach.settings": "ReachSettings",
            "onebend.control.reach.tracking": "Hold WarmReach",
            "onebend.control.reach.uncertainty": "Ellipse PredictedError predicted_error",
            "onebend.control.shape.descent": "Descent",
            "onebend.control.shape.grip": "Bound Grip Hands Push Stand",
            "onebend.control.shape.shape": "ShapeSettings Shaped",
            "onebend.control.shape.spread": "Spread",
        },
    )
