"""The parameters beside k(s) as they are reported: each by itself, and of a force log's slow error mean and drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onebend.learning.inference.hyperparameters import SPREAD
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.parameters import Block
from onebend.records import Array


@dataclass(frozen=True)
class Quantities:
    """Numbers that are linear in a block's parameters."""

    labels: tuple[str, ...]
    units: tuple[str, ...]
    weights: Array  # (N, parameters of the block)
    prior_sd: Array  # (N,) before the data, the sizes of a force error integrated out


def quantities(block: Block, recordings: Sequence[FitData]) -> Quantities:
    """A block's parameters; of a force log's error (a spline in time) mean and drift over the frames of the push."""
    if block.name != "force":
        return Quantities(block.labels, (block.unit,) * len(block.labels), np.eye(len(block.labels)), block.prior_sd)
    recording = recordings[block.recording]
    time = recording.observations.time[recording.frames]
    time = time - np.mean(time)
    weights = recording.error.weights[: len(time)]
    rows = np.stack([np.mean(weights, axis=0), time @ weights / max(float(time @ time), 1e-300)])
    whose = block.labels[0].rpartition(": ")[0]
    names = tuple(f"{whose}: {what} {axis}" for what in ("mean force error", "force drift") for axis in "xy")
    coloured, _, walk, load = np.exp(SPREAD**2).tolist()  # root mean squares of log-normal factors
    prior = recording.error.covariance(coloured, 1.0, walk, load)
    before = np.sqrt(np.einsum("rk,kl,rl->r", rows, prior, rows))
    return Quantities(names, ("N", "N", "N/s", "N/s"), np.kron(rows, np.eye(2)), np.repeat(before, 2))
