"""Priors of single parameters that are not normal, as normal ones with the same effect (expectation propagation).

A parameter of one sd `d` may have bounds: nothing acts beyond the end of the beam, a tag does not soften it. It may be
sparse: of an effect that many benches lack, the size is unknown. Its prior is then a mixture of normal densities of
several `sizes`, equally probable, with mass near zero. Parameters may have one size together: data that tell only their
differences, or their sum with another parameter, must not make this size smaller.

The site of a parameter is the normal prior under which the linearised model has the mean and variance that the true
prior gives (Minka 2001; Rasmussen and Williams, Gaussian Processes for Machine Learning, 3.6).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import log_ndtr, logsumexp

from onebend.learning.parameters import Block
from onebend.records import Array

Sites = Mapping[tuple[str, int], tuple[Array, Array]]  # of blocks: means (n,) and sds (n,) of the normal priors

_LEAST = 1e-6  # of the prior's precision: of data that say next to nothing


def moments(lower: float, upper: float, mean: Array, variance: Array) -> tuple[Array, Array, Array]:
    """Log mass, mean and variance of normal densities of this mean and variance between the bounds."""
    sd = np.sqrt(variance)
    a, b = (lower - mean) / sd, (upper - mean) / sd
    middle = np.nan_to_num(a, neginf=-1e300) + np.nan_to_num(b, posinf=1e300)
    sign = np.where(middle > 0.0, -1.0, 1.0)  # in the tail where log_ndtr is exact
    a, b = np.where(sign < 0.0, -b, a), np.where(sign < 0.0, -a, b)
    log_mass = log_ndtr(b) + np.log1p(-np.exp(np.minimum(log_ndtr(a) - log_ndtr(b), -1e-300)))
    at_a, at_b = (np.exp(-0.5 * np.minimum(e**2, 1e300) - 0.5 * np.log(2.0 * np.pi) - log_mass) for e in (a, b))
    shift = at_a - at_b
    bend = np.where(np.isfinite(a), a, 0.0) * at_a - np.where(np.isfinite(b), b, 0.0) * at_b
    return log_mass, mean + sign * sd * shift, variance * np.clip(1.0 + bend - shift**2, 1e-8, 1.0)


def first_site(block: Block, size: float = 1.0) -> tuple[Array, Array]:
    """Means and sds (n,) of the prior itself, whose sds are `size` times those of the block."""
    return _matched(block, size, np.zeros(len(block.prior_sd)), np.full(len(block.prior_sd), np.inf))


def _matched(block: Block, size: float, mean: Array, variance: Array) -> tuple[Array, Array]:
    """Means and sds (n,) of the prior times normal densities of this mean and variance (n,)."""
    sizes = size * block.prior_sd[:, None] * np.array(block.sizes)
    mean, given = mean[:, None], np.isfinite(variance)[:, None]
    variance = np.where(given, variance[:, None], 1.0)
    both = np.where(given, 1.0 / (1.0 / sizes**2 + 1.0 / variance), sizes**2)
    middle = np.where(given, both * mean / variance, 0.0)
    before, _, _ = moments(*block.within, np.zeros_like(sizes), sizes**2)
    after, found, spread = moments(*block.within, middle, both)
    total = sizes**2 + variance
    logs = after - before - np.where(given, 0.5 * np.log(total) + 0.5 * mean**2 / total, 0.0)
    weights = np.exp(logs - logsumexp(logs, axis=1, keepdims=True))
    average = np.sum(weights * found, axis=1)
    return average, np.sqrt(np.sum(weights * (spread + (found - average[:, None]) ** 2), axis=1))


def updated(
    block: Block, site: tuple[Array, Array], mean: Array, covariance: Array, size: float = 1.0
) -> tuple[Array, Array]:
    """The site of a block, given its last one, and mean (n,) and covariance (n, n) of the posterior under that.

    Parameters of one size have the variance of the prior, averaged over the sizes with their probabilities. Of others
    the marginal densities count. A site wider than the widest normal density in the prior, or far from all of them, is
    a force without a place to rest: the search may run away with it. A site about zero then gives the same mean.
    """
    if block.together and len(mean) > 1:
        return np.zeros(len(mean)), _common_sd(size * block.prior_sd, np.array(block.sizes), site[1], mean, covariance)
    widest, sd = size * block.sizes[-1] * block.prior_sd, np.sqrt(np.diag(covariance))
    precision = np.maximum(1.0 / sd**2 - 1.0 / site[1] ** 2, _LEAST / widest**2)
    without = (mean / sd**2 - site[0] / site[1] ** 2) / precision
    wanted, spread = _matched(block, size, without, 1.0 / precision)
    left = np.maximum(1.0 / spread**2 - precision, 1.0 / widest**2)
    middle = (wanted * (precision + left) - without * precision) / left
    if len(block.sizes) > 1:
        pull = precision * np.divide(without - wanted, wanted, out=np.zeros_like(wanted), where=wanted != 0.0)
        far = np.abs(middle) > widest
        left, middle = np.where(far, np.maximum(pull, 1.0 / widest**2), left), np.where(far, 0.0, middle)
    return middle, 1.0 / np.sqrt(left)


def _common_sd(prior_sd: Array, sizes: Array, before: Array, mean: Array, covariance: Array) -> Array:
    """(n,) sds of parameters of one size, by its posterior. Their prior sds are `prior_sd` (n,) times one of `sizes`,
    all equally probable; mean and covariance are those of the posterior under the sds `before` (n,)."""
    inverse = np.linalg.inv(covariance / np.outer(prior_sd, prior_sd))
    values, vectors = np.linalg.eigh(inverse - np.diag((prior_sd / before) ** 2))  # of what the data say
    values, pull = np.maximum(values, 0.0), vectors.T @ (inverse @ (mean / prior_sd))
    squares = sizes[:, None] ** 2
    logs = 0.5 * np.sum(squares * pull**2 / (1.0 + squares * values) - np.log1p(squares * values), axis=1)
    return np.asarray(prior_sd * np.sqrt(np.exp(logs - logsumexp(logs)) @ squares[:, 0]))


def is_shaped(block: Block) -> bool:
    """Whether the block is free and its prior is not normal."""
    return block.start >= 0 and (len(block.sizes) > 1 or bool(np.any(np.isfinite(block.within))))
