"""Objects unlike the others of their group: each against what the others predict for it, spreads included."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.special import log_ndtr

from onebend.blas import one_blas_thread
from onebend.population.covariances import covariance
from onebend.population.fit import Fit, objects_of
from onebend.population.gaussians import inverse
from onebend.records import Array

ORDERS = 5  # of polynomials along the beam: level, slope, bow and two more
FEWEST = 3  # objects of a group
FALSE_ALARMS = 0.05  # of groups in which nothing differs, at most
HEAVY = 300  # points of the grid that are kept, the heaviest


@one_blas_thread
def outliers(fit: Fit) -> tuple[str, ...]:
    """O reasons; empty: like the others, or too few others to say.

    Level, slope and so on of the object less those that the others predict are normal given the spreads, and the
    spreads are weighed without the object. The least of the probabilities counts ORDERS times the group's size.
    """
    trial, heavy = fit.trial, np.argsort(-fit.weight)[:HEAVY]
    spreads, weight = fit.spreads.chosen(heavy), fit.weight[heavy]
    objects = objects_of(trial, spreads)
    spread = spreads.lasting[:, None, None, None] * covariance(spreads, trial.s)[:, None]
    wide = objects.covariance + spread
    waves = legvander(2.0 * trial.s - 1.0, ORDERS - 1) / len(trial.s)
    reasons = []
    for i, group in enumerate(trial.group_of):
        mates = (trial.group_of == group) & (np.arange(trial.objects) != i)
        if mates.sum() < FEWEST - 1:
            reasons.append("")
            continue
        precision, _ = inverse(wide[:, mates])
        error, _ = inverse(precision.sum(axis=1))
        centre = np.einsum("nij,nmjk,nmk->ni", error, precision, np.broadcast_to(objects.mean[:, mates],
                           precision.shape[:-1]))  # fmt: skip
        off, scatter = objects.mean[:, i] - centre, wide[:, i] + error
        chance = _chance(off, scatter, weight, waves) * ORDERS * (mates.sum() + 1)
        reasons.append(_reason(chance, weight @ off, trial.s) if chance.min() < FALSE_ALARMS else "")
    return tuple(reasons)


def _chance(off: Array, scatter: Array, weight: Array, waves: Array) -> Array:
    """(ORDERS,) two-sided probability of what is seen, or farther, if the object is like the others."""
    inner, logs = inverse(scatter)
    log_density = -0.5 * (logs + np.einsum("ni,nij,nj->n", off, inner, off))
    log = np.log(weight) - log_density  # the object's own say taken out of the weights
    without = np.exp(log - log.max())
    sd = np.sqrt(np.einsum("si,nst,ti->ni", waves, scatter, waves))
    tails = 2.0 * np.exp(log_ndtr(-np.abs(off @ waves) / sd))
    return np.asarray(without @ tails / without.sum())


def _reason(chance: Array, off: Array, s: Array) -> str:
    least = f"p = {min(float(chance.min()), 1.0):.1g}"
    if int(np.argmin(chance)) == 0:
        return f"k is {np.exp(off.mean()):.2g} times that of the others ({least})"
    beside = off - off.mean()
    at = int(np.argmax(np.abs(beside)))
    return f"the shape of k(s) is {np.exp(beside[at]):.2g} times that of the others at s = {s[at]:.2g} ({least})"
