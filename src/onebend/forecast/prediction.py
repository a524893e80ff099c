"""How well k(s) would come out, from the Fisher information and the fit's own prior.

Let I be the data's information on the coefficients c of log k, all nuisances marginalised. Data without noise say
`-2 log p = x' I x - 2 x' I c` of the coefficients x. The fit's own posterior of log k (`stiffness_mixture`) under
these data gives the band, its covariance C, and the bias, its mean less c. Noise of covariance I on `I c` moves the
mean by C times the noise, so that the scatter from one recording to the next is `C I C`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from onebend.beam.profiles.uncertain import IDENTIFIED_SD, half_width
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
from onebend.learning.inference.information_form import InformationForm
from onebend.learning.inference.stiffness_prior import Draws, stiffness_mixture
from onebend.learning.model.spline import Spline
from onebend.recording.signals import runs
from onebend.records import Array, BoolArray

SPLINE = Spline(FUNCTIONS)
BASIS = SPLINE.basis(PLACES)
_KNOWN_SHARE = 1e-3  # share of its sd that is left of a nuisance that is known
_LEAST_SD = 1e-9  # sd of what is known
_DRAWS = Draws(chains=36, burn=150, kept=100)  # of the prior's sizes: the band's sd is good to about 3 %


@dataclass(frozen=True)
class PredictedBand:
    """Sizes of log k at the 101 places of `PLACES`; one sd, the force's gain included where not said otherwise."""

    k: Array  # N m, the truth
    sd: Array  # of the band
    own_sd: Array  # of the band, the gain's error left out
    scatter: Array  # of the estimate, from one recording to the next
    bias: Array  # of the estimate, by the prior
    prior: Array  # (p, p) precision of the normal prior under which these data would give this band
    quality: Quality

    @property
    def identified(self) -> BoolArray:
        """Where data rather than the prior set the band."""
        return np.asarray(self.own_sd < IDENTIFIED_SD)

    @property
    def error(self) -> Array:
        """Root mean square error over recordings."""
        return np.asarray(np.hypot(self.scatter, self.bias))


@dataclass(frozen=True)
class BudgetEntry:
    """One nuisance, and what the band would be if it were known exactly."""

    name: str
    mean_width: float  # of the 95 % band of log k, with this known exactly
    share: float  # of the band's mean width that this removes


@one_blas_thread
def predict(setup: Setup) -> PredictedBand:
    """The band and the errors to expect.

    Raises:
        MechanicsError: the beam buckles or snaps through under a push.
    """
    used = instruments(setup)
    return posterior_of(setup, used, information_of(setup, used, derivatives(setup, used)))


@one_blas_thread
def uncertainty_budget(setup: Setup, predicted: PredictedBand) -> tuple[BudgetEntry, ...]:
    """For every nuisance the band with it known exactly and all else as it is; the most costly first.

    Raises:
        MechanicsError: as `predict`.
    """
    used = instruments(setup)
    along_pushes = derivatives(setup, used)
    now = predicted.quality.mean_width
    entries = []
    for name, better in known_exactly(used).items():
        width = with_information(predicted, better, information_of(setup, better, along_pushes)).quality.mean_width
        entries.append(BudgetEntry(name, width, max(1.0 - width / now, 0.0)))
    return tuple(sorted(entries, key=lambda entry: -entry.share))


def known_exactly(used: RehearsalInstruments) -> dict[str, RehearsalInstruments]:
    """The instruments with one nuisance each known almost exactly, by the nuisance's name."""
    bench, push, e = used.bench, used.push, _KNOWN_SHARE
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
    return {name: replace(used, bench=better) for name, better in out.items()} | {
        "force's bias and slow error": RehearsalInstruments(
            replace(bench, force=steady), replace(push, load=e * push.load)
        ),
        "push's place": replace(used, push=replace(push, place=e * push.place)),
        "force's axes": replace(used, push=replace(push, direction=e * push.direction)),
    }


def derivatives(setup: Setup, used: RehearsalInstruments) -> tuple[TagDerivatives, ...]:
    """Derivatives of the tags' poses along every push with all that is not known.

    Behind the coefficients of log k stand those with the push's own place [m], direction [rad] and force [N].
    """
    bench, mass, out = used.bench, mass_of(setup.beam), []
    for push in setup.pushes:
        solved = solve_push(setup.beam, bench, even_push(push))
        on_nodes = SPLINE.basis(solved.problem.grid.nodes)
        along_push = tag_derivatives(solved, bench, even_push(push), mass, on_nodes, np.asarray(bench.tags))
        own = [along_push.blocks[name] for name in ("place", "direction", "push")]  # m, rad, N x and y
        stiffness = np.concatenate([along_push.blocks["stiffness"], *own], axis=-1)
        out.append(replace(along_push, blocks=along_push.blocks | {"stiffness": stiffness}))
    return tuple(out)


