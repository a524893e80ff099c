"""How well k(s) would come out, from the Fisher information alone.

With I the data's information on the coefficients c of log k (all nuisances marginalised) and P the precision of their
prior, the fit gives `(I + P)^-1 (I c + n + P mu)`, n of covariance I. So the band is `(I + P)^-1 = C`, the scatter from
one recording to the next `C I C`, and the prior's pull on this very k `C P (mu - c)`. The prior's sizes are those that
the fit is expected to choose for this k: of the greatest expected evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize

from onebend.beam.uncertain import IDENTIFIED_SD
from onebend.blas import one_blas_thread
from onebend.learning.identifiability import Seen, alone, eliminate, joint_information, mass_of, see, solve_push
from onebend.learning.posterior import RHO, TAU
from onebend.learning.proposals import PLACES, Quality
from onebend.learning.scales import SPREAD
from onebend.learning.spline import Spline
from onebend.learning.workbench import Bench
from onebend.records import Array, BoolArray
from onebend.rehearse.instruments import FUNCTIONS, even_push, instruments
from onebend.rehearse.setup import Setup

SPLINE = Spline(FUNCTIONS)
BASIS = SPLINE.basis(PLACES)
_TWO_SIDED = 2.0 * 1.959964
_EXACT = 1e-3  # of its doubt: what is left of a nuisance that is known
_MOST = 3.0  # sd of the scales' logs


@dataclass(frozen=True)
class Predicted:
    """Sizes of log k at the 101 places of `PLACES`; one sd, the force's gain included where not said otherwise."""

    k: Array  # N m, the truth
    sd: Array  # what the band says
    own_sd: Array  # the same, the gain apart
    scatter: Array  # from one recording to the next
    pull: Array  # what the prior does to this k, always
    tau: float  # roughness of log k that the fit would choose
    rho: float  # steps
    quality: Quality

    @property
    def identified(self) -> BoolArray:
        """Where data rather than the prior set the band."""
        return np.asarray(self.own_sd < IDENTIFIED_SD)

    @property
    def error(self) -> Array:
        """Root mean square error over recordings."""
        return np.asarray(np.hypot(self.scatter, self.pull))


@dataclass(frozen=True)
class Doubt:
    """One thing that is not known exactly, and what the band would be if it were."""

    name: str
    mean_width: float  # of the 95 % band of log k, with this known exactly
    share: float  # of the band that this removes


@one_blas_thread
def predict(setup: Setup) -> Predicted:
    """The band and the errors to expect.

    Raises:
        MechanicsError: the beam buckles or snaps through under a push.
    """
    bench = instruments(setup)
    return _outcome(setup, bench, told_by(setup, bench, derivatives(setup, bench)))


@one_blas_thread
def doubts(setup: Setup) -> tuple[Doubt, ...]:
    """Every nuisance, the one that costs most first: the band with each known exactly, all else as it is.

    Raises:
        MechanicsError: as `predict`.
    """
    bench = instruments(setup)
    seen = derivatives(setup, bench)
    now = _outcome(setup, bench, told_by(setup, bench, seen))
    out = []
    for name, better in known_exactly(bench).items():
        left = outcome_with(now, better, told_by(setup, better, seen)).quality.mean_width
        out.append(Doubt(name, left, max(1.0 - left / now.quality.mean_width, 0.0)))
    return tuple(sorted(out, key=lambda one: -one.share))


def known_exactly(bench: Bench) -> dict[str, Bench]:
    """The bench with one thing known, all but exactly."""
    force, e = bench.force, _EXACT
    out = {
        "force's gain": replace(bench, gain_sd=0.0),
        "force's bias and slow error": replace(bench, force=replace(force.times(e), frame=force.frame)),
        "force's noise": replace(bench, force=replace(force, frame=e * force.frame)),
        "tags' places": replace(bench, placement_sd=e * bench.placement_sd, origin_sd=e * bench.origin_sd),
        "tags' turns": replace(bench, turn_sd=e * bench.turn_sd),
        "clamp's direction": replace(bench, clamp_sd=e * bench.clamp_sd),
        "clock": replace(bench, clock_sd=e * bench.clock_sd),
        "camera's noise": replace(bench, tag_sd=0.01 * bench.tag_sd),
    }
    if bench.curvature_sd > 0.0:
        out["shape at rest"] = replace(bench, curvature_sd=e * bench.curvature_sd)
    return {name: one for name, one in out.items() if name != "force's gain" or bench.gain_sd > 0.0}


