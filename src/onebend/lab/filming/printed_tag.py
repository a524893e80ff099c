"""A printed tag as polygons."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from onebend.recording.tags.printed_code import printed_tag
from onebend.recording.toml.entries import FAMILIES
from onebend.records import Array


@dataclass(frozen=True)
class TagOutlines:
    """In the tag's own frame, in sides of its detected square: origin in its middle, x to the print's right, y up."""

    paper: Array  # (1, 4, 2)
    ink: Array  # (K, 4, 2): black cells that are neighbours in a row make one patch


@cache
def outlines(tag_id: int, family: str = FAMILIES[0], margin: float = 1.0) -> TagOutlines:
    """What is drawn of a tag on paper that is at least `margin` cells wider on every side than the detected square.

    Raises:
        RecordingError: a family that is not known, or a number that it does not have.
    """
    tag = printed_tag(tag_id, family)
    count = len(tag.cells)
    beyond = max(margin - tag.margin, 0.0)
    scale, middle = np.array([1.0, -1.0]) / tag.border, 0.5 * count
    paper = (rectangle(-beyond, count + beyond, -beyond, count + beyond) - middle) * scale
    return TagOutlines(paper[None], (tag.ink - middle) * scale)


def as_printed(made: TagOutlines, size: float, dot: float, phase: Array) -> TagOutlines:
    """In metres, of a tag whose square measures `size`: a printer sets every edge on its grid of dots.

    `dot` [m] is the grid's step (0: print without error), `phase` (2,) in [0, 1) where on it the tag's middle falls.
    Half the dots of a tag are so on either side of where they should be: each edge is up to `dot` / 2 off, evenly.
    """
    if dot == 0.0:
        return TagOutlines(size * made.paper, size * made.ink)
    on_grid = dot * (np.round(size * made.ink / dot + phase) - phase)
    return TagOutlines(size * made.paper, on_grid)


def rectangle(left: float, right: float, top: float, bottom: float) -> Array:
    """Corners (4, 2)."""
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]], dtype=float)


def placed(loops: Array, pose: Array) -> Array:
    """Polygons (..., corners, 2) [m] of a thing that sits at `pose` (3,) x, y [m], angle [rad]."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(loops @ np.array([[cos, sin], [-sin, cos]]) + pose[:2])
