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
    from onebend.lab.expected import Bend as Bend
    from onebend.lab.expected import Expected as Expected
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
    from onebend.lab.filming.film import film as film
    from onebend.lab.filming.film_setup import Filming as Filming
    from onebend.lab.filming.scene import Scene as Scene
    from onebend.lab.filming.viewpoint import Camera as Camera
    from onebend.lab.materials import Silicone as Silicone
    from onebend.lab.materials import Stiffness as Stiffness
    from onebend.lab.materials import silicone as silicone
    from onebend.lab.named import Wish as Wish
    from onebend.lab.named import filming_of as filming_of
    from onebend.lab.pushes import Push as Push
    from onebend.lab.sensors import FRANKA as FRANKA
    from onebend.lab.sensors import WRIST as WRIST
    from onebend.lab.sensors import ForceSensor as ForceSensor
    from onebend.lab.shortcut import observe_quickly as observe_quickly
    from onebend.lab.tag_errors import TagNoise as TagNoise
    from onebend.lab.truths import force_that_bends as force_that_bends
    from onebend.lab.truths import random_stiffness as random_stiffness
    from onebend.lab.virtual import Bench as Bench
    from onebend.lab.virtual import Clock as Clock
    from onebend.lab.virtual import Said as Said
    from onebend.lab.virtual import Tag as Tag
    from onebend.lab.virtual import Virtual as Virtual
    from onebend.lab.virtual import observe_virtual as observe_virtual
    from onebend.lab.virtual import virtual_recording as virtual_recording
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "onebend.lab.design_file": "read_design",
            "onebend.lab.designs": "DESIGNS Design design_named width_table",
            "onebend.lab.expected": "Bend Expected expect",
            "onebend.lab.fabrication.clamp": "TagSeat carriers clamp",
            "onebend.lab.fabrication.mould": "Mould MouldSettings PrintedPart mould",
            "onebend.lab.fabrication.page": "Fill Line Page Text write_pages",
            "onebend.lab.fabrication.sheet": "Sheet tag_pages",
            "onebend.lab.fabrication.solids": "write_mesh",
            "onebend.lab.filming.film": "film",
            "onebend.lab.filming.film_setup": "Filming",
            "onebend.lab.filming.scene": "Scene",
            "onebend.lab.filming.viewpoint": "Camera",
            "onebend.lab.materials": "Silicone Stiffness silicone",
            "onebend.lab.named": "Wish filming_of",
            "onebend.lab.pushes": "Push",
            "onebend.lab.sensors": "FRANKA WRIST ForceSensor",
            "onebend.lab.shortcut": "observe_quickly",
            "onebend.lab.tag_errors": "TagNoise",
            "onebend.lab.truths": "force_that_bends random_stiffness",
            "onebend.lab.virtual": "Bench Clock Said Tag Virtual observe_virtual virtual_recording",
        },
    )
