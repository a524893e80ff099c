"""Frames of the scene: what moves is drawn over the table for several moments of the exposure, and their mean is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from onebend.lab.raster import Box, Image, box_around, coverage
from onebend.lab.scene import Colour, Picture, Scene, backdrop, blend, lamp, light_at, yuv
from onebend.recording.lens import project
from onebend.records import Array, View

BLURRED = 4  # px: how far beyond what moves the lens blurs
BLACK, RANGE = 16.0, 219.0  # luma of a video
COLOUR_RANGE = 224.0
COLOUR_NOISE = 0.5  # of the brightness's


@dataclass(frozen=True)
class Layer:
    """Polygons of one colour (..., corners, 2) [m on the table]; `density` below 1 lets shine through (a shadow)."""

    loops: Array
    colour: Colour
    density: float = 1.0
    soft: float = 0.0  # px, blur of the edges


@dataclass(frozen=True)
class Stage:
    """What does not change over a film."""

    scene: Scene
    view: View
    table: Picture
    light: Image  # (H, W)
    half_light: Image
    scope: Box  # holds whatever moves


def stage(scene: Scene, view: View, size: tuple[int, int], still: list[Layer], moving: Array, seed: int) -> Stage:
    """The table with its `still` layers, seen in `size` (width, height); all that moves stays within `moving` (N, 2) m.

    Two stages of one seed look alike.
    """
    width, height = size
    table = backdrop(scene, view, (height, width), np.random.default_rng([seed, 10]))
    full = Box(0, 0, width, height)
    draw(table, still, view, full)
    light = lamp(scene, (height, width))
    scope = box_around(project(view, moving), width, height, margin=4.0 * BLURRED)
    return Stage(scene, view, table, light, light[::2, ::2], scope)


def draw(picture: Picture, layers: list[Layer], view: View, scope: Box) -> None:
    """Draw layers over `picture`, which shows the box `scope` of the whole, in place."""
    for layer in layers:
        px = project(view, layer.loops)
        box = box_around(px, scope.right, scope.bottom, margin=2.0 + 3.0 * layer.soft)
        box = Box(max(box.left, scope.left), max(box.top, scope.top), box.right, box.bottom)
        if 0 in box.shape or box.right <= box.left or box.bottom <= box.top:
            continue
        cover = coverage(px, box)
        if layer.soft > 0.0:
            cover = gaussian_filter(cover, layer.soft, truncate=2.5)
        full, half = box.within(scope), box.halved.within(scope.halved)
        blend(picture, cover * np.float32(layer.density), yuv(layer.colour), full, half)


def frame_of(staged: Stage, moments: list[list[Layer]], time: float, rng: np.random.Generator) -> Picture:
    """The frame around `time` [s] as 8 bit planes: the mean over `moments` of its exposure, light, blur and noise."""
    scope = staged.scope
    full, half = scope.slices, scope.halved.slices
    mean = Picture(*(np.zeros_like(p[part]) for p, part in planes(staged.table, full, half)))
    for layers in moments:
        now = Picture(*(p[part].copy() for p, part in planes(staged.table, full, half)))
        draw(now, layers, staged.view, scope)
        for total, (plane, _) in zip((mean.y, mean.u, mean.v), planes(now, full, half), strict=True):
            total += plane
    share = np.float32(1.0 / len(moments))
    seen = Picture(staged.table.y.copy(), staged.table.u.copy(), staged.table.v.copy())
    inner = tuple(slice(BLURRED, side - BLURRED) for side in scope.shape)
    sharp = gaussian_filter(mean.y * share, staged.scene.blur, truncate=3.5)
    seen.y[full][inner] = sharp[inner]
    seen.u[half], seen.v[half] = mean.u * share, mean.v * share
    return exposed(staged, seen, np.float32(light_at(staged.scene, time)), rng)


def planes(
    picture: Picture, full: tuple[slice, slice], half: tuple[slice, slice]
) -> tuple[tuple[Image, tuple[slice, slice]], ...]:
    """Each plane with the part of it that is meant."""
    return (picture.y, full), (picture.u, half), (picture.v, half)


def exposed(staged: Stage, seen: Picture, strength: np.float32, rng: np.random.Generator) -> Picture:
    """Light, noise and rounding: planes of 8 bit."""
    scene = staged.scene
    y = seen.y * staged.light * strength
    noise = np.float32(scene.noise / 255.0)
    y += noise * np.sqrt(0.4 + 1.2 * y) * rng.standard_normal(y.shape, dtype=np.float32)
    out = [np.clip(BLACK + RANGE * y + 0.5, 0.0, 255.0).astype(np.uint8)]
    for plane in (seen.u, seen.v):
        colour = plane * staged.half_light * strength
        colour += np.float32(COLOUR_NOISE) * noise * rng.standard_normal(colour.shape, dtype=np.float32)
        out.append(np.clip(128.5 + COLOUR_RANGE * colour, 0.0, 255.0).astype(np.uint8))
    return Picture(*out)
