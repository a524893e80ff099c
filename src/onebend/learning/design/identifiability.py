"""What one push would tell about k(s): Fisher information, through the exact equilibrium and its exact derivatives.

Tags see the beam while the force grows evenly from nothing. With J the derivatives of the tags' poses and A those with
each frame's force, the poses' covariance is `D + A E A'`: D the tags' noise, E the force's doubt over the frames, as
the log's rests leave it. So the parameters' information is `J' (D + A E A')^-1 J`. What is this push's alone (clamp,
origin, camera scale, place, the log's axes, a new tag's place) is taken out by a Schur complement with its prior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline

from onebend.beam.grid import apply
from onebend.beam.loads import Loads, push, weight
from onebend.beam.model import Beam
from onebend.beam.profiles.stiffness import LogSpline
from onebend.beam.statics.continuation import follow
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.problem import Resolution, make_problem
from onebend.beam.statics.sensitivity import of_mass
from onebend.blas import one_blas_thread
from onebend.errors import LearningError, MechanicsError
from onebend.learning.design.instruments import ForceDoubt, Instruments, PlannedPush
from onebend.learning.model.fit_data import MASS_MODES, REST_MODES
from onebend.learning.model.tag_jacobian import (
    BentBeam,
    TagMotion,
    TagRide,
    along_and_across,
    balance_changes,
    place_responses,
    push_blocks,
    push_moment,
    tag_blocks,
)
from onebend.records import Array, IntArray

STEPS = 24  # frames that stand for all of a push
RESOLUTION = Resolution(order=12, widest=0.5)
_INSTANTS = 4  # of a step, over which the force's error is averaged
_MOST_RESTS = 80  # instants of a rest that count: what is farther from the push tells nothing new
_REST_SHARE = 0.1  # of the coloured doubt: how well the log in a rest shows the error there


@dataclass(frozen=True)
class TagDerivatives:
    """Derivatives of tags' poses along one push: F frames, the last being the beam at rest; M places of tags."""

    tags: Array  # (M,)
    blocks: dict[str, Array]  # (F, M, 3, n) of what bends the beam, by the names of `balance_changes` and `push_blocks`
    motion: TagMotion  # with what holds the tags

    @property
    def push(self) -> Array:
        """(F, M, 3, 2) per N, with each frame's force; zero at rest."""
        return self.blocks["push"]


def loads_of(bench: Instruments, at_s: float, forces: Array) -> Loads:
    """Forces (F, 2) N at one place, under the bench's gravity."""
    acting = push(forces, at_s)
    return acting + weight(np.asarray(bench.gravity)) if any(bench.gravity) else acting


def solve_push(beam: Beam, bench: Instruments, candidate: PlannedPush) -> Equilibrium:
    """The push in `STEPS` steps, each in the middle of its share of the push, and the beam at rest.

    Raises:
        MechanicsError: the beam snaps through or buckles on the way.
    """
    solved = follow(make_problem(beam, loads_of(bench, candidate.at_s, _forces(candidate)), RESOLUTION))
    if not np.all(solved.stable & np.isnan(solved.buckled_at)):
        raise MechanicsError(
            f"pushed at s = {candidate.at_s:.2f} to {candidate.largest:.3g} N the beam buckles or snaps through; "
            "a smaller force or another direction is needed"
        )
    return solved


def _forces(candidate: PlannedPush) -> Array:
    """(F, 2) N in the steps of a push, and none at rest."""
    steps = (np.arange(STEPS) + 0.5) / STEPS
    unit = np.array([np.cos(candidate.direction), np.sin(candidate.direction)])
    return np.vstack([candidate.largest * steps[:, None] * unit, np.zeros(2)])


