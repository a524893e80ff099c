"""k(s) while a beam is pushed: cameras and force sensors, a recorder, and a learner that follows frame by frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import Place, lazy_names

if TYPE_CHECKING:
    from onebend.live.guidance import (
        CaptureOutcome as CaptureOutcome,
        CaptureSettings as CaptureSettings,
        CaptureState as CaptureState,
        Stop as Stop,
        TagView as TagView,
        outcome_data as outcome_data,
        outcome_words as outcome_words,
    )
    from onebend.live.hyperparameters import OnlineSettings as OnlineSettings
    from onebend.live.learner import OnlineLearner as OnlineLearner, Update as Update
    from onebend.live.live import (
        Counts as Counts,
        Live as Live,
        LiveSettings as LiveSettings,
        LiveState as LiveState,
        LiveVerdict as LiveVerdict,
    )
    from onebend.live.model import SmootherSettings as SmootherSettings
    from onebend.live.played import (
        Arrival as Arrival,
        Disturbances as Disturbances,
        Followed as Followed,
        OwnClock as OwnClock,
        PlayedCamera as PlayedCamera,
        PlayedForce as PlayedForce,
        follow as follow,
        play as play,
        played_camera as played_camera,
        played_force as played_force,
    )
    from onebend.live.posterior import LiveHyperparameters as LiveHyperparameters
    from onebend.live.recording_folder import copy_description as copy_description
    from onebend.live.replayed import replay as replay
    from onebend.live.session import record as record
    from onebend.live.sources import (
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
    from onebend.live.specs import camera_of as camera_of, force_of as force_of
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.live.guidance": (
                "CaptureOutcome CaptureSettings CaptureState Stop TagView outcome_data outcome_words"
            ),
            "onebend.live.hyperparameters": "OnlineSettings",
            "onebend.live.learner": "OnlineLearner Update",
            "onebend.live.live": "Counts Live LiveSettings LiveState LiveVerdict",
            "onebend.live.model": "SmootherSettings",
            "onebend.live.played": (
                "Arrival Disturbances Followed OwnClock PlayedCamera PlayedForce follow play played_camera played_force"
            ),
            "onebend.live.posterior": "LiveHyperparameters",
            "onebend.live.recording_folder": "copy_description",
            "onebend.live.replayed": "replay",
            "onebend.live.session": "record",
            "onebend.live.sources": (
                "CameraSource Clock End ForceSource Frame HostClock PlayedClock Samples StampTiming"
            ),
            "onebend.live.specs": "camera_of force_of",
        },
    )

COMMANDS = {
    "record": Place(
        "onebend.live.commands:record",
        "Record a push with a camera and a force sensor: guided from rest to rest, with k(s) while it goes on.",
        "out/my-push --play examples/linear-beam/train",
    ),
}
