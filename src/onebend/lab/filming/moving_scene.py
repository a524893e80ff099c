"""What moves before the camera, as polygons on the table: beam, tags, the tool that pushes, a hand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.lab.filming.in_space import lifted, placed_in_space
from onebend.lab.filming.printed_tag import TagOutlines, placed
from onebend.lab.filming.render import ColourLayer, Drawing, Shadow
from onebend.lab.filming.scene import Colour, Scene
from onebend.lab.pushes import PushProfile, smooth
from onebend.records import Array

SHADOW = np.array([0.0025, -0.003])  # m, from the thing that casts it
STRIPS = ((1.0, 0.92), (0.75, 1.0))  # of the beam: share of its width, brightness
PIECE = 30  # nodes of the beam
TOOL_LENGTH = 0.25  # m
RETREAT, APPROACH = 0.04, 0.8  # m, s: how far the tool waits, and how long it takes to come
HAND = (0.035, 0.022)  # m, half axes
HAND_SPEED, HAND_TIME = 0.12, 1.2  # m/s; s before and after its passing
CLAMP = (0.046, 0.05)  # m, length and width


@dataclass(frozen=True)
class MovingScene:
    """The moving things of a scene: their shapes and colours, which do not change."""

    scene: Scene
    push: PushProfile
    half_width: Array  # (S,) m, of the drawn beam
    tags: tuple[TagOutlines, ...]  # m, as printed; base tags first
    base_angle: float  # rad: the clamp's frame in the room


@dataclass(frozen=True)
class BeamPose:
    """Beam and tags at one moment, in the room."""

    time: float  # s
    xy: Array  # (S, 2) m
    angle: Array  # (S,) rad
    tags: Array  # (m, 6) x, y, angle, z, tilts
    height: Array  # (S,) m, of the beam over the table's plane
    contact: float  # s, where the tool pushes


def clamp_block(scene: Scene, base_angle: float) -> Drawing:
    """The block that holds the beam: it ends at the base."""
    length, width = CLAMP
    block = np.array([[-length, -width / 2], [0.004, -width / 2], [0.004, width / 2], [-length, width / 2]])
    inner = 0.92 * (block - block.mean(axis=0)) + block.mean(axis=0)
    pose = np.array([0.0, 0.0, base_angle])
    outer = placed(block, pose)
    layers = [ColourLayer(outer, dimmed(scene.clamp, 0.8)), ColourLayer(placed(inner, pose), scene.clamp)]
    return Drawing([Shadow(outer + SHADOW, soft=6.0)], layers)


def moment_of(cast: MovingScene, pose: BeamPose) -> Drawing:
    """Everything that moves."""
    scene, tool = cast.scene, tool_outline(cast, pose)
    above = scene.overlap > 0.0  # else it pushes the beam's flank, below the tags
    layers = [] if above else [ColourLayer(tool, scene.tool)]
    layers += [
        ColourLayer(strip(part, share * width), dimmed(scene.beam, bright))
        for share, bright in STRIPS
        for part, width in pieces(pose, cast.half_width)
    ]
    for tag, at in zip(cast.tags, pose.tags, strict=True):
        layers.append(ColourLayer(placed_in_space(tag.paper, at), grey(scene.paper)))
        layers.append(ColourLayer(placed_in_space(tag.ink, at), grey(scene.ink)))
    if above:
        layers.append(ColourLayer(tool, scene.tool))
    if abs(pose.time - scene.hand_at) < HAND_TIME:
        layers.append(ColourLayer(hand_outline(pose, scene.hand_at), scene.hand))
    shadows = [Shadow(strip(pose, cast.half_width)[:, :2] + SHADOW), Shadow(tool + SHADOW, density=0.3)]
    return Drawing(shadows, layers)


def over_rows(first: Drawing, last: Drawing, shift: Array, rows: int) -> Drawing:
    """One picture of two drawings of the same things: as the first row is exposed, and as the last one is.

    `shift` (2, 2) px: of the camera's picture at these rows.
    """
    if len(first.layers) != len(last.layers):  # a hand that comes or goes
        return replace(first, shift=shift, rows=rows)
    layers = [replace(one, late=two.loops) for one, two in zip(first.layers, last.layers, strict=True)]
    shadows = [replace(one, late=two.loops) for one, two in zip(first.shadows, last.shadows, strict=True)]
    return Drawing(shadows, layers, shift, rows)


def pieces(pose: BeamPose, half_width: Array) -> list[tuple[BeamPose, Array]]:
    """The beam cut along its length. Pieces overlap, so that no seam shows."""
    out = []
    for first in range(0, len(half_width) - 1, PIECE):
        part = slice(first, first + PIECE + 2)
        cut = replace(pose, xy=pose.xy[part], angle=pose.angle[part], height=pose.height[part])
        out.append((cut, half_width[part]))
    return out


def grey(level: float) -> Colour:
    return (level, level, level)


def dimmed(colour: Colour, share: float) -> Colour:
    return (colour[0] * share, colour[1] * share, colour[2] * share)


def strip(pose: BeamPose, half_width: Array) -> Array:
    """Outline (2 S, 2) m of the beam, or (2 S, 3)."""
    left = half_width[:, None] * np.stack([-np.sin(pose.angle), np.cos(pose.angle)], axis=-1)
    outline = np.concatenate([pose.xy - left, (pose.xy + left)[::-1]])
    return lifted(outline, np.concatenate([pose.height, pose.height[::-1]]))


def tool_outline(cast: MovingScene, pose: BeamPose) -> Array:
    """A bar with a chamfered end that touches the beam's edge where it pushes, and waits aside before and after."""
    push, places = cast.push, np.linspace(0.0, 1.0, len(pose.xy))
    angle = float(push.angle(np.array([pose.time]))[0]) + cast.base_angle
    along = np.array([np.cos(angle), np.sin(angle)])
    touch = np.array([np.interp(pose.contact, places, pose.xy[:, i]) for i in range(2)])
    half = float(np.interp(pose.contact, places, cast.half_width))
    begin, end = push.contact
    away = smooth(np.array([(begin - pose.time) / APPROACH]))[0]
    if push.after > 0.0:
        away = away + smooth(np.array([(pose.time - end) / APPROACH]))[0]
    tip = touch + along * (cast.scene.overlap - half - RETREAT * away)
    wide, cut = 0.5 * cast.scene.tool_width, 0.25 * cast.scene.tool_width
    bar = np.array([[0, -wide + cut], [0, wide - cut], [-cut, wide], [-TOOL_LENGTH, wide]])
    bar = np.concatenate([bar, [[-TOOL_LENGTH, -wide], [-cut, -wide]]])
    return placed(bar, np.array([tip[0], tip[1], angle + cast.scene.slant]))


def hand_outline(pose: BeamPose, at: float) -> Array:
    """A blunt shape that crosses the beam's middle."""
    turn = np.linspace(0.0, 2.0 * np.pi, 41)[:-1]
    bump = 1.0 + 0.12 * np.cos(5.0 * turn)
    shape = bump[:, None] * np.stack([HAND[0] * np.cos(turn), HAND[1] * np.sin(turn)], axis=-1)
    middle = pose.xy[len(pose.xy) // 2] + np.array([0.3, 1.0]) * HAND_SPEED * (pose.time - at)
    return placed(shape, np.array([middle[0], middle[1], 1.2]))
