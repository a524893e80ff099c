"""The band of k(s) against samples of the exact posterior: what Laplace's approximation costs at fixed scales.

The target is the posterior with the nonlinear equilibrium; scales, tags' weights and frames' covariances are held at
the optimum, as Laplace's approximation holds them. The tags are so exact that the posterior is a thin curved sheet:
where k moves, the force's error must follow. So the force's error is followed: at every k and mounting it takes its
most probable value there, as in the fit's own optimum. What is left (some sixty parameters) is sampled by Hamiltonian
Monte Carlo (Neal 2011) with exact derivatives, in coordinates in which Laplace's approximation is a unit normal.

The same with the force's error integrated out is another question: a flat prior of the true force gives a volume to
every k (a stiffer beam leaves the tags less to say of the force), and moves log k up by about its variance times the
number of directions of the force that the tags decide. Its quantiles are those of the same samples, each weighted by
its volume.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from benchmarks.studies import bench_of, fit_from_nothing
from onebend.lab.virtual import observe_virtual, virtual_recording
from onebend.learning.linear import (
    beside_tags,
    data_information,
    explained_by,
    force_shrinkage,
    misfit,
    prior,
    residual_rows,
    residuals,
    solved,
)
from onebend.learning.posterior import Posterior
from onebend.learning.prediction import Prediction, predict
from onebend.records import Array, BoolArray

S = np.linspace(0.05, 0.9, 18)
ACCEPTED = 0.8  # share of steps that the stride is set for
STRIDES = (5, 15)  # a step
INNER = 2  # Gauss-Newton steps of the force's error at each k
LEVELS = (0.025, 0.1, 0.5, 0.9, 0.975)
NORMAL = np.array([-1.9600, -1.2816, 0.0, 1.2816, 1.9600])
CELLS = (("smooth", "correlated"), ("smooth", "everything"), ("stepped", "correlated"), ("joint", "tags"))


@dataclass(frozen=True)
class Sampled:
    """A chain, and how it went."""

    log_k: Array  # (N, S)
    volume: Array  # (N,) of the force's errors, their sum one
    accepted: float  # share of steps
    worth: float  # independent samples, least over S


@dataclass(frozen=True)
class Comparison:
    """Quantiles of log k at S, in Laplace's sd from its centre."""

    followed: Array  # (levels, S)
    integrated: Array  # (levels, S), the force's error integrated out
    sampled: Sampled
    band_over: float  # median of the fit's own sd (scales averaged) over Laplace's at fixed scales


@dataclass(frozen=True)
class Here:
    """The target at one point: minus log density, its slope and its Gauss-Newton curvature."""

    value: float
    slope: Array
    curvature: Array


@dataclass(frozen=True)
class There:
    """The target with the force's error at its optimum."""

    value: float  # infinite where there is no equilibrium
    slope: Array
    volume: float  # log, of the force's errors


class UnreachableError(Exception):
    """No equilibrium at these parameters."""


def target_of(posterior: Posterior) -> tuple[Callable[[Array], Here], Array]:
    """The exact posterior, and Laplace's covariance at the optimum."""
    problem, layout, best = posterior.problem, posterior.layout, posterior.optimum
    every = list(zip(problem.recordings, best.predictions, best.hyperparameters.noise, strict=True))
    rows = [residual_rows(now, noise) for _, now, noise in every]
    before = prior(problem, best.hyperparameters)
    beside = beside_tags(problem, 0, best.x).information(best.x)
    data = data_information(problem, rows, best.x, best.hyperparameters)
    precision = cho_solve((before.times(np.eye(len(best.x))), True), np.eye(len(best.x)))

    def target(x: Array) -> Here:
        away, curvature = x - before.mean, precision + beside.matrix
        slope = precision @ away + beside.matrix @ x - beside.vector
        value = 0.5 * float(away @ precision @ away + x @ beside.matrix @ x) - float(beside.vector @ x)
        for (recording, now, noise), r in zip(every, rows, strict=True):
            there: Prediction = predict(recording, layout, x, now.solved.q, now.own)
            if not np.all(there.solved.converged):
                raise UnreachableError
            residual = r.root_weight * residuals(there) + explained_by(r.a, there.own)
            mine = layout.known_to(recording.number)
            value += 0.5 * misfit(r, residual, noise)
            j = (recording.whiten @ there.slopes.written).reshape(*residual.shape, -1) * r.root_weight[..., None]
            unexplained = (j - r.a @ (force_shrinkage(r, noise) @ (np.swapaxes(r.a, 1, 2) @ j))) / noise.marker**2
            slope[mine] -= np.einsum("frc,fr->c", unexplained, residual)
            curvature[np.ix_(mine, mine)] += unexplained.reshape(-1, len(mine)).T @ j.reshape(-1, len(mine))
        return Here(value, slope, curvature)

    return target, solved(data, before).covariance.pairs[0]


