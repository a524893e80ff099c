"""k(s) while a beam is pushed: cameras and force sensors, a recorder, and a learner that follows frame by frame."""

from __future__ import annotations

import lazy_loader

from onebend.wings import Place

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

COMMANDS = {
    "record": Place(
        "onebend.live.commands:record",
        "Record a push with a camera and a force sensor: guided from rest to rest, with k(s) while it goes on.",
        "out/my-push --play examples/linear-beam/train",
        group="Measure",
    ),
}
