"""What a recording's allowances do to the fit's model at given parameters, and its derivatives with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.beam.grid import solve_each
from onebend.beam.profiles.rectangular import RectangularSection
from onebend.beam.statics.continuation import follow, refine
from onebend.beam.statics.equilibrium import Equilibrium, gradient, tangent
from onebend.beam.statics.perturbation import Perturbation
from onebend.beam.statics.problem import Problem
from onebend.learning.allowances.allowance import Allowance, Entry
from onebend.learning.allowances.relaxation import memory, rest_shift, secant_share, shift_derivatives
from onebend.learning.allowances.section import section_at
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.held_ends import free_ends
from onebend.learning.model.parameters import Layout, rest_curvature
from onebend.learning.model.tag_jacobian import BentBeam, placed_by, pushed_by
from onebend.records import Array

_SETTLED = 1e-7  # rad, of the last change of a shape that relaxes
_FALLING = 0.2  # of the change before: one that is larger takes a new tangent
_FARTHEST = 5.0  # rad, of the curvature in one update of Newton's method
_MOST_PASSES = 16


def allowed(recording: FitData, layout: Layout, x: Array, enters: Entry) -> Array | float:
    """The sum of the allowances that enter here, at parameters x (P,); 0 where there are none. Shapes: see `Entry`."""
    here = [a for a in recording.allowances if a.enters == enters]
    return sum((a.basis @ _values(recording, layout, x, a) for a in here), start=0.0)


def allowed_length(recording: FitData, layout: Layout, x: Array) -> Array:
    """() m, the beam's length."""
    change = [_values(recording, layout, x, a)[0] for a in recording.allowances if a.enters == "length"]
    return np.asarray(recording.observations.length * np.exp(sum(change)))


def allowed_clamp(recording: FitData, layout: Layout, x: Array) -> Array:
    """() or (F, 1) rad, the clamp's angle."""
    angle, gives = layout.get(x, "clamp", recording.number)[0], allowed(recording, layout, x, "clamp")
    return np.asarray(angle if isinstance(gives, float) else angle + gives[:, None])


def allowed_section(recording: FitData, layout: Layout, x: Array) -> tuple[RectangularSection | None, float]:
    """By which the beam stretches and shears, None where it does neither, and how it goes with the parameter: see
    `section_at`."""
    for a in recording.allowances:
        if a.enters == "section":
            o = recording.observations
            return section_at(float(_values(recording, layout, x, a)[0]), o.stated.thickness, o.length)
    return None, 0.0


def equilibria(recording: FitData, layout: Layout, x: Array, problem: Problem, start: Array | None) -> Equilibrium:
    """Of a free end; where the material relaxes, each shape hangs on those before it, and all are found together.

    `problem` has the curvature at rest of a beam that has not relaxed; `start` (F, Q), where shapes are known about.
    Newton's method on each shape and the shift of its rest take turns. The shift settles slowly and Newton's method
    fast: the tangent's inverse of one pass does for the next ones, as long as they settle.
    """
    values = relaxation_values(recording, layout, x)
    if values is None or not remembers(recording, layout, x):
        return free_ends(problem, recording.poses, start)
    q = follow(problem).q if start is None else start
    remembering, rest = memory(values, relaxation_time(recording)), problem.q0
    nodes, inverse, before = q.shape[1], None, np.inf
    for _ in range(_MOST_PASSES):
        shifted = replace(problem, q0=rest + rest_shift(remembering, q - rest, problem.weights))
        if inverse is None:
            inverse = solve_each(tangent(shifted, q), np.broadcast_to(np.eye(nodes), (*q.shape, nodes)))
        update = (inverse @ gradient(shifted, q)[..., None])[..., 0]
        size = float(np.max(np.abs(update)))
        if not size < _FARTHEST:  # from here Newton's method alone cannot be trusted
            q, inverse = refine(shifted, q).q, None
            continue
        q = q - update
        if size < _SETTLED:
            break
        inverse, before = (inverse if size < _FALLING * before else None), size
    return refine(replace(problem, q0=rest + rest_shift(remembering, q - rest, problem.weights)), q)


def relaxation_values(recording: FitData, layout: Layout, x: Array) -> Array | None:
    """(n,) shares of the material that relax; None where nothing is allowed to."""
    every = [_values(recording, layout, x, a) for a in recording.allowances if a.enters == "relaxation"]
    return every[0] if every else None


def remembers(recording: FitData, layout: Layout, x: Array) -> bool:
    """Whether a shape hangs on those before it."""
    values = relaxation_values(recording, layout, x)
    return values is not None and bool(np.any(values != 0.0)) and recording.ends is None


def relaxation_time(recording: FitData) -> Array:
    """(T,) s of the frames whose shapes relaxation remembers."""
    return next(a.basis for a in recording.allowances if a.enters == "relaxation")


def relaxation_derivatives(recording: FitData, layout: Layout, x: Array, solved: Equilibrium) -> Array | None:
    """(F, Q, n) of the curvature at rest, shapes held; None where the material does not relax."""
    values = relaxation_values(recording, layout, x)
    if values is None:
        return None
    return shift_derivatives(
        values, relaxation_time(recording), bending(recording, layout, x, solved), solved.problem.weights
    )


def secant_of(recording: FitData, layout: Layout, x: Array, solved: Equilibrium) -> float:
    """The secant stiffness over the instantaneous one; 1 where the material does not relax."""
    values = relaxation_values(recording, layout, x)
    if values is None:
        return 1.0
    remembering = memory(values, relaxation_time(recording))
    return secant_share(remembering, bending(recording, layout, x, solved), solved.problem.weights)


def log_k_functions(recording: FitData) -> dict[str, Array]:
    """Functions of log k at the nodes, by the allowance's name."""
    return {a.name: a.basis for a in recording.allowances if a.enters == "log k"}


def allowance_changes(recording: FitData, beam: BentBeam) -> dict[str, Perturbation]:
    """How the allowances of the push and of the clamp enter the balance, by name."""
    changes: dict[str, Perturbation] = {}
    for a in recording.allowances:
        if a.enters == "force":
            changes[a.name] = pushed_by(beam.beyond, a.basis)
        elif a.enters == "place":
            changes[a.name] = placed_by(beam, a.basis)
        elif a.enters == "load":
            changes[a.name] = Perturbation(a.basis, None, None, np.zeros(a.count))
    return changes


def clamp_blocks(recording: FitData, by_clamp: Array) -> dict[str, Array]:
    """(F, m, 3, n) of the allowances that turn the clamp or move the tags, by name; `by_clamp` (F, m, 3, 1) per rad."""
    out = {a.name: by_clamp * a.basis[:, None, None, :] for a in recording.allowances if a.enters == "clamp"}
    return out | {a.name: a.basis for a in recording.allowances if a.enters == "poses"}


def bending(recording: FitData, layout: Layout, x: Array, solved: Equilibrium) -> Array:
    """(F, Q) rad of the curvature over that at rest of a beam that has not relaxed."""
    return np.asarray(solved.q - recording.rest_on_nodes @ rest_curvature(layout, x, recording.number))


def _values(recording: FitData, layout: Layout, x: Array, allowance: Allowance) -> Array:
    return layout.get(x, allowance.name, -1 if allowance.shared else recording.number)
