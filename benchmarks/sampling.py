"""The band of k(s) against samples of the exact posterior: what Laplace's approximation costs at fixed scales.

The target is the posterior with the nonlinear equilibrium; scales, tags' weights and frames' covariances are held at
the optimum, as Laplace's approximation holds them. The tags are so exact that the posterior is a thin curved sheet:
where k moves, the force's error must follow. So the force's error is followed: at every k and mounting it takes its
most probable value there, as in the fit's own optimum, and what is left (some thirty parameters) is sampled by
preconditioned Crank-Nicolson steps. A Gaussian target would accept every step.

The same with the force's error integrated out is another question: a flat prior of the true force gives a volume to
every k (a stiffer beam leaves the tags less to say of the force), and moves log k up by about its variance times the
number of directions of the force that the tags decide.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from benchmarks.studies import bench_of, fit_from_nothing
from onebend.blas import one_blas_thread
from onebend.lab.virtual import observe_virtual, virtual_recording
from onebend.learning.forward import Prediction, predict
from onebend.learning.gauss_newton import (
    explained_by,
    misfit,
    prior,
    quadratic,
    residuals,
    rest_quadratic,
    rows_of,
    shrink,
    together,
)
from onebend.learning.posterior import Posterior
from onebend.records import Array, BoolArray

S = np.linspace(0.05, 0.9, 18)
STEP = 0.8  # of pCN: the part of each step that is new
INNER = 2  # Gauss-Newton steps of the force's error at each k
LEVELS = (0.025, 0.1, 0.5, 0.9, 0.975)
NORMAL = np.array([-1.9600, -1.2816, 0.0, 1.2816, 1.9600])
CELLS = (("smooth", "correlated"), ("smooth", "everything"), ("stepped", "correlated"), ("joint", "tags"))


@dataclass(frozen=True)
class Sampled:
    """A chain, and how it went."""

    log_k: Array  # (N, S)
    accepted: float  # share of steps
    worth: float  # independent samples, least over S


@dataclass(frozen=True)
class Comparison:
    """Quantiles of log k at S, in Laplace's sd from its centre."""

    quantiles: Array  # (levels, S)
    sampled: Sampled
    band_over: float  # median of the fit's own sd (scales averaged) over Laplace's at fixed scales


@dataclass(frozen=True)
class Here:
    """The target at one point: minus log density, its slope and its Gauss-Newton curvature."""

    value: float
    slope: Array
    curvature: Array


class UnreachableError(Exception):
    """No equilibrium at these parameters."""


def target_of(found: Posterior) -> tuple[Callable[[Array], Here], Array]:
    """The exact posterior, and Laplace's covariance at the optimum."""
    films, at, best, scales = list(found.films), found.at, found.optimum, found.optimum.scales
    every = list(zip(films, best.predictions, scales.films, strict=True))
    rows = [rows_of(p, n) for _, p, n in every]
    precision, mean, _ = prior(films, at, prior_level(found), scales)
    rests = rest_quadratic(films, at)
    data = together([*(quadratic(r, at, f.number, best.x, n) for (f, _, n), r in zip(every, rows, strict=True)), rests])

    def target(x: Array) -> Here:
        away, curvature = x - mean, precision + rests.information
        slope = precision @ away + rests.information @ x - rests.b
        value = 0.5 * float(away @ precision @ away + x @ rests.information @ x) - float(rests.b @ x)
        for (f, p, n), r in zip(every, rows, strict=True):
            there: Prediction = predict(f, at, x, p.solved.q, p.own)
            if not np.all(there.solved.converged):
                raise UnreachableError
            left, mine = r.root_weight * residuals(there) + explained_by(r.a, there.own), at.known_to(f.number)
            value += 0.5 * misfit(r, left, n)
            j = (f.whiten @ there.slopes.written).reshape(*left.shape, -1) * r.root_weight[..., None]
            across = (j - r.a @ (shrink(r, n) @ (np.swapaxes(r.a, 1, 2) @ j))) / n.marker**2
            slope[mine] -= np.einsum("frc,fr->c", across, left)
            curvature[np.ix_(mine, mine)] += across.reshape(-1, len(mine)).T @ j.reshape(-1, len(mine))
        return Here(value, slope, curvature)

    covariance = np.linalg.inv(data.information + precision)
    return target, 0.5 * (covariance + covariance.T)


def prior_level(found: Posterior) -> float:
    """Mean of log k at the optimum: the prior's own centre is so loose that its place does not matter."""
    s = np.linspace(0.0, 1.0, 101)
    return float(np.mean(found.at.spline.basis(s) @ found.at.get(found.mean, "stiffness")))


def force_errors(found: Posterior) -> BoolArray:
    """(P,) which parameters are the force's error."""
    out = np.zeros(found.at.size, dtype=bool)
    for block in found.at.blocks:
        if block.start >= 0 and block.name == "force":
            out[block.where] = True
    return out


