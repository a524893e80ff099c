"""What the data cannot tell apart: the largest correlations of the posterior.

Two quantities that are strongly correlated trade off: the data fix a combination of them, and what one is depends on
the prior of the other. The quantities are the nuisances, mean and drift of each force log's error, and the mean level
of log k over the places where k(s) is identified.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.learning.inference.fit_problem import log_k_map
from onebend.learning.inference.nuisances import quantities
from onebend.learning.posterior import Posterior
from onebend.records import Array

LEVEL = "mean log k(s)"
_PLACES = 201


@dataclass(frozen=True)
class Tradeoff:
    """Two quantities that the data hardly tell apart."""

    first: str
    second: str
    correlation: float  # of the posterior, in [-1, 1]


def tradeoffs(posterior: Posterior, *, most: int = 5, least: float = 0.5) -> tuple[Tradeoff, ...]:
    """The strongest pairs, strongest first: at most `most`, none weaker than `least`.

    Every quantity is named once, with what it trades off against most.
    """
    names, correlation = correlations(posterior)
    first, second = np.triu_indices(len(names), k=1)
    strength = np.abs(correlation[first, second])
    found: list[Tradeoff] = []
    named: set[int] = set()
    for i in np.argsort(-strength, kind="stable"):
        if strength[i] < least or len(found) == most:
            break
        if not named & {int(first[i]), int(second[i])}:
            found.append(Tradeoff(names[first[i]], names[second[i]], float(correlation[first[i], second[i]])))
            named |= {int(first[i]), int(second[i])}
    return tuple(found)


def with_level(posterior: Posterior, *, most: int = 3, least: float = 0.1) -> tuple[Tradeoff, ...]:
    """What the level of k(s) itself trades off against, strongest first."""
    names, correlation = correlations(posterior)
    order = [i for i in np.argsort(-np.abs(correlation[0, 1:])) + 1 if abs(correlation[0, i]) >= least][:most]
    return tuple(Tradeoff(LEVEL, names[i], float(correlation[0, i])) for i in order)


def correlations(posterior: Posterior) -> tuple[list[str], Array]:
    """Names (N,) and correlations (N, N) of the quantities; the mean of log k(s) comes first."""
    names, rows = [LEVEL], [(slice(0, posterior.layout.shared), _level(posterior)[None])]
    left_out = {"stiffness"} | {
        a.name for one in posterior.recordings for a in one.allowances if a.enters == "poses" and a.sized
    }
    for block in posterior.layout.blocks:
        if block.start < 0 or block.name in left_out:
            continue
        these = quantities(block, posterior.recordings)
        names += these.labels
        rows.append((block.where, these.weights))
    covariance = posterior.covariance.of_functionals(rows)
    sd = np.sqrt(np.diag(covariance))
    return names, np.asarray(covariance / np.outer(sd, sd))


def _level(posterior: Posterior) -> Array:
    """(n,) weights of the shared parameters in the mean of log k, over the identified places if there are any."""
    s = np.linspace(0.0, 1.0, _PLACES)
    identified = posterior.band(s).identified
    index, onto = log_k_map(posterior.problem)
    basis = posterior.layout.spline.finer.basis(s[identified] if np.any(identified) else s) @ onto
    out = np.zeros(posterior.layout.shared)
    out[index] = np.mean(basis, axis=0)
    return out
