"""The beam under an unknown load, as the fit has it: what all frames of a recording share, and their predictions.

The unknowns a frame has of its own are its load and, where it is asked for, the place of the force. A load is the two
components [N] of a force, and may be followed by the moment [N m] that acts at the same place.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from onebend.beam.continuation import ContinuationSettings
from onebend.beam.grid import Grid, Modes, places, positions
from onebend.beam.loads import push, weight
from onebend.beam.model import Beam
from onebend.beam.problem import GridMemory, has_mass, make_problem, share_farther
from onebend.beam.setup import SetUp
from onebend.beam.stiffness import UncertainStiffness
from onebend.errors import LearningError
from onebend.learning import parameters
from onebend.learning.allowances import Allowance, camera, outline_height
from onebend.learning.fit_data import REST_MODES, FitData, fit_data, rested
from onebend.learning.frames import at_frames, known_loads, rest_places, whitening
from onebend.learning.paper import solve_states
from onebend.learning.prediction import Prediction, predict
from onebend.learning.static_poses import RESOLUTION
from onebend.records import Array, IntArray, Observations, Readings

LEARNED = ("curvature", "along", "across", "turn")  # that films of the beam have in common; the clamp may be another
_STATED = (*LEARNED, "clamp", "origin", "scale")  # errors of a bench without a log, whose beam is known
_PLACES = 401
_SLIGHT = 3e-3  # of log k
_EDGES = 0.02  # of s, between edges of grids: a force between two acts as one at the next with another lever
_SAME_PLACE = 1e-6  # s
_NONE = 1e-300  # m, or of a metre: no error, yet a parameter
AT_REST = np.array([-1], dtype=np.int64)  # the frame that shows the beam at rest
# rad: how far Newton's method may turn the beam, and what it may leave; a load that takes the beam farther is not tried
_NEAR = ContinuationSettings(max_turn=3.0, tolerance=1e-11, grow=False)
INNERMOST = 0.03  # s: nearer to the clamp a force bends nothing


@dataclass(frozen=True)
class Bench:
    """Beam and mounting: the parameters that the frames share have this `mean`, and the covariance `root root^T`.

    Beside those that the fit has: the independent ways in which log k is off, its common scale ("gain"), the
    discrepancy of the tags' poses for each metre that they move, and the place of the contact where it is said.
    """

    beam: Beam
    stiffness: UncertainStiffness | None
    observations: Observations
    layout: parameters.Layout
    known: FitData  # what does not go with the frame
    seen: Array  # (T + 1, m, 3) m, m, rad: the tags; the last frame is that at rest
    whiten: Array  # (T + 1, m, 3, 3)
    of_poses: tuple[Allowance, ...]  # in the same frames; the discrepancy last, its basis by `predicted`
    ways: Array  # (c, p) of the c coefficients of log k, each way of variance 1
    mean: Array  # (n,)
    root: Array  # (n, r)
    memory: GridMemory = field(default_factory=GridMemory, compare=False)  # of single frames: one grid serves many

    @property
    def columns(self) -> dict[str, slice]:
        """Where each group of parameters stands."""
        return self.layout.free_columns(0)

    def value(self, part: str) -> float:
        """Of a group that is one number."""
        return float(self.layout.get(self.mean, part, 0)[0])

    @property
    def place_sd(self) -> float:
        """m, of the contact's place where it is known beforehand."""
        return float(np.linalg.norm(self.root[self.columns.get("place", slice(0))]))

    @property
    def axes(self) -> Array:
        """(2, 2): takes a force from the recording's frame to that of the clamp, as its direction is known by now."""
        return parameters.log_axes(self.layout.get(self.mean, "clamp", 0)).T

    def axes_of_loads(self, n: int) -> Array:
        """(n, n): the same for a load."""
        out = np.eye(n)
        out[:2, :2] = self.axes
        return out

    def placed(self, place: Array) -> Array:
        """(F,) s where the force acts that is stated to act at `place` (F,)."""
        return np.clip(place + self.value("place") / self.observations.length, INNERMOST, 1.0)

    def showing(self, seen: Array, covariance: Array) -> Bench:
        """With other frames: tags (F, m, 3) of this `covariance` (F, m, 3, 3), in the first one's gravity."""
        o, count = self.observations, len(seen)
        other = replace(
            o,
            time=np.arange(float(count)),
            frame=np.arange(count),
            xy=seen[..., :2],
            angle=seen[..., 2],
            covariance=covariance,
            force=np.zeros((count, 2)),
            push_s=np.full(count, np.nan),
            loaded=np.ones(count, dtype=bool),
            gravity=np.tile(o.gravity[:1], (count, 1)),
        )
        every = np.concatenate([seen, self.seen[AT_REST]])
        whiten = np.concatenate([whitening(seen, covariance), self.whiten[AT_REST]])
        of_poses = tuple(replace(a, basis=0.0 * a.basis[: count + 1]) for a in self.of_poses)
        return replace(self, observations=other, seen=every, whiten=whiten, of_poses=of_poses)

    def at(self, frames: IntArray, place: Array, *, apart: bool = False) -> FitData:
        """`frames` (F,) as the fit has them, without a force, on a grid with an edge at its `place` (F,); `apart`: on
        one grid a frame, of as many panels wherever the places are, with an edge near its place."""
        edge = np.clip(_EDGES * np.round(place / _EDGES), INNERMOST, 1.0) if apart else place
        key = len(self.seen), *frames.tolist(), *edge.tolist(), apart
        make = partial(self._on_grid, frames, edge, apart)
        data = make() if len(frames) > 1 else self.memory.once(key, make)
        return replace(
            data,
            measured=self.seen[frames],
            whiten=self.whiten[frames],
            beyond=data.beyond + (self.observations.length * (place - edge))[:, None] * data.farther,
            allowances=(*data.allowances, *(replace(a, basis=a.basis[frames]) for a in self.of_poses)),
        )

    def _on_grid(self, frames: IntArray, edge: Array, apart: bool) -> FitData:
        """Without what was seen in these frames."""
        o, rows, at = self.observations, frames, edge
        if apart:  # a frame more, of another place
            rows, at = np.append(frames, frames[-1]), np.append(edge, 0.5 * edge[-1])
        gravity, known = np.vstack([o.gravity, np.zeros(2)])[rows], known_loads(o, np.ones(len(o.time), dtype=bool))
        loads = push(np.zeros((len(rows), 2)), at) + (known if known.size == 1 else rested(known).take(rows))
        problem = make_problem(self.beam, loads + weight(gravity), RESOLUTION)
        problem = problem.take(np.arange(len(frames))) if apart else problem
        if apart and len(frames) == 1:
            one = Grid(problem.grid.edges[0], problem.grid.order)
            of_beam = {name: getattr(problem, name)[0] for name in ("weights", "to_nodes", "k", "q0")}
            problem = replace(problem, grid=one, **of_beam)
        nodes, none = problem.grid.nodes, np.zeros((len(frames), 2))
        logs = {"gain": np.ones((*nodes.shape, 1))}
        if self.stiffness is not None:
            logs["ways"] = (self.stiffness.basis(nodes.ravel()) @ self.ways).reshape(*nodes.shape, -1)
        return replace(
            self.known,
            force=none,
            rate=none,
            error_weights=np.zeros((len(frames), 0)),
            problem=problem,
            beyond=(nodes < edge[:, None]).astype(float),
            farther=share_farther(problem, edge),
            weight=problem.dead_force,
            on_nodes=np.zeros((*nodes.shape, 0)),
            offset=np.log(problem.k),
            rest_on_nodes=REST_MODES.curvature(nodes),
            allowances=tuple(replace(a, basis=logs[a.name]) for a in self.known.allowances),
        )

    def predicted(self, data: FitData, load: Array, near: Array | None) -> Prediction:
        """Of frames under `load` (F, n); from shapes `near` (F, Q), if they are on the same grid."""
        if near is None or near.shape[1] != data.problem.grid.nodes.shape[-1]:
            now = predict(data, self.layout, self.mean, None, load)
        else:
            now = predict(data, self.layout, self.mean, near, load, _NEAR)
        where = self.columns.get("discrepancy")
        if where is None:
            return now
        moved = np.sum((now.pose[..., :2] - rest_places(self.observations)) ** 2, axis=-1)
        m, size = moved.shape[1], np.sqrt(np.mean(moved, axis=1))[:, None, None, None]
        off = replace(data.allowances[-1], basis=size * np.eye(3 * m).reshape(m, 3, 3 * m))
        pose = now.pose + off.basis @ self.mean[where]
        return replace(now, data=replace(data, allowances=(*data.allowances[:-1], off)), pose=pose)

    def derivatives(self, now: Prediction) -> tuple[Array, Array]:
        """Of the tags: (F, m, 3, n + 1) per unit of each frame's load and metre of its place; (F, m, 3, r) per sd of
        each error that the frames share. Forces are of the clamp's axes: they turn with the clamp."""
        slopes = now.slopes
        if "clamp" in self.columns:
            turned = slopes.a[..., 1] * now.own[:, 0, None, None] - slopes.a[..., 0] * now.own[:, 1, None, None]
            slopes.j[..., self.columns["clamp"].start] += turned
        own = np.concatenate([slopes.a, slopes.j[..., self.columns["place"]]], axis=-1)
        shared = slopes.j.reshape(-1, len(self.root)) @ self.root
        return own, shared.reshape(*slopes.j.shape[:-1], -1)


