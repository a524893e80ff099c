"""Tags are patches that stiffen the beam where they sit."""

from __future__ import annotations

import numpy as np

from onebend.learning.allowances.allowance import Allowance
from onebend.records import Array, Observations

PATCH_SD = 0.4  # of the log of the factor on k under a tag, before the evidence has chosen: paper to stiff plastic
RIM = 1.25  # a printed tag over its black square
USUAL_SIZE = 0.08  # of the length: a tag's black square where nobody says its size
_SOFT = 0.08  # of a tag: its edge in s


def patch_function(observations: Observations, s: Array) -> Array:
    """`s.shape`: 1 under the tags, 0 between them."""
    stated = observations.stated.tag_size
    size = stated if np.isfinite(stated) else USUAL_SIZE * observations.length
    half = 0.5 * RIM * size / observations.length
    away = np.min(np.abs(np.asarray(s)[..., None] - observations.marker_s), axis=-1)
    return np.asarray(0.5 - 0.5 * np.tanh((away - half) / (2.0 * _SOFT * half)))


def patches(observations: Observations, nodes: Array) -> Allowance:
    """One factor on k under all tags, for they are alike; `nodes` (Q,) or (F, Q)."""
    basis = patch_function(observations, nodes)[..., None]
    return Allowance(
        "patches", "log k", "1", ("log k under the tags",), np.array([PATCH_SD]), basis, shared=True, sized=True
    )
