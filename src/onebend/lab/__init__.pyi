from .bench import (
    FRANKA as FRANKA,
    WRIST as WRIST,
    ForceSensor as ForceSensor,
    PushProfile as PushProfile,
    RealBench as RealBench,
    TagNoise as TagNoise,
)
from .designs import (
    DESIGNS as DESIGNS,
    Design as Design,
    Expected as Expected,
    ModulusEstimate as ModulusEstimate,
    TipBend as TipBend,
    design_named as design_named,
    expect as expect,
    force_that_bends as force_that_bends,
    from_shore_a as from_shore_a,
    random_stiffness as random_stiffness,
    read_design as read_design,
    width_table as width_table,
)
from .filming import Filming as Filming, film as film
from .forecast import (
    KnownBeam as KnownBeam,
    PredictedBand as PredictedBand,
    Setup as Setup,
    SetupChange as SetupChange,
    Tolerances as Tolerances,
    known_beam as known_beam,
    setup_of as setup_of,
)
from .random_bench import FilmRequest as FilmRequest, filming_of as filming_of
from .rehearsal import Rehearsal as Rehearsal, rehearse as rehearse
from .rendering import Camera as Camera, Scene as Scene
from .rod import RodMotion as RodMotion
from .sheet import Sheet as Sheet, tag_pages as tag_pages, write_pages as write_pages
from .virtual import (
    DeclaredValues as DeclaredValues,
    TrueStiffness as TrueStiffness,
    VirtualBench as VirtualBench,
    VirtualClock as VirtualClock,
    VirtualRecording as VirtualRecording,
    VirtualTag as VirtualTag,
    observe_virtual as observe_virtual,
    true_stiffness as true_stiffness,
    virtual_recording as virtual_recording,
)

COMMANDS: dict[str, object]