def force_errors(found: Posterior) -> BoolArray:
    """(P,) which parameters are the force's error."""
    out = np.zeros(found.layout.size, dtype=bool)
    for block in found.layout.blocks:
        if block.start >= 0 and block.name == "force":
            out[block.where] = True
    return out


class _Followed:
    """The target over all parameters but the force's error, which follows; z in Laplace's sd from the optimum."""

    def __init__(self, found: Posterior) -> None:
        self.target, covariance = target_of(found)
        self.mean, self.inner = found.mean, force_errors(found)
        outer = ~self.inner
        self.root = np.zeros((len(outer), int(outer.sum())))
        self.root[outer] = np.linalg.cholesky(covariance[np.ix_(outer, outer)])
        follow = covariance[np.ix_(self.inner, outer)] @ np.linalg.inv(covariance[np.ix_(outer, outer)])
        self.root[self.inner] = follow @ self.root[outer]
        self.covariance = covariance

    @np.errstate(over="ignore", invalid="ignore")  # where there is no equilibrium
    def __call__(self, z: Array) -> There:
        """Minus log density, its slope (the force's error being at its optimum, only what z does itself counts), and
        the log of the volume of the force's errors."""
        x = self.mean + self.root @ z
        try:
            for _ in range(INNER):
                here = self.target(x)
                factor = cho_factor(here.curvature[np.ix_(self.inner, self.inner)], lower=True)
                x[self.inner] -= cho_solve(factor, here.slope[self.inner])
            here = self.target(x)
            root = np.linalg.cholesky(here.curvature[np.ix_(self.inner, self.inner)])
        except (UnreachableError, np.linalg.LinAlgError):
            return There(np.inf, np.zeros(len(z)), 0.0)
        outer = ~self.inner
        return There(here.value, here.slope[outer] @ self.root[outer], -float(np.sum(np.log(np.diag(root)))))


def sample(found: Posterior, count: int, *, seed: int) -> tuple[Sampled, Array]:
    """`count` Hamiltonian steps from the optimum, the first quarter left out, in which the stride is set; and Laplace's
    covariance (P, P) at fixed scales."""
    followed, rng, p = _Followed(found), np.random.default_rng(seed), found.layout.spline.count
    z, stride, burn = np.zeros(followed.root.shape[1]), 0.3, count // 4
    there, chain, volumes, chances = followed(z), [], [], []
    for i in range(count):
        tried, new, chance = moved(followed, z, there, stride, rng)
        if rng.random() < chance:
            z, there = tried, new
        if i < burn:
            stride = float(np.clip(stride * np.exp((chance - ACCEPTED) * 0.3 / (1.0 + i / 30.0) ** 0.6), 1e-3, 0.8))
            continue
        chain.append((followed.mean + followed.root @ z)[:p])
        volumes.append(there.volume)
        chances.append(chance)
    log_k = np.array(chain) @ found.layout.spline.basis(S).T
    volume = np.exp(np.array(volumes) - max(volumes))
    sampled = Sampled(log_k, volume / volume.sum(), float(np.mean(chances)), min(worth(column) for column in log_k.T))
    return sampled, followed.covariance


