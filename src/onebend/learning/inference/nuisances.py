"""What is said of the parameters beside k(s): each by itself, and of a force log's slow error its mean and drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.learning.inference.hyperparameters import SPREAD
from onebend.learning.model.fit_data import Film
from onebend.learning.model.parameters import Block
from onebend.records import Array


@dataclass(frozen=True)
class Quantities:
    """Numbers that are linear in a block's parameters."""

    labels: tuple[str, ...]
    units: tuple[str, ...]
    weights: Array  # (N, parameters of the block)
    prior_sd: Array  # (N,) before the data, the sizes of a force's error as open as they then are


def quantities(block: Block, films: Sequence[Film]) -> Quantities:
    """A block's own parameters; for a force log's error, a spline in time, what it is over the frames of the push."""
    if block.name != "force":
        return Quantities(block.labels, (block.unit,) * len(block.labels), np.eye(len(block.labels)), block.prior_sd)
    seen = films[block.recording]
    away = seen.observations.time[seen.frames]
    away = away - np.mean(away)
    over = seen.error.weights[: len(away)]
    rows = np.stack([np.mean(over, axis=0), away @ over / max(float(away @ away), 1e-300)])
    whose = block.labels[0].rpartition(": ")[0]
    names = tuple(f"{whose}: {what} {axis}" for what in ("mean force error", "force drift") for axis in "xy")
    coloured, _, walk, load = np.exp(SPREAD**2).tolist()  # root mean squares of log-normal factors
    prior = seen.error.covariance(coloured, 1.0, walk, load)
    before = np.sqrt(np.einsum("rk,kl,rl->r", rows, prior, rows))
    return Quantities(names, ("N", "N", "N/s", "N/s"), np.kron(rows, np.eye(2)), np.repeat(before, 2))
