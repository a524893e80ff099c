"""Closed loops with a real robot and a camera: a learned beam bent to a goal, watched, recorded, let go."""

from __future__ import annotations

import lazy_loader

from onebend.wings import Place

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

COMMANDS = {
    "drive": Place(
        "onebend.drive.commands:drive",
        "Bend a learned beam to a goal with a robot and a camera: a plan first, and with --go the real loop, recorded.",
        "out/linear-beam examples/linear-beam/train --goal 0.1338 0.0638",
    ),
}
