"""The beam under an unknown load: what all frames share (k(s), tags, clamp, rest shape, picture, place of the contact),
equilibria, and poses of the tags with derivatives.

The unknowns a frame has of its own are its load and, where it is asked for, the place of the force. A load is the two
components [N] of a force, and may be followed by the moment [N m] that acts at the same place.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from onebend.beam.continuation import follow
from onebend.beam.grid import Modes, apply, places, positions
from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.problem import Problem, has_mass, make_problem, share_farther
from onebend.beam.sensitivity import Perturbation, of_clamp_angle, of_rest_curvature, of_stiffness, respond
from onebend.beam.setup import SetUp
from onebend.beam.statics import Equilibrium, correct, is_stable
from onebend.beam.stiffness import UncertainStiffness
from onebend.errors import LearningError
from onebend.learning.allowances import camera, heights
from onebend.learning.fit_data import REST_MODES
from onebend.learning.frames import at_frames, known_loads
from onebend.learning.paper import solve_states
from onebend.learning.parameters import NEEDS_MASS, STATED_ERRORS, Priors, weighs
from onebend.learning.prediction import TagRide, tag_blocks
from onebend.learning.static_poses import RESOLUTION
from onebend.records import Array, IntArray, Observations

LEARNED = ("curvature", "clamp", "origin", "along", "across", "turn")  # that a film of the same mounting has as well
_RIDING = ("along", "across", "turn", "origin", "scale")  # of the tags, as `tag_blocks` has them
_PLACES = 401
_REMEMBERED = 50  # grids
_SLIGHT = 3e-3  # of log k
_SAME_PLACE = 1e-6  # s


@dataclass(frozen=True)
class SharedPrior:
    """A normal density, of covariance `root root^T`, of what the frames share, part after part.

    In order: the independent ways (p) in which log k is off, its common scale, the clamp's angle, the rest curvature
    (3) besides that of the beam, the tags' places along and across and their turns (m each), the origin (2), the
    picture's scale, the discrepancy: of the places (2 m) and the angles (m) of the tags for each metre that they move;
    the unknowns of the picture, and the place of the contact where it is said.
    """

    ways: Array  # (c, p) of the c coefficients of log k, each way of variance 1
    picture: Array  # (T + 1, m, 3, v) m, m, rad: what the v unknowns of the picture do in each frame; the last at rest
    mean: Array  # (n,)
    root: Array  # (n, r)
    parts: dict[str, slice]
    memory: dict[bytes, Array] = field(default_factory=dict, compare=False)  # the ways of log k on nodes met before

    def on_nodes(self, stiffness: UncertainStiffness, nodes: Array) -> Array:
        """(..., p) of log k at `nodes` (...), per unit of each way."""
        key = nodes.tobytes()
        if key not in self.memory:
            if len(self.memory) > _REMEMBERED:
                self.memory.clear()
            self.memory[key] = (stiffness.basis(nodes.ravel()) @ self.ways).reshape(*nodes.shape, -1)
        return self.memory[key]


def shared_prior(
    observations: Observations,
    stiffness: UncertainStiffness | None,
    setup: SetUp | None,
    *,
    tags_as_learned: bool,
    place_sd: float,
) -> SharedPrior:
    """As the recording states it, with the discrepancy of the `setup` in which the beam was learned, and the place of
    the contact to `place_sd` [m]; with `tags_as_learned`, rest curvature, clamp and tags are those of the set-up, with
    what their errors have in common with those of k(s)."""
    o, m, tags = observations, len(observations.marker_s), [str(i) for i in observations.tag_id]
    errors = {error.name: error for error in STATED_ERRORS}
    stated = {name: errors[name].allowance([o], Priors(), tags).prior_sd for name in ("clamp", "curvature", *_RIDING)}
    ways = np.zeros((0, 0)) if stiffness is None else ways_of(stiffness)
    picture, picture_sd = picture_of(o)
    place, angle = (0.0, 0.0) if setup is None else (setup.discrepancy, setup.angle_discrepancy)
    sds = {
        "log k": np.ones(ways.shape[1]),
        "gain": np.full(1, 0.0 if stiffness is None else stiffness.gain_sd),
        **stated,
        "discrepancy": np.concatenate([np.full(2 * m, place), np.full(m, angle)]),
        "picture": picture_sd,
        "place": np.full(1, place_sd),
    }
    ends = np.cumsum([0, *(len(sd) for sd in sds.values())]).tolist()
    parts = {name: slice(a, b) for name, a, b in zip(sds, ends[:-1], ends[1:], strict=True)}
    prior = SharedPrior(ways, picture, np.zeros(ends[-1]), np.diag(np.concatenate(list(sds.values()))), parts)
    if stiffness is None or setup is None or not (tags_as_learned and same_tags(o, setup)):
        return prior
    return _as_learned(prior, stiffness, setup)


def same_tags(observations: Observations, setup: SetUp | None) -> bool:
    """Whether the tags of this recording are at the places of those in the set-up."""
    if setup is None or len(setup.tags) != len(observations.marker_s):
        return False
    return bool(np.allclose(setup.tags, observations.marker_s, rtol=0.0, atol=_SAME_PLACE))


def picture_of(observations: Observations) -> tuple[Array, Array]:
    """(T + 1, m, 3, v) what the unknowns of the camera, its plane and the tags' heights over it do to the poses, those
    at rest last, and (v,) one sd of each."""
    o, count = observations, len(observations.time) + 1
    seen = np.concatenate([o.xy, o.angle[..., None]], axis=-1)
    rest = np.concatenate([o.rest_xy, o.rest_angle[:, None]], axis=-1)
    found = [] if o.by_camera is None else [camera(o, np.ones(count - 1, dtype=bool), count)]
    found += [] if o.source.view is None else [heights(o, np.concatenate([seen, rest[None]]))]
    none = np.zeros((count, *seen.shape[1:], 0))
    return np.concatenate([none, *(a.basis for a in found)], axis=-1), np.concatenate(
        [np.zeros(0), *(a.prior_sd for a in found)]
    )


def ways_of(stiffness: UncertainStiffness) -> Array:
    """(c, p) of the coefficients: the independent ways in which log k is off, each of variance 1, without those that
    change log k by less than `_SLIGHT`, root mean square over the beam."""
    values, vectors = np.linalg.eigh(stiffness.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    on_beam = stiffness.basis(np.linspace(0.0, 1.0, _PLACES)) @ root / np.sqrt(_PLACES)
    _, size, turn = np.linalg.svd(on_beam, full_matrices=False)
    return np.asarray(root @ turn[size > _SLIGHT].T)


def _as_learned(prior: SharedPrior, stiffness: UncertainStiffness, setup: SetUp) -> SharedPrior:
    """With the joint density of log k and the set-up; ways of log k that were left out are counted with what k(s) does
    not tell."""
    names = [name for name in LEARNED if name in setup.columns]
    ours, theirs = (np.concatenate([np.r_[where[name]] for name in names]) for where in (prior.parts, setup.columns))
    slope = setup.slope[theirs]
    unseen = slope @ (stiffness.covariance - prior.ways @ prior.ways.T) @ slope.T
    values, vectors = np.linalg.eigh(setup.covariance[np.ix_(theirs, theirs)] + 0.5 * (unseen + unseen.T))
    mean, root = prior.mean.copy(), prior.root.copy()
    root[ours] = 0.0
    root[np.ix_(ours, ours)] = vectors * np.sqrt(np.maximum(values, 0.0))
    root[ours, prior.parts["log k"]] = slope @ prior.ways
    mean[ours] = setup.mean[theirs]
    mean[prior.parts["curvature"]] = 0.0  # that of the beam is the learned one
    return SharedPrior(prior.ways, prior.picture, mean, root, prior.parts)


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
        return self.prior.parts

    def value(self, part: str) -> float:
        """Of a part that is one number."""
        return float(self.mean[self.parts[part]][0])

    @property
    def place_sd(self) -> float:
        """m, of the contact's place where it is known beforehand."""
        return float(np.linalg.norm(self.root[self.parts["place"]]))

    @property
    def axes(self) -> Array:
        """(2, 2): takes a force from the recording's frame to that of the clamp, as its direction is known by now."""
        cos, sin = np.cos(self.value("clamp")), np.sin(self.value("clamp"))
        return np.array([[cos, sin], [-sin, cos]])

    def axes_of_loads(self, n: int) -> Array:
        """(n, n): the same for a load."""
        out = np.eye(n)
        out[:2, :2] = self.axes
        return out

    @property
    def at_rest(self) -> Array:
        """(m, 2) m, where the tags were seen at rest; on a straight beam, where they were not."""
        o = self.observations
        return np.where(np.isfinite(o.rest_xy), o.rest_xy, o.length * o.marker_s[:, None] * np.array([1.0, 0.0]))

    def placed(self, place: Array) -> Array:
        """(F,) s where the force acts that is stated to act at `place` (F,)."""
        return np.clip(place + self.value("place") / self.observations.length, INNERMOST, 1.0)

    def beyond(self, problem: Problem, place: Array) -> Array:
        """(F, Q) share of the force at `place` (F,) that acts beyond each node, with the error of that place."""
        here = np.asarray(problem.grid.nodes < place[:, None], dtype=float)
        off = self.value("place")
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
    (F,)."""
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
    """Equilibria under `load` (F, n) at `place` (F,) besides; with the curvatures `start` (F, Q) by Newton's
    method from there alone: frames where it goes astray, or to what does not stand, have not converged."""
    beyond = bench.beyond(problem, place)
    force = problem.dead_force + beyond[..., None] * load[:, None, :2]
    moment = problem.moment + beyond * load[:, 2:] if load.shape[1] > 2 else problem.moment
    loaded = replace(problem, dead_force=force, moment=moment)
    if start is None:
        return follow(loaded)
    ones = np.ones(len(load))
    q, near, count = correct(loaded, start, ones, trust=_TRUST * ones, remaining=_REMAINING * ones)
    near &= is_stable(loaded, q)
    never = np.full(len(load), np.nan)
    return Equilibrium(loaded, q, near, near.copy(), np.where(near, 1.0, np.nan), never, np.zeros_like(near), count)


def _on_grid(bench: Bench, o: Observations, rows: IntArray, at: Array, count: int) -> Problem:
    loads = push(np.zeros((len(rows), 2)), at)
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


# Where the tags are in a frame, and how they move with its force and place and with all that the frames share.

AT_REST = np.array([-1], dtype=np.int64)  # the frame that shows the beam at rest


@dataclass(frozen=True)
class Tags:
    """Tags of F frames as force and place put them, with derivatives; m, m, rad."""

    solved: Equilibrium
    pose: Array  # (F, m, 3)
    by_load: Array  # (F, m, 3, n) per N, and per N m
    by_place: Array  # (F, m, 3, 1) per metre that the force acts farther out
    by_shared: Array  # (F, m, 3, n) per unit of what the frames share


def poses_of(bench: Bench, frames: IntArray, solved: Equilibrium) -> tuple[Array, TagRide, Array]:
    """(F, m, 3) m, m, rad: the tags in the picture; how they ride, and the places (m,) of the beam under them."""
    parts, mean, length = bench.parts, bench.mean, bench.observations.length
    at = bench.observations.marker_s + mean[parts["along"]] / length
    s = np.clip(at, 0.0, 1.0)
    ride = TagRide(solved.angle(s), length * (at - s), mean[parts["across"]], 1.0 + bench.value("scale"))
    pose = ride.pose(solved.xy(s), mean[parts["origin"]], mean[parts["turn"]])
    seen = pose + bench.prior.picture[frames] @ mean[parts["picture"]]
    return seen + _left(bench, pose[..., :2]) @ mean[parts["discrepancy"]], ride, s


def tags_of(
    bench: Bench, frames: IntArray, solved: Equilibrium, load: Array, place: Array, *, shared: bool = True
) -> Tags:
    """Of `frames` (F,) under `load` (F, n) at `place` (F,), the equilibria being `solved`; without `shared`,
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
    moved[..., turned] += moved[..., 1] * load[:, 0, None, None]
    moved[..., turned] -= moved[..., 0] * load[:, 1, None, None]
    xy = ride.offset + solved.xy(s)
    bend = np.where(ride.over <= 0.0, apply(problem.grid.value_at(s), solved.q) / bench.observations.length, 0.0)
    riding = tag_blocks(ride.motion(xy, bend))
    blocks = [moved[..., ends:], *(riding[name] for name in _RIDING), _left(bench, pose[..., :2])]
    blocks += [bench.prior.picture[frames], moved[..., n:ends]]
    return Tags(solved, pose, moved[..., :n], moved[..., n:ends], np.concatenate(blocks, axis=-1))