def tag_derivatives(
    solved: Equilibrium, bench: Instruments, candidate: PlannedPush, mass: float, on_nodes: Array, tags: Array
) -> TagDerivatives:
    """Derivatives of the tags' poses with the coefficients of functions of log k, given at the nodes (Q, C), and with
    all else. `mass` [kg] is the beam's."""
    problem, nodes = solved.problem, solved.problem.grid.nodes
    per_length = mass / bench.length * MASS_MODES.curvature(nodes)
    pushed, push_s = _forces(candidate), np.asarray(candidate.at_s)
    _, across = along_and_across(pushed, solved.angle(push_s[None])[:, 0])
    beam = BentBeam(
        solved,
        on_nodes,
        REST_MODES.curvature(nodes),
        pushed,
        np.any(pushed != 0.0, axis=1)[:, None] * np.asarray(nodes < push_s, dtype=float),
        np.zeros_like(nodes),
        of_mass(problem, per_length, np.asarray(bench.gravity)[None]),
    )
    changes = balance_changes(beam) | {"place": push_moment(problem, push_s, across)}  # between nodes, too
    blocks = place_responses(solved, changes, tags)
    blocks |= push_blocks(blocks["push"], pushed, np.eye(2), np.zeros_like(pushed))
    pose = np.concatenate([solved.xy(tags), solved.angle(tags)[..., None]], axis=-1)
    bend = apply(problem.grid.value_at(tags), solved.q) / bench.length
    nothing = np.zeros(len(tags))
    motion = TagRide(pose[..., 2], nothing, nothing).motion(pose[..., :2], bend)
    return TagDerivatives(tags, blocks, motion)


def mass_of(beam: Beam) -> float:
    """kg."""
    x, w = np.polynomial.legendre.leggauss(32)
    return float(0.5 * beam.length * w @ np.asarray(beam.mass_per_length(0.5 * (x + 1.0))))


def joint_information(seen: TagDerivatives, bench: Instruments, candidate: PlannedPush, chosen: IntArray) -> Array:
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
    a = root[:-1, :, None] * seen.push[:-1, chosen].reshape(frames - 1, rows, 2)
    flat = j.reshape(-1, columns)
    aj = (np.swapaxes(a, 1, 2) @ j[:-1]).reshape(-1, columns)  # (2 (F - 1), columns)
    information = flat.T @ flat - aj.T @ _doubt_left(a, force_covariance(bench, candidate)) @ aj
    return eliminate(information, len(own_sd), 1.0 / own_sd**2)


@one_blas_thread
def information(beam: Beam, bench: Instruments, candidate: PlannedPush) -> Array:
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
    return _of_coefficients(solved, beam, bench, candidate, on_nodes)


@one_blas_thread
def information_along(beam: Beam, bench: Instruments, candidate: PlannedPush) -> tuple[Array, Array]:
    """Places s (Q,) along the beam and the Fisher information (Q,) about log k there, per unit of s squared.

    A bump of log k of height h over a short stretch w at s changes the data's log likelihood by h^2 w^2 / 2 times this.

    Raises:
        MechanicsError: the push has no stable equilibrium.
    """
    solved = solve_push(beam, bench, candidate)
    weights = solved.problem.weights
    told = _of_coefficients(solved, beam, bench, candidate, np.diag(1.0 / weights))
    return solved.problem.grid.nodes, np.diag(told)


def force_covariance(bench: Instruments, candidate: PlannedPush) -> Array:
    """(2 STEPS, 2 STEPS) N^2: the force's doubt in the steps of a push, x and y in turn, after the rests' say.

    The clock's doubt acts as a force along the push.
    """
    one = _doubt_of_axis(bench.force, bench.seconds, bench.rest_before, bench.rest_after)
    one = one + np.eye(STEPS) * bench.force.frame**2 * STEPS / bench.frames
    unit = np.array([np.cos(candidate.direction), np.sin(candidate.direction)])
    rate = np.tile(candidate.largest / bench.seconds * unit, STEPS)
    return np.asarray(np.kron(one, np.eye(2)) + bench.clock_sd**2 * np.outer(rate, rate))


