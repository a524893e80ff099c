"""What one push would tell about k(s): Fisher information, through the exact equilibrium and its exact derivatives.

Tags see the beam while the force grows evenly from nothing. With J the derivatives of the tags' poses and A those with
each frame's force, the poses' covariance is `D + A E A'`: D the tags' noise, E the force's doubt over the frames, as
the log's rests leave it. So the parameters' information is `J' (D + A E A')^-1 J`. What belongs to this push alone (the
clamp, the origin, the camera's scale, a new tag's place) is taken out by a Schur complement with its prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline

from onebend.beam.continuation import follow
from onebend.beam.loads import Loads, push, weight
from onebend.beam.model import Beam
from onebend.beam.modes import Modes
from onebend.beam.sensitivity import of_clamp_angle, of_force, of_rest_curvature, of_stiffness, respond
from onebend.beam.statics import Equilibrium, Resolution, pose
from onebend.beam.stiffness import LogSpline
from onebend.errors import LearningError, MechanicsError
from onebend.learning.workbench import Bench, Push
from onebend.records import Array, IntArray

STEPS = 24  # frames that stand for all of a push
RESOLUTION = Resolution(order=12, widest=0.5)
_REST_SHARE = 0.3  # of the coloured doubt: how well the log in a rest shows the error there
_REST_MODES = Modes(3)


@dataclass(frozen=True)
class Seen:
    """Derivatives of tags' poses along one push: F frames, the last being the beam at rest; M places of tags."""

    tags: Array  # (M,)
    shape: Array  # (F, M, 3, C) with C coefficients, then 3 states of the rest shape, then the clamp's angle
    force: Array  # (F, M, 3, 2) per N, with each frame's force; zero at rest
    pose: Array  # (F, M, 3) m, m, rad


def loads_of(bench: Bench, at_s: float, forces: Array) -> Loads:
    """Forces (F, 2) N at one place, under the bench's gravity."""
    acting = push(forces, at_s)
    return acting + weight(np.asarray(bench.gravity)) if any(bench.gravity) else acting


def solve_push(beam: Beam, bench: Bench, candidate: Push) -> Equilibrium:
    """The push in `STEPS` steps, each in the middle of its share of the push, and the beam at rest.

    Raises:
        MechanicsError: the beam snaps through or buckles on the way.
    """
    steps = (np.arange(STEPS) + 0.5) / STEPS
    unit = np.array([np.cos(candidate.direction), np.sin(candidate.direction)])
    forces = np.vstack([candidate.largest * steps[:, None] * unit, np.zeros(2)])
    solved = follow(pose(beam, loads_of(bench, candidate.at_s, forces), RESOLUTION))
    if not np.all(solved.stable & np.isnan(solved.buckled_at)):
        raise MechanicsError(
            f"pushed at s = {candidate.at_s:.2f} to {candidate.largest:.3g} N the beam buckles or snaps through; "
            "a smaller force or another direction is needed"
        )
    return solved


def see(solved: Equilibrium, at_s: float, on_nodes: Array, tags: Array) -> Seen:
    """Derivatives of the tags' poses with the coefficients of functions of log k, given at the nodes (Q, C)."""
    change = (
        of_stiffness(solved, solved.problem.k[..., None] * on_nodes)
        + of_rest_curvature(solved.problem, _REST_MODES.curvature(solved.problem.grid.nodes))
        + of_clamp_angle(solved.problem)
        + of_force(solved.problem, np.asarray(at_s))
    )
    response = respond(solved, change)
    moved = np.concatenate([response.xy(tags), response.angle(tags)[:, :, None, :]], axis=2)
    force = moved[..., -2:].copy()
    force[-1] = 0.0  # at rest nothing pushes
    there = np.concatenate([solved.xy(tags), solved.angle(tags)[..., None]], axis=-1)
    return Seen(tags, moved[..., :-2], force, there)


