"""How far off a learned beam's prediction of another push is likely to be.

The noise of the force is only a part of it. k(s) is known to its band. The other push acts where somebody says that it
does, to a tolerance, slides from there as any tool may, and its log's axes stand as written, to another: the fit takes
all of that as unknown in each push. To first order each moves the tags by its derivative. The scale of the force counts
for nothing where one sensor logged both pushes: k(s) is off by as much as the force.
"""

from __future__ import annotations

import numpy as np

from onebend.beam.grid import apply
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.sensitivity import of_force, of_moment, of_stiffness, respond
from onebend.learning.allowances.contact import SLIDE_SD
from onebend.learning.model.frames import push_places
from onebend.learning.model.tag_jacobian import along_and_across
from onebend.records import Array, BoolArray, Observations

_FRAMES = 100  # that are looked at


def few_frames(frames: BoolArray) -> BoolArray:
    """(T,) of these frames at most as many as are looked at, evenly chosen."""
    used = np.flatnonzero(frames)
    chosen = np.zeros_like(frames)
    chosen[used[np.linspace(0, len(used) - 1, min(len(used), _FRAMES)).astype(int)]] = True
    return chosen


def variances(
    solved: Equilibrium, observations: Observations, frames: BoolArray, stiffness: UncertainStiffness
) -> dict[str, Array]:
    """(m,) m^2 each, mean over the frames of the squared distance by which the tags are likely to be off:
    by the band of log k(s), by the place of the push and by the direction of its force.

    `solved`: the beam in these `frames` (T,). Loads that hang on marks act where and as they are said to.
    """
    s, problem, stands = observations.marker_s, solved.problem, solved.converged[:, None]
    functions = problem.k[..., None] * stiffness.basis(problem.grid.nodes)
    by_k = respond(solved, of_stiffness(solved, functions)).xy(s)  # (T, m, 2, p)
    out = {"stiffness": np.sum((by_k @ stiffness.covariance) * by_k, axis=(2, 3))}
    if not observations.static:
        at, force, stated = push_places(observations)[frames], observations.force[frames], observations.stated
        angle = solved.angle(at[:, None])[:, 0]
        _, across = along_and_across(force, angle)
        turned = np.stack([-force[:, 1], force[:, 0]], axis=1)
        by_moment = respond(solved, of_moment(problem, at)).xy(s)[..., 0]
        by_force = respond(solved, of_force(problem, at)).xy(s)
        turn = apply(problem.grid.integral_to(at[:, None]), solved.q - problem.q0)[:, 0]  # of the beam, since rest
        away = stated.place_sd**2 + (SLIDE_SD * turn) ** 2  # (T,) m^2
        out["place"] = np.sum((by_moment * across[:, None, None]) ** 2, axis=-1) * away[:, None]
        out["direction"] = np.sum(np.einsum("tmcd,td->tmc", by_force, turned) ** 2, axis=-1) * stated.direction_sd**2
    return {name: np.mean(one, axis=0, where=stands) for name, one in out.items()}
