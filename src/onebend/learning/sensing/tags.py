"""Where the tags are in a frame, and how they move with its force and place and with all that the frames share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.perturbation import Perturbation
from onebend.beam.statics.problem import Problem
from onebend.beam.statics.sensitivity import of_clamp_angle, of_rest_curvature, of_stiffness, respond
from onebend.learning.model.fit_data import REST_MODES, share_farther
from onebend.learning.model.tag_jacobian import TagRide, tag_blocks
from onebend.learning.sensing.bench import Bench, places_in
from onebend.records import Array, IntArray

AT_REST = np.array([-1], dtype=np.int64)  # the frame that shows the beam at rest
_RIDING = ("along", "across", "turn", "origin", "scale")  # of the tags, as `tag_blocks` has them


@dataclass(frozen=True)
class Tags:
    """Tags of F frames as force and place put them, with derivatives; m, m, rad."""

    solved: Equilibrium
    pose: Array  # (F, m, 3)
    by_load: Array  # (F, m, 3, n) per N, and per N m
    by_place: Array  # (F, m, 3, c) per metre that the force, or each of both, acts farther out
    by_shared: Array  # (F, m, 3, n) per unit of what the frames share


def poses_of(bench: Bench, frames: IntArray, solved: Equilibrium) -> tuple[Array, TagRide, Array]:
    """(F, m, 3) m, m, rad: the tags in the picture; how they ride, and the places (m,) of the beam under them."""
    parts, mean, length = bench.parts, bench.mean, bench.observations.length
    at = bench.observations.marker_s + mean[parts["along"]] / length
    s = np.clip(at, 0.0, 1.0)
    scale = 1.0 + bench.value("scale")
    ride = TagRide(solved.angle(s), length * (at - s), mean[parts["across"]], scale)
    xy = scale * (solved.xy(s) + ride.offset) + mean[parts["origin"]]
    pose = np.concatenate([xy, (ride.angle + mean[parts["turn"]])[..., None]], axis=-1)
    pose = pose + bench.prior.picture[frames] @ mean[parts["picture"]]
    return pose + _left(bench, xy) @ mean[parts["discrepancy"]], ride, s


def tags_of(
    bench: Bench, frames: IntArray, solved: Equilibrium, load: Array, place: Array, *, shared: bool = True
) -> Tags:
    """Of `frames` (F,) under `load` (F, n) at `place` (F,) or (F, 2), the equilibria being `solved`; without `shared`,
    the derivatives with what the frames share are left out.

    Forces are of the clamp's axes: they turn with the clamp.
    """
    problem, nodes = solved.problem, solved.problem.grid.nodes
    pose, ride, s = poses_of(bench, frames, solved)
    own, n = _of_own(bench, problem, load, place), load.shape[1]
    ends = own.clamp.size
    if not shared:
        moved = ride.carry(respond(solved, own).poses(s))
        return Tags(solved, pose, moved[..., :n], moved[..., n:], moved[..., ends:])
    level = problem.k[..., None]
    functions = level
    if bench.stiffness is not None:
        functions = np.concatenate([level * bench.prior.on_nodes(bench.stiffness, nodes), level], axis=-1)
    changes = own + of_stiffness(solved, functions) + of_clamp_angle(problem)
    changes = changes + of_rest_curvature(problem, REST_MODES.curvature(nodes))
    moved = ride.carry(respond(solved, changes).poses(s))
    turned = bench.parts["clamp"].start + ends
    for x in range(0, n - 1, 2):
        moved[..., turned] += moved[..., x + 1] * load[:, x, None, None]
        moved[..., turned] -= moved[..., x] * load[:, x + 1, None, None]
    xy = ride.offset + solved.xy(s)
    bend = np.where(ride.over <= 0.0, apply(problem.grid.value_at(s), solved.q) / bench.observations.length, 0.0)
    riding = tag_blocks(ride.motion(xy, bend))
    blocks = [moved[..., ends:], *(riding[name] for name in _RIDING), _left(bench, pose[..., :2])]
    blocks += [bench.prior.picture[frames], moved[..., n:ends]]
    return Tags(solved, pose, moved[..., :n], moved[..., n:ends], np.concatenate(blocks, axis=-1))


def by_forces_at(bench: Bench, frames: IntArray, solved: Equilibrium, place: Array) -> Array:
    """(F, m, 3, P, 2) m, m, rad per N: by how much the components of a force at each of the places (P,) move the tags
    of `frames` (F,), wherever the grid has its nodes."""
    _, ride, s = poses_of(bench, frames, solved)
    problem = solved.problem
    nodes, weights = (np.asarray(each).reshape(-1) for each in (problem.grid.nodes, problem.weights))
    beyond = np.asarray(nodes < place[:, None], dtype=float)
    short = place - beyond @ weights  # of s from the last node's share of the beam to the place
    beyond = beyond + float(problem.length) * short[:, None] * share_farther(problem, place)
    force = np.einsum("pq,cd->qcpd", beyond, np.eye(2)).reshape(1, len(nodes), 2, -1)
    changes = Perturbation(force, None, None, np.zeros(2 * len(place)))
    moved = ride.carry(respond(solved, changes).poses(s))
    return moved.reshape(*moved.shape[:3], len(place), 2)


def _of_own(bench: Bench, problem: Problem, load: Array, place: Array) -> Perturbation:
    """n of the load, and as many as there are places of these."""
    every, (count, n) = places_in(place), load.shape
    size = n + len(every)
    shape = (count, problem.to_nodes.shape[-1])
    force, moment = np.zeros((*shape, 2, size)), np.zeros((*shape, size))
    for which, at in enumerate(every):
        beyond, farther = bench.beyond(problem, at, which), share_farther(problem, at)
        for c in range(2):
            force[..., c, 2 * which + c] = beyond
            force[..., c, n + which] = farther * load[:, 2 * which + c, None]
        if n % 2:
            moment[..., n - 1], moment[..., n] = beyond, farther * load[:, -1:]
    return Perturbation(force, moment if n % 2 else None, None, np.zeros(size))


def _left(bench: Bench, xy: Array) -> Array:
    """(F, m, 3, 3 m) of each tag's x, then y, then angle, per unit of the discrepancy, of tags at `xy` (F, m, 2) m."""
    moved = xy - bench.at_rest
    frames, m = moved.shape[:2]
    size = np.sqrt(np.mean(np.sum(moved**2, axis=-1), axis=1))
    out = np.zeros((frames, m, 3, 3, m))
    for tag in range(m):
        out[:, tag, range(3), range(3), tag] = size[:, None]
    return out.reshape(frames, m, 3, 3 * m)