def moved(
    followed: Callable[[Array], There], z: Array, there: There, stride: float, rng: np.random.Generator
) -> tuple[Array, There, float]:
    """One Hamiltonian step of a random number of strides (leapfrog): where it ends, and the chance to take it."""
    momentum = rng.standard_normal(len(z))
    energy = there.value + 0.5 * float(momentum @ momentum)
    momentum = momentum - 0.5 * stride * there.slope
    strides = int(rng.integers(*STRIDES))
    for i in range(strides):
        z = z + stride * momentum
        there = followed(z)
        if not np.isfinite(there.value):
            return z, there, 0.0
        momentum = momentum - (stride if i < strides - 1 else 0.5 * stride) * there.slope
    end = there.value + 0.5 * float(momentum @ momentum)
    return z, there, float(np.exp(min(0.0, energy - end)))


def worth(values: Array) -> float:
    """Independent samples that a chain (N,) is worth: Geyer's initial positive sequence."""
    v = values - values.mean()
    size = len(v)
    rho = np.fft.irfft(np.abs(np.fft.rfft(v, 2 * size)) ** 2)[:size]
    rho = rho / max(float(rho[0]), 1e-300)
    pairs = rho[0 : size - 1 : 2] + rho[1:size:2]
    stop = int(np.argmin(pairs > 0.0)) if np.any(pairs <= 0.0) else len(pairs)
    return float(size / max(2.0 * float(np.sum(pairs[:stop])) - 1.0, 1.0))


def compare(found: Posterior, count: int, *, seed: int) -> Comparison:
    """Quantiles of log k from samples against Laplace's."""
    sampled, covariance = sample(found, count, seed=seed)
    basis, p = found.layout.spline.basis(S), found.layout.spline.count
    sd = np.sqrt(np.einsum("si,ij,sj->s", basis, covariance[:p, :p], basis))
    away = (sampled.log_k - basis @ found.mean[:p]) / sd
    even = np.full(len(away), 1.0 / len(away))
    return Comparison(
        quantiles(away, even),
        quantiles(away, sampled.volume),
        sampled,
        float(np.median(found.stiffness.log_at(S)[1] / sd)),
    )


def quantiles(values: Array, weight: Array) -> Array:
    """(levels, S) of values (N, S) with weights (N,)."""
    order = np.argsort(values, axis=0)
    below = np.cumsum(weight[order], axis=0) - 0.5 * weight[order]
    rising = np.take_along_axis(values, order, axis=0)
    return np.stack([np.interp(LEVELS, b, v) for b, v in zip(below.T, rising.T, strict=True)], axis=-1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--cells", type=int, default=len(CELLS), help="how many of the recordings")
    asked = parser.parse_args()
    levels, normal = (" / ".join(f"{q:g}" for q in row) for row in (LEVELS, np.round(NORMAL, 2)))
    print(f"Quantiles {levels} of log k in Laplace's sd; a normal distribution has {normal}.\n")
    print(
        "| recording | steps taken | worth | quantiles, mean over s | farthest off | the force's error integrated out "
        "| band's sd over Laplace's |"
    )
    print("| --- " * 7 + "|")
    for seed, (kind, errors) in enumerate(CELLS[: asked.cells]):
        bench = bench_of(kind, errors, seed)  # type: ignore[arg-type]
        found = fit_from_nothing(observe_virtual(virtual_recording(bench, seed=seed)))
        one = compare(found, asked.steps, seed=seed)
        mean, beside = (" / ".join(f"{v:+.2f}" for v in q.mean(axis=1)) for q in (one.followed, one.integrated))
        worst = float(np.max(np.abs(one.followed - NORMAL[:, None])))
        print(
            f"| {kind} {errors} {seed} | {100 * one.sampled.accepted:.0f} % | {one.sampled.worth:.0f} | {mean} "
            f"| {worst:.2f} | {beside} | {one.band_over:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
