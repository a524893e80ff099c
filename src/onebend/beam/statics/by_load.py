"""How the branch goes on as all loads grow: derivatives of the equilibrium with the load factor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from onebend.beam.grid import apply, transposed
from onebend.beam.statics.equilibrium import gradient
from onebend.beam.statics.nodal_forces import nodal_forces
from onebend.beam.statics.problem import Problem
from onebend.records import Array


def by_load(problem: Problem, q: Array, factor: Array) -> Array:
    """(T, Q) minus the derivative of the gradient with the load factor, in which it is linear, or quadratic where
    the beam stretches or shears: a difference over 1 is then exact."""
    if problem.compliance is None:
        across = nodal_forces(problem, q).across
        return problem.couple + apply(transposed(problem.to_nodes), across)
    return gradient(problem, q, factor - 0.5) - gradient(problem, q, factor + 0.5)


def terms_at_rest(problem: Problem, q: Array, slope: Array) -> tuple[Array, Array]:
    """Terms of second and third order in the load, from the balance differentiated at no load (dead forces only)."""
    if problem.follower.shape[1]:
        return np.zeros_like(q), np.zeros_like(q)
    plain = problem if problem.compliance is None else replace(problem, section=None, stretch=None, shear=None)
    forces = nodal_forces(plain, q)
    along, across, delta = forces.along, forces.across, problem.strain_lever
    back, stiff = transposed(problem.to_nodes), problem.stiff
    turn = apply(problem.to_nodes, slope)
    second = -2.0 * apply(back, along * turn) / stiff
    if delta is not None:
        second = second + 2.0 * apply(back, delta * along * across) / stiff
    third = -3.0 * apply(back, along * apply(problem.to_nodes, second) + across * turn**2) / stiff
    if delta is not None:
        third = third + 6.0 * apply(back, delta * (across**2 - along**2) * turn) / stiff
    return second / 2.0, third / 6.0