def joint_information(seen: Seen, bench: Bench, candidate: Push, chosen: IntArray) -> Array:
    """(C + N, C + N) of coefficients and the bench's shared nuisances; `chosen` rows of `seen.tags` are watched.

    The first of them are the bench's own tags, in order; any further ones are put on for this push.
    """
    jacobian, own_sd = _columns(seen, bench, chosen)
    frames, rows, columns = len(jacobian), 3 * len(chosen), jacobian.shape[-1]
    extra = len(chosen) - len(bench.tags)
    sd = np.vstack([bench.tag_sd, np.repeat(bench.tag_sd[-1:], extra, axis=0)]).ravel()
    counts = np.append(np.full(frames - 1, bench.frames / (frames - 1)), 1.0)
    root = np.sqrt(counts)[:, None] / sd  # (F, R)
    j = root[..., None] * jacobian.reshape(frames, rows, columns)
    a = root[:-1, :, None] * seen.force[:-1, chosen].reshape(frames - 1, rows, 2)
    flat = j.reshape(-1, columns)
    aj = (np.swapaxes(a, 1, 2) @ j[:-1]).reshape(-1, columns)  # (2 (F - 1), columns)
    information = flat.T @ flat - aj.T @ _doubt_left(a, force_covariance(bench, candidate, frames - 1)) @ aj
    return eliminate(information, len(own_sd), 1.0 / own_sd**2)


def information(beam: Beam, bench: Bench, candidate: Push) -> Array:
    """(p, p) Fisher information of one push on the coefficients of log k, every nuisance marginalised.

    Taken by itself, as on a bench without earlier pushes: tags and rest shape are known by their tolerances alone.

    Raises:
        LearningError: the beam's stiffness is no log-spline.
        MechanicsError: the push has no stable equilibrium.
    """
    stiffness = beam.stiffness
    if not isinstance(stiffness, LogSpline):
        raise LearningError("information is on the coefficients of a log-spline; give the beam such a stiffness")
    solved = solve_push(beam, bench, candidate)
    knots = np.asarray(stiffness.knots)
    on_nodes = BSpline.design_matrix(solved.problem.grid.nodes, knots, stiffness.degree).toarray()
    return _of_coefficients(solved, bench, candidate, on_nodes)


def information_along(beam: Beam, bench: Bench, candidate: Push) -> tuple[Array, Array]:
    """Places s (Q,) along the beam and the Fisher information (Q,) about log k there, per unit of s squared.

    A bump of log k of height h over a short stretch w at s changes the data's log likelihood by h^2 w^2 / 2 times this.

    Raises:
        MechanicsError: the push has no stable equilibrium.
    """
    solved = solve_push(beam, bench, candidate)
    weights = solved.problem.weights
    told = _of_coefficients(solved, bench, candidate, np.diag(1.0 / weights))
    return solved.problem.grid.nodes, np.diag(told)


def force_covariance(bench: Bench, candidate: Push, steps: int) -> Array:
    """(2 steps, 2 steps) N^2: the force's doubt in the steps of a push, x and y in turn, after the rests' say.

    A constant level, a part that wanders within its memory and a random walk; where the log runs before and after the
    push it shows its own error. The clock's doubt acts as a force along the push.
    """
    doubt = bench.force
    time = bench.seconds * (np.arange(steps) + 0.5) / steps
    spacing = 0.25 * doubt.memory
    before = -np.arange(spacing, bench.rest_before, spacing)[: _most_rests(bench)]
    after = bench.seconds + np.arange(spacing, bench.rest_after, spacing)[: _most_rests(bench)]
    rests = np.concatenate([before, after])
    every = np.concatenate([time, rests])
    lag = (every[:, None] - every) / doubt.memory
    since = every - every.min()
    full = doubt.coloured**2 * np.exp(-0.5 * lag**2) + doubt.walk**2 * np.minimum(since[:, None], since)
    full += (doubt.level * candidate.largest) ** 2
    inside, across = full[:steps, :steps], full[:steps, steps:]
    seen = full[steps:, steps:] + (_REST_SHARE * doubt.coloured) ** 2 * np.eye(len(rests))
    if len(rests) and doubt.coloured > 0.0:
        inside = inside - across @ np.linalg.solve(seen, across.T)
    inside = inside + np.eye(steps) * doubt.frame**2 * steps / bench.frames
    unit = np.array([np.cos(candidate.direction), np.sin(candidate.direction)])
    rate = np.tile(candidate.largest / bench.seconds * unit, steps)
    return np.asarray(np.kron(inside, np.eye(2)) + bench.clock_sd**2 * np.outer(rate, rate))


