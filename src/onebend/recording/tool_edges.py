"""The edges of a tool in pictures where it roughly is known, and so the middle of its end on the body's flank.

A tool is alike along its own axis, its edges are sharp, and it is equally wide in all pictures. A shadow is the
background, darker by a factor; its edges are soft.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, map_coordinates

from onebend.recording.plane import project, scale_of
from onebend.records import Array, BoolArray, View

STEP = 0.5  # px, of the samples
SHARP = 2.0  # samples, sd: of the derivative that finds an edge
ASIDE = 0.08  # of the length, to either side of the rough place
OUTWARD = (0.015, 0.065)  # of the length from the flank: there the tool is looked at
ABOUT = (-0.035, 0.03)  # of the length from the rough flank: there its end is looked for
TURNS = np.tan(np.radians(np.linspace(-8.0, 8.0, 9)))  # from the rough direction
SHADOW = (0.5, 1.05)  # factors on the background that a shadow may be
NOISE = 2.0  # of 255 squared: variance that is taken for the camera's
CLEAREST = 2.0  # log ratio: no sample says more
EDGES_WORTH = 3e-3  # m of the clearest tool between them: two sharp edges
LEVEL = 0.35  # of the change at the tool's end, where it ends
SAME_WIDTH = 0.15  # of the width, by which a picture may show another one
ABOUT_SAME = 4.0  # samples, likewise


@dataclass(frozen=True)
class ToolStrip:
    """Straight axes at the rough place of a tool in one picture, and how it is seen there."""

    picture: NDArray[np.float32]
    view: View
    origin: Array  # (2,) m on the body's axis
    tangent: Array  # (2,)
    outward: Array  # (2,) to the tool's side
    flank: float  # m outward
    slope: float  # m along the tangent per m outward
    bend: float  # 1/m, of the body's axis towards the tool

    def seen(self, picture: NDArray[np.float32], aside: Array, out: Array) -> Array:
        """(A, B) of a picture at `aside` (A, 1) m from the tool's axis and `out` (1, B) m outward."""
        along = aside + self.slope * (out - self.flank)
        xy = self.origin + along[..., None] * self.tangent + out[..., None] * self.outward
        px = project(self.view, xy)
        return np.asarray(map_coordinates(picture, [px[..., 1], px[..., 0]], np.float32, order=1, mode="nearest"))


@dataclass(frozen=True)
class Contacts:
    """The middle of a tool's end in P pictures."""

    along: Array  # (P,) m along the body's axis, from the origin of each strip
    width: float  # m
    clear: BoolArray  # (P,) in which the tool is as wide as in the others


def contacts(strips: Sequence[ToolStrip], background: NDArray[np.float32], length: float, width: float) -> Contacts:
    """The tool in these strips; `background` is a picture without it, `width` m at most the tool's."""
    step = STEP / scale_of(strips[0].view, length)  # m
    aside = np.arange(-ASIDE * length, ASIDE * length + step, step)
    turned = [_turned(strip, aside, length, step) for strip in strips]
    edges = np.stack([edge for _, edge in turned])
    alike = np.stack([_alike(strip, background, aside, length, step) for strip, _ in turned])
    scores = partial(_scores, edges, alike, aside, step, width)
    widest = min(round(1.4 * width / step), len(aside) - 2)  # both edges are inside
    wide = np.arange(max(round(0.3 * width / step), 2), widest + 1)
    count = int(max(wide, key=lambda n: float(np.sum(np.max(scores(int(n)), axis=1)))))
    first = np.argmax(scores(count), axis=1)
    pairs = [[_edge_near(aside, edge, i) for i in (at, at + count)] for edge, at in zip(edges, first, strict=True)]
    left, right = np.array(pairs).T
    middle = 0.5 * (left + right)
    clear = np.abs(right - left - count * step) < max(SAME_WIDTH * count, ABOUT_SAME) * step
    found = [
        _end(strip, float(at), 0.3 * count * step, length, step) for (strip, _), at in zip(turned, middle, strict=True)
    ]
    out = float(np.median(found))
    along = middle + np.array([strip.slope * (out - strip.flank) for strip, _ in turned])
    return Contacts(along / np.array([1.0 - strip.bend * out for strip in strips]), count * step, clear)