@lru_cache(maxsize=8)
def _doubt_of_axis(doubt: ForceDoubt, seconds: float, before: float, after: float) -> Array:
    """(STEPS, STEPS) N^2 of the mean error in each step of a push.

    A constant level, the coloured part and a random walk; where the log runs before and after the push it shows its
    own error, but for what comes with the load: a constant while that grows.
    """
    apart = seconds / (STEPS * _INSTANTS)
    inside = apart * (np.arange(STEPS * _INSTANTS) + 0.5)
    earlier, later = (apart * np.arange(1, rest / apart)[:_MOST_RESTS] for rest in (before, after))
    rests = np.concatenate([-earlier, seconds + later])
    every = np.concatenate([inside, rests])
    since = every - every.min()
    full = doubt.covariance(every[:, None] - every) + doubt.walk**2 * np.minimum(since[:, None], since)
    full += doubt.level**2
    count = len(inside)
    left = full[:count, :count]
    if len(rests):
        seen = full[count:, count:] + _REST_SHARE**2 * doubt.covariance(np.zeros(1)) * np.eye(len(rests))
        left = left - full[:count, count:] @ np.linalg.solve(seen, full[count:, :count])
    left = left + doubt.load**2
    mean = np.kron(np.eye(STEPS), np.full((1, _INSTANTS), 1.0 / _INSTANTS))
    return np.asarray(mean @ left @ mean.T)


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


def alone(bench: Instruments) -> Array:
    """(N,) prior precisions of the shared nuisances before any push."""
    m = len(bench.tags)
    sd = {
        "curvature": [bench.curvature_sd] * 3,
        "mass": [bench.mass_sd] + [bench.mass_spread_sd] * 3,
        "along": [bench.placement_sd] * m,
        "across": [bench.placement_sd] * m,
        "turn": [bench.turn_sd] * m,
    }
    return np.array([one for name in bench.shared for one in sd[name]]) ** -2.0


def with_better_sensor(bench: Instruments, times: float) -> Instruments:
    """The bench with a force sensor whose every error is `times` smaller."""
    return replace(bench, force=bench.force.times(1.0 / times), gain_sd=bench.gain_sd / times)


def _of_coefficients(
    solved: Equilibrium, beam: Beam, bench: Instruments, candidate: PlannedPush, on_nodes: Array
) -> Array:
    tags = np.asarray(bench.tags)
    seen = tag_derivatives(solved, bench, candidate, mass_of(beam), on_nodes, tags)
    joint = joint_information(seen, bench, candidate, np.arange(len(tags), dtype=np.int64))
    return eliminate(joint, bench.shared_size, alone(bench))


def _columns(seen: TagDerivatives, bench: Instruments, chosen: IntArray) -> tuple[Array, Array]:
    """Derivatives (F, R / 3, 3, C + N + O) and the prior sd (O,) of the O nuisances of this push alone."""
    own, motion = len(bench.tags), seen.motion
    watched = TagMotion(*(part[:, chosen] for part in (motion.along, motion.bend, motion.across, motion.xy)))
    blocks = {name: block[:, chosen] for name, block in seen.blocks.items()} | tag_blocks(watched)
    by_tag = ("along", "across", "turn")
    shared = [blocks[name][..., :own] if name in by_tag else blocks[name] for name in bench.shared]
    wanted = [(blocks[name][..., own:], bench.placement_sd) for name in ("along", "across")]
    wanted += [(blocks["turn"][..., own:], bench.turn_sd), (blocks["clamp"], bench.clamp_sd)]
    wanted += [(blocks["origin"], bench.origin_sd), (blocks["scale"], bench.scale_sd)]
    wanted += [(blocks["place"], bench.place_sd), (blocks["direction"], bench.direction_sd)]
    free = [(part, np.full(part.shape[-1], sd)) for part, sd in wanted if sd > 0.0]
    sds = np.concatenate([np.zeros(0), *(sd for _, sd in free)])
    return np.concatenate([blocks["stiffness"], *shared, *(part for part, _ in free)], axis=-1), sds


def _doubt_left(a: Array, covariance: Array) -> Array:
    """`(E^-1 + G)^-1` with G the frames' `A' A`, block-diagonal; no inverse of E."""
    steps = len(a)
    gram = np.zeros((steps, 2, steps, 2))
    gram[np.arange(steps), :, np.arange(steps), :] = np.swapaxes(a, 1, 2) @ a
    left = np.linalg.solve(np.eye(2 * steps) + covariance @ gram.reshape(2 * steps, -1), covariance)
    return np.asarray(0.5 * (left + left.T))
