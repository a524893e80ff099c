"""The evidence of what is linear in normal unknowns, and mean and sd of the one that is not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from onebend.records import Array

_LIKELY = 12.0  # of the log evidence below the best: farther down it is not


def evidence_of(basis: Array, value: Array, noise: Array, sizes: list[tuple[float, Array]]) -> Array:
    """(n,) log, but for a constant, that `value` (F,) with white `noise` (F,) is a sum of `basis` (n, F, d): over
    `sizes`, each the log of how likely it is before, and the sds (d,) of the coefficients."""
    basis = basis / noise[:, None]
    normal = np.swapaxes(basis, 1, 2) @ basis
    right = np.swapaxes(basis, 1, 2) @ (value / noise)
    every = np.stack([before + _at_sizes(normal, right, sds) for before, sds in sizes])
    best = np.max(every, axis=0)
    return np.asarray(best + np.log(np.sum(np.exp(every - best), axis=0)))


def _at_sizes(normal: Array, right: Array, sds: Array) -> Array:
    """(n,) from normal equations (n, d, d) and (n, d)."""
    on = np.flatnonzero(sds)
    scale = sds[on]
    whole = np.eye(len(on)) + scale[:, None] * normal[:, on][:, :, on] * scale
    root = np.linalg.cholesky(whole)
    left = np.linalg.solve(root, (scale * right[:, on])[..., None])[..., 0]
    return np.asarray(0.5 * np.sum(left**2, axis=1) - np.sum(np.log(np.einsum("nii->ni", root)), axis=1))


def scanned(
    evidence: Callable[[Array], Array], low: float, high: float, counts: tuple[int, ...]
) -> tuple[float, float, float]:
    """Mean and sd of what is anywhere between `low` and `high`, all as likely before, and its log evidence: in rounds
    of so many places, each where it is likely after the one before."""
    wide = high - low
    for count in counts:
        at = np.linspace(low, high, count)
        of = evidence(at)
        likely, step = at[of > np.max(of) - _LIKELY], at[1] - at[0]
        low, high = max(low, float(likely[0] - step)), min(high, float(likely[-1] + step))
    weight = np.exp(of - np.max(of))
    whole = float(np.max(of) + np.log(np.sum(weight) * step / wide))
    weight /= np.sum(weight)
    mean = float(weight @ at)
    return mean, float(np.sqrt(weight @ (at - mean) ** 2 + step**2 / 12.0)), whole
