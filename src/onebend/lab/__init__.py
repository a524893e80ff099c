"""The virtual lab: pushes of known beams, with known errors of sensor, camera and mounting."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import Place, lazy_names, shown_names

if TYPE_CHECKING:
    from onebend.lab.bench import (
        FRANKA as FRANKA,
        WRIST as WRIST,
        ForceSensor as ForceSensor,
        PushProfile as PushProfile,
        RealBench as RealBench,
        TagNoise as TagNoise,
    )
    from onebend.lab.designs import (
        DESIGNS as DESIGNS,
        Design as Design,
        Expected as Expected,
        ModulusEstimate as ModulusEstimate,
        Silicone as Silicone,
        TipBend as TipBend,
        design_named as design_named,
        expect as expect,
        force_that_bends as force_that_bends,
        random_stiffness as random_stiffness,
        read_design as read_design,
        silicone as silicone,
        width_table as width_table,
    )
    from onebend.lab.fabrication import (
        Mould as Mould,
        MouldSettings as MouldSettings,
        PrintedPart as PrintedPart,
        TagSeat as TagSeat,
        carriers as carriers,
        clamp as clamp,
        mould as mould,
        write_mesh as write_mesh,
    )
    from onebend.lab.filming import Filming as Filming, film as film
    from onebend.lab.forecast import (
        BudgetEntry as BudgetEntry,
        KnownBeam as KnownBeam,
        PredictedBand as PredictedBand,
        Setup as Setup,
        SetupChange as SetupChange,
        known_beam as known_beam,
        setup_of as setup_of,
    )
    from onebend.lab.random_bench import FilmRequest as FilmRequest, filming_of as filming_of
    from onebend.lab.rehearsal import (
        Obtained as Obtained,
        Rehearsal as Rehearsal,
        SimulatedRun as SimulatedRun,
        rehearse as rehearse,
    )
    from onebend.lab.rendering import Camera as Camera, Scene as Scene
    from onebend.lab.rod import RodMotion as RodMotion
    from onebend.lab.sensed_force import (
        SensedForce as SensedForce,
        SensedTags as SensedTags,
        drawn_tags as drawn_tags,
        felt_by as felt_by,
    )
    from onebend.lab.sheet import (
        Fill as Fill,
        Line as Line,
        Page as Page,
        Sheet as Sheet,
        Text as Text,
        tag_pages as tag_pages,
        write_pages as write_pages,
    )
    from onebend.lab.virtual import (
        DeclaredValues as DeclaredValues,
        TrueStiffness as TrueStiffness,
        VirtualBench as VirtualBench,
        VirtualClock as VirtualClock,
        VirtualRecording as VirtualRecording,
        VirtualTag as VirtualTag,
        observe_from_truth as observe_from_truth,
        observe_virtual as observe_virtual,
        true_stiffness as true_stiffness,
        virtual_recording as virtual_recording,
    )
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__, shown_names(__file__))

COMMANDS = {
    "loop": Place(
        "onebend.lab.rehearsal_commands:loop",
        "Rehearse a closed loop: force for a goal, corrected by a camera, on beams that are not the model.",
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
