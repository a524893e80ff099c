"""The virtual lab: pushes of known beams, with known errors of sensor, camera and mounting."""

from __future__ import annotations

import lazy_loader

from onebend.wings import Place

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

COMMANDS = {
    "loop": Place(
        "onebend.lab.rehearsal_commands:loop",
        "Simulate a closed loop: a camera corrects the force for a goal, on beams that differ from the model.",
        "out/linear-beam --goal 0.1338 0.0638 --delay-ms 60",
        group="Lab",
    ),
    "design": Place(
        "onebend.lab.commands:design",
        "Predict a designed beam's stiffness, mass, forces, buckling load and vibration.",
        "linear",
        group="Lab",
    ),
    "tags": Place(
        "onebend.lab.commands:tags",
        "Draw a sheet of tags at exact size, with rulers to check the print.",
        "examples/linear-beam/train -o out/tags.pdf",
        group="Lab",
    ),
    "film": Place(
        "onebend.lab.commands:film",
        "Render a recording of a known beam under a push, with the true values beside it.",
        "linear --push free --sensor wrist -o out/released",
        group="Lab",
    ),
    "rehearse": Place(
        "onebend.lab.rehearsal_commands:rehearse",
        "Predict how well a push would determine k(s), before filming it, and rank improvements.",
        "linear",
        group="Lab",
    ),
}
