"""Random beams whose stiffness is known: smooth, stepped, or with a soft joint."""

from __future__ import annotations

from typing import Literal

import numpy as np

from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.profiles.stiffness import Profile, Steps, Table
from onebend.beam.statics.continuation import equilibrium
from onebend.beam.statics.problem import Resolution
from onebend.blas import one_blas_thread
from onebend.records import Array

Kind = Literal["smooth", "stepped", "joint"]
PLACES = 401
RESOLUTION = Resolution(order=12, widest=0.1)  # carries a table of k(s) and a narrow joint to 1e-9 L
GROWTH, BATCH, MOST_BATCHES = 1.12, 10, 10  # of the forces tried
LARGEST_RATIO = 6.0  # of the stiffest to the softest place of a smooth beam


def random_stiffness(kind: Kind, rng: np.random.Generator, *, level: float = 0.02) -> Profile:
    """k(s) [N m] around `level`, of one kind."""
    s = np.linspace(0.0, 1.0, PLACES)
    size = level * np.exp(0.3 * rng.standard_normal())
    if kind == "stepped":
        jumps = np.sort(rng.uniform(0.15, 0.85, rng.integers(1, 3)))
        if len(jumps) == 2 and jumps[1] - jumps[0] < 0.15:
            jumps = jumps[:1]
        signs = rng.choice([-1.0, 1.0], len(jumps))
        log_k = np.concatenate([[0.0], np.cumsum(signs * np.log(rng.uniform(1.3, 3.0, len(jumps))))])
        values = size * np.exp(log_k - log_k.mean())
        return Steps((0.0, *jumps.tolist(), 1.0), tuple(values.tolist()))
    log_k = smooth_log(s, rng)
    if kind == "joint":
        centre, width, left = rng.uniform(0.2, 0.7), rng.uniform(0.02, 0.05), rng.uniform(0.2, 0.6)
        log_k = log_k + np.log1p((left - 1.0) * np.exp(-0.5 * ((s - centre) / width) ** 2))
    return Table(tuple(s.tolist()), tuple((size * np.exp(log_k)).tolist()))


def smooth_log(s: Array, rng: np.random.Generator) -> Array:
    """A taper plus up to three broad bumps, scaled to a range of 1:1 to 6:1; mean zero."""
    taper, bow = rng.normal(0.0, 1.0), rng.normal(0.0, 1.5)
    log_k = taper * (s - 0.5) + bow * (s - rng.uniform(0.3, 0.7)) ** 2
    for _ in range(int(rng.integers(0, 4))):
        centre, width = rng.uniform(0.0, 1.0), rng.uniform(0.12, 0.4)
        log_k = log_k + rng.normal(0.0, 0.5) * np.exp(-0.5 * ((s - centre) / width) ** 2)
    wanted = rng.uniform(0.0, np.log(LARGEST_RATIO))
    log_k = log_k * (wanted / max(float(np.ptp(log_k)), 1e-9))
    return np.asarray(log_k - log_k.mean())


@one_blas_thread
def force_that_bends(beam: Beam, bend: float, direction: float, at_s: float = 1.0) -> float:
    """N: the force at angle `direction` [rad] that turns the place where it acts by `bend` [rad].

    Where the beam would snap through before that, nine tenths of the largest force that it carries on this branch.
    """
    unit = np.array([np.cos(direction), np.sin(direction)])
    softest = float(np.min(np.asarray(beam.stiffness(np.linspace(0.0, 1.0, PLACES)))))
    last, turned = 0.0, 0.0
    sizes = 0.2 * bend * softest / (beam.length * at_s**2) * GROWTH ** np.arange(BATCH)
    for _ in range(MOST_BATCHES):
        solved = equilibrium(beam, push(sizes[:, None] * unit, at_s), resolution=RESOLUTION)
        for size, stands, shape in zip(sizes, solved.converged, solved.angle(np.array([0.0, at_s])), strict=True):
            if not stands:
                return 0.9 * last
            now = abs(float(shape[1] - shape[0]))
            if now >= bend:
                return float(last + (size - last) * (bend - turned) / (now - turned))
            last, turned = float(size), now
        sizes = sizes * GROWTH**BATCH
    return last