def _of_own(bench: Bench, problem: Problem, load: Array, place: Array) -> Perturbation:
    count, n = load.shape
    shape = (count, problem.to_nodes.shape[-1])
    force, moment = np.zeros((*shape, 2, n + 1)), np.zeros((*shape, n + 1))
    beyond, farther = bench.beyond(problem, place), share_farther(problem, place)
    for c in range(2):
        force[..., c, c] = beyond
        force[..., c, n] = farther * load[:, c, None]
    if n > 2:
        moment[..., 2], moment[..., n] = beyond, farther * load[:, 2:]
    return Perturbation(force, moment if n > 2 else None, None, np.zeros(n + 1))


def _left(bench: Bench, xy: Array) -> Array:
    """(F, m, 3, 3 m) of each tag's x, then y, then angle, per unit of the discrepancy, of tags at `xy` (F, m, 2) m."""
    moved = xy - bench.at_rest
    frames, m = moved.shape[:2]
    size = np.sqrt(np.mean(np.sum(moved**2, axis=-1), axis=1))
    out = np.zeros((frames, m, 3, 3, m))
    for tag in range(m):
        out[:, tag, range(3), range(3), tag] = size[:, None]
    return out.reshape(frames, m, 3, 3 * m)


# The search begins at the load that balances the curvature from inverse kinematics (22), `k (q - q0) = (r(s_a) - r(s))
# x F` below `s_a`: linear least squares over places, with the load's prior.

