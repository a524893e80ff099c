"""Derivatives of a beam whose material remembers: what a parameter changes in one frame goes on in all later ones.

A change of the bending shifts the curvature at rest of all later frames, which changes their bending, and so on. It is
followed through some frames only, for the memory is smooth in time; what it shifts in the others lies between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.grid import solve_each
from onebend.beam.statics.equilibrium import Equilibrium, tangent
from onebend.beam.statics.perturbation import Perturbations, minus_gradient
from onebend.learning.allowances.relaxation import memory, reached_part, remembered
from onebend.learning.model.allowed import bending, relaxation_time, relaxation_values
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.parameters import Layout
from onebend.learning.model.tag_jacobian import ResponseColumns
from onebend.records import Array, IntArray

_KEY_FRAMES = 24  # at most, through which the memory is followed
_PASSES = 2  # each leaves about the relaxing share of what the one before left


@dataclass(frozen=True)
class Remembered:
    """What the memory adds to the derivatives of poses at S places of the beam, in F frames.

    A part of the push that is `weights @ values` in each frame, as the force log's error is, adds `by_push` with its
    value in the frame itself and `by_pushes` with its values in the key frames.
    """

    by_parameters: Array  # (F, S, 3, P) m, m, rad per unit
    by_push: Array  # (F, S, 3, 2) per N
    by_pushes: Array  # (F, S, 3, 2 n) per N, x and y in turn
    keys: IntArray  # (n,)


@dataclass(frozen=True)
class _KeyFrames:
    """n of the F frames."""

    keys: IntArray  # (n,)
    between: Array  # (T, n) weights by which values of the key frames stand for all T that remember
    remembering: Array  # (n, n) see `memory`
    bending: Array  # (n, Q) rad
    weights: Array  # (Q,) or (n, Q)


def remembered_poses(
    recording: FitData, layout: Layout, x: Array, solved: Equilibrium, columns: ResponseColumns, by_node: Array
) -> Remembered:
    """With the P parameters of `columns` and with the push; `by_node` (F, S, 3, Q) of the poses with the curvature at
    rest at each node, without memory."""
    values, time = relaxation_values(recording, layout, x), relaxation_time(recording)
    assert values is not None
    keys = np.unique(np.linspace(0, len(time) - 1, min(len(time), _KEY_FRAMES)).round().astype(np.int64))
    some, bent = solved.take(keys), bending(recording, layout, x, solved)[keys]
    between = np.stack([np.interp(time, time[keys], one) for one in np.eye(len(keys))], axis=1)
    frames = _KeyFrames(keys, between, memory(values, time[keys]), bent, some.problem.weights)
    first, by_shift = _responses(some, columns.changes.take(keys))
    change = first.copy()
    change[..., columns.slices["curvature"]] -= recording.rest_on_nodes  # the rest that bending counts from
    shift = np.tensordot(between, _shift(frames, change, by_shift), 1)
    by_parameters = _at_places(by_node[: len(time)], shift)
    by_push, by_pushes = _by_push(frames, first[..., columns.slices["push"]], by_node[keys])
    rests = len(by_node) - len(time)
    return Remembered(
        _with_rests(by_parameters, rests), _with_rests(by_push, rests), _with_rests(by_pushes, rests), keys
    )


def _responses(some: Equilibrium, changes: Perturbations) -> tuple[Array, Array]:
    """(n, Q, P) of the curvature to changes, and (n, Q, Q) to the curvature at rest at each node, without memory."""
    problem, nodes = some.problem, some.q.shape[1]
    inverse = solve_each(tangent(problem, some.q), np.broadcast_to(np.eye(nodes), (len(some.q), nodes, nodes)))
    return inverse @ minus_gradient(some, changes), inverse * problem.stiff[..., None, :]


def _shift(frames: _KeyFrames, change: Array, by_shift: Array) -> Array:
    """(n, Q, P) of the curvature at rest, from changes (n, Q, P) of the bending without memory."""
    moved = change
    for _ in range(_PASSES):
        moved = change + by_shift @ remembered(frames.remembering, frames.bending, frames.weights, moved)
    return remembered(frames.remembering, frames.bending, frames.weights, moved)


def _by_push(frames: _KeyFrames, by_push: Array, by_node: Array) -> tuple[Array, Array]:
    """(T, S, 3, 2) with the push of the frame itself, and (T, S, 3, 2 n) with that of the key frames.

    `by_push` (n, Q, 2) of the curvature without memory, `by_node` (n, S, 3, Q) of the poses with the curvature at rest.
    To first order in what relaxes; that the part c of the curvature that is reached changes too is left out.
    """
    every = np.arange(len(by_push))
    reached = reached_part(frames.remembering @ frames.bending, frames.bending, frames.weights)
    pairs = np.tensordot(by_node, by_push, ((3,), (1,)))  # (n, S, 3, n, 2): frame, and where it was pushed
    at_once = np.tensordot(frames.between, pairs[every, :, :, every], 1)
    pairs *= frames.remembering[:, None, None, :, None]
    later = np.tensordot(frames.between, pairs.reshape(*pairs.shape[:3], -1), 1)
    return -reached / (1.0 - reached) * at_once, later / (1.0 - reached)


def _at_places(by_node: Array, shift: Array) -> Array:
    """(F, S, 3, P) of poses, from `by_node` (F, S, 3, Q) and shifts (F, Q, P) of the curvature at rest."""
    rows = by_node.reshape(len(by_node), -1, by_node.shape[-1])
    return np.asarray((rows @ shift).reshape(*by_node.shape[:3], -1))


def _with_rests(part: Array, rests: int) -> Array:
    """(F, ...) of (T, ...): nothing in the frames at rest, which come last."""
    return np.concatenate([part, np.zeros((rests, *part.shape[1:]))])
