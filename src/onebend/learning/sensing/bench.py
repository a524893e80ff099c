"""What all frames of a recording share when the force is told from the shape: the beam, the place of the contact, how
the tags sit, the clamp, the rest shape; each with its sd, and the derivatives of the tags with it.

The unknowns a frame has of its own are the force's two components and, where it is asked for, its place. All that is
shared is integrated out to first order: it adds `B C B^T` to the noise of the tags, B their derivatives, C the
covariance after the beam at rest was seen. The discrepancy that the learning found is one of the shared parts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.beam.statics.continuation import follow
from onebend.beam.statics.equilibrium import Equilibrium, is_stable
from onebend.beam.statics.newton import correct
from onebend.beam.statics.problem import Problem, make_problem
from onebend.beam.statics.sensitivity import (
    of_clamp_angle,
    of_force,
    of_moment,
    of_rest_curvature,
    of_stiffness,
    respond,
)
from onebend.learning.design.instruments import Instruments
from onebend.learning.model.fit_data import REST_MODES
from onebend.learning.model.frames import known_loads, whitening
from onebend.learning.model.held_ends import RESOLUTION
from onebend.learning.model.tag_jacobian import TagRide, along_and_across, tag_blocks
from onebend.learning.sensing.prior import SharedPrior, shared_prior
from onebend.records import Array, IntArray, Observations

_RIDING = ("along", "across", "turn", "origin", "scale")  # of the tags, as `tag_blocks` has them
_REST_STEPS = 4
_TRUST = 3.0  # rad: Newton's method may turn the beam no further
_REMAINING = 1e-11  # rad


@dataclass(frozen=True)
class Bench:
    """Beam and mounting, as the beam at rest leaves them: what the frames share is `mean`, of covariance `root root^T`.

    Their order is that of `prior.SharedPrior`.
    """

    beam: Beam
    stiffness: UncertainStiffness | None
    prior: SharedPrior
    observations: Observations
    mean: Array  # (n,)
    root: Array  # (n, r)
    place_sd: float  # m, of the contact's place where it is said

    @property
    def parts(self) -> dict[str, slice]:
        """Where each part stands."""
        return self.prior.parts

    @property
    def at_rest(self) -> Array:
        """(m, 2) m, where the tags were seen at rest; on a straight beam, where they were not."""
        o = self.observations
        return np.where(np.isfinite(o.rest_xy), o.rest_xy, o.length * o.marker_s[:, None] * np.array([1.0, 0.0]))


@dataclass(frozen=True)
class Tags:
    """Tags of F frames as force and place put them, with derivatives; m, m, rad."""

    solved: Equilibrium
    pose: Array  # (F, m, 3)
    by_force: Array  # (F, m, 3, 2) per N
    by_place: Array  # (F, m, 3) per metre that the force acts farther out
    by_shared: Array  # (F, m, 3, n) per unit of what the frames share
    angle: Array  # (F,) rad, of the beam where the force acts


def make_bench(
    beam: Beam,
    observations: Observations,
    stiffness: UncertainStiffness | None,
    place_sd: float,
    instruments: Instruments | None = None,
    *,
    tags_as_learned: bool = True,
) -> Bench:
    """What is known before, and then what the tags at rest say of it (Gauss-Newton, the beam without a force)."""
    o, m = observations, len(observations.marker_s)
    prior = shared_prior(o, stiffness, instruments, tags_as_learned=tags_as_learned)
    root, bench = prior.root, Bench(beam, stiffness, prior, o, prior.mean, prior.root, place_sd)
    seen = np.concatenate([o.rest_xy, o.rest_angle[:, None]], axis=1)
    if not np.isfinite(seen).any():
        return bench
    whiten, mean, inner = whitening(seen, o.rest_covariance), bench.mean, np.eye(root.shape[1])
    for _ in range(_REST_STEPS):
        tags = rest_tags(replace(bench, mean=mean))
        rows = (whiten @ (tags.by_shared[0] @ root)).reshape(3 * m, -1)
        away = np.nan_to_num(seen - tags.pose[0]) + tags.by_shared[0] @ (mean - prior.mean)
        inner = np.linalg.inv(np.eye(root.shape[1]) + rows.T @ rows)
        mean = prior.mean + root @ (inner @ (rows.T @ (whiten @ away[..., None]).ravel()))
    return replace(bench, mean=mean, root=root @ np.linalg.cholesky(0.5 * (inner + inner.T)))


def rest_tags(bench: Bench) -> Tags:
    """The tags of the beam with nothing on it, one frame."""
    problem = _with_rest(bench, make_problem(bench.beam, push(np.zeros((1, 2))), RESOLUTION))
    return tags_of(bench, follow(problem), np.zeros((1, 2)), np.ones(1))


def problem_of(bench: Bench, frames: IntArray, place: Array) -> Problem:
    """The beam in `frames` (F,) under all that acts but the force that is sought, on a grid with an edge at its `place`
    (F,)."""
    o = bench.observations
    return _on_grid(bench, o, frames, place, len(frames))


def problem_apart(bench: Bench, frames: IntArray, place: Array) -> Problem:
    """The same on one grid a frame, of as many panels wherever the places are."""
    rows, at = np.append(frames, frames[-1]), np.append(place, 0.5 * place[-1])  # a frame more, of another place
    return _on_grid(bench, bench.observations, rows, at, len(frames))


def _on_grid(bench: Bench, o: Observations, rows: IntArray, at: Array, count: int) -> Problem:
    loads = push(np.zeros((len(rows), 2)), at)
    if o.known_loads is not None:
        loads = loads + known_loads(o, np.ones(len(o.time), dtype=bool)).take(rows)
    if np.any(o.gravity[rows] != 0.0):
        loads = loads + weight(o.gravity[rows])
    problem = make_problem(bench.beam, loads, RESOLUTION)
    return _with_rest(bench, problem if count == len(rows) else problem.take(np.arange(count)))


def solve(problem: Problem, force: Array, place: Array, start: Array | None) -> Equilibrium:
    """Equilibria under `force` (F, 2) N at `place` (F,) besides; with the curvatures `start` (F, Q) by Newton's method
    from there alone: frames where it goes astray, or to what does not stand, have not converged."""
    beyond = np.asarray(problem.grid.nodes < place[:, None], dtype=float)
    loaded = replace(problem, dead_force=problem.dead_force + beyond[..., None] * force[:, None])
    if start is None:
        return follow(loaded)
    ones = np.ones(len(force))
    q, near, count = correct(loaded, start, ones, trust=_TRUST * ones, remaining=_REMAINING * ones)
    near &= is_stable(loaded, q)
    never = np.full(len(force), np.nan)
    return Equilibrium(loaded, q, near, near.copy(), np.where(near, 1.0, np.nan), never, np.zeros_like(near), count)


def _with_rest(bench: Bench, problem: Problem) -> Problem:
    """With rest curvature and clamp angle as they are thought to be."""
    parts = bench.parts
    q0 = np.asarray(bench.beam.rest_curvature(problem.grid.nodes)) + (
        REST_MODES.curvature(problem.grid.nodes) @ bench.mean[parts["curvature"]]
    )
    return replace(problem, q0=q0, alpha0=np.asarray(bench.beam.clamp_angle + float(bench.mean[parts["clamp"]][0])))


def poses_of(bench: Bench, solved: Equilibrium) -> tuple[Array, TagRide, Array]:
    """(F, m, 3) m, m, rad: the tags in the picture; how they ride, and the places (m,) of the beam under them."""
    parts, mean, length = bench.parts, bench.mean, bench.observations.length
    at = bench.observations.marker_s + mean[parts["along"]] / length
    s = np.clip(at, 0.0, 1.0)
    scale = 1.0 + float(mean[parts["scale"]][0])
    ride = TagRide(solved.angle(s), length * (at - s), mean[parts["across"]], scale)
    xy = scale * (solved.xy(s) + ride.offset) + mean[parts["origin"]]
    return np.concatenate([xy, (ride.angle + mean[parts["turn"]])[..., None]], axis=-1), ride, s


def tags_of(bench: Bench, solved: Equilibrium, force: Array, place: Array) -> Tags:
    """Where the tags are, and how they move with force, place and all that the frames share."""
    problem, nodes, parts = solved.problem, solved.problem.grid.nodes, bench.parts
    pose, ride, s = poses_of(bench, solved)
    level = problem.k[..., None]
    functions = level
    if bench.stiffness is not None:
        off = (bench.stiffness.basis(nodes.ravel()) @ bench.prior.ways).reshape(*nodes.shape, -1)
        functions = np.concatenate([level * off, level], axis=-1)
    changes = of_force(problem, place) + of_moment(problem, place) + of_stiffness(solved, functions)
    changes = changes + of_clamp_angle(problem) + of_rest_curvature(problem, REST_MODES.curvature(nodes))
    moved = ride.carry(respond(solved, changes).poses(s))
    angle = solved.angle(place[:, None])[:, 0]
    across = along_and_across(force, angle)[1]
    xy = (pose[..., :2] - bench.mean[parts["origin"]]) / ride.scale
    bend = np.where(ride.over <= 0.0, apply(problem.grid.value_at(s), solved.q) / bench.observations.length, 0.0)
    riding = tag_blocks(ride.motion(xy, bend))
    left = _discrepancy(pose[..., :2] - bench.at_rest)
    shared = np.concatenate([moved[..., 3:], *(riding[name] for name in _RIDING), left], axis=-1)
    return Tags(solved, pose, moved[..., :2], moved[..., 2] * across[:, None, None], shared, angle)


def _discrepancy(moved: Array) -> Array:
    """(F, m, 3, 3 m) of each tag's x, then y, then angle, per unit of the discrepancy, of tags `moved` (F, m, 2) m."""
    frames, m = moved.shape[:2]
    size = np.sqrt(np.mean(np.sum(moved**2, axis=-1), axis=1))
    out = np.zeros((frames, m, 3, 3, m))
    for tag in range(m):
        out[:, tag, range(3), range(3), tag] = size[:, None]
    return out.reshape(frames, m, 3, 3 * m)