def bench_at(
    beam: Beam,
    observations: Observations,
    stiffness: UncertainStiffness | None,
    setup: SetUp | None,
    *,
    tags_as_learned: bool,
    place_sd: float,
) -> Bench:
    """As the recording states it, with the discrepancy of the `setup` in which the beam was learned, and the place of
    the contact to `place_sd` [m]; with `tags_as_learned`, rest curvature and tags are those of the set-up, with what
    their errors have in common with those of k(s). The clamp may be another."""
    o = observations
    as_learned = tags_as_learned and stiffness is not None and same_tags(o, setup)
    tags = [str(i) for i in o.tag_id]
    stated = {
        e.name: e.allowance([o], tags) if e.name in _STATED else e.with_sd(0.0, tags) for e in parameters.STATED_ERRORS
    }
    stated["place"] = parameters.inside("place", "m", max(place_sd, _NONE), ("place",))
    if as_learned and setup is not None:  # the joint density below takes the place of what is stated
        known = {name: replace(a, prior_sd=np.ones(a.count)) for name, a in stated.items() if name in setup.columns}
        stated |= {name: a for name, a in known.items() if name in LEARNED}
    ways = np.zeros((0, 0)) if stiffness is None else ways_of(stiffness)
    gain = parameters.inside("gain", "1", 0.0 if stiffness is None else stiffness.gain_sd, ("gain",))
    logs = [parameters.inside("ways", "1", 1.0, ("",) * ways.shape[1]), gain]
    logs = [replace(a, enters="log k") for a in logs if a.count and a.prior_sd[0] > 0.0]
    seen = np.concatenate([o.xy, o.angle[..., None]], axis=-1)
    seen = np.concatenate([seen, np.concatenate([o.rest_xy, o.rest_angle[:, None]], axis=1)[None]])
    of_poses = _picture(o, seen) + _discrepancy(o, setup)
    wanted = [(0, a) for a in (*stated.values(), *logs, *of_poses, *parameters.without_recording())]
    layout = parameters.layout_of(parameters.Spline(0), wanted)
    blocks = [block.prior_sd for block in layout.blocks if block.start >= 0]
    root = np.diag(np.concatenate([np.zeros(0), *blocks]))
    covariance = np.concatenate([o.covariance, o.rest_covariance[None]])
    bench = Bench(
        beam=beam,
        stiffness=stiffness,
        observations=o,
        layout=layout,
        known=replace(_without_frames(o), allowances=tuple(logs)),
        seen=seen,
        whiten=whitening(seen, covariance),
        of_poses=of_poses,
        ways=ways,
        mean=np.zeros(layout.size),
        root=root,
    )
    return _as_learned(bench, stiffness, setup) if as_learned and stiffness is not None and setup is not None else bench