def _turned(strip: ToolStrip, aside: Array, length: float, step: float) -> tuple[ToolStrip, Array]:
    """The strip in the direction in which its edges are sharpest, and their sizes there (A,), over the largest."""
    out = strip.flank + np.arange(OUTWARD[0] * length, OUTWARD[1] * length, 2.0 * step)
    best: tuple[float, ToolStrip, Array] | None = None
    for turn in TURNS:
        tried = replace(strip, slope=strip.slope + float(turn))
        mean = tried.seen(strip.picture, aside[:, None], out[None]).mean(axis=1)
        edge = np.abs(gaussian_filter1d(mean, SHARP, order=1))
        sharpness = float(np.sum(np.sort(edge)[-8:] ** 2))
        if best is None or sharpness > best[0]:
            best = sharpness, tried, edge
    assert best is not None
    return best[1], best[2] / max(float(np.mean(np.sort(best[2])[-3:])), 1e-9)


def _alike(strip: ToolStrip, background: NDArray[np.float32], aside: Array, length: float, step: float) -> Array:
    """(A,) log ratios of how badly the background in a shadow, and one colour along the tool, explain the picture."""
    out = strip.flank + np.arange(OUTWARD[0] * length, OUTWARD[1] * length, 2.0 * step)
    seen, behind = (strip.seen(one, aside[:, None], out[None]) for one in (strip.picture, background))
    squares = np.maximum(np.sum(behind**2, axis=1), 1.0)
    factor = np.clip(np.sum(seen * behind, axis=1) / squares, *SHADOW)
    by_shadow = np.mean((seen - factor[:, None] * behind) ** 2, axis=1)
    return np.asarray(np.clip(np.log((by_shadow + NOISE) / (seen.var(axis=1) + NOISE)), -CLEAREST, CLEAREST))


def _scores(edges: Array, alike: Array, aside: Array, step: float, width: float, count: int) -> Array:
    """(P, A - count) of tools `count` samples wide that begin at each sample."""
    total = np.cumsum(np.concatenate([np.zeros((len(alike), 1)), alike], axis=1), axis=1)
    out = total[:, count + 1 :] - total[:, : -count - 1]
    out = out + EDGES_WORTH / step * np.minimum(edges[:, :-count], edges[:, count:])
    far = np.abs(aside[:-count] + 0.5 * count * step) > 0.5 * width + 4.0 * step
    return np.where(far, -np.inf, out)


def _edge_near(aside: Array, edge: Array, at: int) -> float:
    """m, of the sharpest edge (A,) near a sample."""
    near = np.arange(max(at - 3, 0), min(at + 4, len(edge)))
    top = int(near[np.argmax(edge[near])])
    near = np.arange(max(top - 3, 0), min(top + 4, len(edge)))
    weight = np.maximum(edge[near] - 0.5 * edge[top], 0.0)
    return float(np.sum(aside[near] * weight) / max(float(np.sum(weight)), 1e-12))


def _end(strip: ToolStrip, middle: float, half: float, length: float, step: float) -> float:
    """m outward at which the tool with this middle and (less than) half a width ends."""
    out = strip.flank + np.arange(ABOUT[0] * length, ABOUT[1] * length, step)
    across = middle + np.linspace(-half, half, 9)
    level = gaussian_filter1d(strip.seen(strip.picture, across[:, None], out[None]).mean(axis=0), 1.0)
    outside = out > strip.flank + OUTWARD[0] * length
    off = np.abs(level - np.median(level[outside]))
    other = np.flatnonzero((off > LEVEL * float(np.max(off[~outside]))) & ~outside)
    return float(out[other[-1]]) if len(other) else strip.flank
