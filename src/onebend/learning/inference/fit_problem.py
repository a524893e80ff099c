"""What is fitted: the recordings' data, where each parameter stands, and what is expected before the data."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from onebend.learning.allowances.allowance import Sizes
from onebend.learning.allowances.patches import patch_functions
from onebend.learning.frequencies.frequency_data import FrequencyData
from onebend.learning.frequencies.predicted import PredictedFrequencies, predicted_frequencies
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.parameters import Layout
from onebend.records import Array, IntArray


@dataclass(frozen=True)
class RecordingNoise:
    """Noise of one recording's frames, correlation in time included."""

    marker: float  # over what the tags' covariances say
    force: float  # N, the force error that is faster than its knots


@dataclass(frozen=True)
class Hyperparameters:
    """Sizes of priors and noise, which the data choose."""

    part_variances: Array  # (n,) variances of the parts of log k, see `Spline.parts`
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

    def predicted_frequencies(self, x: Array) -> tuple[PredictedFrequencies, ...]:
        """Those of each such recording, at parameters x."""
        return tuple(predicted_frequencies(data, self.layout, x) for data in self.frequencies)

    def swings(self, x: Array) -> bool:
        """Whether the beam stands, and so swings, in every posture in which its frequencies were measured."""
        return all(np.isfinite(one.log).all() for one in self.predicted_frequencies(x))


@dataclass(frozen=True)
class Prior:
    """The parameters before the data: `x = mean + root z` with z of covariance one.

    The fit is computed in z. There the posterior's precision is the identity plus what the data add, so that every
    factor of it exists, however exactly a parameter is known beforehand; the prior covariance is never inverted.
    """

    mean: Array  # (P,)
    root: Array  # (P, P) lower triangular

    @cached_property
    def precisions(self) -> Array:
        """(P,) of each parameter, all others known."""
        rows = solve_triangular(self.root, np.eye(len(self.root)), lower=True)
        return np.asarray(np.sum(rows**2, axis=0))

    def whiten(self, x: Array) -> Array:
        """(P,) z of parameters x."""
        return np.asarray(solve_triangular(self.root, x - self.mean, lower=True))


def prior(problem: FitProblem, hyperparameters: Hyperparameters, log_k: Array | None = None) -> Prior:
    """The prior at given hyperparameters; `log_k` (p,): mean of log k's coefficients, where it is not one level."""
    layout, size = problem.layout, problem.layout.size
    root, mean = np.zeros((size, size)), np.zeros(size)
    for block in layout.blocks:
        if block.start < 0:
            continue
        where = block.where
        if block.name == "stiffness":
            root[where, where] = _stiffness_root(layout, hyperparameters.part_variances)
            mean[where] = problem.level if log_k is None else log_k
        elif block.name == "force":  # x and y in turn, alike
            error, h = problem.recordings[block.recording].error, hyperparameters
            mean[where] = error.mean.ravel()
            of_axis = error.root(h.coloured, h.memory, h.walk, h.load)
            for axis in range(2):
                same_axis = slice(where.start + axis, where.stop, 2)
                root[same_axis, same_axis] = of_axis
        else:
            root[where, where] = np.diag(block.prior_sd * hyperparameters.sizes.get(block.name, 1.0))
    return Prior(mean, root)


def _stiffness_root(layout: Layout, variances: Array) -> Array:
    """(p, p) lower triangular factor of the prior covariance of log k's coefficients."""
    root = layout.spline.root_of(variances)
    if not layout.even:
        return root
    differences = layout.differences @ root
    factor = np.linalg.qr(np.concatenate([np.eye(len(root)), differences]), mode="r")
    return np.asarray(np.linalg.qr(solve_triangular(factor, root.T, trans="T"), mode="r")).T


def log_k_map(problem: FitProblem) -> tuple[IntArray, Array]:
    """Indices (n,) of the parameters that log k is made of, and (f, n) how the finer spline's coefficients follow from
    them."""
    layout = problem.layout
    where, fine = layout.index["stiffness", -1].where, layout.spline.finer
    index: list[IntArray] = [np.arange(where.start, where.stop)]
    onto: list[Array] = [layout.spline.on_finer]
    under_tags, o = layout.index.get(("patches", -1)), problem.recordings[0].observations
    if under_tags is not None and under_tags.start >= 0:
        index.append(np.arange(under_tags.where.start, under_tags.where.stop))
        onto.append(fine.nearest(lambda s: patch_functions(o.marker_s, o.length, o.stated.tag_size, s)))
    return np.concatenate(index), np.concatenate(onto, axis=1)