def _without_frames(o: Observations) -> FitData:
    """What of a recording does not go with the frame."""
    plain = replace(o, static=False, readings=Readings(), held=None, known_loads=None, gravity=0.0 * o.gravity)
    plain = replace(plain, source=replace(o.source, clean_force=None), force=0.0 * o.force, push_s=np.ones(len(o.time)))
    one = at_frames(plain, np.arange(len(o.time)) < 1)
    return replace(fit_data(one, 0, np.ones(1, dtype=bool), parameters.Spline(4)), tags=np.arange(len(o.marker_s)))


def _discrepancy(o: Observations, setup: SetUp | None) -> tuple[Allowance, ...]:
    """Errors of each tag's x, y and angle that go with how far the tags have moved, as learning left them."""
    m, (place, angle) = len(o.marker_s), (0.0, 0.0) if setup is None else (setup.discrepancy, setup.angle_discrepancy)
    sds = np.tile([max(place, _NONE), max(place, _NONE), max(angle, _NONE)], m)
    basis = np.zeros((len(o.time) + 1, m, 3, 3 * m))
    one = Allowance("discrepancy", "poses", "1", ("",) * (3 * m), sds, basis)
    return (one,) if max(place, angle) > 0.0 else ()


def same_tags(observations: Observations, setup: SetUp | None) -> bool:
    """Whether the tags of this recording are at the places of those in the set-up."""
    if setup is None or len(setup.tags) != len(observations.marker_s):
        return False
    return bool(np.allclose(setup.tags, observations.marker_s, rtol=0.0, atol=_SAME_PLACE))


