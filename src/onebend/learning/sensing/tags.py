"""Where the tags are in a frame, and how they move with its force and place and with all that the frames share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.perturbation import Perturbation
from onebend.beam.statics.sensitivity import of_clamp_angle, of_rest_curvature, of_stiffness, respond
from onebend.learning.model.fit_data import REST_MODES, share_farther
from onebend.learning.model.tag_jacobian import TagRide, tag_blocks
from onebend.learning.sensing.bench import Bench
from onebend.records import Array, IntArray

AT_REST = np.array([-1], dtype=np.int64)  # the frame that shows the beam at rest
_RIDING = ("along", "across", "turn", "origin", "scale")  # of the tags, as `tag_blocks` has them


@dataclass(frozen=True)
class Tags:
    """Tags of F frames as force and place put them, with derivatives; m, m, rad."""

    solved: Equilibrium
    pose: Array  # (F, m, 3)
    by_force: Array  # (F, m, 3, 2) per N
    by_place: Array  # (F, m, 3) per metre that the force acts farther out
    by_shared: Array  # (F, m, 3, n) per unit of what the frames share
    angle: Array  # (F,) rad, of the beam where the force acts


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
    bench: Bench, frames: IntArray, solved: Equilibrium, force: Array, place: Array, *, shared: bool = True
) -> Tags:
    """Of `frames` (F,) under `force` (F, 2) N at `place` (F,), the equilibria being `solved`; without `shared`, the
    derivatives with what the frames share are left out.

    The force is of the clamp's axes: it turns with the clamp.
    """
    problem, nodes = solved.problem, solved.problem.grid.nodes
    pose, ride, s = poses_of(bench, frames, solved)
    angle = solved.angle(place[:, None])[:, 0]
    by_both = bench.beyond(problem, place)[..., None, None] * np.eye(2)
    farther = share_farther(problem, place)[..., None] * force[:, None]
    own = Perturbation(np.concatenate([by_both, farther[..., None]], axis=-1), None, None, np.zeros(3))
    if not shared:
        moved = ride.carry(respond(solved, own).poses(s))
        return Tags(solved, pose, moved[..., :2], moved[..., 2], moved[..., 3:], angle)
    level = problem.k[..., None]
    functions = level
    if bench.stiffness is not None:
        functions = np.concatenate([level * bench.prior.on_nodes(bench.stiffness, nodes), level], axis=-1)
    changes = own + of_stiffness(solved, functions) + of_clamp_angle(problem)
    changes = changes + of_rest_curvature(problem, REST_MODES.curvature(nodes))
    moved = ride.carry(respond(solved, changes).poses(s))
    turned = bench.parts["clamp"].start + 3
    moved[..., turned] += moved[..., 1] * force[:, :1, None] - moved[..., 0] * force[:, 1:, None]
    xy = ride.offset + solved.xy(s)
    bend = np.where(ride.over <= 0.0, apply(problem.grid.value_at(s), solved.q) / bench.observations.length, 0.0)
    riding = tag_blocks(ride.motion(xy, bend))
    blocks = [moved[..., 3:], *(riding[name] for name in _RIDING), _left(bench, pose[..., :2])]
    blocks += [bench.prior.picture[frames], moved[..., 2:3]]
    return Tags(solved, pose, moved[..., :2], moved[..., 2], np.concatenate(blocks, axis=-1), angle)


def _left(bench: Bench, xy: Array) -> Array:
    """(F, m, 3, 3 m) of each tag's x, then y, then angle, per unit of the discrepancy, of tags at `xy` (F, m, 2) m."""
    moved = xy - bench.at_rest
    frames, m = moved.shape[:2]
    size = np.sqrt(np.mean(np.sum(moved**2, axis=-1), axis=1))
    out = np.zeros((frames, m, 3, 3, m))
    for tag in range(m):
        out[:, tag, range(3), range(3), tag] = size[:, None]
    return out.reshape(frames, m, 3, 3 * m)
