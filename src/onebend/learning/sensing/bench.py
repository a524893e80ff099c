"""What all frames of a recording share when the force is told from the shape: the beam, the place of the contact, how
the tags sit, the clamp, the rest shape, the picture; as it is known by now, and the beam of it in each frame.

The unknowns a frame has of its own are its load and, where it is asked for, the place of the force. A load is the two
components [N] of one force, or of two one after the other; after those of one may stand the moment [N m] that acts at
the same place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.beam.statics.continuation import follow
from onebend.beam.statics.equilibrium import Equilibrium, is_stable
from onebend.beam.statics.newton import correct
from onebend.beam.statics.problem import Problem, make_problem
from onebend.beam.statics.rod import has_mass
from onebend.errors import LearningError
from onebend.learning.model.fit_data import REST_MODES, share_farther
from onebend.learning.model.frames import known_loads
from onebend.learning.model.held_ends import RESOLUTION
from onebend.learning.model.mass import NEEDS_MASS, weighs
from onebend.learning.sensing.prior import SharedPrior
from onebend.records import Array, IntArray, Observations

INNERMOST = 0.03  # s: nearer to the clamp a force bends nothing
_TRUST = 3.0  # rad: Newton's method may turn the beam no further
_REMAINING = 1e-11  # rad


@dataclass(frozen=True)
class Bench:
    """Beam and mounting: what the frames share is `mean`, of covariance `root root^T`, in the order of the prior."""

    beam: Beam
    stiffness: UncertainStiffness | None
    prior: SharedPrior
    observations: Observations
    mean: Array  # (n,)
    root: Array  # (n, r)

    @property
    def parts(self) -> dict[str, slice]:
        """Where each part stands."""
        return self.prior.parts

    def value(self, part: str) -> float:
        """Of a part that is one number."""
        return float(self.mean[self.parts[part]][0])

    @property
    def place_sd(self) -> float:
        """m, of the contact's place where it is said; of two, the first."""
        return float(np.linalg.norm(self.root[self.parts["place"]][0]))

    @property
    def axes(self) -> Array:
        """(2, 2): takes a force from the recording's frame to that of the clamp, as its direction is known by now."""
        cos, sin = np.cos(self.value("clamp")), np.sin(self.value("clamp"))
        return np.array([[cos, sin], [-sin, cos]])

    def axes_of_loads(self, n: int) -> Array:
        """(n, n): the same for a load."""
        out = np.eye(n)
        for c in range(0, n - 1, 2):
            out[c : c + 2, c : c + 2] = self.axes
        return out

    @property
    def at_rest(self) -> Array:
        """(m, 2) m, where the tags were seen at rest; on a straight beam, where they were not."""
        o = self.observations
        return np.where(np.isfinite(o.rest_xy), o.rest_xy, o.length * o.marker_s[:, None] * np.array([1.0, 0.0]))

    def placed(self, place: Array) -> Array:
        """(F,) or (F, 2) s where the forces act that are said to act at `place`, as many."""
        off = self.mean[self.parts["place"]] / self.observations.length
        return np.clip(place + (off if place.ndim > 1 else off[0]), INNERMOST, 1.0)

    def beyond(self, problem: Problem, place: Array, which: int = 0) -> Array:
        """(F, Q) share of the force at `place` (F,) that acts beyond each node, with what that place is off by;
        `which`: 1 of the second of two forces."""
        here = np.asarray(problem.grid.nodes < place[:, None], dtype=float)
        off = float(self.mean[self.parts["place"]][which])
        return here if off == 0.0 else here + off * share_farther(problem, place)


def check_recording(beam: Beam, o: Observations) -> None:
    """Whether a force on `beam` can be told from this recording.

    Raises:
        LearningError: it is not of this beam, its end is held, or the beam's mass is needed and not known.
    """
    if abs(beam.length - o.length) > 1e-6 * o.length:
        raise LearningError(
            f"{o.source.name}: the model's beam is {1e3 * beam.length:.6g} mm long, the recording's "
            f"{1e3 * o.length:.6g} mm. Give the model of this beam"
        )
    if o.held is not None:
        raise LearningError(
            f"{o.source.name}: the end of the beam is held; a force is told from the shape of a beam that is free there"
        )
    if weighs(o) and not has_mass(beam):
        raise LearningError(f"{o.source.name}: {NEEDS_MASS}")


