"""The virtual lab: pushes of known beams, with known errors of sensor, camera and mounting."""

from __future__ import annotations

import lazy_loader

from onebend.wings import Place

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

COMMANDS = {
    "loop": Place(
        "onebend.lab.rehearsal_commands:loop",
        "Simulate a closed loop: force for a goal, corrected by a camera, on beams that are not the model.",
        "out/linear-beam --goal 0.1338 0.0638 --delay-ms 60",
    ),
    "design": Place(
        "onebend.lab.commands:design",
        "Say what a beam of a design will do on the bench: stiffness, mass, forces, buckling, vibration.",
        "linear",
    ),
    "mould": Place(
        "onebend.lab.commands:mould",
        "Make the mould of a design, the clamp and the carriers of its tags, as files to print.",
        "linear -o out/mould",
    ),
    "tags": Place(
        "onebend.lab.commands:tags",
        "Draw a sheet of tags at exact size, with rulers to check the printer by.",
        "examples/linear-beam/train -o out/tags.pdf",
    ),
    "film": Place(
        "onebend.lab.commands:film",
        "Film a known beam that is pushed: a recording folder to learn from, with the truth beside it.",
        "linear --push free --sensor wrist -o out/released",
    ),
    "reproduce": Place(
        "onebend.lab.rehearsal_commands:reproduce",
        "Make the paper's experiments again: films of three beams, its tables, figures and tasks, in one report.",
        "-o out/paper --quick --without-video",
    ),
    "rehearse": Place(
        "onebend.lab.rehearsal_commands:rehearse",
        "Say how well k(s) would come out of a push before it is filmed, what costs most, and what to change.",
        "linear --runs 0",
    ),
}
