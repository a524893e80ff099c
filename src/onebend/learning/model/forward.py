"""From parameters to predicted tags, with exact derivatives: the model of the marker-space fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from onebend.beam.grid import apply, paired
from onebend.beam.statics.equilibrium import Equilibrium
from onebend.beam.statics.perturbation import Perturbations
from onebend.beam.statics.sensitivity import of_force, of_moment, of_rest_curvature, respond
from onebend.learning.model.allowed import (
    allowance_changes,
    allowed,
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
from onebend.learning.model.parameters import Layout, rest_curvature
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


@dataclass(frozen=True)
class Slopes:
    """Derivatives of R numbers a frame with the parameters of a film (`at.known_to`) and with each frame's force.

    The slow error of the force log comes last of the parameters. It enters by its value in the frame alone, so its K
    knots are not written out: they have `-a axes` times the frame's weights. Where the material remembers earlier
    frames they are written out, and K is 0.
    """

    j: Array  # (F, ..., C - 2 K) with all parameters but that error
    a: Array  # (F, ..., 2) with the frame's force
    axes: Array  # (2, 2) by which the logged force is turned
    weights: Array  # (F, K): that error is `weights @ values`

    @property
    def written(self) -> Array:
        """(F, ..., C) with all parameters."""
        count, frames = self.j.shape[-1], (len(self.weights), *[1] * (self.a.ndim - 2))
        out = np.empty((*self.a.shape[:-1], count + 2 * self.weights.shape[1]))
        out[..., :count] = self.j
        by_knots = -(self.a @ self.axes)[..., None, :] * self.weights.reshape(*frames, -1, 1)
        out[..., count:] = by_knots.reshape(*self.a.shape[:-1], -1)
        return out

    def times(self, step: Array) -> Array:
        """(F, ...): what a step (C,) of the parameters does."""
        count = self.j.shape[-1]
        error = self.weights @ step[count:].reshape(-1, 2) @ self.axes.T
        return np.asarray(self.j @ step[:count] - np.einsum("t...d,td->t...", self.a, error))

    def transposed_times(self, v: Array) -> Array:
        """(C, n): what n sets of R numbers a frame, v (F, R, n), have with each parameter."""
        frames, n = len(v), v.shape[-1]
        of_parameters = self.j.reshape(-1, self.j.shape[-1]).T @ v.reshape(-1, n)
        by_error = -self.axes.T @ (np.swapaxes(self.a, 1, 2) @ v)  # (F, 2, n)
        of_knots = (self.weights.T @ by_error.reshape(frames, -1)).reshape(-1, n)
        return np.concatenate([of_parameters, of_knots])


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
        return replace(slopes, j=whitened(whiten, slopes.j), a=whitened(whiten, slopes.a))

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
    force = (recording.force - slow + recording.rate * layout.get(x, "clock", r)) @ _axes(layout, x, r).T + own
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
        alpha0=_clamp_angle(recording, layout, x),
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
    bent, axes = _bent(now), _axes(layout, x, r)
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
        slopes = _with_memory(slopes, ride.carry(memory.by_push), ride.carry(memory.by_pushes), memory.keys)
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


def _with_memory(slopes: Slopes, by_push: Array, by_pushes: Array, keys: IntArray) -> Slopes:
    """With what the memory adds to the derivatives of the tags with the push: (F, m, 3, 2) of the frame itself,
    (F, m, 3, 2 n) of n key frames. It goes to the knots of the force log's slow error, which are written out."""
    written = replace(slopes, a=slopes.a + by_push).written
    late = (by_pushes.reshape(*by_pushes.shape[:3], -1, 2) @ slopes.axes).swapaxes(-1, -2)  # (F, m, 3, 2, n)
    by_knots = (late @ slopes.weights[keys]).swapaxes(-1, -2)  # the error is taken off the log
    written[..., slopes.j.shape[-1] :] -= by_knots.reshape(*by_pushes.shape[:3], -1)
    return Slopes(written, slopes.a, slopes.axes, slopes.weights[:, :0])


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


def _clamp_angle(recording: FitData, layout: Layout, x: Array) -> Array:
    """() or (F, 1) rad."""
    angle, gives = layout.get(x, "clamp", recording.number)[0], allowed(recording, layout, x, "clamp")
    return np.asarray(angle if isinstance(gives, float) else angle + gives[:, None])


def _axes(layout: Layout, x: Array, r: int) -> Array:
    """(2, 2) by which the logged force is turned."""
    turn = float(layout.get(x, "direction", r)[0])
    cos, sin = np.cos(turn), np.sin(turn)
    return np.array([[cos, -sin], [sin, cos]])