def information_of(setup: Setup, used: RehearsalInstruments, along_pushes: tuple[TagDerivatives, ...]) -> Array:
    """(p, p) information of all pushes together on the coefficients of log k; tags and rest shape are shared by all."""
    bench, own = used.bench, used.push
    chosen = np.arange(len(bench.tags), dtype=np.int64)
    sd = np.maximum([own.place, own.direction, own.load, own.load], _LEAST_SD)
    first, size = SPLINE.count, SPLINE.count + len(sd) + bench.shared_size
    last = np.arange(first, first + len(sd))
    order = np.concatenate([np.setdiff1d(np.arange(size), last), last])
    joint = np.zeros((first + bench.shared_size, first + bench.shared_size))
    for along_push, push in zip(along_pushes, setup.pushes, strict=True):
        of_push = joint_information(along_push, bench, even_push(push), chosen)
        joint += eliminate(of_push[np.ix_(order, order)], len(sd), sd**-2.0)
    return eliminate(joint, bench.shared_size, alone(bench))


def posterior_of(setup: Setup, used: RehearsalInstruments, information: Array) -> PredictedBand:
    """What the fit's prior makes of data with this information (p, p), that show the setup's k without noise."""
    k = np.asarray(setup.beam.stiffness(PLACES))
    truth = np.linalg.lstsq(BASIS, np.log(k), rcond=None)[0]
    posterior = stiffness_mixture(
        SPLINE, [InformationForm(information, information @ truth)], float(np.mean(np.log(k))), _DRAWS
    )
    prior = equivalent_prior(posterior.covariance, information)
    bias = np.asarray(BASIS @ (posterior.mean - truth))
    return _band(k, bias, prior, information, used.bench.gain_sd)


def with_information(now: PredictedBand, used: RehearsalInstruments, information: Array) -> PredictedBand:
    """The same beam with other data: the equivalent prior and the bias are kept, so that only the data differ."""
    return _band(now.k, now.bias, now.prior, information, used.bench.gain_sd)


def equivalent_prior(covariance: Array, information: Array) -> Array:
    """(p, p) precision P of a normal prior with `(I + P)^-1 = covariance`.

    With covariance = L L', P = L^-T (1 - L' I L) L^-1. Where the draws make the covariance larger than the data alone
    allow, by chance, that part of P is zero.
    """
    root = np.linalg.cholesky(covariance)
    values, vectors = np.linalg.eigh(root.T @ information @ root)
    factor = solve_triangular(root, vectors * np.sqrt(np.maximum(1.0 - values, 0.0)), lower=True, trans="T")
    return np.asarray(factor @ factor.T)


def _band(k: Array, bias: Array, prior: Array, information: Array, gain_sd: float) -> PredictedBand:
    covariance = np.asarray(np.linalg.inv(information + prior))
    own_sd = _sd_along(covariance)
    sd = np.hypot(own_sd, gain_sd)
    scatter = np.hypot(_sd_along(np.asarray(covariance @ information @ covariance)), gain_sd)
    return PredictedBand(k, sd, own_sd, scatter, bias, prior, quality_of(sd, own_sd))


def _sd_along(covariance: Array) -> Array:
    """(101,) sd of log k at `PLACES`."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("si,ij,sj->s", BASIS, covariance, BASIS), 0.0)))


def quality_of(sd: Array, own_sd: Array) -> Quality:
    """Figures of a band of log k whose sd (101,) is `own_sd` without the gain; as `plan` reads them."""
    width, known = 2.0 * half_width(sd), own_sd < IDENTIFIED_SD
    worst = int(np.argmax(width))
    to = 0.0 if not known[0] else 1.0 if np.all(known) else float(PLACES[max(int(np.argmin(known)) - 1, 0)])
    share = float(np.mean(known))
    return Quality(float(np.mean(width)), float(width[worst]), float(PLACES[worst]), share, round(to, 2))


def ranges(known: BoolArray) -> list[tuple[float, float]]:
    """Stretches of s where `known` (101,) holds."""
    return [(float(PLACES[first]), float(PLACES[end - 1])) for first, end in runs(known)]
