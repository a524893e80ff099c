"""From a camera and a force sensor that run to k(s) with a band, frame by frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.streaming.live import Live as Live
    from onebend.streaming.live import LiveSettings as LiveSettings
    from onebend.streaming.played import Arrival as Arrival
    from onebend.streaming.played import Disturbances as Disturbances
    from onebend.streaming.played import Followed as Followed
    from onebend.streaming.played import follow as follow
    from onebend.streaming.played import play as play
    from onebend.streaming.state import Counts as Counts
    from onebend.streaming.state import LiveState as LiveState
    from onebend.streaming.state import LiveVerdict as LiveVerdict
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.streaming.live": "Live LiveSettings",
            "onebend.streaming.played": "Arrival Disturbances Followed follow play",
            "onebend.streaming.state": "Counts LiveState LiveVerdict",
        },
    )
