"""What each allowance costs: how much it widens the band of k(s), and how far off k(s) would be without it.

With C the posterior covariance, b an allowance's parameters and c the coefficients of log k: had b been known, the
variance of c would be `C_cc - C_cb C_bb^-1 C_bc`; had b been kept at its value for the ideal bench, b_0, log k would
have come out `C_cb C_bb^-1 (b_0 - b)` away.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from onebend.learning.inference.fit_problem import FitProblem, log_k_map
from onebend.learning.inference.optimizer import Optimum
from onebend.learning.model.allowed import secant_of
from onebend.learning.model.parameters import Block
from onebend.records import Array

# Blocks of the layout that say one thing about the bench, by the name under which a person knows it.
GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "stretch and shear": ("section",),
        "relaxation": ("relaxation",),
        "sliding contact": ("slide",),
        "place of the push": ("place",),
        "stiff tags": ("patches",),
        "clamp that gives": ("clamp gives",),
        "posture-dependent bias": ("posture",),
        "length": ("length",),
        "rest shape": ("curvature",),
        "places of the tags": ("along", "across", "turn"),
        "clamp and origin": ("clamp", "origin"),
        "direction of the force": ("direction",),
        "clock": ("clock",),
        "mass": ("mass",),
        "camera": ("scale", "heights", "camera", "rolling shutter"),
        "inertia": ("inertia",),
        "error of the force log": ("force",),
        "remaining discrepancy": ("discrepancy", "angle discrepancy"),
    }
)
_NO_THICKNESS = -1.0  # of the relative change of its square: a beam that neither stretches nor shears
# Known of every bench, and unknown on every one: no allowance for a bench that is not ideal.
_OF_EVERY_BENCH = (
    "error of the force log",
    "clock",
    "places of the tags",
    "clamp and origin",
    "direction of the force",
)
_WIDENS = 1.1  # the band, at least
_SHIFTS, _SURE = 0.02, 2.0  # log k, at least, by something that is so many sd from nothing
_MOST_TOLD = 1e-9  # of the largest eigenvalue of the correlations in C_bb: directions below are fixed


@dataclass(frozen=True)
class Attribution:
    """What one thing about the bench does to k(s), over the places looked at."""

    name: str
    widening: float  # median of the sd of log k over what it would be, were this known exactly
    shift: float  # RMS of the change of log k, were this as on the ideal bench
    sds: float  # how far its parameters are from the ideal bench's, in sd, less what several reach by chance

    @property
    def matters(self) -> bool:
        """Whether k(s) or its band would be visibly otherwise without it."""
        return self.name not in _OF_EVERY_BENCH and (self.widening > _WIDENS or self.worth > _SHIFTS)

    @property
    def sure(self) -> bool:
        """Whether the data show it clearly."""
        return self.sds > _SURE

    @property
    def worth(self) -> float:
        """What it changes of log k, or of its band, as far as the data are sure of it."""
        return max(self.shift if self.sure else 0.0, 0.1 * (self.widening - 1.0))


def attributions(problem: FitProblem, optimum: Optimum, s: Array) -> tuple[Attribution, ...]:
    """Everything that the fit allows for, by what it is worth at places `s` (S,); the largest first."""
    layout, covariance = problem.layout, optimum.covariance
    log_k, onto = log_k_map(problem)
    basis = layout.spline.finer.basis(s) @ onto
    of_k = basis @ covariance[log_k]  # (S, P)
    variance = np.einsum("sp,sp->s", of_k[:, log_k], basis)
    out: list[Attribution] = []
    for name, blocks in GROUPS.items():
        free = [b for b in layout.blocks if b.name in blocks and b.start >= 0]
        if not free:
            continue
        index = np.concatenate([np.arange(b.where.start, b.where.stop) for b in free])
        before = np.concatenate([_ideal(problem, b) for b in free])
        values = optimum.x[index] - before
        inverse = _inverse(covariance[np.ix_(index, index)])
        regression = of_k[:, index] @ inverse
        known = np.maximum(variance - np.einsum("si,si->s", regression, of_k[:, index]), 1e-4 * variance)
        out.append(
            Attribution(
                name=name,
                widening=float(np.median(np.sqrt(variance / known))),
                shift=float(np.hypot(np.sqrt(np.mean((regression @ values) ** 2)), _to_instantaneous(name, optimum))),
                sds=float(np.sqrt(max(float(values @ inverse @ values) - (len(values) - 1), 0.0))),
            )
        )
    return tuple(sorted(out, key=_by_worth))


def _inverse(covariance: Array) -> Array:
    """(n, n) pseudo-inverse, whatever the units."""
    sd = np.sqrt(np.diag(covariance))
    return np.asarray(
        np.linalg.pinv(covariance / np.outer(sd, sd), rcond=_MOST_TOLD, hermitian=True) / np.outer(sd, sd)
    )


def _by_worth(attribution: Attribution) -> float:
    return -attribution.worth


def _to_instantaneous(name: str, optimum: Optimum) -> float:
    """Log of the instantaneous stiffness over k(s), the secant stiffness: what relaxation itself makes of k(s)."""
    if name != "relaxation" or not optimum.predictions:
        return 0.0
    shares = [secant_of(p.recording, p.layout, p.x, p.solved) for p in optimum.predictions]
    return float(-np.mean(np.log(shares)))


def _ideal(problem: FitProblem, block: Block) -> Array:
    """(n,) parameters of the ideal bench. What the rests say of the force log's error is known without the fit."""
    if block.name == "force":
        return np.asarray(problem.recordings[block.recording].error.mean.ravel())
    if block.name == "section":
        return np.full(len(block.prior_sd), _NO_THICKNESS)
    return np.zeros(len(block.prior_sd))