_MODES = 4
_NODES = 0.05 + 0.9 * (np.arange(24) + 0.5) / 24  # of the way to the force
_CURVATURE_SD = 0.3  # rad, of such a shape's curvature


def first_forces(bench: Bench, frames: IntArray, place: Array, prior_sd: Array) -> Array:
    """(F, n) loads in `frames` (F,) at `place` (F,) of s; `prior_sd` (n,) of each number."""
    beam, every = bench.beam, bench.observations
    o = at_frames(every, np.isin(np.arange(len(every.time)), frames))
    states = solve_states(o, min(_MODES, 2 * len(o.marker_s)))
    theta = np.nan_to_num(states.theta)
    out = np.zeros((len(frames), len(prior_sd)))
    place = bench.placed(place)
    for at in np.unique(place):
        rows = np.flatnonzero(place == at)
        s = at * _NODES
        on = places(o.length, Modes(theta.shape[1]), np.append(s, at))
        xy = positions(on, theta[rows])
        bent = on.modes.curvature(s) @ theta[rows].T - np.asarray(beam.rest_curvature(s))[:, None]
        by, lever = np.ones((len(rows), len(s), len(prior_sd))), xy[:, -1:] - xy[:, :-1]
        by[..., 0], by[..., 1] = -lever[..., 1], lever[..., 0]
        weight = np.sqrt(theta.shape[1] / len(s)) / _CURVATURE_SD
        by = weight * prior_sd * by / np.asarray(beam.stiffness(s))[:, None]
        right = np.einsum("fsi,sf->fi", by, weight * bent)
        normal = np.einsum("fsi,fsj->fij", by, by) + np.eye(len(prior_sd))
        out[rows] = prior_sd * np.linalg.solve(normal, right[..., None])[..., 0]
    return out
