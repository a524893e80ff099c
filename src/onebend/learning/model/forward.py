"""From parameters to predicted tags, with exact derivatives: the model of the marker-space fit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from onebend.beam.grid import apply, paired
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.perturbation import Perturbations
from onebend.beam.statics.sensitivity import of_force, of_moment, of_rest_curvature, respond
from onebend.learning.model.allowed import (
    allowance_changes,
    allowed,
    allowed_clamp,
    allowed_length,
    allowed_section,
    clamp_blocks,
    equilibria,
    log_k_functions,
    relaxation_derivatives,
    remembers,
)
from onebend.learning.model.fit_data import FitData
from onebend.learning.model.held_ends import moved, put_ends, solve, with_ends_held
from onebend.learning.model.memory import remembered_poses
from onebend.learning.model.parameters import Layout, log_axes, rest_curvature
from onebend.learning.model.readings import ruler_places, whitened, zeroed_coordinates
from onebend.learning.model.tag_jacobian import (
    BentBeam,
    TagMotion,
    TagRide,
    balance_changes,
    free_columns,
    push_forces,
    pushed_by,
    put_blocks,
    put_tags,
    response_columns,
)
from onebend.records import Array, IntArray
from onebend.workers import in_own_pages


@dataclass(frozen=True)
class Slopes:
    """Derivatives of R numbers a frame with the parameters of a film (`at.known_to`) and with each frame's force.

    The slow error of the force log comes last of the parameters. It enters by its value in the frame and, where the
    material remembers, by those in n key frames before it, so its K knots are not written out.
    """

    j: Array  # (F, ..., C - 2 K + 2 n) with all parameters but that error, and with the push in the key frames
    a: Array  # (F, ..., 2) with the frame's force
    axes: Array  # (2, 2) by which the logged force is turned
    weights: Array  # (F, K): that error is `weights @ values`
    added: Array | None = None  # (F, ..., 2) what memory adds to `a` for a part of the push that lasts
    keys: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # (n,) the key frames

    @property
    def others(self) -> int:
        """How many parameters there are but that error's."""
        return int(self.j.shape[-1]) - 2 * len(self.keys)

    @property
    def lasting(self) -> Array:
        """(F, ..., 2) with a push that lasts, as that error does."""
        return self.a if self.added is None else self.a + self.added

    @property
    def written(self) -> Array:
        """(F, ..., C) with all parameters."""
        count, frames = self.others, (len(self.weights), *[1] * (self.a.ndim - 2))
        out = np.empty((*self.a.shape[:-1], count + 2 * self.weights.shape[1]))
        out[..., :count] = self.j[..., :count]
        by_knots = -(self.lasting @ self.axes)[..., None, :] * self.weights.reshape(*frames, -1, 1)
        out[..., count:] = by_knots.reshape(*self.a.shape[:-1], -1)
        if len(self.keys):
            out[..., count:] -= self.j[..., count:] @ np.kron(self.weights[self.keys], self.axes)
        return out

    def times(self, step: Array) -> Array:
        """(F, ...): what a step (C,) of the parameters does."""
        error = self.weights @ step[self.others :].reshape(-1, 2) @ self.axes.T
        with_keys = np.concatenate([step[: self.others], -error[self.keys].ravel()])
        return np.asarray(self.j @ with_keys - np.einsum("t...d,td->t...", self.lasting, error))

    def transposed_times(self, v: Array) -> Array:
        """(C, n): what n sets of R numbers a frame, v (F, R, n), have with each parameter."""
        dense = self.j.reshape(-1, self.j.shape[-1]).T @ v.reshape(-1, v.shape[-1])
        return self.with_knots(dense, np.swapaxes(self.lasting, 1, 2) @ v)

    def with_knots(self, dense: Array, by_push: Array) -> Array:
        """(C, n) from what is known with the columns of `j` (., n) and with each frame's lasting push (F, 2, n)."""
        count = self.others
        by_keys = dense[count:].reshape(len(self.keys), 2, dense.shape[1])  # x and y in turn
        return np.concatenate([dense[:count], self.onto_knots(by_push) + self.onto_knots(by_keys, self.keys)])

    def onto_knots(self, by_push: Array, frames: IntArray | slice = slice(None)) -> Array:
        """(2 K, n) with that error's knots, from what is known with the push in some frames (., 2, n)."""
        weights, count = self.weights[frames], by_push.shape[-1]
        by_error = -self.axes.T @ by_push  # the error is taken off the log
        return (weights.T @ by_error.reshape(len(weights), 2 * count)).reshape(2 * weights.shape[1], count)


