"""How many objects of a group a wished band of its mean needs."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtrit

from onebend.blas import one_blas_thread
from onebend.population.covariances import covariance
from onebend.population.curves import Curves
from onebend.population.fit import Fit, objects_of
from onebend.population.gaussians import inverse
from onebend.records import Array, BoolArray

MOST = 100_000  # objects that are looked at
NUMBERS = (2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 30, 50, 100, 200, 500, 1000)  # whose band is foretold


def half_band(means: Curves, group: int, places: BoolArray) -> float:
    """Half the 95 % band of the group's mean log k: the median over the places; NaN where there is none."""
    wide = 0.5 * (means.high[group] - means.low[group])[places]
    return float(np.median(wide)) if len(wide) else float("nan")


@one_blas_thread
def foretold(fit: Fit, means: Curves, group: int, places: BoolArray) -> Array:
    """(MOST,) half bands of the group's mean for 1, 2, ... objects in it as those that are there, other groups as now.

    The band shrinks as the mean's sd under the spreads that were found, and as Student's quantile; at the number that
    is there it is the band that was found.
    """
    trial = fit.trial
    now, rest = int(np.sum(trial.group_of == group)), trial.objects - trial.groups
    objects = objects_of(trial, fit.spreads)
    spread = fit.spreads.lasting[:, None, None, None] * covariance(fit.spreads, trial.s)[:, None]
    precision, _ = inverse((objects.covariance + spread)[:, trial.group_of == group])
    one, _ = inverse(precision.mean(axis=1))
    variance = fit.weight @ np.diagonal(one, axis1=-2, axis2=-1)[:, places]
    numbers = np.arange(1, MOST + 1)
    freedom = np.maximum(rest + numbers - now, 1)
    quantile = stdtrit(freedom.astype(float), 0.975)
    own = quantile**2 * float(np.median(variance)) / numbers
    alike = float(np.median(np.diagonal(trial.alike[group])[places]))  # no number of objects averages this out
    common = 1.959963984540054**2 * (trial.common_sd**2 + alike)
    found = max(half_band(means, group, places) ** 2 - common, 0.0)
    return np.asarray(np.sqrt(own * found / own[now - 1] + common))


def needed(bands: Array, wished: float) -> float:
    """The least number of objects whose half band is at most that wished; inf: none that was looked at."""
    enough = np.flatnonzero(bands <= wished)
    return float(enough[0] + 1) if len(enough) else float("inf")
