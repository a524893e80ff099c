"""Random beams, and goals that are known to be reachable because a force put the point there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from onebend.beam.continuation import follow
from onebend.beam.loads import push
from onebend.beam.model import Beam
from onebend.beam.problem import Resolution, make_problem
from onebend.beam.stiffness import LogSpline, Powers, Profile, Uniform
from onebend.records import Array, BoolArray

RESOLUTION = Resolution(16)
LARGEST = 25.0  # times k / (L s_a^2): of the forces
TIP = np.deg2rad(120.0)  # the most that a tip turns from rest
LEAST = 0.05  # rad: a beam bent less has no goal worth the name
TAPER = 10.0


@dataclass(frozen=True)
class Goals:
    """A beam and reachable goals of one of its points."""

    beam: Beam
    push_s: float
    point_s: float
    goals: Array  # (G, 2) m
    forces: Array  # (G, 2) N, that made them


def random_beam(rng: np.random.Generator) -> Beam:
    """Uniform, tapered 10:1 either way, or smooth and uneven up to 10:1; four in ten are bent at rest."""
    level = 0.02 * np.exp(0.3 * rng.standard_normal())
    profiles: tuple[Profile, ...] = (
        Uniform(level),
        Powers((level, -(1.0 - 1.0 / TAPER) * level)),
        Powers((level / TAPER, (1.0 - 1.0 / TAPER) * level)),
        _uneven(level, rng),
    )
    rest = Uniform(0.3 * rng.standard_normal() if rng.random() < 0.4 else 0.0)
    return Beam(rng.uniform(0.08, 0.4), profiles[rng.integers(len(profiles))], rest_curvature=rest)


def _uneven(level: float, rng: np.random.Generator) -> LogSpline:
    values = rng.uniform(-0.5, 0.5, 7)
    values *= np.log(rng.uniform(1.0, TAPER)) / np.ptp(values)
    knots = (0.0, 0.0, 0.0, *np.linspace(0.0, 1.0, 5).tolist(), 1.0, 1.0, 1.0)
    return LogSpline(knots, tuple((np.log(level) + values).tolist()))


def goals(beams: int, each: int, *, seed: int) -> Iterator[Goals]:
    """`each` goals on each of `beams` random beams: forces of all directions and sizes, tips turned up to 120 deg."""
    for i in range(beams):
        rng = np.random.default_rng([seed, i])
        beam = random_beam(rng)
        push_s = float(rng.choice([1.0, 1.0, 0.8, 0.6, rng.uniform(0.4, 1.0)]))
        point_s = float(rng.choice([1.0, push_s, rng.uniform(0.3, 1.0)]))
        yield _reached(beam, push_s, point_s, each, rng)


def _reached(beam: Beam, push_s: float, point_s: float, count: int, rng: np.random.Generator) -> Goals:
    turn, size = rng.uniform(-np.pi, np.pi, 4 * count), rng.uniform(0.0, 1.0, 4 * count) ** 2
    largest = LARGEST * float(np.mean(beam.stiffness(np.linspace(0.0, 1.0, 51)))) / (beam.length * push_s**2)
    force = largest * size[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    solved = follow(make_problem(beam, push(force, push_s), RESOLUTION))
    bent = np.max(np.abs(solved.alpha - solved.problem.to_nodes @ solved.problem.q0), axis=1)
    tip = np.abs(solved.angle(np.ones(1))[:, 0] - float(np.sum(solved.problem.weights * solved.problem.q0)))
    good = np.flatnonzero(solved.converged & solved.stable & (bent > LEAST) & (tip < TIP))[:count]
    return Goals(beam, push_s, point_s, solved.xy(np.array([point_s]))[good, 0], force[good])


def places_under(
    beam: Beam, force: Array, push_s: float, point_s: float, resolution: Resolution = RESOLUTION
) -> tuple[Array, BoolArray]:
    """(G, 2) m of the point under forces (G, 2), on the branch from rest, and (G,) whether it is stable there.

    By load continuation alone: it knows nothing of how the forces were found.
    """
    solved = follow(make_problem(beam, push(force, push_s), resolution))
    return solved.xy(np.array([point_s]))[:, 0], solved.converged & solved.stable