@dataclass(frozen=True)
class Prediction:
    """Tags where the parameters put them."""

    recording: FitData
    layout: Layout
    x: Array  # (P,) the parameters
    solved: Equilibrium
    pose: Array  # (F, m, 3)
    force: Array  # (F, 2) N, the corrected force, `own` with it
    own: Array  # (F, 2) N, what of the force is each frame's own: less the log's error that is faster than the knots
    nearby: Slopes | None = None  # whitened ones of shapes so near that they do for these as well

    @property
    def slopes(self) -> Slopes:
        """Derivatives of the tags' poses (F, m, 3), exact."""
        return _slopes(self)

    @cached_property
    def whitened_slopes(self) -> Slopes:
        """The same of the whitened poses, R = 3 m numbers a frame; zero where a tag was not seen."""
        if self.nearby is not None:
            return self.nearby
        whiten, shapes = self.recording.whiten, replace(self.solved, problem=replace(self.solved.problem))
        slopes = replace(self, solved=shapes).slopes  # what is worked out of the shapes on the way is not kept
        added = None if slopes.added is None else whitened(whiten, slopes.added)
        return replace(slopes, j=in_own_pages(whitened(whiten, slopes.j)), a=whitened(whiten, slopes.a), added=added)

    @property
    def whitened_by_force(self) -> Slopes:
        """`whitened_slopes` with each frame's force, and with no parameter: a small part of the work."""
        recording, frames = self.recording, len(self.pose)
        by_force = pushed_by(_pushed(recording, self.layout, self.x), np.eye(2)[None])
        ride = tag_ride(recording, self.layout, self.x, self.solved)
        a = whitened(recording.whiten, ride.carry(_responses(self, Perturbations((by_force,)))[0]))
        return Slopes(a[..., :0], a, np.eye(2), np.zeros((frames, 0)))

    def release(self) -> None:
        """Forget the derivatives, most of what a fit holds in memory; they are worked out again where asked for, and
        then its own ones."""
        self.__dict__.pop("whitened_slopes", None)
        self.__dict__["nearby"] = None


def predict(recording: FitData, layout: Layout, x: Array, start: Array | None, own: Array | None = None) -> Prediction:
    """Equilibria and tags for parameters x and each frame's `own` force (F, 2) [N], none where it is not given;
    warm-started from shapes `start` (F, Q) where given."""
    r = recording.number
    own = np.zeros_like(recording.force) if own is None else own
    slow = recording.error_weights @ layout.get(x, "force", r).reshape(-1, 2)
    force = (recording.force - slow + recording.rate * layout.get(x, "clock", r)) @ log_axes(layout, x, r).T + own
    force = force + allowed(recording, layout, x, "force")
    k = np.exp(
        recording.offset + recording.on_nodes @ layout.get(x, "stiffness") + allowed(recording, layout, x, "log k")
    )
    weight_beyond = recording.weight + allowed(recording, layout, x, "load")
    if recording.mass is not None:
        weight_beyond = weight_beyond + recording.mass.force(recording.problem, k, layout.get(x, "mass"))
    problem = replace(
        recording.problem,
        k=k,
        length=allowed_length(recording, layout, x),
        section=allowed_section(recording, layout, x)[0],
        q0=recording.rest_on_nodes @ rest_curvature(layout, x, r),
        alpha0=allowed_clamp(recording, layout, x),
        dead_force=_pushed(recording, layout, x)[..., None] * force[:, None, :] + weight_beyond,
    )
    if recording.ends is not None:
        solved = solve(problem, recording.ends, moved(recording.ends, layout, x, r), start, recording.poses)
    else:
        solved = equilibria(recording, layout, x, problem, start)
    s, _ = tag_places(recording, layout, x, solved)
    ride = tag_ride(recording, layout, x, solved)
    xy = ride.scale * (solved.xy(s) + ride.offset) + layout.get(x, "origin", r)
    if recording.rulers is not None:
        xy = paired(recording.rulers, xy[..., 1] + layout.get(x, "across"))
    pose = np.concatenate([xy, (ride.angle + layout.get(x, "turn"))[..., None]], axis=-1)
    for (i, c), zero in zip(zeroed_coordinates(recording.observations), layout.get(x, "zero", r), strict=True):
        pose[:, i, c] -= zero
    return Prediction(recording, layout, x, solved, pose + allowed(recording, layout, x, "poses"), force, own)


def _slopes(now: Prediction) -> Slopes:
    recording, layout, x, r, solved = now.recording, now.layout, now.x, now.recording.number, now.solved
    bent, axes = _bent(now), log_axes(layout, x, r)
    logged = now.force - now.own - allowed(recording, layout, x, "force")
    pushes = {name: pushed_by(bent.beyond, f) for name, f in push_forces(logged, axes, recording.rate).items()}
    columns = response_columns(balance_changes(bent) | pushes | allowance_changes(recording, bent))
    nodes, has_memory = solved.q.shape[1], remembers(recording, layout, x)
    each_node = of_rest_curvature(solved.problem, np.eye(nodes) if has_memory else np.zeros((nodes, 0)))
    both, by_end = _responses(now, columns.changes + each_node)
    response, by_node = np.split(both, [len(columns.changes.clamp)], axis=-1)
    s, ride = tag_places(recording, layout, x, solved)[0], tag_ride(recording, layout, x, solved)
    if recording.ends is None and "length" in columns.slices:
        response[:, :, :2, columns.slices["length"]] += solved.xy(s)[..., None]
    carried = ride.carry(response)
    free, error = free_columns(layout, r), layout.columns("force", r)
    out = np.zeros((*now.pose.shape, len(layout.known_to(r)) if error is None else error.start))
    slopes = Slopes(out, columns.split(carried)["push"], axes, recording.error_weights)
    if has_memory:
        memory = remembered_poses(recording, layout, x, solved, columns, by_node)
        carried = carried + ride.carry(memory.by_parameters)
        if error is not None:
            out = np.concatenate([out, ride.carry(memory.by_pushes)], axis=-1)
            slopes = replace(slopes, j=out, added=ride.carry(memory.by_push), keys=memory.keys)
    blocks = columns.split(carried)
    blocks = blocks | {"rest change": blocks["curvature"]} | clamp_blocks(recording, blocks["clamp"])
    put_blocks(slopes.j, free, blocks)
    put_tags(slopes.j, free, _tag_motion(now, ride, s))
    if recording.ends is not None:
        held = replace(ride, angle=ride.angle[recording.ends.frames])
        put_ends(slopes.j, recording.ends, layout, r, held.carry(by_end))
    if "zero" in free:
        for n, (i, c) in enumerate(zeroed_coordinates(recording.observations)):
            slopes.j[:, i, c, free["zero"].start + n] = -1.0
    return slopes