def _picture(o: Observations, seen: Array) -> tuple[Allowance, ...]:
    """The unknowns of the camera, its plane, the tags' heights over it and the outline's."""
    found = camera(o, np.ones(len(o.time), dtype=bool), len(seen)), outline_height(o, seen)
    return tuple(one for one in found if one is not None)


def ways_of(stiffness: UncertainStiffness) -> Array:
    """(c, p) of the coefficients: the independent ways in which log k is off, each of variance 1, without those that
    change log k by less than `_SLIGHT`, root mean square over the beam."""
    values, vectors = np.linalg.eigh(stiffness.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    on_beam = stiffness.basis(np.linspace(0.0, 1.0, _PLACES)) @ root / np.sqrt(_PLACES)
    _, size, turn = np.linalg.svd(on_beam, full_matrices=False)
    return np.asarray(root @ turn[size > _SLIGHT].T)


def _as_learned(bench: Bench, stiffness: UncertainStiffness, setup: SetUp) -> Bench:
    """With the joint density of log k and the set-up; ways of log k that were left out are counted with what k(s) does
    not tell."""
    names = [name for name in LEARNED if name in setup.columns]
    ours, theirs = (np.concatenate([np.r_[where[name]] for name in names]) for where in (bench.columns, setup.columns))
    slope = setup.slope[theirs]
    unseen = slope @ (stiffness.covariance - bench.ways @ bench.ways.T) @ slope.T
    values, vectors = np.linalg.eigh(setup.covariance[np.ix_(theirs, theirs)] + 0.5 * (unseen + unseen.T))
    mean, root = bench.mean.copy(), bench.root.copy()
    root[ours] = 0.0
    root[np.ix_(ours, ours)] = vectors * np.sqrt(np.maximum(values, 0.0))
    root[ours, bench.columns["ways"]] = slope @ bench.ways
    mean[ours] = setup.mean[theirs]
    mean[bench.columns.get("curvature", slice(0))] = 0.0  # that of the beam is the learned one
    return replace(bench, mean=mean, root=root)


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
    if parameters.weighs(o) and not has_mass(beam):
        raise LearningError(f"{o.source.name}: {parameters.NEEDS_MASS}")


# The search begins at the load that balances the curvature from inverse kinematics (22), `k (q - q0) = (r(s_a) - r(s))
# x F` below `s_a`: linear least squares over places, with the load's prior.

_MODES = 4  # of the curvature, for a start
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