def derivatives(setup: Setup, bench: Bench) -> tuple[Seen, ...]:
    """Of the tags along every push, with what is not known."""
    tags, mass, out = np.asarray(bench.tags), mass_of(setup.beam), []
    for push in setup.pushes:
        solved = solve_push(setup.beam, bench, even_push(push))
        out.append(see(solved, bench, even_push(push), mass, SPLINE.basis(solved.problem.grid.nodes), tags))
    return tuple(out)


def told_by(setup: Setup, bench: Bench, seen: tuple[Seen, ...]) -> Array:
    """(p, p) information of all pushes together on the coefficients, tags and rest shape being the same in all."""
    chosen = np.arange(len(bench.tags), dtype=np.int64)
    pairs = zip(seen, setup.pushes, strict=True)
    joint = np.sum([joint_information(one, bench, even_push(push), chosen) for one, push in pairs], axis=0)
    return eliminate(joint, bench.shared_size, alone(bench))


def _outcome(setup: Setup, bench: Bench, told: Array) -> Predicted:
    k = np.asarray(setup.beam.stiffness(PLACES))
    away = _away(k)
    return _with_scales(k, away, told, bench.gain_sd, *likely_scales(told, away))


def outcome_with(now: Predicted, bench: Bench, told: Array) -> Predicted:
    """The same beam with other information; the prior's sizes are kept, so that only the data differ."""
    return _with_scales(now.k, _away(now.k), told, bench.gain_sd, now.tau, now.rho)


def _away(k: Array) -> Array:
    """(p,) coefficients of the prior's mean, an even k, less those of `k` (101,)."""
    log_k = np.log(k)
    return np.asarray(float(np.mean(log_k)) - np.linalg.lstsq(BASIS, log_k, rcond=None)[0])


def _with_scales(k: Array, away: Array, told: Array, gain_sd: float, tau: float, rho: float) -> Predicted:
    prior = SPLINE.precision(tau, rho)
    left = np.asarray(np.linalg.inv(told + prior))
    own = _along(left)
    sd = np.hypot(own, gain_sd)
    scatter = np.hypot(_along(np.asarray(left @ told @ left)), gain_sd)
    pull = np.asarray(BASIS @ left @ prior @ away)
    return Predicted(k, sd, own, scatter, pull, tau, rho, quality_of(sd, own))


def _along(covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.einsum("si,ij,sj->s", BASIS, covariance, BASIS), 0.0)))


def likely_scales(told: Array, away: Array) -> tuple[float, float]:
    """tau and rho of the greatest expected evidence: over the noise, of data that show `away` (p,) from the level.

    `2 log p = log|P| - log|I + P| - a' (P - P C P) a + tr(C I)`, under the fit's own priors of both.
    """

    def cost(z: Array) -> float:
        prior = SPLINE.precision(*_scales(z))
        left = np.linalg.inv(told + prior)
        ratio = np.linalg.slogdet(prior)[1] - np.linalg.slogdet(told + prior)[1]
        missed = away @ prior @ away - away @ prior @ left @ prior @ away
        return float(0.5 * (z @ z + missed - ratio - np.trace(left @ told)))

    options = {"initial_simplex": [[0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]], "xatol": 0.02, "fatol": 1e-3, "maxfev": 120}
    found = minimize(cost, np.zeros(2), method="Nelder-Mead", options=options)
    return _scales(found.x)


def _scales(z: Array) -> tuple[float, float]:
    tau, rho = np.array([TAU, RHO]) * np.exp(SPREAD[:2] * np.clip(z, -_MOST, _MOST))
    return float(tau), float(rho)


def quality_of(sd: Array, own_sd: Array) -> Quality:
    """Figures of a band of log k whose sd (101,) is `own_sd` without the gain; as `plan` reads them."""
    width, known = _TWO_SIDED * sd, own_sd < IDENTIFIED_SD
    worst = int(np.argmax(width))
    to = 0.0 if not known[0] else 1.0 if np.all(known) else float(PLACES[max(int(np.argmin(known)) - 1, 0)])
    share = float(np.mean(known))
    return Quality(float(np.mean(width)), float(width[worst]), float(PLACES[worst]), share, round(to, 2))


def ranges(known: BoolArray) -> list[tuple[float, float]]:
    """Stretches of s where `known` (101,) holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(int)))
    return [(float(PLACES[a]), float(PLACES[b - 1])) for a, b in list(pairwise(edges.tolist()))[::2]]
