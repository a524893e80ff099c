from .guidance import (
    CaptureOutcome as CaptureOutcome,
    CaptureSettings as CaptureSettings,
    CaptureState as CaptureState,
    Stop as Stop,
    TagView as TagView,
    outcome_data as outcome_data,
    outcome_words as outcome_words,
)
from .hyperparameters import LiveHyperparameters as LiveHyperparameters, OnlineSettings as OnlineSettings
from .learner import OnlineLearner as OnlineLearner, Update as Update
from .live import (
    Counts as Counts,
    Live as Live,
    LiveSettings as LiveSettings,
    LiveState as LiveState,
    LiveVerdict as LiveVerdict,
)
from .played import (
    PlayedCamera as PlayedCamera,
    PlayedForce as PlayedForce,
    played_camera as played_camera,
    played_force as played_force,
)
from .recording_folder import copy_description as copy_description
from .replayed import replay as replay
from .session import Follower as Follower, record as record
from .sources import (
    CameraSource as CameraSource,
    Clock as Clock,
    End as End,
    ForceSource as ForceSource,
    Frame as Frame,
    HostClock as HostClock,
    PlayedClock as PlayedClock,
    Samples as Samples,
    StampTiming as StampTiming,
)
from .specs import camera_of as camera_of, force_of as force_of

COMMANDS: dict[str, object]