def problem_of(bench: Bench, frames: IntArray, place: Array) -> Problem:
    """The beam in `frames` (F,) under all that acts but the force that is sought, on a grid with an edge at its `place`
    (F,) or (F, 2)."""
    return _on_grid(bench, bench.observations, frames, place, len(frames))


def problem_apart(bench: Bench, frames: IntArray, place: Array) -> Problem:
    """The same on one grid a frame, of as many panels wherever the places are."""
    rows = np.append(frames, frames[-1])
    at = np.concatenate([place, 0.5 * place[-1:]])  # a frame more, of another place
    return _on_grid(bench, bench.observations, rows, at, len(frames))


def rest_problem(bench: Bench) -> Problem:
    """The beam with nothing on it, one frame."""
    return _as_known(bench, make_problem(bench.beam, push(np.zeros((1, 2))), RESOLUTION))


def solve(bench: Bench, problem: Problem, load: Array, place: Array, start: Array | None) -> Equilibrium:
    """Equilibria under `load` (F, n) at `place` (F,) or (F, 2) besides; with the curvatures `start` (F, Q) by Newton's
    method from there alone: frames where it goes astray, or to what does not stand, have not converged."""
    force, moment = problem.dead_force, problem.moment
    for which, at in enumerate(places_in(place)):
        beyond = bench.beyond(problem, at, which)
        force = force + beyond[..., None] * load[:, None, 2 * which : 2 * which + 2]
        if load.shape[1] % 2:
            moment = moment + beyond * load[:, -1:]
    loaded = replace(problem, dead_force=force, moment=moment)
    if start is None:
        return follow(loaded)
    ones = np.ones(len(load))
    q, near, count = correct(loaded, start, ones, trust=_TRUST * ones, remaining=_REMAINING * ones)
    near &= is_stable(loaded, q)
    never = np.full(len(load), np.nan)
    return Equilibrium(loaded, q, near, near.copy(), np.where(near, 1.0, np.nan), never, np.zeros_like(near), count)


def places_in(place: Array) -> list[Array]:
    """Those of each force, (F,): of (F,) or (F, 2)."""
    return [place] if place.ndim == 1 else list(place.T)


def _on_grid(bench: Bench, o: Observations, rows: IntArray, at: Array, count: int) -> Problem:
    loads, *more = (push(np.zeros((len(rows), 2)), one) for one in places_in(at))
    for one in more:
        loads = loads + one
    if o.known_loads is not None:
        loads = loads + known_loads(o, np.ones(len(o.time), dtype=bool)).take(rows)
    if np.any(o.gravity[rows] != 0.0):
        loads = loads + weight(o.gravity[rows])
    problem = make_problem(bench.beam, loads, RESOLUTION)
    return _as_known(bench, problem if count == len(rows) else problem.take(np.arange(count)))


def _as_known(bench: Bench, problem: Problem) -> Problem:
    """With k(s), rest curvature and clamp angle as they are thought to be."""
    nodes, level = problem.grid.nodes, bench.value("gain")
    q0 = (
        np.asarray(bench.beam.rest_curvature(nodes))
        + REST_MODES.curvature(nodes) @ bench.mean[bench.parts["curvature"]]
    )
    off = bench.mean[bench.parts["log k"]]
    k = problem.k
    if bench.stiffness is not None and (level != 0.0 or np.any(off != 0.0)):
        k = k * np.exp(level + bench.prior.on_nodes(bench.stiffness, nodes) @ off)
    return replace(problem, k=k, q0=q0, alpha0=np.asarray(bench.beam.clamp_angle + bench.value("clamp")))
