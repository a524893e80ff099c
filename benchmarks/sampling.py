"""The band of k(s) against samples of the exact posterior: what Laplace's approximation costs at fixed scales.

The target is the posterior of all parameters with the nonlinear equilibrium; scales, tags' weights and frames'
covariances are held at the optimum, as Laplace's approximation holds them. Sampled by preconditioned Crank-Nicolson
steps around the optimum: a Gaussian target accepts every one, so what is rejected measures how far from Gaussian it is.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.studies import bench_of, fit_from_nothing
from onebend.blas import one_blas_thread
from onebend.lab.virtual import observe_virtual, virtual_recording
from onebend.learning.forward import predict
from onebend.learning.gauss_newton import misfit, prior, quadratic, residuals, rest_quadratic, rows_of, together
from onebend.learning.posterior import Posterior
from onebend.records import Array

S = np.linspace(0.05, 0.95, 19)
STEP = 0.4  # of pCN: the part of each step that is new
LEVELS = (0.025, 0.1, 0.5, 0.9, 0.975)


@dataclass(frozen=True)
class Sampled:
    """A chain, and how it went."""

    x: Array  # (N, P)
    accepted: float  # share
    effective: float  # samples' worth, least over log k at S
    covariance: Array  # (P, P) Laplace's at fixed scales


@dataclass(frozen=True)
class Comparison:
    """Quantiles of log k at S, in Laplace's sd from its centre."""

    name: str
    quantiles: Array  # (levels, S)
    sampled: Sampled
    band_over: float  # median of the fit's own sd (scales averaged) over Laplace's at fixed scales


def minus_log_posterior(found: Posterior) -> tuple[Callable[[Array], float], Array]:
    """The exact target but for a constant, and Laplace's covariance at the optimum."""
    films, at, best, scales = list(found.films), found.at, found.optimum, found.optimum.scales
    shapes = list(best.predictions)
    every = list(zip(films, shapes, scales.films, strict=True))
    rows = [rows_of(f, at, best.x, p, n) for f, p, n in every]
    level = prior_level(found)
    precision, mean = prior(films, at, level, scales)
    rests = rest_quadratic(films, at)
    data = together([*(quadratic(r, at, f.number, best.x, n) for (f, _, n), r in zip(every, rows, strict=True)), rests])

    def target(x: Array) -> float:
        there = [predict(f, at, x, p.solved.q) for f, p, _ in every]
        if not all(np.all(p.solved.converged) for p in there):
            return np.inf
        tags = sum(
            misfit(r, r.root_weight * residuals(f, p), n) for (f, _, n), r, p in zip(every, rows, there, strict=True)
        )
        away = x - mean
        return 0.5 * float(tags + away @ precision @ away + x @ rests.information @ x - 2.0 * rests.b @ x)

    covariance = np.linalg.inv(data.information + precision)
    return target, 0.5 * (covariance + covariance.T)


def prior_level(found: Posterior) -> float:
    """Mean of log k at the optimum: the prior's own centre is so loose that its place does not matter."""
    s = np.linspace(0.0, 1.0, 101)
    return float(np.mean(found.at.spline.basis(s) @ found.at.get(found.mean, "stiffness")))


@one_blas_thread
def sample(found: Posterior, count: int, *, seed: int) -> Sampled:
    """`count` steps from the optimum; the first tenth is left out."""
    target, covariance = minus_log_posterior(found)
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(covariance)
    centre = found.mean
    z = np.zeros(len(centre))  # in Laplace's sd
    excess = target(centre)  # of the target over Laplace's quadratic
    chain, accepted = np.empty((count, len(centre))), 0
    for i in range(count):
        tried = np.sqrt(1.0 - STEP**2) * z + STEP * rng.standard_normal(len(z))
        there = target(centre + root @ tried) - 0.5 * float(tried @ tried)
        if np.log(rng.random()) < excess - there:
            z, excess, accepted = tried, there, accepted + 1
        chain[i] = centre + root @ z
    chain = chain[count // 10 :]
    basis = found.at.spline.basis(S)
    log_k = chain[:, : found.at.spline.count] @ basis.T
    return Sampled(chain, accepted / count, min(effective(column) for column in log_k.T), covariance)


def effective(values: Array) -> float:
    """Independent samples that a chain (N,) is worth: Geyer's initial positive sequence."""
    v = values - values.mean()
    size = len(v)
    spectrum = np.abs(np.fft.rfft(v, 2 * size)) ** 2
    rho = np.fft.irfft(spectrum)[:size]
    rho = rho / max(float(rho[0]), 1e-300)
    pairs = rho[0 : size - 1 : 2] + rho[1:size:2]
    stop = int(np.argmin(pairs > 0.0)) if np.any(pairs <= 0.0) else len(pairs)
    return float(size / max(2.0 * float(np.sum(pairs[:stop])) - 1.0, 1.0))


def compare(found: Posterior, name: str, count: int, *, seed: int) -> Comparison:
    """Quantiles of log k from samples against Laplace's."""
    drawn = sample(found, count, seed=seed)
    basis, p = found.at.spline.basis(S), found.at.spline.count
    centre = basis @ found.at.get(found.mean, "stiffness")
    sd = np.sqrt(np.einsum("si,ij,sj->s", basis, drawn.covariance[:p, :p], basis))
    away = (drawn.x[:, :p] @ basis.T - centre) / sd
    own = found.stiffness.log_at(S)[1]
    return Comparison(name, np.quantile(away, LEVELS, axis=0), drawn, float(np.median(own / sd)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=3000)
    asked = parser.parse_args()
    quantiles = " / ".join(map(str, LEVELS))
    print(
        f"| recording | steps taken | worth | quantiles {quantiles} of log k in sd, mean | farthest off | band over |"
    )
    print("| --- " * 6 + "|")
    normal = np.array([-1.96, -1.2816, 0.0, 1.2816, 1.96])
    for seed, cell in enumerate(("smooth correlated", "smooth everything", "stepped correlated", "joint tags")):
        kind, errors = cell.split()
        bench = bench_of(kind, errors, seed)  # type: ignore[arg-type]
        found = fit_from_nothing(observe_virtual(virtual_recording(bench, seed=seed)))
        one = compare(found, cell, asked.steps, seed=seed)
        inside = one.quantiles[:, S < 0.91]
        mean = " / ".join(f"{q:+.2f}" for q in inside.mean(axis=1))
        worst = float(np.max(np.abs(inside - normal[:, None])))
        print(
            f"| {cell} {seed} | {100 * one.sampled.accepted:.0f} % | {one.sampled.effective:.0f} | {mean} "
            f"| {worst:.2f} | {one.band_over:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
