"""The virtual lab: pushes of known beams, with known errors of sensor, camera and mounting."""

from __future__ import annotations

from typing import TYPE_CHECKING

from onebend.lazy import lazy_names

if TYPE_CHECKING:
    from onebend.lab.design_file import read_design as read_design
    from onebend.lab.designs import DESIGNS as DESIGNS
    from onebend.lab.designs import Design as Design
    from onebend.lab.designs import design_named as design_named
    from onebend.lab.designs import width_table as width_table
    from onebend.lab.direct_observation import observe_from_truth as observe_from_truth
    from onebend.lab.expected import Expected as Expected
    from onebend.lab.expected import TipBend as TipBend
    from onebend.lab.expected import expect as expect
    from onebend.lab.fabrication.clamp import TagSeat as TagSeat
    from onebend.lab.fabrication.clamp import carriers as carriers
    from onebend.lab.fabrication.clamp import clamp as clamp
    from onebend.lab.fabrication.mould import Mould as Mould
    from onebend.lab.fabrication.mould import MouldSettings as MouldSettings
    from onebend.lab.fabrication.mould import PrintedPart as PrintedPart
    from onebend.lab.fabrication.mould import mould as mould
    from onebend.lab.fabrication.page import Fill as Fill
    from onebend.lab.fabrication.page import Line as Line
    from onebend.lab.fabrication.page import Page as Page
    from onebend.lab.fabrication.page import Text as Text
    from onebend.lab.fabrication.page import write_pages as write_pages
    from onebend.lab.fabrication.sheet import Sheet as Sheet
    from onebend.lab.fabrication.sheet import tag_pages as tag_pages
    from onebend.lab.fabrication.solids import write_mesh as write_mesh
    from onebend.lab.film_request import FilmRequest as FilmRequest
    from onebend.lab.film_request import filming_of as filming_of
    from onebend.lab.filming.film import film as film
    from onebend.lab.filming.film_setup import Filming as Filming
    from onebend.lab.filming.scene import Scene as Scene
    from onebend.lab.filming.viewpoint import Camera as Camera
    from onebend.lab.materials import ModulusEstimate as ModulusEstimate
    from onebend.lab.materials import Silicone as Silicone
    from onebend.lab.materials import silicone as silicone
    from onebend.lab.pushes import PushProfile as PushProfile
    from onebend.lab.random_beams import force_that_bends as force_that_bends
    from onebend.lab.random_beams import random_stiffness as random_stiffness
    from onebend.lab.sensors import FRANKA as FRANKA
    from onebend.lab.sensors import WRIST as WRIST
    from onebend.lab.sensors import ForceSensor as ForceSensor
    from onebend.lab.tag_errors import TagNoise as TagNoise
    from onebend.lab.virtual import DeclaredValues as DeclaredValues
    from onebend.lab.virtual import VirtualBench as VirtualBench
    from onebend.lab.virtual import VirtualClock as VirtualClock
    from onebend.lab.virtual import VirtualRecording as VirtualRecording
    from onebend.lab.virtual import VirtualTag as VirtualTag
    from onebend.lab.virtual import observe_virtual as observe_virtual
    from onebend.lab.virtual import virtual_recording as virtual_recording
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.lab.design_file": "read_design",
            "onebend.lab.designs": "DESIGNS Design design_named width_table",
            "onebend.lab.direct_observation": "observe_from_truth",
            "onebend.lab.expected": "Expected TipBend expect",
            "onebend.lab.fabrication.clamp": "TagSeat carriers clamp",
            "onebend.lab.fabrication.mould": "Mould MouldSettings PrintedPart mould",
            "onebend.lab.fabrication.page": "Fill Line Page Text write_pages",
            "onebend.lab.fabrication.sheet": "Sheet tag_pages",
            "onebend.lab.fabrication.solids": "write_mesh",
            "onebend.lab.film_request": "FilmRequest filming_of",
            "onebend.lab.filming.film": "film",
            "onebend.lab.filming.film_setup": "Filming",
            "onebend.lab.filming.scene": "Scene",
            "onebend.lab.filming.viewpoint": "Camera",
            "onebend.lab.materials": "ModulusEstimate Silicone silicone",
            "onebend.lab.pushes": "PushProfile",
            "onebend.lab.random_beams": "force_that_bends random_stiffness",
            "onebend.lab.sensors": "FRANKA WRIST ForceSensor",
            "onebend.lab.tag_errors": "TagNoise",
            "onebend.lab.virtual": (
                "DeclaredValues VirtualBench VirtualClock VirtualRecording VirtualTag observe_virtual virtual_recording"
            ),
        },
    )
