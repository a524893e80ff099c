"""Tags are patches that stiffen the beam where they sit."""

from __future__ import annotations

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.records import Array

PATCH_SD = 0.4  # of the log of the factor on k under a tag, before the evidence has chosen: paper to stiff plastic
RIM = 1.25  # a printed tag over its black square
USUAL_SIZE = 0.08  # of the length: a tag's black square where nobody says its size
_SOFT = 0.08  # of a tag: its edge in s


def patch_function(marker_s: Array, length: float, tag_size: float, s: Array) -> Array:
    """`s.shape`: 1 under the tags, 0 between them; `length` and `tag_size` in m, the latter NaN where not known."""
    size = tag_size if np.isfinite(tag_size) else USUAL_SIZE * length
    half = 0.5 * RIM * size / length
    away = np.min(np.abs(np.asarray(s)[..., None] - marker_s), axis=-1)
    return np.asarray(0.5 - 0.5 * np.tanh((away - half) / (2.0 * _SOFT * half)))


def patches(marker_s: Array, length: float, tag_size: float, nodes: Array) -> Allowance:
    """One factor on k under all tags, for they are alike; `nodes` (Q,) or (F, Q)."""
    basis = patch_function(marker_s, length, tag_size, nodes)[..., None]
    return Allowance(
        "patches", "log k", "1", ("log k under the tags",), np.array([PATCH_SD]), basis, shared=True, sized=True
    )
