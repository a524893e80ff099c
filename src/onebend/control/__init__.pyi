from .goals import (
    Goals as Goals,
    Targets as Targets,
    angles as angles,
    curve as curve,
    curve_of_length as curve_of_length,
    points as points,
    read_goals as read_goals,
    read_targets as read_targets,
    tags as tags,
)
from .loaded_beam import (
    LoadedState as LoadedState,
    PaperSettings as PaperSettings,
    PushedBeam as PushedBeam,
    ReachSettings as ReachSettings,
)
from .loop import (
    Controller as Controller,
    ControllerSettings as ControllerSettings,
    ControllerState as ControllerState,
    Gains as Gains,
    Margins as Margins,
    Plant as Plant,
    Reference as Reference,
    RequiredMargins as RequiredMargins,
    Timing as Timing,
)
from .loop_simulation import (
    Actuator as Actuator,
    LoopCamera as LoopCamera,
    LoopSimulation as LoopSimulation,
    LoopTrial as LoopTrial,
    TrialBeam as TrialBeam,
    TrueSystem as TrueSystem,
    drawn_beams as drawn_beams,
    simulate_loop as simulate_loop,
    simulate_trials as simulate_trials,
    trial_settings as trial_settings,
    wrong_beams as wrong_beams,
)
from .path import (
    FollowedPath as FollowedPath,
    PathSettings as PathSettings,
    PathSpread as PathSpread,
    RateLimits as RateLimits,
    by_force as by_force,
    path_spread as path_spread,
)
from .reach import (
    ErrorEllipse as ErrorEllipse,
    PredictedError as PredictedError,
    Reach as Reach,
    ReachCandidate as ReachCandidate,
    ReachInSetUp as ReachInSetUp,
    predicted_error as predicted_error,
    reach_in_setup as reach_in_setup,
)
from .reach_set import NearestPoint as NearestPoint, ReachableSet as ReachableSet, reachable as reachable
from .shape import (
    Actuators as Actuators,
    BeamState as BeamState,
    Grip as Grip,
    LoadBound as LoadBound,
    Pusher as Pusher,
    ShapeResult as ShapeResult,
    ShapeSettings as ShapeSettings,
    ShapeSpread as ShapeSpread,
)
