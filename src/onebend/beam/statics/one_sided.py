"""Loads that all push to one side of the rest shape: there is one equilibrium on that side, found without continuation.

With `gamma = alpha - alpha_rest`, N the force beyond s, phi in (0, pi) its angle with the tangent at rest, counted to
the side to which it pushes, and eps = (1/EA - 1/kGA) N (`nodal_forces.py`), the balance of dead forces is

    -(k gamma')' = f(s, gamma) = L N sin(phi - gamma) (1 + eps cos(phi - gamma)),   gamma(0) = gamma'(1) = 0.

Where phi is in (0, pi) all along the beam, `0 < gamma <= max phi` on the whole branch that grows from rest (maximum
principle), at every share of the load. Where also f / gamma falls with gamma in that range, there is one solution in
it (Brezis and Oswald 1986) and its second variation is positive: the branch neither turns back nor splits, and the
solution at the full load is the branch's. f / gamma falls for gamma up to phi, as long as |eps| is below 1/5; beyond,
up to max phi = phi + d, where `(phi + d) (cos d - |eps|) > sin d (1 + |eps|)`.

Newton's method begins at the solution of a linear balance: with `sin(phi - gamma)` replaced by the line
`(phi - gamma) sin(phi / 2) / (phi / 2)`.
"""

from __future__ import annotations

import numpy as np

from onebend.beam.grid import apply, transposed
from onebend.beam.statics.equilibrium import is_stable, second_variation
from onebend.beam.statics.newton import correct, solve_batch
from onebend.beam.statics.nodal_forces import node_angles
from onebend.beam.statics.problem import Problem
from onebend.records import Array, BoolArray, IntArray

_AXIAL = 1e-9  # share of a force: one that pushes less to a side is along the beam
_MOST_STRAIN = 0.2  # of |eps|
_OUTSIDE = 1e-9  # rad, by which an angle may leave the range
_TRUST = 1.0  # rad, from the start to the equilibrium


def on_one_side(problem: Problem) -> tuple[IntArray, Array, Array]:
    """Frames (n,) whose loads all push to one side, phi (n, Q) rad with the sign of that side, and L w N (n, Q) N m."""
    pull = np.zeros((0, problem.to_nodes.shape[-2]))
    if problem.follower.shape[1] or problem.size == 0:
        return np.zeros(0, dtype=np.int64), pull, pull
    rest, (x, y) = node_angles(problem, problem.q0), problem.dead_pull
    cos, sin = np.cos(rest), np.sin(rest)
    along, across, pull = x * cos + y * sin, y * cos - x * sin, np.sqrt(x**2 + y**2)
    side = np.sign(np.sum(across, axis=-1, keepdims=True))
    acts = pull > 0.0
    chosen = np.all((side * across > _AXIAL * pull) | ~acts, axis=-1) & np.any(acts, axis=-1)
    chosen &= ~np.any(problem.moment, axis=-1)
    strain = np.zeros(1) if problem.strain_lever is None else np.abs(problem.strain_lever) * pull
    chosen &= np.all(strain <= _MOST_STRAIN, axis=-1)
    phi = np.arctan2(side * across, along)
    beyond = np.max(np.where(acts, phi, 0.0), axis=-1, keepdims=True) - phi
    falls = (phi + beyond) * (np.cos(beyond) - strain) > np.sin(beyond) * (1.0 + strain)
    chosen &= np.all((falls & (beyond < 0.5 * np.pi)) | ~acts, axis=-1)
    return np.flatnonzero(chosen), (side * phi)[chosen], pull[chosen]


def at_once(problem: Problem, tolerance: float, corrections: int) -> tuple[IntArray, Array, int]:
    """Frames (n,) on one side that were reached, their equilibria (n, Q), and the number of iterations."""
    frames, phi, pull = on_one_side(problem)
    if frames.size == 0:
        return frames, np.zeros((0, problem.to_nodes.shape[-1])), 0
    part = problem if frames.size == problem.size else problem.take(frames)
    secant, full = pull * np.sinc(phi / (2.0 * np.pi)), np.ones(frames.size)
    lever = apply(transposed(part.to_nodes), secant * phi)
    start = part.q0 + solve_batch(second_variation(part, secant, part.stiff), lever)
    q, near, count = correct(
        part, start, full, trust=_TRUST * full, remaining=tolerance * full, max_iterations=corrections
    )
    near &= _within(part, q, phi, pull) & is_stable(part, q)
    return frames[near], q[near], count + 1


def _within(problem: Problem, q: Array, phi: Array, pull: Array) -> BoolArray:
    """(n,) whether the beam is bent to the side of its loads, and no further than they point."""
    turned = np.sign(np.sum(phi * pull, axis=-1, keepdims=True)) * apply(problem.to_nodes, q - problem.q0)
    farthest = np.max(np.abs(phi) * (pull > 0.0), axis=-1)
    return np.asarray((np.min(turned, axis=-1) > -_OUTSIDE) & (np.max(turned, axis=-1) < farthest + _OUTSIDE))