def without_forces(target: Callable[[Array], Here], inner: BoolArray, x: Array, *, integrate: bool) -> float:
    """Minus log density at x with the parameters `inner` at their optimum there, or integrated out."""
    x = x.copy()
    for _ in range(INNER):
        here = target(x)
        factor = cho_factor(here.curvature[np.ix_(inner, inner)], lower=True)
        x[inner] -= cho_solve(factor, here.slope[inner])
    here = target(x)
    if not integrate:
        return here.value
    root = np.linalg.cholesky(here.curvature[np.ix_(inner, inner)])
    return here.value + float(np.sum(np.log(np.diag(root))))


@one_blas_thread
def sample(found: Posterior, count: int, *, seed: int, integrate: bool) -> tuple[Sampled, Array]:
    """`count` steps from the optimum, the first tenth left out; and Laplace's covariance (P, P) at fixed scales."""
    target, covariance = target_of(found)
    inner = force_errors(found)
    outer = ~inner
    follow = covariance[np.ix_(inner, outer)] @ np.linalg.inv(covariance[np.ix_(outer, outer)])
    root = np.linalg.cholesky(covariance[np.ix_(outer, outer)])
    rng, p = np.random.default_rng(seed), found.at.spline.count

    def beyond(z: Array) -> float:
        """Minus log density over Laplace's, z of its sd from the optimum."""
        x = found.mean.copy()
        x[outer] += root @ z
        x[inner] += follow @ (root @ z)
        try:
            return without_forces(target, inner, x, integrate=integrate) - 0.5 * float(z @ z)
        except (UnreachableError, np.linalg.LinAlgError):
            return np.inf

    z = np.zeros(len(root))
    excess, accepted, chain = beyond(z), 0, np.empty((count, p))
    for i in range(count):
        tried = np.sqrt(1.0 - STEP**2) * z + STEP * rng.standard_normal(len(z))
        there = beyond(tried)
        if np.log(rng.random()) < excess - there:
            z, excess, accepted = tried, there, accepted + 1
        chain[i] = (found.mean[outer] + root @ z)[:p]
    log_k = chain[count // 10 :] @ found.at.spline.basis(S).T
    return Sampled(log_k, accepted / count, min(worth(column) for column in log_k.T)), covariance


def worth(values: Array) -> float:
    """Independent samples that a chain (N,) is worth: Geyer's initial positive sequence."""
    v = values - values.mean()
    size = len(v)
    rho = np.fft.irfft(np.abs(np.fft.rfft(v, 2 * size)) ** 2)[:size]
    rho = rho / max(float(rho[0]), 1e-300)
    pairs = rho[0 : size - 1 : 2] + rho[1:size:2]
    stop = int(np.argmin(pairs > 0.0)) if np.any(pairs <= 0.0) else len(pairs)
    return float(size / max(2.0 * float(np.sum(pairs[:stop])) - 1.0, 1.0))


def compare(found: Posterior, count: int, *, seed: int, integrate: bool) -> Comparison:
    """Quantiles of log k from samples against Laplace's."""
    sampled, covariance = sample(found, count, seed=seed, integrate=integrate)
    basis, p = found.at.spline.basis(S), found.at.spline.count
    sd = np.sqrt(np.einsum("si,ij,sj->s", basis, covariance[:p, :p], basis))
    away = (sampled.log_k - basis @ found.mean[:p]) / sd
    return Comparison(np.quantile(away, LEVELS, axis=0), sampled, float(np.median(found.stiffness.log_at(S)[1] / sd)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--cells", type=int, default=len(CELLS), help="how many of the recordings")
    asked = parser.parse_args()
    quantiles, normal = (" / ".join(f"{q:g}" for q in row) for row in (LEVELS, np.round(NORMAL, 2)))
    print(f"Quantiles {quantiles} of log k in Laplace's sd; a normal distribution has {normal}.\n")
    print(
        "| recording | force error | steps taken | worth | quantiles, mean over s | farthest off | band's sd over it |"
    )
    print("| --- " * 7 + "|")
    for seed, (kind, errors) in enumerate(CELLS[: asked.cells]):
        bench = bench_of(kind, errors, seed)  # type: ignore[arg-type]
        found = fit_from_nothing(observe_virtual(virtual_recording(bench, seed=seed)))
        for integrate in (False, True):
            one = compare(found, asked.steps, seed=seed, integrate=integrate)
            mean = " / ".join(f"{q:+.2f}" for q in one.quantiles.mean(axis=1))
            worst = float(np.max(np.abs(one.quantiles - NORMAL[:, None])))
            print(
                f"| {kind} {errors} {seed} | {'integrated' if integrate else 'followed'} "
                f"| {100 * one.sampled.accepted:.0f} % | {one.sampled.worth:.0f} | {mean} | {worst:.2f} "
                f"| {one.band_over:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