def _responses(now: Prediction, changes: Perturbations) -> tuple[Array, Array]:
    """(F, m, 3, P) of the beam's places under the tags to changes, and (H, m, 3, 3) to the held ends."""
    recording, solved = now.recording, now.solved
    s, _ = tag_places(recording, now.layout, now.x, solved)
    if recording.ends is None:
        return respond(solved, changes).poses(s), np.zeros((0, s.shape[-1], 3, 3))
    wrench = of_force(solved.problem, np.ones(1)) + of_moment(solved.problem, np.ones(1))
    return with_ends_held(respond(solved, changes + wrench).poses(np.append(s, 1.0)), recording.ends)


def _tag_motion(now: Prediction, ride: TagRide, s: Array) -> TagMotion:
    """How the tags at places `s` (S,) move with what holds them; a metre along is one of the length as written."""
    recording, layout, x, solved = now.recording, now.layout, now.x, now.solved
    seen = now.pose - allowed(recording, layout, x, "poses")
    xy = (seen[..., :2] - layout.get(x, "origin", recording.number)) / ride.scale
    written, on_beam = recording.observations.length, ride.over <= 0.0
    if ride.ruler:
        return ride.motion(xy, ride.over)
    bend = np.where(on_beam, apply(solved.problem.grid.value_at(s), solved.q) / written, 0.0)
    if not recording.allowances:
        return ride.motion(xy, bend)
    tangent = np.stack([np.cos(ride.angle), np.sin(ride.angle)], axis=-1)
    return ride.motion(xy, bend, np.where(on_beam[:, None], solved.xy_by_s(s) / written, tangent))


def _bent(now: Prediction) -> BentBeam:
    """What the parameters change in the balance of the fitted shapes."""
    recording, layout, x, solved = now.recording, now.layout, now.x, now.solved
    on_nodes, by_mass, weight_by_k = recording.on_nodes, None, None
    if recording.mass is not None:
        k = solved.problem.k
        by_mass = recording.mass.by_mass(recording.problem, k)
        weight_by_k = recording.mass.by_stiffness(recording.problem, k, on_nodes, layout.get(x, "mass"))
    return BentBeam(
        solved,
        on_nodes,
        recording.rest_on_nodes,
        now.force,
        _pushed(recording, layout, x),
        recording.farther,
        by_mass,
        weight_by_k,
        log_k_functions(recording),
        relaxation_derivatives(recording, layout, x, solved),
        lengthens="length" in free_columns(layout, recording.number),
        thickens=allowed_section(recording, layout, x)[1],
    )


def tag_places(recording: FitData, layout: Layout, x: Array, solved: Equilibrium) -> tuple[Array, Array]:
    """Where the tags sit: (m,) s on the beam, and (m,) m beyond its tip, where one sits there; (F, m) each of what is
    under rulers."""
    if recording.rulers is not None:
        origin, along = layout.get(x, "origin", recording.number), layout.get(x, "along")
        return ruler_places(solved, np.nan_to_num(recording.rulers) + along - origin[0])
    length = recording.observations.length
    s = recording.observations.marker_s + layout.get(x, "along") / length
    return np.clip(s, 0.0, 1.0), length * (s - np.clip(s, 0.0, 1.0))


def tag_ride(recording: FitData, layout: Layout, x: Array, solved: Equilibrium) -> TagRide:
    """The tags on fitted shapes."""
    s, over = tag_places(recording, layout, x, solved)
    scale = 1.0 + float(layout.get(x, "scale", recording.number)[0])
    if recording.rulers is not None:
        return TagRide(solved.angle(s), over, np.zeros(over.shape[1]), scale, ruler=True)
    return TagRide(solved.angle(s), over, layout.get(x, "across"), scale)


def _pushed(recording: FitData, layout: Layout, x: Array) -> Array:
    """(F, Q) share of the push that acts beyond the node."""
    place = layout.get(x, "place", recording.number) + allowed(recording, layout, x, "place")  # (1,) or (F,) m
    return np.asarray(recording.beyond + place[:, None] * recording.farther)
