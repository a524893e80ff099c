"""How well k(s) would come out, from the Fisher information alone.

With I the data's information on the coefficients c of log k (all nuisances marginalised) and P the precision of their
prior, the fit gives `(I + P)^-1 (I c + n + P mu)`, n of covariance I. So the band is `(I + P)^-1 = C`, the scatter from
one recording to the next `C I C`, and the prior's pull on this very k `C P (mu - c)`. The prior's sizes are those that
the fit is expected to choose for this k: of the greatest expected evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from onebend.beam.profiles.uncertain import IDENTIFIED_SD
from onebend.blas import one_blas_thread
from onebend.forecast.instruments import FUNCTIONS, RehearsalInstruments, even_push, instruments
from onebend.forecast.setup import Setup
from onebend.learning.design.identifiability import (
    TagDerivatives,
    alone,
    eliminate,
    joint_information,
    mass_of,
    solve_push,
    tag_derivatives,
)
from onebend.learning.design.proposals import PLACES, Quality
from onebend.learning.model.spline import RHO, SPREAD, TAU, Spline
from onebend.recording.signals import runs
from onebend.records import Array, BoolArray

SPLINE = Spline(FUNCTIONS)
BASIS = SPLINE.basis(PLACES)
_TWO_SIDED = 2.0 * 1.959964
_EXACT = 1e-3  # of its doubt: what is left of a nuisance that is known
_TINY = 1e-9  # sd of what is known
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
    used = instruments(setup)
    return _outcome(setup, used, told_by(setup, used, derivatives(setup, used)))


@one_blas_thread
def doubts(setup: Setup) -> tuple[Doubt, ...]:
    """Every nuisance, the one that costs most first: the band with each known exactly, all else as it is.

    Raises:
        MechanicsError: as `predict`.
    """
    used = instruments(setup)
    seen = derivatives(setup, used)
    now = _outcome(setup, used, told_by(setup, used, seen))
    out = []
    for name, better in known_exactly(used).items():
        left = outcome_with(now, better, told_by(setup, better, seen)).quality.mean_width
        out.append(Doubt(name, left, max(1.0 - left / now.quality.mean_width, 0.0)))
    return tuple(sorted(out, key=lambda one: -one.share))


def known_exactly(used: RehearsalInstruments) -> dict[str, RehearsalInstruments]:
    """The instruments with one thing known, all but exactly."""
    bench, push, e = used.bench, used.push, _EXACT
    force = bench.force
    steady = replace(force.times(e), frame=force.frame)
    out = {
        "force's gain": replace(bench, gain_sd=0.0),
        "force's noise": replace(bench, force=replace(force, frame=e * force.frame)),
        "tags' places": replace(bench, placement_sd=e * bench.placement_sd, origin_sd=e * bench.origin_sd),
        "tags' turns": replace(bench, turn_sd=e * bench.turn_sd),
        "clamp's direction": replace(bench, clamp_sd=e * bench.clamp_sd),
        "clock": replace(bench, clock_sd=e * bench.clock_sd),
        "camera's noise": replace(bench, tag_sd=0.01 * bench.tag_sd),
    }
    if bench.curvature_sd > 0.0:
        out["shape at rest"] = replace(bench, curvature_sd=e * bench.curvature_sd)
    if bench.gain_sd == 0.0:
        del out["force's gain"]
    if bench.clock_sd == 0.0:
        del out["clock"]
    return {name: replace(used, bench=one) for name, one in out.items()} | {
        "force's bias and slow error": RehearsalInstruments(
            replace(bench, force=steady), replace(push, load=e * push.load)
        ),
        "push's place": replace(used, push=replace(push, place=e * push.place)),
        "force's axes": replace(used, push=replace(push, direction=e * push.direction)),
    }


def derivatives(setup: Setup, used: RehearsalInstruments) -> tuple[TagDerivatives, ...]:
    """Of the tags along every push, with what is not known; behind the coefficients of log k stand a push's own."""
    bench, mass, out = used.bench, mass_of(setup.beam), []
    for push in setup.pushes:
        solved = solve_push(setup.beam, bench, even_push(push))
        on_nodes = SPLINE.basis(solved.problem.grid.nodes)
        one = tag_derivatives(solved, bench, even_push(push), mass, on_nodes, np.asarray(bench.tags))
        own = [one.blocks[name] for name in ("place", "direction", "push")]  # m, rad, N x and y
        functions = np.concatenate([one.blocks["stiffness"], *own], axis=-1)
        out.append(replace(one, blocks=one.blocks | {"stiffness": functions}))
    return tuple(out)


def told_by(setup: Setup, used: RehearsalInstruments, seen: tuple[TagDerivatives, ...]) -> Array:
    """(p, p) information of all pushes together on the coefficients, tags and rest shape being the same in all."""
    bench, own = used.bench, used.push
    chosen = np.arange(len(bench.tags), dtype=np.int64)
    sd = np.maximum([own.place, own.direction, own.load, own.load], _TINY)
    first, size = SPLINE.count, SPLINE.count + len(sd) + bench.shared_size
    last = np.arange(first, first + len(sd))
    order = np.concatenate([np.setdiff1d(np.arange(size), last), last])
    parts = [joint_information(one, bench, even_push(p), chosen) for one, p in zip(seen, setup.pushes, strict=True)]
    joint = np.sum([eliminate(one[np.ix_(order, order)], len(sd), sd**-2.0) for one in parts], axis=0)
    return eliminate(joint, bench.shared_size, alone(bench))


def _outcome(setup: Setup, used: RehearsalInstruments, told: Array) -> Predicted:
    k = np.asarray(setup.beam.stiffness(PLACES))
    away = _away(k)
    return _with_scales(k, away, told, used.bench.gain_sd, *likely_scales(told, away))


def outcome_with(now: Predicted, used: RehearsalInstruments, told: Array) -> Predicted:
    """The same beam with other information; the prior's sizes are kept, so that only the data differ."""
    return _with_scales(now.k, _away(now.k), told, used.bench.gain_sd, now.tau, now.rho)


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
    tau, rho = np.array([TAU, RHO]) * np.exp(SPREAD * np.clip(z, -_MOST, _MOST))
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
    return [(float(PLACES[first]), float(PLACES[end - 1])) for first, end in runs(known)]
