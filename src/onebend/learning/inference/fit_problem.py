"""What is fitted: the recordings' data, where each parameter stands, and what is expected before the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from onebend.learning.allowances.allowance import Sizes
from onebend.learning.allowances.patches import patch_functions
from onebend.learning.frequencies.frequency_data import FrequencyData
from onebend.learning.frequencies.predicted import PredictedFrequencies, predicted_frequencies
from onebend.learning.inference.block_root import BlockRoot
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.parameters import Block, Layout
from onebend.records import Array, IntArray
from onebend.workers import each


@dataclass(frozen=True)
class RecordingNoise:
    """Noise of one recording's frames, correlation in time included."""

    marker: float  # over what the tags' covariances say
    force: float  # N, the force error that is faster than its knots


@dataclass(frozen=True)
class Hyperparameters:
    """Sizes of priors and noise, which the data choose."""

    part_variances: Array  # (n,) variances of the parts of log k, see `Layout.stiffness_parts`
    coloured: float  # sd of the force error's coloured part, over what was expected
    memory: float  # its correlation time, likewise
    walk: float  # the random walk of the force error, likewise
    load: float  # sd of the force error that comes with the load, likewise
    noise: tuple[RecordingNoise, ...]
    sizes: Sizes = field(default_factory=dict)  # of allowances whose size the evidence chooses; 1 where not named
    chains: Array | None = None  # where the sampler's chains stand, see `stiffness_prior.mean_part_variances`


@dataclass(frozen=True)
class FitProblem:
    """One or several recordings of one beam, and the prior of the parameters."""

    recordings: tuple[FitData, ...]
    layout: Layout
    level: float  # prior mean of log k
    expected: Hyperparameters
    frequencies: tuple[FrequencyData, ...] = ()  # of those recordings that have measured ones

    def predicted_frequencies(self, x: Array, number: int | None = None) -> tuple[PredictedFrequencies, ...]:
        """Those of each such recording, or of the one with this number, at parameters x."""
        wanted = (data for data in self.frequencies if number in (None, data.number))
        return tuple(predicted_frequencies(data, self.layout, x) for data in wanted)

    def swings(self, x: Array) -> bool:
        """Whether the beam stands, and so swings, in every posture in which its frequencies were measured."""
        return all(np.isfinite(one.log).all() for one in self.predicted_frequencies(x))


@dataclass(frozen=True)
class Prior:
    """The parameters before the data: `x = mean + L z` with z of covariance one.

    The fit is computed in z. There the posterior's precision is the identity plus what the data add, so that every
    factor of it exists, however exactly a parameter is known beforehand; the prior covariance is never inverted. What
    the recordings share, and what each has of its own, are independent.
    """

    mean: Array  # (P,)
    parts: tuple[slice, ...]  # where the shared parameters stand, and those of each recording
    roots: tuple[BlockRoot, ...]  # L of each part

    def times(self, z: Array) -> Array:
        """(P, ...) `L z`."""
        return np.concatenate([root.times(z[part]) for part, root in zip(self.parts, self.roots, strict=True)])

    def transposed_times(self, v: Array) -> Array:
        """(P, ...) `L' v`."""
        pairs = zip(self.parts, self.roots, strict=True)
        return np.concatenate([root.transposed_times(v[part]) for part, root in pairs])

    def whiten(self, x: Array) -> Array:
        """(P,) z of parameters x."""
        away = x - self.mean
        return np.concatenate([root.solve(away[part]) for part, root in zip(self.parts, self.roots, strict=True)])


def prior(problem: FitProblem, hyperparameters: Hyperparameters, log_k: Array | None = None) -> Prior:
    """The prior at given hyperparameters; `log_k` (p,): mean of log k's coefficients, where it is not one level."""
    layout, h = problem.layout, hyperparameters
    mean, sd = np.zeros(layout.size), np.ones(layout.size)

    def root_of(part: slice, inside: Sequence[Block]) -> BlockRoot:
        blocks: list[tuple[IntArray, Array]] = []
        for block in inside:
            where, index = block.where, np.arange(block.where.start, block.where.stop) - part.start
            if block.name == "stiffness":
                blocks.append((index, layout.stiffness_root(h.part_variances)))
                mean[where] = problem.level if log_k is None else log_k
            elif block.name == "force":  # x and y in turn, alike
                error = problem.recordings[block.recording].error
                mean[where], of_axis = error.mean.ravel(), error.root(h.coloured, h.memory, h.walk, h.load)
                blocks += [(index[axis::2], of_axis) for axis in range(2)]
            else:
                sd[where] = block.prior_sd * h.sizes.get(block.name, 1.0)
        return BlockRoot(sd[part], tuple(blocks))

    return Prior(mean, layout.parts, each(root_of, layout.parts, layout.free_blocks))


def log_k_map(problem: FitProblem) -> tuple[IntArray, Array]:
    """Indices (n,) of the parameters that log k, less what is known of it, is made of, and (f, n) how the finer
    spline's coefficients follow from them."""
    layout = problem.layout
    where, fine = layout.index["stiffness", -1].where, layout.spline.finer
    index: list[IntArray] = [np.arange(where.start, where.stop)]
    onto: list[Array] = [layout.spline.on_finer]
    under_tags, o = layout.index.get(("patches", -1)), problem.recordings[0].observations
    if under_tags is not None and under_tags.start >= 0:
        index.append(np.arange(under_tags.where.start, under_tags.where.stop))
        onto.append(fine.nearest(lambda s: patch_functions(o.marker_s, o.length, o.stated.tag_size, s)))
    return np.concatenate(index), np.concatenate(onto, axis=1)
