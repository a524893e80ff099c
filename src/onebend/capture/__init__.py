"""From a camera and a force sensor to a recording folder."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.capture.clocks import Clock as Clock
    from onebend.capture.clocks import HostClock as HostClock
    from onebend.capture.clocks import PlayedClock as PlayedClock
    from onebend.capture.clocks import StampTiming as StampTiming
    from onebend.capture.folder import copy_description as copy_description
    from onebend.capture.played import OwnClock as OwnClock
    from onebend.capture.played import PlayedCamera as PlayedCamera
    from onebend.capture.played import PlayedForce as PlayedForce
    from onebend.capture.played import played_camera as played_camera
    from onebend.capture.played import played_force as played_force
    from onebend.capture.session import record as record
    from onebend.capture.sources import CameraSource as CameraSource
    from onebend.capture.sources import End as End
    from onebend.capture.sources import ForceSource as ForceSource
    from onebend.capture.sources import Frame as Frame
    from onebend.capture.sources import Samples as Samples
    from onebend.capture.specs import camera_of as camera_of
    from onebend.capture.specs import force_of as force_of
    from onebend.capture.state import CaptureOutcome as CaptureOutcome
    from onebend.capture.state import CaptureSettings as CaptureSettings
    from onebend.capture.state import CaptureState as CaptureState
    from onebend.capture.state import Stop as Stop
    from onebend.capture.state import TagView as TagView
    from onebend.capture.state import outcome_data as outcome_data
    from onebend.capture.state import outcome_words as outcome_words
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.capture.clocks": "Clock HostClock StampTiming PlayedClock",
            "onebend.capture.folder": "copy_description",
            "onebend.capture.played": "OwnClock PlayedCamera PlayedForce played_camera played_force",
            "onebend.capture.session": "record",
            "onebend.capture.sources": "CameraSource End ForceSource Frame Samples",
            "onebend.capture.specs": "camera_of force_of",
            "onebend.capture.state": (
                "CaptureOutcome CaptureSettings CaptureState Stop TagView outcome_data outcome_words"
            ),
        },
    )
