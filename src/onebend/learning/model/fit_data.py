"""A recording as the marker-space fit sees it: everything that does not depend on the parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.loads import Loads, push, weight
from onebend.beam.modal import Modes
from onebend.beam.model import Beam
from onebend.beam.profiles.stiffness import Uniform
from onebend.beam.statics.problem import Problem, make_problem
from onebend.errors import LearningError
from onebend.learning.allowances.allowance import Allowance
from onebend.learning.allowances.chosen import AllowanceName, allowances_of
from onebend.learning.allowances.inertia import inertial_force, unknown_mass
from onebend.learning.known_shape import KnownShape
from onebend.learning.model.force_error import ForceError, force_error
from onebend.learning.model.frames import known_loads, mass_profile, push_places, typical
from onebend.learning.model.held_ends import HeldEnds, held_ends, resolution_of
from onebend.learning.model.mass import NEEDS_MASS
from onebend.learning.model.own_weight import POWERS, OwnWeight, gravity_direction, own_weight
from onebend.learning.model.readings import pose_whitening
from onebend.learning.model.spline import Spline
from onebend.learning.pose_equilibria import SeenPoses, seen_poses
from onebend.recording.signals import low_pass
from onebend.records import Array, BoolArray, Observations, covariance_with_camera

REST_MODES = Modes(3)
MASS_MODES = Modes(4)
_SLOW = 0.5  # of the cut-off, which is twice the bandwidth of the tags' motion


@dataclass(frozen=True)
class FitData:
    """One recording as the fit sees it: F frames, the last being the beam at rest where it was seen."""

    observations: Observations
    number: int
    frames: BoolArray  # (T,) which frames of the recording are used
    measured: Array  # (F, m, 3) x, y, angle; NaN where missing
    whiten: Array  # (F, m, 3, 3) or (F, 3 m, 3 m), see `pose_whitening`; zero where missing
    rulers: Array | None  # (F, m) m: where rulers stand; None: points are marks on the beam
    force: Array  # (F, 2) N as logged
    rate: Array  # (F, 2) N/s, derivative of the logged force
    error: ForceError
    error_weights: Array  # (F, K)
    push_s: Array  # (F,)
    problem: Problem  # grid and what does not change
    beyond: Array  # (F, Q) 1 where the push lies beyond the node
    farther: Array  # (F, Q) 1/m: what is added to it where the push lies farther out; see `share_farther`
    weight: Array  # (F, Q, 2) N beyond the node: weight, the mass as written down, and the loads known besides
    ends: HeldEnds | None  # of frames whose end an unknown wrench holds
    poses: SeenPoses | None  # what tells in which equilibrium each is; None: in that which grows from rest
    mass: OwnWeight | None  # what the mass has besides; None where nothing weighs
    on_nodes: Array  # (Q, p) or (F, Q, p): the spline's functions at the nodes
    offset: Array  # (Q,) or (F, Q): what is known of log k there, but for its level
    rest_on_nodes: Array  # (Q, 3) or (F, Q, 3)
    allowances: tuple[Allowance, ...] = ()


def fit_data(
    observations: Observations,
    number: int,
    frames: BoolArray,
    spline: Spline,
    allowances: frozenset[AllowanceName] = frozenset(),
    known: KnownShape | None = None,
) -> FitData:
    """Prepare a recording: everything that does not depend on the parameters; `allowances` by name, `known`: what is
    stated of how k varies."""
    o = observations
    time = o.time[frames]
    error = force_error(o, time)
    measured = np.concatenate([o.xy[frames], o.angle[frames][..., None]], axis=-1)
    rulers = None
    if o.readings.at == "x":
        rulers, measured[..., 0] = measured[..., 0].copy(), np.nan
    all_noise = o.covariance if "camera" in allowances else covariance_with_camera(o)
    covariance, force = all_noise[frames], o.force[frames]
    rate = _rate(o)[frames]
    push_s, gravity, weights = push_places(o)[frames], o.gravity[frames], error.weights
    other = known_loads(o, frames)
    if np.any(np.isfinite(o.rest_xy)):  # the beam at rest is one more frame, of no force and no force error
        rest = np.concatenate([o.rest_xy, o.rest_angle[:, None]], axis=1)
        measured = np.concatenate([measured, rest[None]])
        covariance = np.concatenate([covariance, np.maximum(typical(all_noise), 0.0)[None] * np.eye(3)])
        force, rate = np.vstack([force, np.zeros(2)]), np.vstack([rate, np.zeros(2)])
        push_s, gravity = np.append(push_s, push_s[-1]), np.vstack([gravity, np.zeros(2)])
        weights = np.vstack([weights, np.zeros(weights.shape[1])])
        other = _rested(other)
    weighs = bool(np.any(gravity != 0.0))
    if weighs and not np.isfinite(o.stated.mass):
        raise LearningError(f"{o.source.name}: {NEEDS_MASS}")
    line = mass_profile(o)
    written = line if weighs and o.stated.mass_along not in POWERS else Uniform(0.0)
    known = KnownShape(None, 0.0) if known is None else known
    carrier = Beam(o.length, known.profile, mass_per_length=written, masses=o.stated.masses)
    problem = make_problem(carrier, _loads(np.zeros_like(force), push_s, gravity) + other, resolution_of(o))
    ends = held_ends(o, frames, problem)
    nodes = problem.grid.nodes
    allowed = allowances_of(o, frames, measured, push_s, force, problem.grid, allowances)
    known_mass = bool(allowances) and (np.isfinite(o.stated.mass) or o.stated.masses) and not o.static
    inertia = inertial_force(o, frames, problem, line, len(force), o.stated.masses) if known_mass else np.zeros(1)
    mass = unknown_mass(o, frames, problem, len(force)) if "inertia" in allowances else None
    leaning = gravity_direction(o, problem, gravity, line) if "gravity direction" in allowances else None
    return FitData(
        observations=o,
        number=number,
        frames=frames,
        measured=measured,
        whiten=pose_whitening(o, measured, covariance),
        rulers=rulers,
        force=force,
        rate=rate,
        error=error,
        error_weights=weights,
        push_s=push_s,
        problem=problem,
        beyond=np.asarray(nodes < push_s[:, None], dtype=float),
        farther=share_farther(problem, push_s),
        weight=problem.dead_force + inertia,
        ends=ends,
        poses=seen_poses(o, frames),
        mass=own_weight(o, problem.grid, gravity, MASS_MODES.curvature(nodes), line) if weighs else None,
        on_nodes=spline.basis(nodes),
        offset=known.offset_at(nodes),
        rest_on_nodes=REST_MODES.curvature(nodes),
        allowances=(*allowed, *(one for one in (mass, leaning) if one is not None)),
    )


def share_farther(problem: Problem, push_s: Array) -> Array:
    """(F, Q) 1/m: a dead force that acts d metres farther out along the tangent than `push_s` adds d times this to the
    share of it beyond each node.

    It lengthens the way to the force, `L sum w u`, by d u at the last node before it. So it also holds beyond the tip,
    where there is no beam, and the nodes stay where they are.
    """
    nodes, weights = np.broadcast_arrays(problem.grid.nodes, problem.weights)
    last = np.broadcast_to(nodes < push_s[:, None], (len(push_s), nodes.shape[-1])).sum(axis=1) - 1
    nodes_of = np.arange(nodes.shape[-1]) == last[:, None]
    return np.asarray(nodes_of / (float(problem.length) * weights))


def _rate(o: Observations) -> Array:
    """(T, 2) N/s: slope of the force at the frames, from its slow part: the slope of the log's noise would tell the
    clock that it is right as it is.
    """
    if o.source.clean_force is None:
        return np.gradient(o.force, o.time, axis=0) if len(o.time) > 1 else np.zeros_like(o.force)
    clean = o.source.clean_force
    known = np.all(np.isfinite(clean.force), axis=1)
    time = clean.time[known]
    slow = low_pass(time, clean.force[known], _SLOW * clean.cutoff, longest_gap=np.inf)
    slope = np.gradient(slow, time, axis=0)
    return np.stack([np.interp(o.time, time, slope[:, c]) for c in range(2)], axis=1)


def _rested(loads: Loads) -> Loads:
    """One frame more, in which nothing acts."""
    if loads.size == 1:
        return loads
    more = loads.take(np.append(np.arange(loads.size), loads.size - 1))
    here = (np.arange(more.size) < loads.size).astype(float)
    return replace(more, force=more.force * here[:, None, None], moment=more.moment * here[:, None])


def _loads(force: Array, push_s: Array, gravity: Array) -> Loads:
    loads = push(force, push_s)
    return loads + weight(gravity) if np.any(gravity != 0.0) else loads
