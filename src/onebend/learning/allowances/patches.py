"""Tags are patches that stiffen the beam where they sit.

How far a patch goes beyond the black square that is seen is not known, only how likely each width is: a label may be
cut at its rim or far outside it. So a patch is a sum of layers of rising width, with one log factor each, whose
variances are the shares of the widths. At a distance d from a tag's middle, log k has the variance `PATCH_SD^2` times
the probability that the patch reaches as far as d.
"""

from __future__ import annotations

import numpy as np

from onebend.beam.grid import Grid
from onebend.learning.allowances.allowance import Allowance
from onebend.records import Array

PATCH_SD = 0.4  # of the log of the factor on k under a tag, before the evidence has chosen: paper to stiff plastic
SHARES = np.array([0.25, 0.5, 0.25])  # of the widths below
WIDTHS = np.array([1.05, 1.25, 1.6])  # of a patch over the tag's black square: a printed tag has a rim of one cell
USUAL_SIZE = 0.08  # of the length: a tag's black square where nobody says its size
_USUAL_WIDTHS = np.array([0.8, 1.25, 1.9])  # over `USUAL_SIZE`
_SOFT = 0.04  # of half a width: its edge in s
_FINE = 4001  # places


def patch_functions(marker_s: Array, length: float, tag_size: float, s: Array) -> Array:
    """`s.shape + (3,)`: 1 under the tags, 0 between them, one function a width; `length` and `tag_size` in m, the
    latter NaN where not known."""
    known = bool(np.isfinite(tag_size))
    half = 0.5 * (WIDTHS * tag_size / length if known else _USUAL_WIDTHS * USUAL_SIZE)
    away = np.min(np.abs(np.asarray(s)[..., None] - marker_s), axis=-1)[..., None]
    return np.asarray(0.5 - 0.5 * np.tanh((away - half) / (2.0 * _SOFT * half)))


def patch_means(marker_s: Array, length: float, tag_size: float, grid: Grid) -> Array:
    """`grid.nodes.shape + (3,)`: means of `patch_functions` over the part of the beam that each node's weight stands
    for.

    A patch is about as wide as nodes are apart. The values at the nodes would let its width depend on where they lie.
    """
    fine = np.linspace(0.0, 1.0, _FINE)
    values = patch_functions(marker_s, length, tag_size, fine)
    steps = 0.5 * (values[1:] + values[:-1]) / (_FINE - 1)
    integral = np.concatenate([np.zeros((1, len(WIDTHS))), np.cumsum(steps, axis=0)])
    edges = np.cumsum(grid.weights, axis=-1)
    to_edges = np.stack([np.interp(edges, fine, one) for one in integral.T], axis=-1)
    return np.asarray(np.diff(to_edges, axis=-2, prepend=0.0) / grid.weights[..., None])


def patches(marker_s: Array, length: float, tag_size: float, grid: Grid | None) -> Allowance:
    """The layers' factors on k, the same under all tags, for they are alike; no `grid`, no basis."""
    basis = np.zeros((0, len(WIDTHS))) if grid is None else patch_means(marker_s, length, tag_size, grid)
    labels = tuple(f"log k under the tags, {name}" for name in ("as wide as seen", "and its rim", "and around it"))
    return Allowance("patches", "log k", "1", labels, PATCH_SD * np.sqrt(SHARES), basis, shared=True, sized=True)
