"""Recordings of a beam whose k(s), mounting and contact are drawn as they are stated to be known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from onebend.beam.continuation import follow
from onebend.beam.loads import Loads, push
from onebend.beam.model import Beam, Shape
from onebend.beam.problem import make_problem
from onebend.beam.stiffness import UncertainStiffness
from onebend.learning.parameters import clamp_sd
from onebend.records import Array, Observations
from tests.learning.bench import MARKERS, observed

_KNOTS = np.array([0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0])
_ROOT = 0.02 * np.eye(5) + 0.01
BAND = UncertainStiffness(_KNOTS, np.full(5, np.log(0.02)), _ROOT @ _ROOT.T, gain_sd=0.02)
BEAM = Beam(0.15, BAND.profile)
NOISE = (3e-5, 1e-3)  # m, rad, of a tag in a frame
PLACEMENT_SD, TURN_SD, PLACE_SD = 2e-4, 2e-3, 3e-4  # m, rad, m


class Shapes(Protocol):
    """A beam's shapes in F frames."""

    def xy(self, s: Array) -> Array: ...  # (F, S, 2) m

    def angle(self, s: Array) -> Array: ...  # (F, S) rad


def place_off(seed: int) -> float:
    """Of s: what the place of the contact is off by."""
    return PLACE_SD / BEAM.length * float(np.random.default_rng([seed, 1]).standard_normal())


def shape_of(beam: Beam, loads: Loads) -> Shape:
    """Its equilibria."""
    return Shape(follow(make_problem(beam, loads)), single=False)


def drawn(
    seed: int, loads: Loads, *, at_s: float = 0.9, noise: tuple[float, float] = NOISE
) -> tuple[Observations, Array]:
    """What is seen under `loads` at their true places, said to act at `at_s`; and the axes (2, 2) of the clamp: they
    take a force from the beam's frame to that in which it is told."""
    return drawn_shapes(seed, lambda beam: shape_of(beam, loads), loads.size, at_s=at_s, noise=noise)


def drawn_shapes(
    seed: int,
    shapes: Callable[[Beam], Shapes],
    count: int,
    *,
    at_s: float = 0.9,
    noise: tuple[float, float] = NOISE,
    fps: float = 30.0,
) -> tuple[Observations, Array]:
    """As `drawn`, of what `shapes` makes of the true beam: its `count` shapes in time."""
    rng, length, rest = np.random.default_rng([seed, 2]), BEAM.length, push((0.0, 0.0))
    o = observed(BEAM, np.zeros((count, 2)), at_s=at_s, noise=noise)
    o = replace(o, stated=replace(o.stated, placement_sd=PLACEMENT_SD, turn_sd=TURN_SD, place_sd=PLACE_SD))
    o = replace(o, time=np.arange(count) / fps)
    clamp = clamp_sd(o) * float(rng.standard_normal())
    true = Beam(length, BAND.draw(1, seed=seed)[0], clamp_angle=clamp)
    at = MARKERS + PLACEMENT_SD * rng.standard_normal(3) / length
    across, turn = PLACEMENT_SD * rng.standard_normal((3, 1)), TURN_SD * rng.standard_normal(3)
    origin, s = PLACEMENT_SD * rng.standard_normal(2), np.minimum(at, 1.0)

    def seen(shape: Shapes, sd: Array) -> tuple[Array, Array]:
        angle = shape.angle(s)
        tangent = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        left = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
        xy = shape.xy(s) + length * (at - s)[:, None] * tangent + across * left + origin
        return xy + sd[0] * rng.standard_normal(xy.shape), angle + turn + sd[1] * rng.standard_normal(angle.shape)

    sd = np.array(noise)
    xy, angle = seen(shapes(true), sd)
    rest_xy, rest_angle = (values[0] for values in seen(shape_of(true, rest), sd / np.sqrt(30.0)))
    cos, sin = np.cos(clamp), np.sin(clamp)
    o = replace(o, xy=xy, angle=angle, rest_xy=rest_xy, rest_angle=rest_angle)
    return o, np.array([[cos, sin], [-sin, cos]])


def contacts(seed: int, count: int = 8) -> tuple[Array, Array, Array]:
    """Places (2,) at least 0.2 of the beam apart, and forces (F, 2) N at each over `count` frames, to either side: up
    to 1 to 5 times k/L at the nearer one, half of that at the farther one."""
    rng, way = np.random.default_rng([seed, 3]), np.linspace(0.4, 1.0, count)
    near = float(rng.uniform(0.3, 0.75))
    far = float(rng.uniform(near + 0.2, 1.0))
    out, scale = [], float(np.mean(np.asarray(BEAM.stiffness(np.linspace(0.0, 1.0, 101))))) / BEAM.length
    for most, shape in ((5.0, np.sin(rng.uniform(1.5, 3.0) * way)), (2.5, way**2)):
        turn = float(rng.choice([-1.0, 1.0])) * rng.uniform(1.2, 1.9) + 0.2 * way
        size = float(rng.uniform(0.2, 1.0)) * most * scale * shape
        out.append(size[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    return np.array([near, far]), out[0], out[1]
