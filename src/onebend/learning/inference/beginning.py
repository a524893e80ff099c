"""Where the optimizer begins: from a first k(s), and with all frames from where the fit of a few came to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from onebend.beam.profiles.stiffness import Profile
from onebend.errors import LearningError
from onebend.learning.inference.descent import MapEstimate, with_own_forces
from onebend.learning.inference.fit_problem import FitProblem
from onebend.learning.inference.optimizer import estimate_at
from onebend.learning.model.parameters import Layout
from onebend.records import Array, Observations


def parameters_of(layout: Layout, start: Profile | float) -> tuple[Array, float]:
    """Parameters (P,) and the level of log k to begin with."""
    s = np.linspace(0.0, 1.0, 8 * layout.spline.count)
    k = np.full(len(s), float(start)) if isinstance(start, float | int) else np.asarray(start(s))
    if not np.all(k > 0.0):
        raise LearningError("the start stiffness must be positive everywhere")
    x = np.zeros(layout.size)
    x[: layout.spline.count] = np.linalg.lstsq(layout.spline.basis(s), np.log(k), rcond=None)[0]
    return x, float(np.mean(np.log(k)))


def with_mass_found(
    recordings: Sequence[Observations], problem: FitProblem, near: MapEstimate
) -> tuple[Sequence[Observations], MapEstimate]:
    """Recordings and estimate with a guessed mass replaced by what came out: the prior of its unevenness is relative to
    the mass."""
    if not any(np.isfinite(o.stated.mass_sd) for o in recordings):
        return recordings, near
    mass, even = problem.layout.index["mass", -1].where, np.array([1.0, 0.0, 0.0, 0.0])
    factor, x = 1.0 + max(float(near.x[mass.start]), -0.9), near.x.copy()
    x[mass] = (x[mass] + even) / factor - even
    heavier = [replace(o, stated=replace(o.stated, mass=factor * o.stated.mass)) for o in recordings]
    return heavier, replace(near, x=x)


def carried_over(problem: FitProblem, near: MapEstimate, whole: FitProblem) -> MapEstimate:
    """An estimate for all frames from that for a few."""
    pairs = zip(problem.recordings, whole.recordings, strict=True)
    same = all(np.array_equal(few.frames, every.frames) for few, every in pairs)
    shapes = [p.solved.q for p in near.predictions] if same else None
    begin = estimate_at(whole, near.x, shapes)
    return with_own_forces(replace(begin, hyperparameters=near.hyperparameters, steps=near.steps))
