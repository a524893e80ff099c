"""Internal force at the nodes, the strains it causes, and what the balance of moments takes of it.

Planar rod of Simo and Reissner. With the directors d1 = (cos alpha, sin alpha) along the section's normal and
d2 = (-sin alpha, cos alpha), the internal force n(s) (the sum of all forces beyond s), N = n . d1 and Q = n . d2:

    r' = L [(1 + N/EA) d1 + (Q/kGA) d2]

Stretch and shear follow from n, so the curvature stays the only unknown. The work of the loads per s,
`W(alpha) = L (N + N^2 / 2 EA + Q^2 / 2 kGA)`, has with delta = 1/EA - 1/kGA the derivatives

    dW/dalpha = L Q (1 + delta N) = -M' - m',    -d2W/dalpha2 = L (N + delta (N^2 - Q^2)).

1/EA = 1/kGA = 0 is the inextensible, unshearable beam, which takes no more work than without the terms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from onebend.beam.grid import apply, paired
from onebend.beam.statics.problem import Problem
from onebend.records import Array


@dataclass(frozen=True)
class NodalForces:
    """Directions at the nodes, and derivatives of the loads' work `w W` with the angle there."""

    cos: Array  # (T, Q)
    sin: Array  # (T, Q)
    along: Array  # (T, Q) N m: minus the second derivative; L w N where nothing stretches or shears
    across: Array  # (T, Q) N m: the first derivative; L w Q where nothing stretches or shears
    turned: tuple[Array, Array] | None  # (T, Q) each: `d(r'/L)/dalpha = turned[0] d1 + turned[1] d2`; None: it is d2

    @cached_property
    def lever(self) -> Array:
        """(T, Q, 2): d(r'/L)/dalpha at fixed n, `(1 + delta N) d2 + delta Q d1`.

        It is also the derivative of `dW/dalpha` with n, over L: a force and the place it moves are reciprocal (Betti).
        """
        if self.turned is None:
            return paired(-self.sin, self.cos)
        first, second = self.turned
        return paired(first * self.cos - second * self.sin, first * self.sin + second * self.cos)


def node_angles(problem: Problem, q: Array) -> Array:
    """(T, Q) `alpha = alpha0 + B q` (3)."""
    return problem.alpha0 + apply(problem.to_nodes, q)


def internal_force(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> Array:
    """(T, Q, 2) N: the sum of all forces beyond each node, followers turned to where they point now."""
    factor = np.asarray(load_factor, dtype=float)[..., None, None]
    if problem.follower.shape[1] == 0:
        return np.asarray(factor * problem.dead_force)
    turned, _ = turned_followers(problem, q)
    return np.asarray(factor * (problem.dead_force + np.einsum("tcd,tcq->tqd", turned, problem.follower_beyond)))


def turned_followers(problem: Problem, q: Array) -> tuple[Array, Array]:
    """(T, c, 2) N the followers in the beam's frame, and their derivative with the angle there."""
    angle = problem.alpha0 + np.einsum("tcq,tq->tc", problem.follower_rows, q)
    cos, sin = np.cos(angle), np.sin(angle)
    f = problem.follower
    turned = np.stack([cos * f[..., 0] - sin * f[..., 1], sin * f[..., 0] + cos * f[..., 1]], axis=-1)
    return turned, np.stack([-turned[..., 1], turned[..., 0]], axis=-1)


def nodal_forces(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> NodalForces:
    """Of shapes (T, Q), all loads times `load_factor` (T,)."""
    alpha = node_angles(problem, q)
    cos, sin = np.cos(alpha), np.sin(alpha)
    factor = np.asarray(load_factor, dtype=float)[..., None]
    x, y = problem.dead_pull
    if problem.follower.shape[1]:
        turned, _ = turned_followers(problem, q)
        lw = problem.length * problem.weights
        x, y = (d + lw * np.einsum("tc,tcq->tq", turned[..., i], problem.follower_beyond) for i, d in enumerate((x, y)))
    along, across = factor * (x * cos + y * sin), factor * (y * cos - x * sin)
    delta = problem.strain_lever
    if delta is None:
        return NodalForces(cos, sin, along, across, None)
    tilted, stretched = delta * across, 1.0 + delta * along
    return NodalForces(cos, sin, along * stretched - tilted * across, across * stretched, (tilted, stretched))


def normal_and_shear(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> tuple[Array, Array]:
    """(T, Q) N each: N and Q, the internal force along d1 and d2."""
    alpha, n = node_angles(problem, q), internal_force(problem, q, load_factor)
    cos, sin = np.cos(alpha), np.sin(alpha)
    return n[..., 0] * cos + n[..., 1] * sin, n[..., 1] * cos - n[..., 0] * sin


def strains(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> tuple[Array, Array]:
    """(T, Q) each: stretch N/EA and shear Q/kGA at the nodes."""
    if problem.compliance is None:
        nothing = np.zeros((problem.size, problem.to_nodes.shape[-1]))
        return nothing, nothing
    normal, transverse = normal_and_shear(problem, q, load_factor)
    stretch, shear = problem.compliance
    return stretch * normal, shear * transverse


def centreline_slope(problem: Problem, q: Array, load_factor: Array | float = 1.0) -> Array:
    """(T, Q, 2): r'/L at the nodes, `(1 + N/EA) d1 + (Q/kGA) d2`."""
    alpha = node_angles(problem, q)
    cos, sin = np.cos(alpha), np.sin(alpha)
    if problem.compliance is None:
        return np.stack([cos, sin], axis=-1)
    stretch, shear = strains(problem, q, load_factor)
    along = 1.0 + stretch
    return np.stack([along * cos - shear * sin, along * sin + shear * cos], axis=-1)


def strain_by_force(problem: Problem, forces: NodalForces) -> Array:
    """(T, Q, 2, 2) 1/N: d(r'/L)/dn at fixed angle, `d1 d1^T / EA + d2 d2^T / kGA`; of a beam that is compliant."""
    assert problem.compliance is not None
    stretch, shear = problem.compliance
    cos, sin = forces.cos, forces.sin
    out = np.empty((*cos.shape, 2, 2))
    out[..., 0, 0] = stretch * cos**2 + shear * sin**2
    out[..., 1, 1] = stretch * sin**2 + shear * cos**2
    out[..., 0, 1] = out[..., 1, 0] = (stretch - shear) * cos * sin
    return out
