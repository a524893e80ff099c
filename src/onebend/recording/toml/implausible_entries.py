"""Implausible numbers in recording.toml, possible but probably wrong: of the camera, the mass, an sd."""

from __future__ import annotations

import math
from typing import Any

from onebend.recording.toml.beam_entry import BeamEntry
from onebend.recording.toml.entries import TagsEntry
from onebend.recording.toml.source_entries import CameraEntry
from onebend.records import CURVATURE_SD, Remark

PIXELS = 0.05  # by which fx and fy may differ: pixels are square
MIDDLE = 0.2  # of the picture, that the principal point may be away from its middle
SHORTEST, LONGEST = 0.3, 10.0  # focal length over the picture's longer side: 118 deg to 6 deg of view
HEAVIEST = 50.0  # kg/m, a steel bar of 90 mm
RIDERS = 20.0  # masses of the beam, of all that rides on it
LOOSEST = math.radians(15.0)  # sd of a clamp's direction
ROUNDEST = 2.0  # rad, sd of what a beam turns by its own curvature
ROUGHEST = 0.1  # sd of a picture's scale
LONG = 10.0  # m, of a beam
NOWHERE = 0.2  # of the length, sd of a place
TURNED = math.radians(45.0)  # sd of a direction
SCALED = 0.5  # sd of the force's scale
SOURCES = ("video", "markers", "poses", "photos")


def entry_remarks(beam: BeamEntry, camera: CameraEntry | None) -> tuple[Remark, ...]:
    """A warning for each number that is probably wrong, a note on two that are easily swapped."""
    remarks = [] if camera is None else [Remark("warning", text, about="camera") for text in camera_doubts(camera)]
    if beam.mass / beam.length > HEAVIEST:
        text = f"mass_kg makes the beam weigh {beam.mass / beam.length:.3g} kg a metre: is it in kilograms?"
        remarks.append(Remark("warning", text, about="unit"))
    riding = sum(one.mass for one in beam.masses)
    if riding > RIDERS * beam.mass:
        text = f"what rides on the beam weighs {riding:.3g} kg, {riding / beam.mass:.2g} times the beam: in kilograms?"
        remarks.append(Remark("warning", text, about="unit"))
    if beam.width > beam.thickness:
        text = (
            f"width_m = {beam.width:g} is larger than thickness_m = {beam.thickness:g}, so the beam bends over its "
            "thicker side: width_m lies in the plane of bending. Are the two swapped?"
        )
        remarks.append(Remark("note", text))
    return tuple(remarks)


def spread_remarks(beam: BeamEntry, entries: dict[str, Any], scale_sd: float) -> tuple[Remark, ...]:
    """A warning for each stated sd (clamp, rest shape, scale) that is too large, a note on one that is not used."""
    warnings = []
    clamp = max((entries[name].clamp_sd for name in SOURCES if entries[name] is not None), default=math.nan)
    if clamp > LOOSEST:
        warnings.append(
            f"clamp_sd_deg = {math.degrees(clamp):g} lets the clamp turn freely: k near it cannot be known then. "
            "Write how firm it is."
        )
    if beam.rest == "unknown" and beam.curvature_sd > ROUNDEST:
        warnings.append(
            f"rest_curvature_sd_deg = {math.degrees(beam.curvature_sd):.3g} is a beam that may be rolled up: is it in "
            "degrees?"
        )
    if scale_sd > ROUGHEST:
        warnings.append(f"scale_sd = {scale_sd:g} is {100.0 * scale_sd:g} %: is it a share (0.003 = 0.3 %)?")
    remarks = [Remark("warning", text, about="wide tolerance") for text in warnings]
    if beam.rest == "straight" and beam.curvature_sd not in (0.0, CURVATURE_SD):
        remarks.append(Remark("note", 'rest_curvature_sd_deg is used only with rest = "unknown".'))
    return tuple(remarks)


def unit_remarks(beam: BeamEntry, tags: TagsEntry, entries: dict[str, Any]) -> tuple[Remark, ...]:
    """A warning for each size that looks written in another unit, or says nothing."""
    length, warnings = beam.length, []
    if length > LONG:
        warnings.append(f"length_m = {length:g} is a beam longer than {LONG:g} m: is it in metres?")
    if tags.size > length:
        warnings.append(f"size_m = {tags.size:g} is a tag wider than the beam is long: are both in metres?")
    sizes = (("width_m", beam.width), ("thickness_m", beam.thickness), ("diameter_m", beam.diameter))
    warnings += [
        f"{name} = {size:g} is a section larger than the beam is long: are both in metres?"
        for name, size in sizes
        if size > length
    ]
    push, force, gravity = entries["push"], entries["force"], entries["gravity"]
    sds = [("placement_sd_m", tags.placement_sd), ("at_sd_m", math.nan if push is None else push.at_sd)]
    for name, sd in sds:
        if sd > NOWHERE * length:
            warnings.append(f"{name} = {sd:g} is more than a fifth of the beam's length: is it in metres?")
    turns = [
        ("turn_sd_deg", tags.turn_sd),
        ("rotation_sd_deg", math.nan if force is None else force.rotation_sd),
        ("direction_sd_deg", math.nan if gravity is None else gravity.direction_sd),
    ]
    open_turns = [
        f"{name} = {math.degrees(sd):g} leaves the direction open: is it right?" for name, sd in turns if sd > TURNED
    ]
    if force is not None and force.gain_sd > SCALED:
        warnings.append(f"gain_sd = {force.gain_sd:g} is {100.0 * force.gain_sd:g} %: is it a share (0.02 = 2 %)?")
    return (
        *(Remark("warning", text, about="unit") for text in warnings),
        *(Remark("warning", text, about="wide tolerance") for text in open_turns),
    )


def camera_doubts(camera: CameraEntry) -> list[str]:
    """What is unlikely of a calibration."""
    warnings = []
    if abs(camera.fx / camera.fy - 1.0) > PIXELS:
        warnings.append(f"[camera] fx = {camera.fx:g} and fy = {camera.fy:g} differ by more than 5 %: check them.")
    longer = max(camera.width, camera.height)
    if not SHORTEST * longer < camera.fx < LONGEST * longer:
        warnings.append(f"[camera] fx = {camera.fx:g} is unlikely for a picture {longer} px wide: is it in pixels?")
    off = max(abs((camera.cx + 0.5) / camera.width - 0.5), abs((camera.cy + 0.5) / camera.height - 0.5))
    if off > MIDDLE:
        warnings.append(
            f"[camera] the principal point ({camera.cx:g}, {camera.cy:g}) is far from the picture's middle "
            f"({0.5 * (camera.width - 1):g}, {0.5 * (camera.height - 1):g}): check cx and cy."
        )
    return warnings