def eliminate(information: Array, last: int, prior: Array | float = 0.0) -> Array:
    """Information on all but the `last` parameters, these being unknown but for their prior precisions (last,)."""
    if last == 0:
        return information
    kept = len(information) - last
    across = information[:kept, kept:]
    out = information[:kept, :kept] - across @ np.linalg.solve(
        information[kept:, kept:] + np.diag(np.broadcast_to(prior, last)), across.T
    )
    return np.asarray(0.5 * (out + out.T))


def alone(bench: Bench) -> Array:
    """(N,) prior precisions of the shared nuisances before any push."""
    sd = {"curvature": bench.curvature_sd, "turn": bench.turn_sd}
    size = {"curvature": 3}
    values = [np.full(size.get(n, len(bench.tags)), sd.get(n, bench.placement_sd)) for n in bench.shared]
    return np.concatenate([np.zeros(0), *values]) ** -2.0


def with_better_sensor(bench: Bench, times: float) -> Bench:
    """The bench with a force sensor whose every error is `times` smaller."""
    return replace(bench, force=bench.force.times(1.0 / times), gain_sd=bench.gain_sd / times)


def _of_coefficients(solved: Equilibrium, bench: Bench, candidate: Push, on_nodes: Array) -> Array:
    tags = np.asarray(bench.tags)
    joint = joint_information(
        see(solved, candidate.at_s, on_nodes, tags), bench, candidate, np.arange(len(tags), dtype=np.int64)
    )
    return eliminate(joint, bench.shared_size, alone(bench))


def _columns(seen: Seen, bench: Bench, chosen: IntArray) -> tuple[Array, Array]:
    """Derivatives (F, R / 3, 3, C + N + O) and the prior sd (O,) of the O nuisances of this push alone."""
    shape, there = seen.shape[:, chosen], seen.pose[:, chosen]
    own, tags = len(bench.tags), len(chosen)
    by_tag = {"along": _sideways(there, 0.0), "across": _sideways(there, 0.5 * np.pi), "turn": _turns(there)}
    parts = [shape[..., :-4]]
    for name in bench.shared:
        parts.append(shape[..., -4:-1] if name == "curvature" else by_tag[name][..., :own])
    origin = np.zeros((*there.shape, 2))
    origin[..., 0, 0] = origin[..., 1, 1] = 1.0
    scale = there[..., None] * np.array([1.0, 1.0, 0.0])[:, None]
    wanted = [(by_tag[name][..., own:], bench.placement_sd) for name in ("along", "across")]
    wanted += [(by_tag["turn"][..., own:], bench.turn_sd), (shape[..., -1:], bench.clamp_sd)]
    wanted += [(origin, bench.origin_sd), (scale, bench.scale_sd)]
    free = [(part, np.full(part.shape[-1], sd)) for part, sd in wanted if sd > 0.0]
    sds = np.concatenate([np.zeros(0), *(sd for _, sd in free)])
    assert by_tag["turn"].shape[-1] == tags
    return np.concatenate([*parts, *(part for part, _ in free)], axis=-1), sds


def _sideways(there: Array, turn: float) -> Array:
    """(F, M, 3, M): each tag shifted in its own frame, along the beam (`turn` 0) or to its left (pi / 2)."""
    m = there.shape[1]
    out = np.zeros((*there.shape, m))
    each = np.arange(m)
    out[:, each, 0, each] = np.cos(there[..., 2] + turn)
    out[:, each, 1, each] = np.sin(there[..., 2] + turn)
    return out


def _turns(there: Array) -> Array:
    """(F, M, 3, M): each tag turned on the beam."""
    m = there.shape[1]
    out = np.zeros((*there.shape, m))
    out[:, np.arange(m), 2, np.arange(m)] = 1.0
    return out


def _doubt_left(a: Array, covariance: Array) -> Array:
    """`(E^-1 + G)^-1` with G the frames' `A' A`, block-diagonal; no inverse of E."""
    steps = len(a)
    gram = np.zeros((steps, 2, steps, 2))
    gram[np.arange(steps), :, np.arange(steps), :] = np.swapaxes(a, 1, 2) @ a
    left = np.linalg.solve(np.eye(2 * steps) + covariance @ gram.reshape(2 * steps, -1), covariance)
    return np.asarray(0.5 * (left + left.T))


def _most_rests(bench: Bench) -> int:
    """Instants of a rest that count: more of them than the memory of the error reaches tell nothing new."""
    return max(40, int(4.0 * bench.seconds / bench.force.memory))
